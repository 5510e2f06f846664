"""Exact signed distance of convex pieces: to points, capsules, boxes, cylinders, half-spaces and other pieces.

The signed distance of two convex bodies A and B is the largest, over all unit normals n, of

    f(n) = min n.a - max n.b    over all points a of A and b of B.

For separate bodies, n is the direction between their nearest points, see `gjk`. For overlapping bodies, n is normal to
a face of A - B: to a face of A or B, or to an edge of A and an edge of B whose arcs of normals cross on the Gauss
sphere (Gregorius, The separating axis test between convex polyhedra, GDC 2013). A pair of edges bounds f(n) from above
even if the arcs do not cross. Pairs are therefore evaluated in the order of their bounds, until no bound is higher than
the largest f(n) found. Every distance is f(n) of a known n: rounding can make it smaller than the true distance, never
larger.

Segments, points and boxes are pieces, too; a capsule is a segment with a radius.
"""

from functools import cache
from itertools import product as combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.gjk import Nearest, nearest
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.model import ConvexPiece, make_piece
from htcp_jax.numerics import product, safe_divide, safe_norm, segment_parameter
from htcp_jax.types import Array, Float, Int, Pose, Scalar, Vector3

ROUNDING_M = 1e-12  # rounding error of the height of an edge's end over a face
PARALLEL = 1e-9  # sine of the angle below which two edges have no common normal
CLOSE_M = 1e-6  # below this distance a normal from the nearest points is inaccurate; faces' normals are used
APART_M = 0.01  # distance to which overlapping bodies are moved apart to find their contact points


class PlacedPiece(NamedTuple):
    """A piece at a pose."""

    piece: ConvexPiece
    T_world: Pose


class PieceContact(NamedTuple):
    """Signed distance of a piece from another body, and its nearest points: distance = normal . (point - witness)."""

    distance: Scalar  # signed [m]
    normal: Vector3  # from the other body to the piece, unit, world
    point: Vector3  # on the piece, world [m]
    witness: Vector3  # on the other body, world [m]


Body = PlacedPiece | Rod | Box | Cylinder | HalfSpace


@cache
def _cube() -> ConvexPiece:
    return make_piece(np.array(list(combinations((-1.0, 1.0), repeat=3))))


def piece_contact(placed: PlacedPiece, other: Body) -> PieceContact:
    """Return the contact of a piece with another body.

    The other body may be a point: a rod with p = q and radius 0. Distance and points are differentiable in the poses of
    pieces and in the ends of a rod: the points move with their bodies (envelope theorem). Rows under `jax.vmap` do not
    affect each other.
    """
    still, fixed = jax.lax.stop_gradient((_in_world(placed), other))
    if isinstance(fixed, HalfSpace):
        on_piece = _lowest(still, fixed.normal)
        normal, apart = fixed.normal, product(fixed.normal, on_piece) - fixed.offset
    else:
        apart, normal, on_piece = _contact(still, fixed if isinstance(fixed, Cylinder) else _polyhedron(fixed))
    radius = _radius(fixed)
    point = _moved_with(placed, on_piece - placed.piece.radius * normal)
    witness = _moved_with(other, on_piece - (apart - radius) * normal)
    moved = product(normal, point - witness)
    return PieceContact(
        apart - radius - placed.piece.radius + moved - jax.lax.stop_gradient(moved), normal, point, witness
    )


def face_contact(placed: PlacedPiece, other: PlacedPiece, enough_m: Scalar | float = np.inf) -> PieceContact:
    """Return the contact of two pieces; overlapping pieces are compared along the normals of their faces only.

    The distance is exact for separate pieces. For overlapping ones it is a lower bound with the right sign, as pairs of
    edges are not tested. It takes a tenth of the time of `piece_contact`, and has no gradient.

    Args:
        placed: The first piece.
        other: The second piece.
        enough_m: Once the distance is known to be larger, a lower bound above it is returned [m].
    """
    a, b = jax.lax.stop_gradient((_in_world(placed), _in_world(other)))
    enough = jnp.maximum(enough_m, 0.0) + a.radius + b.radius + CLOSE_M
    near = nearest(lambda direction: _lowest(a, direction), lambda direction: _lowest(b, direction), enough)

    def overlapping() -> tuple[Scalar, Vector3, Vector3]:
        distance, normal, k = _best(a, b, jnp.concatenate([b.normals, -a.normals]))
        by_own = k >= len(b.normals)  # True: the normal is that of a face of `a`, nearest to a corner of `b`
        corner = _lowest(b, -normal) + distance * normal
        return distance, normal, jnp.where(by_own, corner, _lowest(a, normal))

    found = jax.lax.cond(near.lower > CLOSE_M, lambda: (near.lower, near.normal, near.point), overlapping)
    apart, normal, point = found
    point = point - a.radius * normal
    distance = apart - a.radius - b.radius
    return PieceContact(distance, normal, point, point - distance * normal)


def _radius(body: Body) -> Scalar:
    if isinstance(body, PlacedPiece):
        return body.piece.radius
    return body.radius if isinstance(body, Rod) else jnp.zeros(())


def _in_world(placed: PlacedPiece) -> ConvexPiece:
    R, t = placed.T_world[:3, :3], placed.T_world[:3, 3]
    vertices = product(placed.piece.vertices, R.T) + t[None]
    return placed.piece._replace(vertices=vertices, normals=product(placed.piece.normals, R.T))


def _polyhedron(other: PlacedPiece | Rod | Box) -> ConvexPiece:
    """Return a body as a convex piece in the world; for a rod, its axis without the radius."""
    if isinstance(other, PlacedPiece):
        return _in_world(other)
    if isinstance(other, Rod):
        length = safe_norm(other.q - other.p)
        along = safe_divide(other.q - other.p, jnp.broadcast_to(length, (3,)))
        z = jnp.where(length > 0, along, jnp.array([0.0, 0.0, 1.0]))
        x = jnp.cross(z, jnp.eye(3)[jnp.argmin(jnp.abs(z))])
        x = x / safe_norm(x)
        half = jnp.array([0.0, 0.0, 0.5]) * length
        other = Box(jnp.stack([x, jnp.cross(z, x), z], axis=1), (other.p + other.q) / 2, half)
    cube = _cube()
    vertices = product(cube.vertices * other.half[None], other.rotation.T) + other.centre[None]
    return cube._replace(vertices=vertices, normals=product(jnp.asarray(cube.normals), other.rotation.T))


def _moved_with(body: Body, point: Vector3) -> Vector3:
    """Return the point, differentiable as a point fixed to the body."""
    point = jax.lax.stop_gradient(point)
    if isinstance(body, PlacedPiece):
        R, t = body.T_world[:3, :3], body.T_world[:3, 3]
        moved = product(R, jax.lax.stop_gradient(product(point - t, R))) + t
    elif isinstance(body, Rod):
        moved = body.p + jax.lax.stop_gradient(segment_parameter(body.p, body.q, point)) * (body.q - body.p)
    else:
        return point
    return point + moved - jax.lax.stop_gradient(moved)


def _argmax(values: Float[Array, "n"]) -> Int[Array, ""]:
    """Return the first index of the largest value; on a CPU this takes half the time of `jnp.argmax`."""
    numbers = jnp.arange(values.size, dtype=jnp.int32)
    return jnp.min(jnp.where(values == jnp.max(values), numbers, values.size - 1))


def _dot(a: Float[Array, "n 3"], b: Float[Array, "m 3"]) -> Float[Array, "n m"]:
    return sum(a[:, i, None] * b[None, :, i] for i in range(3))


def _lowest(body: ConvexPiece | Cylinder, direction: Vector3) -> Vector3:
    """Return the point of a body that is lowest along a direction."""
    if isinstance(body, ConvexPiece):
        return body.vertices[_argmax(_dot(body.vertices, -direction[None])[:, 0])]
    own = product(direction, body.rotation)
    flat = own * jnp.array([1.0, 1.0, 0.0])
    aside = -body.radius * safe_divide(flat, jnp.broadcast_to(safe_norm(flat), (3,)))
    end = jnp.where(own[2] > 0, -body.half, body.half)
    return body.centre + product(body.rotation, aside.at[2].set(end))


def _highest(body: ConvexPiece | Cylinder, normals: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Return max n.x over a body for each normal."""
    if isinstance(body, ConvexPiece):
        return jnp.max(_dot(normals, body.vertices), axis=1)
    own = product(normals, body.rotation)
    rim = body.radius * safe_norm(own * jnp.array([[1.0, 1.0, 0.0]]))
    return product(normals, body.centre) + rim + body.half * jnp.abs(own[:, 2])


def _contact(a: ConvexPiece, b: ConvexPiece | Cylinder) -> tuple[Scalar, Vector3, Vector3]:
    """Return the signed distance [m], the normal, and the contact point on `a` [m], without the bodies' radii.

    Bodies that overlap or nearly do are first moved apart along the normal, to find the contact point.
    """

    def close() -> tuple[Scalar, Vector3, Vector3]:
        distance, normal = _least_penetration(a, b)
        found = jnp.where(near.lower > distance, near.normal, normal)
        distance = jnp.maximum(near.lower, distance)
        shift = (APART_M - distance) * found
        return distance, found, search(shift).point - shift

    def search(shift: Vector3) -> Nearest:
        return nearest(lambda direction: _lowest(a, direction) + shift, lambda direction: _lowest(b, direction))

    near = search(jnp.zeros(3))
    return jax.lax.cond(near.lower > CLOSE_M, lambda: (near.lower, near.normal, near.point), close)


def _least_penetration(a: ConvexPiece, b: ConvexPiece | Cylinder) -> tuple[Scalar, Vector3]:
    """Return the largest f(n) [m] over all candidates n for the normal of least penetration, and this n."""
    if isinstance(b, ConvexPiece):
        return _best_with_edges(a, b, _best(a, b, jnp.concatenate([-a.normals, b.normals]))[:2])
    ends = product(a.vertices - b.centre[None], b.rotation)[a.edges]
    own = jax.vmap(b.penetration_normals)(ends[:, 0], ends[:, 1]).reshape(-1, 3)
    return _best(a, b, jnp.concatenate([-a.normals, product(own, b.rotation.T)]))[:2]


def _best(
    a: ConvexPiece, b: ConvexPiece | Cylinder, normals: Float[Array, "n 3"]
) -> tuple[Scalar, Vector3, Int[Array, ""]]:
    """Return the largest f(n) over unit normals [m], this normal n, and its row. Normals of length 0 are ignored."""
    f = jnp.where(jnp.any(normals != 0, axis=1), -_highest(a, -normals) - _highest(b, normals), -jnp.inf)
    k = _argmax(f)
    return f[k], normals[k], k


def _best_with_edges(a: ConvexPiece, b: ConvexPiece, best: tuple[Scalar, Vector3]) -> tuple[Scalar, Vector3]:
    """Return f(n) and n of the best pair of edges d and e, or `best` if no pair is better.

    Let m1 and m2 be the normals of the faces at edge d, with d along m1 x m2. The arc of normals of d contains a
    positive multiple of d x e if m1.e >= 0 >= m2.e. A pair's bound on f(n) is n.(p - q), for points p of d and q of e.
    """
    p, q = a.vertices[a.edges], b.vertices[b.edges]
    d, e = p[:, 1] - p[:, 0], q[:, 1] - q[:, 0]
    first, second = (_dot(a.normals[a.sides[:, k]], e) for k in (0, 1))
    third, fourth = (_dot(d, b.normals[b.sides[:, k]]) for k in (0, 1))
    forwards = (jnp.minimum(first, third) >= -ROUNDING_M) & (jnp.maximum(second, fourth) <= ROUNDING_M)
    backwards = (jnp.maximum(first, third) <= ROUNDING_M) & (jnp.minimum(second, fourth) >= -ROUNDING_M)
    across = [d[:, i, None] * e[None, :, j] - d[:, j, None] * e[None, :, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    square = sum(c * c for c in across)
    along = sum(c * (p[:, 0, i, None] - q[None, :, 0, i]) for i, c in enumerate(across))
    size = jnp.sum(d * d, axis=1)[:, None] * jnp.sum(e * e, axis=1)[None]
    crosses = (forwards | backwards) & (square > PARALLEL**2 * size)
    bound = jnp.where(forwards, -along, along) / jnp.sqrt(jnp.where(crosses, square, 1.0))
    bound = jnp.where(crosses, bound, -jnp.inf).reshape(-1)

    def verify(state):
        bound, f, normal = state
        k = _argmax(bound)
        n = jnp.cross(d[k // len(e)], e[k % len(e)])
        n = n / safe_norm(n)
        own_f, n, _ = _best(a, b, jnp.stack([n, -n]))
        return bound.at[k].set(-jnp.inf), jnp.maximum(f, own_f), jnp.where(own_f > f, n, normal)

    return jax.lax.while_loop(lambda state: jnp.any(state[0] > state[1]), verify, (bound, *best))[1:]
