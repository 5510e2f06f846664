"""The arm's own bodies as an obstacle: pairs of capsules that must not touch.

A row is a body against those of one link before it, of which the nearest counts.

Left out are pairs on one link and on neighbouring ones, which meet at their joint; those that the model excludes; and
those that overlap at the model's zero or at a keyframe of it, where the arm stands as its maker drew it.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.obstacle import Bodies, Contacts, Exact, Posed, Rows
from htcp_jax.clearance.segments import nearest_points
from htcp_jax.numerics import safe_divide, safe_norm
from htcp_jax.pytree import register_pytree
from htcp_jax.scene.kinematics import capsule_segments
from htcp_jax.scene.robot import Robot
from htcp_jax.types import Float, Int

Pairs = tuple[tuple[int, int], ...]
Ends = Float[jax.Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class SelfCollision(Exact):
    """Pairs of bodies by their numbers, the one further out first: those that are kept apart, at least one, and those
    that overlap where the model is drawn, which are not."""

    pairs: Pairs = field(metadata={"static": True})
    overlapping: Pairs = field(default=(), metadata={"static": True})

    per_body = False

    def rows(self, robot: Robot) -> Rows:
        """A body further out against those of one link."""
        return Rows(*zip(*self._rows(robot), strict=True))

    def contacts(self, robot: Robot, where: Posed, bodies: Bodies) -> Contacts:
        """The nearest points of the axes of the nearest pair of every row."""
        every, nearest = self._nearest(robot, bodies.p, bodies.q)
        return jax.tree.map(lambda leaf: leaf[nearest], every)

    def distances(self, robot: Robot, p: Ends, q: Ends) -> Float[jax.Array, "n"]:
        """Of every pair, in their order."""
        return _contacts(robot, self.pairs, p, q).distance

    def hit(self, robot: Robot, row: int, p: Ends, q: Ends) -> str:
        """What the body of a row is nearest to, in words."""
        return robot.capsule_names[self.pairs[int(_nearest(self, robot, p, q)[row])][1]]

    def described(self, robot: Robot) -> str:
        """How many pairs are kept apart, and which are not."""
        left_out = ", ".join(f"{robot.capsule_names[a]} and {robot.capsule_names[b]}" for a, b in self.overlapping)
        return f"{len(self.pairs)} pairs of bodies" + (f"; not {left_out}, which overlap as drawn" if left_out else "")

    def _rows(self, robot: Robot) -> dict[tuple[int, int], list[int]]:
        """Of every row the body, the link, and its pairs by their numbers."""
        found = {}
        for number, (a, b) in enumerate(self.pairs):
            found.setdefault((a, robot.capsule_link[b]), []).append(number)
        return found

    def _nearest(self, robot: Robot, p: Ends, q: Ends) -> tuple[Contacts, Int[jax.Array, "R"]]:
        """The contacts of all pairs, and which of them is nearest in every row."""
        every, rows = _contacts(robot, self.pairs, p, q), list(self._rows(robot).values())
        most = max(map(len, rows))
        table = np.array([(own + own[-1:] * most)[:most] for own in rows])
        best = jnp.argmin(every.distance[table], axis=1)
        return every, jnp.take_along_axis(jnp.asarray(table), best[:, None], axis=1)[:, 0]


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


def _contacts(robot: Robot, pairs: Pairs, p: Ends, q: Ends) -> Contacts:
    a, b = (np.array(side) for side in zip(*pairs, strict=True))
    _, _, on_a, on_b = nearest_points(p[a], q[a], p[b], q[b])
    arm, reach = on_a - on_b, robot.capsule_radius[a] + robot.capsule_radius[b]
    length = safe_norm(arm)
    normal = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))
    return Contacts(length - reach, on_a, normal, reach, jnp.zeros(length.shape, bool))


@jax.jit
def _nearest(own: SelfCollision, robot: Robot, p: Ends, q: Ends) -> Int[jax.Array, "R"]:
    return own._nearest(robot, p, q)[1]


@jax.jit
def _distances(robot: Robot, own: SelfCollision, postures: Float[jax.Array, "n N"]) -> Float[jax.Array, "n R"]:
    def at(x):
        return own.distances(robot, *capsule_segments(robot, x))

    return jax.vmap(at)(postures)
