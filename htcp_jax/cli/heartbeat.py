"""Lines that show that a command is at work while it has nothing else to show.

Between two progress bars, before the first and after the last one, a command loads modules, reads files, or draws
pictures. If this takes longer than the time between two lines of progress, a line with the elapsed time is printed.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import timedelta

LINE_S = 10.0  # maximum time between two lines of progress [s]


class Heartbeat:
    """Time of the last line of progress, and whether a progress bar is shown."""

    def __init__(self):
        self.began_s = self._last_s = time.monotonic()  # `began_s`: when the current command began
        self._bars, self._ended = list[Callable[[], bool]](), threading.Event()

    def wait_s(self, line_s: float) -> float:
        """Return the time until the next line is due [s].

        Args:
            line_s: Maximum time between two lines [s].
        """
        return max(0.0, self._last_s + line_s - time.monotonic())

    def print(self, line: str) -> None:
        """Print a line of progress to stderr, unless stderr is closed."""
        with contextlib.suppress(OSError, ValueError):
            print(f"htcp: {line}", file=sys.stderr, flush=True)
        self._last_s = time.monotonic()

    @contextlib.contextmanager
    def bar(self, is_shown: Callable[[], bool]) -> Iterator[None]:
        """While the context is open and the function returns True, a progress bar shows what is done."""
        self._bars.append(is_shown)
        try:
            yield
        finally:
            self._bars.remove(is_shown)

    @contextlib.contextmanager
    def command(self, name: str) -> Iterator[None]:
        """Print a line with the command's name and the elapsed time whenever there was none for LINE_S, and no bar.

        Args:
            name: Name of the command.
        """
        self.began_s = self._last_s = began = time.monotonic()
        self._ended = ended = threading.Event()

        def beat() -> None:
            while not ended.wait(max(0.05, self.wait_s(LINE_S))):
                if self.wait_s(LINE_S):
                    continue
                if any(is_shown() for is_shown in self._bars):
                    self._last_s = time.monotonic()
                else:
                    self.print(f"{name}: at work {timedelta(seconds=int(time.monotonic() - began))}")

        threading.Thread(target=beat, daemon=True).start()
        try:
            yield
        finally:
            ended.set()

    def end(self) -> None:
        """End the lines of the current command, which waits from now on."""
        self._ended.set()


HEARTBEAT = Heartbeat()  # of this process
