"""Signed distance from a segment to the solids of a cell: half-spaces, capsules, boxes, cylinders and convex pieces.

The signed distance of a segment to a convex solid S is the largest, over all unit normals n, of

    min(n.p, n.q) - h(n),    h(n) = max n.x over all x of S.

If the segment is outside S, n points from the nearest point of S to the segment's nearest point:

    half-space, capsule   closed form
    box                   the slope of the squared distance along the segment is piecewise linear; its zero lies between
                          two of eight places
    cylinder              bisection along the segment
    convex piece          an end of the segment above a face, or a point of an edge

If the segment crosses S, n is the best of finitely many candidates: normals of S swept along the segment. For a box and
a convex piece they are the normals of its faces, and normals perpendicular to the segment and an edge. For a cylinder
they are the normals of its caps and side, and one perpendicular to the segment, found by bisection.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.segments import nearest_points
from htcp_jax.numerics import product, safe_divide, safe_norm, segment_parameter
from htcp_jax.types import Array, Bool, Float, Int, Scalar, Vector3

HALVINGS = 48  # halvings of a segment, to 1e-14 of its length
TOUCHES_M = 1e-9  # below this distance a normal would consist of rounding errors


class SolidContact(NamedTuple):
    """Signed distance from a solid to a segment, and the point of the segment at which it is attained."""

    t: Scalar  # parameter on the segment, 0 to 1
    normal: Vector3  # from the solid to the segment, unit
    distance: Scalar  # signed [m]
    plane: Bool[Array, ""]  # True: the distance is to the plane n.x = h(n); False: to a fixed point
    extent: Scalar  # distance from the fixed point to the solid's surface [m]


class HalfSpace(NamedTuple):
    """The half-space below a plane: normal . x <= offset [m]."""

    normal: Float[Array, "*n 3"]
    offset: Float[Array, "*n"]

    def contact(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with the segment from p to q, at the segment's lower end, see `SolidContact`."""
        heights = jnp.stack([product(p, self.normal), product(q, self.normal)]) - self.offset
        return SolidContact(
            jnp.argmin(heights).astype(float), self.normal, jnp.min(heights), jnp.ones((), bool), jnp.zeros(())
        )


class Rod(NamedTuple):
    """A capsule with the axis from p to q [m]; a sphere if p = q."""

    p: Float[Array, "*n 3"]
    q: Float[Array, "*n 3"]
    radius: Float[Array, "*n"]

    def contact(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with the segment from p to q, see `SolidContact`; the normal is 0 where the axes cross."""
        t, _, on, other = nearest_points(p, q, self.p, self.q)
        length = safe_norm(on - other)
        normal = safe_divide(on - other, jnp.broadcast_to(length, (3,)))
        return SolidContact(t, normal, length - self.radius, jnp.zeros((), bool), self.radius)


class Box(NamedTuple):
    """A box with the half sizes `half` along its own axes [m]."""

    rotation: Float[Array, "*n 3 3"]
    centre: Float[Array, "*n 3"]
    half: Float[Array, "*n 3"]

    def contact(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with a segment, see `SolidContact`."""
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
        faces, adjacent = _both(axes), _both(_units(jnp.cross(axes, d[None])))
        corners, normals = jnp.sign(adjacent) * self.half[None], jnp.concatenate([faces, adjacent])
        places = jnp.concatenate([_lower(faces, p, q), _level(adjacent, p, q, corners, _both(axes))])
        across = _least_penetration(normals, p, q, jnp.sum(jnp.abs(normals) * self.half[None], axis=1), places)
        return _rotated_to_world(self, _outside_or_across(_outside(t, outside), across))


class Cylinder(NamedTuple):
    """A cylinder with a radius and a half length along its own z axis [m]."""

    rotation: Float[Array, "*n 3 3"]
    centre: Float[Array, "*n 3"]
    radius: Float[Array, "*n"]
    half: Float[Array, "*n"]

    def contact(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with a segment, see `SolidContact`."""
        p, q = _within(self, p), _within(self, q)
        d = q - p
        t = _bisected_parameter(lambda t: product(self._off(p + t * d), d) <= 0, jnp.zeros(()))
        return _rotated_to_world(self, _outside_or_across(_outside(t, self._off(p + t * d)), self._across(p, q)))

    def _across(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with a segment that crosses the cylinder.

        The candidates are the normals of the caps, of the side, and one perpendicular to the segment.
        """
        x, z, flat = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 1.0, 0.0])
        d = q - p
        middle = segment_parameter(p * flat, q * flat, jnp.zeros(3))
        rim = self._rim(p, d, p)
        normals = _units(jnp.stack([z, -z, (p + middle * d) * flat, _towards(jnp.cross(d, z), p), rim, x]))
        extent = self.radius * safe_norm(normals * flat[None]) + self.half * jnp.abs(normals[:, 2])
        places = jnp.where(normals[:, 2] == 0, middle, _lower(normals, p, q))
        return _least_penetration(normals, p, q, extent, places.at[4].set(self._nearest_side(p, d, normals[4])))

    def penetration_normals(self, p: Vector3, q: Vector3) -> Float[Array, "12 3"]:
        """Return candidates for the normal of least penetration by a body's edge, in the cylinder's frame.

        They have length 1 or 0: the normals of the caps, of the side at the edge's ends, and normals perpendicular to
        the edge.
        """
        z, flat = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 1.0, 0.0])
        d = q - p
        rims = [self._rim(p, d, side) for side in (z, -z)]
        one_way = _units(jnp.stack([z, p * flat, q * flat, jnp.cross(d, z), *rims]))
        return _both(one_way)

    def _rim(self, p: Vector3, d: Vector3, side: Vector3) -> Vector3:
        """Return the normal of least penetration that is perpendicular to a segment through p, on the given side.

        In the projection along the segment, the cylinder is an ellipse swept up and down, and p is a point (u, v)
        relative to the upper ellipse's centre. The normal at angle f of the ellipse passes through p if
        u sin f - v c cos f = r s^2 sin f cos f, with `c` and `s` the segment's rise and run. For v < 0 two such f may
        exist, one on each side of tan^3 f = -v c / u; the larger one belongs to the nearest point.
        """
        along = _units(d[None])[0]
        aside = _towards(_units(jnp.array([[-d[1], d[0], 0.0]]))[0], p)
        up = _towards(jnp.cross(aside, along), side)
        c, s = jnp.abs(along[2]), jnp.abs(up[2])
        u, v = product(p, aside), product(p, up) - self.half * s

        def short(sine):
            cosine = jnp.sqrt(1 - sine * sine)
            return u * sine - v * c * cosine < self.radius * s * s * sine * cosine

        least = jnp.cbrt(jnp.maximum(-v * c, 0.0))
        sine = _bisected_parameter(short, safe_divide(least, jnp.hypot(least, jnp.cbrt(u))))
        return c * jnp.sqrt(1 - sine * sine) * aside + sine * up

    def _nearest_side(self, p: Vector3, d: Vector3, normal: Vector3) -> Scalar:
        """Return the parameter on a segment from p that is nearest to the cylinder's outermost point along a normal."""
        round_ = jnp.array([1.0, 1.0, 0.0]) * normal
        outermost = self.radius * _units(round_[None])[0] + (self.half * jnp.sign(normal)).at[:2].set(0.0)
        return jnp.clip(safe_divide(product(outermost - p, d), product(d, d)), 0, 1)

    def _off(self, x: Vector3) -> Vector3:
        """Return the vector from the nearest point of the cylinder to x."""
        flat = jnp.array([1.0, 1.0, 0.0])
        away = safe_norm(x * flat)
        aside = jnp.maximum(away - self.radius, 0.0) * safe_divide(x * flat, jnp.broadcast_to(away, (3,)))
        return aside.at[2].set(x[2] - jnp.clip(x[2], -self.half, self.half))


class Polyhedron(NamedTuple):
    """A convex polyhedron in the world [m].

    In a stack of polyhedra, those with fewer faces or edges are padded with their last face and edge.
    """

    corners: Float[Array, "*n F 3 3"]  # corners of the F triangles [m]
    normal: Float[Array, "*n F 3"]  # outward unit normals of the triangles
    edges: Float[Array, "*n E 2 3"]  # both ends of each edge [m]
    adjacent: Int[Array, "*n E 2"]  # indices of the triangles on both sides of each edge

    def contact(self, p: Vector3, q: Vector3) -> SolidContact:
        """Return the contact with a segment, see `SolidContact`."""
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
        across = _least_penetration(*self._normals(p, q))
        return jax.tree.map(lambda a, b: jnp.where(within, a, b), across, outside)

    @property
    def _offset(self) -> Float[Array, "F"]:
        return jnp.sum(self.normal * self.corners[:, 0], axis=1)

    def _above(self, x: Vector3) -> Float[Array, "F 3"]:
        """Return the perpendicular from every face to x [m]; infinite for faces that x is not above."""
        height = product(self.normal, x) - self._offset
        sides = jnp.roll(self.corners, -1, axis=1) - self.corners
        inwards = jnp.cross(self.normal[:, None], sides)
        over = jnp.all(jnp.sum(inwards * (x[None, None] - self.corners), axis=2) >= 0, axis=1) & (height >= 0)
        return jnp.where(over[:, None], height[:, None] * self.normal, jnp.inf)

    def _clipped(self, heights: Float[Array, "2 F"]) -> Bool[Array, ""]:
        """Return True if a part of the segment is inside, given the heights of its ends over all faces [m]."""
        at = safe_divide(heights[0], heights[0] - heights[1])
        enters = jnp.max(jnp.where(heights[0] > 0, jnp.where(heights[1] > 0, 2.0, at), 0.0))
        leaves = jnp.min(jnp.where((heights[1] > 0) & (heights[0] <= 0), at, 1.0))
        return enters <= leaves

    def _normals(self, p: Vector3, q: Vector3):
        """Return the arguments of `_least_penetration` for a segment that crosses the polyhedron.

        The candidates are the normals of the faces, and of planes along the silhouette edges as seen along the segment.
        """
        sides = product(self.normal, q - p)[self.adjacent]
        outline = sides[:, 0] * sides[:, 1] <= 0
        edges = self.edges[:, 1] - self.edges[:, 0]
        along = _units(jnp.cross(edges, (q - p)[None]))
        outwards = jnp.sum(along * jnp.sum(self.normal[self.adjacent], axis=1), axis=1)
        along = along * jnp.where(outwards < 0, -1.0, 1.0)[:, None]
        extent = jnp.where(outline & jnp.any(along != 0, axis=1), jnp.sum(along * self.edges[:, 0], axis=1), jnp.inf)
        places = jnp.concatenate([_lower(self.normal, p, q), _level(along, p, q, self.edges[:, 0], edges)])
        return jnp.concatenate([self.normal, along]), p, q, jnp.concatenate([self._offset, extent]), places


Solid = HalfSpace | Rod | Box | Cylinder | Polyhedron


def _within(solid: Box | Cylinder, x: Vector3) -> Vector3:
    return product(x - solid.centre, solid.rotation)


def _rotated_to_world(solid: Box | Cylinder, seen: SolidContact) -> SolidContact:
    return seen._replace(normal=product(solid.rotation, seen.normal))


def _outside(t: Scalar, arm: Vector3) -> SolidContact:
    """Return the contact with a segment outside a solid, from the vector `arm` between the nearest points [m]."""
    length = safe_norm(arm)
    normal = safe_divide(arm, jnp.broadcast_to(length, (3,)))
    return SolidContact(t, normal, length, length <= TOUCHES_M, jnp.zeros(()))


def _least_penetration(
    normals: Float[Array, "n 3"], p: Vector3, q: Vector3, extent: Float[Array, "n"], places: Float[Array, "n"]
) -> SolidContact:
    """Return the contact along the normal of least penetration.

    Args:
        normals: Candidates; normals of length 0 are ignored.
        p: First end of the segment [m].
        q: Second end [m].
        extent: h(n) of each normal [m].
        places: Parameter on the segment for each normal, 0 to 1.
    """
    ends = product(jnp.stack([p, q]), normals.T)
    depth = jnp.where(jnp.any(normals != 0, axis=1), jnp.min(ends, axis=0) - extent, -jnp.inf)
    k = jnp.argmax(depth)
    return SolidContact(places[k], normals[k], depth[k], jnp.ones((), bool), jnp.zeros(()))


def _lower(normals: Float[Array, "n 3"], p: Vector3, q: Vector3) -> Float[Array, "n"]:
    """Return the parameter of the end that is lower along each normal: 0 for p, 1 for q."""
    return (product(normals, q - p) < 0).astype(float)


def _level(
    normals: Float[Array, "n 3"], p: Vector3, q: Vector3, points: Float[Array, "n 3"], edges: Float[Array, "n 3"]
) -> Float[Array, "n"]:
    """Return the parameter at which the segment crosses each edge, as seen along the normal.

    An edge is a line through a point of `points`; its normal is perpendicular to the edge and to the segment.
    """
    over = jnp.sum(jnp.cross(points - p[None], edges) * normals, axis=1)
    return jnp.clip(safe_divide(over, jnp.sum(jnp.cross((q - p)[None], edges) * normals, axis=1)), 0, 1)


def _bisected_parameter(short: Callable[[Scalar], Bool[Array, ""]], low: Scalar) -> Scalar:
    """Return the parameter between `low` and 1 at which `short` becomes false, by bisection.

    The result is exactly `low` if `short` is false everywhere, and exactly 1 if it is true everywhere.
    """

    def halve(_, between):
        low, high = between
        middle = 0.5 * (low + high)
        yes = short(middle)
        return jnp.where(yes, middle, low), jnp.where(yes, high, middle)

    first = low
    low, high = jax.lax.fori_loop(0, HALVINGS, halve, (low, jnp.ones(())))
    return jnp.where(low == first, first, jnp.where(high == 1, 1.0, 0.5 * (low + high)))


def _outside_or_across(outside: SolidContact, across: SolidContact) -> SolidContact:
    return jax.tree.map(lambda a, b: jnp.where(outside.plane, a, b), across, outside)


def _towards(normal: Vector3, p: Vector3) -> Vector3:
    """Return `normal` or -`normal`, whichever points to the side of the origin on which p lies."""
    return jnp.where(product(normal, p) < 0, -1.0, 1.0) * normal


def _both(normals: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    return jnp.concatenate([normals, -normals])


def _units(vectors: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    length = safe_norm(vectors)
    long = length > 1e-9 * jnp.max(length, initial=1e-300)
    return jnp.where(long[:, None], vectors / jnp.where(long, length, 1.0)[:, None], 0.0)
