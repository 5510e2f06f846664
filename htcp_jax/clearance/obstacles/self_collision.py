"""The arm's own bodies as an obstacle: pairs of capsules that must not touch.

A row is a body against all bodies of one link nearer to the base; its contact is that of the nearest pair. If there are
many pairs, contacts are computed only for the nearest pair of each row, distances for all pairs.

Pairs that need no check are excluded, see self_exclusions.py.
"""

import dataclasses
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.caching import cached_by_values
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
from htcp_jax.numerics import one_by_one, safe_divide, safe_norm, with_repeated
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Scalar

FEW_PAIRS = 128  # number of pairs up to which the contacts of all pairs are computed
CLOSE = 16  # numbers of pairs and of rows are padded to a multiple of this number, if they are padded closely
USUAL = 0.99  # a start is refused if an excluded pair overlaps more than in this share of random configurations
RULES = {
    "a": "by the model",
    "b": "that nearly always overlap",
    "c": "whose links do not touch where the capsules overlap",
    "d": "by the job",
}
COULD_COLLIDE = "bd"  # rules by which pairs are excluded that could collide
Ends = Float[jax.Array, "K 3"]


@register_pytree
@dataclass(frozen=True)
class SelfCollision(Obstacle):
    """The arm's own bodies as an obstacle: the checked pairs of bodies, at least one, and the excluded pairs.

    A pair has the indices of two capsules, first the one nearer to the tool.
    """

    pairs: Pairs = field(metadata={"static": True})
    excluded: tuple[robots.Exclusion, ...] = field(default=(), metadata=LABEL)
    table: "PairTable | None" = None  # of a compiled program, whose pairs are data; `pairs` is then empty

    per_body = False
    in_pairs = True
    is_exact = True

    def rows(self, robot: Robot) -> RowPairs:
        """Return one row for each body and each link nearer to the base, if they have a checked pair."""
        table = self.table_of(robot)
        return RowPairs(table.body, table.other)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every row's nearest pair."""
        return self._contacts(robot, where, bodies, self._measured(robot, bodies))

    def _contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, every: "_MeasuredPairs") -> Contacts:
        if robot.pieces is not None:
            doubts = self._doubts(robot, every, narrow_phase.limit_m(where))
            return narrow_phase.decide(robot, bodies, [doubts])[0]
        return every.contacts(self.table_of(robot).nearest(every.distance))

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return the smallest distance of all pairs [m], without its contact."""
        if robot.pieces is not None:
            return super().any_below(robot, where, bodies, limit_m)
        return jnp.min(self._measured(robot, bodies).distance)

    def doubts(self, robot: Robot, bodies: BodyAxes, limit: Float[jax.Array, "..."]) -> narrow_phase.Doubts:
        """Return the rows whose capsules are in doubt, and their pairs, see `narrow_phase`."""
        return self._doubts(robot, self._measured(robot, bodies), limit)

    def _doubts(self, robot: Robot, every: "_MeasuredPairs", limit: Float[jax.Array, "..."]) -> narrow_phase.Doubts:
        table = self.table_of(robot)
        capsules = every.contacts(table.nearest(every.distance))
        first, second, row_of_pair = map(jnp.asarray, (table.first, table.second, table.row))
        limit, excess = jnp.broadcast_to(limit, capsules.distance.shape), robot.pieces.excess_m
        doubt = narrow_phase.in_doubt(every.distance, excess[first] + excess[second], limit[row_of_pair])
        doubt &= (capsules.distance < limit)[row_of_pair]
        certain = table.nearest(jnp.where(doubt, jnp.inf, every.distance))
        exact = every.contacts(certain)
        is_near = (exact.distance < limit) & ~doubt[certain]
        known = narrow_phase.chosen(is_near, exact, narrow_phase.undecided(capsules, limit))
        lower = jnp.where(doubt, every.distance, jnp.inf)
        return narrow_phase.Doubts(capsules, capsules.distance < limit, known, first, second, row_of_pair, lower)

    def parts(self, robot: Robot, row: int) -> Int[np.ndarray, "n"]:
        """Return the numbers of a row's pairs."""
        return np.unique(self.table_of(robot).numbers[row])

    def only(self, robot: Robot, part: Int[jax.Array, ""]) -> "SelfCollision":
        """Return the obstacle with one pair as the only one of its row; with all pairs for a negative number."""
        return SelfCollision((), table=self.table_of(robot).only(part))

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the name of the capsule of a pair that is nearer to the base, for messages."""
        return robots.capsule_label(robot, robot.capsule_names[self.pairs[part][1]])

    def described(self, robot: Robot) -> str:
        """Return a text with the number of checked pairs, and of excluded pairs by rule."""
        counts = Counter(each.rule for each in self.excluded)
        excluded = ", ".join(f"{counts[rule]} {RULES[rule]}" for rule in RULES if counts[rule])
        return f"{len(self.pairs)} pairs of bodies" + (f"; excluded: {excluded}" if excluded else "")

    @property
    def unchecked(self) -> tuple[robots.Exclusion, ...]:
        """Excluded pairs that could collide."""
        return tuple(each for each in self.excluded if each.rule in COULD_COLLIDE)

    def for_programs(self, robot: Robot, bodies: int, closely: bool) -> "SelfCollision":
        """Return the obstacle with its pairs as data."""
        table = self.table_of(robot)
        return SelfCollision((), table=table.padded(table.close_sizes if closely else table.sizes(bodies)))

    def table_of(self, robot: Robot) -> "PairTable":
        """Return the pairs and the rows as arrays."""
        return _pair_table(self.pairs, robot.capsule_link) if self.table is None else self.table

    def _measured(self, robot: Robot, bodies: BodyAxes) -> "_MeasuredPairs":
        return _measured(robot, self.table_of(robot), bodies.p, bodies.q)


class PairTable(NamedTuple):
    """P pairs of bodies, and R rows, each of a body and a link with a pair; as arrays."""

    first: Int[Anywhere, "P"]  # index of a capsule
    second: Int[Anywhere, "P"]  # index of a capsule on a link nearer to the base
    row: Int[Anywhere, "P"]  # row of each pair
    body: Int[Anywhere, "R"]  # index of the capsule of each row
    other: Int[Anywhere, "R"]  # link of each row
    numbers: Int[Anywhere, "R most"]  # indices of each row's pairs; shorter rows are padded with their last pair
    is_pair: Bool[Anywhere, "P"] | None = None  # False: padding, at the end; None: there is none
    is_row: Bool[Anywhere, "R"] | None = None

    def nearest(self, distance: Float[jax.Array, "P"]) -> Int[jax.Array, "R"]:
        """Return the index of the pair with the smallest distance in every row."""
        numbers = jnp.asarray(self.numbers)
        best = jnp.argmin(distance[numbers], axis=1)
        return jnp.take_along_axis(numbers, best[:, None], axis=1)[:, 0]

    def only(self, pair: Int[jax.Array, ""]) -> "PairTable":
        """Return the table with one pair in place of all others; all pairs for a negative number."""
        is_pair = True if self.is_pair is None else self.is_pair
        return self._replace(
            numbers=jnp.where(pair < 0, self.numbers, pair),
            is_pair=((jnp.arange(len(self.first)) == pair) | (pair < 0)) & is_pair,
            is_row=np.ones(len(self.body), bool) if self.is_row is None else self.is_row,
        )

    @property
    def close_sizes(self) -> tuple[int, int, int]:
        """Numbers of pairs, of rows, and of pairs in a row; the first two rounded up."""
        pairs, rows = (-(-len(each) // CLOSE) * CLOSE for each in (self.first, self.body))
        return pairs, rows, self.numbers.shape[1]

    def sizes(self, bodies: int) -> tuple[int, int, int]:
        """Return one of few sizes, as `close_sizes`: at least those of usual arms with this many bodies."""
        return next(
            each
            for k, each in enumerate(_sizes(), 1)
            if k * robots.BODIES >= min(bodies, robots.MORE_BODIES)
            and all(a <= b for a, b in zip((len(self.first), *self.numbers.shape), each, strict=True))
        )

    def padded(self, sizes: tuple[int, int, int]) -> "PairTable":
        """Return the table with these numbers of pairs, of rows, and of pairs in a row."""
        pairs, rows = len(self.first), len(self.body)
        numbers = with_repeated(with_repeated(self.numbers, sizes[1]).T, sizes[2]).T
        of_pairs, of_rows = (
            [with_repeated(each, size) for each in own] for own, size in zip((self[:3], self[3:5]), sizes, strict=False)
        )
        is_pair, is_row = (np.arange(size) < own for size, own in zip(sizes, (pairs, rows), strict=False))
        return PairTable(*of_pairs, *of_rows, numbers, is_pair, is_row)


def _sizes() -> Iterator[tuple[int, int, int]]:
    """Return numbers of pairs, of rows, and of pairs in a row, for which programs are compiled; in growing order."""
    yield from ((32, 16, 2), (128, 64, 8))  # arms with a torch have 35 pairs or more
    yield from ((160 * 2**k, 80 * 2**k, 8 * 2**k) for k in count())  # usual arms of seven and eight joints have 150


@lru_cache(maxsize=256)
def _pair_table(pairs: Pairs, links: tuple[int, ...]) -> PairTable:
    rows: dict[tuple[int, int], list[int]] = {}
    for number, (a, b) in enumerate(pairs):
        rows.setdefault((a, links[b]), []).append(number)
    most, each = max(map(len, rows.values())), list(rows)
    row = np.array([each.index((a, links[b])) for a, b in pairs])
    numbers = np.array([(own + own[-1:] * most)[:most] for own in rows.values()])
    return PairTable(*np.array(pairs).T, row, *np.array(each).T, numbers)


def make_self_collision(robot: Robot) -> SelfCollision | None:
    """Return a robot's own bodies as an obstacle, with its current tool; None if there is no pair to check.

    If pairs with the job's own tool are excluded, a UserWarning names them.

    Raises:
        InputError: If the model excludes every pair.
    """
    excluded = (*robot.exclusions, *_found(_without_meshes(robot)))
    ours = {(each.first, each.second) for each in excluded}
    known = candidates(robot)
    pairs = tuple(sorted(pair for pair in known if pair not in ours))
    if not pairs and robot.listed and any(each.rule == "a" for each in excluded):
        raise InputError(
            f"robot {robot.name}: all {len(known)} pairs of capsules are excluded; remove exclusions to check some"
        )
    if tool := [each for each in excluded if {each.first, each.second} & set(robot.mounted) and each.rule == "b"]:
        names = ", ".join(f"{robot.capsule_names[a]} and {robot.capsule_names[b]}" for a, b, *_ in tool)
        warnings.warn(
            f"not checked against each other: {names}; a motion in which they collide counts as clear; the capsules "
            "overlap, or are within 1 mm, in at least 95 % of the sampled configurations; to check them, begin the "
            "tool's or fixture's body farther out, or fit the arm closer (htcp robot --fit-tolerance)",
            UserWarning,
            stacklevel=2,
        )
    return SelfCollision(pairs, excluded) if pairs else None


class RefusedPair(NamedTuple):
    """An excluded pair that nevertheless collides at a start: indices of its capsules, depth and reason."""

    first: int
    second: int
    depth_m: float
    reason: str


def refused_pair(own: SelfCollision, robot: Robot, x: Float[np.ndarray, "N"]) -> RefusedPair | None:
    """Return an excluded pair that nevertheless collides at a start x [rad or m]; None if there is none.

    The test depends on the rule by which `self_exclusions` excludes a pair. Rule c: the meshes in its capsules overlap
    by more than TOUCHING_M. Rules a and b: its links are not adjacent, and it overlaps more than in the share USUAL of
    the `samples`. Rule d: never.
    """
    link, names = robot.capsule_link, robot.capsule_names
    pairs = [each for each in own.excluded if link[each.first] != link[each.second]]
    if not pairs:
        return None
    numbers = tuple((each.first, each.second) for each in pairs)
    depth = -distances(robot, numbers, x[None])[0]
    for each, d, usual in zip(pairs, depth, _usual_depths(_without_meshes(robot), numbers), strict=True):
        pair = f"the capsules {names[each.first]} and {names[each.second]}"
        if each.rule == "c" and robot.meshes and d > 0:
            touch_m = robot.meshes.deepest_m(names[each.first], names[each.second], x)
            if touch_m > robots.TOUCHING_M:
                reason = f"the meshes in {pair} overlap by {1e3 * touch_m:.3g} mm"
                return RefusedPair(each.first, each.second, touch_m, reason)
        elif each.rule in "ab" and robot.parents[link[each.first]] != link[each.second] and d > max(usual, 0.0):
            reason = f"{pair} overlap by {1e3 * d:.3g} mm, more than in {USUAL:.0%} of random configurations"
            return RefusedPair(each.first, each.second, float(d), reason)
    return None


def _without_meshes(robot: Robot) -> Robot:
    """Return the robot as a key of a cache: with its arrays on the host, and without the vendor's meshes."""
    return jax.device_get(dataclasses.replace(robot, meshes=None))


@cached_by_values(256)
def _found(robot: Robot) -> tuple[robots.Exclusion, ...]:
    return find_exclusions(jax.device_put(robot))


@cached_by_values(256)
def _usual_depths(robot: Robot, pairs: Pairs) -> Float[np.ndarray, "R"]:
    """Return the overlap of each pair that only a share 1 - USUAL of the `samples` exceeds [m]."""
    return np.quantile(-distances(jax.device_put(robot), pairs, samples(robot)), USUAL, axis=0)


class _MeasuredPairs(NamedTuple):
    """Distances of n pairs of capsules at one configuration, and a function that computes contacts of some pairs."""

    distance: Float[jax.Array, "n"]  # [m]
    contacts: Callable[[Int[jax.Array, "R"]], Contacts]  # returns the contacts of the pairs with these indices


def _measured(robot: Robot, table: PairTable, p: Ends, q: Ends) -> _MeasuredPairs:
    a, b = table.first, table.second
    if len(a) <= FEW_PAIRS:
        every = _pair_contacts(robot, a, b, p, q)
        away = every.distance
        of_pairs = lambda numbers: jax.tree.map(lambda leaf: leaf[numbers], every)  # noqa: E731
    else:
        away = _many_distances((a, b), p.T, q.T, robot.capsule_radius)
        first, second = jnp.asarray(a), jnp.asarray(b)
        of_pairs = lambda numbers: _column_contacts(robot, first[numbers], second[numbers], p.T, q.T)  # noqa: E731
    if table.is_pair is None:
        return _MeasuredPairs(away, of_pairs)

    def contacts(numbers: Int[jax.Array, "R"]) -> Contacts:
        found = of_pairs(numbers)
        return found._replace(distance=jnp.where(table.is_row, found.distance, robots.FAR_M))

    return _MeasuredPairs(jnp.where(table.is_pair, away, robots.FAR_M), contacts)


def _pair_contacts(robot: Robot, a: Int[Anywhere, "P"], b: Int[Anywhere, "P"], p: Ends, q: Ends) -> Contacts:
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
