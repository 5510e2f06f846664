"""Solids of the work cell as an obstacle, fixed in the world.

A body that is fixed in the world, such as the arm's base, is not checked. Nor are bodies of the first link against a
solid that they touch at x = 0: an arm stands on its pedestal; nor those of links that a solid's fixture excludes.

Half-spaces, capsules, boxes and cylinders are all measured. Convex pieces are measured only if their bounding ball is
nearer than the smallest distance so far: one after the other, the nearest ball first.
"""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import product
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Polyhedron, Rod, Solid, SolidContact
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle
from htcp_jax.model import ConvexPiece, Robot, convex_piece, kinematics
from htcp_jax.numerics import one_by_one
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Array, Bool, Float, Int

SIDES = 48  # of the prism about a cylinder: 0.2 % wider than it
CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))

Ends = Float[Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class Fixtures(Obstacle):
    """Solids in the world, stacked by kind, and the mask of pairs of solid and body (K bodies) that are checked."""

    simple: tuple[HalfSpace | Rod | Box | Cylinder, ...]
    pieces: Polyhedron | None
    balls: Float[jax.Array, "P 4"]  # about the pieces: centre, radius [m]
    is_checked: Bool[jax.Array, "G K"]  # True: the pair is checked; the simple solids first
    names: tuple[str, ...] = field(metadata=LABEL)
    solids: ConvexPiece | None = None  # all but half-spaces in the order of the names, for an arm with pieces

    in_pairs = True

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with its nearest solid."""
        if robot.pieces is not None:
            return narrow_phase.decide(robot, bodies, [self.doubts(robot, where, bodies)])[0]
        return self._nearest(bodies.p, bodies.q, robot.capsule_radius, self.is_checked)

    def doubts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> narrow_phase.Doubts:
        """Return the bodies whose capsules are in doubt, and the solids near them."""
        if self.solids is None and not all(isinstance(kind, HalfSpace) for kind in (*self.simple, self.pieces) if kind):
            raise ValueError("fixtures for an arm without pieces are measured for an arm with pieces")
        capsules = self._nearest(bodies.p, bodies.q, robot.capsule_radius, self.is_checked)
        limit = narrow_phase.limit_m(where)
        doubt = narrow_phase.in_doubt(capsules.distance, robot.pieces.excess_m, limit)
        parts = [_each_seen(kind, bodies.p, bodies.q).distance - robot.capsule_radius[None] for kind in self.simple]
        if self.pieces is not None:
            parts.append(narrow_phase.ball_bounds(bodies.p, bodies.q, robot.capsule_radius, self.balls))
        lower = jnp.where(self.is_checked & doubt[None], jnp.concatenate(parts), jnp.inf)
        solid, body = jnp.indices(lower.shape).reshape(2, -1)
        planes = next((kind for kind in self.simple if isinstance(kind, HalfSpace)), None)
        known = narrow_phase.undecided(capsules, limit)
        return narrow_phase.Doubts(capsules, doubt, known, body, solid, body, lower.reshape(-1), self.solids, planes)

    def touches_along(
        self,
        robot: Robot,
        where: HasWorkpiecePose,
        bodies: BodyAxes,
        body: Int[jax.Array, ""],
        requested: Bool[jax.Array, "S"],
    ) -> Bool[jax.Array, ""]:
        """Return True if a body touches at any of the marked configurations."""
        is_checked = self.is_checked[:, body, None] & requested[None]
        radius = jnp.broadcast_to(robot.capsule_radius[body], requested.shape)
        return jnp.any(self._nearest(bodies.p[:, body], bodies.q[:, body], radius, is_checked).distance <= 0)

    def distances(self, robot: Robot, p: Ends, q: Ends) -> Float[jax.Array, "G K"]:
        """Return the distance of every solid to every body, in the order of the names, without the mask."""
        kinds = (*self.simple, *(() if self.pieces is None else (self.pieces,)))
        found = jnp.concatenate([_each_seen(kind, p, q).distance for kind in kinds])
        return found - robot.capsule_radius[None]

    def nearest_name(self, robot: Robot, where: HasWorkpiecePose, row: int, bodies: BodyAxes) -> str:
        """Return the name of the solid nearest to a body, by its capsule or the piece in it, for messages."""
        return f"the fixture {self.names[int(_distances_alone(self, robot, where, bodies)[:, row].argmin())]!r}"

    def _nearest(self, p: Ends, q: Ends, radius: Float[Array, "K"], is_checked: Bool[Array, "G K"]) -> Contacts:
        """Return the contact of each capsule with the nearest of its solids in the mask `is_checked`."""
        seen = self._simple(p, q, is_checked) if self.simple else _nothing(len(p))
        if self.pieces is not None:
            is_checked = is_checked[len(is_checked) - len(self.balls) :]
            seen = _with_pieces((self.pieces, self.balls), is_checked, *jax.lax.stop_gradient((p, q, radius, seen)))
        return _constant_contacts(seen, p, q, radius)

    def _simple(self, p: Ends, q: Ends, is_checked: Bool[Array, "G K"]) -> SolidContact:
        """Return the nearest of the solids that are always measured."""
        parts = [_each_seen(kind, p, q) for kind in self.simple]
        seen = jax.tree.map(lambda *each: jnp.concatenate(each), *parts)
        distance = jnp.where(is_checked[: len(seen.distance)], seen.distance, jnp.inf)
        best, body = jnp.argmin(distance, axis=0), jnp.arange(len(p))
        return jax.tree.map(lambda each: each[best, body], seen._replace(distance=distance))


def fixtures(
    robot: Robot, named: list[tuple[str, Solid]], excluded: Mapping[str, Collection[int]] = MappingProxyType({})
) -> Fixtures:
    """Return the obstacle of at least one named solid for a robot.

    Args:
        robot: The robot.
        named: The solids with their names.
        excluded: By name the links that a solid is not tested against; none for other names.
    """
    order = (HalfSpace, Rod, Box, Cylinder, Polyhedron)
    named = sorted(named, key=lambda each: order.index(type(each[1])))
    stacks = [[solid for _, solid in named if isinstance(solid, kind)] for kind in order]
    *simple, pieces = [_stacked(own) for own in stacks if own] + ([] if stacks[-1] else [None])
    balls = np.array([_ball(piece) for piece in stacks[-1]]).reshape(-1, 4)
    links = np.array(robot.capsule_link)
    is_checked = jnp.broadcast_to(jnp.asarray(links >= 0)[None], (len(named), len(links)))
    names = tuple(name for name, _ in named)
    found = Fixtures(tuple(simple), pieces, jnp.asarray(balls), is_checked, names, _as_pieces(robot, named))
    drawn = kinematics.capsule_segments(robot, jnp.zeros(len(robot.slides)))
    stands = (np.asarray(_solid_distances(found, robot, *drawn)) <= 0) & _may_stand(robot)[None]
    stands |= np.array([np.isin(links, [*excluded.get(name, ())]) for name, _ in named])
    return dataclasses.replace(found, is_checked=is_checked & ~stands)


def _may_stand(robot: Robot) -> Bool[np.ndarray, "K"]:
    """Return True for the bodies of the first link; for none if the part moves: it stands nowhere."""
    if robot.part_moves:
        return np.zeros(len(robot.capsule_link), bool)
    return (np.array(robot.capsule_link) == 0) & ~np.isin(np.arange(len(robot.capsule_link)), robot.attached)


def _as_pieces(robot: Robot, named: list[tuple[str, Solid]]) -> ConvexPiece | None:
    """Return the solids but half-spaces as pieces in the world; None for an arm without pieces, and without solids.

    Of a cylinder it is the prism of SIDES sides about it.
    """
    solids = [solid for _, solid in named if not isinstance(solid, HalfSpace)]
    if robot.pieces is None or not solids:
        return None
    return jax.tree.map(jnp.asarray, convex_piece.stack_pieces([_as_piece(solid) for solid in solids]))


def _as_piece(solid: Rod | Box | Cylinder | Polyhedron) -> ConvexPiece:
    if isinstance(solid, Rod):
        return convex_piece.make_piece(np.array([solid.p, solid.q]), float(solid.radius))
    if isinstance(solid, Polyhedron):
        return convex_piece.make_piece(np.asarray(solid.corners).reshape(-1, 3))
    own = CUBE * np.asarray(solid.half) if isinstance(solid, Box) else _prism(float(solid.radius), float(solid.half))
    return convex_piece.make_piece(own @ np.asarray(solid.rotation).T + np.asarray(solid.centre))


def _prism(radius: float, half: float) -> Float[np.ndarray, "P 3"]:
    """Return the corners of the prism about a cylinder along z."""
    angle, outer = 2 * np.pi * np.arange(SIDES) / SIDES, radius / np.cos(np.pi / SIDES)
    return np.array([[outer * np.cos(a), outer * np.sin(a), z] for a in angle for z in (-half, half)])


_solid_distances = jax.jit(Fixtures.distances)


@jax.jit
def _distances_alone(own: Fixtures, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[Array, "G K"]:
    """Return the distance of every body to every solid, as if there were no other."""

    def alone(mask: Bool[Array, "G K"]) -> Float[Array, "K"]:
        return dataclasses.replace(own, is_checked=mask).contacts(robot, where, bodies).distance

    return jax.lax.map(alone, jnp.eye(len(own.is_checked), dtype=bool)[..., None] & own.is_checked[None])


def _stacked(solids: list[Solid]) -> Solid:
    """Stack several solids of a kind; pieces are padded to the faces and edges of the largest with their last one."""
    if isinstance(solids[0], Polyhedron):
        faces, edges = (max(len(each) for each in column) for column in list(zip(*solids, strict=True))[1:3])
        sizes = Polyhedron(faces, faces, edges, edges)
        solids = [Polyhedron(*map(_repeated, piece, sizes)) for piece in solids]
    return jax.tree.map(lambda *each: jnp.stack(list(map(jnp.asarray, each))), *solids)


def _repeated(rows: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(rows)[np.minimum(np.arange(count), len(rows) - 1)]


def _ball(piece: Polyhedron) -> np.ndarray:
    corners = np.asarray(piece.corners).reshape(-1, 3)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return np.append(centre, np.linalg.norm(corners - centre, axis=1).max())


def _each_seen(stack: Solid, p: Ends, q: Ends) -> SolidContact:
    """Return the contact of every solid with every segment (n, K)."""
    return jax.vmap(lambda solid: jax.vmap(solid.contact)(p, q))(stack)


def _nothing(bodies: int) -> SolidContact:
    none = jnp.zeros(bodies)
    return SolidContact(none, jnp.zeros((bodies, 3)), jnp.full(bodies, jnp.inf), jnp.zeros(bodies, bool), none)


def _constant_contacts(seen: SolidContact, p: Ends, q: Ends, radius: Float[Array, "K"]) -> Contacts:
    """Return the contacts, fixed: their distances depend on the ends alone, exactly to first order."""
    seen = jax.lax.stop_gradient(seen)
    point = p + seen.t[:, None] * (q - p)
    still = jax.lax.stop_gradient(point)
    moved = jnp.sum(seen.normal * (point - still), axis=1)
    return Contacts(seen.distance + moved - radius, point, seen.normal, radius + seen.extent, seen.plane)


@one_by_one
def _with_pieces(search, is_checked, p, q, radius, seen):
    """Return `seen`, or the contact with a piece where one is nearer."""
    pieces, balls = search
    lower = jnp.where(is_checked, narrow_phase.ball_bounds(p, q, jnp.zeros(len(p)), balls), jnp.inf)

    def open_(state):
        lower, seen = state
        return lower < seen.distance[None]

    def measure(state):
        lower, seen = state
        nearest = jnp.argmin(jnp.where(open_(state), lower - radius[None], jnp.inf))
        k, body = jnp.unravel_index(nearest, lower.shape)
        found = jax.tree.map(lambda leaf: leaf[k], pieces).contact(p[body], q[body])
        nearer = found.distance < seen.distance[body]
        seen = jax.tree.map(lambda old, new: old.at[body].set(jnp.where(nearer, new, old[body])), seen, found)
        return lower.at[k, body].set(jnp.inf), seen

    return jax.lax.while_loop(lambda state: jnp.any(open_(state)), measure, (lower, seen))[1]
