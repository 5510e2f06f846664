"""Distance of a cloud's points from convex pieces, by the planes that enclose each piece.

The distance is the largest height of the point over the piece's planes. This is a lower bound on the true distance. It
is exact inside and above faces, and has the right sign everywhere. Planes at sharp edges and corners limit its error to
10 % for a box.

A search begins with one known point, and skips every cluster in which no point can be lower than it.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.cloud_tree import bit_mask, empty_lists, for_each_leaf, in_reach
from htcp_jax.clearance.distance.clusters import SLACK, CloudIndex, as_segments, single, with_axes
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
    start: Float[Array, "K 3"],
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
        start: A point of the cloud within this distance of each axis, which is measured first [m].
    """
    return _lowest_points((index, planes), *jax.lax.stop_gradient((T_cloud_link, p, q, within, highest, start)))


@one_by_one
def _lowest_points(shared, T, p, q, within, highest, start):
    index, planes = shared
    segments = as_segments(p, q)
    top = in_reach(with_axes(single(segments), 1), index.levels[0][0][:, None, :], within[:, None])

    def measured(k, lists):
        segment = jax.tree.map(lambda a: a[..., k], segments)
        heights, bounds = partial(_heights, planes[k], T[k]), partial(_height_bounds, planes[k], T[k])
        height = jnp.max(heights(start[k, :, None]))
        best = jnp.minimum(height, highest), jnp.where(height < highest, start[k], 0.0)
        highest32 = best[0].astype(jnp.float32)

        def may_be_lower(discs):
            return bit_mask(bounds(discs) <= highest32)

        def measure(leaf, best):
            height = jnp.max(heights(index.points[leaf]), axis=0)
            lowest = jnp.argmin(height)
            nearer = height[lowest] < best[0]
            return jnp.where(nearer, height[lowest], best[0]), jnp.where(nearer, index.points[leaf][:, lowest], best[1])

        begin = top[k] & may_be_lower(index.levels[0][0])
        best, lists = for_each_leaf(index, segment, within[k], begin, measure, best, lists, may_be_lower)
        plane = jnp.argmax(heights(best[1][:, None])[:, 0])
        return PointHeights(*best, product(T[k, :3, :3], planes[k, plane, :3])), lists

    def search(state):
        left, found, lists = state
        k = jnp.argmax(left)
        own, lists = measured(k, lists)
        found = jax.tree.map(lambda every, new: every.at[k].set(new), found, own)
        return left.at[k].set(False), found, lists

    nothing, count = jnp.zeros((len(p), 3)), len(p)
    found = PointHeights(jnp.broadcast_to(highest, count), nothing, nothing)
    begin = within >= 0, found, empty_lists(index)  # only these bodies are visited, as every visit copies the lists
    return jax.lax.while_loop(lambda state: jnp.any(state[0]), search, begin)[1]


def _heights(planes: Float[Array, "D 4"], T: Float[Array, "4 4"], points: Float[Array, "3 n"]) -> Float[Array, "D n"]:
    """Return the heights of points over all planes of a piece [m]."""
    return _along(planes, T, [points[i] - T[i, 3] for i in range(3)]) - planes[:, 3:]


def _along(planes: Float[Array, "D 4"], T: Float[Array, "4 4"], vectors) -> Float[Array, "D n"]:
    """Return the components of vectors (3, n) along the normals of a piece's planes."""
    own = sum(T[i, :3, None] * vectors[i][None] for i in range(3))
    return sum(planes[:, i, None] * own[i, None] for i in range(3))


def _height_bounds(
    planes: Float[Array, "D 4"], T: Float[Array, "4 4"], discs: Float[Array, "8 n"]
) -> Float[Array, "n"]:
    """Return lower bounds on the heights of the points in discs over a piece [m], by the highest plane of each middle.

    No point of a disc is lower than its middle by more than |c| e + sqrt(1 - c^2) r, see `clusters`, with the cosine c
    between the normals of disc and plane. The bounds are computed in 32-bit floats and reduced by `SLACK`.
    """
    planes, T = planes.astype(jnp.float32), T.astype(jnp.float32)
    height = _heights(planes, T, discs[:3])
    highest = jnp.max(height, axis=0)
    cosine = jnp.max(jnp.where(height == highest[None], jnp.abs(_along(planes, T, discs[3:6])), 0), axis=0)
    across = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0) + 2e-6)
    return highest - cosine * discs[6] - across * discs[7] - jnp.float32(SLACK)
