"""Figures of a benchmark as a machine reads them, and the committed ones, which figures.yaml beside this file holds.

An entry of that file is a case on one machine: its figures with the commit and the versions they were measured with.
"""

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

COMMITTED = Path(__file__).with_name("figures.yaml")
HEAD = "# Written by `python -m benchmarks speed --record`.\n"


class Figure(NamedTuple):
    """One number of a case."""

    name: str
    value: float
    unit: str
    count: int | None = None  # of targets or programs that it took; must not change


@dataclass(frozen=True)
class Entry:
    """A case as it was committed."""

    case: str
    job: str  # the workpiece, and what differs from the whole case
    machine: str
    commit: str
    versions: str
    figures: tuple[Figure, ...]


def save(file: Path | None, figures: Iterable[Figure]) -> None:
    """Write what `load` reads; nothing without a file."""
    if file is not None:
        file.write_text(json.dumps([figure._asdict() for figure in figures]))


def load(file: Path) -> list[Figure]:
    """The figures that a benchmark wrote with --json."""
    return [Figure(**raw) for raw in json.loads(file.read_text())]


def committed(file: Path) -> list[Entry]:
    """The entries of a file; none where it is absent."""
    raw = yaml.safe_load(file.read_text(encoding="utf-8")) if file.is_file() else []
    return [Entry(**{**each, "figures": tuple(Figure(**one) for one in each["figures"])}) for each in raw or []]


def nearest(entries: Iterable[Entry], case: str, job: str, machine: str) -> Entry | None:
    """The entry of a case and job on this machine, else the last one on another."""
    found = [entry for entry in entries if (entry.case, entry.job) == (case, job)]
    return next((entry for entry in found if entry.machine == machine), found[-1] if found else None)


def record(file: Path, new: list[Entry]) -> None:
    """Put entries in place of those of the same case, job and machine: all of them or none."""
    replaced = {(entry.case, entry.job, entry.machine) for entry in new}
    kept = [entry for entry in committed(file) if (entry.case, entry.job, entry.machine) not in replaced]
    aside = file.with_suffix(".part")
    text = yaml.safe_dump([_raw(entry) for entry in kept + new], sort_keys=False, width=120, default_flow_style=None)
    aside.write_text(HEAD + text, encoding="utf-8")
    os.replace(aside, file)


def _raw(entry: Entry) -> dict[str, Any]:
    """An entry in YAML's own types; what is not counted has no count."""
    figures = [{key: value for key, value in one._asdict().items() if value is not None} for one in entry.figures]
    return {**asdict(entry), "figures": figures}
