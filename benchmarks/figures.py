"""Machine-readable figures of a benchmark, and committed figures in figures.yaml.

An entry of figures.yaml contains the figures of a case on one machine, with the measured commit and versions.
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
    """Number measured by a benchmark case."""

    name: str
    value: float
    unit: str
    count: int | None = None  # number of targets or programs, which must not change


@dataclass(frozen=True)
class Entry:
    """Committed figures of a benchmark case on one machine."""

    case: str
    job: str  # workpiece, and differences from the complete case
    machine: str
    commit: str
    versions: str
    figures: tuple[Figure, ...]


def save(file: Path | None, figures: Iterable[Figure]) -> None:
    """Write figures to a JSON file, which `load` reads; None: nothing is written."""
    if file is not None:
        file.write_text(json.dumps([figure._asdict() for figure in figures]))


def load(file: Path) -> list[Figure]:
    """Return the figures in a file that a benchmark wrote with --json."""
    return [Figure(**raw) for raw in json.loads(file.read_text())]


def committed(file: Path) -> list[Entry]:
    """Return the entries in a file; none if the file does not exist."""
    raw = yaml.safe_load(file.read_text(encoding="utf-8")) if file.is_file() else []
    return [Entry(**{**each, "figures": tuple(Figure(**one) for one in each["figures"])}) for each in raw or []]


def nearest(entries: Iterable[Entry], case: str, job: str, machine: str) -> Entry | None:
    """Return the entry of a case and job on this machine, else the last one on another machine; None without one."""
    found = [entry for entry in entries if (entry.case, entry.job) == (case, job)]
    return next((entry for entry in found if entry.machine == machine), found[-1] if found else None)


def record(file: Path, new: list[Entry]) -> None:
    """Write new entries into a file, atomically; each replaces the entry of the same case, job and machine."""
    replaced = {(entry.case, entry.job, entry.machine) for entry in new}
    kept = [entry for entry in committed(file) if (entry.case, entry.job, entry.machine) not in replaced]
    aside = file.with_suffix(".part")
    text = yaml.safe_dump([_raw(entry) for entry in kept + new], sort_keys=False, width=120, default_flow_style=None)
    aside.write_text(HEAD + text, encoding="utf-8")
    os.replace(aside, file)


def _raw(entry: Entry) -> dict[str, Any]:
    """Convert an entry to plain types for YAML; a count of None is omitted."""
    figures = [{key: value for key, value in one._asdict().items() if value is not None} for one in entry.figures]
    return {**asdict(entry), "figures": figures}
