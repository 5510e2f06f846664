"""Placement search with equal budgets by a grid, random draws, `htcp place` and differential evolution.

    python -m benchmarks mountings [PLACE.yaml] [--scenarios 2000] [--seeds 5] [--threads N] [--out out/mountings]

Every search proposes mountings in the same ranges, and the same quick planner evaluates them. Each search runs with
`--seeds` seeds (the grid with one). The results are the number of mountings that complete the path, and the best
clearance at their targets. Every round is a sweep in the folder `--out`, so the same command resumes an interrupted
run. It writes mountings.csv into this folder, and prints a table.
"""

import argparse
import csv
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import differential_evolution

from benchmarks import hardware
from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import Sweep
from htcp_jax.placement.place_file import Search, load_search
from htcp_jax.placement.scores import MountingPlanner
from htcp_jax.placement.search import EVEN, FROM, POPULATION, Evolution, SearchResults, even
from htcp_jax.runs import Run
from htcp_jax.runs.sweep import sweep

Evaluate = Callable[[Float[np.ndarray, "n d"]], SearchResults]  # evaluates mountings in the unit cube
Approach = Callable[[Evaluate, int, int, int], None]  # with the number of dimensions, budget and seed


class Found(NamedTuple):
    """Results of one search with one seed."""

    approach: str
    seed: int
    best_m: Float[np.ndarray, "n"]  # minimum clearance of the best mounting so far, after each mounting; NaN: none yet
    complete: Float[np.ndarray, "n"]  # number of complete mountings so far


def grid(scores: Evaluate, d: int, budget: int, seed: int) -> None:
    """Evaluate a grid with as many points as the budget allows, at the centres of equal parts.

    The first axes may have one point more than the others.
    """
    counts = np.full(d, int(budget ** (1 / d) + 1e-9))
    for k in range(d):
        if np.prod(counts) // counts[k] * (counts[k] + 1) <= budget:
            counts[k] += 1
    parts = np.meshgrid(*((np.arange(n) + 0.5) / n for n in counts), indexing="ij")
    scores(np.stack([part.ravel() for part in parts], axis=1))


def draws(scores: Evaluate, d: int, budget: int, seed: int) -> None:
    """Evaluate uniform, independent random mountings."""
    scores(np.random.default_rng([seed, 2]).random((budget, d)))


def search(scores: Evaluate, d: int, budget: int, seed: int) -> None:
    """Search as `htcp place` does: first evenly over the ranges, then near the best mountings."""
    rounds = int((1 - EVEN) * budget) // (FROM * POPULATION)
    evolution = Evolution(scores(even(d, 0, budget - rounds * FROM * POPULATION, seed)), 1, seed)
    for _ in range(rounds):
        evolution.tell(scores(evolution.ask()))


def differential(scores: Evaluate, d: int, budget: int, seed: int) -> None:
    """Search by SciPy's differential evolution with default settings and the same score, by generations."""
    parents = max(5, min(15 * d, budget // 4))
    known: list[SearchResults] = []

    def energies(u: Float[np.ndarray, "d n"]) -> Float[np.ndarray, "n"]:
        known.append(scores(u.T))
        return _fixed_score(known[-1])

    first = even(d, 0, parents, seed)
    generations = budget // parents - 1
    differential_evolution(energies, [(0, 1)] * d, init=first, maxiter=generations, seed=seed, tol=0, polish=False,
                           updating="deferred", vectorized=True)  # fmt: skip


def _fixed_score(known: SearchResults) -> Float[np.ndarray, "n"]:
    """Return scores that rank as `search.score` does, but do not depend on the other mountings in the generation."""
    return np.where(known.complete, -1.0 - known.objective[:, 0], 1.0 - known.done)


APPROACHES: dict[str, Approach] = {
    "grid": grid,
    "random draws": draws,
    "htcp place": search,
    "differential evolution": differential,
}


def run(requested: Search, approach: str, seed: int, budget: int, folder: Path, threads: int | None) -> Found:
    """Run one search with one seed."""
    rounds: list[SearchResults] = []

    def plan(spec: Sweep, method: str, into: Path) -> Run:
        return sweep(spec, [method], into, threads=threads)

    def scores(u: Float[np.ndarray, "n d"]) -> SearchResults:
        u = u[: budget - sum(len(each.u) for each in rounds)]
        planner = MountingPlanner(requested, plan)
        one = planner.evaluate_raised(requested.ranges.values(u), folder / f"{len(rounds):03d}", folder / "raised")
        rounds.append(SearchResults(u, one.done.mean(axis=1), one.complete, one.objective))
        return rounds[-1]

    APPROACHES[approach](scores, len(requested.ranges.axes), budget, seed)
    objective = np.concatenate([each.objective[:, 0] for each in rounds])
    best = np.maximum.accumulate(objective)
    complete = np.cumsum(np.concatenate([each.complete for each in rounds]))
    return Found(approach, seed, np.where(np.isfinite(best), best, np.nan), complete)


def results(requested: Search, seeds: int, budget: int, out: Path, threads: int | None) -> Iterator[Found]:
    """Run every search with every seed."""
    for approach in APPROACHES:
        one = partial(run, requested, approach, budget=budget, threads=threads)
        for seed in range(1 if approach == "grid" else seeds):
            yield one(seed=seed, folder=out / approach.replace(" ", "-") / f"{budget}-{seed}")


def main() -> None:
    """Run every search, write its results, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", default=Path("configs/place/duct.yaml"), metavar="PLACE.yaml")
    parser.add_argument(
        "--scenarios", type=int, default=2000, help="Mountings that each approach may evaluate with each seed."
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, default=Path("out/mountings"))
    requested = parser.parse_args()
    cache_folder.enable()
    print(hardware.line())
    found = []
    spec = load_search(requested.file, changes={"objective": "clearance"})
    for each in results(spec, requested.seeds, requested.scenarios, requested.out, requested.threads):
        found.append(each)
        print(f"{each.approach}, seed {each.seed}: {each.complete[-1]:,} of {len(each.complete):,} complete, best "
              f"{1e3 * each.best_m[-1]:.2f} mm", flush=True)  # fmt: skip
    with (requested.out / "mountings.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["approach", "seed", "evaluated", "complete", "best_mm"])
        rows.writerows(
            [e.approach, e.seed, len(e.complete), e.complete[-1], f"{1e3 * e.best_m[-1]:.3f}"] for e in found
        )
    print("\n| | complete, by seed | best clearance, by seed [mm] |\n|---|---|---|")
    for approach in APPROACHES:
        own = [each for each in found if each.approach == approach]
        counts, best = (", ".join(words) for words in zip(
            *((f"{each.complete[-1]:,}", f"{1e3 * each.best_m[-1]:.1f}") for each in own), strict=True))  # fmt: skip
        print(f"| {approach} | {counts} | {best} |")


if __name__ == "__main__":
    main()
