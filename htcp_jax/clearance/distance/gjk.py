"""Nearest points of two convex bodies, by the algorithm of Gilbert, Johnson and Keerthi (1988).

A body is given by its support function: its point that is lowest along a direction. The search keeps a simplex of at
most three differences a - b. Let x be the simplex's nearest point to the origin. Each round adds the difference that is
lowest along x. The distance is at most the length of x, and at least the least height of any difference along x. The
search ends when both bounds agree or rounding allows no progress: after two to ten rounds for polyhedra, twenty for a
cylinder.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.numerics import product, safe_divide
from htcp_jax.types import Array, Bool, Float, Int, Scalar, Vector3

CONVERGED_M = 1e-11  # difference of the bounds on the distance
TOUCHES_M = 1e-9  # below this distance a normal would consist of rounding errors
ROUNDS = 64  # maximum number of rounds

Support = Callable[[Vector3], Vector3]  # from a direction to the body's point [m] that is lowest along it


class Nearest(NamedTuple):
    """State and result of the search for the nearest points of two bodies. `lower` is 0 or less if they overlap."""

    difference: Vector3  # the simplex's point nearest to the origin
    square: Scalar  # its squared length
    weights: Float[Array, "3"]  # barycentric weights of the corners at this point; 0: unused corner
    corners: Float[Array, "3 3"]  # corners of the simplex: differences a - b [m]
    points: Float[Array, "3 3"]  # the corners' points a on the first body [m]
    lower: Scalar  # lower bound on the distance [m]
    normal: Vector3  # unit, from the second body to the first: along it they are at least `lower` apart
    done: Bool[Array, ""]
    rounds: Int[Array, ""]

    @property
    def point(self) -> Vector3:
        """The point on the first body [m]."""
        return product(self.weights, self.points)


def nearest(a: Support, b: Support, enough_m: Scalar | float = np.inf) -> Nearest:
    """Return the nearest points of two bodies. Rows under `jax.vmap` do not affect each other.

    Args:
        a: Support function of the first body.
        b: Support function of the second body.
        enough_m: Once the distance is known to be larger, the search ends [m].
    """

    def lowest(direction: Vector3) -> tuple[Vector3, Vector3]:
        point = a(direction)
        return point, point - b(-direction)

    def step(now: Nearest) -> Nearest:
        point, corner = lowest(now.difference)
        length, first = jnp.sqrt(now.square), now.rounds == 0
        normal = now.difference / length
        height = jnp.where(first, -jnp.inf, product(normal, corner))
        lower, normal = jnp.maximum(now.lower, height), jnp.where(height > now.lower, normal, now.normal)
        square, difference, weights = _nearest_of_simplex(corner, now.corners, now.weights > 0, lower <= 0)
        stays = now._replace(lower=lower, normal=normal, done=jnp.ones((), bool))
        drop = jnp.arange(3) == jnp.argmin(weights)
        moves = Nearest(
            difference,
            square,
            jnp.where(drop, 1 - jnp.sum(weights), weights),
            jnp.where(drop[:, None], corner[None], now.corners),
            jnp.where(drop[:, None], point[None], now.points),
            lower,
            normal,
            square <= jnp.where(first, 0.0, (TOUCHES_M / 2) ** 2),
            now.rounds + 1,
        )
        stops = ~first & ((length - lower <= CONVERGED_M) | ~(square < now.square) | (lower > enough_m))
        return jax.tree.map(lambda old, new: jnp.where(stops, old, new), stays, moves)

    x, nothing = jnp.array([1.0, 0.0, 0.0]), jnp.zeros((3, 3))  # no simplex yet: the first direction is the x axis
    unknown = jnp.full((), -jnp.inf), jnp.zeros(3), jnp.zeros((), bool), jnp.zeros((), int)
    start = Nearest(x, jnp.ones(()), jnp.zeros(3), nothing, nothing, *unknown)
    return jax.lax.while_loop(lambda now: ~now.done & (now.rounds <= ROUNDS), step, start)


def _nearest_of_simplex(
    w: Vector3, corners: Float[Array, "3 3"], used: Bool[Array, "3"], may_enclose: Bool[Array, ""]
) -> tuple[Scalar, Vector3, Float[Array, "3"]]:
    """Return the point of a simplex that is nearest to the origin; the simplex has w and the used corners.

    The candidates are w, and the three edges, the three triangles and the inside with w.

    Args:
        w: The new corner [m].
        corners: The other corners [m].
        used: True for the corners in use.
        may_enclose: True if no plane is known that separates the simplex from the origin. Only then the inside is a
            candidate.

    Returns:
        The squared distance, the point, and the weights of `corners`; the weight of w is 1 minus their sum.
    """
    eye = jnp.eye(3)
    e = jnp.where(used[:, None], corners - w[None], 0.0)
    f = jnp.roll(e, -1, axis=0)
    n = jnp.cross(e, f)
    along = jnp.clip(safe_divide(-product(e, w), jnp.sum(e * e, axis=1)), 0, 1)
    square = jnp.sum(n * n, axis=1)
    first = safe_divide(jnp.sum(n * jnp.cross(f, w[None]), axis=1), square)
    second = safe_divide(jnp.sum(n * jnp.cross(w[None], e), axis=1), square)
    over = (square > 0) & used & jnp.roll(used, -1) & (first >= 0) & (second >= 0) & (first + second <= 1)
    volume = jnp.sum(e[2] * n[0])
    inner = safe_divide(-product(jnp.roll(n, -1, axis=0), w), jnp.broadcast_to(volume, (3,)))
    inside = (volume != 0) & jnp.all(used & (inner >= 0)) & (jnp.sum(inner) <= 1) & may_enclose
    triangles = first[:, None] * eye + second[:, None] * jnp.roll(eye, 1, axis=1)
    weights = jnp.concatenate([jnp.zeros((1, 3)), along[:, None] * eye, triangles, inner[None]])
    points = w[None] + product(weights, e)
    distance = jnp.where(jnp.arange(8) == 7, 0.0, jnp.sum(points * points, axis=1))
    allowed = jnp.concatenate([jnp.ones(4, bool), over, inside[None]])
    k = jnp.argmin(jnp.where(allowed, distance, jnp.inf))
    return distance[k], points[k], weights[k]
