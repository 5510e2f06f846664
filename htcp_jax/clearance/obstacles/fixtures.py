"""Solids of the work cell as an obstacle, fixed in the world.

Some pairs are not checked: bodies that are fixed in the world, such as the arm's base; a body of the first link, or of
a side branch's link on the root, with a solid that it touches at x = 0, such as the arm's pedestal; and bodies of links
that the solid's fixture excludes.

All half-spaces, capsules, boxes and cylinders are measured. A convex piece is measured only if its bounding ball is
nearer than the smallest distance so far; the pieces with the nearest balls come first.
"""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Polyhedron, Rod, Solid, SolidContact
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle
from htcp_jax.model import ConvexPiece, Robot, kinematics, make_piece, stack_pieces
from htcp_jax.numerics import one_by_one, padded_count, table_size, with_repeated
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Array, Bool, Float, Int, Scalar

SIDES = 48  # sides of the prism about a cylinder, which is 0.2 % wider than the cylinder
CUBE = np.array(list(product((-1.0, 1.0), repeat=3)))
SUNK_M = 0.01  # depth of a fixed body's axis in a solid above which the overlap is stated [m]

Ends = Float[Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class Fixtures(Obstacle):
    """Solids fixed in the world, stacked by kind, and the pairs of solid and body that are checked.

    Each stack is padded to one of few lengths. Padding is not checked against any body.
    """

    simple: tuple[HalfSpace | Rod | Box | Cylinder, ...]
    pieces: Polyhedron | None
    balls: Float[jax.Array, "P 4"]  # bounding balls of the pieces: centre, radius [m]
    is_checked: Bool[jax.Array, "G K"]  # True: solid g is checked against body k; simple solids first, then pieces
    counts: Int[jax.Array, "kinds"]  # numbers of simple solids by kind, without padding
    names: tuple[str, ...] = field(metadata=LABEL)  # names of the solids in the rows of `is_checked`; "" for padding
    solids: ConvexPiece | None = None  # all solids except half-spaces, in the order of `names`; for an arm with pieces
    sunk: str = field(default="", metadata=LABEL)  # bodies that are not checked, and the solids in which they are deep

    in_pairs = True
    is_exact = True

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with its nearest solid."""
        if robot.pieces is not None:
            doubts = self.doubts(robot, bodies, narrow_phase.limit_m(where))
            return narrow_phase.decide(robot, bodies, [doubts])[0]
        return self._nearest(bodies.p, bodies.q, robot.capsule_radius)

    def doubts(self, robot: Robot, bodies: BodyAxes, limit: Float[jax.Array, "..."]) -> narrow_phase.Doubts:
        """Return the bodies whose capsules are in doubt, and their pairs with solids, see `narrow_phase`."""
        if self.solids is None and not all(isinstance(kind, HalfSpace) for kind in (*self.simple, self.pieces) if kind):
            raise ValueError("the fixtures were made for an arm without pieces; make them for this arm")
        capsules = self._nearest(bodies.p, bodies.q, robot.capsule_radius)
        doubt = narrow_phase.in_doubt(capsules.distance, robot.pieces.excess_m, limit)
        parts = [each.distance - robot.capsule_radius[None] for each in self._each_simple(bodies.p, bodies.q)]
        if self.pieces is not None:
            parts.append(narrow_phase.ball_bounds(bodies.p, bodies.q, robot.capsule_radius, self.balls))
        lower = jnp.where(self.is_checked & doubt[None], jnp.concatenate(parts), jnp.inf)
        solid, body = jnp.indices(lower.shape).reshape(2, -1)
        planes = next((kind for kind in self.simple if isinstance(kind, HalfSpace)), None)
        known = narrow_phase.undecided(capsules, limit)
        return narrow_phase.Doubts(capsules, doubt, known, body, solid, body, lower.reshape(-1), self.solids, planes)

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return a distance below the limit [m]: pieces whose balls are beyond it are not measured."""
        if robot.pieces is not None:
            return super().any_below(robot, where, bodies, limit_m)
        return jnp.min(self._nearest(bodies.p, bodies.q, robot.capsule_radius, limit_m).distance)

    def for_programs(self, robot: Robot, bodies: int, closely: bool) -> "Fixtures":
        """Return the obstacle with padding up to a number of bodies, which is not checked."""
        more = bodies - self.is_checked.shape[1]
        padded = np.pad(np.asarray(self.is_checked), ((0, 0), (0, more)))
        return dataclasses.replace(self, is_checked=jax.device_put(padded))

    def distances(self, robot: Robot, p: Ends, q: Ends) -> Float[jax.Array, "G K"]:
        """Return the distance of every solid to every body's capsule [m], including pairs that are not checked."""
        kinds = (*self.simple, *(() if self.pieces is None else (self.pieces,)))
        found = jnp.concatenate([_each_seen(kind, p, q).distance for kind in kinds])
        return found - robot.capsule_radius[None]

    def parts(self, robot: Robot, row: int) -> Int[np.ndarray, "G"]:
        """Return the numbers of all solids."""
        return np.arange(len(self.names))

    def only(self, robot: Robot, part: Int[jax.Array, ""]) -> "Fixtures":
        """Return the obstacle with one of its solids; all solids for a negative number."""
        is_part = (jnp.arange(len(self.is_checked)) == part) | (part < 0)
        return dataclasses.replace(self, is_checked=self.is_checked & is_part[:, None])

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the name of a solid, for messages."""
        return f"the fixture {self.names[part]!r}"

    def _nearest(self, p: Ends, q: Ends, radius: Float[Array, "K"], within: Scalar | float = np.inf) -> Contacts:
        """Return the contact of each capsule with the nearest of its solids; pieces only within `within` [m]."""
        seen = self._simple(p, q) if self.simple else _nothing(len(p))
        if self.pieces is not None:
            is_checked = self.is_checked[len(self.is_checked) - len(self.balls) :]
            still = jax.lax.stop_gradient((p, q, radius, seen))
            seen = _with_pieces((self.pieces, self.balls), is_checked, *still, radius + within)
        return _constant_contacts(seen, p, q, radius)

    def _simple(self, p: Ends, q: Ends) -> SolidContact:
        """Return the contact of each capsule with the nearest of the solids that are always measured."""
        seen = jax.tree.map(lambda *each: jnp.concatenate(each), *self._each_simple(p, q))
        distance = jnp.where(self.is_checked[: len(seen.distance)], seen.distance, jnp.inf)
        best, body = jnp.argmin(distance, axis=0), jnp.arange(len(p))
        return jax.tree.map(lambda each: each[best, body], seen._replace(distance=distance))

    def _each_simple(self, p: Ends, q: Ends) -> list[SolidContact]:
        """Return the contact of every simple solid with every segment (n, K) for each kind; padding is far away."""
        if not backend().is_cpu:
            return [_each_seen(kind, p, q) for kind in self.simple]
        still = jax.lax.stop_gradient((p, q))
        return [_seen_in_turn(kind, self.counts[k], *still) for k, kind in enumerate(self.simple)]


def fixtures(
    robot: Robot, named: list[tuple[str, Solid]], excluded: Mapping[str, Collection[int]] = MappingProxyType({})
) -> Fixtures:
    """Return an obstacle that consists of one or more named solids.

    Args:
        robot: The robot.
        named: The solids with their names.
        excluded: Name of a solid -> indices of links whose bodies are not checked against this solid.
    """
    order = (HalfSpace, Rod, Box, Cylinder, Polyhedron)
    stacks = [_padded([each for each in named if isinstance(each[1], kind)]) for kind in order]
    *simple, pieces = [_stacked([row.solid for row in own]) for own in stacks if own] + ([] if stacks[-1] else [None])
    balls = np.array([_ball(row.solid) for row in stacks[-1]]).reshape(-1, 4)
    rows = [row for own in stacks for row in own]
    links = np.array(robot.capsule_link)
    without = np.array([np.isin(links, [*excluded.get(row.name, ())]) for row in rows])
    is_checked = np.array([row.is_checked for row in rows])[:, None] & (links >= 0)[None] & ~without
    radius, sunk = np.asarray(robot.capsule_radius), list[str]()
    for body in np.flatnonzero(_may_stand(robot)).tolist():
        distance = _axis_distances(robot, body, rows)
        is_checked[:, body] &= distance > radius[body]
        deep = [row.name for row, own in zip(rows, distance, strict=True) if row.is_checked and own < -SUNK_M]
        sunk += [f"{robot.capsule_names[body]} deep in the fixture {name!r}" for name in deep]
    names = tuple(row.name for row in rows)
    counts = np.array([sum(row.is_checked for row in own) for own in stacks[:-1] if own], np.int32)
    balls, mask, counts = jax.device_put((balls, is_checked, counts))
    return Fixtures(tuple(simple), pieces, balls, mask, counts, names, _as_pieces(robot, rows), ", ".join(sunk))


class _Row(NamedTuple):
    """A solid in a stack."""

    name: str
    solid: Solid
    is_checked: bool = True  # False: padding


def _padded(named: list[tuple[str, Solid]]) -> list[_Row]:
    """Return solids of one kind as rows, padded to one of few lengths, so that most cells share compiled code.

    On a CPU padding is skipped, so there are fewer lengths.
    """
    rows = [_Row(*each) for each in named]
    length = table_size(len(rows), 4, 4 if backend().is_cpu else 2)
    return rows + [_Row("", rows[-1].solid, False)] * (length - len(rows)) if rows else []


def _axis_distances(robot: Robot, body: int, rows: list[_Row]) -> Float[np.ndarray, "G"]:
    """Return the signed distance of each solid to the axis of a body of the base, or of a link on the root at x = 0."""
    link = robot.capsule_link[body]
    T = np.eye(4) if link < 0 else np.asarray(robot.T_parent_joint)[0]
    if link >= 0 and robot.coupling is not None:  # a joint that follows need not be at 0
        T = np.asarray(kinematics.link_poses(robot, jnp.zeros(robot.dof)))[link]
    p, q = (T[:3, :3] @ np.asarray(end)[body] + T[:3, 3] for end in (robot.capsule_p, robot.capsule_q))
    alone = (jax.tree.map(lambda leaf: leaf[0], _host_stacked([row.solid])) for row in rows)
    return np.array([float(_distance(solid, p, q)) for solid in alone])


_distance = jax.jit(lambda solid, p, q: solid.contact(p, q).distance)  # compiled once per kind of solid


def _may_stand(robot: Robot) -> Bool[np.ndarray, "K"]:
    """Return True for bodies of the base and of links on the root, or none if the arm moves the part."""
    links, bodies = np.array(robot.capsule_link), np.arange(len(robot.capsule_link))
    if robot.part_moves:
        return np.zeros(len(bodies), bool)
    return ((links < 0) | np.isin(links, robot.root_links)) & ~np.isin(bodies, robot.attached)


def _as_pieces(robot: Robot, rows: list[_Row]) -> ConvexPiece | None:
    """Return the solids except half-spaces as convex pieces in the world; None if there are none.

    A cylinder becomes a prism about it with SIDES sides. The result is also None for an arm without pieces.
    """
    solids = [row.solid for row in rows if not isinstance(row.solid, HalfSpace)]
    if robot.pieces is None or not solids:
        return None
    return jax.device_put(stack_pieces([_as_piece(solid) for solid in solids]))


def _as_piece(solid: Rod | Box | Cylinder | Polyhedron) -> ConvexPiece:
    if isinstance(solid, Rod):
        return make_piece(np.array([solid.p, solid.q]), float(solid.radius))
    if isinstance(solid, Polyhedron):
        return make_piece(np.asarray(solid.corners).reshape(-1, 3))
    own = CUBE * np.asarray(solid.half) if isinstance(solid, Box) else _prism(float(solid.radius), float(solid.half))
    return make_piece(own @ np.asarray(solid.rotation).T + np.asarray(solid.centre))


def _prism(radius: float, half: float) -> Float[np.ndarray, "P 3"]:
    """Return the corners [m] of the prism with SIDES sides about a cylinder along z."""
    angle, outer = 2 * np.pi * np.arange(SIDES) / SIDES, radius / np.cos(np.pi / SIDES)
    return np.array([[outer * np.cos(a), outer * np.sin(a), z] for a in angle for z in (-half, half)])


def _stacked(solids: list[Solid]) -> Solid:
    """Stack several solids of a kind, on the device."""
    return jax.device_put(_host_stacked(solids))  # `jnp.asarray` would compile an executable for every shape


def _host_stacked(solids: list[Solid]) -> Solid:
    """Stack several solids of a kind as numpy arrays; faces and edges of pieces are padded with the last one."""
    if isinstance(solids[0], Polyhedron):
        faces, edges = (padded_count(max(map(len, column))) for column in list(zip(*solids, strict=True))[1:3])
        sizes = Polyhedron(faces, faces, edges, edges)
        solids = [Polyhedron(*map(with_repeated, piece, sizes)) for piece in solids]
    return jax.tree.map(lambda *each: np.stack(list(map(np.asarray, each))), *solids)


def _ball(piece: Polyhedron) -> np.ndarray:
    corners = np.asarray(piece.corners).reshape(-1, 3)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return np.append(centre, np.linalg.norm(corners - centre, axis=1).max())


def _each_seen(stack: Solid, p: Ends, q: Ends) -> SolidContact:
    """Return the contact of every solid with every segment (n, K)."""
    return jax.vmap(lambda solid: jax.vmap(solid.contact)(p, q))(stack)


def _seen_in_turn(stack: Solid, count: Int[Array, ""], p: Ends, q: Ends) -> SolidContact:
    """Return the contact of each of the first `count` solids with every segment (n, K); the others are far away."""

    def measure(k: Int[Array, ""], seen: SolidContact) -> SolidContact:
        found = jax.vmap(jax.tree.map(lambda leaf: leaf[k], stack).contact)(p, q)
        return jax.tree.map(lambda every, new: every.at[k].set(new), seen, found)

    nothing = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(stack[0]), *leaf.shape)), _nothing(len(p)))
    return jax.lax.fori_loop(0, count, measure, nothing)


def _nothing(bodies: int) -> SolidContact:
    none = jnp.zeros(bodies)
    return SolidContact(none, jnp.zeros((bodies, 3)), jnp.full(bodies, jnp.inf), jnp.zeros(bodies, bool), none)


def _constant_contacts(seen: SolidContact, p: Ends, q: Ends, radius: Float[Array, "K"]) -> Contacts:
    """Return the contacts with constant points and normals, so that only the bodies' ends have a gradient."""
    seen = jax.lax.stop_gradient(seen)
    point = p + seen.t[:, None] * (q - p)
    still = jax.lax.stop_gradient(point)
    moved = jnp.sum(seen.normal * (point - still), axis=1)
    return Contacts(seen.distance + moved - radius, point, seen.normal, radius + seen.extent, seen.plane)


@one_by_one
def _with_pieces(search, is_checked, p, q, radius, seen, most):
    """Return the contacts `seen`, each replaced by the contact with a piece if a piece is nearer."""
    pieces, balls = search
    lower = narrow_phase.ball_bounds(p, q, jnp.zeros(len(p)), balls)
    lower = jnp.where(is_checked & (lower < most[None]), lower, jnp.inf)

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
