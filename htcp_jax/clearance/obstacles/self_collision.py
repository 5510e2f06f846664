"""The arm's own bodies as an obstacle: pairs of capsules that must not touch.

A row is a body against the bodies of one link before it; its contact is that of the nearest pair. Of many pairs, only
these contacts are made, and the others' distances alone.

Pairs that need no check are excluded, see self_exclusions.py.
"""

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.segments import nearest_columns, nearest_points
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle, RowPairs
from htcp_jax.clearance.obstacles.self_exclusions import (
    Pairs,
    candidates,
    distances,
    find_exclusions,
    samples,
)
from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.model import robot as robots
from htcp_jax.numerics import one_by_one, safe_divide, safe_norm
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Array, Float, Int, Scalar

FEW_PAIRS = 128  # up to which all contacts are made: arms made by hand
USUAL = 0.99  # a start is refused where an excluded pair is deeper than in this share of random configurations
RULES = {
    "a": "by the model",
    "b": "that nearly always overlap",
    "c": "whose links do not touch where they overlap",
    "d": "by the job",
}
Ends = Float[jax.Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class SelfCollision(Obstacle):
    """Pairs of bodies by their numbers, the one further out first: at least one checked pair, and the excluded ones."""

    pairs: Pairs = field(metadata={"static": True})
    excluded: tuple[robots.Exclusion, ...] = field(default=(), metadata=LABEL)

    per_body = False
    in_pairs = True

    def rows(self, robot: Robot) -> RowPairs:
        """Return one row per body and link before it with a checked pair."""
        return RowPairs(*zip(*self._rows(robot), strict=True))

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the nearest points of the axes of the nearest pair of every row."""
        return self._contacts(robot, where, bodies, _measured(robot, self.pairs, bodies.p, bodies.q))

    def _contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, every: "_MeasuredPairs") -> Contacts:
        if robot.pieces is not None:
            return narrow_phase.decide(robot, bodies, [self._doubts(robot, where, every)])[0]
        return every.contacts(self._nearest_of(every.distance, list(self._rows(robot).values())))

    def doubts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> narrow_phase.Doubts:
        """Return the rows whose capsules are in doubt, and their pairs."""
        return self._doubts(robot, where, _measured(robot, self.pairs, bodies.p, bodies.q))

    def _doubts(self, robot: Robot, where: HasWorkpiecePose, every: "_MeasuredPairs") -> narrow_phase.Doubts:
        rows = list(self._rows(robot).values())
        capsules = every.contacts(self._nearest_of(every.distance, rows))
        row = np.argsort(np.concatenate(rows)), np.repeat(np.arange(len(rows)), list(map(len, rows)))
        row_of_pair = jnp.asarray(row[1][row[0]])
        first, second = (jnp.asarray(side) for side in zip(*self.pairs, strict=True))
        limit, excess = narrow_phase.limit_m(where), robot.pieces.excess_m
        doubt = narrow_phase.in_doubt(every.distance, excess[first] + excess[second], limit)
        doubt &= (capsules.distance < limit)[row_of_pair]
        certain = self._nearest_of(jnp.where(doubt, jnp.inf, every.distance), rows)
        exact = every.contacts(certain)
        is_near = (exact.distance < limit) & ~doubt[certain]
        known = narrow_phase.chosen(is_near, exact, narrow_phase.undecided(capsules, limit))
        lower = jnp.where(doubt, every.distance, jnp.inf)
        return narrow_phase.Doubts(capsules, capsules.distance < limit, known, first, second, row_of_pair, lower)

    def nearest_name(self, robot: Robot, where: HasWorkpiecePose, row: int, bodies: BodyAxes) -> str:
        """Return the name of the capsule nearest to the body of a row, by it or the piece in it, for messages."""
        numbers = self._table(list(self._rows(robot).values()))[row]
        nearest = numbers[int(_distances_alone(self, robot, where, bodies, numbers, row).argmin())]
        return robots.capsule_label(robot, robot.capsule_names[self.pairs[nearest][1]])

    def described(self, robot: Robot) -> str:
        """Describe the number of checked pairs and of excluded pairs by rule."""
        counts = Counter(each.rule for each in self.excluded)
        excluded = ", ".join(f"{counts[rule]} {RULES[rule]}" for rule in RULES if counts[rule])
        return f"{len(self.pairs)} pairs of bodies" + (f"; excluded: {excluded}" if excluded else "")

    def _rows(self, robot: Robot) -> dict[tuple[int, int], list[int]]:
        """Return the pairs' numbers by each row's body and link."""
        found = {}
        for number, (a, b) in enumerate(self.pairs):
            found.setdefault((a, robot.capsule_link[b]), []).append(number)
        return found

    def _table(self, rows: list[list[int]]) -> np.ndarray:
        """Return the pairs' numbers, one row each, filled up with its last one."""
        most = max(map(len, rows))
        return np.array([(own + own[-1:] * most)[:most] for own in rows])

    def _nearest_of(self, distance: Float[jax.Array, "n"], rows: list[list[int]]) -> Int[jax.Array, "R"]:
        """Return the number of the pair with the smallest distance in every row."""
        table = self._table(rows)
        best = jnp.argmin(distance[table], axis=1)
        return jnp.take_along_axis(jnp.asarray(table), best[:, None], axis=1)[:, 0]


def self_collision(robot: Robot) -> SelfCollision | None:
    """Return the robot's pairs, with its current tool; None if no pair is left to check.

    A UserWarning names excluded pairs with the job's own tool.

    Raises:
        InputError: For a model that excludes every pair.
    """
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


class RefusedPair(NamedTuple):
    """An excluded pair that collides all the same, by the numbers of its capsules."""

    first: int
    second: int
    depth_m: float
    reason: str


def refused_pair(own: SelfCollision, robot: Robot, x: Float[np.ndarray, "N"]) -> RefusedPair | None:
    """Return an excluded pair that nevertheless collides at a start x [rad or m]; None without one.

    A pair of rule c collides if the meshes in it touch. One of rule a or b does if its links are not adjacent and it is
    deeper than in USUAL of the `samples`. One of rule d never does.
    """
    link, names = robot.capsule_link, robot.capsule_names
    pairs = [each for each in own.excluded if link[each.first] != link[each.second]]
    if not pairs:
        return None
    numbers = tuple((each.first, each.second) for each in pairs)
    depth = -distances(robot, numbers, x[None])[0]
    for each, d, usual in zip(pairs, depth, _usual_depths(_Hashable(robot), numbers), strict=True):
        pair = f"the capsules {names[each.first]} and {names[each.second]}"
        if each.rule == "c" and robot.meshes and d > 0:
            touch_m = robot.meshes.deepest_m(names[each.first], names[each.second], x)
            if touch_m > robots.TOUCHING_M:
                reason = f"the meshes in {pair} touch by {1e3 * touch_m:.3g} mm"
                return RefusedPair(each.first, each.second, touch_m, reason)
        elif each.rule in "ab" and link[each.first] > link[each.second] + 1 and d > max(usual, 0.0):
            reason = f"{pair} overlap by {1e3 * d:.3g} mm, more than in {USUAL:.0%} of random configurations"
            return RefusedPair(each.first, each.second, float(d), reason)
    return None


class _Hashable:
    """A robot that compares equal to another one with the same numbers.

    The numbers are on the host, so that a cache of results for robots holds no memory of a device.
    """

    def __init__(self, robot: Robot):
        self.robot = jax.tree.map(np.asarray, robot)
        leaves, structure = jax.tree.flatten(self.robot)
        self._key = structure, tuple(leaf.tobytes() for leaf in leaves)

    def __eq__(self, other: "_Hashable") -> bool:
        return self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=256)
def _found(arm: _Hashable) -> tuple[robots.Exclusion, ...]:
    return find_exclusions(jax.device_put(arm.robot))


@lru_cache(maxsize=256)
def _usual_depths(arm: _Hashable, pairs: Pairs) -> Float[np.ndarray, "R"]:
    """Return the depth that each pair exceeds in 1 - USUAL of the `samples` [m]: the same for every start."""
    robot = jax.device_put(arm.robot)
    return np.quantile(-distances(robot, pairs, samples(robot)), USUAL, axis=0)


class _MeasuredPairs(NamedTuple):
    """Pairs of capsules at one configuration."""

    distance: Float[jax.Array, "n"]  # [m]
    contacts: Callable[[Int[jax.Array, "R"]], Contacts]  # of pairs by their numbers


def _measured(robot: Robot, pairs: Pairs, p: Ends, q: Ends) -> _MeasuredPairs:
    a, b = (np.array(side) for side in zip(*pairs, strict=True))
    if len(pairs) <= FEW_PAIRS:
        every = _pair_contacts(robot, a, b, p, q)
        return _MeasuredPairs(every.distance, lambda numbers: jax.tree.map(lambda leaf: leaf[numbers], every))
    away = _many_distances((a, b), p.T, q.T, robot.capsule_radius)
    first, second = jnp.asarray(a), jnp.asarray(b)
    return _MeasuredPairs(away, lambda numbers: _column_contacts(robot, first[numbers], second[numbers], p.T, q.T))


def _pair_contacts(robot: Robot, a: np.ndarray, b: np.ndarray, p: Ends, q: Ends) -> Contacts:
    _, _, on_a, on_b = nearest_points(p[a], q[a], p[b], q[b])
    return _contacts(on_a, on_b, robot.capsule_radius[a] + robot.capsule_radius[b])


def _contacts(on_a: Float[jax.Array, "n 3"], on_b: Float[jax.Array, "n 3"], reach: Float[jax.Array, "n"]) -> Contacts:
    arm = on_a - on_b
    length = safe_norm(arm)
    normal = safe_divide(arm, jnp.broadcast_to(length[:, None], arm.shape))
    return Contacts(length - reach, on_a, normal, reach, jnp.zeros(length.shape, bool))


@one_by_one
def _many_distances(shared, p, q, radius):
    a, b = shared
    return nearest_columns(p[:, a], q[:, a], p[:, b], q[:, b])[2] - (radius[a] + radius[b])


def _column_contacts(
    robot: Robot, a: Int[jax.Array, "n"], b: Int[jax.Array, "n"], p: Float[Array, "3 K"], q: Float[Array, "3 K"]
) -> Contacts:
    ends = p[:, a], q[:, a], p[:, b], q[:, b]
    t, u, _ = nearest_columns(*ends)
    on_a, on_b = ends[0] + t[None] * (ends[1] - ends[0]), ends[2] + u[None] * (ends[3] - ends[2])
    return _contacts(on_a.T, on_b.T, robot.capsule_radius[a] + robot.capsule_radius[b])


@jax.jit
def _distances_alone(
    own: SelfCollision,
    robot: Robot,
    where: HasWorkpiecePose,
    bodies: BodyAxes,
    numbers: Int[Array, "n"],
    row: Int[Array, ""],
) -> Float[Array, "n"]:
    """Return the distances of n pairs of a row, each as if the row had no other."""
    every = _measured(robot, own.pairs, bodies.p, bodies.q)

    def alone(number: Int[Array, ""]) -> Scalar:
        distance = jnp.where(jnp.arange(len(own.pairs)) == number, every.distance, jnp.inf)
        return own._contacts(robot, where, bodies, every._replace(distance=distance)).distance[row]

    return jax.lax.map(alone, numbers)
