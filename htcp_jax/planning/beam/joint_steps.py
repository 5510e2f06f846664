"""Bounds on joint steps in a beam search: the travel of each joint between two targets of the file.

Goals may be inserted on a segment, and there may be self-motions at them; the bound is one for the whole segment.
Self-motions at a target belong to the segment that begins there.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.device import tables
from htcp_jax.model import Scenario
from htcp_jax.motion import configuration_tree
from htcp_jax.planning.beam.tree import BeamTree, Nodes

ROUNDING = 1e-12  # share of a bound that sums may miss


class JointSteps(NamedTuple):
    """Bounds on the segments of S scenarios, by row; the last row is behind the last target, for self-motions at it."""

    segment: Int[np.ndarray, "S R1"]  # number of the file's target at the end of the segment that a row is on
    most: Float[np.ndarray, "S R1 N"]  # longest travel of each joint on that segment [rad or m]

    @classmethod
    def of(cls, scenarios: Scenario) -> "JointSteps | None":
        """Return the bounds of stacked scenarios; None if they have none."""
        if (most := scenarios.max_joint_step) is None:
            return None
        segment = np.append(scenarios.segments, scenarios.segments[:, -1:] + 1, axis=1)
        return cls(segment, np.append((1 - ROUNDING) * most, np.full_like(most[:, :1], np.inf), axis=1))

    def left(
        self, tree: BeamTree, nodes: Int[np.ndarray, "m"], scenario: Int[np.ndarray, "m"], row: Int[np.ndarray, "m"]
    ) -> Float[np.ndarray, "m N"]:
        """Return how far each joint may still travel on a segment after the motion to a node [rad or m].

        Args:
            tree: The tree, of a search in either direction.
            nodes: Tree rows.
            scenario: Row of each one's scenario.
            row: A row on the segment: the node's, or the one behind it.
        """
        left, own, which = self.most[scenario, row], self.segment[scenario, row], np.arange(len(nodes))
        while len(which):
            child = tree.nodes(nodes)
            which, child = tables.gather((which, child), child.parent != configuration_tree.NO_PARENT)
            parent = tree.nodes(child.parent)
            here = self.segment[scenario[which], _row_of(child.target, parent.target)] == own[which]
            which, nodes, x, before = tables.gather((which, child.parent, child.at.x, parent.at.x), here)
            left[which] -= np.abs(x - before)
        return left

    def are_kept(self, scenario: int, path: Nodes) -> bool:
        """Return True if the motion along nodes, in the order of travel, keeps all bounds."""
        row = _row_of(path.target[1:], path.target[:-1])
        segment = self.segment[scenario, row]
        travel = np.zeros((self.segment[scenario].max() + 1, self.most.shape[2]))
        np.add.at(travel, segment, np.abs(np.diff(path.at.x, axis=0)))
        return bool(((1 - ROUNDING) * travel[segment] <= self.most[scenario, row]).all())


def _row_of(target: Int[np.ndarray, "m"], before: Int[np.ndarray, "m"]) -> Int[np.ndarray, "m"]:
    """Return the row that a motion between two targets, in either direction, leads to; the next one if it stays."""
    return np.maximum(target, before) + (target == before)
