"""Fixtures that move with a link of an arm: capsules are fitted to them, and become bodies of the arm."""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.capsule_fit import Capsule, cover_with_capsules
from htcp_jax.model import BodyPieces, Robot, robot


class AttachedBody(NamedTuple):
    """A body that moves with a link: the convex hull of points."""

    name: str
    points: Float[np.ndarray, "P 3"]  # in the link's frame [m]
    link: int
    excluded: tuple[int, ...] = ()  # links that the body is not tested against


def attach(arm: Robot, bodies: Sequence[AttachedBody]) -> Robot:
    """Return an arm with capsules about bodies that move with its links.

    A capsule has its body's name, or name_1, name_2, ... if the body has several capsules.

    Raises:
        InputError: For points in one plane, and for a name that the arm already has for a capsule.
    """
    capsules, names, links, excluded = [], [*arm.capsule_names], [*arm.capsule_link], {}
    for body in bodies:
        own = _capsules_about(body.name, np.ascontiguousarray(body.points).tobytes())
        called = [body.name] if len(own) == 1 else [f"{body.name}_{k}" for k in range(1, len(own) + 1)]
        if taken := [each for each in called if each in names]:
            raise InputError(
                f"fixture {body.name!r}: {arm.name} already has a capsule {taken[0]!r}; choose another name"
            )
        excluded |= dict.fromkeys(range(len(names), len(names) + len(own)), body.excluded)
        capsules, names, links = [*capsules, *own], [*names, *called], [*links, *[body.link] * len(own)]
    pairs = {(a, b) for a, others in excluded.items() for b, link in enumerate(links) if link in others}
    apart = sorted({tuple(sorted(pair, key=lambda k: (-links[k], k))) for pair in pairs})
    return dataclasses.replace(
        arm,
        capsule_p=_with_rows(arm.capsule_p, [each.p for each in capsules]),
        capsule_q=_with_rows(arm.capsule_q, [each.q for each in capsules]),
        capsule_radius=_with_rows(arm.capsule_radius, [each.radius for each in capsules]),
        on_tool=_with_rows(arm.on_tool, np.zeros((len(capsules), 2))),
        pieces=_with_missing(arm.pieces, len(capsules)),
        capsule_names=tuple(names),
        capsule_link=tuple(links),
        exclusions=(*arm.exclusions, *(robot.Exclusion(*pair, "d", 0.0) for pair in apart)),
        mounted=(*arm.mounted, *excluded),
        attached=tuple(excluded),
    )


def _with_rows(known, rows):
    return jnp.concatenate([known, jnp.asarray(rows, known.dtype)])


def _with_missing(pieces: BodyPieces | None, count: int) -> BodyPieces | None:
    """Append rows for `count` bodies without a piece."""
    if pieces is None:
        return None
    more = jax.tree.map(lambda known: jnp.concatenate([known, jnp.repeat(known[:1], count, axis=0)]), pieces)
    return more._replace(excess_m=jnp.pad(pieces.excess_m, (0, count)))


@lru_cache(maxsize=64)
def _capsules_about(name: str, points: bytes) -> tuple[Capsule, ...]:
    corners = np.frombuffer(points).reshape(-1, 3)
    try:
        hull = scipy.spatial.ConvexHull(corners)
    except (scipy.spatial.QhullError, ValueError):
        raise InputError(
            f"fixture {name!r}: its points lie in one plane; a body on a link must have a volume"
        ) from None
    return tuple(piece.capsule for piece in cover_with_capsules(corners[hull.simplices]))
