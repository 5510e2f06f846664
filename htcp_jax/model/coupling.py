"""Joints that follow others: q = C u + d.

An arm's coordinates u (N,) are the joints that are commanded; planners know no others. Its links are moved by J joints
q. Some are coordinates themselves, the others follow them by a constant factor and an offset, as URDF's `mimic` and
MJCF's `equality/joint` say. An arm without followers has no Coupling, and none of this in its programs.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Array, Bool, Float

_STATIC = {"static": True}


@register_pytree
@dataclasses.dataclass(frozen=True)
class Coupling:
    """The joints q = C u + d that move an arm's J links, by its N coordinates u.

    The joints of the chain to the TCP come first, in the chain's order, then those on side branches. A joint's index is
    that of the link it moves; a link comes after its parent.
    """

    factors: Float[Array, "J N"]  # C [1, m/rad or rad/m]
    offsets: Float[Array, "J"]  # d [rad or m]
    joint_names: tuple[str, ...] = dataclasses.field(metadata=LABEL)  # of q; `Robot.joint_names` are those of u
    speed: tuple[float, ...] = dataclasses.field(metadata=LABEL)  # of q, inf where the model sets none [rad/s or m/s]
    acceleration: tuple[float, ...] = dataclasses.field(metadata=LABEL)  # likewise [rad/s2 or m/s2]
    parents: tuple[int, ...] = dataclasses.field(metadata=_STATIC)  # link that carries each joint, -1 for the root
    tcp_link: int = dataclasses.field(metadata=_STATIC)  # link that carries the TCP, the chain's last
    slides: tuple[bool, ...] = dataclasses.field(metadata=_STATIC)  # True for coordinates of u that are sliding joints

    def positions(self, u: Float[np.ndarray, "*S N"]) -> Float[np.ndarray, "*S J"]:
        """Return the joints' positions q = C u + d [rad or m]."""
        return self.rates(u) + np.asarray(self.offsets)

    def rates(self, rates: Float[np.ndarray, "*S N"]) -> Float[np.ndarray, "*S J"]:
        """Return the joints' rates C u', also for higher derivatives [rad or m, per s or s2]."""
        return rates @ np.asarray(self.factors).T


class LimitArrays(NamedTuple):
    """Limits of n joints or coordinates [rad or m, rad/s or m/s, rad/s2 or m/s2, N m or N]; inf where there is none."""

    lower: Float[np.ndarray, "n"]
    upper: Float[np.ndarray, "n"]
    speed: Float[np.ndarray, "n"]
    acceleration: Float[np.ndarray, "n"]
    effort: Float[np.ndarray, "n"]


def coordinate_limits(
    factors: Float[np.ndarray, "J N"],
    offsets: Float[np.ndarray, "J"],
    limits: LimitArrays,
    names: Sequence[str],
    coordinates: Sequence[str],
    where: str = "",
) -> LimitArrays:
    """Return the limits of the coordinates u within which every joint of q = C u + d keeps its own.

    The torque at a coordinate is C^T times the joints' torques, by the principle of virtual work (Siciliano et al.,
    Robotics, section 3.8). Its own motor supplies all of it: followers have none, so their limits of effort are not
    used.

    Args:
        factors: C, at most one factor per row. Coordinates that move no link have a row too.
        offsets: d [rad or m].
        limits: Limits of the joints.
        names: Names of the joints.
        coordinates: Names of the coordinates, each also the name of a joint.
        where: Start of a message, such as "arm.urdf: ".

    Raises:
        InputError: If no range of a coordinate satisfies all.
    """
    found = []
    for k, coordinate in enumerate(coordinates):
        rows = np.flatnonzero(factors[:, k])
        factor, size = factors[rows, k], np.abs(factors[rows, k])
        ends = np.sort((np.stack([limits.lower[rows], limits.upper[rows]]) - offsets[rows]) / factor, axis=0)
        low, high = ends[0].max(), ends[1].min()
        if not low < high:
            first, second = (names[rows[j]] for j in (ends[0].argmax(), ends[1].argmin()))
            raise InputError(
                f"{where}joint {coordinate} has no range within the limits of {first} and {second}, which move with it"
            )
        own = names.index(coordinate)
        rates = (limits.speed[rows] / size).min(), (limits.acceleration[rows] / size).min()
        found.append((low, high, *rates, limits.effort[own]))
    return LimitArrays(*np.array(found).T)


def moved_by(parents: Sequence[int]) -> Bool[np.ndarray, "L J"]:
    """Return True where a joint moves a link; the last row, L = J + 1, is the root's, so that it is link -1."""
    moves = np.zeros((len(parents) + 1, len(parents)), bool)
    for link, parent in enumerate(parents):
        moves[link] = moves[parent]
        moves[link, link] = True
    return moves


def joints_between(parents: Sequence[int], link: int, other: int) -> tuple[list[int], list[float]]:
    """Return the joints between two links, in order from `other` to `link`, as a serial chain seen from `other`.

    Returns:
        Indices of the joints, and for each 1.0 or, if it moves `other` instead of `link`, -1.0.
    """
    moves = moved_by(parents)
    down, up = (np.flatnonzero(moves[a] & ~moves[b]) for a, b in ((other, link), (link, other)))
    return [*down[::-1].tolist(), *up.tolist()], [-1.0] * len(down) + [1.0] * len(up)
