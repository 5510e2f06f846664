"""The public call of a search: ranges of mountings in, mountings ranked out.

    found = htcp_jax.place("place.yaml", out="out/place")
    found.mountings[0].spare, found.motions      # ranked, the best first; and the run that holds their motions

Every stage is a sweep or several, in folders of their own: `rounds` and `raised` judge mountings by quick plans, first
evenly and then about what is best, `confirmed` plans the best of them as proven motions with as much clearance as there
is, `disturbed` and `tolerance` plan these anew, a little off, and `ranked` holds the motions in their order. A first
ranking is written before mountings are disturbed. Called again it goes on from what is there.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs.feed import feed_of
from htcp_jax.jobs.grid import Sweep
from htcp_jax.motion.plans import Plans
from htcp_jax.placement.clock import Clock
from htcp_jax.placement.judge import (
    MARGIN,
    RAISED,
    Judged,
    Planner,
    judge,
    judge_lowered,
    judge_raised,
    sweep_of,
)
from htcp_jax.placement.mounting import Answer, Mounting, Tolerance
from htcp_jax.placement.place_file import CLEARANCE, CYCLE_TIME, Search, load_search
from htcp_jax.placement.placed import Placed, searching, write
from htcp_jax.placement.search import EVEN, FROM, POPULATION, ROUND, Evolution, Known, best_apart, even, score
from htcp_jax.placement.tolerance import TRIED, disturbed, most_tried, tolerances
from htcp_jax.planning.batch import start_clearance
from htcp_jax.runs import sweep as sweeps
from htcp_jax.runs.open import MOTIONS
from htcp_jax.runs.run_folder import Run
from htcp_jax.status import AT_HOME, Status
from htcp_jax.trajectory.whole_run import time_run

MARGINS = 1.7, 1.4, 1.2, 1.05, 0.95, 0.8, 0.5  # of the clearance of the quick plan, that a motion is planned with
LOWERED = 0.8, 0.4  # of its margin, with which a disturbed mounting is planned before the job's own margin
TOLERANCES = 3  # of so many mountings tolerances are worked out


class PlaceProgress(NamedTuple):
    """How far a search has come."""

    stage: str
    scenarios: int  # judged so far
    of: int | None  # that will be; None: as many as time allows
    complete: int  # mountings
    best: float  # of the first aim so far; -inf: none
    sweep: sweeps.SweepProgress | None = None  # the one at hand
    most: dict[str, int] | None = None  # plans of each stage at most; of the first None where time decides


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
) -> Placed:
    """Search the ranges of a file, or of a mapping that spells one, and rank what does the whole work.

    config, overrides, changes: see `load_search`. on, device, threads: as of `runs.sweep.sweep`; no result hangs on
    them. out: the folder; one that holds a part of the same search is gone on with.
    Raises InputError for bad input, ranges whose ends the job refuses among it, for a folder that holds another search
    or is in use, and where every start collides; Interrupted and Lost as a sweep does, with what is finished in the
    folder.
    """
    search, folder = load_search(spec, config, overrides, changes), Path(out)
    _refuse(search)
    with searching(folder, search):
        tell = _Teller(search, progress)

        def plan(grid: Sweep, method: str, into: Path) -> Run:
            run = sweeps.sweep(grid, [method], into, progress=tell.sweep, on=on, device=device, threads=threads)
            return time_run(run, search.file.feed, (method,)) if CYCLE_TIME in search.file.spare else run

        judged = list(_rounds(search, folder / "rounds", plan, tell))
        tell.stage = "confirm"
        confirmed = _confirmed(search, judged, folder / "confirmed", plan)
        tell.stage = "tolerance"
        for mountings, is_final in _ranked(search, confirmed, folder, plan):
            motions = _motions(search, confirmed, mountings, folder)
            found = write(folder, search, judged, mountings, motions, is_final)
        return found


def _refuse(search: Search) -> None:
    """Raise InputError for a feed that is none, and for ranges whose ends the job refuses, before anything is done."""
    feed_of(search.file.feed)
    ends = np.repeat([[0.0], [1.0]], len(search.ranges.axes), axis=1)
    sweep_of(search, search.ranges.values(ends)).batch()


def most_plans(search: Search) -> dict[str, int | None]:
    """The largest number of plans that each stage makes; None where time decides."""
    file, k = search.file, max(1, len(search.seams))
    is_raised = CLEARANCE in file.spare
    scenarios = file.within.scenarios
    return {
        "search": None if scenarios is None else scenarios // k * k * (1 + RAISED * is_raised),
        "confirm": k * file.best * (len(MARGINS) if is_raised else 1),
        "disturbed": k * file.best * TRIED * (1 + len(LOWERED) * is_raised),
        "tolerance": k * min(TOLERANCES, file.best) * most_tried(len(search.ranges.axes)),
    }


class _Teller:
    """Reports the stages to whoever listens."""

    def __init__(self, search: Search, progress: Callable[[PlaceProgress], None] | None):
        self.stage, self._progress, self._of = "search", progress, search.file.within.scenarios
        self._scenarios, self._complete, self._best, self._most = 0, 0, -np.inf, most_plans(search)

    def judged(self, found: Judged) -> None:
        self._scenarios += len(found.plans.status)
        self._complete += int(found.complete.sum())
        self._best = max(self._best, float(found.spare[:, 0].max(initial=-np.inf)))

    def sweep(self, now: sweeps.SweepProgress) -> None:
        if self._progress is not None:
            counts = self._scenarios, self._of, self._complete, self._best
            self._progress(PlaceProgress(self.stage, *counts, now, self._most))


def _rounds(search: Search, folder: Path, plan: Planner, tell: _Teller) -> Iterator[Judged]:
    """The mountings of all rounds, judged."""
    known, number = None, 0
    budget, clock = search.file.within.scenarios, Clock(folder, search.file.within.seconds)
    mountings = None if budget is None else max(1, budget // max(1, len(search.seams)))
    evolved = 0 if mountings is None else int((1 - EVEN) * mountings) // (FROM * POPULATION)
    spread = None if mountings is None else mountings - evolved * FROM * POPULATION
    d, seed = len(search.ranges.axes), search.file.seed
    evolution: Evolution | None = None

    while clock.used(number) < 1 and (mountings is None or known is None or len(known.u) < mountings):
        here = 0 if known is None else len(known.u)
        if evolution is None and (here < spread if spread is not None else clock.used(number) < EVEN):
            u = even(d, here, ROUND if spread is None else min(ROUND, spread - here), seed)
        else:
            evolution = Evolution(known, len(search.file.spare), seed) if evolution is None else evolution
            u = evolution.ask()
        values = search.ranges.values(u)
        found = judge_raised(search, plan, values, folder / f"{number:03d}", folder.with_name("raised"))
        if not number:
            _refuse_collision(search, found, folder)
        own = Known(u, found.done.mean(axis=1), found.complete, found.spare)
        if evolution is not None:
            evolution.tell(own)
        known = own if known is None else Known(*map(np.concatenate, zip(known, own, strict=True)))
        number += 1
        clock.finished(number)
        tell.judged(found)
        yield found


def _refuse_collision(search: Search, found: Judged, folder: Path) -> None:
    """Raise InputError where every start of the first round collides, naming the body; the round is kept no more."""
    first = found.plans.status[:, 0]
    if not np.isin(first, (Status.START_IN_COLLISION, *AT_HOME)).all():
        return
    batch = sweep_of(search, found.values[:1]).batch(1)
    cell, scenario = batch.cells[0], jax.tree.map(itemgetter(0), batch.scenarios)
    why = Status(int(first[0])).message
    if Status(int(first[0])) in (Status.START_IN_COLLISION, Status.HOME_IN_COLLISION):
        depth, body, other = start_clearance(cell.robot, cell.workpiece, scenario, scenario.x_home, cell.obstacles)
        why = f"{body} is {-1e3 * depth:.3g} mm inside {other} in the first of them" if depth <= 0 else why
    shutil.rmtree(folder)
    raise InputError(f"{search.name}: in all of {len(found.values):,} mountings nothing can begin: {why}")


def _confirmed(search: Search, judged: Sequence[Judged], folder: Path, plan: Planner) -> Judged:
    """The best mountings, some way apart, each planned with several margins."""
    values = np.concatenate([each.values for each in judged])
    known = Known(
        (values - search.ranges.low) / search.ranges.width,
        np.concatenate([each.done.mean(axis=1) for each in judged]),
        np.concatenate([each.complete for each in judged]),
        np.concatenate([each.spare for each in judged]),
    )
    aims = known.spare.shape[1]
    chosen: list[int] = []
    for weights in np.eye(aims):
        order = np.argsort(score(known, weights), kind="stable")
        chosen += best_apart(known.u, order, -(-search.file.best // aims))
    chosen = list(dict.fromkeys(chosen))
    clear = np.concatenate([each.clearance for each in judged])[chosen]
    least = search.job.margin_m
    is_raised = CLEARANCE in search.file.spare
    margins = [
        sorted({max(least, share * c) for share in MARGINS} if whole and is_raised else {least}, reverse=True)
        for c, whole in zip(clear.tolist(), known.complete[chosen].tolist(), strict=True)
    ]
    every = np.repeat(values[chosen], [len(own) for own in margins], axis=0)
    return judge(search, plan, every, search.file.confirm, folder, np.concatenate(margins))


def _ranked(search: Search, confirmed: Judged, folder: Path, plan: Planner) -> Iterator[tuple[list[Mounting], bool]]:
    """The plan with the most to spare of each mounting: first by that, then by what is left when they are off, with the
    tolerances of the first; and whether that is the final ranking."""
    rows = _best_rows(confirmed)
    if not rows:
        yield [], True
        return
    values, spare, front = confirmed.values[rows], confirmed.spare[rows], _front(confirmed.spare[rows])
    margin = _margins(confirmed)[rows]

    def mountings(order: np.ndarray, worst: np.ndarray, held: np.ndarray, known: Mapping[int, Tolerance]):
        kept = zip(rows, values, margin.tolist(), spare, worst, held.tolist(), front.tolist(), strict=True)
        found = [Mounting(*each, known.get(k)) for k, each in enumerate(kept)]
        return [found[k] for k in order]

    unknown = np.full(spare.shape, np.nan)
    yield mountings(np.argsort(-spare[:, 0], kind="stable"), unknown, unknown[:, 0], {}), False
    off = disturbed(search, values, folder / "disturbed", partial(_anew, search, plan, margin))
    worst = np.minimum([one.spare.min(axis=0) for one in off], spare)
    held = np.array([one.complete.mean() for one in off])
    order = np.lexsort((-spare[:, 0], -worst[:, 0], -held))
    first = order[:TOLERANCES]
    known = tolerances(search, values[first], folder / "tolerance", partial(_anew, search, plan, None))
    yield mountings(order, worst, held, dict(zip(first.tolist(), known, strict=True))), True


def _anew(
    search: Search,
    plan: Planner,
    margin_m: Float[np.ndarray, "m"] | None,
    values: Float[np.ndarray, "n d"],
    folder: Path,
) -> Answer:
    """What mountings come to by quick plans. margin_m: of m mountings, with which n / m each are planned if clearance
    is an aim; None: whether they are complete is all that is asked."""
    with_clearance = margin_m is not None and CLEARANCE in search.file.spare
    shares = LOWERED if with_clearance else ()
    margins = [] if margin_m is None else [s * np.repeat(margin_m, len(values) // len(margin_m)) for s in shares]
    quick = judge_lowered(search, plan, values, folder, margins)
    proven = Judged(search, quick.run, quick.method, values, plans=quick.plans)  # clearance all along, at least
    return Answer(proven.complete, proven.spare)


def _margins(judged: Judged) -> Float[np.ndarray, "n"]:
    """The margin that each mounting was planned with [m]."""
    return judged.run.scenarios(judged.method)[MARGIN].to_numpy()[:: judged.seams]


def _best_rows(confirmed: Judged) -> list[int]:
    """Of the plans of each mounting the one that is a motion with the most to spare."""
    best: dict[bytes, int] = {}
    for row in np.flatnonzero(confirmed.complete).tolist():
        key = confirmed.values[row].tobytes()
        if key not in best or confirmed.spare[row, 0] > confirmed.spare[best[key], 0]:
            best[key] = row
    return list(best.values())


def _front(spare: Float[np.ndarray, "n A"]) -> np.ndarray:
    """Which are no worse in some aim than every other."""
    beaten = (spare[None] >= spare[:, None]).all(axis=2) & (spare[None] > spare[:, None]).any(axis=2)
    return ~beaten.any(axis=1)


def _motions(search: Search, confirmed: Judged, mountings: Sequence[Mounting], folder: Path) -> Path | None:
    """The ranked mountings' motions as a run of their own, in their order."""
    if not mountings:
        return None
    rows = np.array([one.row for one in mountings])
    margins = _margins(confirmed)[rows]
    scenarios = (rows[:, None] * confirmed.seams + np.arange(confirmed.seams)).ravel()
    plans: Plans = confirmed.plans.rows(scenarios)
    spec = sweep_of(search, confirmed.values[rows], margins)
    return sweeps.keep_plans(spec, confirmed.method, plans, folder / MOTIONS).folder
