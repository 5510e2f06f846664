"""The arm's own bodies as an obstacle: pairs of capsules that must not touch.

A row is a body against those of one link before it, of which the nearest counts.

Pairs that need no check are excluded, see self_exclusions.py.
"""

import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.segments import nearest_points
from htcp_jax.clearance.obstacles.obstacle import Bodies, Contacts, Exact, Posed, Rows
from htcp_jax.clearance.obstacles.self_exclusions import (
    Pairs,
    candidates,
    distances,
    find_exclusions,
    samples,
)
from htcp_jax.errors import InputError
from htcp_jax.model.robot import TOUCHING_M, Exclusion, Robot, capsule_in_words
from htcp_jax.numerics import safe_divide, safe_norm
from htcp_jax.pytree import register_pytree
from htcp_jax.types import Float, Int

USUAL = 0.99  # of random configurations, in which an excluded pair is less deep than at a start
RULES = {"a": "by the model", "b": "that nearly always overlap", "c": "whose links do not touch where they overlap"}
Ends = Float[jax.Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class SelfCollision(Exact):
    """Pairs of bodies by their numbers, the one further out first: those that are kept apart, at least one, and those
    that are not checked."""

    pairs: Pairs = field(metadata={"static": True})
    excluded: tuple[Exclusion, ...] = field(default=(), metadata={"static": True})

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
        return capsule_in_words(robot.capsule_names[self.pairs[int(_nearest(self, robot, p, q)[row])][1]])

    def described(self, robot: Robot) -> str:
        """How many pairs are kept apart, and how many are not, by which rule."""
        counts = Counter(each.rule for each in self.excluded)
        excluded = ", ".join(f"{counts[rule]} {RULES[rule]}" for rule in RULES if counts[rule])
        return f"{len(self.pairs)} pairs of bodies" + (f"; excluded: {excluded}" if excluded else "")

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
    """The robot's pairs, with the tool that it has; None where there are none to keep apart. A UserWarning names pairs
    with the job's own tool that are excluded. Raises InputError for a model that excludes every pair."""
    excluded = (*robot.exclusions, *_found(_Hashable(robot)))
    ours = {(each.first, each.second) for each in excluded}
    known = candidates(robot)
    pairs = tuple(sorted(pair for pair in known if pair not in ours))
    if not pairs and robot.listed and any(each.rule == "a" for each in excluded):
        raise InputError(
            f"robot {robot.name}: all {len(known)} pairs of capsules are excluded; nothing is left to check"
        )
    if tool := [each for each in excluded if {each.first, each.second} & set(robot.mounted) and each.rule == "b"]:
        names = ", ".join(f"{robot.capsule_names[a]} and {robot.capsule_names[b]}" for a, b, *_ in tool)
        warnings.warn(
            f"not checked against each other, as they nearly always overlap: {names}", UserWarning, stacklevel=2
        )
    return SelfCollision(pairs, excluded) if pairs else None


def refused_overlap(own: SelfCollision, robot: Robot, x: Float[np.ndarray, "N"]) -> str | None:
    """Name an excluded pair that is in collision at a start x [rad or m] all the same, and its depth; None without one.

    A pair of rule c, if the meshes in it touch. One of rule a or b, if its links are not adjacent and it is deeper than
    in USUAL of the `samples`.
    """
    link, names = robot.capsule_link, robot.capsule_names
    pairs = [each for each in own.excluded if link[each.first] != link[each.second]]
    if not pairs:
        return None
    depth = -distances(robot, [(each.first, each.second) for each in pairs], np.vstack([samples(robot), x]))
    for each, d, usual in zip(pairs, depth[-1], np.quantile(depth[:-1], USUAL, axis=0), strict=True):
        pair = f"the capsules {names[each.first]} and {names[each.second]}"
        if each.rule == "c" and robot.meshes and d > 0:
            touch_m = robot.meshes.deepest_m(names[each.first], names[each.second], x)
            if touch_m > TOUCHING_M:
                return f"the meshes in {pair} touch by {1e3 * touch_m:.3g} mm"
        elif each.rule != "c" and link[each.first] > link[each.second] + 1 and d > max(usual, 0.0):
            return f"{pair} overlap by {1e3 * d:.3g} mm, more than in {USUAL:.0%} of random configurations"
    return None


class _Hashable:
    """A robot that equals another one with the same numbers."""

    def __init__(self, robot: Robot):
        self.robot = robot
        leaves, structure = jax.tree.flatten(robot)
        self._key = structure, tuple(np.asarray(leaf).tobytes() for leaf in leaves)

    def __eq__(self, other: "_Hashable") -> bool:
        return self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=256)
def _found(arm: _Hashable) -> tuple[Exclusion, ...]:
    return find_exclusions(arm.robot)


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
