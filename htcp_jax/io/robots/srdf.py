"""Pairs of links that an SRDF file, as written by MoveIt's setup assistant, excludes from self-collision checks."""

from collections.abc import Collection
from pathlib import Path

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots.ledger import Ledger, short
from htcp_jax.io.robots.safe_xml import parse_model

PAIR = "disable_collisions"
# Elements for planners and controllers, without influence on the links that may touch each other.
UNUSED = {
    "end_effector", "group", "group_state", "joint_property", "link_sphere_approximation", "passive_joint",
    "virtual_joint",
}  # fmt: skip


def disabled_pairs(path: Path, robot: str, bodies: Collection[str], ledger: Ledger) -> list[tuple[str, str]]:
    """Return the pairs of links in an SRDF file's <disable_collisions> elements; a Note names elements of other kinds.

    Args:
        path: The SRDF file.
        robot: Name of the robot.
        bodies: Names of the robot's links.
        ledger: Ledger to which all other elements are added.

    Raises:
        InputError: For a file that cannot be read, for the SRDF file of another robot, for a pair with a link that the
            model lacks or inside another element, and for a file without pairs.
    """
    root = parse_model(path, "an SRDF file", ".srdf")
    if root.tag != "robot":
        raise InputError(f"{path}: the root is <{root.tag}>; in an SRDF file it must be <robot>")
    if (name := root.get("name", "")) != robot:
        raise InputError(
            f"{path}: the SRDF is for {name!r}, the model is {robot!r}; if both are the same robot, write <robot "
            f"name={robot!r}> in the SRDF"
        )
    found = root.findall(PAIR)
    if len(found) < len(list(root.iter(PAIR))):
        raise InputError(f"{path}: a <{PAIR}> is inside another element; it must be a child of <robot>")
    for each in root:
        if each.tag != PAIR:
            (ledger.count if each.tag in UNUSED else ledger.name)(f"<{short(each.tag)}>")
    ledger.warn(path, Note, stacklevel=3)
    pairs = [(each.get("link1", ""), each.get("link2", "")) for each in found]
    if not pairs:
        raise InputError(f"{path}: <{PAIR}> is missing; the links of the model: {', '.join(sorted(bodies))}")
    for pair in pairs:
        if lost := [link for link in pair if link not in bodies]:
            named = " and ".join(pair)
            raise InputError(f"{path}: {named}: the model has no link {lost[0]}; valid: {', '.join(sorted(bodies))}")
    return [pair for pair in pairs if pair[0] != pair[1]]
