"""Two kinds of obstacle that nothing in the package knows: a floor, and the arm itself."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from htcp_jax.clearance.obstacle import Bodies, Contacts, Posed, Rows
from htcp_jax.numerics import safe_norm
from htcp_jax.pytree import register_pytree
from htcp_jax.scene.robot import Robot

STATIC = {"static": True}


@register_pytree
@dataclass(frozen=True)
class Floor:
    """All of the arm but what stands still stays above a height in the world; one row a body, shared."""

    height_m: jax.Array

    per_body = True

    def rows(self, robot: Robot) -> Rows:
        return Rows.of_bodies(robot)

    def contacts(self, robot: Robot, where: Posed, bodies: Bodies) -> Contacts:
        lower = jnp.where((bodies.p[:, 2] < bodies.q[:, 2])[:, None], bodies.p, bodies.q)
        up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), lower.shape)
        plane = jnp.ones(len(lower), bool)
        return Contacts(self._above(robot, bodies.p, bodies.q), lower, up, robot.capsule_radius, plane)

    def smallest(self, robot: Robot, where: Posed, bodies: Bodies):
        return jnp.min(self._above(robot, bodies.p, bodies.q))

    def touches(self, robot: Robot, where: Posed, bodies: Bodies):
        return self.smallest(robot, where, bodies) <= 0

    def room(self, robot: Robot, where: Posed, bodies: Bodies):
        return self._above(robot, bodies.p, bodies.q)

    def touches_along(self, robot: Robot, where: Posed, bodies: Bodies, body, asked):
        return jnp.any(asked & (self._above(robot, bodies.p, bodies.q)[:, body] <= 0))

    def _above(self, robot: Robot, p, q):
        lowest = jnp.minimum(p[..., 2], q[..., 2])
        reach, fixed = robot.capsule_radius + self.height_m, jnp.array(robot.capsule_link) < 0
        reach, fixed = (jnp.broadcast_to(each, lowest.shape) for each in (reach, fixed))
        return jnp.where(fixed, 10.0, lowest - reach)


@register_pytree
@dataclass(frozen=True)
class SelfPairs:
    """Pairs of bodies that must not touch; a row a pair, which is its own."""

    pairs: tuple[tuple[int, int], ...] = field(metadata=STATIC)

    per_body = False

    def rows(self, robot: Robot) -> Rows:
        return Rows(tuple(a for a, _ in self.pairs), tuple(robot.capsule_link[b] for _, b in self.pairs))

    def contacts(self, robot: Robot, where: Posed, bodies: Bodies) -> Contacts:
        a, b = (jnp.array(side) for side in zip(*self.pairs, strict=True))
        on_a, on_b = nearest_points(bodies.p[a], bodies.q[a], bodies.p[b], bodies.q[b])
        apart = safe_norm(on_a - on_b)
        reach = robot.capsule_radius[a] + robot.capsule_radius[b]
        normal = (on_a - on_b) / jnp.maximum(apart, 1e-12)[:, None]
        return Contacts(apart - reach, on_a, normal, reach, jnp.zeros(len(self.pairs), bool))

    def smallest(self, robot: Robot, where: Posed, bodies: Bodies):
        return jnp.min(self.contacts(robot, where, bodies).distance)

    def touches(self, robot: Robot, where: Posed, bodies: Bodies):
        return self.smallest(robot, where, bodies) <= 0

    def room(self, robot: Robot, where: Posed, bodies: Bodies):
        """Half the distance each, as both may move."""
        half = self.contacts(robot, where, bodies).distance / 2
        room = jnp.full(len(robot.capsule_link), 10.0)
        for row, pair in enumerate(self.pairs):
            room = room.at[jnp.array(pair)].min(half[row])
        return room


def nearest_points(p, q, r, s):
    """Of segments p q and r s, row by row, the points nearest to each other (Ericson, Real-Time Collision Detection,
    5.1.9)."""
    d, e, w = q - p, s - r, p - r
    a, b, c = (jnp.sum(u * v, axis=1) for u, v in ((d, d), (d, e), (e, e)))
    f, g = jnp.sum(d * w, axis=1), jnp.sum(e * w, axis=1)
    det = a * c - b * b
    t = jnp.where(det > 1e-12, jnp.clip((b * g - c * f) / jnp.where(det > 1e-12, det, 1.0), 0, 1), 0.0)
    u = jnp.clip((b * t + g) / jnp.maximum(c, 1e-12), 0, 1)
    t = jnp.clip((b * u - f) / jnp.maximum(a, 1e-12), 0, 1)
    return p + t[:, None] * d, r + u[:, None] * e
