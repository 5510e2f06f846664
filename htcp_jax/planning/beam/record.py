"""Results of an ended beam search: the path to its best leaf, and the motion from the start to the path's root."""

from itertools import pairwise

import numpy as np

from htcp_jax.device import tables
from htcp_jax.motion import CollisionChecker, Plans, Problem, transfers
from htcp_jax.planning.beam.searches import NONE, Searches
from htcp_jax.planning.beam.tree import Nodes
from htcp_jax.status import Status

TRANSFERRED = 1  # `Plans.recovery` of a first target that is reached by a transfer
ViaPointRow = tuple[int, int, np.ndarray]  # via points of a segment: (scenario, target, configurations)


class BeamRecord:
    """Writer of search results into plans."""

    def __init__(self, problem: Problem, plans: Plans, checker: CollisionChecker, searches: Searches):
        self._problem, self._plans, self._checker = problem, plans, checker
        self._searches, self._tree = searches, searches.tree

    def chosen(self, last: int) -> tuple[int, int, np.ndarray | None]:
        """Return the result of a scenario whose last search has ended.

        Returns:
            The search that reached the farthest target, the tree row of its best leaf, and the via points of the
                transfer to the path's root (V, N) [rad or m]; None if there is no transfer.
        """
        searches, scenarios = self._searches, self._problem.scenarios
        s, chain = int(searches.columns.scenario[last]), searches.chain(last)
        forwards = [one for one in chain[::-1] if searches.columns.step[one] > 0]
        for search in sorted(forwards, key=lambda one: -searches.columns.target[one]):
            leaves = searches.beam_of(search)
            if search == chain[-1] or self._problem.begins_anywhere[s]:
                return search, leaves[0], None
            roots = dict(zip(leaves, self._tree.roots(np.array(leaves)).tolist(), strict=True))
            if self._tree.target[roots[leaves[0]]] < 0:
                return search, leaves[0], None
            start = self._tree.x[self._row_0(chain[-1])] if self._is_approach(search) else scenarios.x_start[s]
            distinct = list(dict.fromkeys(roots.values()))
            via_points = transfers.joined(self._problem, self._checker, s, start, self._tree.x[distinct])
            known = {root: row for root, row in zip(distinct, via_points, strict=False) if row is not None}
            if found := [leaf for leaf in leaves if roots[leaf] in known]:
                return search, found[0], known[roots[found[0]]]
        raise AssertionError("the first search begins at the start, so there is no transfer to it")

    def write(self, search: int, leaf: int, transfer: np.ndarray | None) -> list[ViaPointRow]:
        """Record the path to a leaf, and the search's status.

        Args:
            search: Number of the search.
            leaf: Tree row at the end of the path.
            transfer: Via points of the transfer to the path's root (V, N) [rad or m]; None: no transfer.

        Returns:
            Via points of the path's segments.
        """
        columns, plans, path = self._searches.columns, self._plans, self._tree.path(leaf)
        s, nodes = int(columns.scenario[search]), self._tree.nodes(path)
        via_points, extended = [], np.flatnonzero(~nodes.by_self_motion)
        for before, row in pairwise(extended.tolist()):
            plans.joint_step[s, nodes.target[row]] = np.linalg.norm(nodes.at.x[row] - nodes.at.x[before])
            if row > before + 1:
                via_points.append((s, int(nodes.target[row]), nodes.at.x[before + 1 : row]))
        self._write_rows(s, nodes.target[extended], tables.gather(nodes, extended))
        if self._problem.begins_anywhere[s]:
            plans.start[s], plans.joint_step[s, 0] = plans.x[s, 0], 0.0
        if transfer is not None:
            via_points.append((s, self._write_joined(search, int(path[0])), transfer))
        if columns.status[search] != NONE:
            plans.status[s, columns.target[search] + 1] = columns.status[search]
        return via_points

    def _is_approach(self, search: int) -> bool:
        """Return True if the search begins at the path's first point instead of the first target."""
        return bool(self._searches.columns.earlier[search] != NONE and self._searches.columns.root[search] > 0)

    def _row_0(self, first: int) -> int:
        """Return the tree row at the first target on the best path of search `first`."""
        path = self._tree.path(self._searches.beam_of(first)[0])
        nodes = self._tree.nodes(path)
        return int(path[(nodes.target == 0) & ~nodes.by_self_motion][0])

    def _write_rows(self, s: int, target: np.ndarray, nodes: Nodes) -> None:
        """Write each node into the plans, at its target; starts are not written."""
        plans, (target, nodes) = self._plans, tables.gather((target, nodes), target >= 0)
        plans.x[s, target], plans.tcp[s, target] = nodes.at.x, nodes.at.tcp
        plans.clearance[s, target], plans.residual[s, target] = nodes.at.clearance, nodes.at.residual
        plans.status[s, target], plans.iterations[s, target] = Status.TRACKED, nodes.step_qps
        plans.path_clear[s, target] = 1

    def _write_joined(self, search: int, root: int) -> int:
        """Record the motion from the start to the root of a search; return the target at its end.

        An approach does not follow its lines: all of its targets except the first are replaced by the path's first
        point.
        """
        s, plans, x = int(self._searches.columns.scenario[search]), self._plans, self._tree.x
        if not self._is_approach(search):
            plans.joint_step[s, 0] = np.linalg.norm(x[root] - plans.start[s])
            plans.status[s, 0], plans.recovery[s, 0] = Status.TRACKED_AFTER_RECOVERY, TRANSFERRED
            return 0
        on_path, row_0 = int(self._problem.scenarios.on_path[s]), self._row_0(self._searches.chain(search)[-1])
        plans.target[s, 1:on_path] = plans.target[s, on_path]
        stays = np.arange(1, on_path)
        self._write_rows(s, stays, self._tree.nodes(np.full(len(stays), root)))
        self._write_rows(s, np.zeros(1, int), self._tree.nodes(np.array([row_0])))
        plans.joint_step[s, 0] = np.linalg.norm(x[row_0] - plans.start[s])
        plans.joint_step[s, 1] = np.linalg.norm(x[root] - x[row_0])
        plans.joint_step[s, 2 : on_path + 1] = 0.0
        return 1
