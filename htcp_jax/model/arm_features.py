"""Points and directions of the arm by name: the TCP's, or those of a site or body of the model."""

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model.robot import ArmFrame, Robot
from htcp_jax.model.task_rows import Feature
from htcp_jax.types import Triple

TCP = ArmFrame("tcp", None, (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def frame_of(robot: Robot, name: str, what: str = "frame") -> ArmFrame:
    """Return the frame with that name. what: the word for it in messages. Raises InputError for an unknown name."""
    known = {frame.name: frame for frame in (*robot.frames, TCP)}
    if name not in known:
        raise InputError(f"no {what} {name!r} on {robot.name}; valid: {', '.join(sorted(known))}")
    return known[name]


def point_of(robot: Robot, name: str, offset_m: Triple = (0.0, 0.0, 0.0)) -> Feature:
    """Return the point at `offset_m` [m] in the frame with that name. Raises InputError for an unknown name."""
    frame = frame_of(robot, name, "point")
    place = np.array(frame.origin_m) + np.array(frame.columns).T @ np.array(offset_m)
    return Feature(frame.link, tuple(place.tolist()))


def axis_of(robot: Robot, name: str) -> Feature:
    """Return an axis of a frame as a direction: tcp.z, or reversed -tcp.z.

    Raises InputError for an unknown name, and for a letter other than x, y, z.
    """
    own, _, letter = name.lstrip("-").rpartition(".")
    if letter not in ("x", "y", "z"):
        raise InputError(f"the axis is {name!r}; it is a name and x, y or z, as in tcp.z")
    frame, sign = frame_of(robot, own, "axis"), -1.0 if name.startswith("-") else 1.0
    x, y, z = frame.columns["xyz".index(letter)]
    return Feature(frame.link, (sign * x, sign * y, sign * z), is_direction=True)
