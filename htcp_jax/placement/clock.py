"""Elapsed time of a search with a time limit, across interruptions.

Each round depends on the time elapsed before it. The time at the end of every round is therefore saved in the search's
folder, and a resumed search reads it with the finished rounds.
"""

import time
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.system import files, output_files

FILE = "seconds.json"


class Clock:
    """Timer of a search.

    Args:
        folder: The folder in which the elapsed time is saved.
        seconds: Time limit of the search [s]; None: no limit, and no time is saved.
    """

    def __init__(self, folder: Path, seconds: float | None):
        self._file, self._seconds, self._last = folder / FILE, seconds, time.monotonic()
        self._ends = [] if seconds is None else _read_times(self._file)

    def used(self, rounds: int) -> float:
        """Return the share of the time limit that is used after `rounds` rounds."""
        return 0.0 if self._seconds is None or not rounds else self._ends[rounds - 1] / self._seconds

    def finished(self, rounds: int) -> None:
        """Save the elapsed time at the end of round number `rounds`.

        Raises:
            InputError: If the file cannot be written.
        """
        now = time.monotonic()
        if self._seconds is not None and rounds > len(self._ends):
            self._ends.append(sum(self._ends[-1:]) + now - self._last)
            output_files.write_json(self._file, {"ends_s": self._ends})
        self._last = now


def _read_times(file: Path) -> list[float]:
    if not file.exists():
        return []
    try:
        return [float(end) for end in files.read_json(file, file.parent)["ends_s"]]
    except (OSError, ValueError, TypeError, LookupError) as error:
        raise InputError(f"{file} is damaged: {files.cause(error, file)}") from None
