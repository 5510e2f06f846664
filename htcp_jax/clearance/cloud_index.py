"""A cloud cut into clusters of clusters, see `cloud_tree`, and how a search goes through them."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Int

ONE_BODY = 1, 1, 4  # roots, branches and leaves that a CPU takes at a time: leaves wait for square roots
SIDE_BY_SIDE = 8, 8  # branches and leaves that other devices take at a time, for each body


class CloudIndex(NamedTuple):
    """A cloud and its tree. Rows of a bound: medoid xyz, normal xyz, half thickness, radius [m]."""

    roots: Float[Array, "1 8 roots"]
    branches: Float[Array, "roots 8 branches"]
    leaves: Float[Array, "all_branches 8 leaves"]
    points: Float[Array, "all_leaves 3 points"]
    rows: Int[Array, "all_leaves points"]  # row of the cloud that each point came from


def levels_of(index: CloudIndex, backend: str) -> tuple[Float[Array, "parents 8 clusters"], ...]:
    """Bounds of the clusters that a search goes down by. Where a loop costs more than the arithmetic in it, without the
    roots: they would be a loop more."""
    if backend == "cpu":
        return index.roots, index.branches, index.leaves
    return index.branches.transpose(1, 0, 2).reshape(1, 8, -1), index.leaves
