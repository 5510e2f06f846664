"""Placement search: ranges of mountings in, ranked mountings out.

    found = htcp_jax.place("place.yaml", out="out/place")
    found.mountings[0].objective, found.motions      # the best mounting; the run folder with the motions

Every stage is one or more sweeps, in a folder with the stage's name. `rounds` and `raised` evaluate mountings by quick
plans, first evenly over the ranges, then near the best ones. `confirmed` plans the best mountings as proven motions
with the largest possible margin. `perturbed` and `tolerance` plan the confirmed mountings again under perturbation.
`ranked` contains the motions in the order of the ranking. A first ranking is written before mountings are perturbed.
Calling `place` again resumes an interrupted search. A time limit bounds all stages: the planner's calls are small, and
a call that is expected to take too long is omitted, and one that takes too long is ended.
"""

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.device import LOADING
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.jobs import Sweep
from htcp_jax.motion import Plans, start_contact
from htcp_jax.placement.clock import ENDED, Clock, PlanTime, TimeOver
from htcp_jax.placement.mounting import Mounting, MountingResults, PlacementTolerance
from htcp_jax.placement.part_depth import part_depths
from htcp_jax.placement.place_file import CLEARANCE, CYCLE_TIME, Search, load_search
from htcp_jax.placement.placement_result import PlacementResult, kept_plans, locked_search, ranked_plans, write_result
from htcp_jax.placement.progress import (
    LOWERED,
    MARGINS,
    STAGES,
    PlaceProgress,
    ProgressReporter,
    most_plans,
)
from htcp_jax.placement.scores import QUICK, MountingPlanner, MountingScores, sweep_of
from htcp_jax.placement.search import EVEN, FROM, POPULATION, ROUND, Evolution, SearchResults, best_apart, even, score
from htcp_jax.placement.tolerance import TRIED, most_tried, perturbed, tolerances
from htcp_jax.runs import Run
from htcp_jax.runs import open as plan_sets
from htcp_jax.runs import sweep as sweeps
from htcp_jax.spec import feed
from htcp_jax.status import AT_HOME, Status
from htcp_jax.trajectory import time_run

# Shares of a time limit after which the search ends, then the confirmation, then the perturbations and tolerances.
SEARCHED, CONFIRMED, PERTURBED = 0.5, 0.8, ENDED


def place(
    spec: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    config: str | Path | None = None,
    overrides: Sequence[str] = (),
    changes: Mapping[str, Any] | None = None,
    on: str = "here",
    device: str | None = None,
    threads: int | None = None,
    progress: Callable[[PlaceProgress], None] | None = None,
    began_s: float | None = None,
) -> PlacementResult:
    """Search the ranges of a file, or of an equivalent mapping, and rank the mountings that complete the path.

    Args:
        spec: The search, see `load_search`.
        out: The folder of the results; an interrupted search in it is resumed.
        config: The job, in place of the search's own, see `load_search`.
        overrides: Changes to the job, each "dotted.key=value".
        changes: Changes to the search, value by key.
        on: The machines that plan, see `runs.sweep.sweep`; results do not depend on it.
        device: The device of this process, see `runs.sweep.sweep`; results do not depend on it.
        threads: The number of engines in this process, see `runs.sweep.sweep`; results do not depend on it.
        progress: Function that is called with the progress of the search.
        began_s: Value of `time.monotonic` from which a time limit counts [s]; None: that of this call.

    Returns:
        The ranked mountings, and the run folder with their motions.

    Raises:
        InputError: If the input is invalid, or the ends of the ranges are invalid in the job; if the folder contains
            another search or is in use; if every start collides; if the time limit ends the first quick plans.
        Interrupted: On SIGINT and SIGTERM; finished plans are kept in the folder.
        Lost: As `runs.sweep.sweep`; finished plans are kept in the folder.
    """
    began_s = time.monotonic() if began_s is None else began_s
    search, folder = load_search(spec, config, overrides, changes), Path(out)
    targets = _targets(search) * (most_plans(search)["search"] or ROUND)
    with locked_search(folder, search):
        clock = Clock(folder, search.file.within.seconds, began_s)
        report = ProgressReporter(search, progress, kept_plans(folder))
        compile_s = list[float]()

        def progress_of(now: sweeps.SweepProgress) -> None:
            clock.check()
            report.sweep(now)

        sweep = partial(
            sweeps.sweep, on=on, device=device, threads=threads, progress=progress_of, targets_in_all=targets
        )

        def plan(grid: Sweep, method: str, into: Path) -> Run:
            name, began, loaded_s = into.relative_to(folder), time.monotonic(), LOADING.seconds
            report.begin(stage := STAGES[name.parts[0]])
            # A call by Ray is not ended, because the compilation of its workers is unknown until its end.
            clock.begin(name.as_posix(), stops=on == "here")
            run = None
            with suppress(TimeOver):
                planned = sweep(grid, [method], into)
                report.planned(planned)
                if CYCLE_TIME in search.file.objective:
                    planned = time_run(planned, search.file.feed, (method,), progress=lambda *_: clock.check())
                run = planned
            compile_s.append(LOADING.seconds - loaded_s if run is None else run.manifest.seconds[method].compile_s)
            seconds, count = time.monotonic() - began - compile_s[-1], 0 if run is None else run.manifest.count
            clock.add(name.as_posix(), PlanTime(count, max(0.0, seconds), stage != "confirm"), began)
            if run is None:
                raise TimeOver
            return run

        planner, scores, parts = MountingPlanner(search, plan), list[MountingScores](), list[MountingScores]()
        is_over = True
        try:
            with suppress(TimeOver):
                for each in search_rounds(planner, clock, folder / "rounds", report):
                    scores.append(each)
            if not scores:
                clock.forget()
                raise InputError(f"the time limit of {clock.seconds:g} s ended the first quick plans; allow more time")
            with suppress(TimeOver):
                for each in _confirmed(planner, clock, scores, folder / "confirmed"):
                    parts.append(each)
                    report.confirmed(each)
                is_over = False
        except (Interrupted, KeyboardInterrupt):
            _write_ranking_so_far(search, scores, parts, folder)
            raise
        if is_over and not any(each.complete.any() for each in parts):
            found = _write_ranking_so_far(search, scores, parts, folder)
            found = found or write_result(folder, search, scores, [], None, is_final=False)
            return found._replace(compile_s=sum(compile_s))
        confirmed = MountingScores.concatenate(parts)
        for mountings, is_final in _rankings(planner, clock, confirmed, folder):
            motions = _save_motions(search, confirmed, mountings, folder)
            found = write_result(folder, search, scores, mountings, motions, is_final)
        return found._replace(compile_s=sum(compile_s))


def _targets(search: Search) -> int:
    """Return the maximum number of targets of a scenario, over the lower and upper ends of the ranges.

    Raises:
        InputError: If the feed rate is invalid, or if the ends of the ranges are invalid in the job.
    """
    feed.feed_of(search.file.feed)
    ends = np.repeat([[0.0], [1.0]], len(search.ranges.axes), axis=1)
    return int(sweep_of(search, search.ranges.values(ends)).batch().scenarios.count.max())


def search_rounds(
    planner: MountingPlanner, clock: Clock, folder: Path, report: ProgressReporter
) -> Iterator[MountingScores]:
    """Propose and plan mountings round by round, and yield the scores of each call of the planner.

    With a time limit, the mountings of a round are planned in several calls.
    """
    search, known, number = planner.search, None, 0
    budget = search.file.within.scenarios
    mountings = None if budget is None else max(1, budget // max(1, len(search.seams)))
    evolved = 0 if mountings is None else int((1 - EVEN) * mountings) // (FROM * POPULATION)
    spread = None if mountings is None else mountings - evolved * FROM * POPULATION
    d, seed = len(search.ranges.axes), search.file.seed
    evolution: Evolution | None = None

    while clock.used < SEARCHED and (mountings is None or known is None or len(known.u) < mountings):
        here = 0 if known is None else len(known.u)
        if evolution is None and (here < spread if spread is not None else clock.used < EVEN * SEARCHED):
            u = even(d, here, mountings_together(search, clock) if spread is None else min(ROUND, spread - here), seed)
        else:
            evolution = Evolution(known, len(search.file.objective), seed) if evolution is None else evolution
            u = evolution.ask()
        parts: list[SearchResults] = []
        while (done := sum(len(part.u) for part in parts)) < len(u) and (not done or clock.used < SEARCHED):
            now = u[done:] if spread is not None else u[done : done + mountings_together(search, clock)]
            into = folder / f"{number:03d}", folder.with_name("raised")
            found = planner.evaluate_raised(
                search.ranges.values(now), *into, lambda plans: clock.fits(plans, quick=True, share=SEARCHED)
            )
            if not number:
                _refuse_collision(search, found, folder)
            parts.append(SearchResults(now, found.done.mean(axis=1), found.complete, found.objective))
            number += 1
            report.evaluated(found)
            yield found
        own = _joined(parts)
        if evolution is not None and len(own.u) == len(u):
            evolution.tell(own)
        known = own if known is None else _joined([known, own])


def _joined(parts: Sequence[SearchResults]) -> SearchResults:
    """Return the results of all parts."""
    return SearchResults(*map(np.concatenate, zip(*parts, strict=True)))


def mountings_together(search: Search, clock: Clock) -> int:
    """Return the number of mountings in the next call of a search with a time limit."""
    return min(ROUND, max(1, clock.plans_together() // max(1, len(search.seams))))


def _refuse_collision(search: Search, found: MountingScores, folder: Path) -> None:
    """Raise InputError with the colliding body if every start of the first round collides; remove that round."""
    first = found.plans.status[:, 0]
    if not np.isin(first, (Status.START_IN_COLLISION, *AT_HOME)).all():
        return
    batch = sweep_of(search, found.values[:1]).batch(1)
    cell, scenario = batch.cells[0], jax.tree.map(itemgetter(0), batch.scenarios)
    why = Status(int(first[0])).message
    if Status(int(first[0])) in (Status.START_IN_COLLISION, Status.HOME_IN_COLLISION):
        near = start_contact(cell.robot, cell.workpiece, scenario, scenario.x_home, cell.obstacles)
        if near.clearance_m <= 0:
            why = f"{near.body} is {-1e3 * near.clearance_m:.3g} mm inside {near.other} in the first of them"
    shutil.rmtree(folder)
    raise InputError(f"{search.name}: no motion can start in any of {len(found.values):,} mountings: {why}")


def _best_mountings(
    search: Search, scores: Sequence[MountingScores]
) -> tuple[Float[np.ndarray, "n d"], SearchResults, list[int]]:
    """Return all mountings, their results, and the indices of the best by each objective, APART from each other."""
    values = np.concatenate([each.values for each in scores])
    known = SearchResults(
        (values - search.ranges.low) / search.ranges.width,
        np.concatenate([each.done.mean(axis=1) for each in scores]),
        np.concatenate([each.complete for each in scores]),
        np.concatenate([each.objective for each in scores]),
    )
    objectives = known.objective.shape[1]
    chosen: list[int] = []
    for weights in np.eye(objectives):
        order = np.argsort(score(known, weights), kind="stable")
        chosen += best_apart(known.u, order, -(-search.file.best // objectives))
    return values, known, list(dict.fromkeys(chosen))


def _confirmed(
    planner: MountingPlanner, clock: Clock, scores: Sequence[MountingScores], folder: Path
) -> Iterator[MountingScores]:
    """Plan the best mountings by each objective, each with all of MARGINS, and yield the results of each call.

    With a time limit, each mounting is planned in a call of its own, with as many margins as there is time for. At
    least one is planned.
    """
    search = planner.search
    values, known, chosen = _best_mountings(search, scores)
    clear = np.concatenate([each.clearance for each in scores])[chosen]
    least = search.job.margin_m
    is_raised = CLEARANCE in search.file.objective
    margins = [
        sorted({max(least, share * c) for share in MARGINS} if whole and is_raised else {least}, reverse=True)
        for c, whole in zip(clear.tolist(), known.complete[chosen].tolist(), strict=True)
    ]
    if clock.seconds is None:
        every = np.repeat(values[chosen], [len(own) for own in margins], axis=0)
        yield planner.evaluate(every, search.file.confirm, folder, np.concatenate(margins))
        return
    for k, (one, own) in enumerate(zip(values[chosen], margins, strict=True)):
        fit = [n for n in range(len(own)) if clock.fits((n + 1) * max(1, len(search.seams)), False, CONFIRMED)]
        if k and not fit:
            break
        own = own[-1 - max(fit, default=0) :]  # the smallest margins are the most likely to be kept
        every = np.repeat(one[None], len(own), axis=0)
        yield planner.evaluate(every, search.file.confirm, folder / f"{k:03d}", np.array(own))


def _write_ranking_so_far(
    search: Search, scores: Sequence[MountingScores], confirmed: Sequence[MountingScores], folder: Path
) -> PlacementResult | None:
    """Write a preliminary ranking of a search that ends before its first ranking, if a mounting is complete.

    The mountings are those with confirmed motions or, without any, the best ones of the quick plans. A ranking of more
    plans, which an earlier call wrote, is kept.
    """
    known = [each for each in confirmed if each.complete.any()] or [each for each in scores if each.complete.any()]
    if not known or ranked_plans(folder) > sum(len(each.plans.status) for each in scores):
        return None
    found = MountingScores.concatenate(known).with_guaranteed_clearance()
    chosen = _best_mountings(search, [found])[2]
    rows = _best_rows(found) if known[0] in confirmed else [k for k in chosen if found.complete[k]]
    front, unknown = is_on_pareto_front(found.objective[rows]), np.full(found.objective.shape[1], np.nan)
    mountings = [
        Mounting(
            k, found.values[k], float(found.margin_m[k]), found.objective[k], unknown, np.nan, bool(on), None, depth
        )
        for k, on, depth in zip(rows, front, part_depths(search, found.values[rows]), strict=True)
    ]
    mountings.sort(key=lambda one: (one.inside.depth_m > 0, -one.objective[0]))
    motions = _save_motions(search, found, mountings, folder)
    return write_result(folder, search, scores, mountings, motions, is_final=False)


def _rankings(
    planner: MountingPlanner, clock: Clock, confirmed: MountingScores, folder: Path
) -> Iterator[tuple[list[Mounting], bool]]:
    """Yield rankings of the confirmed mountings, each with True if it is final.

    The first ranking is by the objective of each mounting's best plan. The final one is by the results under
    perturbation; its first mountings have tolerances. What a time limit omits is unknown. Mountings with the part in a
    solid of the cell come last.
    """
    rows = _best_rows(confirmed)
    if not rows:
        yield [], True
        return
    values, objective, margin = confirmed.values[rows], confirmed.objective[rows], confirmed.margin_m[rows]
    pareto_front = is_on_pareto_front(objective)

    def mountings(
        order: np.ndarray, worst: np.ndarray, success_rate: np.ndarray, known: Mapping[int, PlacementTolerance]
    ):
        kept = zip(
            rows, values, margin.tolist(), objective, worst, success_rate.tolist(), pareto_front.tolist(), strict=True
        )
        found = [Mounting(*each, known.get(k), inside[k]) for k, each in enumerate(kept)]
        return [found[k] for k in order]

    unknown, inside = np.full(objective.shape, np.nan), part_depths(planner.search, values)
    is_inside = np.array([one.depth_m > 0 for one in inside])
    first = np.lexsort((-objective[:, 0], is_inside))
    yield mountings(first, unknown, unknown[:, 0], {}), False
    seams = max(1, len(planner.search.seams))
    tries = 1 + len(LOWERED) * (CLEARANCE in planner.search.file.objective)
    worst, success_rate = unknown.copy(), unknown[:, 0].copy()
    with suppress(TimeOver):
        for own, into in _calls(clock, first, folder / "perturbed", seams * TRIED * tries):
            again = partial(_planned_again, planner, margin[own])
            for row, one in zip(own, perturbed(planner.search, values[own], into, again), strict=True):
                worst[row] = np.minimum(one.objective.min(axis=0), objective[row])
                success_rate[row] = one.complete.mean()
    order = np.lexsort((-objective[:, 0], -worst[:, 0], -success_rate, is_inside))
    known: dict[int, PlacementTolerance] = {}
    most = seams * most_tried(values.shape[1])
    with suppress(TimeOver):
        for own, into in _calls(clock, order[: planner.search.file.tolerances], folder / "tolerance", most):
            found = tolerances(planner.search, values[own], into, partial(_planned_again, planner, None))
            known |= dict(zip(own.tolist(), found, strict=True))
    yield mountings(order, worst, success_rate, known), True


def _calls(clock: Clock, rows: np.ndarray, folder: Path, plans: int) -> Iterator[tuple[np.ndarray, Path]]:
    """Yield mountings that are perturbed together, with the folder of their plans: all without a time limit.

    Args:
        clock: The search's clock; with a limit, mountings are yielded one by one as long as the time suffices.
        rows: Rows of the mountings, best first.
        folder: The folder of the stage.
        plans: Maximum number of plans for one mounting.
    """
    if not len(rows):
        return
    if clock.seconds is None:
        yield np.sort(rows) if folder.name == "perturbed" else rows, folder
        return
    for k, row in enumerate(rows):
        if not clock.fits(plans, True, PERTURBED):
            return
        yield np.array([row]), folder / f"{k:03d}"


def _planned_again(
    planner: MountingPlanner, margin_m: Float[np.ndarray, "m"] | None, values: Float[np.ndarray, "n d"], folder: Path
) -> MountingResults:
    """Return the results of quick plans for n perturbed mountings, n / m around each of m mountings.

    Args:
        planner: Plans the mountings of the search.
        margin_m: Margins of the m mountings. If clearance is an objective, the shares LOWERED of these are tried before
            the job's margin. None: only the job's margin is tried.
        values: Parameters of the n perturbed mountings, each in the job's unit.
        folder: The folder of the plans.
    """
    with_clearance = margin_m is not None and CLEARANCE in planner.search.file.objective
    shares = LOWERED if with_clearance else ()
    margins = [] if margin_m is None else [s * np.repeat(margin_m, len(values) // len(margin_m)) for s in shares]
    quick = planner.evaluate_lowered(values, folder, margins)
    # not marked as quick, so that the objective is the guaranteed clearance
    proven = MountingScores(planner.search, quick.run, quick.method, values, plans=quick.plans)
    return MountingResults(proven.complete, proven.objective)


def _best_rows(confirmed: MountingScores) -> list[int]:
    """Return the row of the plan with the largest first objective, for each mounting with a complete plan."""
    best: dict[bytes, int] = {}
    for row in np.flatnonzero(confirmed.complete).tolist():
        key = confirmed.values[row].tobytes()
        if key not in best or confirmed.objective[row, 0] > confirmed.objective[best[key], 0]:
            best[key] = row
    return list(best.values())


def is_on_pareto_front(objective: Float[np.ndarray, "n A"]) -> np.ndarray:
    """Return the mask (n,) of the Pareto front: rows that no other row dominates."""
    beaten = (objective[None] >= objective[:, None]).all(axis=2) & (objective[None] > objective[:, None]).any(axis=2)
    return ~beaten.any(axis=1)


def _save_motions(
    search: Search, confirmed: MountingScores, mountings: Sequence[Mounting], folder: Path
) -> Path | None:
    """Save the motions of the ranked mountings as a run, in the order of the ranking, and return the run's folder."""
    if not mountings:
        return None
    rows = np.array([one.row for one in mountings])
    margins = confirmed.margin_m[rows]
    scenarios = (rows[:, None] * confirmed.seams + np.arange(confirmed.seams)).ravel()
    plans: Plans = confirmed.plans.rows(scenarios)
    spec = sweep_of(search, confirmed.values[rows], margins, QUICK if confirmed.quick else ())
    return sweeps.keep_plans(spec, {confirmed.method: plans}, folder / plan_sets.MOTIONS).folder
