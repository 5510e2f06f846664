"""Data structure of a cloud's cluster tree: built by `cloud_tree`, used by all searches."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Int


class CloudIndex(NamedTuple):
    """A cloud and its tree.

    Rows of a bound: middle xyz, normal xyz, half thickness, radius [m]. A level has a group of clusters for each
    cluster of the level above; there are two levels or more, and one group at the top.
    """

    levels: tuple[Float[Array, "groups 8 clusters"], ...]
    points: Float[Array, "leaves 3 points"]
    rows: Int[Array, "leaves points"]  # row of the cloud that each point came from
