"""Joint limits from a file in the form of MoveIt's and ROS's joint_limits.yaml."""

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
    """Read the limits of an arm's joints, as changes of a job's section `program`.

    The file maps `joint_limits` to joints by name, and these to `max_velocity`, `max_acceleration` and `max_jerk`
    [rad or m per s, s^2, s^3]; `has_velocity_limits: false` and such remove one. Other joints and scaling factors are
    ignored. A joint without a velocity or acceleration keeps the model's.

    Args:
        file: The file.
        robot: The arm.

    Returns:
        "program.velocity=[...]" and such, for each kind that the file states.

    Raises:
        InputError: For another file, and for a joint whose limit is stated neither there nor by the model although
            another's is.
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
            raise InputError(f"{file}: max_{kind} of joint {name} is missing, and the model states none")
        found.append(f"program.{kind}=[{', '.join(repr(float(value)) for value in values)}]")
    if not found:
        raise InputError(f"{file} limits no joint of {robot.name}: it needs max_velocity, max_acceleration or max_jerk")
    return found


def _joints(file: str | Path, robot: Robot) -> dict[str, dict[str, Any]]:
    """Return the arm's joints that the file describes."""
    joints = strict_yaml.read_yaml(file).get(SECTION)
    if not isinstance(joints, dict):
        raise InputError(f"{file}: the mapping {SECTION} is missing, as in MoveIt's joint_limits.yaml")
    known = {name: joints[name] for name in robot.joint_names if name in joints}
    if not known:
        raise InputError(f"{file}: no joint of {robot.name} is listed; its joints: {', '.join(robot.joint_names)}")
    for name in (name for name, limits in known.items() if not isinstance(limits, dict)):
        raise InputError(f"{file}: joint {name} is no mapping")
    return known


def _limit(file: str | Path, joint: str, kind: str, limits: dict[str, Any]) -> float | None:
    value = limits.get(f"max_{kind}")
    if value is None or limits.get(f"has_{kind}_limits", True) is False:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise InputError(f"{file}: max_{kind} of joint {joint} is {value!r}; a positive number is needed")
    return float(value)
