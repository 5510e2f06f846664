"""Robot program of a saved plan, with the feed, the limits and the controller data of its job.

```python
made = program_of(open_plans("out/plan"), feed_of("20mm/s"))
made.text("jbi-pulses", "WELD")
```
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.motions import coupled_axes, encoder_scale, joint_groups
from htcp_jax.io.robots import joints_in_file
from htcp_jax.jobs import build, tasks_of_targets
from htcp_jax.model import Robot, joints_between, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans, manipulability, motion
from htcp_jax.runs import PlanSet
from htcp_jax.spec import PlanConfig, config_file, feed, split_name, strict_model
from htcp_jax.spec import tool as tools
from htcp_jax.trajectory.arm_flags import arm_flags
from htcp_jax.trajectory.blends import motion_slack
from htcp_jax.trajectory.controller_data import ControllerData, PlannedTcp, UserFrame
from htcp_jax.trajectory.deviation import FileMotion
from htcp_jax.trajectory.exact_corners import with_exact_corners
from htcp_jax.trajectory.file_motion import MaxPoints, file_motion
from htcp_jax.trajectory.formats.parts import ProgramFile
from htcp_jax.trajectory.formats.writers import FORMATS, format_of, program_files, program_text
from htcp_jax.trajectory.joint_torques import (
    TORQUES_EVERY_S,
    PeakTorque,
    model_of,
    peak_torque,
    torques,
)
from htcp_jax.trajectory.limits import MotionLimits, joint_limits
from htcp_jax.trajectory.limits_file import limits_of_job
from htcp_jax.trajectory.near_part import near_part_speeds
from htcp_jax.trajectory.program import Program, time_motion
from htcp_jax.trajectory.seam_spans import process_outputs, seam_spans
from htcp_jax.trajectory.task_slack import with_rows
from htcp_jax.trajectory.timed_motion import TimedMotion

SECTION = "program."
UNCOUPLED = "jbi-pulses", "krl", "ls", "urscript"  # formats that do not support `program.coupled`

Feeds = float | tuple[float, ...]  # feed rate of the TCP on the path [m/s]: one, or one for each seam

__all__ = ["UNCOUPLED", "PlanProgram", "program_of", "requested_feed", "requested_feeds", "timed_plan", "with_program"]


class PlanProgram(NamedTuple):
    """Robot program of one plan, with the inputs from which it was made."""

    program: Program
    robot: Robot  # the robot with the job's tool
    job: PlanConfig
    limits: MotionLimits
    method: str
    x: Float[np.ndarray, "T N"]  # configurations at the targets [rad or m]
    goals: Float[np.ndarray, "T G"]  # the task's goals at the targets [m]
    seam_begins: tuple[int, ...] = ()  # first targets of the second and of each later seam
    seam_feeds: Mapping[str, float] = MappingProxyType({})  # by the seam's name [m/s]; empty: one feed

    @property
    def manipulability(self) -> Float[np.ndarray, "T"]:
        """Smallest singular value of the task's Jacobian at each target [m/rad], see `motion.manipulability`."""
        seam = np.searchsorted(self.seam_begins, np.arange(len(self.x)), "right")
        tasks = [(each.task, each.here) for each in tasks_of_targets(self.job, self.robot, seam)]
        return manipulability.along(self.robot, tasks, self.x, self.goals)

    @property
    def stops_within_seams(self) -> int:
        """Number of stops on the path, other than at the ends of seams."""
        counts = np.diff([0, *self.seam_begins, len(self.x)])
        pieces = sum(blend.on_process for blend in self.program.blends)
        return max(0, pieces - int((counts > 1).sum()))

    def text(self, format: str, name: str, step_s: float | None = None, max_points: MaxPoints = None) -> str:
        """Return the text of the program's file.

        Args:
            format: Name of the format in `writers.FORMATS`.
            name: Name of the program.
            step_s: Time between samples; None: the format's default, see `writers.ProgramFormat`.
            max_points: Maximum number of configurations, or "fewest", see `file_motion`; None: those of the time step.

        Raises:
            InputError: If `in_file`, `program_text` or `controller` raises it.
        """
        timed = self.timed(format, step_s, max_points)
        return program_text(format, timed, self.controller(format, name, timed))

    def files(self, format: str, name: str, file: FileMotion) -> list[ProgramFile]:
        """Return the program's files: one, or a main file and its parts, see `writers.program_files`.

        Args:
            format: Name of the format in `writers.FORMATS`.
            name: Name of the program.
            file: The configurations, see `in_file`.

        Raises:
            InputError: If `program_files` or `controller` raises it.
        """
        timed = self._with_axes(format, file.timed)
        if format_of(format).whole_corners:
            timed = with_exact_corners(self.robot, timed, self.job.settings.tube_m)
        return program_files(format, timed, self.controller(format, name, timed))

    def timed(self, format: str, step_s: float | None = None, max_points: MaxPoints = None) -> TimedMotion:
        """Return the samples of the motion that a format contains, see `text`.

        Raises:
            InputError: If `in_file` raises it.
        """
        return self._with_axes(format, self.in_file(format, step_s, max_points).timed)

    def in_file(self, format: str, step_s: float | None = None, max_points: MaxPoints = None) -> FileMotion:
        """Return the configurations that a format contains, without joints that follow others, see `file_motion`.

        Raises:
            InputError: If `file_motion` raises it.
        """
        return file_motion(self.robot, self.program, self.job, format, step_s, max_points)

    def _axes(self, format: str) -> str:
        """Return the joints that a format contains: `commanded`, or `all`.

        Raises:
            InputError: If the job requests joints that the format does not support.
        """
        valid, requested = format_of(format).axes, self.job.program.axes
        if self.robot.coupling is None or requested is None:
            return valid[0]
        if requested not in valid:
            raise InputError(f"{format} does not support program.axes: {requested}; valid: {', '.join(valid)}")
        return requested

    def _with_axes(self, format: str, timed: TimedMotion) -> TimedMotion:
        """Return the samples with the joints that follow others, after all others, if the format contains them."""
        if (own := self.robot.coupling) is None or self._axes(format) == "commanded":
            return timed
        rows = list(self.robot.followers)
        states = {"x": own.positions(timed.x), "velocity": own.rates(timed.velocity)}
        states["acceleration"] = own.rates(timed.acceleration)
        more = {name: np.hstack([getattr(timed, name), every[:, rows]]) for name, every in states.items()}
        return timed._replace(**more, joint_names=(*timed.joint_names, *(own.joint_names[j] for j in rows)))

    @property
    def peak_torque(self) -> PeakTorque | None:
        """Largest joint torque; None if the arm's model has no inertias."""
        if (model := model_of(self.job.robot, self.job.tree)) is None:
            return None
        timed = self.program.timed(self.program.long_step_s(TORQUES_EVERY_S))
        torque = torques(model, dict(self.job.robot.locked), self.robot.coupling)(
            timed.x, timed.velocity, timed.acceleration
        )
        return peak_torque(timed, torque, np.asarray(self.robot.effort))

    def controller(self, format: str, name: str, timed: TimedMotion) -> ControllerData:
        """Return the job's controller data for a format.

        Args:
            format: Name of the format in `writers.FORMATS`.
            name: Name of the program.
            timed: Samples in the file.

        Raises:
            InputError: If pulses, groups or coupled axes do not match the arm's joints, or if a configuration's arm
                configuration flags are unknown. If the part moves, also if the format has no external axes, or if the
                job lacks groups that the format needs.
        """
        if self.robot.part_moves and not format_of(format).external_axes:
            valid = ", ".join(name for name, each in FORMATS.items() if each.external_axes)
            raise InputError(f"{format} has no external axes, which a moving part needs; valid: {valid}")
        groups = joint_groups(self.job, self.robot)
        if self.robot.part_moves and format_of(format).by_group and groups is None:
            raise InputError(f"{format}: the part moves; set program.groups to the joints of robot, base and station")
        requested, speed = self.job.program, np.asarray(self.robot.speed, float)
        source, followers = self.job.tree or self.job.robot.file, self.robot.followers
        in_file = (
            joints_in_file(source, timed.joint_names, dict(self.job.robot.locked)) if format == "keyframes" else None
        )
        return ControllerData(
            name.upper() if format.startswith("jbi") or format == "ls" else name,
            (*self.robot.sliding, *(self.robot.slides[j] for j in followers))[: len(timed.joint_names)],
            speed=np.where(np.isfinite(speed), speed, self.limits.velocity),
            tool=requested.tool,
            tool_name=requested.tool_name,
            tcp=planned_tcp(self.job, self.robot),
            coupled=self._coupled(format),
            user_frame=self._user_frame(timed) if format == "jbi" else None,
            pulses=encoder_scale(self.job, self.robot),
            groups=groups,
            control_step_s=requested.control_step_s,
            in_file=in_file and in_file.order,
            locked=in_file.locked if in_file else dict(self.job.robot.locked),
            seams=seam_spans(self.job, timed, self.seam_begins),
            process=process_outputs(self.job, format),
            j3_from=requested.j3_from,
        )

    def _user_frame(self, timed: TimedMotion) -> UserFrame | None:
        flags = arm_flags(self.job.robot, self.robot, timed.x)  # first, as no other input helps an arm without them
        if (requested := self.job.program.user_frame) is None:
            return None
        T_world = np.asarray(jax.vmap(kinematics.tcp_pose, (None, 0))(self.robot, timed.x))
        if requested.on == "workpiece":
            T_world = np.linalg.inv(build.scene(self.job)[2].T_world_workpiece) @ T_world
        return UserFrame(requested.number, T_world, flags)

    def _coupled(self, format: str) -> tuple[tuple[int, int], ...]:
        requested = self.job.program.coupled
        if requested and format in UNCOUPLED:
            raise InputError(f"{format} does not support program.coupled; remove the key, or use the format rapid")
        found = coupled_axes(self.job, self.robot)
        for axis, joint in requested:
            if between := self._followers_between(joint, axis):
                raise InputError(
                    f"program.coupled: the arm's model has this coupling: {between} follows {joint}; remove the key"
                )
        return found

    def _followers_between(self, first: str, last: str) -> str:
        """Return the names of the joints that follow the joint `first` between it and the joint `last`."""
        names = self.robot.all_joint_names
        if self.robot.coupling is None or not {first, last} <= {*names}:
            return ""
        between, _ = joints_between(self.robot.parents, names.index(last), names.index(first))
        with_first = np.asarray(self.robot.coupling.factors)[:, self.robot.joint_names.index(first)] != 0
        return ", ".join(names[j] for j in between if j in self.robot.followers and with_first[j])


def program_of(
    found: PlanSet,
    feed_m_s: Feeds,
    method: str | None = None,
    scenario: int = 0,
    *,
    retract: bool = True,
    overrides: Sequence[str] = (),
) -> PlanProgram:
    """Return the robot program of a saved plan, from home or the start to the last target.

    Args:
        found: The plans in a folder.
        feed_m_s: Feed rate of the TCP on the path; one for each seam, or one for all.
        method: Name of the method; None: the first method with plans.
        scenario: Number of the scenario.
        retract: True to append the retraction.
        overrides: Changes to the job's section `program`, as on the command line.

    Raises:
        InputError: If the plan does not exist or is not completely executable, if an override changes another section,
            or if `time_motion` or `joint_limits` raises it.
    """
    method = found.methods[0] if method is None else method
    plans = _plans(found, method, scenario)
    job = with_program(found.jobs[scenario], overrides)
    return program_of_plans(str(found.folder), plans, scenario, job, feed_m_s, method, retract=retract)


def program_of_plans(
    name: str, plans: Plans, scenario: int, job: PlanConfig, feed_m_s: Feeds, method: str, *, retract: bool = True
) -> PlanProgram:
    """Return the robot program of a plan in memory.

    Args:
        name: Name of the plans, for messages.
        plans: The plans.
        scenario: Row of the plan.
        job: The scenario's job.
        feed_m_s: Feed rate of the TCP on the path; one for each seam, or one for all.
        method: Name of the method, for the result.
        retract: True to append the retraction.

    Raises:
        InputError: If the plan is not completely executable, or if `time_motion` or `joint_limits` raises it.
    """
    end = plans.outcome(scenario)
    if not end.can_be_driven:
        if lacking := _missing_seams(plans, scenario, job):
            raise InputError(f"{name}: the plan lacks {lacking}; remove it from the job and plan the job again")
        why = end.segment_status.message if end.executable < end.tracked else "the next one is not tracked"
        raise InputError(f"{name}: the motion leads to only {end.executable} of {end.targets} targets; {why}")
    robot = robots.lengthen_tool(build.robot_of(job.robot, job.cell, job.tree), job.robot.tool_extension_m)
    goals = build.scene(job)[2].goals if job.task_rows else None
    limits = joint_limits(robot, job.program, limits_of_job(job, robot))
    return timed_plan(plans, scenario, job, robot, goals, limits, feed_m_s, method, retract=retract)


def _missing_seams(plans: Plans, scenario: int, job: PlanConfig) -> str:
    """Return text with the names of the seams that a plan does not complete; "" for a job of one seam."""
    parts = np.split(plans.executable[scenario], plans.seam_begins)
    seams = job.workpiece.seams if plans.seam_begins else ()
    return ", ".join(f"seam {seam.name!r}" for seam, done in zip(seams, parts, strict=False) if not done.all())


def timed_plan(
    plans: Plans,
    scenario: int,
    job: PlanConfig,
    robot: Robot,
    goals: Float[np.ndarray, "T G"] | None,
    limits: MotionLimits,
    feed_m_s: Feeds,
    method: str,
    *,
    retract: bool = True,
) -> PlanProgram:
    """Return the robot program of a plan that is completely executable.

    Args:
        plans: The plans.
        scenario: Row of the plan.
        job: The scenario's job.
        robot: The robot with the job's tool.
        goals: Goals of the scenario [m, rad]; None if the job has no task.
        limits: The robot's limits, see `joint_limits`.
        feed_m_s: Feed rate of the TCP on the path; one for each seam, or one for all.
        method: Name of the method, for the result.
        retract: True to append the retraction.

    Raises:
        InputError: If `time_motion` raises it.
    """
    whole = motion.motion(plans, scenario, job.on_path, retract=retract)
    left = motion_slack(plans, scenario, whole, job.settings.tube_m, robot)
    if job.cell.self_collision:
        left = left._replace(clearance=0.5 * left.clearance)  # two bodies may move towards each other
    if goals is not None:
        tasks = tasks_of_targets(job, robot, plans.seam_of_targets)
        left = with_rows(left, tasks, robot, whole, goals, plans.target[scenario])
    at = plans.x[scenario], plans.target[scenario] if goals is None else goals
    by_seam = () if isinstance(feed_m_s, float) else feed_m_s
    feed = np.array(by_seam)[plans.seam_of_targets] if by_seam else feed_m_s
    made = time_motion(robot, whole, left, limits, feed, near_part_speeds(job))
    feeds = dict(zip((seam.name for seam in job.workpiece.seams), by_seam, strict=False))
    return PlanProgram(made, robot, job, limits, method, *at, plans.seam_begins, feeds)


def requested_feed(text: str | None, job: PlanConfig) -> float:
    """Return the required feed rate [m/s], from `text` if it is not None, else from the job.

    Raises:
        InputError: If both are missing, or if `text` is not a valid feed rate.
    """
    text = job.program.feed if text is None else text
    if text is None:
        raise InputError("the feed rate is missing: pass --feed 20mm/s, or set program.feed in the job")
    return feed.feed_of(text)


def requested_feeds(text: str | None, job: PlanConfig) -> Feeds:
    """Return the required feed rate [m/s]: from `text` if it is not None, else each seam's own, else the job's.

    Raises:
        InputError: If it is missing, or if `text` is not a valid feed rate.
    """
    seams = job.workpiece.seams
    if text is not None or all(seam.feed is None for seam in seams):
        return requested_feed(text, job)
    stated = job.stated_feeds
    for seam, own in zip(seams, stated, strict=True):
        if own is None:
            remedy = "set program.feed in the job, or feed in the seam, or pass --feed 20mm/s"
            raise InputError(f"the feed rate of the seam {seam.name!r} is missing: {remedy}")
    return tuple(requested_feed(own, job) for own in stated)


def _plans(found: PlanSet, method: str, scenario: int) -> Plans:
    """Return a method's plans.

    Raises:
        InputError: If the method has no plans, or if the scenario is unknown.
    """
    if method not in found.methods:
        raise InputError(f"{found.folder} has no plans by {method!r}; valid: {', '.join(found.methods)}")
    plans = found.plans(method)
    if not 0 <= scenario < len(plans.status):
        raise InputError(f"{found.folder} has no scenario {scenario}; valid: 0 to {len(plans.status) - 1}")
    return plans


def with_program(job: PlanConfig, overrides: Sequence[str]) -> PlanConfig:
    """Return the job with overrides of its section `program`.

    Raises:
        InputError: If a key is in another section, or if a value is invalid.
    """
    raw = {"program": job.program.model_dump()}
    for override in overrides:
        key, value = config_file.parse_override(override)
        if not key.startswith(SECTION):
            raise InputError(f"--set {key}: the plan is saved; only keys of {SECTION}* can be changed")
        config_file.put_key(raw, key, value)
    return job.model_copy(update={"program": strict_model.validate_model(raw, PlanConfig, "--set").program})


def planned_tcp(job: PlanConfig, robot: Robot) -> PlannedTcp:
    """Return the TCP relative to the frame that carries the job's tool, else relative to the last joint's frame."""
    link, T_link_tcp = robot.tcp_link, np.asarray(robot.T_link_tcp, float)
    if (tool := job.robot.tool) is not None:
        longer = tools.pose((0.0, 0.0, job.robot.tool_extension_m), (0.0, 0.0, 0.0))
        return PlannedTcp("the flange", tools.pose(tool.tip_m, tool.tip_rpy_rad) @ longer)
    if job.tool.model is not None:
        names = job.tool.parent, split_name(job.tool.parent)[1]
        carrier = next((frame for frame in robot.frames if frame.name in names and frame.link == link), None)
        if carrier is not None:
            T = np.eye(4)
            T[:3] = np.column_stack([*carrier.columns, carrier.origin_m])
            return PlannedTcp(f"{carrier.name}, which carries the tool", np.linalg.inv(T) @ T_link_tcp)
    return PlannedTcp(robot.all_joint_names[link], T_link_tcp)
