"""The end of a command's process: its exit code at once, one line after a signal, and no unfinished file.

Python runs signal handlers in the main thread alone, and not while that is inside compiled code: XLA compiles for many
seconds. So the first SIGINT or SIGTERM raises KeyboardInterrupt in the main thread, and a separate thread, which the
signal itself wakes, ends the process if it still runs `GRACE_S` later, or at a second signal.

For the command line only: in a notebook or a test, only functions without side effects are called. Imports only the
standard library, as handlers must be installed before JAX is imported.
"""

import atexit
import contextlib
import os
import shutil
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

try:
    import resource
except ImportError:  # no POSIX system
    resource = None

GRACE_S = 3.0  # for the main thread after a signal, and for exit functions
ECHO_S = 0.5  # so soon after the first signal the next is the same one: `timeout` sends it to a process and its group
PART = ".part-"  # prefix of files that are being written
LEAST_BYTES = 3 * 2**29  # of address space: no plan needs less, and with less, libraries abort the process
FAILED, SIGNALLED = 1, 128
HANDLED = signal.SIGINT, signal.SIGTERM
INTERRUPTED = "interrupted; what was unfinished is removed"
NO_MEMORY = "out of memory"

_messages: list[Callable[[], str]] = []
_watched_signals: list["_Process"] = []


def is_watched() -> bool:
    """Return True in a process of the command line, which a second signal ends without its main thread."""
    return bool(_watched_signals)


@contextlib.contextmanager
def stop_message(message: Callable[[], str]) -> Iterator[None]:
    """Call `message` if the process is ended within the block; of nested blocks, the outermost one's.

    Args:
        message: Removes unfinished files and returns the line to print.
    """
    _messages.append(message)
    try:
        yield
    finally:
        _messages.remove(message)


@contextlib.contextmanager
def signals_blocked() -> Iterator[None]:
    """Make processes started within the block ignore SIGINT and SIGTERM from the first moment.

    A terminal and `timeout` send them to all, and the parent handles them. Signals to this process go to another
    thread.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, HANDLED)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def run(command: Callable[[], int]) -> NoReturn:
    """Run a command, which returns its exit code, and end the process with it.

    After a signal the code is 130 or 143, stderr has one line, and files and folders that were being written are
    removed.
    """
    process = _Process()
    try:
        process.watch()
        code = _code_of(command, process)
        process.leaving = True
    except KeyboardInterrupt:  # raised once in a process
        process.leaving, code = True, SIGNALLED
        _write_line(INTERRUPTED)
    process.leave(code)


def _code_of(command: Callable[[], int], process: "_Process") -> int:
    if (limit := _address_space()) < LEAST_BYTES:
        _write_line(f"{NO_MEMORY}: the address space is limited to {limit / 1e9:.1f} GB (ulimit -v)")
        return FAILED
    try:
        return command()
    except SystemExit as ended:  # of shell completion
        return ended.code if isinstance(ended.code, int) else FAILED if ended.code else 0
    except Exception as error:
        if process.number:  # some libraries make another exception of KeyboardInterrupt
            _write_line(INTERRUPTED)
        elif why := _of_memory(error):
            _write_line(" ".join(f"{NO_MEMORY}: {why}".split()))
        else:
            traceback.print_exc()
        return FAILED


class _Process:
    """This process, its signals, and the files and folders that it has made."""

    def __init__(self):
        self.number = 0  # of the first signal
        self.raised = self.leaving = False
        self._ends = threading.Lock()
        self.made: list[str] = []  # temporary folders and unfinished files
        self.folders: list[str] = []

    def watch(self) -> None:
        """Handle signals from now on, except ignored ones, such as those of a script's background job."""
        _watched_signals.append(self)
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        for number in HANDLED:
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self._raise)
        threading.Thread(target=self._end_in_time, args=(reading,), daemon=True).start()
        sys.addaudithook(self._note)
        sys.unraisablehook = self._unless_signalled(sys.unraisablehook)
        threading.excepthook = self._unless_signalled(threading.excepthook)
        # Silences multiprocessing's resource tracker, which cleans up after this process with a warning.
        os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")

    def _raise(self, number: int, frame: FrameType | None) -> None:
        self.number = self.number or number
        if self.raised or self.leaving:
            return
        self.raised = True
        if _imports(frame):  # libraries print or replace what is raised there
            self._end()
        raise KeyboardInterrupt

    def _unless_signalled(self, hook: Callable) -> Callable:
        """Return the hook, silenced after a signal: errors in destructors, callbacks and threads are then expected."""
        return lambda error: None if self.number else hook(error)

    def _note(self, event: str, args: tuple) -> None:
        if event == "tempfile.mkdtemp":
            self.made.append(args[0])
        elif event == "open" and isinstance(args[0], str | Path) and os.path.basename(args[0]).startswith(PART):
            self.made.append(os.path.abspath(args[0]))
        elif event == "os.mkdir" and not os.path.exists(args[0]):
            self.folders.append(os.path.abspath(args[0]))

    def _end_in_time(self, wakeups: int) -> None:
        while (number := os.read(wakeups, 1)[0]) not in HANDLED:
            pass
        began, self.number = time.monotonic(), self.number or number
        threading.Thread(target=self._end_after_grace, daemon=True).start()
        while os.read(wakeups, 1)[0] not in HANDLED or time.monotonic() - began < ECHO_S:
            pass
        self._end()

    def _end_after_grace(self) -> None:
        time.sleep(GRACE_S)
        self._end()

    def _end(self) -> NoReturn:
        """End the process, whatever its main thread is doing."""
        self._ends.acquire()  # for good: the first thread here ends all
        line = INTERRUPTED
        with contextlib.suppress(Exception):
            line = _messages[0]() if _messages else INTERRUPTED
        if not self.leaving:
            _write_line(line)
        self._exit(SIGNALLED)

    def leave(self, code: int) -> NoReturn:
        """End the process as the interpreter would, but without its last steps.

        In these, threads in compiled code that need the interpreter abort it.
        """
        self.leaving = True
        last = threading.Timer(GRACE_S, self._exit, [code])
        last.daemon = True
        with contextlib.suppress(RuntimeError):  # no memory for a thread
            last.start()
        with contextlib.suppress(BaseException):
            atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):  # closed, full, or None
                stream.flush()
        self._exit(code)

    def _exit(self, code: int) -> NoReturn:
        """End at once; buffered output is lost, as the main thread may hold the buffer."""
        if self.number and code:
            code = SIGNALLED + self.number
        _kill_children()
        for path in self.made:
            shutil.rmtree(path, ignore_errors=True)
            with contextlib.suppress(OSError):
                os.unlink(path)
        for folder in reversed(self.folders if code >= SIGNALLED else []):
            with contextlib.suppress(OSError):  # not empty
                os.rmdir(folder)
        os._exit(code)


def _write_line(line: str) -> None:
    """Write one line to stderr, past its buffer.

    On a terminal it replaces a progress bar, which hides the cursor.
    """
    begin = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""
    with contextlib.suppress(OSError):
        os.write(2, f"{begin}htcp: {line}\n".encode(errors="replace"))


def _imports(frame: FrameType | None) -> bool:
    """Return True if the frame is within an import."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _kill_children() -> None:
    """End all child processes except resource trackers, which end with this one and remove its shared resources."""
    for file in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in file.read_text().split():
                if b"resource_tracker" not in Path("/proc", child, "cmdline").read_bytes():
                    os.kill(int(child), signal.SIGKILL)


def _address_space() -> float:
    limit = resource.getrlimit(resource.RLIMIT_AS)[0] if resource else -1
    return float("inf") if limit < 0 else limit


def _of_memory(error: BaseException) -> str | None:
    """Return the text of an out-of-memory error; None for any other error."""
    words = str(error)
    signs = "RESOURCE_EXHAUSTED", "bad_alloc", "llocate memory", "t start new thread", "failed to map segment"
    is_one = isinstance(error, MemoryError) or any(sign in words for sign in signs)
    return (words or type(error).__name__) if is_one else None
