"""Controller data of a job that files with joint values need."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots import joints_in_file
from htcp_jax.model import Robot
from htcp_jax.spec import PlanConfig


class EncoderScale(NamedTuple):
    """Encoder scale of a controller."""

    per_unit: Float[np.ndarray, "N"]  # pulses [1/rad or 1/m]; negative for an opposite direction of rotation
    zero: Float[np.ndarray, "N"]  # joint values at 0 pulses [rad or m]
    source: str = ""  # origin of the scale, as text


class JointGroups(NamedTuple):
    """Indices of a motion's joints in each group of the controller, in the controller's order."""

    robot: tuple[int, ...]
    base: tuple[int, ...] = ()  # axes that carry the robot
    station: tuple[int, ...] = ()  # axes of the positioner

    @property
    def external(self) -> tuple[int, ...]:
        """Indices of all joints that are not in the robot's group."""
        return self.base + self.station


class JobController(NamedTuple):
    """Controller data of a job that a file's joint values need."""

    coupled: tuple[tuple[int, int], ...] = ()  # indices of a coupled axis and of the joint that is added to it
    pulses: EncoderScale | None = None
    groups: JointGroups | None = None  # None: all joints are the robot's
    # index of each joint of the model file, over the robot's joints, its followers and `locked`; None: same order
    in_file: tuple[int, ...] | None = None
    locked: Mapping[str, float] = MappingProxyType({})  # values of joints that do not move [rad or m], by name
    j3_from: str = "upper_arm"  # where joint 3 of a FANUC arm is counted from: "upper_arm" or "horizontal"


def controller_of(job: PlanConfig, robot: Robot, *, of_model: bool = True) -> JobController:
    """Return the controller data of a job.

    Args:
        job: The job.
        robot: Its robot.
        of_model: True to read the order of the joints from the robot's model file, for MuJoCo key frames.

    Raises:
        InputError: If the job's section `program` names a joint that the robot does not command, or has another number
            of pulses than the robot has joints, and for a model file that cannot be read.
    """
    in_file: tuple[int, ...] | None = None
    locked: Mapping[str, float] = dict(job.robot.locked)
    if of_model:
        every_name = [*robot.joint_names, *(robot.all_joint_names[j] for j in robot.followers)]
        found = joints_in_file(job.tree or job.robot.file, every_name, dict(locked))
        in_file, locked = found.order, found.locked
    own = coupled_axes(job, robot), encoder_scale(job, robot), joint_groups(job, robot)
    return JobController(*own, in_file, locked, job.program.j3_from)


def encoder_scale(job: PlanConfig, robot: Robot) -> EncoderScale | None:
    """Return the encoder scale in a job's section `program`; None if it has none.

    Args:
        job: The job.
        robot: Its robot.

    Raises:
        InputError: For another number of values than the robot has joints, and for 0 pulses per unit.
    """
    if (stated := job.program.pulses) is None:
        return None
    per_unit = values_per_joint(robot, "program.pulses.per_rad", stated.per_rad)
    zero = values_per_joint(robot, "program.pulses.zero_rad", stated.zero_rad)
    if not all(stated.per_rad):
        raise InputError("program.pulses.per_rad must not be 0 for any joint")
    return EncoderScale(per_unit, np.zeros(len(per_unit)) if zero is None else zero, stated.source)


def values_per_joint(robot: Robot, key: str, values: tuple[float, ...] | None) -> Float[np.ndarray, "N"] | None:
    """Return a job's list of one number per joint as an array [unit of the key]; None if the job has no list.

    Args:
        robot: The robot.
        key: The list's dotted key, for messages.
        values: The list [rad or m, or per s]; None: the job has no list.

    Raises:
        InputError: If the list's length is not the number of joints.
    """
    if values is None:
        return None
    if len(values) != len(robot.joint_names):
        raise InputError(f"{key} has {len(values)} values, but the robot {robot.name} has {robot.counted_joints}")
    return np.array(values)


def coupled_axes(job: PlanConfig, robot: Robot) -> tuple[tuple[int, int], ...]:
    """Return the indices of each coupled axis in a job's section `program`, and of the joint that is added to it.

    Args:
        job: The job.
        robot: Its robot.

    Raises:
        InputError: For a joint that the robot does not command.
    """
    return tuple(
        (_index(robot, "coupled", axis), _index(robot, "coupled", joint)) for axis, joint in job.program.coupled
    )


def joint_groups(job: PlanConfig, robot: Robot) -> JointGroups | None:
    """Return the joints in each group of a job's controller; None if its section `program` has no groups.

    Args:
        job: The job.
        robot: Its robot.

    Raises:
        InputError: For a joint that the robot does not command, and for one that is not in exactly one group.
    """
    if (named := job.program.groups) is None:
        return None
    names = named.robot, named.base, named.station
    groups = JointGroups(*(tuple(_index(robot, "groups", name) for name in own) for own in names))
    every = [*groups.robot, *groups.external]
    for k, name in enumerate(robot.joint_names):
        if (count := every.count(k)) != 1:
            raise InputError(f"program.groups has {name!r} {count} times; each joint must be in one group")
    return groups


def _index(robot: Robot, key: str, name: str) -> int:
    """Return the index of a joint that a key of the section `program` names.

    Raises:
        InputError: If the robot does not command the joint.
    """
    if name not in robot.joint_names:
        what = "follows another joint" if name in robot.all_joint_names else "is not a joint"
        raise InputError(f"program.{key}: {name!r} {what}; valid: {', '.join(robot.joint_names)}")
    return robot.joint_names.index(name)
