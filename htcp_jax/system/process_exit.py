"""End of a command's process: a prompt exit, one line after a signal, and removal of unfinished files.

Python runs signal handlers in the main thread only, and not while that thread runs compiled code; XLA compiles for many
seconds. Therefore the first SIGINT or SIGTERM does two things. It raises KeyboardInterrupt in the main thread, and it
wakes a second thread, which ends the process after `GRACE_S` seconds or at a second signal.

Only the command line installs these handlers; notebooks and tests do not. This module imports only the standard
library, because the handlers are installed before JAX is imported.
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

from htcp_jax.system.unfinished import PART

try:
    import resource
except ImportError:  # not a POSIX system
    resource = None

GRACE_S = 3.0  # time for the main thread to end after a signal; also time for the exit functions
ECHO_S = 0.5  # signals this soon after the first are ignored: `timeout` signals a process and then its group
LEAST_BYTES = 3 * 2**29  # minimum address space: with less, libraries abort the process
FAILED, SIGNALLED = 1, 128
HANDLED = signal.SIGINT, signal.SIGTERM
INTERRUPTED = "interrupted; unfinished results are removed"
NO_MEMORY = "out of memory"

_messages: list[Callable[[], str]] = []
_watched_signals: list["_Process"] = []


def is_watched() -> bool:
    """Return True if the command line's signal handling is active in this process."""
    return bool(_watched_signals)


@contextlib.contextmanager
def stop_message(message: Callable[[], str]) -> Iterator[None]:
    """Return a context that sets the message for a signal which the main thread does not handle in time.

    If blocks are nested, the outermost block's message is printed.

    Args:
        message: Function that removes unfinished files and returns the line to print.
    """
    _messages.append(message)
    try:
        yield
    finally:
        _messages.remove(message)


def run(command: Callable[[], int]) -> NoReturn:
    """Run a command and end the process with the exit code that it returns.

    After a signal the code is 130 or 143, one line is printed to stderr, and unfinished files and folders are removed.
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
        _write_line(
            f"{NO_MEMORY}: the address space is limited to {limit / 1e9:.1f} GB; "
            f"set ulimit -v to {LEAST_BYTES // 1024} or more"
        )
        return FAILED
    try:
        return command()
    except SystemExit as ended:  # raised by shell completion
        return ended.code if isinstance(ended.code, int) else FAILED if ended.code else 0
    except Exception as error:
        if process.number:  # some libraries convert KeyboardInterrupt to another exception
            _write_line(INTERRUPTED)
        elif why := _of_memory(error):
            _write_line(" ".join(f"{NO_MEMORY}: {why}".split()))
        else:
            traceback.print_exc()
        return FAILED


class _Process:
    """Signal handling of this process, and the files and folders to remove at its end."""

    def __init__(self):
        self.number = 0  # number of the first signal; 0: none yet
        self.raised = self.leaving = False
        self._ends = threading.Lock()
        self.made: list[str] = []  # temporary folders and unfinished files; always removed at the end
        self.folders: list[str] = []  # other folders it created; removed after a signal, if empty

    def watch(self) -> None:
        """Install the signal handlers, except for signals that the process ignores, as in a script's background job."""
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
        # Suppresses the warning with which multiprocessing's resource tracker cleans up after this process.
        os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker:UserWarning")

    def _raise(self, number: int, frame: FrameType | None) -> None:
        self.number = self.number or number
        if self.raised or self.leaving:
            return
        self.raised = True
        if _imports(frame):  # libraries print or replace an exception during import
            self._end()
        raise KeyboardInterrupt

    def _unless_signalled(self, hook: Callable) -> Callable:
        """Return the hook for uncaught errors, made silent after a signal, when threads and destructors may fail."""
        return lambda error: None if self.number else hook(error)

    def _note(self, event: str, args: tuple) -> None:
        if event == "tempfile.mkdtemp":
            self.made.append(args[0])
        elif event == "open" and isinstance(args[0], str | Path) and os.path.basename(args[0]).startswith(PART):
            if args[2] & os.O_CREAT:  # `unfinished.clear` opens those of other processes
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
        """Print the message set by `stop_message` and end the process without waiting for the main thread."""
        self._ends.acquire()  # never released: only the first thread gets past this line
        line = INTERRUPTED
        with contextlib.suppress(Exception):
            line = _messages[0]() if _messages else INTERRUPTED
        if not self.leaving:
            _write_line(line)
        self._exit(SIGNALLED)

    def leave(self, code: int) -> NoReturn:
        """Run exit functions, flush the output and end the process, without finalising the interpreter.

        During finalisation, threads in compiled code that need the interpreter abort the process.
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
        """End the process at once, without flushing buffers, which the main thread may have locked."""
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
    """Write one line to stderr without a buffer.

    On a terminal, the line replaces a progress bar, and the cursor becomes visible again.
    """
    begin = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""
    with contextlib.suppress(OSError):
        os.write(2, f"{begin}htcp: {line}\n".encode(errors="replace"))


def _imports(frame: FrameType | None) -> bool:
    """Return True if this frame is executed during an import."""
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _kill_children() -> None:
    """Kill all child processes except resource trackers, which end by themselves and free shared resources."""
    for file in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):
            for child in file.read_text().split():
                if b"resource_tracker" not in Path("/proc", child, "cmdline").read_bytes():
                    os.kill(int(child), signal.SIGKILL)


def _address_space() -> float:
    limit = resource.getrlimit(resource.RLIMIT_AS)[0] if resource else -1
    return float("inf") if limit < 0 else limit


def _of_memory(error: BaseException) -> str | None:
    """Return the text of an error if it is an out-of-memory error; otherwise None."""
    words = str(error)
    signs = "RESOURCE_EXHAUSTED", "bad_alloc", "llocate memory", "t start new thread", "failed to map segment"
    is_one = isinstance(error, MemoryError) or any(sign in words for sign in signs)
    return (words or type(error).__name__) if is_one else None
