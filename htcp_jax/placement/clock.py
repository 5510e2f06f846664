"""Time that a search with a time limit has used, without compilation and across interruptions.

A call of the planner that is not finished at the end of the time is ended as by Ctrl-C, by an exception that the
progress raises.

The limit is for the whole command: the time between two calls of the planner counts, too, as that before the first.
The size of each call of the planner depends on the time that earlier calls took. Every call's time is therefore saved
in the search's folder, and a resumed search reads it with the finished plans.
"""

import math
import time
from pathlib import Path
from typing import NamedTuple

from htcp_jax.device import LOADING
from htcp_jax.errors import InputError
from htcp_jax.system import files, output_files

FILE = "seconds.json"
DEARER = 4.0  # assumed time of a proven motion / time of a quick plan, until a first one is planned
FIRST, GROWTH = 8, 4.0  # number of plans in the first call; largest ratio of the numbers in two successive calls
SHARE = 0.05  # share of the time limit that a call of the search should take
ENDED = 0.9  # share of the time limit after which a call is ended; the rest is for files and pictures


class TimeOver(Exception):
    """Raised when the time limit ends a call of the planner."""


class PlanTime(NamedTuple):
    """Time of one call of the planner."""

    plans: int  # 0: the call was ended by the time limit
    seconds: float  # without compilation [s]
    quick: bool  # True for quick plans, False for proven motions
    before: float = 0.0  # time between the call before it, or the beginning of the command, and this one [s]


class Clock:
    """Timer of a search.

    Args:
        folder: The search's folder, in which the times are saved.
        seconds: Time limit of the search [s]; None: no limit, and no time is saved.
        began_s: Value of `time.monotonic` when the command began [s].
    """

    def __init__(self, folder: Path, seconds: float | None, began_s: float):
        self._file, self.seconds, self._last_s = folder / FILE, seconds, began_s
        self._known = {} if seconds is None else _read_times(self._file)
        self._calls: list[PlanTime] = []
        self._end_s, self._loaded_s = math.inf, 0.0

    def begin(self, name: str, stops: bool = True) -> None:
        """Begin a call.

        Args:
            name: The name of the call's folder in the search's folder.
            stops: False if the call may take any time.

        Raises:
            TimeOver: If the time limit ended the call before the search was resumed.
        """
        if (known := self._known.get(name)) is not None and not known.plans:
            raise TimeOver
        is_limited = stops and known is None and self.seconds is not None
        self._end_s = self._last_s + (ENDED - self.used) * self.seconds if is_limited else math.inf
        self._loaded_s = LOADING.seconds

    def check(self) -> None:
        """Raise TimeOver if the time for the current call is over; compilation is not counted."""
        if time.monotonic() - (LOADING.seconds - self._loaded_s) > self._end_s:
            raise TimeOver

    @property
    def used(self) -> float:
        """Used share of the time limit; 0 without a limit."""
        return 0.0 if self.seconds is None else sum(own.before + own.seconds for own in self._calls) / self.seconds

    def add(self, name: str, call: PlanTime, began_s: float) -> None:
        """Add the time of a call that has just ended, or the one that is saved under its name.

        Args:
            name: The name of the call's folder in the search's folder.
            call: The call.
            began_s: Value of `time.monotonic` when it began [s].

        Raises:
            InputError: If the file cannot be written.
        """
        if self.seconds is None:
            return
        before, self._last_s = max(0.0, began_s - self._last_s), time.monotonic()
        if name not in self._known:
            self._known[name] = call._replace(before=before)
            output_files.write_json(self._file, {"calls": {each: own._asdict() for each, own in self._known.items()}})
        self._calls.append(self._known[name])

    def forget(self) -> None:
        """Remove the saved times, which a search with another limit must not read."""
        self._file.unlink(missing_ok=True)

    def fits(self, plans: int, quick: bool, share: float = 1.0) -> bool:
        """Return True if a call is expected to end within a share of the time limit, or if there is no limit.

        Args:
            plans: The number of plans in the call.
            quick: True for quick plans, False for proven motions.
            share: The share.
        """
        return self.seconds is None or self.used + plans * self._seconds_each(quick) / self.seconds <= share

    def plans_together(self) -> int:
        """Return the number of quick plans in the next call of the search."""
        if self.seconds is None or not self._calls:
            return FIRST
        most = int(GROWTH * max(call.plans for call in self._calls))
        return max(1, min(most, int(SHARE * self.seconds / max(self._seconds_each(True), 1e-9))))

    def _seconds_each(self, quick: bool) -> float:
        """Return the time of a plan in the latest call of its kind [s], or an estimate before the first one."""
        alike = [call.seconds / max(call.plans, 1) for call in self._calls if call.quick == quick]
        if alike:
            return alike[-1]
        return 0.0 if quick else DEARER * self._seconds_each(True)


def _read_times(file: Path) -> dict[str, PlanTime]:
    if not file.exists():
        return {}
    try:
        calls = files.read_json(file, file.parent)["calls"].items()
        return {
            name: PlanTime(int(own["plans"]), float(own["seconds"]), bool(own["quick"]), float(own.get("before", 0.0)))
            for name, own in calls
        }
    except (OSError, AttributeError, ValueError, TypeError, LookupError) as error:
        raise InputError(f"{file} is damaged: {files.cause(error, file)}") from None
