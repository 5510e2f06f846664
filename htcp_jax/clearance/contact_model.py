"""The clearance as the contacts seen so far give it: never too small, exact where they were seen, and cheap.

A contact seen at one configuration stays true of its body at every other one: the cloud's point is still there. So the
distance to it bounds the body's clearance from above, and the smallest over all contacts seen is a model of D that
becomes D itself once the right ones have been seen. A plane in place of the point would be cheaper still, but false
away from where it was seen: it cuts off configurations that are clear.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.obstacles import Contacts
from htcp_jax.numerics import safe_divide, safe_norm, segment_parameter
from htcp_jax.scene.kinematics import link_poses, point_jacobians
from htcp_jax.scene.robot import Robot
from htcp_jax.types import Array, Bool, Float, Joints


class Seen(NamedTuple):
    """Contacts of all K bodies in turn, from one observation or several (R = K, 2 K, ...), held fixed in the world."""

    witness: Float[Array, "R 3"]  # the point of the cloud [m]
    crossed: Bool[Array, "R"]  # whether it is a facet of the hull instead, crossed by an end of the body:
    end: Float[Array, "R 3"]  # that end, in the frame of the body's link
    normal: Float[Array, "R 3"]  # of the facet, inwards
    offset: Float[Array, "R"]  # clearance = normal . end - offset
    reach: Float[Array, "R"]  # clearance = distance from the axis to the witness - reach


def see(robot: Robot, x: Joints, touch: Contacts) -> Seen:
    """The contacts at x, to be held."""
    T = _body_poses(robot, x)
    return Seen(
        witness=touch.point - touch.normal * (touch.distance + touch.reach)[:, None],
        crossed=touch.crossed,
        end=jnp.sum(T[:, :3, :3] * (touch.point - T[:, :3, 3])[:, :, None], axis=1),
        normal=touch.normal,
        offset=jnp.sum(touch.normal * touch.point, axis=1) - touch.distance,
        reach=touch.reach,
    )


@jax.jit
def seen_clearance(robot: Robot, x: Joints, seen: Seen) -> tuple[Float[Array, "R"], Float[Array, "R N"]]:
    """Clearance at x [m] from each contact seen, and its gradient [m/rad]."""
    rounds = seen.offset.shape[0] // len(robot.capsule_link)
    T = _body_poses(robot, x)
    p, q = _moved(T, robot.capsule_p), _moved(T, robot.capsule_q)
    p, q, T = (jnp.concatenate([each] * rounds) for each in (p, q, T))
    axis_point = p + segment_parameter(p, q, seen.witness)[:, None] * (q - p)
    arm = axis_point - seen.witness
    length = safe_norm(arm)
    away = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))

    point = jnp.where(seen.crossed[:, None], _moved(T, seen.end), axis_point)
    normal = jnp.where(seen.crossed[:, None], seen.normal, away)
    value = jnp.where(seen.crossed, jnp.sum(seen.normal * point, axis=1) - seen.offset, length - seen.reach)
    motion = point_jacobians(robot, x, point, robot.capsule_link * rounds)
    return value, jnp.sum(normal[:, :, None] * motion, axis=1)


def _body_poses(robot: Robot, x: Joints) -> Float[Array, "K 4 4"]:
    T = jnp.concatenate([link_poses(robot, x), jnp.eye(4)[None]])  # the world last, so that link -1 finds it
    return T[jnp.asarray(robot.capsule_link)]


def _moved(T: Float[Array, "R 4 4"], points: Float[Array, "R 3"]) -> Float[Array, "R 3"]:
    return jnp.sum(T[:, :3, :3] * points[:, None, :], axis=2) + T[:, :3, 3]
