"""How far a segment is from the solids of a cell: half-spaces, capsules, boxes, cylinders and convex pieces.

The signed distance of a segment to a convex solid S is the largest, over all unit normals n, of

    min(n.p, n.q) - h(n),    h(n) = max n.x over all x of S.

Outside, n points from the nearest point of S to the nearest of the segment, which closed forms find: for a half-space
and a capsule at once; for a box the slope of the squared distance along the segment is piecewise linear, and its zero
lies between two of eight places; for a cylinder it is found by halving; for a convex piece the nearest is an end of the
segment above a face, or a point of an edge. Where the segment crosses S, n is the best of those that may be the best:
of a box and a piece the normals of faces, and those at right angles to the segment and an edge. Of a cylinder some are
left out, so that what is found there is a bound from below.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.segments import nearest_points
from htcp_jax.numerics import product, safe_divide, safe_norm, segment_parameter
from htcp_jax.types import Array, Bool, Float, Int, Scalar, Vector3

HALVINGS = 48  # of a segment: to 1e-14 of its length
TOUCHES_M = 1e-9  # nearer, a normal would be rounding


class Seen(NamedTuple):
    """A solid as a segment sees it."""

    t: Scalar  # which point of the segment, 0 to 1
    normal: Vector3  # from the solid to the segment, unit
    distance: Scalar  # signed [m]
    plane: Bool[Array, ""]  # whether the distance is to the plane n.x = h(n): it is held, not a point
    reach: Scalar  # from the point that is held to the solid's surface [m]


class HalfSpace(NamedTuple):
    """What lies below a plane: normal . x <= offset."""

    normal: Float[Array, "*n 3"]
    offset: Float[Array, "*n"]

    def seen(self, p: Vector3, q: Vector3) -> Seen:
        """By the lower end of a segment."""
        heights = jnp.stack([product(p, self.normal), product(q, self.normal)]) - self.offset
        return Seen(jnp.argmin(heights).astype(float), self.normal, jnp.min(heights), jnp.ones((), bool), jnp.zeros(()))


class Rod(NamedTuple):
    """A capsule, or with p = q a sphere."""

    p: Float[Array, "*n 3"]
    q: Float[Array, "*n 3"]
    radius: Float[Array, "*n"]

    def seen(self, p: Vector3, q: Vector3) -> Seen:
        """By a segment; where the axes cross, there is no normal."""
        t, _, on, other = nearest_points(p, q, self.p, self.q)
        length = safe_norm(on - other)
        normal = safe_divide(on - other, jnp.broadcast_to(length, (3,)))
        return Seen(t, normal, length - self.radius, jnp.zeros((), bool), self.radius)


class Box(NamedTuple):
    """A box of half these sizes about its centre."""

    rotation: Float[Array, "*n 3 3"]
    centre: Float[Array, "*n 3"]
    half: Float[Array, "*n 3"]

    def seen(self, p: Vector3, q: Vector3) -> Seen:
        """By a segment."""
        p, q = _within(self, p), _within(self, q)
        d = q - p
        faces = jnp.concatenate([safe_divide(self.half - p, d), safe_divide(-self.half - p, d)])
        places = jnp.concatenate([jnp.array([0.0, 1.0]), jnp.clip(faces, 0, 1)])
        at = p[None] + places[:, None] * d[None]
        slope = product(at - jnp.clip(at, -self.half[None], self.half[None]), d)
        lower, upper = jnp.argmax(jnp.where(slope <= 0, places, -1)), jnp.argmin(jnp.where(slope >= 0, places, 2))
        rise = slope[upper] - slope[lower]
        share = jnp.where(rise > 0, -slope[lower] / jnp.where(rise > 0, rise, 1.0), 0.5)
        t = places[lower] + share * (places[upper] - places[lower])
        t = jnp.where(slope[0] > 0, 0.0, jnp.where(slope[1] < 0, 1.0, t))
        x = p + t * d
        outside = x - jnp.clip(x, -self.half, self.half)
        axes = jnp.eye(3)
        normals = _both(jnp.concatenate([axes, _units(jnp.cross(axes, d[None]))]))
        across = _best(normals, p, q, jnp.sum(jnp.abs(normals) * self.half[None], axis=1))
        return _turned(self, _either(_outside(t, outside), across))


class Cylinder(NamedTuple):
    """A cylinder of a radius and half a length along its own z."""

    rotation: Float[Array, "*n 3 3"]
    centre: Float[Array, "*n 3"]
    radius: Float[Array, "*n"]
    half: Float[Array, "*n"]

    def seen(self, p: Vector3, q: Vector3) -> Seen:
        """By a segment; where it crosses, a bound from below."""
        p, q = _within(self, p), _within(self, q)
        d = q - p

        def halve(_, between):
            low, high = between
            t = 0.5 * (low + high)
            rising = product(self._off(p + t * d), d) > 0
            return jnp.where(rising, low, t), jnp.where(rising, t, high)

        low, high = jax.lax.fori_loop(0, HALVINGS, halve, (jnp.zeros(()), jnp.ones(())))
        t = 0.5 * (low + high)
        t = jnp.where(low == 0, 0.0, jnp.where(high == 1, 1.0, t))
        x, z, flat = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 1.0, 0.0])
        on = (p + segment_parameter(p * flat, q * flat, jnp.zeros(3)) * d) * flat
        beside = jnp.cross(d, z)
        normals = _both(_units(jnp.stack([x, z, on, beside, jnp.cross(d, beside)])))
        reach = self.radius * safe_norm(normals * flat[None]) + self.half * jnp.abs(normals[:, 2])
        return _turned(self, _either(_outside(t, self._off(p + t * d)), _best(normals, p, q, reach)))

    def _off(self, x: Vector3) -> Vector3:
        """From the nearest point of the cylinder."""
        flat = jnp.array([1.0, 1.0, 0.0])
        away = safe_norm(x * flat)
        aside = jnp.maximum(away - self.radius, 0.0) * safe_divide(x * flat, jnp.broadcast_to(away, (3,)))
        return aside.at[2].set(x[2] - jnp.clip(x[2], -self.half, self.half))


class Piece(NamedTuple):
    """A convex polyhedron in the world; of stacked ones the last face and edge are repeated."""

    corners: Float[Array, "*n F 3 3"]  # of its triangles
    normal: Float[Array, "*n F 3"]  # theirs, unit, outwards
    edges: Float[Array, "*n E 2 3"]
    beside: Int[Array, "*n E 2"]  # the faces on both sides of an edge

    def seen(self, p: Vector3, q: Vector3) -> Seen:
        """By a segment."""
        many = jnp.broadcast_to(p, (len(self.edges), 3)), jnp.broadcast_to(q, (len(self.edges), 3))
        along, _, on, witness = nearest_points(*many, self.edges[:, 0], self.edges[:, 1])
        first, second = self._above(p), self._above(q)
        arms = jnp.concatenate([on - witness, first, second])
        faces = jnp.zeros(len(self.normal))
        length = safe_norm(arms)
        k = jnp.argmin(length)
        outside = _outside(jnp.concatenate([along, faces, faces + 1])[k], arms[k])
        heights = product(jnp.stack([p, q]), self.normal.T) - self._offset[None]
        within = self._clipped(heights)
        across = _best(*self._normals(p, q))
        return jax.tree.map(lambda a, b: jnp.where(within, a, b), across, outside)

    @property
    def _offset(self) -> Float[Array, "F"]:
        return jnp.sum(self.normal * self.corners[:, 0], axis=1)

    def _above(self, x: Vector3) -> Float[Array, "F 3"]:
        """From every face to a point that stands over it; infinitely long where it does not."""
        height = product(self.normal, x) - self._offset
        sides = jnp.roll(self.corners, -1, axis=1) - self.corners
        inwards = jnp.cross(self.normal[:, None], sides)
        over = jnp.all(jnp.sum(inwards * (x[None, None] - self.corners), axis=2) >= 0, axis=1) & (height >= 0)
        return jnp.where(over[:, None], height[:, None] * self.normal, jnp.inf)

    def _clipped(self, heights: Float[Array, "2 F"]) -> Bool[Array, ""]:
        """Whether a part of the segment is inside: its ends' heights over all faces."""
        at = safe_divide(heights[0], heights[0] - heights[1])
        enters = jnp.max(jnp.where(heights[0] > 0, jnp.where(heights[1] > 0, 2.0, at), 0.0))
        leaves = jnp.min(jnp.where((heights[1] > 0) & (heights[0] <= 0), at, 1.0))
        return enters <= leaves

    def _normals(self, p: Vector3, q: Vector3):
        """Those of the faces, and of planes along an edge that the segment's direction touches the piece at; with the
        segment and their reach."""
        ways = product(self.normal, q - p)[self.beside]
        outline = ways[:, 0] * ways[:, 1] <= 0
        along = _units(jnp.cross(self.edges[:, 1] - self.edges[:, 0], (q - p)[None]))
        outwards = jnp.sum(along * jnp.sum(self.normal[self.beside], axis=1), axis=1)
        along = along * jnp.where(outwards < 0, -1.0, 1.0)[:, None]
        reach = jnp.where(outline & jnp.any(along != 0, axis=1), jnp.sum(along * self.edges[:, 0], axis=1), jnp.inf)
        return jnp.concatenate([self.normal, along]), p, q, jnp.concatenate([self._offset, reach])


Solid = HalfSpace | Rod | Box | Cylinder | Piece


def _within(solid: Box | Cylinder, x: Vector3) -> Vector3:
    return product(x - solid.centre, solid.rotation)


def _turned(solid: Box | Cylinder, seen: Seen) -> Seen:
    return seen._replace(normal=product(solid.rotation, seen.normal))


def _outside(t: Scalar, arm: Vector3) -> Seen:
    """By the way from the solid's nearest point to the segment's."""
    length = safe_norm(arm)
    normal = safe_divide(arm, jnp.broadcast_to(length, (3,)))
    return Seen(t, normal, length, length <= TOUCHES_M, jnp.zeros(()))


def _best(normals: Float[Array, "n 3"], p: Vector3, q: Vector3, reach: Float[Array, "n"]) -> Seen:
    """Along the normal by which the segment sticks in the least; `reach` is h(n). A normal of length 0 is none."""
    ends = product(jnp.stack([p, q]), normals.T)
    depth = jnp.where(jnp.any(normals != 0, axis=1), jnp.min(ends, axis=0) - reach, -jnp.inf)
    k = jnp.argmax(depth)
    lower = (ends[1, k] < ends[0, k]).astype(float)
    return Seen(lower, normals[k], depth[k], jnp.ones((), bool), jnp.zeros(()))


def _either(outside: Seen, across: Seen) -> Seen:
    return jax.tree.map(lambda a, b: jnp.where(outside.plane, a, b), across, outside)


def _both(normals: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    return jnp.concatenate([normals, -normals])


def _units(vectors: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    length = safe_norm(vectors)
    long = length > 1e-9 * jnp.max(length, initial=1e-300)
    return jnp.where(long[:, None], vectors / jnp.where(long, length, 1.0)[:, None], 0.0)
