"""Clearance predicted from known contacts: a cheap upper bound, exact at the configurations of these contacts.

A contact is measured at one configuration. At any other configuration the obstacle's point is at the same place, or has
moved with its link. The distance to this point is therefore an upper bound on the row's distance. The smallest distance
to all known contact points is a model of D; it equals D once the nearest points are among them. A tangent plane in
place of the point would be cheaper, but would reject some clear configurations.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.obstacles.obstacle import Contacts, RowPairs, slopes
from htcp_jax.model import Robot, kinematics
from htcp_jax.numerics import axis_contact, capsule_point_distance
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints


class ContactModel(NamedTuple):
    """Contacts of all R rows at one or several measured configurations, concatenated (H = R, 2 R, ...)."""

    witness: Float[Array, "H 3"]  # the obstacle's point, in the frame of its link or the world [m]
    plane: Bool[Array, "H"]  # True: the contact is a plane that an end of the body has crossed
    end: Float[Array, "H 3"]  # the end of the body's axis that crossed the plane, in the frame of its link [m]
    normal: Float[Array, "H 3"]  # inward normal of the plane, world
    offset: Float[Array, "H"]  # for a plane [m]: distance = normal . end - offset
    radius: Float[Array, "H"]  # for a point [m]: distance = |axis to witness| - radius


def hold_contacts(robot: Robot, x: Joints, rows: RowPairs, touch: Contacts) -> ContactModel:
    """Return the model of the contacts measured at x, fixed in the frames of their links.

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        rows: The pair of each of the R clearance rows: a body, and an obstacle or second body.
        touch: The contacts at x.
    """
    T = _link_poses(robot, x, rows.links(robot))
    witness = touch.witness
    if rows.other is not None:
        witness = _brought_back(_link_poses(robot, x, rows.other), witness)
    radius = touch.radius
    if robot.pieces is not None:  # a piece's contact is modelled by a thinner capsule
        p, q = (_transformed(T, each[jnp.asarray(rows.body)]) for each in (robot.capsule_p, robot.capsule_q))
        radius = capsule_point_distance(p, q, 0.0, touch.witness) - touch.distance
    return ContactModel(
        witness=witness,
        plane=touch.plane,
        end=_brought_back(T, touch.point),
        normal=touch.normal,
        offset=jnp.sum(touch.normal * touch.point, axis=1) - touch.distance,
        radius=radius,
    )


@jax.jit
def predict_distances(
    robot: Robot, x: Joints, rows: RowPairs, held: ContactModel
) -> tuple[Float[Array, "H"], Float[Array, "H N"]]:
    """Return the distance at x to each contact of the model [m], and its gradient [m/rad].

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        rows: The pairs of the R rows.
        held: The model, with contacts from one or several configurations.
    """
    rounds = held.offset.shape[0] // len(rows.body)
    T = _link_poses(robot, x, rows.links(robot))
    body = slice(None) if rows.other is None else jnp.asarray(rows.body)  # rows of bodies only are one for each body
    p, q = _transformed(T, robot.capsule_p[body]), _transformed(T, robot.capsule_q[body])
    p, q, T = (jnp.concatenate([each] * rounds) for each in (p, q, T))
    many = RowPairs.concatenate([rows] * rounds)
    witness = held.witness if many.other is None else _transformed(_link_poses(robot, x, many.other), held.witness)
    axis_point, away = axis_contact(p, q, witness)
    point = jnp.where(held.plane[:, None], _transformed(T, held.end), axis_point)
    normal = jnp.where(held.plane[:, None], held.normal, away)
    to_plane = jnp.sum(held.normal * point, axis=1) - held.offset
    value = jnp.where(held.plane, to_plane, capsule_point_distance(p, q, held.radius, witness))
    return value, slopes(robot, x, many, normal, point, witness)


def _link_poses(robot: Robot, x: Joints, links: Int[Anywhere, "n"]) -> Float[Array, "n 4 4"]:
    T = jnp.concatenate([kinematics.link_poses(robot, x), jnp.eye(4)[None]])  # the world last, so that it is link -1
    return T[jnp.asarray(links)]


def _transformed(T: Float[Array, "n 4 4"], points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    return jnp.sum(T[:, :3, :3] * points[:, None, :], axis=2) + T[:, :3, 3]


def _brought_back(T: Float[Array, "n 4 4"], points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    return jnp.sum(T[:, :3, :3] * (points - T[:, :3, 3])[:, :, None], axis=1)
