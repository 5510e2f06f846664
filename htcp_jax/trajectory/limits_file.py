"""Joint limits from a file in the format of MoveIt's and ROS's joint_limits.yaml."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io import strict_yaml
from htcp_jax.model import Robot
from htcp_jax.trajectory.limits import KINDS

SECTION = "joint_limits"


def limits_overrides(file: str | Path, robot: Robot) -> list[str]:
    """Return the joint limits in a file as overrides of a job's section `program`.

    In the file, `joint_limits` contains joints by name, each with `max_velocity`, `max_acceleration` and `max_jerk`
    [rad or m per s, s^2, s^3]. Keys such as `has_velocity_limits: false` switch a limit off. Joints of other arms and
    scaling factors are ignored. A joint without a velocity or acceleration limit in the file gets the model's limit.

    Args:
        file: The file.
        robot: The arm.

    Returns:
        Overrides such as "program.velocity=[...]", one for each kind of limit in the file.

    Raises:
        InputError: If the file has another format, or if it limits some joints, but neither the file nor the model
            limits another joint.
    """
    own = {"velocity": np.asarray(robot.speed, float), "acceleration": np.asarray(robot.acceleration, float)}
    unknown, found = np.full(len(robot.joint_names), np.nan), []
    known = _joints(file, robot)
    for kind in KINDS:
        given = [_limit(file, name, kind, known.get(name, {})) for name in robot.joint_names]
        if all(value is None for value in given):
            continue
        values = [own.get(kind, unknown)[k] if value is None else value for k, value in enumerate(given)]
        for name in (name for name, value in zip(robot.joint_names, values, strict=True) if not math.isfinite(value)):
            raise InputError(f"{file}: max_{kind} of joint {name} is missing here and in the model")
        found.append(f"program.{kind}=[{', '.join(repr(float(value)) for value in values)}]")
    if not found:
        raise InputError(f"{file} limits no joint of {robot.name}; add max_velocity, max_acceleration or max_jerk")
    return found


def _joints(file: str | Path, robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the file's entries on the arm's joints, by name."""
    joints = strict_yaml.read_yaml(file).get(SECTION)
    if not isinstance(joints, dict):
        raise InputError(f"{file}: the mapping {SECTION} is missing, as in MoveIt's joint_limits.yaml")
    known = {name: joints[name] for name in robot.joint_names if name in joints}
    if not known:
        raise InputError(f"{file}: no joint of {robot.name} is listed; valid: {', '.join(robot.joint_names)}")
    for name in (name for name, limits in known.items() if not isinstance(limits, dict)):
        raise InputError(f"{file}: joint {name} must be a mapping, such as {{max_velocity: 2.0}}")
    return known


def _limit(file: str | Path, joint: str, kind: str, limits: dict[str, Any]) -> float | None:
    value = limits.get(f"max_{kind}")
    if value is None or limits.get(f"has_{kind}_limits", True) is False:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise InputError(f"{file}: max_{kind} of joint {joint} is {value!r}; it must be a positive number")
    return float(value)
