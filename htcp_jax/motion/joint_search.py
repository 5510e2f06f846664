"""Joining two postures of an arm by a joint path that is proven clear all along, for many pairs at once.

No task is held: the TCP may be anywhere. Per pair two trees of postures grow, one from either end, until they meet:

    straight   the joint path from end to end; where it is proven, nothing is left to do
    grow       the smaller tree: from random postures of it in random directions, a step at a time, as far as is proven
    meet       from the other tree's nearest posture towards each end of what has grown, the same way
    shorten    what was found, by straight joint paths between random places of it

These are expansive trees (Hsu, Latombe and Motwani, 1997), joined as RRT-Connect joins its own (Kuffner and LaValle,
2000). The draws stand about the tree and not all over the joint range, and the smaller tree, which is the one that is
confined, has them all: of postures inside a part that joins more than RRT-Connect does, with far fewer proofs.

A search is a generator: it asks which straight joint paths are clear, and is told. It knows nothing of other searches,
and its random numbers come from the seed and from the numbers of its scenario and pair, so what it finds does not
depend on which pairs are joined together. Whatever all of them ask at a time goes to the device in one batch.
"""

from collections.abc import Generator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof.motion_proof import DEEPEST
from htcp_jax.device.programs import Kernels
from htcp_jax.device.tables import gather
from htcp_jax.model.scenario import Scenario
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.posture_tree import NO_PARENT, Tree
from htcp_jax.motion.proofs import clear_paths
from htcp_jax.motion.tip_check import TipCheck
from htcp_jax.settings import Settings

IN_FLIGHT = 4  # pairs are joined together, a quarter as many as a table has lanes
DRAWS = 16  # of a round; and shortcuts of one
LONGEST_RAD, SHORTEST_RAD = 4.0, 0.125  # of draws, whose lengths are spread evenly over their orders of magnitude
FINEST_RAD = 0.02  # parts of a shortcut that its proof may look at
LEAST_RAD = 1e-6  # that a shortcut has to save; more than rounding


class JointPaths(NamedTuple):
    """Straight joint paths that a search asks about."""

    a: Float[np.ndarray, "m N"]  # [rad or m]
    b: Float[np.ndarray, "m N"]
    deepest: Int[np.ndarray, "m"]  # how often their proof may halve them


Joining = Generator[JointPaths, Bool[np.ndarray, "m"], Any]  # asks, and is sent which of them are proven
Limits = tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]


def join(
    kernels: Kernels,
    tip: TipCheck | None,
    scenarios: Scenario,
    scenario: Int[np.ndarray, "n"],
    pair: Int[np.ndarray, "n"],
    a: Float[np.ndarray, "n N"],
    b: Float[np.ndarray, "n N"],
    settings: Settings,
    soonest: bool = False,
) -> list[Float[np.ndarray, "_ N"] | None]:
    """For each pair of postures the knots strictly between them, such that every straight joint path from a over the
    knots to b is proven clear; none where the straight joint path is. None where an end is not clear, or where nothing
    was found in `settings.search_rounds`.

    scenario: each pair's, by its row in `scenarios` (stacked, numpy). pair: its number within the scenario, 0 or more;
    random numbers are drawn by it. a, b: within the joint limits [rad or m]. tip: the tool's bare tip keeps out of the
    walls, too, as far as samples tell.
    soonest: of each scenario's pairs only that one is wanted for which least has to be asked, the first of equals; the
    others are given up.
    """
    found: list[np.ndarray | None] = [None] * len(a)
    waiting, most, limits = iter(range(len(a))), max(1, kernels.lanes // IN_FLIGHT), kernels.limits
    going: dict[int, Joining] = {}
    told: dict[int, np.ndarray] = {}
    asks, best = [0] * len(a), {}

    def wanted(k: int) -> bool:
        return not soonest or (asks[k], k) < best.get(scenario[k], (np.inf, k))

    while True:
        for k in islice(waiting, most - len(going)):
            rng = np.random.default_rng([settings.seed, int(scenarios.number[scenario[k]]), int(pair[k])])
            going[k] = _joined(a[k], b[k], limits, rng, settings)
        if not going:
            return found
        asked: dict[int, JointPaths] = {}
        for k, search in going.items():
            try:
                asked[k] = search.send(told.get(k))
                asks[k] += 1
            except StopIteration as end:
                if end.value is not None and wanted(k):
                    if soonest and scenario[k] in best:
                        found[best[scenario[k]][1]] = None
                    found[k], best[scenario[k]] = end.value, (asks[k], k)
        asked = {k: paths for k, paths in asked.items() if wanted(k)}
        going = {k: going[k] for k in asked}
        told = _told(kernels, tip, scenarios, scenario, asked) if asked else {}


def _told(
    kernels: Kernels, tip: TipCheck | None, scenarios: Scenario, scenario: np.ndarray, asked: dict[int, JointPaths]
) -> dict[int, np.ndarray]:
    """Which of the joint paths that each search asks about are proven."""
    counts = [len(paths.a) for paths in asked.values()]
    own = np.repeat(scenario[list(asked)], counts)
    a, b, deepest = (np.concatenate(column) for column in zip(*asked.values(), strict=True))
    inputs = lane_inputs(scenarios, own, np.zeros_like(own))
    clear = clear_paths(kernels, inputs, a, b, deepest=deepest)
    if tip is not None and clear.any():
        pick = gather((inputs, a, b), clear)
        clear[clear] = ~(tip.at(*pick[:2]) | tip.at(pick[0], pick[2]) | tip.along(*pick))
    return dict(zip(asked, np.split(clear, np.cumsum(counts)[:-1]), strict=True))


def _joined(a: np.ndarray, b: np.ndarray, limits: Limits, rng: np.random.Generator, settings: Settings) -> Joining:
    """One pair; returns what `join` does."""
    ends_clear = yield _steps(np.stack([a, b]), np.stack([a, b]))
    if not ends_clear.all():
        return None
    if (yield _steps(a[None], b[None])).all():
        return a[:0].reshape(0, len(a))
    way = yield from _grown(a, b, limits, rng, settings)
    return None if way is None else (yield from _shortened(way, rng, settings.search_shortcuts))[1:-1]


class _Nodes(NamedTuple):
    """Configurations, and the row of each one's parent."""

    x: Float[np.ndarray, "n N"]
    parent: Int[np.ndarray, "n"]


class _JointTree(Tree):
    """Postures connected to a root by proven steps, which lead away from it; or, to be walked backwards, towards it."""

    def __init__(self, root: Float[np.ndarray, "N"], backwards: bool):
        super().__init__(_Nodes(root[None], np.array([NO_PARENT])))
        self.backwards = backwards

    @property
    def x(self) -> Float[np.ndarray, "n N"]:
        """The configurations [rad or m]."""
        return self._table.x[: self._count]

    def nearest(self, x: Float[np.ndarray, "m N"]) -> Int[np.ndarray, "m"]:
        """To each of some postures; of equals the first."""
        apart = self.x[None] - x[:, None]
        return np.argmin((apart * apart).sum(axis=2), axis=1)

    def way(self, node: int) -> Float[np.ndarray, "k N"]:
        """The postures from the root to a node; backwards, from the node to the root."""
        path = self.path(node)
        return self.x[path[::-1] if self.backwards else path]

    def extend(self, node: Int[np.ndarray, "m"], goal: Float[np.ndarray, "m N"], step: float) -> Joining:
        """From each node straight towards its goal, as far as steps are proven; returns the nodes where that ends."""
        node, going = node.copy(), np.arange(len(node))
        while len(going):
            x, to = self.x[node[going]], goal[going]
            left = np.linalg.norm(to - x, axis=1)
            there = _between(x, to, np.minimum(1.0, step / np.maximum(left, step)))
            clear = yield _steps(there, x) if self.backwards else _steps(x, there)
            node[going[clear]] = self.add(_Nodes(there[clear], node[going[clear]]))
            going = going[clear & (left > step)]
        return node


def _grown(a: np.ndarray, b: np.ndarray, limits: Limits, rng: np.random.Generator, settings: Settings) -> Joining:
    """A way from a to b, step by step; None where the rounds are spent."""
    trees, step = (_JointTree(a, False), _JointTree(b, True)), settings.search_step_rad
    for _ in range(settings.search_rounds):
        small, other = sorted(trees, key=len)
        node = rng.integers(len(small), size=DRAWS)
        ends = yield from small.extend(node, _drawn(small.x[node], limits, rng), step)
        ends = ends[ends != node]
        goals = small.x[ends]
        meet = yield from other.extend(other.nearest(goals), goals, step)
        met = np.flatnonzero((other.x[meet] == goals).all(axis=1))
        if len(met):
            ways = {tree.backwards: tree.way(int(nodes[met[0]])) for tree, nodes in ((small, ends), (other, meet))}
            return np.concatenate([ways[False], ways[True][1:]])
    return None


def _drawn(x: np.ndarray, limits: Limits, rng: np.random.Generator) -> np.ndarray:
    """From each posture in a random direction, near or far, within the limits."""
    directions = rng.standard_normal(x.shape)
    lengths = LONGEST_RAD * (SHORTEST_RAD / LONGEST_RAD) ** rng.random((len(x), 1))
    return np.clip(x + directions * (lengths / np.linalg.norm(directions, axis=1, keepdims=True)), *limits)


def _shortened(way: np.ndarray, rng: np.random.Generator, rounds: int) -> Joining:
    """The way, with straight joint paths in place of parts of it: of each round's the one that saves most."""
    for _ in range(rounds):
        cuts = np.sort(rng.random((DRAWS, 2)) * (len(way) - 1), axis=1)
        cuts[::2] = np.rint(cuts[::2])  # from knot to knot, so that there are fewer of them
        before, after = np.floor(cuts[:, 0]).astype(int), np.ceil(cuts[:, 1]).astype(int)
        p, q = (_at(way, cut) for cut in cuts.T)
        legs = np.stack([way[before], p, q, way[after]], axis=1)
        clear = yield _cuts(*(part.reshape(-1, way.shape[1]) for part in (legs[:, :-1], legs[:, 1:])))
        walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
        length = np.linalg.norm(np.diff(legs, axis=1), axis=2).sum(axis=1)
        saved = np.where(clear.reshape(DRAWS, 3).all(axis=1), walked[after] - walked[before] - length, 0.0)
        if saved[best := int(np.argmax(saved))] > LEAST_RAD:
            way = np.concatenate([way[: before[best]], legs[best], way[after[best] + 1 :]])
            way = way[np.append(True, (np.diff(way, axis=0) != 0).any(axis=1))]
    return way


def _steps(a: np.ndarray, b: np.ndarray) -> JointPaths:
    return JointPaths(a, b, np.full(len(a), DEEPEST, np.int32))


def _cuts(a: np.ndarray, b: np.ndarray) -> JointPaths:
    """To be proven at little cost: the shortest way grazes the walls, and is not wanted."""
    parts = np.linalg.norm(b - a, axis=1) / FINEST_RAD
    return JointPaths(a, b, np.clip(np.ceil(np.log2(np.maximum(parts, 1.0))), 0, DEEPEST).astype(np.int32))


def _at(way: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Postures of a way; a place is the number of a knot, and a part of the way to the next one."""
    knot = np.minimum(place.astype(int), len(way) - 2)
    return _between(way[knot], way[knot + 1], place - knot)


def _between(a: np.ndarray, b: np.ndarray, part: np.ndarray) -> np.ndarray:
    """That part of the way from each a to its b; never outside of both, and exactly b for 1."""
    x = np.clip(a + part[:, None] * (b - a), np.minimum(a, b), np.maximum(a, b))
    return np.where(part[:, None] == 1, b, x)
