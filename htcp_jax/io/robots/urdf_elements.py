"""Elements and attributes of a URDF that are read.

One pass over the tree refuses elements that are missing, repeated or malformed, and adds all others to a ledger, so
that a misspelt or misplaced element is noticed.
"""

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from htcp_jax.errors import InputError
from htcp_jax.io.robots.ledger import Ledger, short

# Elements that change neither geometry nor kinematics nor limits, as elements of other programs with a prefix (a:b).
HARMLESS = {
    "calibration", "collision_checking", "compliant_contact", "contact", "contact_coefficients", "dynamics", "frame",
    "gazebo", "gravity", "hardwareInterface", "joint_properties", "klampt", "material", "ros2_control",
    "self_collision_checking", "self_filter", "sensor", "transmission", "verbose",
}  # fmt: skip
# Elements with a prefix that do change them; each is named.
NOT_HARMLESS = {"drake:capsule", "drake:ellipsoid", "drake:joint", "drake:mimic", "drake:screw_thread_pitch"}
SHAPES = "box", "capsule", "cylinder", "mesh", "sphere"


class _Rule(NamedTuple):
    """Children and attributes of an element."""

    children: dict[str, str]  # by name: "" for at most one, "!" for exactly one, "*" for any number
    numbers: dict[str, int]  # number of numbers in each attribute; 0: text
    required: frozenset[str]  # names of required attributes


def _rule(children: str = "", attributes: str = "") -> _Rule:
    parts = [each.rstrip("!").partition(":") for each in attributes.split()]
    return _Rule(
        {each.rstrip("!*"): each[len(each.rstrip("!*")) :] for each in children.split()},
        {name: int(count or 0) for name, _, count in parts},
        frozenset(each.rstrip("!").partition(":")[0] for each in attributes.split() if each.endswith("!")),
    )


_INERTIA = "ixx:1 ixy:1 ixz:1 iyy:1 iyz:1 izz:1"
_CONTENT = {
    "robot": _rule("link* joint* mujoco*", "name version"),
    "link": _rule("inertial visual* collision*", "name! type"),
    "joint": _rule("parent! child! origin axis limit mimic safety_controller", "name! type! dont_collapse"),
    "inertial": _rule("origin mass inertia"),
    "visual": _rule("origin geometry!", "name"),
    "collision": _rule("origin geometry!", "name"),
    "geometry": _rule(" ".join(SHAPES), "name"),
    "origin": _rule("", "xyz:3 rpy:3"),
    "axis": _rule("", "xyz:3!"),
    "parent": _rule("", "link!"),
    "child": _rule("", "link!"),
    "limit": _rule("", "lower:1 upper:1 effort:1 velocity:1 acceleration:1"),
    "mimic": _rule("", "joint! multiplier:1 offset:1"),
    "safety_controller": _rule("", "soft_lower_limit:1 soft_upper_limit:1 k_position k_velocity"),
    "mass": _rule("", "value:1!"),
    "inertia": _rule("", _INERTIA),
    "box": _rule("", "size:3!"),
    "capsule": _rule("", "radius:1! length:1!"),
    "cylinder": _rule("", "radius:1! length:1!"),
    "mesh": _rule("", "filename! scale:3"),
    "sphere": _rule("", "radius:1!"),
}
_CONTENT["limit"].numbers["drake:acceleration"] = 1  # the one attribute with a prefix that is read
_WITHOUT_EFFECT = {  # attributes
    ("robot", "version"), ("link", "type"), ("joint", "dont_collapse"), ("safety_controller", "k_position"),
    ("safety_controller", "k_velocity"),
}  # fmt: skip
_INFINITE = "limit", "safety_controller"  # elements in which a number may be infinite


def read_elements(root: Element) -> Iterator[Element]:
    """Yield the elements of a tree, without those in a harmless element."""
    yield root
    for child in root:
        if not _is_harmless(child):
            yield from read_elements(child)


def check_elements(root: Element, path: Path, visual: bool, ledger: Ledger) -> None:
    """Check the elements and attributes of a URDF.

    Args:
        root: The root, <robot>.
        path: The file, for messages.
        visual: True if the visual geometry is used although the file has collision geometry.
        ledger: Ledger to which elements, attributes and text that are not used are added.

    Raises:
        InputError: For a missing, repeated or malformed element or attribute.
    """
    _check(root, "", path, ledger, "" if visual or root.find("link/collision") is None else "visual")


def _check(element: Element, owner: str, path: Path, ledger: Ledger, skipped: str) -> None:
    """Check an element of `_CONTENT` and its children; `owner` is the link or joint that contains it."""
    rule, tag = _CONTENT[element.tag], element.tag
    inside = f" in <{tag}>"
    if tag in ("link", "joint"):
        owner, inside = f"{tag} {short(element.get('name', ''))!r}", ""
    where = f"{path}: {owner and owner + ': '}<{tag}>"
    _check_children(element, rule, where)
    if missing := [name for name in sorted(rule.required) if not element.get(name)]:
        raise InputError(f"{where} has no attribute {missing[0]!r}")
    for name, value in element.attrib.items():
        if (tag, name) in _WITHOUT_EFFECT:
            ledger.count(f"{name!r} in <{tag}>")
        if name in rule.numbers:
            _check_numbers(value, rule.numbers[name], f"{where[:-1]} {name}={short(value)!r}>", tag in _INFINITE)
        elif ":" in name or name == "xmlns":
            ledger.count(name.partition(":")[0] + ":...")
        elif tag == "mimic":  # a misspelt one would change how the arm moves
            raise InputError(f"{where} has an unknown attribute {short(name)!r}; valid: {', '.join(rule.numbers)}")
        else:
            ledger.name(f"{short(name)!r}{inside}", owner)
    texts = " ".join(filter(None, map(str.strip, [element.text or "", *(child.tail or "" for child in element)])))
    if texts:
        ledger.name(f"text {short(texts)!r}{inside}", owner)
    for child in element:
        if child.tag not in rule.children:
            if not _is_harmless(child):
                ledger.name(f"<{short(child.tag)}>{inside}", owner)
            elif _limits_commands(child):
                ledger.name("limits in <ros2_control>")
            else:
                ledger.count(f"<{child.tag}>")
        elif child.tag == skipped:
            ledger.count(f"<{child.tag}>")
        elif child.tag in _CONTENT:
            _check(child, owner, path, ledger, skipped)


def _check_children(element: Element, rule: _Rule, where: str) -> None:
    """Check how often the children of an element occur; `where` names the element in messages."""
    counts = Counter(child.tag for child in element)
    for name, how_many in rule.children.items():
        if counts[name] > 1 and how_many != "*":
            raise InputError(f"{where} has {counts[name]} <{name}>; it must have one")
        if how_many == "!" and not counts[name]:
            raise InputError(f"{where} has no <{name}>")
    if element.tag == "geometry" and sum(counts[shape] for shape in SHAPES) != 1:
        found = ", ".join(f"<{name}>" for name in counts) or "nothing"
        raise InputError(f"{where} contains {short(found)}; it must contain one of {', '.join(SHAPES)}")


def _check_numbers(text: str, count: int, where: str, may_be_infinite: bool) -> None:
    """Check an attribute with `count` numbers; 0: text.

    Raises:
        InputError: For another number of values, and for one that is no number, nan, or infinite without need.
    """
    if not count:
        return
    try:
        values = [] if "_" in text else [float(part) for part in text.split()]  # Python reads 1_0 as ten
    except ValueError:
        values = []
    if len(values) != count or any(map(math.isnan, values)) or not (may_be_infinite or all(map(math.isfinite, values))):
        raise InputError(f"{where} is not {'a number' if count == 1 else f'{count} numbers'}")


def _is_harmless(element: Element) -> bool:
    return element.tag in HARMLESS or (":" in element.tag and element.tag not in NOT_HARMLESS)


def _limits_commands(element: Element) -> bool:
    """Return True for a <ros2_control> that limits the commands to a joint."""
    return element.tag == "ros2_control" and any(each.get("name") in ("min", "max") for each in element.iter("param"))
