"""The arm's own bodies as an obstacle: pairs of capsules that must not touch, a row each.

Left out are pairs on one link and on neighbouring ones, which meet at their joint; those that the model excludes; and
those that overlap at the model's zero or at a keyframe of it, where the arm stands as its maker drew it.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.obstacle import Bodies, Contacts, Posed, Rows
from htcp_jax.clearance.segments import nearest_points
from htcp_jax.numerics import safe_divide, safe_norm
from htcp_jax.pytree import register_pytree
from htcp_jax.scene.kinematics import capsule_segments
from htcp_jax.scene.robot import Robot
from htcp_jax.types import Bool, Float, Scalar

Pairs = tuple[tuple[int, int], ...]


@register_pytree
@dataclass(frozen=True)
class SelfCollision:
    """Pairs of bodies by their numbers, the one further out first: those that are kept apart, at least one, and those
    that overlap where the model is drawn, which are not."""

    pairs: Pairs = field(metadata={"static": True})
    overlapping: Pairs = field(default=(), metadata={"static": True})

    per_body = False

    def rows(self, robot: Robot) -> Rows:
        """One a pair: the body further out, against a point of the link of the other."""
        return Rows(tuple(a for a, _ in self.pairs), tuple(robot.capsule_link[b] for _, b in self.pairs))

    def contacts(self, robot: Robot, where: Posed, bodies: Bodies) -> Contacts:
        """The nearest points of the axes of every pair."""
        return _contacts(robot, self.pairs, bodies.p, bodies.q)

    def smallest(self, robot: Robot, where: Posed, bodies: Bodies) -> Scalar:
        """Of all pairs."""
        return jnp.min(self.contacts(robot, where, bodies).distance)

    def touches(self, robot: Robot, where: Posed, bodies: Bodies) -> Bool[jax.Array, ""]:
        """Whether any pair does."""
        return self.smallest(robot, where, bodies) <= 0

    def room(self, robot: Robot, where: Posed, bodies: Bodies) -> Float[jax.Array, "R"]:
        """The distance itself, as one of the two sees it."""
        return self.contacts(robot, where, bodies).distance

    def hit(self, robot: Robot, row: int, p: Float[jax.Array, "K 3"], q: Float[jax.Array, "K 3"]) -> str:
        """What the body of a row is nearest to, in words."""
        return robot.capsule_names[self.pairs[row][1]]

    def described(self, robot: Robot) -> str:
        """How many pairs are kept apart, and which are not."""
        left_out = ", ".join(f"{robot.capsule_names[a]} and {robot.capsule_names[b]}" for a, b in self.overlapping)
        return f"{len(self.pairs)} pairs of bodies" + (f"; not {left_out}, which overlap as drawn" if left_out else "")


def self_collision(robot: Robot) -> SelfCollision | None:
    """The robot's pairs, with the tool that it has; None where there are none to keep apart."""
    link, bodies = robot.capsule_link, range(len(robot.capsule_link))
    excluded = {frozenset(pair) for pair in robot.excluded}
    apart = [(a, b) for a in bodies for b in bodies if link[a] > link[b] + 1 and {a, b} not in excluded]
    pairs = tuple(sorted(apart))
    if not pairs:
        return None
    postures = np.array([(0.0,) * len(robot.slides), *robot.keyframes])
    drawn = (_distances(robot, SelfCollision(pairs), postures) <= 0).any(axis=0)
    kept = tuple(pair for pair, overlaps in zip(pairs, drawn, strict=True) if not overlaps)
    return SelfCollision(kept, tuple(pair for pair in pairs if pair not in kept)) if kept else None


def _contacts(robot: Robot, pairs: Pairs, p: Float[jax.Array, "K 3"], q: Float[jax.Array, "K 3"]) -> Contacts:
    a, b = (np.array(side) for side in zip(*pairs, strict=True))
    _, _, on_a, on_b = nearest_points(p[a], q[a], p[b], q[b])
    arm, reach = on_a - on_b, robot.capsule_radius[a] + robot.capsule_radius[b]
    length = safe_norm(arm)
    normal = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))
    return Contacts(length - reach, on_a, normal, reach, jnp.zeros(length.shape, bool))


@jax.jit
def _distances(robot: Robot, own: SelfCollision, postures: Float[jax.Array, "n N"]) -> Float[jax.Array, "n R"]:
    def at(x):
        return _contacts(robot, own.pairs, *capsule_segments(robot, x)).distance

    return jax.vmap(at)(postures)
