"""Constraints of an MJCF file's <equality> that close loops of bodies, or couple joints by tendons.

They are not planned: a constraint that a moving joint takes part in is refused, unless all links that only it moves
have no capsules.
"""

import itertools
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.mujoco_models import FREE, body_name, is_mocap_alone, joints_of, unreadable_model, upwards

_TAGS = {int(mujoco.mjtEq.mjEQ_CONNECT): "connect", int(mujoco.mjtEq.mjEQ_WELD): "weld"}


def tendon_remarks(root: Element, path: Path) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return remarks on the joints, and on the bodies, that an active <tendon> in <equality> couples, by their names.

    Raises:
        InputError: For defaults or a <tendon> that MuJoCo refuses.
    """
    rows = [row for equality in root.findall("equality") for row in equality.findall("tendon")]
    active = _are_active(rows, root.findall("default"), path) if rows else ()
    body_of = {site.get("name"): body.get("name", "") for body in root.iter("body") for site in body.findall("site")}
    tendons = {each.get("name"): each for section in root.findall("tendon") for each in section}
    joints: dict[str, list[str]] = {}
    bodies: dict[str, list[str]] = {}
    for each in itertools.compress(rows, active):
        for name in (each.get("tendon1"), each.get("tendon2")):
            for part in tendons.get(name, ()):
                owner, found = (
                    (part.get("joint"), joints) if part.tag == "joint" else (body_of.get(part.get("site")), bodies)
                )
                if owner:
                    found.setdefault(owner, []).append(remarks.TENDON + str(name))
    return joints, bodies


def _are_active(rows: Sequence[Element], defaults: Sequence[Element], path: Path) -> list[bool]:
    """Return True for rows of <equality> that are active, by their own attribute or by their class's default."""
    root = Element("mujoco")
    root.extend(defaults)
    SubElement(root, "equality").extend(rows)
    try:
        return [bool(each.active) for each in mujoco.MjSpec.from_string(tostring(root, "unicode")).equalities]
    except (ValueError, mujoco.FatalError) as error:
        raise unreadable_model(path, error) from None


class _Tie(NamedTuple):
    """A <connect> or <weld> of two bodies."""

    tag: str
    bodies: tuple[int, int]


def _ties(model: mujoco.MjModel) -> list[_Tie]:
    """Return the active ties of a model."""
    found = []
    for k in np.flatnonzero(np.isin(model.eq_type, list(_TAGS)) & (model.eq_active0 > 0)):
        ends = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
            ends = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
        found.append(_Tie(_TAGS[int(model.eq_type[k])], ends))
    return found


def check_loops(
    model: mujoco.MjModel, path: Path, links: Sequence[int], passive: Collection[int] = (), shaped: Collection[int] = ()
) -> set[int]:
    """Check that no <connect> or <weld> ties two links that move against each other.

    A tie with a body that is not the robot's, such as one that a mouse moves, is a warning.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        links: The link of each body; -1: the chain's root.
        passive: Joints that are frozen, but that a tie may move.
        shaped: Bodies with capsules.

    Returns:
        The passive joints that ties move.

    Raises:
        InputError: For such a tie, unless no capsules are on the links between it and the passive joints.
    """
    moved: set[int] = set()
    ignored = []
    for tie in _ties(model):
        text = f"<{tie.tag}> of {' and '.join('world' if b == 0 else body_name(model, b) for b in tie.bodies)}"
        if links[tie.bodies[0]] == links[tie.bodies[1]]:
            continue
        if any(_is_foreign(model, b) for b in tie.bodies):
            ignored.append(text)
            continue
        first, second = ({j for b in upwards(model, body) for j in joints_of(model, b)} for body in tie.bodies)
        loose = (first ^ second).intersection(passive)  # a joint that moves both bodies does not move the tie
        named = moved_bodies(model, loose, shaped)
        if not loose or named:
            remedy = (
                f"exclude the links that it moves with {omit_text(model, named)}" if loose else 'write active="false"'
            )
            raise InputError(f"{path}: {text} in <equality> closes a loop, which is not supported; {remedy}")
        moved.update(loose)
    if ignored:
        warnings.warn(f"{path}: ignored in <equality>: {remarks.listed(ignored)}", stacklevel=4)
    return moved


def moved_bodies(model: mujoco.MjModel, joints: Collection[int], among: Collection[int]) -> list[int]:
    """Return the bodies, of those in `among`, that one of the joints moves."""
    return [b for b in among if any(j in joints for above in upwards(model, b) for j in joints_of(model, above))]


def omit_text(model: mujoco.MjModel, bodies: Sequence[int]) -> str:
    """Format the options that exclude the shapes of bodies."""
    return " ".join(f"--omit {body_name(model, b)}" for b in bodies)


def _is_foreign(model: mujoco.MjModel, body: int) -> bool:
    line = list(upwards(model, body))
    free = any(model.jnt_type[j] == FREE for b in line for j in joints_of(model, b))
    return free or any(is_mocap_alone(model, b) for b in line)
