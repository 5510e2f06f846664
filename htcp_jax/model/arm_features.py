"""Frames, points and axes of the arm by name: tcp, or a site or body of the model."""

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model.robot import ArmFrame, Robot
from htcp_jax.model.task_rows import Feature
from htcp_jax.types import Triple

TCP = ArmFrame("tcp", None, (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def frame_of(robot: Robot, name: str, what: str = "frame") -> ArmFrame:
    """Return the arm's frame with the given name.

    Args:
        robot: The robot.
        name: Name of the frame: tcp, or a site or body of the model.
        what: Word for the frame in the error message.

    Raises:
        InputError: For an unknown name.
    """
    known = {frame.name: frame for frame in (*robot.frames, TCP)}
    if name not in known:
        raise InputError(f"no {what} {name!r} on {robot.name}; valid: {', '.join(sorted(known))}")
    return known[name]


def point_of(robot: Robot, name: str, offset_m: Triple = (0.0, 0.0, 0.0)) -> Feature:
    """Return a point of the arm as a feature.

    Args:
        robot: The robot.
        name: Name of a frame: tcp, or a site or body of the model.
        offset_m: Position of the point in this frame [m].

    Raises:
        InputError: For an unknown name.
    """
    frame = frame_of(robot, name, "point")
    place = np.array(frame.origin_m) + np.array(frame.columns).T @ np.array(offset_m)
    return Feature(frame.link, tuple(place.tolist()))


def axis_of(robot: Robot, name: str) -> Feature:
    """Return an axis of a frame as a feature, for example tcp.z, or -tcp.z for the opposite direction.

    Args:
        robot: The robot.
        name: Name of the frame, a dot, and x, y or z; a leading minus reverses the axis.

    Raises:
        InputError: For an unknown frame, and for an axis other than x, y, z.
    """
    own, _, letter = name.lstrip("-").rpartition(".")
    if letter not in ("x", "y", "z"):
        raise InputError(f"the axis is {name!r}; it must be like tcp.z: a frame's name, a dot and x, y or z")
    frame, sign = frame_of(robot, own, "axis"), -1.0 if name.startswith("-") else 1.0
    x, y, z = frame.columns["xyz".index(letter)]
    return Feature(frame.link, (sign * x, sign * y, sign * z), is_direction=True)
