"""Ledger of the elements and attributes that a reader met in a model file and did not use."""

import warnings
from collections import Counter
from pathlib import Path

MOST_NAMED, MOST_OWNERS, LONGEST = 8, 4, 60  # bounds of the warning: kinds of elements, names for each, characters


class Ledger:
    """Counter of the elements and attributes that a reader did not use.

    Those that change neither geometry nor kinematics nor limits are only counted; the others are named in one line.
    """

    def __init__(self):
        self._counts: Counter[str] = Counter()
        self._named: dict[str, list[str]] = {}

    def count(self, what: str) -> None:
        """Count a harmless element or attribute."""
        self._counts[short(what)] += 1

    def name(self, what: str, owner: str = "") -> None:
        """Count an element or attribute that is named, with the link, joint or section that contains it."""
        self._counts[what] += 1
        self._named.setdefault(what, []).append(owner)

    def warn(self, path: Path, category: type[Warning] = UserWarning, stacklevel: int = 5) -> None:
        """Name all that is not harmless in one warning, if there is any."""
        if self._named:
            shown = [f"{what}{_owners(names)}" for what, names in list(self._named.items())[:MOST_NAMED]]
            rest = f", and {len(self._named) - MOST_NAMED} more" if len(self._named) > MOST_NAMED else ""
            warnings.warn(f"{path}: not used: {', '.join(shown)}{rest}", category, stacklevel=stacklevel)

    def lines(self) -> list[str]:
        """Return all elements and attributes with their numbers, most frequent first: "<visual> 12"."""
        return [f"{what} {count}" for what, count in self._counts.most_common()]


def _owners(names: list[str]) -> str:
    named = [*filter(None, names)]
    return f" of {', '.join([*named[:MOST_OWNERS], *(['...'] if len(named) > MOST_OWNERS else [])])}" if named else ""


def short(text: str) -> str:
    """Return a text from a file, cut to a length that fits into a message."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
