"""Data structure of a cloud's cluster tree: built by `cloud_tree`, used by all searches."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Int


class CloudIndex(NamedTuple):
    """A cloud and its tree of clusters.

    A level has a group of clusters for each cluster of the level above. There are two levels or more, and one group at
    the top. The 8 rows of a level are the clusters' bounding discs: middle xyz, normal xyz, half thickness, radius [m].
    """

    levels: tuple[Float[Array, "groups 8 clusters"], ...]
    points: Float[Array, "leaves 3 points"]  # [m]
    rows: Int[Array, "leaves points"]  # row of the cloud that each point came from
