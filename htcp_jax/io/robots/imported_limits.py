"""Limits of an imported arm: its model's, replaced by those that a file with joint limits states."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import Note
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.chain import JointMap
from htcp_jax.io.robots.composed import PER_JOINT
from htcp_jax.io.robots.joint_limits import read_joint_limits
from htcp_jax.io.robots.mujoco_models import SLIDE, has_numeric, joint_name, joint_numbers, model_name

Numbers = dict[str, Float[np.ndarray, "J"]]  # values of PER_JOINT for all joints of a model, by name


def limits_of(
    model: mujoco.MjModel, path: Path, mapped: JointMap, file: Path | None
) -> tuple[Float[np.ndarray, "J 2"], Numbers]:
    """Return the ranges of moving joints [rad or m], and the values of PER_JOINT of all joints.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        mapped: The J joints.
        file: File with joint limits, see `read_joint_limits`; None: the model's limits apply.

    Raises:
        InputError: For a file that cannot be read, for joints without a range, followers excepted, and if no range of a
            joint satisfies its own limits and those of its followers.
    """
    joints = mapped.joints
    numbers = {name: joint_numbers(model, path, name) for name in PER_JOINT if has_numeric(model, name)}
    at, ranges = list(joints), remarks.own_ranges(model, joints)
    if file is not None:
        stated = read_joint_limits(file, [joint_name(model, j) for j in joints], model_name(model))
        speed = numbers.get("speed", np.full(model.njnt, np.inf))[at]
        if note := stated.note((ranges[:, 0], ranges[:, 1]), speed):
            warnings.warn(note, Note, stacklevel=3)
        slides = [bool(model.jnt_type[j] == SLIDE) for j in joints]
        ranges = np.stack(stated.ranges(slides, ranges[:, 0], ranges[:, 1]), axis=1)
        for name, kind in (("speed", "velocity"), ("acceleration", "acceleration")):
            rates = stated.rates(kind)
            if not np.isnan(rates).all():
                values = numbers.setdefault(name, np.full(model.njnt, np.inf))
                values[at] = np.where(np.isnan(rates), values[at], rates)
    lower, upper = mapped.limits(model, path, ranges)[:2]
    remarks.check_ranges(model, path, mapped.free, np.stack([lower, upper], axis=1), remarks.OF_IMPORT)
    return ranges, numbers


def write_ranges(
    model: mujoco.MjModel, path: Path, joints: Sequence[int], ranges: Float[np.ndarray, "J 2"], numbers: Numbers
) -> None:
    """Note what was assumed about the limits of joints, and write their ranges into the model.

    Args:
        model: The compiled model, which is modified.
        path: Its file, for messages.
        joints: Indices of the J joints.
        ranges: Their ranges [rad or m].
        numbers: Values of PER_JOINT.
    """
    at = list(joints)
    remarks.note_limits(model, path, joints, ranges, {name: values[at] for name, values in numbers.items()})
    model.jnt_limited[at], model.jnt_range[at] = np.isfinite(ranges).all(axis=1), ranges
