"""Freezing of a model's joints at given values: the joint's motion is added to the body's pose in its parent."""

from collections.abc import Collection, Mapping
from pathlib import Path

import mujoco
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots.followers import followers
from htcp_jax.io.robots.frames import body_frame, shifted_frame, turned_frame
from htcp_jax.io.robots.mujoco_models import HINGE, SLIDE, joint_name

_UNITS = {HINGE: "rad", SLIDE: "m"}
ROUNDING = 1e-6  # difference between a stated value of a follower and the one that its master gives [rad or m]


def fix_joints(model: mujoco.MjModel, path: Path, values: Mapping[str, float], where: str = "") -> dict[int, float]:
    """Freeze hinges and slides of a compiled model in place, and the joints that follow them or are held.

    Args:
        model: The compiled model, which is modified.
        path: Its file, for messages.
        values: Values by the names of the joints [rad or m].
        where: The job's key that contains the values, for messages.

    Returns:
        Values of the frozen joints, by their indices in the model [rad or m].

    Raises:
        InputError: For an unknown joint, a value beyond the joint's limits or, by its constraint, a follower's, a joint
            that follows another one, unless its value is the one that its master's gives, and for followers that
            `followers` refuses.
    """
    known = {joint_name(model, j): j for j in range(model.njnt) if model.jnt_type[j] in _UNITS}
    for name, value in values.items():
        if name not in known:
            valid = ", ".join(known) or "none"
            raise InputError(f"{path}: {where}no hinge or slide joint {name!r}; valid: {valid}")
        j = known[name]
        if beyond := _beyond_limits(model, j, value):
            raise InputError(f"{path}: {where}{name}={value:g} {beyond}")
    fixed = {known[name]: float(value) for name, value in values.items()}
    for j, follower in followers(model, path).items():
        value = None
        if follower.is_held or follower.master in fixed:
            value = follower.at(fixed.get(follower.master, 0.0))
        rule = "is held" if follower.master < 0 else f"follows {joint_name(model, follower.master)}"
        if j in fixed and (value is None or abs(value - fixed[j]) > ROUNDING):
            remedy = "freeze that joint instead" if value is None else f"it is at {value:.6g}"
            raise InputError(f"{path}: {where}{joint_name(model, j)}={fixed[j]:g}: this joint {rule}; {remedy}")
        if value is not None:
            if beyond := _beyond_limits(model, j, value, ROUNDING):
                at = f" at {fixed[follower.master]:g}" if follower.master in fixed else ""
                raise InputError(f"{path}: {where}{joint_name(model, j)}={value:g} {beyond}; this joint {rule}{at}")
            fixed[j] = value
    for j in sorted(fixed):
        _fix(model, j, fixed[j])
    return fixed


def _beyond_limits(model: mujoco.MjModel, joint: int, value: float, rounding: float = 0.0) -> str:
    """Return the end of a message if a value is outside a joint's limits, else ""."""
    lower, upper = model.jnt_range[joint]
    if not model.jnt_limited[joint] or lower - rounding <= value <= upper + rounding:
        return ""
    return f"is outside the joint's limits, {lower:g} to {upper:g} {_UNITS[int(model.jnt_type[joint])]}"


def fix_followers(
    model: mujoco.MjModel, path: Path, joints: Collection[int], known: Mapping[int, float]
) -> dict[int, float]:
    """Freeze the joints among `joints` that follow another one and are not at zero while it is, in place.

    Args:
        model: The compiled model, which is modified.
        path: Its file, for messages.
        joints: Indices of joints that do not move, without those in `known`.
        known: Values of joints that are frozen already [rad or m], by index.

    Returns:
        Values of the frozen joints that differ from the initial configuration's, by index [rad or m].
    """
    drawn_at, pairs = model.qpos0[model.jnt_qposadr], followers(model, path)
    values = dict(enumerate(drawn_at.tolist())) | dict(known)
    for j, follower in pairs.items():
        values[j] = known[j] if j in known else follower.at(values.get(follower.master, 0.0))
    fixed = {j: values[j] for j in sorted(joints) if j in pairs and values[j] != drawn_at[j]}
    for j, value in fixed.items():
        _fix(model, j, value)
    return fixed


def _fix(model: mujoco.MjModel, joint: int, value: float) -> None:
    body, axis, anchor = int(model.jnt_bodyid[joint]), model.jnt_axis[joint], model.jnt_pos[joint]
    moved = value - model.qpos0[model.jnt_qposadr[joint]]
    if model.jnt_type[joint] == HINGE:
        T = shifted_frame(anchor) @ turned_frame(axis, moved) @ shifted_frame(-anchor)
    else:
        T = shifted_frame(moved * axis)
    pose = body_frame(model, body) @ T
    model.body_pos[body] = pose[:3, 3]
    mujoco.mju_mat2Quat(model.body_quat[body], pose[:3, :3].ravel())
    back = np.linalg.inv(T)
    for before in range(model.body_jntadr[body], joint):  # joints of the same body that move it first
        model.jnt_axis[before] = back[:3, :3] @ model.jnt_axis[before]
        model.jnt_pos[before] = (back @ [*model.jnt_pos[before], 1.0])[:3]
