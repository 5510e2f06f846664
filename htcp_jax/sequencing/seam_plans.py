"""Plans of each seam of a part, from several configurations at either of its ends.

Each seam has variants: its rows in one direction of travel, for a closed seam also from other rows. If the task is the
same in both directions, a proven motion is one in the other direction, too, so one of the two directions is planned.

A seam is first planned from home, so that a seam that a job of its own would complete is completed here. Then it is
planned from configurations at either end from which short air moves lead to the other seams: the arm should do all
seams in similar configurations. They are chosen among random configurations and among those that are nearest to home
and to the ends of the other seams' plans.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import devices, tables
from htcp_jax.model import Scenario
from htcp_jax.motion import CollisionChecker, Plans, Problem, ViaPoints, configurations, transfers
from htcp_jax.planning import Method, batch
from htcp_jax.status import Status

MOST_ENDS = 64  # ends of plans to which a configuration is compared
SAMPLES_ROUND = 200  # number of the round of random configurations
NO_SEAM = -1  # number of home among the seams
SAME_RAD = 1e-3  # plans whose first and last configurations differ by less count as one


class Variants(NamedTuple):
    """Ways to follow the seams: V of them, which are also the scenarios of a problem."""

    seam: Int[np.ndarray, "V"]  # the seam that each variant belongs to
    reverse: Int[np.ndarray, "V"]  # the variant with the same rows backwards
    is_allowed: Bool[np.ndarray, "V"]  # False for a direction that is planned only to be reversed
    task: Int[np.ndarray, "V"]  # number of the task, and of its problem


class SeamPlan(NamedTuple):
    """A proven motion along one seam."""

    variant: int
    plans: Plans  # of one scenario with only the seam's targets
    start: Float[np.ndarray, "N"]  # configuration at the first target [rad or m]
    end: Float[np.ndarray, "N"]  # configuration at the last target [rad or m]


class SeamPlans(NamedTuple):
    """Proven motions along the seams, and what prevents the others."""

    found: list[SeamPlan]
    best: dict[int, Plans]  # seam -> the plan that leads furthest, for seams without a proven motion
    compile_s: float  # time spent waiting for compilation [s]


def plan_seams(
    problems: Sequence[Problem],
    variants: Variants,
    home: Float[np.ndarray, "N"] | None,
    speed: Float[np.ndarray, "N"],
    method: Method,
    progress: Callable[[batch.Progress], None] | None = None,
) -> SeamPlans:
    """Return the proven motions along all seams.

    Args:
        problems: One problem for each task, which differ in nothing else; the scenarios of each are all variants.
        variants: The seams, directions and tasks of the variants.
        home: First and last configuration of the motion [rad or m]; None: it begins and ends at the seams.
        speed: Full speeds of the joints [rad/s or m/s].
        method: The planning method.
        progress: See `batch.plan`.
    """
    problem = problems[0]
    scenarios, seam, every = problem.scenarios, variants.seam, np.arange(len(variants.seam))
    pairs = [(problems[task].scenarios, v, int(variants.reverse[v])) for v, task in enumerate(variants.task)]
    reversible = np.array([_is_reversible(*pair) for pair in pairs], bool)
    is_second = reversible & (variants.reverse < every)  # planned from home only if its reverse does not serve it
    is_point = scenarios.count == scenarios.on_path + 1
    if is_point.all():  # only the configurations at the points are kept, no motion
        problems = [replace(each, settings=replace(each.settings, smooth=False)) for each in problems]
    usable = np.isin(every, problem.to_plan) & (reversible | variants.is_allowed) & ~(is_point & is_second)
    nothing = problem.empty_plans()
    best = {int(s): _on_path(nothing.rows([v]), scenarios.on_path[v]) for v, s in enumerate(seam)}
    found, done, compile_s, number = list[SeamPlan](), np.zeros(len(seam), bool), 0.0, 0

    def add(rows: np.ndarray, x: np.ndarray | None, phase: str) -> list[SeamPlan]:
        nonlocal compile_s, number, done
        made = dict[int, SeamPlan]()
        for own_problem, own in _by_problem(problems, variants, rows):
            begun = tables.gather(own_problem.scenarios, rows[own])
            begun = replace(begun, number=(number + own).astype(begun.number.dtype))
            settings = own_problem.settings
            if x is not None:
                begun = replace(begun, x_start=x[own], x_home=x[own].copy(), auto_start=np.zeros(len(own), bool))
                settings = replace(settings, transfers=False, effort=0.0)
            own_problem = replace(own_problem, scenarios=begun, settings=settings)
            complete = f"; {len(np.unique(seam[done]))} of {len(best)} seams complete{phase}"
            plans = _plans(own_problem, rows[own], method, progress, complete)
            compile_s += plans[0].plans.compile_s
            made |= zip(own.tolist(), plans, strict=True)
        number += len(rows)
        every_plan = [made[k] for k in range(len(rows))]
        driven = [plan for plan in every_plan if plan.plans.outcome(0).can_be_driven]
        found.extend(plan for plan in driven if variants.is_allowed[plan.variant] or _can_be_reversed(plan))
        done = np.isin(seam, seam[[plan.variant for plan in found]])
        return every_plan

    for chosen in (usable & ~is_second, usable & is_second):
        turned = [int(variants.reverse[plan.variant]) for plan in found if _can_be_reversed(plan)]
        rows = np.flatnonzero(chosen & ~np.isin(every, turned) & (variants.is_allowed | ~done))
        for plan in add(rows, None, "; seams from home") if len(rows) else []:
            own = int(seam[plan.variant])
            if plan.plans.executable.sum() >= best[own].executable.sum():
                best[own] = plan.plans
    lost = {s: plan for s, plan in best.items() if s not in seam[done]}
    if not len(rows := np.flatnonzero(usable & done)):
        return SeamPlans([], lost, compile_s)
    samples = _Configurations.sampled(problems, variants, rows)
    rows, x = _starts(problems, variants, samples, found, home, speed)
    if len(x):
        add(rows, x, "; seams from other configurations")
    return SeamPlans(_both_directions(variants, reversible & ~is_point, found), lost, compile_s)


def _by_problem(
    problems: Sequence[Problem], variants: Variants, rows: Int[np.ndarray, "n"]
) -> list[tuple[Problem, Int[np.ndarray, "k"]]]:
    """Return each problem with the positions of its variants in `rows`, without problems that have none."""
    parts = [(problem, np.flatnonzero(variants.task[rows] == task)) for task, problem in enumerate(problems)]
    return [part for part in parts if len(part[1])]


def _plans(
    problem: Problem,
    variant: np.ndarray,
    method: Method,
    progress: Callable[[batch.Progress], None] | None,
    phase: str,
) -> list[SeamPlan]:
    """Return the plans of scenarios, each of a variant, on the path."""

    def report(now: batch.Progress) -> None:
        progress(now._replace(phase=f"{phase}: {now.scenarios_done} of {now.scenarios} plans ended"))

    plans, on_path = batch.plan(problem, method, progress and report), problem.scenarios.on_path
    own = [_on_path(plans.rows([row]), on_path[row]) for row in range(len(variant))]
    return [SeamPlan(v, each, each.x[0, 0], each.x[0, -1]) for v, each in zip(variant.tolist(), own, strict=True)]


def _on_path(plan: Plans, on_path: np.integer) -> Plans:
    """Return the plan of a scenario's targets on the path; if an earlier target failed, the first has its status."""
    first, plan = int(on_path), plan.narrowed()
    found = {name: array[:, first:].copy() for name, array in plan.arrays().items() if name != "start"}
    failed = plan.outcome(0).failed
    if failed is not None and failed < first:
        found["status"][0, 0] = plan.status[0, failed]
    later = plan.via_points.target > first
    via_points = ViaPoints(*(column[later] for column in plan.via_points))
    start = plan.x[:, first] if plan.tracked[0, first] else plan.start
    return plan._replace(**found, start=start, via_points=via_points._replace(target=via_points.target - first))


def _with_first_repeated(plan: Plans) -> Plans:
    """Return the plan with its first target twice, as in every scenario: target 0 is the path's first point."""
    rows = np.append(0, np.arange(plan.status.shape[1]))
    found = {name: array[:, rows] for name, array in plan.arrays().items() if name != "start"}
    found["status"][0, 1:2][~plan.tracked[0, :1]] = Status.NOT_ATTEMPTED
    return plan._replace(**found, via_points=plan.via_points._replace(target=plan.via_points.target + 1))


class _Configurations(NamedTuple):
    """Valid configurations at the first targets of variants."""

    variant: Int[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]

    @classmethod
    def sampled(
        cls, problems: Sequence[Problem], variants: Variants, variant: Int[np.ndarray, "_"]
    ) -> "_Configurations":
        """Return random configurations of some variants."""

        def sample(problem: Problem, own: Int[np.ndarray, "_"], checker: CollisionChecker, share: slice):
            at, lane = transfers.other_configurations(problem, checker, own[share], SAMPLES_ROUND)
            return cls(own[share][lane], at.x)

        parts = list[_Configurations]()
        for problem, rows in _by_problem(problems, variants, variant):
            work = partial(sample, problem, variant[rows])
            parts += problem.in_threads(work, min(problem.threads, len(rows)))
        found = cls(*(np.concatenate(both) for both in zip(*parts, strict=True)))
        return cls(*(values[np.argsort(found.variant, kind="stable")] for values in found))

    @classmethod
    def near(
        cls,
        problems: Sequence[Problem],
        variants: Variants,
        variant: Int[np.ndarray, "_"],
        x: Float[np.ndarray, "m N"],
    ) -> "_Configurations":
        """Return those configurations of some variants that are near some other configurations [rad or m].

        Indexed axes are where they are in the other configurations, so that they need not move between the seams.
        """
        parts = [cls(np.zeros(0, int), x[:0])]
        for problem, rows in _by_problem(problems, variants, variant):
            checker, lane = problem.checkers[0], np.repeat(variant[rows], len(x))
            with devices.on(checker.executor.device):
                others = np.tile(x, (len(rows), 1))
                at = transfers.projected(problem, checker, lane, 0, others, still=True)
                valid = checker.valid(problem.inputs(lane, 0), at)
            parts.append(cls(lane[valid], at.x[valid]))
        return cls(*(np.concatenate(both) for both in zip(*parts, strict=True)))


def _starts(
    problems: Sequence[Problem],
    variants: Variants,
    samples: _Configurations,
    found: Sequence[SeamPlan],
    home: Float[np.ndarray, "N"] | None,
    speed: Float[np.ndarray, "N"],
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n N"]]:
    """Return for each variant the configuration with the shortest air moves to other seams and home, and its variant.

    What counts is the mean time to the nearest end of each other seam's plans. Configurations at which plans begin
    already are excluded. Of very many ends, some that are chosen at random are considered.
    """
    seam, settings = variants.seam, problems[0].settings
    ends, of = (
        np.array([x for plan in found for x in (plan.start, plan.end)]),
        seam[[p.variant for p in found]].repeat(2),
    )
    some = np.random.default_rng(settings.seed).permutation(len(ends))[:MOST_ENDS]
    ends, of = ends[some], of[some]
    if home is not None:
        ends, of = np.concatenate([ends, home[None]]), np.append(of, NO_SEAM)
    near = _Configurations.near(problems, variants, np.unique(samples.variant), ends)
    variant, x = (np.concatenate(both) for both in zip(samples, near, strict=True))
    times = np.stack([(np.abs(x - end) / speed).max(axis=1) for end in ends], axis=1)
    seams = np.unique(of)
    nearest = np.stack([times[:, of == each].min(axis=1) for each in seams], axis=1)
    order = np.lexsort((np.where(seam[variant][:, None] == seams, 0.0, nearest).sum(axis=1), variant))
    variant, x = variant[order], x[order]
    known = np.array([plan.start for plan in found]), np.array([plan.variant for plan in found])
    kept = configurations.dispersed(x, variant, len(x), settings.beam_separation_rad, known)
    kept = kept[np.diff(variant[kept], prepend=-1) > 0]
    return variant[kept], x[kept]


def _both_directions(variants: Variants, reversible: Bool[np.ndarray, "V"], found: list[SeamPlan]) -> list[SeamPlan]:
    """Return the plans in all allowed directions, without those that are nearly equal."""
    every = list(found)
    for each in found:
        if reversible[each.variant] and _can_be_reversed(each):
            every.append(_reversed(each, int(variants.reverse[each.variant])))
    kept = dict[int, list[SeamPlan]]()
    for each in every:
        others = kept.setdefault(each.variant, [])
        ends = np.array([(other.start, other.end) for other in others]).reshape(-1, 2, len(each.start))
        apart = np.abs(ends - np.stack([each.start, each.end])).max(axis=(1, 2), initial=0)
        if variants.is_allowed[each.variant] and (apart > SAME_RAD).all():
            others.append(each)
    return [each for v in sorted(kept) for each in kept[v]]


def _is_reversible(scenarios: Scenario, variant: int, reverse: int) -> bool:
    """Return True if the task along a variant is that of the reverse variant, backwards."""
    count = int(scenarios.count[variant])
    if int(scenarios.count[reverse]) != count:
        return False
    on_path = int(scenarios.on_path[variant])
    a, b = scenarios.goals[variant, on_path:count], scenarios.goals[reverse, on_path:count]
    return bool(np.allclose(a, b[::-1], rtol=0, atol=1e-12))


def _can_be_reversed(plan: SeamPlan) -> bool:
    """Return False if the arm changes its configuration at a target: backwards, this is no dwell before a segment."""
    return bool((plan.plans.via_points.share > 0).all())


def _reversed(plan: SeamPlan, variant: int) -> SeamPlan:
    """Return the same motion backwards."""
    found = {name: array[:, ::-1] for name, array in plan.plans.arrays().items() if name != "start"}
    for name in ("segment_status", "segment_clearance", "path_clear", "joint_step"):  # those of the segment before
        found[name] = np.roll(found[name], 1, axis=1)
    scenario, target, x, share = (column[::-1] for column in plan.plans.via_points)
    via_points = ViaPoints(scenario, (plan.plans.status.shape[1] - target).astype(target.dtype), x, 1.0 - share)
    own = plan.plans._replace(start=plan.end[None], via_points=via_points, **found)
    return SeamPlan(variant, own, plan.end, plan.start)


def not_joined(problem: Problem, variants: Variants, seam: int) -> Plans:
    """Return the plan of a seam to which no air move leads."""
    v = int(np.flatnonzero(variants.seam == seam)[0])
    plan = _on_path(problem.empty_plans().rows([v]), problem.scenarios.on_path[v])
    plan.status[0, 0] = Status.HOME_NOT_JOINED
    return plan


def in_order(done: Sequence[Plans], missing: Sequence[Plans]) -> Plans:
    """Return the plans of seams in their order of work as one plan; the segments between seams are not checked.

    Args:
        done: Complete plans of seams.
        missing: Plans of the seams that are not done. Only the first of them keeps its status.
    """
    parts = list(done)
    for k, plan in enumerate(missing):
        status = np.full_like(plan.status, Status.NOT_ATTEMPTED)
        if not k:
            failed = plan.outcome(0).status
            status[0, 0] = Status.NOT_ATTEMPTED if failed is None else failed
        bare = Plans.empty(plan.start, plan.target)
        parts.append(bare._replace(status=status))
    parts[0] = _with_first_repeated(parts[0])
    counts = np.cumsum([0, *(part.status.shape[1] for part in parts)])
    names = [name for name in parts[0].arrays() if name != "start"]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts], axis=1) for name in names}
    moved = [
        part.via_points._replace(target=part.via_points.target + a) for part, a in zip(parts, counts, strict=False)
    ]
    via_points = ViaPoints(*(np.concatenate(column) for column in zip(*moved, strict=True)))
    own = {"via_points": via_points, "seam_begins": tuple(counts[1:-1].tolist())}
    return parts[0]._replace(**arrays, **own)
