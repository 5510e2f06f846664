"""Exact signed distance of convex pieces: to points, capsules, boxes, cylinders, half-spaces and other pieces.

The signed distance of two convex bodies A and B is the largest, over all unit normals n, of

    f(n) = min n.a - max n.b    over all a of A and b of B.

Apart, the normal joins the nearest points. The algorithm of Gilbert, Johnson and Keerthi (1988) finds them: it keeps a
simplex of at most four differences a - b, and replaces them by the one furthest towards the origin until f(n), a lower
bound, is the simplex's own distance. That takes two to ten rounds.

Where A and B overlap, n is normal to a face of A - B: to a face of A, a face of B, or to an edge of each, whose arcs on
the Gauss sphere cross (Gregorius, The separating axis test, GDC 2013). An edge's plane bounds f(n) from above wherever
the arcs are, and f(n) is evaluated for the highest bound until none is higher. Every distance is f(n) of a known
normal, so rounding can make it smaller than the true one, never larger.

A capsule is a segment with a radius, and segments, points and boxes are pieces as well. See `solids` for the shapes.
"""

from itertools import product as combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull

from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.numerics import product, safe_divide, safe_norm, segment_parameter
from htcp_jax.types import Array, Bool, Float, Int, Pose, Scalar, Vector3

CONVERGED_M = 1e-11  # difference of the bounds on a distance
TOUCHES_M = 1e-9  # below this distance a normal would be rounding
ROUNDS = 64  # of the search for the nearest points, at most
FLAT = 1e-7  # points that are this close to a plane or line, relative to their extent, are on it
ROUNDING_M = 1e-12  # of the height of an edge's end over a face
PARALLEL = 1e-9  # sine of the angle below which two edges have no common normal
APART_M = 0.01  # distance at which the points of contact of overlapping bodies are found


class ConvexPiece(NamedTuple):
    """A convex polyhedron in its own frame; stacked ones repeat the last vertex, face and edge.

    A polygon, a segment and a point are prisms with no thickness in the directions that they lack.
    """

    vertices: Float[Array, "*n V 3"]
    normals: Float[Array, "*n F 3"]  # of the faces, unit, outwards
    edges: Int[Array, "*n E 2"]  # the vertices, in the direction of the cross product of the sides' normals
    sides: Int[Array, "*n E 2"]  # the faces


class PlacedPiece(NamedTuple):
    """A piece at a pose."""

    piece: ConvexPiece
    T_world: Pose


class PieceContact(NamedTuple):
    """Signed distance of a piece, and where it is attained; at fixed points of both bodies, to first order.

    The distance and the points follow the bodies' poses: distance = normal . (point - witness).
    """

    distance: Scalar  # signed [m]
    normal: Vector3  # from the other body to the piece, unit, world
    point: Vector3  # on the piece, world [m]
    witness: Vector3  # on the other body, world [m]


def make_piece(points: Float[np.ndarray, "P 3"]) -> ConvexPiece:
    """Return the convex hull of at least one point [m]; they may be in a plane, on a line, or equal."""
    middle = points.mean(axis=0)
    _, size, axes = np.linalg.svd(np.concatenate([points - middle, np.zeros((3, 3))]))
    missing = axes[int(np.sum(size > FLAT * size[0])) :] * (size[0] or 1.0)
    thickened = np.array(list(combinations((-1, 1), repeat=len(missing)))) @ missing
    hull = ConvexHull((points[:, None] + thickened[None]).reshape(-1, 3))
    normals, face = np.unique(hull.equations[:, :3].round(12), axis=0, return_inverse=True)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    used, vertex = np.unique(np.arange(len(points)).repeat(len(thickened))[hull.simplices], return_inverse=True)
    corners, vertices = vertex.reshape(-1, 3), points[used]
    edges = {}
    for facet, neighbours in enumerate(hull.neighbors):
        for opposite, other in enumerate(neighbours):  # the neighbour is opposite of the corner
            (a, b), sides = np.delete(corners[facet], opposite), (face[facet], face[other])
            if facet < other and sides[0] != sides[1] and a != b:
                forwards = np.cross(*normals[list(sides)]) @ (vertices[b] - vertices[a]) > 0
                edges[(a, b) if forwards else (b, a), sides] = None
    pairs = np.array(list(edges) or [((0, 0), (0, 0))])
    return ConvexPiece(vertices, normals, pairs[:, 0], pairs[:, 1])


def stack_pieces(pieces: list[ConvexPiece]) -> ConvexPiece:
    """Return the pieces stacked, each padded to the largest."""
    sizes = ConvexPiece(*(max(map(len, column)) for column in zip(*pieces, strict=True)))
    padded = [jax.tree.map(_repeated, piece, sizes) for piece in pieces]
    return jax.tree.map(lambda *each: jnp.asarray(np.stack(each)), *padded)


def _repeated(rows: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(rows)[np.minimum(np.arange(count), len(rows) - 1)]


CUBE = make_piece(np.array(list(combinations((-1.0, 1.0), repeat=3))))


def heights(placed: PlacedPiece, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
    """Return lower bounds on the signed distances of points from a piece [m], exact inside and above a face."""
    piece = _in_world(placed)
    offset = jnp.max(product(piece.normals, piece.vertices.T), axis=1)
    return jnp.max(product(points, piece.normals.T) - offset[None], axis=1)


def piece_contact(placed: PlacedPiece, other: PlacedPiece | Rod | Box | Cylinder | HalfSpace) -> PieceContact:
    """Return the contact of a piece with another body; a point is a rod with p = q and no radius.

    It is differentiable in the pose of the piece, and in that of another piece and the ends of a rod. Rows under
    `jax.vmap` do not affect each other.
    """
    still, fixed = jax.lax.stop_gradient((placed, other))
    piece, radius = _in_world(still), jnp.zeros(())
    if isinstance(other, HalfSpace):
        point = _lowest(piece, fixed.normal)
        distance, normal = product(fixed.normal, point) - fixed.offset, fixed.normal
    else:
        radius = fixed.radius if isinstance(fixed, Rod) else radius
        distance, normal, point = _contact(piece, fixed if isinstance(fixed, Cylinder) else _polyhedron(fixed))
    core = point - distance * normal
    point, core = _carried(placed.T_world, point), _follow(other, core)
    moved = product(normal, point - core) - jax.lax.stop_gradient(product(normal, point - core))
    return PieceContact(distance - radius + moved, normal, point, core + radius * normal)


def _in_world(placed: PlacedPiece) -> ConvexPiece:
    R, t = placed.T_world[:3, :3], placed.T_world[:3, 3]
    vertices = product(placed.piece.vertices, R.T) + t[None]
    return placed.piece._replace(vertices=vertices, normals=product(placed.piece.normals, R.T))


def _polyhedron(other: PlacedPiece | Rod | Box) -> ConvexPiece:
    """Return another body as a piece in the world; of a rod its axis."""
    if isinstance(other, PlacedPiece):
        return _in_world(other)
    if isinstance(other, Rod):
        along = other.q - other.p
        length = safe_norm(along)
        z = jnp.where(length > 0, along / jnp.where(length > 0, length, 1.0), jnp.array([0.0, 0.0, 1.0]))
        x = jnp.cross(z, jnp.eye(3)[jnp.argmin(jnp.abs(z))])
        x = x / safe_norm(x)
        half = jnp.array([0.0, 0.0, 0.5]) * length
        other = Box(jnp.stack([x, jnp.cross(z, x), z], axis=1), (other.p + other.q) / 2, half)
    vertices = product(CUBE.vertices * other.half[None], other.rotation.T) + other.centre[None]
    cube = jax.tree.map(jnp.asarray, CUBE)
    return cube._replace(vertices=vertices, normals=product(cube.normals, other.rotation.T))


def _carried(T: Pose, point: Vector3) -> Vector3:
    """Return a point as one that moves with a frame."""
    R, t = T[:3, :3], T[:3, 3]
    return product(R, jax.lax.stop_gradient(product(point - t, R))) + t


def _follow(other: PlacedPiece | Rod | Box | Cylinder | HalfSpace, point: Vector3) -> Vector3:
    """Return a point of another body as one that moves with it."""
    if isinstance(other, PlacedPiece):
        return _carried(other.T_world, point)
    if isinstance(other, Rod):
        share = jax.lax.stop_gradient(segment_parameter(other.p, other.q, point))
        on = other.p + share * (other.q - other.p)
        return on + jax.lax.stop_gradient(point - on)
    return point


def _argmax(values: Float[Array, "n"]) -> Int[Array, ""]:
    """Return the first index of the largest value; on a CPU in half of the time that `jnp.argmax` takes."""
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


def _best(a: ConvexPiece, b: ConvexPiece | Cylinder, normals: Float[Array, "n 3"]) -> tuple[Scalar, Vector3]:
    """Return the largest f(n) of unit normals [m], and its n. Those of length 0 are ignored."""
    f = jnp.where(jnp.any(normals != 0, axis=1), -_highest(a, -normals) - _highest(b, normals), -jnp.inf)
    k = _argmax(f)
    return f[k], normals[k]


def _overlap(a: ConvexPiece, b: ConvexPiece | Cylinder) -> tuple[Scalar, Vector3]:
    """Return the largest f(n) of all candidates for the normal of least penetration, and its n."""
    if isinstance(b, ConvexPiece):
        return _best_with_edges(a, b, _best(a, b, jnp.concatenate([-a.normals, b.normals])))
    ends = product(a.vertices - b.centre[None], b.rotation)[a.edges]
    own = jax.vmap(b.penetration_normals)(ends[:, 0], ends[:, 1]).reshape(-1, 3)
    return _best(a, b, jnp.concatenate([-a.normals, product(own, b.rotation.T)]))


def _best_with_edges(a: ConvexPiece, b: ConvexPiece, best: tuple[Scalar, Vector3]) -> tuple[Scalar, Vector3]:
    """Return f(n) and n of the best pair of edges, or `best` if none is better.

    An edge d whose sides have the normals m1 and m2, d along m1 x m2, has a positive multiple of d x e on its arc if
    m1.e >= 0 >= m2.e. A pair's bound on f(n) is n.(p - q) for a point p and q on each edge.
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
        own = jnp.cross(d[k // len(e)], e[k % len(e)])
        own = own / safe_norm(own)
        own_f, own = _best(a, b, jnp.stack([own, -own]))
        return bound.at[k].set(-jnp.inf), jnp.maximum(f, own_f), jnp.where(own_f > f, own, normal)

    return jax.lax.while_loop(lambda state: jnp.any(state[0] > state[1]), verify, (bound, *best))[1:]


def _contact(a: ConvexPiece, b: ConvexPiece | Cylinder) -> tuple[Scalar, Vector3, Vector3]:
    """Return distance, normal and the point on `a`.

    The point of contact of overlapping bodies is the nearest one once they are moved apart along the normal.
    """
    near = _nearest(a, b, jnp.zeros(3))

    def overlapping():
        distance, normal = _overlap(a, b)
        shift = (APART_M - distance) * normal
        return distance, normal, _nearest(a, b, shift).point - shift

    return jax.lax.cond(near.lower > TOUCHES_M, lambda: (near.lower, near.normal, near.point), overlapping)


class _Nearest(NamedTuple):
    """The nearest points of two bodies, or the simplex of the search so far."""

    difference: Vector3  # the point of the simplex nearest to the origin
    square: Scalar  # of its length
    weights: Float[Array, "3"]  # of the corners; 0: unused
    corners: Float[Array, "3 3"]
    points: Float[Array, "3 3"]  # the corners' points on the first body
    lower: Scalar  # largest f(n) so far
    normal: Vector3  # the unit normal of that
    done: Bool[Array, ""]
    rounds: Int[Array, ""]

    @property
    def point(self) -> Vector3:
        return product(self.weights, self.points)


def _nearest(a: ConvexPiece, b: ConvexPiece | Cylinder, shift: Vector3) -> _Nearest:
    """Return the nearest points of a piece moved by `shift` and another body."""

    def outermost(direction):
        point = _lowest(a, direction) + shift
        return point, point - _lowest(b, -direction)

    def step(now: _Nearest) -> _Nearest:
        point, corner = outermost(now.difference)
        length = jnp.sqrt(now.square)
        normal = now.difference / length
        f = product(normal, corner)
        lower, normal = jnp.maximum(now.lower, f), jnp.where(f > now.lower, normal, now.normal)
        square, difference, weights = _nearest_of_simplex(corner, now.corners, now.weights > 0, lower <= 0)
        stop = (length - lower <= CONVERGED_M) | ~(square < now.square)
        drop = jnp.arange(3) == jnp.argmin(weights)
        corners = jnp.where(drop[:, None], corner[None], now.corners)
        points = jnp.where(drop[:, None], point[None], now.points)
        weights = jnp.where(drop, 1 - jnp.sum(weights), weights)
        ahead = _Nearest(
            difference, square, weights, corners, points, lower, normal, square <= TOUCHES_M**2 / 4, now.rounds + 1
        )
        stay = now._replace(lower=lower, normal=normal, done=jnp.ones((), bool))
        return jax.tree.map(lambda x, y: jnp.where(stop, x, y), stay, ahead)

    point, corner = outermost(jnp.array([1.0, 0.0, 0.0]))
    square = product(corner, corner)
    start = _Nearest(
        *(corner, square, jnp.array([1.0, 0.0, 0.0]), jnp.stack([corner] * 3), jnp.stack([point] * 3)),
        *(jnp.full((), -jnp.inf), jnp.zeros(3), square == 0, jnp.zeros((), int)),
    )
    return jax.lax.while_loop(lambda now: ~now.done & (now.rounds < ROUNDS), step, start)


def _nearest_of_simplex(
    w: Vector3, corners: Float[Array, "3 3"], used: Bool[Array, "3"], may_enclose: Bool[Array, ""]
) -> tuple[Scalar, Vector3, Float[Array, "3"]]:
    """Return the nearest point to the origin of the simplex of w and the used corners.

    The candidates are w, three edges, three triangles and the inside, each with w. Returned are the squared distance,
    the point and the weights of the corners; that of w is the rest to 1.
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
