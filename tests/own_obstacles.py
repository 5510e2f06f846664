"""User-defined kind of obstacle that the package does not contain: a floor."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from htcp_jax.clearance import HasWorkpiecePose, Obstacle
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, RowPairs
from htcp_jax.model import Robot
from htcp_jax.pytree import register_pytree


@register_pytree
@dataclass(frozen=True)
class Floor(Obstacle):
    """Floor at a height in the world that all moving bodies stay above; one shared row per body."""

    height_m: jax.Array

    per_body = True

    def rows(self, robot: Robot) -> RowPairs:
        return RowPairs.of_bodies(robot)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        lower = jnp.where((bodies.p[:, 2] < bodies.q[:, 2])[:, None], bodies.p, bodies.q)
        up = jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), lower.shape)
        plane = jnp.ones(len(lower), bool)
        return Contacts(self._above(robot, bodies.p, bodies.q), lower, up, robot.capsule_radius, plane)

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes):
        return jnp.min(self._above(robot, bodies.p, bodies.q))

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes):
        return self._above(robot, bodies.p, bodies.q)

    def _above(self, robot: Robot, p, q):
        lowest = jnp.minimum(p[..., 2], q[..., 2])
        reach, fixed = robot.capsule_radius + self.height_m, jnp.array(robot.capsule_link) < 0
        return jnp.where(fixed, 10.0, lowest - reach)
