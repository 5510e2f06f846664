"""Self-collision of an imported arm: pairs that are not checked, and how often the arm is clear.

Capsules and convex pieces contain the meshes, so that an arm is clear in fewer configurations by them than by its
meshes. An arm that is hardly ever clear by them cannot be used, although its links do not touch. The share of random
configurations that are clear is therefore measured both ways, with the same pairs checked. If the difference is large,
the pieces of the pairs that make it are cut closer, see `closer_pieces`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool

from htcp_jax.clearance.obstacles import self_exclusions
from htcp_jax.io.robots.body_covers import new_name
from htcp_jax.io.robots.closer_pieces import KEPT, SharedPoints, cut_apart, drawn_points, in_hull
from htcp_jax.io.robots.link_meshes import LinkMeshes, Poses
from htcp_jax.io.robots.mjcf import Listed
from htcp_jax.io.robots.mujoco_models import body_name
from htcp_jax.io.robots.vendor_import import ImportedArm
from htcp_jax.model import Robot

SAMPLES = 500  # number of configurations for the shares
NEARLY = 0.95  # pieces are cut closer if the arm is clear less often by them than by its meshes, times this
OFTEN = 0.5
ROUNDS = 3  # maximum number of times that pieces are cut closer
MOST_LOST = 100  # maximum number of configurations from which points are drawn

_Pair = tuple[str, str]  # names of two capsules
_Masks = dict[_Pair, Bool[np.ndarray, "n"]]


class PairShare(NamedTuple):
    """A pair of capsules, and the share of configurations in which it overlaps."""

    first: str
    second: str
    share: float

    def __str__(self):
        return f"{self.first} and {self.second} ({self.share:.1%})"


@dataclass(frozen=True)
class ClearShares:
    """Shares of random configurations in which an arm is clear.

    Attributes:
        by_pieces: By pair of capsules, True for configurations in which their pieces overlap.
        by_meshes: By pair, True for configurations in which their meshes overlap, or touch.
        count: Number of configurations.
    """

    by_pieces: _Masks
    by_meshes: _Masks
    count: int

    @property
    def pieces(self) -> float:
        """Share by capsules and pieces."""
        return float(self._is_clear(self.by_pieces).mean())

    @property
    def meshes(self) -> float:
        """Share by meshes."""
        return float(self._is_clear(self.by_meshes).mean())

    def _is_clear(self, overlap: _Masks) -> Bool[np.ndarray, "n"]:
        return ~np.any([np.zeros(self.count, bool), *overlap.values()], axis=0)

    def lost(self) -> _Masks:
        """Return, by pair, True for configurations that are clear by meshes, and in which its pieces overlap."""
        is_clear = self._is_clear(self.by_meshes)
        return {pair: mask & is_clear for pair, mask in self.by_pieces.items()}

    @property
    def ratio(self) -> float:
        """Share by capsules and pieces divided by that by meshes; 1 if both are 0."""
        return self.pieces / self.meshes if self.meshes else 1.0

    @cached_property
    def differing(self) -> tuple[PairShare, ...]:
        """The pairs that make the difference, with their shares of configurations that only meshes leave clear.

        Without their overlaps the share by pieces would be at least NEARLY that by meshes.
        """
        lost, found = self.lost(), []
        while self.meshes - (~self._is_clear(lost)).mean() < NEARLY * self.meshes:
            found.append(PairShare(*(most := max(lost, key=lambda pair: lost[pair].sum())), float(lost[most].mean())))
            del lost[most]
        return tuple(found)

    @property
    def usual(self) -> tuple[PairShare, ...]:
        """The pairs whose meshes overlap in at least OFTEN of the configurations."""
        shares = [PairShare(*pair, float(mask.mean())) for pair, mask in self.by_meshes.items()]
        return tuple(sorted((each for each in shares if each.share >= OFTEN), key=lambda each: -each.share))

    def described(self) -> str:
        """Describe the shares, the pairs that make the difference, and those that overlap often."""
        text = f"{self.pieces:.0%} of {self.count} random configurations, {self.meshes:.0%} by the meshes"
        for reason, pairs in (("the difference", self.differing), ("meshes that overlap often", self.usual)):
            text += f"; {reason}: {', '.join(map(str, pairs))}" if pairs else ""
        return text


@dataclass(frozen=True)
class CheckedArm:
    """An imported arm with its pairs of capsules that are not checked."""

    arm: ImportedArm
    listed: list[Listed]  # pairs that samples and meshes exclude, without those that the model or the SRDF disables
    shares: ClearShares
    _at: Poses = field(repr=False)  # poses of the bodies in the configurations of the shares

    def closer_than(self, first: ImportedArm) -> tuple[str, ...]:
        """Describe the bodies that have more capsules than in another import of the arm."""
        counts = {b: (len(first.covers[b].pieces), len(cover.pieces)) for b, cover in self.arm.covers.items()}
        return tuple(
            f"{body_name(self.arm.model, b)} ({count[0]} to {count[1]} capsules)"
            for b, count in counts.items()
            if count[0] != count[1]
        )


def check_arm(
    arm: ImportedArm,
    load: Callable[[ImportedArm], Robot],
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> CheckedArm:
    """Find the pairs that are not checked and the shares of clear configurations, and cut pieces closer if necessary.

    Args:
        arm: The imported arm.
        load: Function that returns an imported arm as a robot.
        progress: Function that is called with the number of finished pairs and their total.
    """
    known: dict[tuple, bool | float] = {}
    best = now = _checked(arm, load(arm), known, progress)
    for _ in range(ROUNDS):
        closer = _closer(now) if now.shares.differing else None
        if closer is None:
            break
        now = _checked(closer, load(closer), known, progress)
        best = max(best, now, key=lambda each: each.shares.ratio)
    return best


def _checked(arm: ImportedArm, made: Robot, known: dict, progress: Callable[[int, int], None]) -> CheckedArm:
    """Find the excluded pairs and the shares; `known` has results for pairs of pieces, and is extended."""
    pieces = {name: (name, piece.cuts) for cover in arm.covers.values() for name, piece in cover.pieces.items()}
    meshes, names, x = LinkMeshes.of(arm), made.capsule_names, self_exclusions.samples(made)
    at, count, tried = meshes.poses(x), len(self_exclusions.candidates(made)), 0
    near: _Masks = {}  # for checked pairs, the configurations in which the capsules overlap

    def touch(pair: tuple[int, int], overlap: Bool[np.ndarray, "n"]) -> bool:
        nonlocal tried
        tried += 1
        progress(tried, count)
        one, other = (names[k] for k in pair)
        key = "touch", pieces.get(one, one), pieces.get(other, other)
        if key not in known:
            known[key] = meshes.can_touch(one, other, x, at, np.flatnonzero(overlap))
        if known[key]:
            near[one, other] = overlap[:SAMPLES]
        return known[key]

    def touching_share(pairs: self_exclusions.Pairs) -> float:
        named = [(names[a], names[b]) for a, b in pairs]
        key = "share", *((pieces.get(one, one), pieces.get(other, other)) for one, other in named)
        if key not in known:
            known[key] = meshes.touching_share(named, at)
        return known[key]

    found = self_exclusions.find_exclusions(made, touch, touching_share)
    some = Poses(at.rotation[:SAMPLES], at.position[:SAMPLES])
    listed = [(names[a], names[b], rule, share) for a, b, rule, share in found]
    return CheckedArm(arm, listed, _shares(near, meshes, LinkMeshes.convex(arm), some), some)


def _shares(near: _Masks, meshes: LinkMeshes, pieces: LinkMeshes, at: Poses) -> ClearShares:
    """Measure the pieces where capsules overlap, and the meshes where pieces do."""

    def overlapping(held: LinkMeshes, masks: _Masks) -> _Masks:
        return {
            pair: np.array([bool(is_near and held.overlap(*pair, at, k)) for k, is_near in enumerate(mask)])
            for pair, mask in masks.items()
        }

    by_pieces = overlapping(pieces, near)
    return ClearShares(by_pieces, overlapping(meshes, by_pieces), len(at.position))


def _closer(found: CheckedArm) -> ImportedArm | None:
    """Return the arm with the pieces cut that make the difference; None if no cut helps."""
    arm, pairs = found.arm, [(each.first, each.second) for each in found.shares.differing]
    body = {name: b for b, cover in arm.covers.items() for name in cover.pieces}
    names = [name for name in dict.fromkeys(name for pair in pairs for name in pair) if name in body]
    lost = {pair: np.flatnonzero(mask) for pair, mask in found.shares.lost().items() if pair in pairs}
    points = _shared_points(arm, body, names, lost, found._at)
    if not len(points.weight):
        return None
    parts = cut_apart({name: arm.covers[body[name]].pieces[name] for name in names}, points)
    given = {name for cover in arm.covers.values() for name in (*cover.own, *cover.pieces)}
    covers = dict(arm.covers)
    for b in dict.fromkeys(body[name] for name in parts):
        own = {}
        for name, piece in covers[b].pieces.items():
            first, *others = parts.get(name, [piece])
            own |= {name: first} | {new_name(body_name(arm.model, b), given): part for part in others}
        covers[b] = covers[b].with_pieces(own)
    return arm._replace(covers=covers) if parts else None


def _shared_points(
    arm: ImportedArm, body: Mapping[str, int], names: list[str], lost: Mapping[_Pair, np.ndarray], at: Poses
) -> SharedPoints:
    """Return points in the hulls of both pieces of the pairs, in configurations with the given rows of `at`.

    Pairs with a capsule of the model are left out.
    """
    hulls = {name: arm.covers[body[name]].hulls[name].vertices for name in names}
    drawn = {name: drawn_points(vertices) for name, vertices in hulls.items()}
    index, found = [], []
    for pair, rows in lost.items():
        for k in rows[:: max(1, len(rows) // MOST_LOST)] if set(pair) <= hulls.keys() else ():
            R, t = at.rotation[k], at.position[k]
            a, b = (body[name] for name in pair)
            from_first = np.stack([drawn[pair[0]], (drawn[pair[0]] @ R[a].T + t[a] - t[b]) @ R[b]])
            from_second = np.stack([(drawn[pair[1]] @ R[b].T + t[b] - t[a]) @ R[a], drawn[pair[1]]])
            both = np.concatenate([from_first, from_second], axis=1)
            both = both[:, in_hull(hulls[pair[0]], both[0]) & in_hull(hulls[pair[1]], both[1])]
            both = both[:, :: max(1, both.shape[1] // KEPT)]
            index.append(np.tile([[names.index(name)] for name in pair], both.shape[1]))
            found.append(both)
    if not found:
        return SharedPoints(np.empty((2, 0), int), np.empty((2, 0, 3)), np.empty(0))
    weights = [np.full(each.shape[1], 1 / max(1, each.shape[1])) for each in found]
    return SharedPoints(*(np.concatenate(each, axis=1) for each in (index, found)), np.concatenate(weights))
