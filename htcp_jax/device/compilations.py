"""Count of the programs that this process compiles, for messages about what a command waits for.

The module does not import JAX, so that a command can show the count from its start.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

USUAL_S = 10.0  # time that a program takes on two cores while another one is compiled [s]


class Compilations:
    """Programs that are requested, being compiled and compiled; those that are loaded from the cache do not count."""

    def __init__(self):
        self._lock = threading.Lock()
        self._requested, self._begun, self._seconds = 0, dict[object, float](), list[float]()
        self._is_growing = False

    @contextmanager
    def requested(self, count: int) -> Iterator[Callable[[], None]]:
        """Count programs as requested while the context is open; its value is called when the next one is begun."""
        left = count

        def begin() -> None:
            nonlocal left
            with self._lock:
                left, self._requested = left - 1, self._requested - 1

        with self._lock:
            self._requested += count
        try:
            yield begin
        finally:
            with self._lock:
                self._requested -= left

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Count a program as being compiled while the context is open."""
        number, began = object(), time.monotonic()
        with self._lock:
            self._begun[number] = began
        try:
            yield
        finally:
            with self._lock:
                del self._begun[number]
                self._seconds.append(time.monotonic() - began)

    @contextmanager
    def growing(self) -> Iterator[None]:
        """While the context is open, more programs will be requested, so that `text` has no time."""
        self._is_growing = True
        try:
            yield
        finally:
            self._is_growing = False

    @property
    def done(self) -> int:
        """Number of programs compiled so far."""
        with self._lock:
            return len(self._seconds)

    @property
    def text(self) -> str:
        """Text such as "compiling 3 of 7 programs, about 40 s"; "" if no program is being compiled.

        The time is an estimate: every program takes the mean time of those before and of a first one of USUAL_S. One
        that has already taken two thirds of it or more takes half as long again as it has taken.
        """
        with self._lock:
            begun, done, requested = list(self._begun.values()), list(self._seconds), self._requested
        if not begun:
            return ""
        least = "at least " if self._is_growing else ""
        text = f"compiling {len(done) + 1} of {least}{len(done) + len(begun) + requested} programs"
        if self._is_growing:
            return text
        each, now = (USUAL_S + sum(done)) / (1 + len(done)), time.monotonic()
        left = requested * each + sum(max(each - (now - began), (now - began) / 2) for began in begun)
        return f"{text}, about {max(1, round(left / len(begun)))} s"


COMPILATIONS = Compilations()  # those of this process
