"""Order of seams: cost, gap to the proven bound and time, on generated jobs whose seed is fixed.

    python -m benchmarks order                    40 seams with precedence, ten seeds; 300 points, one seed
    python -m benchmarks order --tenfold 10       the same, and ten seeds with ten times the effort: takes an hour
    python -m benchmarks order --only points --groups 500 --effort 60
    python -m benchmarks order --job kingpin/job.yaml --tenfold 10
    python -m benchmarks order --job coverage/job.yaml --plan out/coverage

With --plan, a job's plan is compared with a tour of nearest neighbours through the same configurations: joint length,
turns and time of the air moves. The plan is read from the folder if it is there; otherwise the job is planned and saved
there.

With --job alone, the seams of a job are planned once; then `htcp plan`'s own search, and a search for each seed with
ten times the effort, find orders of these plans. A proven air move is used by all of them.

A job has seams in a box. A seam has nodes: branches of the arm, and both directions; a point has branches alone. A
configuration is a smooth function of the position, moved by an offset for its branch, and a move takes as long as the
slowest joint. Half as many pairs of seams as there are seams have to be in the order of a random permutation. A row per
order states its cost, that of its air moves alone, and the gap to the proven bound. On a machine that others use, trust
the processor time.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import hardware
from htcp_jax import api, jobs, sequencing
from htcp_jax.model.scenario import with_goals_of
from htcp_jax.motion import Problem
from htcp_jax.planning import methods
from htcp_jax.sequencing import Order, shortest_order
from htcp_jax.status import Kind

SPEED_RAD_S = np.array([2.5, 2.0, 3.0, 5.0, 5.0, 7.0])
FEED_M_S = 0.05
TURN_RAD = np.pi / 2


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


def nearest_tour(seams: np.ndarray, plans: Sequence, home: np.ndarray | None, speed: np.ndarray) -> list:
    """Return one plan of each seam: always the one whose first configuration is reached soonest, from home on."""
    starts, is_left, tour = np.array([plan.start for plan in plans]), np.ones(len(plans), bool), []
    at = starts[0] if home is None else home
    while is_left.any():
        times = np.where(is_left, (np.abs(starts - at) / speed).max(axis=1), np.inf)
        tour.append(plans[int(times.argmin())])
        at, is_left = tour[-1].end, is_left & (seams != seams[int(times.argmin())])
    return tour


def travel(tour: list, home: np.ndarray | None, speed: np.ndarray) -> tuple[float, float, int]:
    """Return time [s], joint length [rad] and number of turns of the straight air moves of a tour.

    A turn is an air move on which a joint moves by more than TURN_RAD.
    """
    first = [plan.start for plan in tour]
    last = [plan.end for plan in tour]
    if home is not None:
        first, last = [*first, home], [home, *last]
    else:
        first, last = first[1:], last[:-1]
    steps = np.abs(np.array(first) - np.array(last)).reshape(len(first), -1)
    length = np.linalg.norm(steps, axis=1).sum()
    return (steps / speed).max(axis=1).sum(), length, int((steps.max(axis=1) > TURN_RAD).sum())


class Ends(NamedTuple):
    """First and last configuration of a seam."""

    start: np.ndarray
    end: np.ndarray


def compare_plan(file: str, folder: Path) -> Iterator[str]:
    """Yield the air moves of a job's plan, and those of a tour of nearest neighbours, as text.

    Args:
        file: The job.
        folder: Folder of the plan; without one, the job is planned and saved there.
    """
    if not (folder / "summary.json").exists():
        api.plan(file).save(folder)
    made = api.open_plan(folder)
    if made.order is None:
        raise SystemExit(f"{file} has one seam")
    plans, speed = made.plans, api.joint_speeds(made.robot, made.job)
    tour = [Ends(plans.x[0, visit.first], plans.x[0, visit.last]) for visit in made.order.visits]
    home = None if plans.retract is None else plans.start[0]
    moved = made.motion(retract=home is not None)
    is_air = ~np.isin(moved.kind[1:], (Kind.PROCESS, Kind.DWELL))
    steps = np.abs(np.diff(moved.x, axis=0))[is_air]
    proven_s, length = (steps / speed).max(axis=1).sum(), np.linalg.norm(steps, axis=1).sum()
    yield f"plan: {len(tour)} of {len(made.job.workpiece.seams)} seams, {made.order.facts()['order']}"
    yield f"its air moves, proven: {proven_s:.3f} s, {length:.2f} rad"
    own_s, own, turns = travel(tour, home, speed)
    yield f"the same, if they were straight: {own_s:.3f} s, {own:.2f} rad, {turns} turns"
    near_s, near, turns = travel(nearest_tour(np.arange(len(tour)), tour, home, speed), home, speed)
    more = f"{100 * (near / own - 1):.1f} % longer" if own else "-"
    yield f"nearest neighbours, straight, not proven: {near_s:.3f} s, {near:.2f} rad, {turns} turns; {more}"


def solve_job(file: str, tenfold: int) -> None:
    """Print a row for each order of a job's seams, and how much longer the first one is than the shortest."""
    chosen = jobs.load_config(file)
    chosen, robot = jobs.build.with_robot(chosen, file)
    found = jobs.seam_scenarios.seam_scenarios(chosen, robot)
    obstacles = jobs.build.obstacles_of(chosen.cell, robot)
    problems = [
        Problem.of(
            robot, found.workpiece, with_goals_of(found.scenarios, task.numbers), chosen.settings, task, obstacles
        )
        for task in found.tasks
    ]
    problem = problems[0]
    home = None if problem.begins_anywhere[0] else np.asarray(problem.scenarios.x_home[0])
    speed, used = api.joint_speeds(robot, chosen), time.process_time()
    plans = sequencing.plan_seams(problems, found.variants, home, speed, methods.find(chosen.method)).found
    seams = found.variants.seam[[plan.variant for plan in plans]]
    print(f"{len(plans)} plans of {len(np.unique(seams))} seams, {time.process_time() - used:.1f} s of processor time")
    moves, times = sequencing.moves_between(problem, plans, home, speed), list[float]()
    time_s, length, turns = travel(nearest_tour(seams, plans, home, speed), home, speed)
    print(f"nearest neighbours, straight, not proven: air moves {time_s:.3f} s, {length:.2f} rad, {turns} turns")
    for seed in range(-1, tenfold):
        used, effort = time.process_time(), sequencing.ORDER_EFFORT * (1 if seed < 0 else 10)
        order = sequencing.find_sequence(seams, plans, found.before, moves, max(seed, 0), effort=effort)
        times.append(order.cost_s)
        legs = [each.time_s for each in (*order.moves, order.retract) if each is not None]
        _, length, turns = travel(order.visits, home, speed)
        print(
            f"effort {effort:g}, seed {max(seed, 0)}: {len(order.visits)} seams, {order.cost_s:.3f} s, "
            f"air moves {sum(legs):.3f} s, straight {length:.2f} rad, {turns} turns, "
            f"{100 * (order.cost_s / order.bound_s - 1):.2f} % above the bound, "
            f"{time.process_time() - used:.1f} s of processor time",
            flush=True,
        )
    if tenfold:
        print(f"the first order is {100 * (times[0] / min(times) - 1):.2f} % above the shortest")


def main() -> None:
    """Print a row for each order, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("seams", "points"))
    parser.add_argument("--groups", type=int, help="default: 40 seams, 300 points")
    parser.add_argument("--nodes", type=int, default=8)
    parser.add_argument("--seeds", type=int, default=10, help="of seams; points have one")
    parser.add_argument("--effort", type=float, default=10.0)
    parser.add_argument("--tenfold", type=int, default=0, help="seeds with ten times the effort")
    parser.add_argument("--job", help="a job with several seams, instead of generated ones")
    parser.add_argument("--plan", type=Path, help="folder of the job's plan, which is compared with nearest neighbours")
    options = parser.parse_args()
    print(hardware.line(), hardware.version("ortools"), sep=", ")
    if options.plan is not None:
        if options.job is None:
            parser.error("--plan needs --job")
        for line in compare_plan(options.job, options.plan):
            print(line)
        return
    if options.job is not None:
        solve_job(options.job, options.tenfold)
        return
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
