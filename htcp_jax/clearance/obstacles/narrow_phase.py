"""The narrow phase: distances of the convex pieces of an arm's meshes, where its capsules are in doubt.

A row's capsules answer first. If their distance is below `limit_m`, the margin plus CLOSE_M, and not so small that the
meshes collide all the same, the pieces in them are measured. The row's distance is then

    max(D of the capsules, min(D of the pieces, limit)),

continuous, and a lower bound on the distance of the meshes. The contact, and so the gradient, is that of the
representation that decided.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.convex_pieces import PlacedPiece, face_contact, piece_contact
from htcp_jax.clearance.distance.solids import HalfSpace
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose
from htcp_jax.model import ConvexPiece, Robot
from htcp_jax.numerics import one_by_one, safe_norm, segment_parameter
from htcp_jax.types import Array, Bool, Float, Int, Pose, Scalar

CLOSE_M = 0.005  # above the margin: a step QP may go this far by the capsules before it sees the pieces


class Pairs(NamedTuple):
    """P pairs of a body and another piece, and the rows that they belong to."""

    first: Int[Array, "P"]
    second: Int[Array, "P"]
    row: Int[Array, "P"]


def margin_m(where: HasWorkpiecePose) -> Scalar:
    """Return the margin [m]: a scenario's, 0 for a pose alone."""
    return jnp.asarray(getattr(where, "margin_m", 0.0), float)


def limit_m(where: HasWorkpiecePose) -> Scalar:
    """Return the distance below which capsules are in doubt [m]."""
    return margin_m(where) + CLOSE_M


def in_doubt(distance: Float[Array, "R"], excess_m: Float[Array, "R"], limit: Scalar) -> Bool[Array, "R"]:
    """Return True for distances of capsules that their pieces may raise above 0 [m]."""
    return (excess_m > 0) & (distance < limit) & (distance > -excess_m)


def undecided(capsules: Contacts, limit: Scalar) -> Contacts:
    """Return the contacts of capsules with the distance `limit` [m] at the same witness."""
    return capsules._replace(
        distance=jnp.broadcast_to(limit, capsules.distance.shape),
        radius=capsules.radius + capsules.distance - limit,
    )


def chosen(take: Bool[Array, "R"], new: Contacts, old: Contacts) -> Contacts:
    """Return the new contacts in rows where `take` is True, else the old ones."""
    return jax.tree.map(lambda a, b: jnp.where(take.reshape(-1, *[1] * (a.ndim - 1)), a, b), new, old)


def decided(capsules: Contacts, pieces: Contacts, doubt: Bool[Array, "R"]) -> Contacts:
    """Return the contacts of the pieces for rows in doubt where their distance is larger, else the capsules'."""
    return chosen(doubt & (pieces.distance > capsules.distance), pieces, capsules)


def nearest_pieces(
    robot: Robot,
    bodies: BodyAxes,
    pairs: Pairs,
    others: ConvexPiece | None,
    planes: HalfSpace | None,
    lower: Float[Array, "P"],
    best: Contacts,
) -> Contacts:
    """Return `best`, or in each row the contact of the pair of pieces with a smaller distance.

    Args:
        robot: The robot, with pieces.
        bodies: The bodies.
        pairs: The pairs, whose first bodies move.
        others: The pieces of the second bodies, in the world; None: there are none.
        planes: Half-spaces, which come before them; None: there are none. Without either, the second bodies are the
            robot's, too.
        lower: Lower bound on each pair's distance [m]; infinite for those that are not measured.
        best: A contact of every row.
    """
    arguments = robot.pieces.excess_m == 0, robot.capsule_radius, bodies.p, bodies.q, bodies.T, lower, best
    return _nearest_pieces((robot.pieces.piece, pairs, others, planes), *jax.lax.stop_gradient(arguments))


@one_by_one
def _nearest_pieces(shared, is_exact, radius, p, q, T, lower, best):
    pieces, pairs, others, planes = shared
    count = 0 if planes is None else len(planes.offset)

    def body(k) -> PlacedPiece:
        piece = jax.tree.map(lambda leaf: leaf[k], pieces)
        axis = jnp.stack([p[k], q[k]])[jnp.arange(len(piece.vertices)) % 2]
        return PlacedPiece(
            piece._replace(
                vertices=jnp.where(is_exact[k], axis, piece.vertices),
                radius=jnp.where(is_exact[k], radius[k], piece.radius),
            ),
            jnp.where(is_exact[k], jnp.eye(4), T[k]),
        )

    def contact(k):
        first, second = body(pairs.first[k]), pairs.second[k]
        if others is None and planes is None:
            return face_contact(first, body(second))

        def solid():
            other = jax.tree.map(lambda leaf: leaf[second - count], others)
            return face_contact(first, PlacedPiece(other, jnp.eye(4)))

        def plane():
            return piece_contact(first, jax.tree.map(lambda leaf: leaf[jnp.minimum(second, count - 1)], planes))

        if others is None or planes is None:
            return solid() if planes is None else plane()
        return jax.lax.cond(second < count, plane, solid)

    def is_open(lower, best):
        return lower < best.distance[pairs.row]

    def measure(state):
        lower, best = state
        k = jnp.argmin(jnp.where(is_open(lower, best), lower, jnp.inf))
        found, row = contact(k), pairs.row[k]
        new = Contacts(found.distance, found.point, found.normal, jnp.zeros(()), jnp.zeros((), bool))
        nearer = found.distance < best.distance[row]
        best = jax.tree.map(lambda old, new: old.at[row].set(jnp.where(nearer, new, old[row])), best, new)
        return lower.at[k].set(jnp.inf), best

    return jax.lax.while_loop(lambda state: jnp.any(is_open(*state)), measure, (lower, best))[1]


def ball_bounds(
    p: Float[Array, "K 3"], q: Float[Array, "K 3"], radius: Float[Array, "K"], balls: Float[Array, "n 4"]
) -> Float[Array, "n K"]:
    """Return lower bounds on the distances of capsules from what is in balls [m]."""
    p_, q_, centre = jnp.broadcast_arrays(p[None], q[None], balls[:, None, :3])
    apart = p_ + segment_parameter(p_, q_, centre)[..., None] * (q_ - p_) - centre
    return safe_norm(apart) - balls[:, 3:] - radius[None]


def link_poses_in(T_world_frame: Pose, T_world_link: Float[Array, "K 4 4"]) -> Float[Array, "K 4 4"]:
    """Return the poses of links in another frame."""
    R, t = T_world_frame[:3, :3], T_world_frame[:3, 3]
    apart = T_world_link[:, :3].at[:, :, 3].add(-t[None])
    turned = jnp.sum(R.T[None, :, :, None] * apart[:, None], axis=2)
    return jnp.concatenate([turned, T_world_link[:, 3:]], axis=1)
