"""Pairs of links that an SRDF file, as written by MoveIt's setup assistant, excludes from self-collision checks."""

from collections.abc import Collection
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.io.robots.safe_xml import parse, refuse_xacro


def disabled_pairs(path: Path, robot: str, bodies: Collection[str]) -> list[tuple[str, str]]:
    """Return the pairs of the <disable_collisions>.

    Args:
        path: The SRDF file.
        robot: Name of the robot.
        bodies: Names of its links.

    Raises:
        InputError: For a file that cannot be read, for the SRDF of another robot, for a pair with a link that the model
            lacks, and if there are no pairs.
    """
    root = parse(path, "an SRDF file")
    refuse_xacro(root, path, ".srdf")
    if root.tag != "robot":
        raise InputError(f"{path}: the root is <{root.tag}>; an SRDF has <robot>")
    if (name := root.get("name", "")) != robot:
        raise InputError(
            f"{path}: an SRDF of {name!r}; the model is {robot!r}; if they are one robot, write <robot name={robot!r}>"
        )
    pairs = [(each.get("link1", ""), each.get("link2", "")) for each in root.iter("disable_collisions")]
    if not pairs:
        raise InputError(f"{path}: it has no <disable_collisions>; the links are {', '.join(sorted(bodies))}")
    for pair in pairs:
        if lost := [link for link in pair if link not in bodies]:
            named = " and ".join(pair)
            raise InputError(f"{path}: {named}: the model has no link {lost[0]}; it has {', '.join(sorted(bodies))}")
    return [pair for pair in pairs if pair[0] != pair[1]]
