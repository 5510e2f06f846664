"""Table of `benchmarks.speed`: figures of this checkout, of another one and committed ones."""

import statistics
from collections.abc import Iterable
from typing import NamedTuple

from benchmarks.figures import Entry, Figure

# Names and widths; the last ratio may be followed by a star.
COLUMNS = {"": 38, "here": 11, "there": 11, "ratio": 5, "of pairs": 12, "committed": 11, "ratio ": 6, "count": 8}
OF_PAIRS = "there", "ratio", "of pairs"


class Measured(NamedTuple):
    """Figures of every run of a case, here and there."""

    here: list[list[Figure]]
    there: list[list[Figure]]  # empty without another checkout, or if it lacks the case


def medians(runs: list[list[Figure]]) -> dict[str, Figure]:
    """Figures by their names, each with the median of its values."""
    return {
        one.name: one._replace(value=statistics.median(values(runs, one.name))) for one in (runs[0] if runs else ())
    }


def values(runs: list[list[Figure]], name: str) -> list[float]:
    """Values of one figure in all runs that have it."""
    return [one.value for run in runs for one in run if one.name == name]


def head(pairs: bool) -> str:
    """Names of the columns, with those of pairs if there are any."""
    return _line({name: name for name in COLUMNS}, pairs)


def rows(found: Measured, old: Entry | None, machine: str, pairs: bool) -> Iterable[str]:
    """Rows of the table, one per figure; a star marks a committed one of another machine."""
    here, there = medians(found.here), medians(found.there)
    committed = {one.name: one for one in old.figures} if old else {}
    star = "*" if old and old.machine != machine else " "
    for name, one in here.items():
        cells = {"": f"  {name}", "here": _spelt(one), "count": "" if one.count is None else f"{one.count:,}"}
        if other := there.get(name):
            ratios = [_ratio(*pair) for pair in zip(values(found.here, name), values(found.there, name), strict=True)]
            cells |= {"there": _spelt(other), "ratio": f"{_ratio(one.value, other.value):.2f}"}
            cells |= {"of pairs": f"{min(ratios):.2f} to {max(ratios):.2f}"}
        if before := committed.get(name):
            cells |= {"committed": _spelt(before), "ratio ": f"{_ratio(one.value, before.value):.2f}{star}"}
        yield _line(cells, pairs)


def counts_differ(case: str, found: Measured) -> list[str]:
    """Counts that differ between runs of the two checkouts."""
    lines = []
    for name in medians(found.here):
        here, there = ({one.count for run in runs for one in run if one.name == name} for runs in found)
        if len(here | there) > 1:
            reported = f"{_counts(here)} here" + (f", {_counts(there)} there" if there else "")
            lines.append(f"{case}, {name}: {reported}")
    return lines


def sources(compared: Iterable[tuple[str, Measured, Entry | None]], machine: str) -> list[str]:
    """Sources of the committed figures, one line each, and the counts that have changed since."""
    lines: dict[str, list[str]] = {}
    counts = []
    for case, found, old in compared:
        if old is None:
            continue
        where = "this machine" if old.machine == machine else f"* {old.machine}"
        lines.setdefault(f"{where}; {old.versions}; commit {old.commit}", []).append(case)
        now = medians(found.here)
        changed = [one for one in old.figures if one.name in now and one.count != now[one.name].count]
        counts += [f"{case}, {one.name}: {now[one.name].count} here, {one.count} committed" for one in changed]
    return [f"committed {', '.join(cases)}: {source}" for source, cases in lines.items()] + counts


def _ratio(now: float, before: float) -> float:
    return now / before if before else float("inf")


def _spelt(one: Figure) -> str:
    return f"{one.value:,.{2 if one.value < 10 else 1}f} {one.unit}"


def _counts(counts: Iterable[int | None]) -> str:
    return " or ".join(sorted(f"{count:,}" if count is not None else "none" for count in counts))


def _line(cells: dict[str, str], pairs: bool) -> str:
    shown = [name for name in COLUMNS if pairs or name not in OF_PAIRS]
    first, *others = (cells.get(name, "") for name in shown)
    widths = [COLUMNS[name] for name in shown[1:]]
    columns = (cell.rjust(width) for cell, width in zip(others, widths, strict=True))
    return "  ".join([first.ljust(COLUMNS[""]), *columns]).rstrip()
