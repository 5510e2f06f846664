"""Plans prepared for display: arm, workpiece and results at every target.

    replays = open_replays("out/workpiece")     # folder of htcp sweep or htcp plan; `replays_of` for a plan in memory
    replay = replays.replay(12, "nspace-sqp")
    replay.x[40]                                # the configuration at target 40

Pictures and the viewer only need a `Replay`.
"""

from collections.abc import Callable, Hashable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Float, Int8

from htcp_jax.clearance import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Task, Workpiece, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.model import surface as surfaces
from htcp_jax.motion import Motion, Plans, measured_rows
from htcp_jax.motion import motion as motions
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.reachability import Obstruction
from htcp_jax.reachability import obstruction as obstruction_module
from htcp_jax.runs import MotionSummary, PlanSet, open_plans, summarise_motion
from htcp_jax.spec import PlanConfig
from htcp_jax.viewer.arm_pose import ArmPose, arms_at, links_at, moved, roots_at, seen, shown_bodies
from htcp_jax.viewer.colours import TargetStyle, target_styles, verdict_styles
from htcp_jax.viewer.normal_glyphs import NormalGlyphs, glyphs
from htcp_jax.viewer.viewpoints import ShownScene, Viewpoint, camera_views
from htcp_jax.viewer.workcell import GivenCell, Workcell, Workcells, cells_of

VIEW_SAMPLES = 3  # number of configurations that determine the viewpoint
SEGMENT_SAMPLES = 33  # number of samples on a segment for its minimum distance


class Witness(NamedTuple):
    """Pair of nearest points on the arm and on the obstacles, at each of T targets."""

    body: list[str]  # name of the nearest capsule
    arm: Float[np.ndarray, "T 3"]  # point on this capsule's surface, world [m]
    cloud: Float[np.ndarray, "T 3"]  # point of the obstacle, or of the hull that the capsule's end has crossed

    def rows(self, which: slice) -> "Witness":
        """Return the pairs of nearest points for a slice of the targets."""
        return Witness(*(part[which] for part in self))


class NarrowSegment(NamedTuple):
    """Segment with the smallest guaranteed clearance, and the minimum distance sampled on it."""

    target: int  # target at the end of the segment
    seen_m: float  # minimum distance at SEGMENT_SAMPLES samples
    body: str  # name of the nearest capsule
    arm: Float[np.ndarray, "3"]  # nearest point on this capsule's surface, world [m]
    cloud: Float[np.ndarray, "3"]  # nearest point of the obstacle, world [m]


class ShownFile(NamedTuple):
    """Texts about the proof of a motion in a file; its T displayed configurations stand for a plan's targets.

    The text of the segment to configuration 0 says that the motion begins there.
    """

    headline: str  # verdict on the motion, and its reason
    places: tuple[str, ...]  # place of each configuration in the file, such as "line 23"
    segments: tuple[str, ...]  # verdict on the segment to each configuration, as a sentence
    first: int  # configuration to show first
    nearest: Float[np.ndarray, "N"] | None  # deepest contact, or the nearest one of a proven motion; None: no obstacle
    mark: str  # short text about it
    has_part: bool  # False: the cell has no workpiece


class Replay(NamedTuple):
    """Plan of one scenario by one method, prepared for display.

    At the failed target, the arm is displayed in collision. At targets that were not attempted, it is displayed at the
    last tracked one.
    """

    method: str
    number: int  # number of the scenario
    label: str  # number and varied parameters of the scenario
    robot: Robot  # with the scenario's tool
    surface: surfaces.Surface  # surface of the cloud; world [m], like all positions below
    path: int  # first target of the tool path; targets before it are the approach
    target: Float[np.ndarray, "T 3"]
    status: Int8[np.ndarray, "T"]
    clearance: Float[np.ndarray, "T"]  # NaN where not tracked
    residual: Float[np.ndarray, "T"]
    orientation_error: Float[np.ndarray, "T"]  # [rad]; NaN if the task does not constrain the orientation
    x: Float[np.ndarray, "T N"]
    shape: kinematics.ArmShape  # the arm at the displayed configurations
    T_root: Sequence[Float[np.ndarray, "4 4"]]  # T_world_root at the displayed configurations
    links: Sequence[Float[np.ndarray, "K 4 4"] | None]  # poses of the capsules' links
    witness: Witness
    motion: Motion  # motion up to the last tracked target
    summary: MotionSummary  # figures of the executable part
    narrow: NarrowSegment | None  # narrowest segment of the executable part
    segment_status: Int8[np.ndarray, "T"]  # `status.SegmentStatus`
    segment_clearance: Float[np.ndarray, "T"]  # guaranteed clearance along the segment to each target
    obstruction: Obstruction | None  # colliding body at the failed target
    triangles: Float[np.ndarray, "M 3 3"]  # mesh of the workpiece, world [m]; none for a cloud, which `surface` shows
    sides: tuple[Viewpoint, ...]  # two viewpoints relative to the part: the best, and one from another side
    sides_in_world: tuple[Viewpoint, ...]  # two viewpoints in the world
    part_axes: Float[np.ndarray, "3 3"]  # columns: axes of the workpiece's frame
    fixtures: surfaces.WorldGeometry  # other obstacles
    normals: NormalGlyphs  # normals of the path; empty if the task does not refer to them
    file: ShownFile | None = None  # proof of the file from which the motion is; None: it was planned

    @property
    def cloud(self) -> Float[np.ndarray, "P 3"]:
        """Points of the workpiece that are drawn, a subset of the points to which clearance is measured."""
        return self.surface.points

    @property
    def pieces(self) -> dict[int, tuple[Float[np.ndarray, "V 3"], float]]:
        """Convex pieces that are checked, by capsule: vertices in the frame of the link [m], radius about them [m]."""
        return robots.checked_pieces(self.robot)

    @property
    def styles(self) -> list[TargetStyle]:
        """Marker styles of the targets."""
        return target_styles(self.status) if self.file is None else verdict_styles(self.segment_status)

    @property
    def outcome(self) -> plan_arrays.Outcome:
        """Outcome of the plan, by the statuses of its targets only."""
        return plan_arrays.outcomes(self.status[None]).of(0)._replace(scenario=self.number)

    @property
    def tracked(self) -> int:
        """Number of tracked targets."""
        return self.outcome.tracked

    @property
    def failed(self) -> int | None:
        """First target that is not tracked; None if all are."""
        return self.outcome.failed

    def arm_at(self, target: int) -> kinematics.ArmShape:
        """Return the arm at one target."""
        return kinematics.ArmShape(*(part[target] for part in self.shape))

    def seen_at(self, targets: Sequence[int], seam: slice | None = None) -> "Replay":
        """Return the plan with the best viewpoints for pictures of the arm at some targets.

        Args:
            targets: The targets.
            seam: Targets of the seam that is to be visible; None: the complete path.
        """
        poses = [ArmPose(self.arm_at(t), t, False, self.T_root[t], self.links[t]) for t in targets]
        seam = slice(self.path if len(self.target) > self.path + 1 else 0, None) if seam is None else seam
        path = self.target[seam]
        bodies = shown_bodies(self.robot, [seen(each, True) for each in poses])
        scene = ShownScene(self.cloud, path, bodies, self.triangles, self.fixtures.triangles, self.part_axes)
        if not len(self.triangles) and len(self.cloud):
            nearest = [int(((self.cloud - point) ** 2).sum(axis=1).argmin()) for point in path]
            scene = scene._replace(inward=self.surface.normals[nearest])
        sides = sides_in_world = camera_views([scene])
        if self.robot.part_moves:
            sides_in_world = camera_views([_scene_in_world(scene, self.robot, each) for each in poses], moves=True)
        return self._replace(sides=sides, sides_in_world=sides_in_world)


class Replays:
    """Plans for display, of several scenarios by several methods.

    Args:
        name: Name of the plans, for messages.
        methods: Names of the methods.
        plans: Function that returns a method's plans; row s is scenario s.
        cells: The workcells of the scenarios.
        labels: The scenarios' varied parameters as text, by number; None: no labels.
        file: Proof of the file from which the only scenario's motion is; None: it was planned.
    """

    def __init__(
        self,
        name: str,
        methods: tuple[str, ...],
        plans: Callable[[str], Plans],
        cells: Workcells,
        labels: dict[int, str] | None = None,
        file: ShownFile | None = None,
    ):
        self.name, self.methods, self.labels, self.file = name, methods, labels or {}, file
        self.plans, self.cells = lru_cache(maxsize=None)(plans), cells

    def outcomes(self, method: str) -> list[plan_arrays.Outcome]:
        """Return the outcomes of the scenarios that a method has planned: failed ones first, each group by number.

        Raises:
            InputError: If the method has no results.
        """
        if method not in self.methods:
            raise InputError(f"{self.name} has no results of {method!r}; it has {', '.join(self.methods)}")
        ends = self.plans(method).outcomes
        found = [ends.of(number) for number in np.flatnonzero(ends.planned).tolist()]
        return sorted(found, key=lambda outcome: outcome.complete)

    def replay(self, number: int, method: str) -> Replay:
        """Return a scenario's plan by a method, prepared for display.

        Raises:
            InputError: If the scenario or the method is unknown; the message lists the valid ones.
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
        summary = summarise_motion(alone, on_path)
        narrowest, looked_at = summary.clearance_target, _segment_samples(alone, summary.clearance_target)
        if self.file is not None:
            narrowest, nearest = (None, x[0]) if self.file.nearest is None else (self.file.first, self.file.nearest)
            looked_at = np.tile(nearest, (len(looked_at), 1))
        witness = _witness(cell.robot, cell.obstacle, placement, np.concatenate([x, looked_at]))
        surface = cell.surface.placed(placement.T_world_workpiece)
        target, status = plans.target[number, there], plans.status[number, there]
        shown = _shown_targets(np.flatnonzero(plan_arrays.is_tracked(status)), on_path)
        replay = Replay(
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
            shape=arms_at(robot, x),
            T_root=roots_at(robot, x),
            links=links_at(robot, x),
            witness=witness.rows(slice(len(x))),
            motion=motions.motions(alone, on_path, np.logical_and.accumulate(alone.tracked, axis=1)).of(0),
            summary=summary,
            narrow=_narrow(narrowest, witness.rows(slice(len(x), None))),
            segment_status=plans.segment_status[number, there],
            segment_clearance=plans.segment_clearance[number, there],
            obstruction=blocked,
            triangles=moved(cell.triangles, placement.T_world_workpiece),
            sides=(),
            sides_in_world=(),
            part_axes=np.asarray(placement.T_world_workpiece)[:3, :3],
            fixtures=cell.fixtures,
            normals=glyphs(cell.config.task_rows, cell.workpiece, placement.T_world_workpiece),
            file=self.file,
        )
        return replay.seen_at(shown.tolist())

    def label(self, number: int) -> str:
        """Return a scenario's number and varied parameters as text."""
        return f"{number}: {self.labels[number]}" if self.labels.get(number) else str(number)

    def obstructions(self, method: str, numbers: Sequence[int] | None = None) -> dict[int, Obstruction]:
        """Return the colliding body by scenario, for the scenarios in which a method failed.

        Args:
            method: The method.
            numbers: The scenarios to include; None: all.
        """
        plans, together = self.plans(method), dict[tuple[Hashable, Task | None], dict[int, int]]()
        for number in range(len(plans.status)) if numbers is None else numbers:
            if (target := obstruction_module.blocked_target(plans, number)) is not None:
                task = self.cells.task(number, int(plans.seam_of_targets[target]))
                together.setdefault((self.cells.key(number), task), {})[number] = target
        found = {}
        for (key, task), targets in together.items():
            found |= self._colliding_bodies(self.cells.cell(key), task, plans, targets)
        return {number: found[number] for number in sorted(found)}

    def _colliding_bodies(
        self, cell: Workcell, task: Task | None, plans: Plans, targets: dict[int, int]
    ) -> dict[int, Obstruction]:
        """Return the colliding body by scenario, for scenarios with the same workcell and task.

        Args:
            cell: The workcell.
            task: The task; None: the TCP's position.
            plans: The plans.
            targets: The failed target by scenario.
        """
        where = jax.tree.map(lambda *leaves: np.stack(leaves), *map(self.cells.placement, targets))
        s, t = np.array(list(targets)), np.array(list(targets.values()))
        goals = plans.target[s, t]
        if task is not None:
            goals = np.stack([self.cells.goals(n)[k, : task.numbers] for n, k in targets.items()])
        how = plans.before(s, t), goals, cell.config.settings, task
        return dict(zip(targets, obstruction_module.obstructions(cell.robot, cell.obstacle, where, *how), strict=True))


def open_replays(folder: str | Path) -> Replays:
    """Open the plans in the folder of a sweep or of a plan.

    Raises:
        InputError: If the folder contains no plans, if a file is missing or damaged, or if a plan does not match its
            configuration.
    """
    return recorded_replays(open_plans(folder))


def recorded_replays(found: PlanSet, plans: Callable[[str], Plans] | None = None) -> Replays:
    """Return the replays of saved plans.

    Args:
        found: The saved plans.
        plans: Function that returns a method's plans, if they have been read already; None: read them.

    Raises:
        InputError: As `open_replays`.
    """
    return Replays(str(found.folder), found.methods, plans or found.plans, cells_of(found), found.labels)


@runtime_checkable
class PlannedJob(Protocol):
    """Interface of a job with its result, such as `htcp_jax.plan` returns; the robot includes the tool."""

    job: PlanConfig
    robot: Robot
    workpiece: Workpiece
    scenario: Scenario
    plans: Plans


def replays_of(name: str, plan: PlannedJob, file: ShownFile | None = None) -> Replays:
    """Return the `Replays` of a plan in memory.

    Args:
        name: Name of the plan, for messages.
        plan: The plan.
        file: Proof of the file from which the motion is; None: it was planned.
    """
    cells = GivenCell(Workcell(plan.job, plan.robot, plan.workpiece), plan.scenario)
    return Replays(name, (plan.job.method,), lambda _: plan.plans, cells, file=file)


def _shown_targets(tracked: np.ndarray, path: int) -> np.ndarray:
    """Return a few tracked targets, on the tool path if possible; the first target if none is tracked."""
    shown = tracked[tracked >= path] if (tracked >= path).any() else tracked if tracked.size else np.zeros(1, int)
    return shown[np.linspace(0, len(shown) - 1, VIEW_SAMPLES).round().astype(int)]


def _scene_in_world(scene: ShownScene, robot: Robot, pose: ArmPose) -> ShownScene:
    """Return the scene with a moving part where it is in a pose, relative to the world, and the arm in that pose."""
    cloud, path, *meshes = (
        moved(each, pose.T_root) for each in (scene.cloud, scene.path, scene.triangles, scene.fixtures)
    )
    return ShownScene(cloud, path, shown_bodies(robot, [seen(pose, False)]), *meshes)


def _segment_samples(plans: Plans, target: int | None) -> Float[np.ndarray, "n N"]:
    """Return evenly spaced configurations on the segment to a target; copies of the start if the target is None."""
    if target is None:
        return np.repeat(plans.start, SEGMENT_SAMPLES, axis=0)
    x = np.concatenate([plans.before(0, target)[None], plans.via_points.on_segment(0, target), plans.x[:1, target]])
    place = np.linspace(0, len(x) - 1, SEGMENT_SAMPLES)
    return np.stack([np.interp(place, np.arange(len(x)), joint) for joint in x.T], axis=1)


def _narrow(target: int | None, seen: Witness) -> NarrowSegment | None:
    """Return the segment with the smallest guaranteed clearance; None if no segment is executable.

    Args:
        target: Target at the end of the segment; None: no segment.
        seen: Nearest points at samples of the segment.
    """
    if target is None:
        return None
    apart = np.linalg.norm(seen.arm - seen.cloud, axis=1)
    k = int(apart.argmin())
    return NarrowSegment(target, float(apart[k]), seen.body[k], seen.arm[k], seen.cloud[k])


def _witness(robot: Robot, obstacle: Obstacles, where: measured_rows.Placement, x: Float[np.ndarray, "T N"]) -> Witness:
    found = measured_rows.nearest_pairs(robot, obstacle, where, x)
    return Witness([robot.capsule_names[k] for k in found.body.tolist()], found.arm, found.other)


def _without_gaps(x: Float[np.ndarray, "T N"], start: Float[np.ndarray, "N"]) -> Float[np.ndarray, "T N"]:
    """Replace each unknown configuration by the last known one before it, at first by the start."""
    rows = np.concatenate([start[None], x])
    known = np.where(np.isnan(rows).any(axis=1), 0, np.arange(len(rows)))
    return rows[np.maximum.accumulate(known)][1:]


def _spans(numbers: list[int]) -> str:
    """Return sorted numbers as text with spans, such as "0 to 3, 7"."""
    parts, first = [], 0
    for k, number in enumerate(numbers):
        if k + 1 == len(numbers) or numbers[k + 1] != number + 1:
            parts.append(f"{numbers[first]}" if first == k else f"{numbers[first]} to {number}")
            first = k + 1
    return ", ".join(parts)
