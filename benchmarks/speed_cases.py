"""Cases of `benchmarks.speed`, and their execution in a checkout.

A case is a function of a checkout and of the options: it starts new processes there and returns their figures.
"""

import json
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.figures import Figure, load

SIX = "baseline,cspace-sample,nspace-sample,nspace-sqp,nspace-ip,nspace-cmaes"
FEW = "baseline,nspace-sqp"
EVERY, EVERY_CROSS, LIMIT = 25, 250, 5  # of a quick case: every N-th scenario, number of scenarios
PEERS = {"mink": "mink", "tesseract_robotics": "tesseract-robotics"}  # modules and packages
DEVICE_QP = "--set", "settings.qp=device"
ON_CPU = {"JAX_PLATFORMS": "cpu"}
TEXT = {  # rows that a benchmark prints
    "tables": re.compile(r"^(\S+) +(\S+) +([\d,]+) of [\d,]+ +[\d.]+ +[\d.]+ +([\d.]+) +\d+$", re.M),
    "clearance": re.compile(r"^ *([\d,]+) +([\d.]+) us +([\d.]+) us +([\d.]+) us +\d+ us +\d+$", re.M),
}


class Broken(Exception):
    """Failure of a process; the message is its last line."""


class Requested(NamedTuple):
    """Options of the command line for every case."""

    quick: bool = False
    methods: str | None = None  # of tables and the cross sweep
    warm: bool = False  # the second run of every method in its process, in place of the first one


@dataclass(frozen=True)
class Checkout:
    """Tree of the project, and the workpiece of its jobs."""

    name: str
    root: Path
    part: dict[str, Any]  # the section `workpiece` of a job; empty for the generated duct
    changes: tuple[str, ...] = ()  # KEY=VALUE

    @property
    def overrides(self) -> list[str]:
        """Changes of every job in this checkout, KEY=VALUE each."""
        return [*(f"workpiece.{key}={json.dumps(value)}" for key, value in self.part.items()), *self.changes]

    @property
    def sets(self) -> list[str]:
        """Changes of every job as options of the command line."""
        return [word for pair in self.overrides for word in ("--set", pair)]

    def python(self, *words: str, one_core: bool = False, expected: Iterable[int] = (0,), **environment: str) -> str:
        """Run a new interpreter that imports from this tree only, and return its output.

        Raises:
            Broken: For an unexpected exit code.
        """
        known = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
        pin = _pin if one_core and hasattr(os, "sched_setaffinity") else None
        done = subprocess.run(
            [sys.executable, *words],
            cwd=self.root,
            env=known | {"PYTHONPATH": str(self.root)} | environment,
            preexec_fn=pin,
            capture_output=True,
            text=True,
        )
        if done.returncode not in expected:
            raise Broken((done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1])
        return done.stdout

    def benchmark(self, name: str, *words: str, **how: Any) -> list[Figure]:
        """Run a benchmark of this tree, and return its figures, from JSON or else from the printed table."""
        begin = "-m", "benchmarks", name
        if "--json" not in (self.root / f"benchmarks/{name}.py").read_text(encoding="utf-8"):
            return of_text(name, self.python(*begin, *words, **how))
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "figures.json"
            self.python(*begin, *words, "--json", str(file), **how)
            return load(file)

    def htcp(self, *words: str, **how: Any) -> str:
        """Run this tree's command `htcp`, and return its output."""
        scripts = tomllib.loads((self.root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
        module, _, function = scripts["htcp"].partition(":")
        return self.python("-c", f"import sys; from {module} import {function}; sys.exit({function}())", *words, **how)


Run = Callable[[Checkout, Requested], list[Figure]]


def _pin() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def of_text(name: str, text: str) -> list[Figure]:
    """Parse the figures in a printed table.

    Raises:
        Broken: If there are none.
    """
    if name not in TEXT or not (rows := TEXT[name].findall(text)):
        raise Broken(f"`python -m benchmarks {name}` of this checkout has no figures that can be read")
    if name == "tables":
        return [Figure(f"{row[0]} {row[1]}", float(row[3]), "s", int(row[2].replace(",", ""))) for row in rows]
    names = "gradient", "alone", "path of 20"
    return [
        Figure(f"{size} points, {name}", float(us), "us")
        for size, *times in rows
        for name, us in zip(names, times, strict=True)
    ]


def tables(*more: str, methods: str = SIX, quick: int = EVERY) -> Run:
    """Case of `benchmarks.tables`: time and tracked targets by method, and the total time."""

    def run(checkout: Checkout, requested: Requested) -> list[Figure]:
        chosen = requested.methods or (FEW if requested.quick else methods)
        how_often = [] if requested.warm else ["--once"]
        every = ["--every", str(quick)] if requested.quick else []
        words = "--methods", chosen, *how_often, *every, *more, *checkout.sets
        found = checkout.benchmark("tables", *words, **ON_CPU)
        return [*found, Figure("in all", sum(one.value for one in found), "s")]

    return run


def cross(*more: str) -> Run:
    """Case of the cross sweep."""
    return tables("--sweeps", "cross", *more, methods=FEW, quick=EVERY_CROSS)


def clearance(checkout: Checkout, requested: Requested) -> list[Figure]:
    """Measure a clearance query on one core."""
    return checkout.benchmark("clearance", *checkout.sets, one_core=True, **ON_CPU)


def first_plan(checkout: Checkout, requested: Requested) -> list[Figure]:
    """Measure a first `htcp plan` by N-space SQP and by the default method: compilation, and the complete command."""
    found = []
    for method in (["--method", "nspace-sqp"], []):
        with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as out:
            words = "plan", "--json", "--out", f"{out}/plan", *method, *checkout.sets
            began = _clocks()
            record = json.loads(checkout.htcp(*words, expected=(0, 3), HTCP_CACHE=cache, **ON_CPU))
            whole, cpu = (now - then for now, then in zip(_clocks(), began, strict=True))
        name = record["method"] if method else f"by default, {record['method']}"
        found += [Figure(f"{name}: compiling", record["compile_s"], "s", record["tracked"])]
        found += [Figure(f"{name}: the command", whole, "s"), Figure(f"{name}: its CPU time", cpu, "s")]
    return found


def _clocks() -> tuple[float, float]:
    """Time of the clock, and CPU time of all child processes that have ended [s]."""
    spent = os.times()
    return time.perf_counter(), spent.children_user + spent.children_system


def programs(checkout: Checkout, requested: Requested) -> list[Figure]:
    """Measure the CPU time of a program, the median over the starts that N-space SQP completes."""
    if not (checkout.root / "benchmarks/programs.py").is_file():
        raise Broken("this checkout writes no programs")
    limit = ["--limit", str(LIMIT)] if requested.quick else []
    with tempfile.TemporaryDirectory() as folder:
        words = "sweeps/robot.yaml", "--methods", "nspace-sqp", "--out", f"{folder}/robot", *limit, *checkout.sets
        checkout.htcp("sweep", *words, **ON_CPU)
        return checkout.benchmark("programs", f"{folder}/robot", "--checked", "0", **ON_CPU)


def peers(checkout: Checkout, requested: Requested) -> list[Figure]:
    """Compare other planners with two of ours, by targets that MuJoCo confirms."""
    part = [checkout.part.get(key) for key in ("cloud", "path", "inlet_m")]
    real = ["--real", *part[:2], *map(str, part[2])] if all(part) else []
    scenarios = ["--scenarios", "1"] if requested.quick else []
    return checkout.benchmark("peers", *scenarios, *real, **ON_CPU)


def lacking() -> list[str]:
    """Packages of the peers that are not installed."""
    return [package for module, package in PEERS.items() if find_spec(module) is None]


class Case(NamedTuple):
    """Case, as named by `--only`."""

    about: str
    run: Run


CASES = {
    "tables": Case("both tables, Clarabel, with joint paths and proofs", tables()),
    "tables-engines": Case("both tables, Clarabel, engines alone", tables("--no-paths")),
    "tables-device": Case("both tables, qp: device, with joint paths and proofs", tables(*DEVICE_QP)),
    "tables-device-engines": Case("both tables, qp: device, engines alone", tables(*DEVICE_QP, "--no-paths")),
    "cross": Case("125 starts x 49 poses, Clarabel, with joint paths and proofs", cross()),
    "cross-engines": Case("125 starts x 49 poses, Clarabel, engines alone", cross("--no-paths")),
    "clearance": Case("one exact query, one core", clearance),
    "plan": Case("a first htcp plan, nothing compiled before", first_plan),
    "programs": Case("CPU time of a program, and of its configurations", programs),
    "peers": Case("other planners on nine poses, CPU time a step", peers),
}
