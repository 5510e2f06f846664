"""Robot program of a saved plan, with the feed, the limits and the controller data of its job.

Example:
    made = program_of(open_plans("out/plan"), feed_of("20mm/s"))
    made.text("jbi-pulses", "WELD")
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import strict_model
from htcp_jax.io.robots import model_file
from htcp_jax.jobs import PlanConfig, build, config_file, feed
from htcp_jax.model import Robot, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans, manipulability, motion
from htcp_jax.runs import PlanSet
from htcp_jax.trajectory.arm_flags import arm_flags
from htcp_jax.trajectory.blends import motion_slack
from htcp_jax.trajectory.controller_data import ControllerData, JointGroups, Pulses, UserFrame
from htcp_jax.trajectory.formats.writers import FORMATS, format_of, program_text
from htcp_jax.trajectory.joint_torques import TORQUES_EVERY_S, PeakTorque, model_of, peak_torque, torques
from htcp_jax.trajectory.limits import MotionLimits, joint_limits, own_of
from htcp_jax.trajectory.program import Program, time_motion
from htcp_jax.trajectory.task_slack import with_rows
from htcp_jax.trajectory.timed_motion import TimedMotion

SECTION = "program."

__all__ = ["PlanProgram", "program_of", "requested_feed", "timed_plan", "with_program"]


class PlanProgram(NamedTuple):
    """The program of one plan, with its inputs."""

    program: Program
    robot: Robot  # with the job's tool
    job: PlanConfig
    limits: MotionLimits
    method: str
    x: Float[np.ndarray, "T N"]  # configurations at the targets [rad or m]
    goals: Float[np.ndarray, "T G"]  # the task's goals there [m]

    @property
    def manipulability(self) -> Float[np.ndarray, "T"]:
        """Smallest singular value of the task's Jacobian at each target [m/rad], see `motion.manipulability`."""
        task = build.task_of_job(self.job, self.robot)
        return manipulability.manipulability(self.robot, task, self.x, self.goals)

    def text(self, format: str, name: str, step_s: float | None = None) -> str:
        """Return the program's file.

        Args:
            format: Name in `writers.FORMATS`.
            name: Name of the program.
            step_s: Time between samples; None: see `writers.ProgramFormat`.

        Raises:
            InputError: As `program_text` does, for a step that the format does not support, and for tables of another
                arm.
        """
        timed = self.timed(format, step_s)
        return program_text(format, timed, self.controller(format, name, timed))

    def timed(self, format: str, step_s: float | None = None) -> TimedMotion:
        """Return the samples in the file.

        Raises:
            InputError: For a step that the format does not support.
        """
        own = format_of(format).step_s
        if own is None and step_s is not None:
            raise InputError(f"{format} holds the configurations that the motion is made of, whatever the step")
        if own is None:
            return self.program.at_configurations()
        if format == "urscript":
            own = self.job.program.control_step_s
        return self.program.timed(own if step_s is None else step_s)

    @property
    def peak_torque(self) -> PeakTorque | None:
        """Largest joint torque; None if the arm's model has no inertias."""
        if (model := model_of(self.job.robot)) is None:
            return None
        timed = self.program.timed(TORQUES_EVERY_S)
        torque = torques(model, dict(self.job.robot.locked))(timed.x, timed.velocity, timed.acceleration)
        return peak_torque(timed, torque, np.asarray(self.robot.effort))

    def controller(self, format: str, name: str, timed: TimedMotion) -> ControllerData:
        """Return the job's controller data for a format.

        Args:
            format: Name in `writers.FORMATS`.
            name: Name of the program.
            timed: Samples in the file.

        Raises:
            InputError: For tables and groups of another arm, for configurations whose arm configuration flags are
                unknown, and if the part moves for a format without external axes or without the groups that it needs.
        """
        if self.robot.part_moves and not format_of(format).external_axes:
            valid = ", ".join(name for name, each in FORMATS.items() if each.external_axes)
            raise InputError(f"{format} has no external axes, and the part moves; valid: {valid}")
        groups = self._groups()
        if self.robot.part_moves and format_of(format).by_group and groups is None:
            raise InputError(f"{format}: the part moves; program.groups gives the joints of robot, base and station")
        requested, speed = self.job.program, np.asarray(self.robot.speed, float)
        own, locked = self.job.robot, dict(self.job.robot.locked)
        return ControllerData(
            name.upper() if format.startswith("jbi") else name,
            self.robot.slides,
            speed=np.where(np.isfinite(speed), speed, self.limits.velocity),
            tool=requested.tool,
            user_frame=self._user_frame(timed) if format == "jbi" else None,
            pulses=self._pulses(),
            groups=groups,
            control_step_s=requested.control_step_s,
            in_file=model_file.joints_in_file(own.file, tuple(locked)) if self.robot.part_moves or locked else None,
            locked=locked,
        )

    def _user_frame(self, timed: TimedMotion) -> UserFrame | None:
        if (requested := self.job.program.user_frame) is None:
            return None
        flags = arm_flags(self.job.robot, self.robot, timed.x)
        T_world = np.asarray(jax.vmap(kinematics.tcp_pose, (None, 0))(self.robot, timed.x))
        if requested.on == "workpiece":
            T_world = np.linalg.inv(build.scene(self.job)[2].T_world_workpiece) @ T_world
        return UserFrame(requested.number, T_world, flags)

    def _groups(self) -> JointGroups | None:
        if (requested := self.job.program.groups) is None:
            return None
        own, named = self.robot.joint_names, [*requested.robot, *requested.base, *requested.station]
        if wrong := [name for name in named if name not in own]:
            raise InputError(f"program.groups: {wrong[0]!r} is no joint; valid: {', '.join(own)}")
        if odd := [name for name in own if named.count(name) != 1]:
            raise InputError(f"program.groups has {odd[0]!r} {named.count(odd[0])} times; each joint is in one group")
        groups = requested.robot, requested.base, requested.station
        return JointGroups(*(tuple(map(own.index, names)) for names in groups))

    def _pulses(self) -> Pulses | None:
        if (requested := self.job.program.pulses) is None:
            return None
        per_rad = own_of(self.robot, "program.pulses.per_rad", requested.per_rad)
        if not per_rad.all():
            raise InputError("program.pulses.per_rad has a joint with 0 pulses per radian")
        zero = own_of(self.robot, "program.pulses.zero_rad", requested.zero_rad)
        return Pulses(per_rad, np.zeros(len(per_rad)) if zero is None else zero, requested.source)


def program_of(
    found: PlanSet,
    feed_m_s: float,
    method: str | None = None,
    scenario: int = 0,
    *,
    retract: bool = True,
    overrides: Sequence[str] = (),
) -> PlanProgram:
    """Make the program of one plan, from home or the start to the last target.

    Args:
        found: The plans in a folder.
        feed_m_s: Feed of the TCP on the path.
        method: None: the first one.
        scenario: Number of the plan.
        retract: Append the motion back.
        overrides: Changes to the job's section `program`, as on the command line.

    Raises:
        InputError: For a plan that does not exist or is not completely executable, for overrides of other sections, and
            as `time_motion` and `joint_limits` do.
    """
    method = found.methods[0] if method is None else method
    plans = _plans(found, method, scenario)
    job = with_program(found.jobs[scenario], overrides)
    return program_of_plans(str(found.folder), plans, scenario, job, feed_m_s, method, retract=retract)


def program_of_plans(
    name: str, plans: Plans, scenario: int, job: PlanConfig, feed_m_s: float, method: str, *, retract: bool = True
) -> PlanProgram:
    """Make the program of a plan in memory.

    Args:
        name: Name of the plans, for messages.
        plans: The plans.
        scenario: Row of the plan.
        job: The scenario's job.
        feed_m_s: Feed of the TCP on the path.
        method: The method, for the result.
        retract: Append the motion back.

    Raises:
        InputError: For a plan that is not completely executable, and as `time_motion` and `joint_limits` do.
    """
    end = plans.outcome(scenario)
    if not end.can_be_driven:
        why = end.segment_status.message if end.executable < end.tracked else "the next one is not tracked"
        raise InputError(f"{name}: a motion leads to {end.executable} of {end.targets} targets; {why}")
    robot = robots.lengthen_tool(build.robot_of(job.robot, job.cell), job.robot.tool_extension_m)
    goals = build.scene(job)[2].goals if job.task else None
    return timed_plan(plans, scenario, job, robot, goals, feed_m_s, method, retract=retract)


def timed_plan(
    plans: Plans,
    scenario: int,
    job: PlanConfig,
    robot: Robot,
    goals: Float[np.ndarray, "T G"] | None,
    feed_m_s: float,
    method: str,
    *,
    retract: bool = True,
) -> PlanProgram:
    """Make the program of a completely executable scenario.

    Args:
        plans: The plans.
        scenario: Row of the plan.
        job: The scenario's job.
        robot: With the job's tool.
        goals: Goals of its scenario [m, rad], if the job has a task; else None.
        feed_m_s: Feed of the TCP on the path.
        method: The method, for the result.
        retract: Append the motion back.

    Raises:
        InputError: As `time_motion` and `joint_limits` do.
    """
    limits = joint_limits(robot, job.program)
    whole = motion.motion(plans, scenario, job.on_path, retract=retract)
    left = motion_slack(plans, scenario, whole, job.settings.tube_m, robot)
    if job.cell.self_collision:
        left = left._replace(clearance=0.5 * left.clearance)  # two bodies may move towards each other
    if goals is not None:
        left = with_rows(left, job, robot, whole, goals, plans.target[scenario])
    at = plans.x[scenario], plans.target[scenario] if goals is None else goals
    return PlanProgram(time_motion(robot, whole, left, limits, feed_m_s), robot, job, limits, method, *at)


def requested_feed(text: str | None, job: PlanConfig) -> float:
    """Return the required feed [m/s]: `text`, else the job's.

    Raises:
        InputError: If neither is given, and as `feed_of` does.
    """
    text = job.program.feed if text is None else text
    if text is None:
        raise InputError("no feed: --feed 20mm/s gives one, or program.feed of the job")
    return feed.feed_of(text)


def _plans(found: PlanSet, method: str, scenario: int) -> Plans:
    """Return the plans of a method.

    Raises:
        InputError: For one without plans, and for an unknown scenario.
    """
    if method not in found.methods:
        raise InputError(f"{found.folder} has no plans by {method!r}; there are {', '.join(found.methods)}")
    plans = found.plans(method)
    if not 0 <= scenario < len(plans.status):
        raise InputError(f"{found.folder} has no scenario {scenario}; there are 0 to {len(plans.status) - 1}")
    return plans


def with_program(job: PlanConfig, overrides: Sequence[str]) -> PlanConfig:
    """Return the job with overrides in section `program`.

    Raises:
        InputError: For keys outside it, and for invalid values.
    """
    raw = {"program": job.program.model_dump()}
    for override in overrides:
        key, value = config_file.parse_override(override)
        if not key.startswith(SECTION):
            raise InputError(f"--set {key}: the plan is saved; only keys of {SECTION}* can be changed")
        config_file.put_key(raw, key, value)
    return job.model_copy(update={"program": strict_model.validate_model(raw, PlanConfig, "--set").program})
