"""Order of seams: cost, gap to the proven bound and time, on generated jobs whose seed is fixed.

    python -m benchmarks order                    40 seams with precedence, ten seeds; 300 points, one seed
    python -m benchmarks order --tenfold 10       the same, and ten seeds with ten times the effort: takes an hour
    python -m benchmarks order --only points --groups 500 --effort 60

A job has seams in a box. A seam has nodes: branches of the arm, and both directions; a point has branches alone. A
configuration is a smooth function of the position, moved by an offset for its branch, and a move takes as long as the
slowest joint. Half as many pairs of seams as there are seams have to be in the order of a random permutation. A row per
order states its cost, that of its air moves alone, and the gap to the proven bound. On a machine that others use, trust
the processor time.
"""

import argparse
import time
from typing import NamedTuple

import numpy as np

from benchmarks import hardware
from htcp_jax.sequencing import Order, shortest_order

SPEED_RAD_S = np.array([2.5, 2.0, 3.0, 5.0, 5.0, 7.0])
FEED_M_S = 0.05


class Job(NamedTuple):
    """Arguments of `shortest_order`; n nodes."""

    group: np.ndarray  # (n,)
    own_cost: np.ndarray  # (n,) [s]
    move_cost: np.ndarray  # (n, n) [s]
    begin_cost: np.ndarray  # (n,) [s]
    end_cost: np.ndarray  # (n,) [s]
    before: list[tuple[int, int]]


def job(groups: int, nodes: int, are_points: bool, pairs: int, seed: int) -> Job:
    """Return a job with `nodes` nodes for each of its groups; an even number if these are seams."""
    rng = np.random.default_rng(seed)
    begin = rng.uniform(-1, 1, (groups, 3))
    end = begin if are_points else begin + rng.normal(0, 0.15, (groups, 3))
    branches = nodes if are_points else nodes // 2
    mixing, phase = rng.normal(0, 1, (2, 3, 6)), rng.uniform(0, 2 * np.pi, 6)
    offset = rng.uniform(-1.5, 1.5, (branches, 6))

    def configurations(at: np.ndarray) -> np.ndarray:
        smooth = at @ mixing[0] + 0.5 * np.sin(2 * at @ mixing[1] + phase)
        return (smooth[:, None] + offset * (1 + 0.3 * at[:, None, :1])).reshape(groups, branches, 6)

    first, last = configurations(begin), configurations(end)
    if not are_points:
        first, last = np.concatenate([first, last], axis=1), np.concatenate([last, first], axis=1)
    first, last = first.reshape(-1, 6), last.reshape(-1, 6)
    own = np.repeat(np.linalg.norm(end - begin, axis=1) / FEED_M_S, nodes)
    move = np.abs(last[:, None] - first) / SPEED_RAD_S
    rank = rng.permutation(groups)
    chosen = rng.integers(groups, size=(pairs, 2))
    before = [(int(a), int(b)) if rank[a] < rank[b] else (int(b), int(a)) for a, b in chosen if a != b]
    home = [(np.abs(each) / SPEED_RAD_S).max(axis=1) for each in (first, last)]
    return Job(np.repeat(np.arange(groups), nodes), own, move.max(axis=2), *home, before)


def solve(case: Job, seed: int, effort: float) -> tuple[Order, float, float]:
    """Return the order of a job, and the wall time and the processor time that it took [s]."""
    start, used = time.perf_counter(), time.process_time()
    order = shortest_order(*case, seed=seed, effort=effort)
    return order, time.perf_counter() - start, time.process_time() - used


def main() -> None:
    """Print a row for each order, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("seams", "points"))
    parser.add_argument("--groups", type=int, help="default: 40 seams, 300 points")
    parser.add_argument("--nodes", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=10, help="of seams; points have one")
    parser.add_argument("--effort", type=float, default=10.0)
    parser.add_argument("--tenfold", type=int, default=0, help="seeds with ten times the effort")
    options = parser.parse_args()
    print(hardware.line(), hardware.version("ortools"), sep=", ")
    for kind in ("seams", "points"):
        if options.only not in (None, kind):
            continue
        groups = options.groups or (40 if kind == "seams" else 300)
        case = job(groups, options.nodes, kind == "points", groups // 2 if kind == "seams" else 0, seed=groups)
        seeds = options.seeds if kind == "seams" else 1
        runs = [(options.effort, seed) for seed in range(seeds)]
        runs += [(10 * options.effort, seed) for seed in range(options.tenfold if kind == "seams" else 0)]
        found = []
        for effort, seed in runs:
            order, taken_s, used_s = solve(case, seed, effort)
            air_s = order.cost - float(case.own_cost[order.nodes].sum())
            found.append((effort, order, air_s))
            gap = 100 * (1 - order.bound / order.cost)
            air_gap = 100 * (order.cost - order.bound) / air_s
            print(
                f"{groups} {kind}, effort {effort:g}, seed {seed}: {order.cost:.3f} s, air moves {air_s:.3f} s, "
                f"gap {gap:.2f} % ({air_gap:.2f} % of the air moves), {taken_s:.1f} s of wall time, "
                f"{used_s:.1f} s of processor time",
                flush=True,
            )
        best = min(air_s for _, _, air_s in found)
        for effort in sorted({effort for effort, _, _ in found}):
            worst = max(air_s for each, _, air_s in found if each == effort)
            print(f"effort {effort:g}: the longest air moves are {100 * (worst / best - 1):.2f} % above the shortest")


if __name__ == "__main__":
    main()
