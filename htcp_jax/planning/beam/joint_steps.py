"""Limits on joint steps in a beam search: the maximum travel of each joint between two targets of the path's file.

The limit applies to the sum over a segment, including the goals inserted on it and self-motions at these goals.
Self-motions at a target belong to the segment that begins at this target.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.device import tables
from htcp_jax.model import Scenario
from htcp_jax.motion import configuration_tree
from htcp_jax.planning.beam.tree import BeamTree, Nodes

ROUNDING = 1e-12  # tolerance of sums, relative to a limit


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
            which, child = tables.gather((which, child), child.parent != configuration_tree.NO_PARENT)
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
