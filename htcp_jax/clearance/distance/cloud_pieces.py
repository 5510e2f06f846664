"""Distance of a cloud's points from convex pieces, by the planes that enclose each piece.

The distance is the largest height of the point over the piece's planes. This is a lower bound on the true distance. It
is exact inside and above faces, and has the right sign everywhere. Planes at sharp edges and corners limit its error to
10 % for a box.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.cloud_tree import empty_lists, for_each_leaf, in_reach
from htcp_jax.clearance.distance.clusters import CloudIndex, as_segments, single, with_axes
from htcp_jax.numerics import one_by_one, product
from htcp_jax.types import Array, Float


class PointHeights(NamedTuple):
    """The point of a cloud that is nearest to each of K pieces, by its height over the piece's planes."""

    height: Float[Array, "K"]  # [m]
    point: Float[Array, "K 3"]  # in the cloud's frame [m]
    normal: Float[Array, "K 3"]  # outward normal of the plane with this height, in the cloud's frame


def lowest_points(
    index: CloudIndex,
    planes: Float[Array, "K D 4"],
    T_cloud_link: Float[Array, "K 4 4"],
    p: Float[Array, "K 3"],
    q: Float[Array, "K 3"],
    within: Float[Array, "K"],
    highest: Float[Array, ""],
) -> PointHeights:
    """Return the lowest point over each piece among the points within a distance of its capsule's axis.

    Args:
        index: The cloud's tree.
        planes: Planes about each piece in the frame of its link: normal, offset [m].
        T_cloud_link: Poses of the links in the cloud's frame.
        p: First ends of the capsules' axes, in the cloud's frame [m].
        q: Second ends [m].
        within: Distance from each capsule's axis within which points are measured [m]; negative: no point is.
        highest: Upper limit of the returned heights [m]; it is returned if no measured point is lower.
    """
    return _lowest_points((index, planes), *jax.lax.stop_gradient((T_cloud_link, p, q, within, highest)))


@one_by_one
def _lowest_points(shared, T, p, q, within, highest):
    index, planes = shared
    segments = as_segments(p, q)
    top = in_reach(with_axes(single(segments), 1), index.levels[0][0][:, None, :], within[:, None])

    def heights(k, points):
        """Return the heights of points (3, n) over all planes of a piece (D, n)."""
        own = sum(T[k, i, :3, None] * (points[i] - T[k, i, 3])[None] for i in range(3))
        return sum(planes[k, :, i, None] * own[i, None] for i in range(3)) - planes[k, :, 3:]

    def search(k, state):
        found, lists = state
        segment = jax.tree.map(lambda a: a[..., k], segments)

        def measure(leaf, best):
            height = jnp.max(heights(k, index.points[leaf]), axis=0)
            lowest = jnp.argmin(height)
            nearer = height[lowest] < best[0]
            return jnp.where(nearer, height[lowest], best[0]), jnp.where(nearer, index.points[leaf][:, lowest], best[1])

        best, lists = for_each_leaf(index, segment, within[k], top[k], measure, (highest, jnp.zeros(3)), lists)
        plane = jnp.argmax(heights(k, best[1][:, None])[:, 0])
        own = PointHeights(*best, product(T[k, :3, :3], planes[k, plane, :3]))
        return jax.tree.map(lambda every, new: every.at[k].set(new), found, own), lists

    count = len(p)
    start = PointHeights(jnp.zeros(count), jnp.zeros((count, 3)), jnp.zeros((count, 3)))
    return jax.lax.fori_loop(0, count, search, (start, empty_lists(index)))[0]
