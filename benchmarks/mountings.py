"""Placement search with equal budgets by a grid, random draws, `htcp place` and differential evolution.

    python -m benchmarks mountings [PLACE.yaml ...] [--scenarios 2000 | --seconds S] [--seeds 5] [--out out/mountings]
    python -m benchmarks mountings --jobs DIR    write the searches of mounting_jobs.yaml into a folder
    python -m benchmarks mountings --table CSV...    print the table of finished searches

Every search proposes mountings in the same ranges, and the same quick planner evaluates them, as `htcp place` does: the
file's method `screen`, and larger margins if the objective is clearance. With `--seconds` every search has the same
time, without compilation, which limits the calls of the planner as in `htcp place`; the grid, whose size must be known
before, is omitted. Each search runs with `--seeds` seeds (the grid with one). `--only` and `--first` choose approaches
and the first seed, so that searches can run side by side, each with another `--out`.

The results are the number of evaluated mountings, those that complete the path, those of them that are apart from each
other as the mountings which `htcp place` confirms, the first complete one, and the best objective. Every round is a
sweep in the folder `--out`, so the same command resumes an interrupted run. It writes mountings.csv into this folder,
and prints a table.
"""

import argparse
import csv
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from jaxtyping import Float
from scipy.optimize import OptimizeResult, differential_evolution

from benchmarks import hardware, strangers
from benchmarks.gpu import ROOT
from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import Sweep
from htcp_jax.placement.clock import Clock, PlanTime
from htcp_jax.placement.mounting import UNITS
from htcp_jax.placement.place import SEARCHED, mountings_together, search_rounds
from htcp_jax.placement.place_file import CYCLE_TIME, Search, load_search
from htcp_jax.placement.progress import ProgressReporter
from htcp_jax.placement.scores import MountingPlanner, MountingScores
from htcp_jax.placement.search import SearchResults, best_apart, even, score
from htcp_jax.runs import Run
from htcp_jax.runs.sweep import sweep
from htcp_jax.trajectory import time_run

JOBS = ROOT / "benchmarks/mounting_jobs.yaml"


class Found(NamedTuple):
    """Results of one search with one seed."""

    job: str
    objective: str
    approach: str
    seed: int
    seconds: float  # time of the search without compilation [s]; 0: limited by the number of mountings
    evaluated: int  # number of mountings
    complete: int  # number of complete mountings
    apart: int  # number of complete mountings that are APART from each other
    first: int  # number of mountings until the first complete one; 0: none
    best: float  # best objective of a complete mounting, in its display unit; NaN: none


class Evaluator:
    """Evaluates mountings of a search until its budget is used up, and keeps the results.

    Args:
        search: The search; `file.within.scenarios` is the number of mountings, if there is no time limit.
        folder: The folder of the plans.
        seconds: Time limit without compilation [s]; None: none.
        threads: The number of engines, see `runs.sweep.sweep`.
    """

    def __init__(self, search: Search, folder: Path, seconds: float | None, threads: int | None):
        folder.mkdir(parents=True, exist_ok=True)
        self.search, self.folder, self._threads = search, folder, threads
        self.clock = Clock(folder, None if seconds is None else seconds / SEARCHED, time.monotonic())
        self.planner = MountingPlanner(search, self._plan)
        self.scores: list[MountingScores] = []

    @property
    def is_open(self) -> bool:
        """True if the budget is not used up."""
        return self.clock.used < SEARCHED if self.clock.seconds else self.evaluated < self.budget

    @property
    def budget(self) -> int:
        """Maximum number of mountings, without a time limit."""
        return self.search.file.within.scenarios // max(1, len(self.search.seams))

    @property
    def evaluated(self) -> int:
        """Number of mountings so far."""
        return sum(len(each.values) for each in self.scores)

    def together(self) -> int:
        """Return the number of mountings in the next call of the planner."""
        return mountings_together(self.search, self.clock) if self.clock.seconds else self.budget - self.evaluated

    def __call__(self, u: Float[np.ndarray, "n d"]) -> SearchResults | None:
        """Evaluate mountings in the unit cube; those that exceed the budget are missing in the result; None: all."""
        parts = []
        while len(u) and self.is_open:
            now, u = np.split(u, [self.together()])
            found = self.planner.evaluate_raised(
                self.search.ranges.values(now),
                self.folder / "rounds" / f"{len(self.scores):03d}",
                self.folder / "raised",
                lambda plans: self.clock.fits(plans, quick=True, share=SEARCHED),
            )
            self.scores.append(found)
            parts.append(SearchResults(now, found.done.mean(axis=1), found.complete, found.objective))
        return SearchResults(*map(np.concatenate, zip(*parts, strict=True))) if parts else None

    def _plan(self, grid: Sweep, method: str, into: Path) -> Run:
        began = time.monotonic()
        run = sweep(grid, [method], into, threads=self._threads)
        run = time_run(run, self.search.file.feed, (method,)) if CYCLE_TIME in self.search.file.objective else run
        seconds = time.monotonic() - began - run.manifest.seconds[method].compile_s
        name = into.relative_to(self.folder).as_posix()
        self.clock.add(name, PlanTime(run.manifest.count, max(0.0, seconds), quick=True), began)
        return run


def grid(evaluate: Evaluator, d: int, seed: int) -> None:
    """Evaluate a grid with as many points as the budget allows, at the centres of equal parts.

    The first axes may have one point more than the others.
    """
    counts = np.full(d, int(evaluate.budget ** (1 / d) + 1e-9))
    for k in range(d):
        if np.prod(counts) // counts[k] * (counts[k] + 1) <= evaluate.budget:
            counts[k] += 1
    parts = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts), indexing="ij")
    evaluate(np.stack([part.ravel() for part in parts], axis=1))


def draws(evaluate: Evaluator, d: int, seed: int) -> None:
    """Evaluate uniform, independent random mountings."""
    rng = np.random.default_rng([seed, 2])
    while evaluate.is_open:
        evaluate(rng.random((evaluate.together(), d)))


def search(evaluate: Evaluator, d: int, seed: int) -> None:
    """Search as `htcp place` does, by its own function: first evenly over the ranges, then near the best mountings."""
    report = ProgressReporter(evaluate.search, None, 0)
    for found in search_rounds(evaluate.planner, evaluate.clock, evaluate.folder / "rounds", report):
        evaluate.scores.append(found)


def differential(evaluate: Evaluator, d: int, seed: int) -> None:
    """Search by SciPy's differential evolution with default settings and the same score, by generations."""
    parents = 15 * d  # SciPy's default
    if not evaluate.clock.seconds:
        parents = max(5, min(parents, evaluate.budget // 4))

    def energies(u: Float[np.ndarray, "d n"]) -> Float[np.ndarray, "n"]:
        costs, found = np.full(u.shape[1], np.inf), evaluate(u.T)
        if found is not None:
            costs[: len(found.u)] = fixed_score(found)
        return costs

    def is_over(intermediate_result: OptimizeResult) -> bool:
        return not evaluate.is_open

    first = even(d, 0, parents, seed)
    generations = 10**6 if evaluate.clock.seconds else evaluate.budget // parents - 1
    differential_evolution(energies, [(0, 1)] * d, init=first, maxiter=generations, seed=seed, tol=0, atol=-1,
                           polish=False, updating="deferred", vectorized=True, callback=is_over)  # fmt: skip


def fixed_score(known: SearchResults) -> Float[np.ndarray, "n"]:
    """Return scores that rank as `search.score` does, but do not depend on the other mountings in the generation."""
    value = np.maximum(np.where(known.complete, known.objective[:, 0], 0.0), -1e12)  # -inf: not computed
    return np.where(known.complete, -2.0 - value / (1.0 + np.abs(value)), 1.0 - known.done)


APPROACHES: dict[str, Callable[[Evaluator, int, int], None]] = {
    "grid": grid,
    "random draws": draws,
    "htcp place": search,
    "differential evolution": differential,
}


def run(requested: Search, approach: str, seed: int, folder: Path, seconds: float | None, threads: int | None) -> Found:
    """Run one search with one seed."""
    requested = requested._replace(file=requested.file.model_copy(update={"seed": seed}))
    evaluate = Evaluator(requested, folder, seconds, threads)
    APPROACHES[approach](evaluate, len(requested.ranges.axes), seed)
    complete, values, objective = (
        np.concatenate([getattr(each, name) for each in evaluate.scores])
        for name in ("complete", "values", "objective")
    )
    u = (values - requested.ranges.low) / requested.ranges.width
    known = SearchResults(u, complete.astype(float), complete, objective)
    order = np.argsort(score(known, np.ones(1)), kind="stable")[: complete.sum()]
    name = requested.file.objective[0]
    best = UNITS[name][1] * objective[order[0], 0] if len(order) else np.nan
    first = int(complete.argmax()) + 1 if len(order) else 0
    used = 0.0 if seconds is None else evaluate.clock.used / SEARCHED * seconds
    apart = len(best_apart(u, order, len(order))) if len(order) else 0
    counts = len(complete), len(order), apart, first
    return Found(requested.name, name, approach, seed, round(used, 1), *counts, round(float(best), 3))


def results(chosen: argparse.Namespace) -> Iterator[Found]:
    """Run every search with every seed."""
    within = {"scenarios": chosen.scenarios} if chosen.seconds is None else {"seconds": chosen.seconds}
    for file in chosen.file:
        requested = load_search(file, changes={"within": within})
        for approach in chosen.only or [name for name in APPROACHES if name != "grid" or chosen.seconds is None]:
            for seed in range(chosen.first, chosen.first + (1 if approach == "grid" else chosen.seeds)):
                (limit,) = within.values()
                folder = chosen.out / requested.name / approach.replace(" ", "-") / f"{limit:g}-{seed}"
                yield run(requested, approach, seed, folder, chosen.seconds, chosen.threads)


def write_jobs(folder: Path) -> None:
    """Write the searches of mounting_jobs.yaml, with the strangers' parts and imported arms, into a folder."""
    known = yaml.safe_load(JOBS.read_text(encoding="utf-8"))
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    listed = yaml.safe_load(strangers.JOBS.read_text(encoding="utf-8"))
    for name, entry in known.items():
        place: dict[str, Any] = dict(entry["place"])
        if "stranger" in entry:
            own = folder / entry["stranger"]
            own.mkdir(parents=True, exist_ok=True)
            job = listed["jobs"][entry["stranger"]]
            strangers.write_job(own, job, listed["tools"])
            code, _, _, message = strangers.run(strangers.arm_arguments(job, folder / "packages"), own)
            if code:
                raise SystemExit(f"{name}: {message}")
            place["config"] = f"{entry['stranger']}/job.yaml"
        if "job" in entry:
            (folder / f"{name}-job.yaml").write_text(yaml.safe_dump(entry["job"], sort_keys=False), encoding="utf-8")
            place["config"] = f"{name}-job.yaml"
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(place, sort_keys=False), encoding="utf-8")
        print(folder / f"{name}.yaml", flush=True)


def main() -> None:
    """Run every search, write its results, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="*", default=[Path("configs/place/duct.yaml")], metavar="PLACE.yaml")
    limit = parser.add_mutually_exclusive_group()
    limit.add_argument(
        "--scenarios", type=int, default=2000, help="Scenarios that each approach may evaluate with each seed."
    )
    limit.add_argument("--seconds", type=float, help="Time of each approach with each seed, without compilation.")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, help="The first seed.")
    parser.add_argument("--only", type=lambda text: text.split(","), help="Approaches, separated by commas.")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, default=Path("out/mountings"))
    parser.add_argument("--jobs", type=Path, metavar="DIR", help="Write the searches of mounting_jobs.yaml.")
    parser.add_argument("--table", type=Path, nargs="+", metavar="CSV", help="Print the table of these files.")
    chosen = parser.parse_args()
    if chosen.jobs:
        write_jobs(chosen.jobs)
        return
    if chosen.table:
        print_table([each for file in chosen.table for each in read(file)])
        return
    cache_folder.enable()
    print(hardware.line())
    found = []
    for each in results(chosen):
        found.append(each)
        print(f"{each.job}, {each.approach}, seed {each.seed}: {each.complete:,} of {each.evaluated:,} complete, best "
              f"{each.best} {UNITS[each.objective][0]}", flush=True)  # fmt: skip
    with (chosen.out / "mountings.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(Found._fields)
        rows.writerows(found)
    print_table(found)


def read(file: Path) -> list[Found]:
    """Return the rows of a mountings.csv."""
    with file.open(newline="") as stream:
        kinds = Found.__annotations__
        return [Found(**{key: kinds[key](text) for key, text in row.items()}) for row in csv.DictReader(stream)]


def print_table(found: list[Found]) -> None:
    """Print a row for each job and approach, with numbers by seed."""
    print("\n| job | | evaluated | complete, by seed | of them apart | first complete | best objective |")
    print("|---|---|---|---|---|---|---|")
    for job in dict.fromkeys(each.job for each in found):
        for approach in APPROACHES:
            own = sorted((each for each in found if (each.job, each.approach) == (job, approach)), key=lambda e: e.seed)
            if own:
                unit = UNITS[own[0].objective][0]
                evaluated, complete, apart, first = (
                    ", ".join(f"{getattr(each, name):,}" for each in own)
                    for name in ("evaluated", "complete", "apart", "first")
                )
                best = ", ".join(f"{each.best:.2f}" for each in own)
                print(f"| {job} | {approach} | {evaluated} | {complete} | {apart} | {first} | {best} {unit} |")


if __name__ == "__main__":
    main()
