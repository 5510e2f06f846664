"""SIGINT and SIGTERM during a sweep: remembered, and heeded where the work can be dropped cleanly."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator


class SignalCame(Exception):
    """Raised where the work can stop."""


@contextlib.contextmanager
def signals() -> Iterator[list[int]]:
    """Hands out the list to which SIGINT and SIGTERM are added when they come. A second one ends the process."""
    came, handlers = [], {}

    def remember(number: int, _) -> None:
        came.append(number)
        # print may be interrupted itself
        os.write(2, b"\nstopping after the step at hand; once more to stop at once\n")
        for each in handlers:
            signal.signal(each, signal.SIG_DFL)

    if threading.current_thread() is threading.main_thread():  # no other may set handlers
        handlers |= {each: signal.signal(each, remember) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield came
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
