"""Results of an ended beam search: the path to its best leaf, and the motion from the start to the path's root."""

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

    def chosen(self, ended: list[int]) -> list[tuple[int, int, np.ndarray | None]]:
        """Return the results of scenarios whose last searches have ended.

        Returns:
            For each scenario the search that reached the farthest target, the tree row of its best leaf, and the via
                points of the transfer to the path's root (V, N) [rad or m]; None if there is no transfer.
        """
        found, open_ = {}, {last: iter(self._searches.forwards(last)) for last in ended}
        while open_:
            now = {last: next(searches) for last, searches in open_.items()}
            direct = {last: search for last, search in now.items() if not self._needs_transfer(search)}
            found |= {last: (search, self._searches.beam_of(search)[0], None) for last, search in direct.items()}
            found |= self._transferred({last: search for last, search in now.items() if last not in direct})
            open_ = {last: searches for last, searches in open_.items() if last not in found}
        return [found[last] for last in ended]

    def _needs_transfer(self, search: int) -> bool:
        """Return True if the motion must be joined to the roots of a search's beam."""
        searches = self._searches
        if searches.columns.earlier[search] == NONE or self._problem.begins_anywhere[searches.columns.scenario[search]]:
            return False
        return bool(self._tree.target[self._tree.roots(np.array(searches.beam_of(search)[:1]))[0]] >= 0)

    def _transferred(self, searches: dict[int, int]) -> dict[int, tuple[int, int, np.ndarray]]:
        """Return the results of searches whose beams are joined to the start, by the last search of their scenarios."""
        if not searches:
            return {}
        leaves = [self._searches.beam_of(search) for search in searches.values()]
        roots = [self._tree.roots(np.array(own)).tolist() for own in leaves]
        distinct = [list(dict.fromkeys(own)) for own in roots]
        scenario = self._searches.columns.scenario[list(searches.values())]
        start = self._problem.scenarios.x_start[scenario]
        for k, search in enumerate(searches.values()):
            if self._is_approach(search):
                start[k] = self._tree.x[self._row_0(self._searches.chain(search)[-1])]
        to = [self._tree.x[own] for own in distinct]
        found = {}
        joined = transfers.joined(self._problem, self._checker, scenario, start, to)
        for (last, search), own, at, rows, via in zip(searches.items(), leaves, roots, distinct, joined, strict=True):
            known = {root: points for root, points in zip(rows, via, strict=False) if points is not None}
            if reached := [(leaf, known[root]) for leaf, root in zip(own, at, strict=True) if root in known]:
                found[last] = search, *reached[0]
        return found

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
        extended = np.flatnonzero(~nodes.by_self_motion)
        step = np.diff(nodes.at.x[extended], axis=0)
        plans.joint_step[s, nodes.target[extended[1:]]] = np.sqrt(np.vecdot(step, step))
        turned = np.flatnonzero(np.diff(extended) > 1)
        via_points = [
            (s, int(nodes.target[row]), nodes.at.x[before + 1 : row])
            for before, row in zip(extended[turned].tolist(), extended[turned + 1].tolist(), strict=True)
        ]
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
