"""Tree of a beam search: configurations that are clear and on target, each connected to a root by proven motions.

Its tables have one row per node.

`JointSteps` limits the travel of each joint between two targets of the path's file. The limit applies to the sum over a
segment, including the goals inserted on it and self-motions at these goals. Self-motions at a target belong to the
segment that begins at this target.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import tables
from htcp_jax.model import Scenario
from htcp_jax.motion import configurations, step_functions

LEAST = 4096  # minimum rows of a table
ROUNDING = 1e-12  # tolerance of sums, relative to a limit


class Nodes(NamedTuple):
    """Configurations, and the motion to each configuration from its parent."""

    at: step_functions.State
    target: Int[np.ndarray, "n"]
    parent: Int[np.ndarray, "n"]  # row of the parent; configurations.NO_PARENT for a root
    by_self_motion: Bool[np.ndarray, "n"]  # True: reached by self-motion at its target; False: extended to its target
    step_qps: Int[np.ndarray, "n"]  # number of step QPs solved for the configuration
    dwells: Int[np.ndarray, "n"]  # number of changes of configuration on the path from the root
    cost: Float[np.ndarray, "n"]  # cost (3) of the path from the root: the sum of |x_{t+1} - x_t|^2 [rad2]


class BeamTree(configurations.Tree):
    """All configurations of some searches, as a tree.

    Configurations without descendants in a beam are removed from time to time.
    """

    def __init__(self, joints: int):
        names = {"x": (joints,), "clearance": (), "residual": (), "tcp": (3,)}
        at = step_functions.State(**{name: np.empty((LEAST, *shape)) for name, shape in names.items()})
        whole = (np.empty(LEAST, kind) for kind in (np.int32, np.int64, bool, np.int32, np.int32))
        super().__init__(Nodes(at, *whole, np.empty(LEAST)))
        self._count, self._kept = 0, LEAST

    @property
    def x(self) -> Float[np.ndarray, "n N"]:
        """Configurations [rad or m]."""
        return self._table.at.x[: self._count]

    @property
    def clearance(self) -> Float[np.ndarray, "n"]:
        """Clearance D of each configuration [m]; NaN if it was not measured."""
        return self._table.at.clearance[: self._count]

    @property
    def target(self) -> Int[np.ndarray, "n"]:
        """Target of each configuration."""
        return self._table.target[: self._count]

    def nodes(self, rows: Int[np.ndarray, "m"]) -> Nodes:
        """Return the nodes with the given rows."""
        return tables.gather(self._table, rows)

    def plant(self, at: step_functions.State, target: int | Int[np.ndarray, "m"]) -> Int[np.ndarray, "m"]:
        """Add roots at a target; return the rows of the new nodes."""
        none = np.full(len(at.x), configurations.NO_PARENT)
        return self.add(Nodes(at, none * 0 + target, none, none > 0, none * 0, none * 0, np.zeros(len(none))))

    def grow(
        self,
        parent: Int[np.ndarray, "m"],
        at: step_functions.State,
        target,
        step_qps=0,
        by_self_motion: bool = False,
        dwells=0,
    ) -> Int[np.ndarray, "m"]:
        """Add a child to each parent; return the rows of the children.

        Args:
            parent: Rows of the parents.
            at: The children, with `x` [rad or m].
            target (int or array): Index of the children's target.
            step_qps (int or array): Number of step QPs solved for each child.
            by_self_motion: See `Nodes`.
            dwells (int or array): Number of changes of configuration that begin on the motion from the parent.
        """
        step, zero = at.x - self.x[parent], np.zeros_like(parent)
        dwells = self._table.dwells[parent] + dwells
        cost = self._table.cost[parent] + (step * step).sum(axis=1)
        return self.add(
            Nodes(at, zero + target, parent, np.full(len(parent), by_self_motion), zero + step_qps, dwells, cost)
        )

    def grow_path(
        self,
        parent: int,
        at: step_functions.State,
        target: Int[np.ndarray, "m"],
        step_qps: Int[np.ndarray, "m"],
        by_self_motion: Bool[np.ndarray, "m"],
        dwells: Int[np.ndarray, "m"],
    ) -> int:
        """Add a path of m nodes to a parent, each the child of the one before; return the row of the last one.

        Args:
            parent: Row of the parent; `configurations.NO_PARENT`: the first node is a root.
            at: The nodes, with `x` [rad or m].
            target: Index of each node's target.
            step_qps: Number of step QPs solved for each node.
            by_self_motion: See `Nodes`.
            dwells: Number of changes of configuration that begin on the motion to each node.
        """
        is_root = parent == configurations.NO_PARENT
        before = np.concatenate([at.x[:1] if is_root else self.x[[parent]], at.x[:-1]])
        step = at.x - before
        own = (step * step).sum(axis=1), dwells
        known = (0.0, 0) if is_root else (self._table.cost[parent], self._table.dwells[parent])
        cost, dwells = (np.cumsum(np.append(first, each))[1:] for first, each in zip(known, own, strict=True))
        parents = np.append(parent, self._count + np.arange(len(target) - 1))
        return int(self.add(Nodes(at, target, parents, by_self_motion, step_qps, dwells, cost))[-1])

    @property
    def is_overgrown(self) -> bool:
        """True if there are more than twice as many nodes as after the last pruning."""
        return self._count > 2 * self._kept

    def with_ancestors(
        self, rows: Int[np.ndarray, "m"], owner: Int[np.ndarray, "m"]
    ) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "k"]]:
        """Return the rows of some nodes and of all their ancestors, in ascending order, and the owner of each row.

        Args:
            rows: The nodes.
            owner: Number of each node's owner, 0 or more. Owners have no common ancestors.
        """
        owners, parent = np.full(self._count, -1), self._table.parent
        while len(rows):
            owners[rows] = owner
            above = parent[rows]
            new = (above != configurations.NO_PARENT) & (owners[above] < 0)
            rows, first = np.unique(above[new], return_index=True)
            owner = owner[new][first]
        found = np.flatnonzero(owners >= 0)
        return found, owners[found]

    def roots(self, rows: Int[np.ndarray, "m"]) -> Int[np.ndarray, "m"]:
        """Return the row of the root of each node."""
        while ((above := self._table.parent[rows]) != configurations.NO_PARENT).any():
            rows = np.where(above == configurations.NO_PARENT, rows, above)
        return rows

    def prune(self, rows: Int[np.ndarray, "m"]) -> Int[np.ndarray, "n"]:
        """Remove all nodes except those in `rows` and their ancestors; return the new row of each old row."""
        (kept_rows, _), moved = self.with_ancestors(rows, np.zeros_like(rows)), np.full(self._count, -1)
        moved[kept_rows] = np.arange(len(kept_rows))
        kept = tables.gather(self._table, kept_rows)
        kept.parent[:] = np.where(kept.parent == configurations.NO_PARENT, configurations.NO_PARENT, moved[kept.parent])
        self._table, self._count = kept, len(kept.parent)
        self._kept = max(LEAST, self._count)
        return moved


def best_first(nodes: Nodes, search: Int[np.ndarray, "n"] | int = 0) -> Int[np.ndarray, "n"]:
    """Return the indices of nodes sorted by search, then number of dwells, then cost; the sort is stable."""
    return np.lexsort((nodes.cost, nodes.dwells, np.broadcast_to(search, nodes.cost.shape)))


class JointSteps(NamedTuple):
    """Limits on joint travel for S scenarios, one row per target or inserted goal.

    The additional last row is for self-motions at the last target.
    """

    segment: Int[np.ndarray, "S R1"]  # target of the file at the end of each row's segment
    most: Float[np.ndarray, "S R1 N"]  # maximum travel of each joint on this segment [rad or m]

    @classmethod
    def of(cls, scenarios: Scenario) -> "JointSteps | None":
        """Return the limits of stacked scenarios; None if their joint steps are unlimited."""
        if (most := scenarios.max_joint_step) is None:
            return None
        segment = np.append(scenarios.segments, scenarios.segments[:, -1:] + 1, axis=1)
        return cls(segment, np.append((1 - ROUNDING) * most, np.full_like(most[:, :1], np.inf), axis=1))

    def left(
        self, tree: BeamTree, nodes: Int[np.ndarray, "m"], scenario: Int[np.ndarray, "m"], row: Int[np.ndarray, "m"]
    ) -> Float[np.ndarray, "m N"]:
        """Return the remaining travel of each joint on a segment after the motion to a node [rad or m].

        Args:
            tree: The tree, of searches in either direction.
            nodes: Tree rows of the nodes.
            scenario: Row of each node's scenario.
            row: A row on the segment: the row of the node's target, or the next one.
        """
        left, own, which = self.most[scenario, row], self.segment[scenario, row], np.arange(len(nodes))
        while len(which):
            child = tree.nodes(nodes)
            which, child = tables.gather((which, child), child.parent != configurations.NO_PARENT)
            parent = tree.nodes(child.parent)
            here = self.segment[scenario[which], _row_of(child.target, parent.target)] == own[which]
            which, nodes, x, before = tables.gather((which, child.parent, child.at.x, parent.at.x), here)
            left[which] -= np.abs(x - before)
        return left

    def are_kept(self, scenario: int, path: Nodes) -> bool:
        """Return True if the motion along nodes, in the order of travel, satisfies all limits."""
        row = _row_of(path.target[1:], path.target[:-1])
        segment = self.segment[scenario, row]
        travel = np.zeros((self.segment[scenario].max() + 1, self.most.shape[2]))
        np.add.at(travel, segment, np.abs(np.diff(path.at.x, axis=0)))
        return bool(((1 - ROUNDING) * travel[segment] <= self.most[scenario, row]).all())


def _row_of(target: Int[np.ndarray, "m"], before: Int[np.ndarray, "m"]) -> Int[np.ndarray, "m"]:
    """Return the row of the motion between two targets: the larger target; the next row for a motion at one target."""
    return np.maximum(target, before) + (target == before)
