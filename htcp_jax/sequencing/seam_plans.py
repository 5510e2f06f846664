"""Plans of each seam of a part, from several configurations at either of its ends.

Each seam has variants: its rows in one direction of travel, for a closed seam also from other rows. For each variant,
configurations far apart from each other are sampled at its first target, and the seam is planned from each of them. It
is also planned from home, so that a seam that a job of its own would complete is completed here. If the task is the
same in both directions, a proven motion is one in the other direction, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import devices
from htcp_jax.model import Scenario
from htcp_jax.motion import Plans, Problem, ViaPoints, configurations, transfers
from htcp_jax.planning import Method, batch
from htcp_jax.status import Status

STARTS = 3  # maximum number of configurations from which a variant is planned
ROUNDS, FIRST_ROUND = 2, 200  # rounds of sampled configurations, and the number of the first one
SAME_RAD = 1e-3  # plans whose first and last configurations differ by less count as one


class Variants(NamedTuple):
    """Ways to follow the seams: V of them, which are also the scenarios of a problem."""

    seam: Int[np.ndarray, "V"]  # the seam that each variant belongs to
    reverse: Int[np.ndarray, "V"]  # the variant with the same rows backwards
    is_allowed: Bool[np.ndarray, "V"]  # False for a direction that is planned only to be reversed


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
    problem: Problem, variants: Variants, method: Method, progress: Callable[[batch.Progress], None] | None = None
) -> SeamPlans:
    """Return the proven motions along all seams.

    All variants are planned from home. Those of seams for which this succeeds are planned from other configurations,
    too, without searches after dead ends.

    Args:
        problem: The problem; its scenarios are the variants.
        variants: The seams and directions of the variants.
        method: The planning method.
        progress: See `batch.plan`.
    """
    every, scenarios = problem.to_plan, problem.scenarios
    nothing = problem.empty_plans()
    best = {int(seam): _on_path(nothing.rows([v]), scenarios.on_path[v]) for v, seam in enumerate(variants.seam)}
    if not len(every):
        return SeamPlans([], best, 0.0)
    from_home = jax.tree.map(lambda leaf: leaf[every], scenarios)
    found = _plans(replace(problem, scenarios=_numbered(from_home, 0)), every, method, progress, "")
    compile_s = found[0].plans.compile_s
    for plan in found:
        seam = int(variants.seam[plan.variant])
        if plan.plans.executable.sum() >= best[seam].executable.sum():
            best[seam] = plan.plans
    found = [plan for plan in found if plan.plans.outcome(0).can_be_driven]
    done = {int(variants.seam[plan.variant]) for plan in found}
    variant, x = _starts(problem, every[np.isin(variants.seam[every], sorted(done))])
    if len(variant):
        begun = jax.tree.map(lambda leaf: leaf[variant], scenarios)
        begun = replace(begun, x_start=x, x_home=x.copy(), auto_start=np.zeros(len(variant), bool))
        settings = replace(problem.settings, transfers=False, effort=0.0)
        further = replace(problem, scenarios=_numbered(begun, len(every)), settings=settings)
        made = _plans(further, variant, method, progress, "; from other configurations")
        found += [plan for plan in made if plan.plans.outcome(0).can_be_driven]
        compile_s += made[0].plans.compile_s
    lost = {seam: plan for seam, plan in best.items() if seam not in done}
    return SeamPlans(_both_directions(problem, variants, found), lost, compile_s)


def _plans(
    problem: Problem,
    variant: np.ndarray,
    method: Method,
    progress: Callable[[batch.Progress], None] | None,
    phase: str,
) -> list[SeamPlan]:
    """Return the plans of scenarios, each of a variant, on the path."""
    report = progress and (lambda now: progress(now._replace(phase=phase)))
    plans, on_path = batch.plan(problem, method, report), problem.scenarios.on_path
    own = [_on_path(plans.rows([row]), on_path[row]) for row in range(len(variant))]
    return [SeamPlan(v, each, each.x[0, 0], each.x[0, -1]) for v, each in zip(variant.tolist(), own, strict=True)]


def _numbered(scenarios: Scenario, first: int) -> Scenario:
    """Return the scenarios with consecutive numbers, from which random keys are derived."""
    return replace(scenarios, number=first + np.arange(len(scenarios.number), dtype=scenarios.number.dtype))


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


def _starts(problem: Problem, rows: np.ndarray) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n N"]]:
    """Return configurations at the first targets of some variants, far apart from each other, and their variants."""
    settings = problem.settings
    variant, x, clearance = (np.empty(0, int), np.empty((0, problem.scenarios.x_start.shape[1])), np.empty(0))
    checker = problem.checkers[0]
    with devices.on(checker.executor.device):
        for round_ in range(ROUNDS):
            missing = rows[np.bincount(variant, minlength=len(problem.scenarios.number))[rows] < STARTS]
            if not len(missing):
                break
            at, lane = transfers.other_configurations(problem, checker, missing, FIRST_ROUND + round_)
            variant, x, clearance = (
                np.concatenate(both)
                for both in ((variant, missing[lane]), (x, at.x), (clearance, np.asarray(at.clearance)))
            )
    order = np.lexsort((-clearance, variant))
    variant, x = variant[order], x[order]
    kept = configurations.dispersed(x, variant, STARTS, settings.beam_separation_rad)
    return variant[kept], x[kept]


def _both_directions(problem: Problem, variants: Variants, found: list[SeamPlan]) -> list[SeamPlan]:
    """Return the plans in all allowed directions, without those that are nearly equal."""
    reversible = [_is_reversible(problem.scenarios, v, int(r)) for v, r in enumerate(variants.reverse)]
    every = list(found)
    for each in found:
        if reversible[each.variant] and not len(each.plans.via_points.x):
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


def _reversed(plan: SeamPlan, variant: int) -> SeamPlan:
    """Return the same motion backwards; the plan must have no via points."""
    found = {name: array[:, ::-1] for name, array in plan.plans.arrays().items() if name != "start"}
    for name in ("segment_status", "segment_clearance", "path_clear", "joint_step"):  # those of the segment before
        found[name] = np.roll(found[name], 1, axis=1)
    own = plan.plans._replace(start=plan.end[None], **found)
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
