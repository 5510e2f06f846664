"""Remarks on a file's joints and bodies that matter only between the base, or the part's link, and the TCP.

The readers of files add them to a model as texts, one for each joint, because the chain is known only after MuJoCo has
compiled the model. Here they become refusals, warnings and notes.
"""

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots.joint_limits import UNLIMITED
from htcp_jax.io.robots.mujoco_models import joint_name, text_of

ON_JOINT, ON_BODY = "remark on joint ", "remark on body "  # heads of a text's name, before the joint's or body's
NO_RANGE, ENDLESS, SOFT, ONE_BOUND = "no range", "endless", "soft limits", "one bound"
UNUSED_RANGE, LONG_AXIS = "unused range", "long axis"
# Each of these is followed by a value.
TYPE, LOST, TENDON, NO_RATE = "type ", "mimics the unknown joint ", "is coupled by the tendon ", "no "
PLANAR_ENDINGS = "_TX", "_TY", "_RZ"  # of the names of the three joints that MuJoCo makes of a planar one
MOST_NAMED = 12  # maximum number of names in a message


class Remedies(NamedTuple):
    """Texts for messages: how to freeze a joint, with {} for its name, and how to give limits."""

    freeze: str
    limits: str


OF_IMPORT = Remedies("--fix {}=VALUE", "--limits FILE (MoveIt's joint_limits.yaml)")
OF_JOB = Remedies("robot.locked: {{{}: VALUE}}", "robot.limits: FILE (MoveIt's joint_limits.yaml)")


def add_remarks(
    spec: mujoco.MjSpec, of_joints: Mapping[str, Sequence[str]], of_bodies: Mapping[str, Sequence[str]]
) -> None:
    """Add remarks, by the names of joints and bodies, to a model."""
    for head, found in ((ON_JOINT, of_joints), (ON_BODY, of_bodies)):
        for name, said in found.items():
            if said:
                spec.add_text(name=head + name, data="\n".join(said))


def _remarks(model: mujoco.MjModel, name: str, head: str = ON_JOINT) -> list[str]:
    """Return the remarks on a joint or body of a compiled model, by its name."""
    text = text_of(model, head + name)
    return [] if text is None else text.split("\n")


def check_kinds(
    model: mujoco.MjModel, path: Path, joints: Sequence[str], bodies: Collection[str], remedies: Remedies
) -> None:
    """Check that joints on the chain are of kinds that are planned, and that no tendon couples them.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        joints: Names of the moving joints on the chain.
        bodies: Names of the chain's bodies that these joints move.
        remedies: Remedies for the message.

    Raises:
        InputError: For floating, planar and ball joints, for joints that follow an unknown one, and for tendons.
    """
    for name in joints:
        for said in _remarks(model, name):
            if said.startswith(TYPE):
                raise _wrong_type(path, name, said.removeprefix(TYPE))
            if said.startswith((LOST, TENDON)):
                remedy = f"; freeze it with {remedies.freeze.format(name)}" if said.startswith(LOST) else ""
                raise InputError(f"{path}: joint {name!r} {said}{remedy or ', which is not supported'}")
    for name in bodies:
        for said in _remarks(model, name, ON_BODY):
            raise InputError(f"{path}: link {name!r} {said}, which is not supported")


def _wrong_type(path: Path, joint: str, kind: str) -> InputError:
    own = joint[: -len(PLANAR_ENDINGS[0])] if kind == "planar" else joint
    return InputError(
        f"{path}: joint {own!r} between base and TCP has type {kind}; valid: revolute, continuous, prismatic, fixed; "
        'write type="fixed" if it does not move'
    )


def check_ranges(
    model: mujoco.MjModel, path: Path, joints: Sequence[int], ranges: Float[np.ndarray, "N 2"], remedies: Remedies
) -> None:
    """Check that joints on the chain have ranges.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        joints: Indices of the N moving joints on the chain.
        ranges: Their lower and upper limits [rad or m], infinite for none.
        remedies: Remedies for the message.

    Raises:
        InputError: For joints without a range, and for a range that is unlimited on one side.
    """
    names = [joint_name(model, j) for j in joints]
    said = [_remarks(model, name) for name in names]
    is_open = ~(np.abs(ranges) <= UNLIMITED).all(axis=1)
    missing = [name for name, own, is_one in zip(names, said, is_open, strict=True) if is_one and NO_RANGE in own]
    if missing:
        freeze = remedies.freeze.format(missing[0] if len(missing) == 1 else "JOINT")
        raise InputError(
            f"{path}: no range for {', '.join(missing)}: <limit> is missing, or its lower and upper are; 0 to 0 counts "
            f"as missing; give ranges with {remedies.limits}, or freeze a joint with {freeze}"
        )
    for k, (lower, upper) in enumerate(ranges.tolist()):
        if math.isinf(lower) != math.isinf(upper) or (is_open[k] and ONE_BOUND in said[k]):
            raise InputError(
                f"{path}: joint {names[k]!r} has range {lower:g} to {upper:g}, which is unlimited on one side; give "
                f"both limits with {remedies.limits}"
            )


def note_limits(
    model: mujoco.MjModel,
    path: Path,
    joints: Sequence[int],
    ranges: Float[np.ndarray, "N 2"],
    rates: Mapping[str, Float[np.ndarray, "N"]],
) -> None:
    """Name in notes what was assumed about the limits of joints on the chain.

    Args:
        model: The compiled model, with the file's own ranges.
        path: Its file, for messages.
        joints: Indices of the N moving joints on the chain.
        ranges: Lower and upper limits that apply to them [rad or m].
        rates: Their limits of "speed" and "acceleration" [rad or m, per s and s2]; inf, or no entry, for none.
    """
    said = {joint_name(model, j): _remarks(model, joint_name(model, j)) for j in joints}
    is_own = (own_ranges(model, joints) == ranges).all(axis=1)
    always, unlimited = np.full(len(said), True), np.full(len(said), np.inf)
    for remark, (applies, text) in {
        SOFT: (is_own, "the soft limits of <safety_controller>, tighter than the range, are the range of {}"),
        ENDLESS: (is_own, "a range beyond 1e6 rad counts as unlimited: {}"),
        UNUSED_RANGE: (is_own, "the range of a continuous joint is not used: {}"),
        LONG_AXIS: (always, "the length of the <axis> of {} is not 1 and has no effect"),
        NO_RATE + "speed": (
            np.isinf(rates.get("speed", unlimited)),
            "the speed of {} is not positive and counts as missing; htcp program needs it: --limits FILE or "
            "program.velocity",
        ),
        NO_RATE + "acceleration": (
            np.isinf(rates.get("acceleration", unlimited)),
            "the acceleration of {} is not positive and counts as missing",
        ),
    }.items():
        named = [name for name, is_so in zip(said, applies, strict=True) if is_so and remark in said[name]]
        if named:
            warnings.warn(f"{path}: {text.format(listed(named))}", Note, stacklevel=3)


def listed(names: Sequence[str]) -> str:
    """Return names as text, at most MOST_NAMED of them."""
    return ", ".join([*names[:MOST_NAMED], *(["..."] if len(names) > MOST_NAMED else [])])


def own_ranges(model: mujoco.MjModel, joints: Sequence[int]) -> Float[np.ndarray, "N 2"]:
    """Return the ranges of N joints, by their indices in a compiled model [rad or m]; infinite for none."""
    at = list(joints)
    return np.where(model.jnt_limited[at, None], model.jnt_range[at], [-np.inf, np.inf])
