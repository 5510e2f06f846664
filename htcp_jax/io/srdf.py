"""Pairs of links that an SRDF file, as written by MoveIt's setup assistant, excludes from self-collision checks."""

from collections.abc import Collection
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.io.safe_xml import parse


def disabled_pairs(path: Path, robot: str, bodies: Collection[str]) -> list[tuple[str, str]]:
    """Return the <disable_collisions> whose links are both bodies of the model. Raises InputError for a file that
    cannot be read, for the SRDF of another robot, and if there are none."""
    root = parse(path)
    if root.tag != "robot":
        raise InputError(f"{path}: the root is <{root.tag}>; an SRDF has <robot>")
    if (name := root.get("name", "")) != robot:
        raise InputError(f"{path}: an SRDF of {name!r}; the model is {robot!r}")
    pairs = [(each.get("link1", ""), each.get("link2", "")) for each in root.iter("disable_collisions")]
    known = [pair for pair in pairs if set(pair) <= set(bodies) and pair[0] != pair[1]]
    if not known:
        stated = (
            f"none of its {len(pairs)} pairs is of links of the model" if pairs else "it has no <disable_collisions>"
        )
        raise InputError(f"{path}: {stated}; the links are {', '.join(sorted(bodies))}")
    return known
