"""Joining two configurations of an arm by a joint path that is proven clear, for many pairs at once.

The task is not enforced: the TCP may be anywhere. The path has the clearance `Scenario.transfer_margin_m`, less near
its ends (`clearance.proof.margin`). If none is found, SHARES of this clearance are tried, and finally D > 0. For each
pair two trees of configurations grow, one from each end,
until they meet:

    straight   prove the straight joint path between the ends; if this succeeds, the search is done
    grow       extend the smaller tree from random nodes in random directions, step by step while steps are proven
    meet       extend the other tree from its nearest node towards the end of each new branch, in the same way
    shorten    replace parts of the path found by straight joint paths between random points on it

These are expansive trees (Hsu, Latombe and Motwani, 1997), joined as in RRT-Connect (Kuffner and LaValle, 2000).
Samples are drawn around the tree instead of in the complete joint range, and only the smaller, more confined tree
grows. For configurations inside a part this joins more pairs than RRT-Connect, with far fewer proofs.

A search is a generator: it yields straight joint paths, and receives True for each path that is proven clear. The
queries of all searches go to the device in one batch. Searches are independent, and their random numbers come from the
seed and the numbers of scenario and pair: a result does not depend on which pairs are joined together.
"""

from collections.abc import Callable, Generator
from dataclasses import replace
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof import margin, motion_proof
from htcp_jax.device import tables
from htcp_jax.model import Scenario
from htcp_jax.motion.collision_checker import CollisionChecker, free_tubes
from htcp_jax.motion.configurations import NO_PARENT, Tree
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus

IN_FLIGHT = 4  # the number of pairs joined together is the number of lanes / IN_FLIGHT
DRAWS = 16  # number of samples per round, and of shortcuts per round
LONGEST_RAD, SHORTEST_RAD = 4.0, 0.125  # range of sampled lengths, log-uniform
FINEST_RAD = 0.02  # finest subdivision of a shortcut's proof
LEAST_RAD = 1e-6  # minimum saving of a shortcut, which is more than rounding
SHARES = 1.0, 0.5, 0.2  # of the required clearance, tried one after the other
MARGIN_ROUNDS = 30  # maximum number of sampling rounds with each of these


class QueriedPaths(NamedTuple):
    """Straight joint paths from a to b that a search wants to be proven."""

    a: Float[np.ndarray, "m N"]  # [rad or m]
    b: Float[np.ndarray, "m N"]  # [rad or m]
    deepest: Int[np.ndarray, "m"]  # maximum number of halvings in each proof
    left: int = 0  # least number of further rounds of queries until the search ends with a path
    is_joined: bool = False  # True: the search will end with a path, after `left` further rounds


Joining = Generator[QueriedPaths, Bool[np.ndarray, "m"], Any]  # yields queries, receives True for proven paths
Limits = tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]


def join(
    checker: CollisionChecker,
    scenarios: Scenario,
    scenario: Int[np.ndarray, "n"],
    pair: Int[np.ndarray, "n"],
    a: Float[np.ndarray, "n N"],
    b: Float[np.ndarray, "n N"],
    settings: Settings,
    soonest: bool = False,
    report: Callable[[int], None] = lambda joined: None,
) -> list[Float[np.ndarray, "_ N"] | None]:
    """Return via points between the two configurations of each pair, without these configurations.

    Every straight joint path from a through the via points to b is proven clear, by as much as SHARES allow of the
    required clearance.

    Args:
        checker: Collision checker of the scene.
        scenarios: Stacked scenarios (numpy).
        scenario: Row of each pair's scenario.
        pair: Number of each pair within its scenario, 0 or more, which seeds the pair's random numbers.
        a: First configurations, within the joint limits [rad or m].
        b: Second configurations, within the joint limits [rad or m].
        settings: Settings of the search.
        soonest: True to join only one pair per scenario: the one joined in the fewest rounds of queries, the first of
            several. The other pairs are abandoned when they can no longer be that pair.
        report: Function that is called before each round of queries, with the number of scenarios that have a joined
            pair for the first time. An exception in it ends the search.

    Returns:
        The via points of each pair [rad or m]; an empty array if the straight joint path is clear. None if an end is
            not clear, if no path was found in `settings.search_rounds`, or if the pair was abandoned.
    """
    via_points: list[np.ndarray | None] = [None] * len(a)
    required = _required(checker, scenarios, scenario, a, b)
    few = replace(settings, search_rounds=min(settings.search_rounds, MARGIN_ROUNDS))
    tries = [(few, required.scaled(share)) for share in SHARES] if required is not None else []
    for own_settings, own in [*tries, (settings, None)]:
        joined = {scenario[k] for k, found in enumerate(via_points) if found is not None}
        left = [k for k, found in enumerate(via_points) if found is None and not (soonest and scenario[k] in joined)]
        if own is not None:
            left = [k for k in left if own.most_m[k] > 0]
        pairs = scenario[left], pair[left], a[left], b[left]
        rules = None if own is None else tables.gather(own, np.array(left, int))
        found = _joined(checker, scenarios, *pairs, own_settings, soonest, report, rules)
        for k, points in zip(left, found, strict=True):
            via_points[k] = points
    return via_points


def _required(
    checker: CollisionChecker, scenarios: Scenario, scenario: np.ndarray, a: np.ndarray, b: np.ndarray
) -> margin.Margin | None:
    """Return the required clearance on each pair's path; None if no pair needs more than D > 0."""
    most = scenarios.transfer_margin_m[scenario]
    if not (most > 0).any():
        return None
    inputs = lane_inputs(scenarios, scenario, np.zeros_like(scenario))
    ends = [checker.states(inputs, x) for x in (a, b)]
    tcp, clearance = (np.stack([getattr(end, name) for end in ends], axis=1) for name in ("tcp", "clearance"))
    return margin.falling_off(most, scenarios.transfer_falloff_m[scenario], tcp, clearance)


def _joined(
    checker: CollisionChecker,
    scenarios: Scenario,
    scenario: np.ndarray,
    pair: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    settings: Settings,
    soonest: bool,
    report: Callable[[int], None],
    required: margin.Margin | None,
) -> list[np.ndarray | None]:
    """Return via points for each pair, see `join`, with one required clearance; None: only D > 0."""
    via_points: list[np.ndarray | None] = [None] * len(a)
    waiting, limits = iter(range(len(a))), checker.executor.limits
    most = max(1, checker.executor.lanes // IN_FLIGHT)
    searches: dict[int, Joining] = {}
    answers: dict[int, np.ndarray] = {}
    rounds, best = [0] * len(a), {}  # best: scenario -> rounds and number of the pair joined in the fewest rounds

    def may_be_soonest(k: int, left: int) -> bool:
        return not soonest or (rounds[k] + left, k) <= best.get(scenario[k], (np.inf, k))

    while True:
        for k in islice(waiting, most - len(searches)):
            rng = np.random.default_rng([settings.seed, int(scenarios.number[scenario[k]]), int(pair[k])])
            searches[k] = _join_pair(a[k], b[k], limits, rng, settings)
        if not searches:
            chosen = {k for _, k in best.values()}
            return [found if k in chosen or not soonest else None for k, found in enumerate(via_points)]
        queries, known = dict[int, QueriedPaths](), len(best)
        for k, search in searches.items():
            try:
                queries[k] = paths = search.send(answers.get(k))
                rounds[k], left, is_joined = rounds[k] + 1, paths.left, paths.is_joined
            except StopIteration as end:
                via_points[k], left, is_joined = end.value, 0, end.value is not None
            if is_joined and may_be_soonest(k, left):
                best[scenario[k]] = rounds[k] + left, k
        report(len(best) - known)
        queries = {k: paths for k, paths in queries.items() if may_be_soonest(k, paths.left)}
        searches = {k: searches[k] for k in queries}
        answers = _answers(checker, scenarios, scenario, queries, required) if queries else {}


def _answers(
    checker: CollisionChecker,
    scenarios: Scenario,
    scenario: np.ndarray,
    queries: dict[int, QueriedPaths],
    required: margin.Margin | None,
) -> dict[int, np.ndarray]:
    """Return, for each search, True for the queried joint paths that are proven."""
    counts = [len(paths.a) for paths in queries.values()]
    own = np.repeat(scenario[list(queries)], counts)
    a, b, deepest = (np.concatenate([paths[k] for paths in queries.values()]) for k in range(3))
    inputs = lane_inputs(scenarios, own, np.zeros_like(own))
    tube = free_tubes(checker.task, inputs)
    if required is not None:
        tube = tube._replace(margin=tables.gather(required, np.repeat(list(queries), counts)))
    clear = checker.edges(inputs, a, b, tube, deepest=deepest).verdict == SegmentStatus.VALID
    for end in (a, b):
        clear = checker.tip_free(inputs, end, clear)
    return dict(zip(queries, np.split(clear, np.cumsum(counts)[:-1]), strict=True))


def _join_pair(a: np.ndarray, b: np.ndarray, limits: Limits, rng: np.random.Generator, settings: Settings) -> Joining:
    """Join one pair, and return its via points or None, see `join`."""
    ends_clear = yield _full_queries(np.stack([a, b]), np.stack([a, b]))
    if not ends_clear.all():
        return None
    if (yield _full_queries(a[None], b[None])).all():
        return a[:0].reshape(0, len(a))
    path = yield from _grow_trees(a, b, limits, rng, settings)
    return None if path is None else (yield from _shorten(path, rng, settings.search_shortcuts))[1:-1]


class _Nodes(NamedTuple):
    """Nodes of a tree."""

    x: Float[np.ndarray, "n N"]  # configurations [rad or m]
    parent: Int[np.ndarray, "n"]  # row of each node's parent


class _JointTree(Tree):
    """Tree of configurations connected to a root by proven steps: away from the root, or towards it if `backwards`."""

    def __init__(self, root: Float[np.ndarray, "N"], backwards: bool):
        super().__init__(_Nodes(root[None], np.array([NO_PARENT])))
        self.backwards = backwards

    @property
    def x(self) -> Float[np.ndarray, "n N"]:
        """The configurations [rad or m]."""
        return self._table.x[: self._count]

    def nearest(self, x: Float[np.ndarray, "m N"]) -> Int[np.ndarray, "m"]:
        """Return the node nearest to each configuration; the first of several equally near ones."""
        apart = self.x[None] - x[:, None]
        return np.argmin((apart * apart).sum(axis=2), axis=1)

    def path_to(self, node: int) -> Float[np.ndarray, "k N"]:
        """Return the configurations from the root to a node; in a `backwards` tree, from the node to the root."""
        path = self.path(node)
        return self.x[path[::-1] if self.backwards else path]

    def extend(self, node: Int[np.ndarray, "m"], goal: Float[np.ndarray, "m N"], step: float, left: int = 0) -> Joining:
        """Extend each node towards its goal, step by step while steps are proven; return the last nodes."""
        node, branches = node.copy(), np.arange(len(node))
        while len(branches):
            x, to = self.x[node[branches]], goal[branches]
            distance = np.linalg.norm(to - x, axis=1)
            next_x = _interpolated(x, to, np.minimum(1.0, step / np.maximum(distance, step)))
            clear = yield (_full_queries(next_x, x, left) if self.backwards else _full_queries(x, next_x, left))
            node[branches[clear]] = self.add(_Nodes(next_x[clear], node[branches[clear]]))
            branches = branches[clear & (distance > step)]
        return node


def _grow_trees(a: np.ndarray, b: np.ndarray, limits: Limits, rng: np.random.Generator, settings: Settings) -> Joining:
    """Return a path of proven steps from a to b; None if no path is found in the maximum number of rounds."""
    trees, step, left = (_JointTree(a, False), _JointTree(b, True)), settings.search_step_rad, settings.search_shortcuts
    for _ in range(settings.search_rounds):
        small, other = sorted(trees, key=len)
        node = rng.integers(len(small), size=DRAWS)
        ends = yield from small.extend(node, _sampled_goals(small.x[node], limits, rng), step, left)
        ends = ends[ends != node]
        goals = small.x[ends]
        meet = yield from other.extend(other.nearest(goals), goals, step, left)
        met = np.flatnonzero((other.x[meet] == goals).all(axis=1))
        if len(met):
            paths = {tree.backwards: tree.path_to(int(nodes[met[0]])) for tree, nodes in ((small, ends), (other, meet))}
            return np.concatenate([paths[False], paths[True][1:]])
    return None


def _sampled_goals(x: np.ndarray, limits: Limits, rng: np.random.Generator) -> np.ndarray:
    """Return a random goal for each configuration: in a random direction, at a random distance, within the limits."""
    directions = rng.standard_normal(x.shape)
    lengths = LONGEST_RAD * (SHORTEST_RAD / LONGEST_RAD) ** rng.random((len(x), 1))
    return np.clip(x + directions * (lengths / np.linalg.norm(directions, axis=1, keepdims=True)), *limits)


def _shorten(path: np.ndarray, rng: np.random.Generator, rounds: int) -> Joining:
    """Return the path shortened by straight joint paths; each round takes the shortcut that saves most."""
    for left in reversed(range(rounds)):
        cuts = np.sort(rng.random((DRAWS, 2)) * (len(path) - 1), axis=1)
        cuts[::2] = np.rint(cuts[::2])  # from via point to via point, which reduces the number of via points
        before, after = np.floor(cuts[:, 0]).astype(int), np.ceil(cuts[:, 1]).astype(int)
        p, q = (_configurations_at(path, cut) for cut in cuts.T)
        legs = np.stack([path[before], p, q, path[after]], axis=1)
        clear = yield _shallow_queries(*(part.reshape(-1, path.shape[1]) for part in (legs[:, :-1], legs[:, 1:])), left)
        travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        length = np.linalg.norm(np.diff(legs, axis=1), axis=2).sum(axis=1)
        saved = np.where(clear.reshape(DRAWS, 3).all(axis=1), travelled[after] - travelled[before] - length, 0.0)
        if saved[best := int(np.argmax(saved))] > LEAST_RAD:
            path = np.concatenate([path[: before[best]], legs[best], path[after[best] + 1 :]])
            path = path[np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))]
    return path


def _full_queries(a: np.ndarray, b: np.ndarray, left: int = 0) -> QueriedPaths:
    return QueriedPaths(a, b, np.full(len(a), motion_proof.DEEPEST, np.int32), left)


def _shallow_queries(a: np.ndarray, b: np.ndarray, left: int) -> QueriedPaths:
    """Return a joined search's queries with few halvings per proof, as shortcuts that graze walls are not wanted."""
    parts = np.linalg.norm(b - a, axis=1) / FINEST_RAD
    deepest = np.clip(np.ceil(np.log2(np.maximum(parts, 1.0))), 0, motion_proof.DEEPEST).astype(np.int32)
    return QueriedPaths(a, b, deepest, left, is_joined=True)


def _configurations_at(path: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return configurations at places on a path: a via point's number plus the fraction of the way to the next one."""
    via_point = np.minimum(place.astype(int), len(path) - 2)
    return _interpolated(path[via_point], path[via_point + 1], place - via_point)


def _interpolated(a: np.ndarray, b: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Interpolate from a to b by a fraction: the result is exactly b for 1, and between a and b despite rounding."""
    x = np.clip(a + part[:, None] * (b - a), np.minimum(a, b), np.maximum(a, b))
    return np.where(part[:, None] == 1, b, x)
