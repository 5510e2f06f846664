"""Joints of a URDF: their tree, ranges and speeds, before MuJoCo reads them.

MuJoCo reads a range with one bound, and one of 0 to 0, as no limit, and no soft limits and speeds. `read_joints` writes
both bounds of the range that holds, and remarks on what matters only for joints on the chain, see `remarks`.
"""

import math
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement

from htcp_jax.errors import InputError
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.joint_limits import UNLIMITED
from htcp_jax.io.robots.ledger import short

WORLD = "world"  # MuJoCo's own body 0; a URDF's root link may have this name
TYPES = "revolute", "continuous", "prismatic", "fixed", "floating", "planar"
MOVING = "revolute", "continuous", "prismatic"  # types that have one coordinate
BALL = "spherical"  # pybullet's and MuJoCo's addition
ROUNDED = 0.01  # an axis whose length differs more from 1 is named
_RATES = {"speed": ("velocity",), "acceleration": ("acceleration", "drake:acceleration")}


class UrdfJoints(NamedTuple):
    """Content of a URDF's joints that MuJoCo does not read."""

    numbers: dict[str, dict[str, float]]  # by the <numeric>'s and the joint's name; inf for none
    remarks: dict[str, list[str]]  # by the joint's name
    held: dict[str, float]  # values of joints that mimic a fixed one [rad or m], by name


def refuse_repeated_names(root: Element, path: Path) -> None:
    """Refuse a URDF with repeated names of links or of moving joints; MuJoCo itself refuses such an MJCF file.

    Raises:
        InputError: For repeated names, which the message lists.
    """
    moving = [each for each in root.findall("joint") if each.get("type") != "fixed"]
    counts = Counter((each.tag, each.get("name", "")) for each in [*root.findall("link"), *moving])
    if repeated := [f"{kind} {name!r}" for (kind, name), count in counts.items() if count > 1]:
        raise InputError(f"{path}: repeated names: {', '.join(repeated)}; the names of links and joints must be unique")


def check_tree(root: Element, path: Path) -> None:
    """Check that the joints connect all links to one tree.

    Raises:
        InputError: For a joint of an unknown type or without a link, a link with two parents, a second root, a circle.
    """
    links = {each.get("name", "") for each in root.findall("link")}
    children: dict[str, list[str]] = {}
    parent_joint: dict[str, str] = {}
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in (*TYPES, BALL):
            raise InputError(f"{path}: joint {name!r} has type {short(kind)!r}; valid: {', '.join(TYPES)}")
        parent, child = (joint.find(end).get("link", "") for end in ("parent", "child"))
        for end, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise InputError(f"{path}: joint {name!r}: no link {link!r}, its {end}")
        if child in parent_joint:
            both = f"{parent_joint[child]!r} and {name!r}"
            raise InputError(f"{path}: link {child!r} is the child of joints {both}; it must have one parent")
        parent_joint[child] = name
        children.setdefault(parent, []).append(child)
    roots = [link for link in dict.fromkeys(each.get("name", "") for each in root.findall("link"))
             if link not in parent_joint]  # fmt: skip
    if len(roots) > 1:
        named = f"{', '.join(roots[:6])}{', ...' if len(roots) > 6 else ''}"
        raise InputError(f"{path}: {len(roots)} links have no parent: {named}; connect all links but one by joints")
    reached, near = set(roots), list(roots)
    while near:
        found = children.get(near.pop(), [])
        reached.update(found)
        near += found
    if lost := sorted(links - reached):
        raise InputError(f"{path}: link {lost[0]!r} is its own ancestor; one of the joints above it must be removed")


def read_joints(root: Element, path: Path) -> UrdfJoints:
    """Write the range of each joint as MuJoCo reads it, and return what MuJoCo does not read.

    Args:
        root: The root, <robot>, which is modified.
        path: The file, for messages.

    Raises:
        InputError: For a descending range, soft limits that contradict it, a moving joint with an axis of 0, and a
            joint that mimics itself.
    """
    found = UrdfJoints({name: {} for name in _RATES}, {}, {})
    joints = [each for each in root.findall("joint") if each.get("type") != "fixed"]
    masters = _masters(root, path)
    has_world = WORLD not in {each.get("link") for each in root.findall("joint/child")}
    for joint in joints:
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind in ("floating", "planar", BALL):
            _relieve(joint, has_world)
            endings = remarks.PLANAR_ENDINGS if kind == "planar" else ("",)
            found.remarks.update({name + ending: [remarks.TYPE + kind] for ending in endings})
            continue
        said = found.remarks[name] = _axis_remarks(joint, path)
        said += [] if kind == "continuous" else _range_remarks(joint, path)
        if kind == "continuous" and _states_range(joint):
            said.append(remarks.UNUSED_RANGE)
        for numeric, attributes in _RATES.items():
            stated = {} if (limit := joint.find("limit")) is None else limit.attrib
            given = [float(stated[each]) for each in attributes if each in stated]
            positive = [number for number in given if number > 0]
            found.numbers[numeric][name] = min(positive, default=math.inf)
            if given and not positive:
                said.append(remarks.NO_RATE + numeric)
        if name in masters and masters[name] not in MOVING:  # MuJoCo ignores it
            mimic = joint.find("mimic")
            joint.remove(mimic)
            if masters[name] == "fixed":
                found.held[name] = float(mimic.get("offset", "0"))
            else:
                said.append(remarks.LOST + repr(mimic.get("joint", "")))
    return found


def _masters(root: Element, path: Path) -> dict[str, str]:
    """Return the types of the joints that others mimic, by the mimicking joint's name; "" for an unknown joint."""
    kinds = {each.get("name"): each.get("type", "") for each in root.findall("joint")}
    pairs = [(each.get("name", ""), each.find("mimic").get("joint", "")) for each in root.findall("joint[mimic]")]
    if own := [name for name, master in pairs if name == master]:
        raise InputError(f"{path}: joint {own[0]!r} mimics itself")
    if lost := [f"{name} ({master})" for name, master in pairs if master not in kinds]:
        warnings.warn(f"{path}: joints that mimic an unknown joint: {short(', '.join(lost))}", stacklevel=5)
    return {name: kinds.get(master, "") for name, master in pairs}


def _axis_remarks(joint: Element, path: Path) -> list[str]:
    axis = joint.find("axis")
    length = 1.0 if axis is None else math.hypot(*map(float, axis.get("xyz", "").split()))
    if not length:
        raise InputError(f"{path}: joint {joint.get('name')!r}: <axis xyz={axis.get('xyz')!r}> has no direction")
    return [remarks.LONG_AXIS] if abs(length - 1) > ROUNDED else []


def _range_remarks(joint: Element, path: Path) -> list[str]:
    """Write the range of a revolute or prismatic joint that holds, and return remarks on it."""
    name, slides, said = joint.get("name", ""), joint.get("type") == "prismatic", []
    lower, upper = _number(joint, "limit", "lower"), _number(joint, "limit", "upper")
    if not lower < upper and (lower, upper) != (0, 0):
        raise InputError(f"{path}: joint {name!r} has range {lower:g} to {upper:g}; the lower limit must come first")
    far = [math.isinf(bound) or (abs(bound) > UNLIMITED and not slides) for bound in (lower, upper)]
    if (lower, upper) == (0, 0) or all(far):
        said.append(remarks.ENDLESS if all(far) and not slides else remarks.NO_RANGE)
        lower, upper = -math.inf, math.inf
    elif any(far):
        said.append(remarks.ONE_BOUND)
    soft = [_number(joint, "safety_controller", f"soft_{side}_limit") for side in ("lower", "upper")]
    if soft[0] > soft[1]:
        raise InputError(f"{path}: joint {name!r} has soft limits {soft[0]:g} to {soft[1]:g}; they must ascend")
    if soft[0] < soft[1] and (soft[0] > lower or soft[1] < upper):
        if not max(soft[0], lower) < min(soft[1], upper):
            both = f"{soft[0]:g} to {soft[1]:g} are outside of its range {lower:g} to {upper:g}"
            raise InputError(f"{path}: joint {name!r}: the soft limits {both}")
        lower, upper, said = max(soft[0], lower), min(soft[1], upper), [remarks.SOFT]
    _write_range(joint, lower, upper)
    return said


def _write_range(joint: Element, lower: float, upper: float) -> None:
    """Write both bounds, or none if both are infinite; a text that states the bound already stays."""
    limit = joint.find("limit")
    if limit is None:
        limit = SubElement(joint, "limit")
    for name, bound in (("lower", lower), ("upper", upper)):
        if math.isinf(lower) and math.isinf(upper):
            limit.attrib.pop(name, None)
        elif name not in limit.attrib or float(limit.attrib[name]) != bound:
            limit.set(name, repr(bound))


def _states_range(joint: Element) -> bool:
    """Return True if a continuous joint has a range, or soft limits, that would limit it."""
    hard = [_number(joint, "limit", side) for side in ("lower", "upper")]
    soft = [_number(joint, "safety_controller", f"soft_{side}_limit") for side in ("lower", "upper")]
    return any(lower < upper and min(-lower, upper) < UNLIMITED for lower, upper in (hard, soft))


def _relieve(joint: Element, has_world: bool) -> None:
    """Remove the limit of a floating, planar or ball joint; write a floating one that MuJoCo refuses as a ball joint.

    MuJoCo reads a floating joint only on the root link `world`. Off the chain it is frozen; on the chain it is refused.
    """
    for limit in joint.findall("limit"):
        joint.remove(limit)
    if joint.get("type") == "floating" and not (has_world and joint.find("parent").get("link") == WORLD):
        joint.set("type", BALL)


def _number(joint: Element, tag: str, name: str) -> float:
    """Return a number in a child of a joint; 0 if it is missing, as in the definition of URDF."""
    element = joint.find(tag)
    return 0.0 if element is None else float(element.get(name, "0"))
