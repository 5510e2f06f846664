"""Plans for display: the arm, the cloud and the targets, target by target.

    replays = open_replays("out/workpiece")     # a run of htcp sweep, a plan of htcp plan; or `replays_of` a Plan
    replay = replays.replay(12, "nspace-sqp")
    replay.x[40]                                # the configuration at target 40

A picture or a viewer needs only a `Replay`.
"""

from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int8

from htcp_jax.clearance import Obstacles, contacts, rows_of, surface_points
from htcp_jax.errors import InputError
from htcp_jax.jobs import PlanConfig
from htcp_jax.model import Robot, Scenario, Workpiece, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.model import surface as surfaces
from htcp_jax.motion import Motion, Plans
from htcp_jax.motion import motion as motions
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Obstruction
from htcp_jax.reachability import obstruction as obstruction_module
from htcp_jax.runs import PlanSet, motion_summary, open_plans
from htcp_jax.viewer.colours import is_tool
from htcp_jax.viewer.normal_glyphs import NormalGlyphs, glyphs
from htcp_jax.viewer.viewpoints import ShownBodies, Viewpoint, camera_view
from htcp_jax.viewer.workcell import GivenCell, Placement, Workcell, Workcells, cells_of

VIEW_SAMPLES = 5  # number of configurations by which the viewpoint is chosen
SEGMENT_SAMPLES = 33  # samples of one segment, of which the minimum is taken


class Witness(NamedTuple):
    """Pair of points of the minimum distance, at each of T targets."""

    body: list[str]  # the capsule's name
    arm: Float[np.ndarray, "T 3"]  # on its surface, world [m]
    cloud: Float[np.ndarray, "T 3"]  # the cloud's point, or the one on the hull that the capsule's end has crossed

    def rows(self, which: slice) -> "Witness":
        """Select some of the configurations."""
        return Witness(*(part[which] for part in self))


class NarrowSegment(NamedTuple):
    """Segment with the least guaranteed clearance, and the minimum distance sampled there."""

    target: int  # at the end of the segment
    proven_m: float  # D all along it, at least
    seen_m: float  # minimum of SEGMENT_SAMPLES samples
    body: str  # the capsule's name
    arm: Float[np.ndarray, "3"]  # on its surface, world [m]
    cloud: Float[np.ndarray, "3"]


class Replay(NamedTuple):
    """Plan of one scenario by one method.

    At the failed target the arm is displayed in collision; at targets not attempted it stays at the last tracked one.
    """

    method: str
    number: int  # of the scenario
    label: str  # its number and its varied parameters
    robot: Robot  # with the scenario's tool
    surface: surfaces.Surface  # of the cloud; world [m], like everything below
    path: int  # first target of the tool path; the ones before lead to it
    target: Float[np.ndarray, "T 3"]
    status: Int8[np.ndarray, "T"]
    clearance: Float[np.ndarray, "T"]  # NaN where not tracked
    residual: Float[np.ndarray, "T"]
    orientation_error: Float[np.ndarray, "T"]  # [rad]; NaN if the task holds no orientation
    x: Float[np.ndarray, "T N"]
    shape: kinematics.ArmShape  # the arm at these
    witness: Witness
    motion: Motion  # motion up to the last tracked target
    summary: motion_summary.MotionSummary  # of the executable part
    narrow: NarrowSegment | None  # of the executable part
    segment_status: Int8[np.ndarray, "T"]  # `status.SegmentStatus`
    segment_clearance: Float[np.ndarray, "T"]  # D all along it, at least
    obstruction: Obstruction | None  # at the target that failed
    side: Viewpoint  # viewpoint
    fixtures: surfaces.WorldGeometry  # other obstacles
    normals: NormalGlyphs  # of the path, if the task refers to them

    @property
    def cloud(self) -> Float[np.ndarray, "P 3"]:
        """Points to draw; the clearance is to all of the workpiece's."""
        return self.surface.points

    @property
    def p(self) -> Float[np.ndarray, "T K 3"]:
        """First ends of the capsules' axes."""
        return self.shape.p

    @property
    def q(self) -> Float[np.ndarray, "T K 3"]:
        """Second ends of the capsules' axes."""
        return self.shape.q

    @property
    def tcp(self) -> Float[np.ndarray, "T 3"]:
        """Tool centre points."""
        return self.shape.tcp

    @property
    def outcome(self) -> plan_arrays.Outcome:
        """Outcome of the scenario, without its joint paths."""
        return plan_arrays.outcomes(self.status[None]).of(0)._replace(scenario=self.number)

    @property
    def tracked(self) -> int:
        """Number of tracked targets."""
        return self.outcome.tracked

    @property
    def failed(self) -> int | None:
        """First target that is not tracked."""
        return self.outcome.failed

    def arm_at(self, target: int) -> kinematics.ArmShape:
        """The arm at one target."""
        return kinematics.ArmShape(*(part[target] for part in self.shape))


class Replays:
    """Plans for display: several scenarios by several methods.

    Args:
        name: Name of the plans, for messages.
        methods: Names of the methods.
        plans: Function for the plans of a method; row s is scenario s.
        cells: The workcells.
        labels: The scenarios' varied parameters, by number.
    """

    def __init__(
        self,
        name: str,
        methods: tuple[str, ...],
        plans: Callable[[str], Plans],
        cells: Workcells,
        labels: dict[int, str] | None = None,
    ):
        self.name, self.methods, self.labels = name, methods, labels or {}
        self.plans, self.cells = lru_cache(maxsize=None)(plans), cells

    def outcomes(self, method: str) -> list[plan_arrays.Outcome]:
        """Outcomes of all scenarios that the method has planned; failed ones first, each group in order.

        Raises:
            InputError: For a method without results.
        """
        if method not in self.methods:
            raise InputError(f"{self.name} has no results of {method!r}; it has {', '.join(self.methods)}")
        ends = self.plans(method).outcomes
        found = [ends.of(number) for number in np.flatnonzero(ends.planned).tolist()]
        return sorted(found, key=lambda outcome: outcome.complete)

    def replay(self, number: int, method: str) -> Replay:
        """Return the plan of a scenario by a method.

        Raises:
            InputError: For an unknown scenario or method, with a list of the known.
        """
        numbers = sorted(outcome.scenario for outcome in self.outcomes(method))
        if number not in numbers:
            raise InputError(f"{self.name} has no scenario {number} by {method}; it has {_spans(numbers)}")
        plans, placement = self.plans(method), self.cells.placement(number)
        cell, there = self.cells.cell(self.cells.key(number)), plans.exists[number]
        x = _without_gaps(plans.x[number, there], plans.start[number])
        blocked = self.obstructions(method, [number]).get(number)
        if blocked is not None:
            x[obstruction_module.blocked_target(plans, number)] = blocked.x
        robot = robots.lengthen_tool(cell.robot, placement.tool_extension_m)
        alone, on_path = plans.rows([number]), min(cell.approach, len(x))
        summary = motion_summary.summarise_motion(alone, on_path)
        looked_at = _segment_samples(alone, summary.clearance_target)
        witness = _witness(robot, cell.obstacle, placement, np.concatenate([x, looked_at]))
        shape = kinematics.ArmShape(*map(np.asarray, kinematics.capsules_and_tcp(robot, jnp.asarray(x))))
        surface = cell.surface.placed(placement.T_world_workpiece)
        target, status = plans.target[number, there], plans.status[number, there]
        arm = _arm_at_targets(shape, robot, np.flatnonzero(plan_arrays.is_tracked(status)), on_path)
        return Replay(
            method=method,
            number=number,
            label=self.label(number),
            robot=robot,
            surface=surface,
            path=on_path,
            target=target,
            status=status,
            clearance=plans.clearance[number, there],
            residual=plans.residual[number, there],
            orientation_error=plans.orientation_error[number, there],
            x=x,
            shape=shape,
            witness=witness.rows(slice(len(x))),
            motion=motions.motions(alone, on_path, np.logical_and.accumulate(alone.tracked, axis=1)).of(0),
            summary=summary,
            narrow=_narrow(summary, witness.rows(slice(len(x), None))),
            segment_status=plans.segment_status[number, there],
            segment_clearance=plans.segment_clearance[number, there],
            obstruction=blocked,
            side=camera_view(surface.points, target[on_path:] if len(target) > on_path + 1 else target, arm),
            fixtures=cell.fixtures,
            normals=glyphs(cell.config.task, cell.workpiece, placement.T_world_workpiece),
        )

    def label(self, number: int) -> str:
        """A scenario's number and its varied parameters."""
        return f"{number}: {self.labels[number]}" if self.labels.get(number) else str(number)

    def obstructions(self, method: str, numbers: Sequence[int] | None = None) -> dict[int, Obstruction]:
        """Colliding bodies in the failed scenarios, all or those of some numbers; one call can do hundreds."""
        plans, together = self.plans(method), dict[Hashable, dict[int, int]]()
        for number in range(len(plans.status)) if numbers is None else numbers:
            if (target := obstruction_module.blocked_target(plans, number)) is not None:
                together.setdefault(self.cells.key(number), {})[number] = target
        found = {}
        for key, targets in together.items():
            found |= self._colliding_bodies(self.cells.cell(key), plans, targets)
        return {number: found[number] for number in sorted(found)}

    def _colliding_bodies(self, cell: Workcell, plans: Plans, targets: dict[int, int]) -> dict[int, Obstruction]:
        """Colliding bodies in scenarios of one workcell, with the failed target of each.

        It is empty if the job has a task, whose goals are not saved.
        """
        if cell.config.task:
            return {}
        where = jax.tree.map(lambda *leaves: np.stack(leaves), *map(self.cells.placement, targets))
        s, t = np.array(list(targets)), np.array(list(targets.values()))
        how = plans.before(s, t), plans.target[s, t], cell.config.settings
        return dict(zip(targets, obstruction_module.obstructions(cell.robot, cell.obstacle, where, *how), strict=True))


def open_replays(folder: str | Path) -> Replays:
    """Open the plans in the folder of a sweep or of one plan.

    Raises:
        InputError: As `open_plans`, and for a plan that does not match the configuration next to it.
    """
    return recorded_replays(open_plans(folder))


def recorded_replays(found: PlanSet, plans: Callable[[str], Plans] | None = None) -> Replays:
    """Return the replays of saved plans.

    Args:
        found: The saved plans.
        plans: Function for the plans of a method, if they are read already.

    Raises:
        InputError: As `open_replays`.
    """
    return Replays(str(found.folder), found.methods, plans or found.plans, cells_of(found), found.labels)


@runtime_checkable
class PlannedJob(Protocol):
    """A job and its result, as `htcp_jax.plan` returns it; the robot has its tool."""

    job: PlanConfig
    robot: Robot
    workpiece: Workpiece
    scenario: Scenario
    plans: Plans


def replays_of(name: str, plan: PlannedJob) -> Replays:
    """Return the replay of a plan in memory, as `Replays`."""
    cells = GivenCell(Workcell(plan.job, plan.robot, plan.workpiece), plan.scenario)
    return Replays(name, (plan.job.method,), lambda _: plan.plans, cells)


def _arm_at_targets(shape: kinematics.ArmShape, robot: Robot, tracked: np.ndarray, path: int) -> ShownBodies:
    """The arm at a few tracked targets, on the tool path if possible; else at the first target."""
    shown = tracked[tracked >= path] if (tracked >= path).any() else tracked if tracked.size else np.zeros(1, int)
    shown = shown[np.linspace(0, len(shown) - 1, VIEW_SAMPLES).round().astype(int)]
    return ShownBodies(shape.p[shown], shape.q[shown], np.asarray(robot.capsule_radius), is_tool(robot))


def _segment_samples(plans: Plans, target: int | None) -> Float[np.ndarray, "n N"]:
    """Configurations along the straight joint paths to a target, evenly spaced; the start if the target is None."""
    if target is None:
        return np.repeat(plans.start, SEGMENT_SAMPLES, axis=0)
    x = np.concatenate([plans.before(0, target)[None], plans.via_points.on_segment(0, target), plans.x[:1, target]])
    place = np.linspace(0, len(x) - 1, SEGMENT_SAMPLES)
    return np.stack([np.interp(place, np.arange(len(x)), joint) for joint in x.T], axis=1)


def _narrow(summary: motion_summary.MotionSummary, seen: Witness) -> NarrowSegment | None:
    """Minimum distance of the sampled configurations in the segment with the least guaranteed clearance."""
    if summary.clearance_target is None:
        return None
    apart = np.linalg.norm(seen.arm - seen.cloud, axis=1)
    k = int(apart.argmin())
    return NarrowSegment(
        summary.clearance_target, summary.clearance_m, float(apart[k]), seen.body[k], seen.arm[k], seen.cloud[k]
    )


def _witness(robot: Robot, obstacle: Obstacles, where: Placement, x: Float[np.ndarray, "T N"]) -> Witness:
    row, arm, cloud = map(np.asarray, _nearest_points(robot, obstacle, where, jnp.asarray(x)))
    body = np.array(rows_of(robot, obstacle).body)[row]
    return Witness([robot.capsule_names[k] for k in body.tolist()], arm, cloud)


@jax.jit
def _nearest_points(robot: Robot, obstacle: Obstacles, where: Placement, x: Float[jax.Array, "T N"]):
    """Witness of the minimum distance (row, point on the body, point of the obstacle), of every configuration."""
    rows = rows_of(robot, obstacle)

    def one(x):
        touch = contacts(robot, obstacle, where, x)
        row = jnp.argmin(touch.distance)
        point, normal, ended = touch.point[row], touch.normal[row], touch.plane[row] & (touch.radius[row] == 0)
        arm = jnp.where(ended, point, surface_points(robot, rows, touch)[row])
        return row, arm, arm - touch.distance[row] * normal

    return jax.vmap(one)(x)


def _without_gaps(x: Float[np.ndarray, "T N"], start: Float[np.ndarray, "N"]) -> Float[np.ndarray, "T N"]:
    """Replace unknown configurations by the last known one."""
    rows = np.concatenate([start[None], x])
    known = np.where(np.isnan(rows).any(axis=1), 0, np.arange(len(rows)))
    return rows[np.maximum.accumulate(known)][1:]


def _spans(numbers: list[int]) -> str:
    """Format sorted numbers as spans: 0 to 3, 7."""
    parts, first = [], 0
    for k, number in enumerate(numbers):
        if k + 1 == len(numbers) or numbers[k + 1] != number + 1:
            parts.append(f"{numbers[first]}" if first == k else f"{numbers[first]} to {number}")
            first = k + 1
    return ", ".join(parts)
