"""MuJoCo models: compilation without masses and messages, and lookups by name, body and joint."""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from htcp_jax.errors import InputError

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
LEAST_EIGENVALUE = 1e-14  # MuJoCo refuses an inertia with a smaller one, negated [kg m2]


@contextmanager
def no_log() -> Iterator[None]:
    """Prevent MuJoCo from writing its warnings into MUJOCO_LOG.TXT in the working folder."""
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


def delete_all(spec: mujoco.MjSpec, *elements: list) -> None:
    """Delete lists of elements from a model, one list after the other; its tuples must come before its geoms."""
    for each in elements:
        for element in list(each):
            spec.delete(element)


def set_massless(spec: mujoco.MjSpec) -> None:
    """Let a model be compiled without masses, which kinematics does not need but MuJoCo requires."""
    spec.compiler.fusestatic = False  # keep the fixed links of a URDF, as the TCP may be one of them
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True


def forget_impossible_inertias(spec: mujoco.MjSpec) -> list[str]:
    """Remove masses and inertias with a negative eigenvalue, which MuJoCo refuses, and return the bodies' names."""
    found = []
    for body in spec.bodies:
        xx, yy, zz, xy, xz, yz = body.fullinertia
        if np.linalg.eigvalsh(np.nan_to_num([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))[0] < -LEAST_EIGENVALUE:
            body.explicitinertial, body.mass, body.fullinertia = False, 0.0, [math.nan, 0, 0, 0, 0, 0]
            found.append(body.name)
    return found


def compile_unchecked(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile a model whose shapes refer to no files, whatever the ranges of its joints.

    Raises:
        InputError: For a model that MuJoCo refuses.
    """
    try:
        with no_log():
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise unreadable_model(path, error) from None


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile a model without masses, whose shapes refer to no files.

    Raises:
        InputError: For a model that MuJoCo refuses, and for a descending or nan range of a joint, which MuJoCo itself
            treats as no limit.
    """
    for joint in spec.joints:
        lower, upper = joint.range
        requested = joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE and (lower, upper) != (0, 0)
        if requested and not lower < upper:
            raise InputError(
                f"{path}: joint {joint.name!r} has range {lower:g} to {upper:g}; the lower limit must come first"
            )
    set_massless(spec)
    return compile_unchecked(spec, path)


def unreadable_model(path: Path, error: Exception) -> InputError:
    """Return an InputError with MuJoCo's message in one line."""
    reason = re.sub(r",? line \d+$", "", " ".join(str(error).split()))  # a line of the sanitised text, not of the file
    return InputError(f"{path}: not a model that MuJoCo can read: {reason}")


def model_name(model: mujoco.MjModel) -> str:
    """Return the model's own name."""
    return model.names.partition(b"\0")[0].decode(errors="replace")


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return the body's own name, or body1, body2, ... by its index in the model."""
    return model.body(body).name or f"body{body}"


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return the joint's own name, or joint1, joint2, ... by its index in the model."""
    return model.joint(joint).name or f"joint{joint + 1}"


def text_of(model: mujoco.MjModel, name: str) -> str | None:
    """Return the <custom><text> `name`; None if the model has none."""
    text = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, name)
    if text < 0:
        return None
    start, size = model.text_adr[text], model.text_size[text]
    return model.text_data[start : start + size].rstrip(b"\0").decode(errors="replace")


def has_numeric(model: mujoco.MjModel, name: str) -> bool:
    """Return True if the model has a <custom><numeric> `name`."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name) >= 0


def joint_numbers(model: mujoco.MjModel, path: Path, name: str, default: float = math.inf) -> np.ndarray:
    """Return the <custom><numeric> `name`, (N,), one value per joint.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        name: Name of the <numeric>.
        default: Value for every joint if the file has no such <numeric>.

    Raises:
        InputError: If the number of values is not the number of joints.
    """
    if not has_numeric(model, name):
        return np.full(model.njnt, default)
    values = model.numeric(name).data
    if len(values) != model.njnt:
        followers = ", counting those that follow others" if model.neq else ""
        raise InputError(f"{path}: numeric {name!r} has {len(values)} values for {model.njnt} joints" + followers)
    return values.copy()


def upwards(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield the body and its ancestors, by their indices in the model, without the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def joints_of(model: mujoco.MjModel, body: int) -> range:
    """Return the joints that move a body relative to its parent, by their indices in the model."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def is_mocap_alone(model: mujoco.MjModel, body: int) -> bool:
    """Return True for a mocap body that carries no joints, such as one that a mouse moves; not for an arm's base."""
    return bool(model.body_mocapid[body] >= 0 and not any(body in upwards(model, int(b)) for b in model.jnt_bodyid))


def massive_bodies(spec: mujoco.MjSpec) -> list[int]:
    """Return the bodies with an inertia in the file, by their indices in the compiled model."""
    return [body.id for body in spec.bodies if body.explicitinertial and body.mass > 0]


def excluded_bodies(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Return the pairs of bodies in the file's <exclude>s, by their indices."""
    return {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in model.exclude_signature}
