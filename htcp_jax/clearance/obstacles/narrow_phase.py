"""Narrow phase: distances of the convex pieces of an arm's meshes, for rows that its capsules do not decide.

A row's capsules are measured first. The row is in doubt if their distance is below the limit, which is the margin plus
CLOSE_M, and not so small that the meshes certainly collide. For a row in doubt the pieces in the capsules are measured.
The row's distance is then

    max(D of the capsules, min(D of the pieces, limit)).

It is continuous, and a lower bound on the distance of the meshes. The contact and the gradient are those of the larger
term. A proof replaces the limit by a larger one, as farther bodies may move farther.

The pairs of all obstacles are measured by one search, so that compiled code contains it once, see `decide_together`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.convex_pieces import PieceContact, PlacedPiece, face_contact, piece_contact
from htcp_jax.clearance.distance.solids import HalfSpace
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle, Obstacles, RowPairs
from htcp_jax.model import ConvexPiece, Robot
from htcp_jax.numerics import one_by_one, safe_norm, segment_parameter
from htcp_jax.pytree import register_pytree
from htcp_jax.types import Array, Bool, Float, Int, Pose, Scalar

CLOSE_M = 0.005  # distance above the margin below which pieces are measured


class Doubts(NamedTuple):
    """R rows of an obstacle, and the P pairs of pieces that decide the rows in doubt.

    `first` is the index of a pair's body. If there are no planes and no solids, `second` is the index of another body.
    Otherwise it is the index of a plane or, from the number of planes on, of a solid.
    """

    capsules: Contacts
    rows: Bool[Array, "R"]  # True: the row is in doubt
    known: Contacts  # the results for rows in doubt unless a pair is nearer
    first: Int[Array, "P"]
    second: Int[Array, "P"]
    row: Int[Array, "P"]  # index of the row that the pair belongs to
    lower: Float[Array, "P"]  # lower bounds on the pairs' distances [m]; infinite for pairs that are not measured
    solids: ConvexPiece | None = None  # stacked, in the world
    planes: HalfSpace | None = None  # stacked


def margin_m(where: HasWorkpiecePose) -> Scalar:
    """Return the required clearance [m] of a scenario; 0 for an object that has only a workpiece pose."""
    return jnp.asarray(getattr(where, "margin_m", 0.0), float)


def limit_m(where: HasWorkpiecePose) -> Scalar:
    """Return the distance below which capsules are in doubt [m], see the module's docstring."""
    return margin_m(where) + CLOSE_M


def in_doubt(distance: Float[Array, "R"], excess_m: Float[Array, "R"], limit: Float[Array, "..."]) -> Bool[Array, "R"]:
    """Return True for rows in doubt: their capsules are below the limit, but their pieces may be clear.

    Args:
        distance: Distances of the capsules [m].
        excess_m: Largest amount by which the pieces' distance can exceed the capsules'.
        limit: See `limit_m` [m].
    """
    return (excess_m > 0) & (distance < limit) & (distance > -excess_m)


def undecided(capsules: Contacts, limit: Float[Array, "..."]) -> Contacts:
    """Return the capsules' contacts at the same points, with all distances set to `limit` [m]."""
    return capsules._replace(
        distance=jnp.broadcast_to(limit, capsules.distance.shape),
        radius=capsules.radius + capsules.distance - limit,
    )


def chosen(take: Bool[Array, "R"], new: Contacts, old: Contacts) -> Contacts:
    """Return the contacts of `new` in rows where `take` is True, else those of `old`."""
    return jax.tree.map(lambda a, b: jnp.where(take.reshape(-1, *[1] * (a.ndim - 1)), a, b), new, old)


def decided(capsules: Contacts, pieces: Contacts, doubt: Bool[Array, "R"]) -> Contacts:
    """Return the pieces' contacts for rows in doubt whose pieces have the larger distance, else the capsules'."""
    return chosen(doubt & (pieces.distance > capsules.distance), pieces, capsules)


def decide(robot: Robot, bodies: BodyAxes, every: Sequence[Doubts]) -> list[Contacts]:
    """Return the contacts of each obstacle, with rows in doubt decided by the pieces.

    Args:
        robot: The robot, with pieces.
        bodies: The bodies.
        every: The rows in doubt and the pairs, one entry per obstacle.
    """
    pairs, known, solids, planes = [], [], [], []
    for each in every:
        second = each.second
        if each.planes is not None or each.solids is not None:  # planes get -1, -2, ...; solids follow the bodies
            above = 0 if each.planes is None else len(each.planes.offset)
            plane = -1 - second - sum(len(own.offset) for own in planes)
            solid = second - above + len(robot.capsule_link) + sum(len(own.radius) for own in solids)
            second = jnp.where(second < above, plane, solid)
        pairs.append((each.first, second, each.row + sum(len(own.distance) for own in known)))
        known.append(each.known)
        solids += [] if each.solids is None else [each.solids]
        planes += [] if each.planes is None else [each.planes]
    joined = lambda parts: jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)  # noqa: E731
    exact, lower = robot.pieces.excess_m == 0, jnp.concatenate([each.lower for each in every])
    arguments = exact, robot.capsule_radius, bodies.p, bodies.q, bodies.T, lower, joined(known)
    shared = robot.pieces.piece, joined(pairs), tuple(solids), joined(planes) if planes else None
    found = _nearest_pieces(shared, *jax.lax.stop_gradient(arguments))
    contacts, start = [], 0
    for each in every:
        rows = slice(start, start := start + len(each.rows))
        contacts.append(decided(each.capsules, jax.tree.map(lambda leaf, rows=rows: leaf[rows], found), each.rows))
    return contacts


@one_by_one
def _nearest_pieces(shared, is_exact, radius, p, q, T, lower, known):
    """Return the known contacts, each replaced by the contact of the row's nearest pair of pieces if that is nearer."""
    pieces, (first, second, row), solids, planes = shared
    sizes = [max(own[k].shape[1] for own in (pieces, *solids)) for k in (0, 1)]

    def chosen_from(stack: ConvexPiece, k) -> ConvexPiece:
        vertices, normals = (_padded(leaf[k], most) for leaf, most in zip(stack[:2], sizes, strict=True))
        return ConvexPiece(vertices, normals, *jnp.zeros((2, 0, 2), int), stack.radius[k])

    def body(k) -> PlacedPiece:
        piece = chosen_from(pieces, k)
        axis = jnp.stack([p[k], q[k]])[jnp.arange(sizes[0]) % 2]
        return PlacedPiece(
            piece._replace(
                vertices=jnp.where(is_exact[k], axis, piece.vertices),
                radius=jnp.where(is_exact[k], radius[k], piece.radius),
            ),
            jnp.where(is_exact[k], jnp.eye(4), T[k]),
        )

    def other(k) -> PlacedPiece:
        found, start = body(jnp.minimum(k, len(radius) - 1)), len(radius)
        for stack in solids:
            new = PlacedPiece(chosen_from(stack, jnp.clip(k - start, 0, len(stack.radius) - 1)), jnp.eye(4))
            found = jax.tree.map(partial(jnp.where, k >= start), new, found)
            start += len(stack.radius)
        return found

    def contact(pair, enough) -> PieceContact:
        one, k = body(first[pair]), second[pair]
        if planes is None:
            return face_contact(one, other(k), enough)
        plane = jax.tree.map(lambda leaf: leaf[jnp.clip(-1 - k, 0, len(planes.offset) - 1)], planes)
        return jax.lax.cond(k < 0, lambda: piece_contact(one, plane), lambda: face_contact(one, other(k), enough))

    def is_open(lower, best):
        return lower < best[row, 0]

    def measure(state):
        lower, best = state
        pair = jnp.argmin(jnp.where(is_open(lower, best), lower, jnp.inf))
        old = best[row[pair]]
        found = contact(pair, old[0])
        new = jnp.concatenate([found.distance[None], found.point, found.normal])
        return lower.at[pair].set(jnp.inf), best.at[row[pair]].set(jnp.where(new[0] < old[0], new, old))

    best = jnp.concatenate([known.distance[:, None], known.point, known.normal], axis=1)
    best = jax.lax.while_loop(lambda state: jnp.any(is_open(*state)), measure, (lower, best))[1]
    is_new = best[:, 0] < known.distance
    radius, plane = jnp.where(is_new, 0.0, known.radius), known.plane & ~is_new
    return Contacts(best[:, 0], best[:, 1:4], best[:, 4:], radius, plane)


def _padded(rows: Float[Array, "n 3"], count: int) -> Float[Array, "m 3"]:
    return jnp.concatenate([rows, jnp.broadcast_to(rows[-1:], (count - len(rows), 3))])


@register_pytree
@dataclass(frozen=True)
class _Decided(Obstacle):
    """The obstacle `kind` at one configuration, where its contacts and its capsules' distances are known."""

    kind: Obstacle
    found: Contacts
    of_capsules: Float[Array, "R"]  # [m]

    @property
    def per_body(self) -> bool:
        return self.kind.per_body

    def rows(self, robot: Robot) -> RowPairs:
        return self.kind.rows(robot)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        return self.found


def decide_together(
    robot: Robot,
    obstacles: Obstacles,
    where: HasWorkpiecePose,
    bodies: BodyAxes,
    needed: Sequence[Bool[Array, ""]] | None = None,
    limits: Sequence[Float[Array, "_"]] | None = None,
) -> Obstacles:
    """Return the obstacles for queries at one configuration.

    For an arm with pieces, one search computes the contacts of all obstacles with `in_pairs`. For other arms the
    obstacles are returned unchanged.

    Args:
        robot: The robot.
        obstacles: The obstacles.
        where: A scenario, or another `HasWorkpiecePose`.
        bodies: The bodies.
        needed: True for obstacles that will be queried; None: all.
        limits: For each row of each obstacle, a larger limit than `limit_m` [m]; None: `limit_m`.
    """
    in_pairs = [] if robot.pieces is None else [k for k, each in enumerate(obstacles) if each.in_pairs]
    if not in_pairs:
        return obstacles
    limits = [limit_m(where)] * len(obstacles) if limits is None else limits
    look = [lambda each=obstacles[k], limit=limits[k]: each.doubts(robot, bodies, limit) for k in in_pairs]
    if needed is None:
        doubts = [own() for own in look]
    else:
        doubts = [jax.lax.cond(needed[k], own, partial(_no_doubts, own)) for k, own in zip(in_pairs, look, strict=True)]
    found = zip(in_pairs, decide(robot, bodies, doubts), doubts, strict=True)
    decided = {k: (contacts, own.capsules.distance) for k, contacts, own in found}
    return tuple(_Decided(each, *decided[k]) if k in decided else each for k, each in enumerate(obstacles))


def of_capsules(where: HasWorkpiecePose, each: Obstacle, free_radius: Float[Array, "R"]) -> Float[Array, "R"]:
    """Return the free radii of the capsules [m]; -inf where a piece may be nearest and they are not known.

    Args:
        where: A scenario, or another `HasWorkpiecePose`.
        each: An obstacle from `decide_together`.
        free_radius: Its free radii [m]; -inf for an obstacle that is not needed.
    """
    if not isinstance(each, _Decided):
        return jnp.where(free_radius > limit_m(where), free_radius, -jnp.inf)
    return jnp.minimum(each.of_capsules, free_radius)


def _no_doubts(look: Callable[[], Doubts]) -> Doubts:
    """Return a result of `look` without rows in doubt, for an obstacle that is not measured."""
    empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(look))
    return empty._replace(lower=jnp.full_like(empty.lower, jnp.inf))


def ball_bounds(
    p: Float[Array, "K 3"], q: Float[Array, "K 3"], radius: Float[Array, "K"], balls: Float[Array, "n 4"]
) -> Float[Array, "n K"]:
    """Return lower bounds on the distances of K capsules from anything inside n balls (centre, radius) [m]."""
    p_, q_, centre = jnp.broadcast_arrays(p[None], q[None], balls[:, None, :3])
    apart = p_ + segment_parameter(p_, q_, centre)[..., None] * (q_ - p_) - centre
    return safe_norm(apart) - balls[:, 3:] - radius[None]


def link_poses_in(T_world_frame: Pose, T_world_link: Float[Array, "K 4 4"]) -> Float[Array, "K 4 4"]:
    """Return the poses of links in another frame."""
    R, t = T_world_frame[:3, :3], T_world_frame[:3, 3]
    apart = T_world_link[:, :3].at[:, :, 3].add(-t[None])
    turned = jnp.sum(R.T[None, :, :, None] * apart[:, None], axis=2)
    return jnp.concatenate([turned, T_world_link[:, 3:]], axis=1)
