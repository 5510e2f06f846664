"""Points that cover a mesh: every place on the mesh is within the covering radius of one of the points.

Every triangle is cut at the middle of its longest edge until the corners of each piece cover this piece. The algorithm
is deterministic, and spreads the points evenly for triangles of any shape.

The covering radius is subtracted from every clearance. A clearance is therefore a lower bound at any spacing, and more
conservative at a coarser one. By default the spacing follows the thinnest body that can come near the mesh, within
limits on the number of points.

A triangle's covering radius is the largest distance of any of its points from the nearest corner. If no angle is
obtuse, it is attained at the circumcentre. Otherwise it is attained where the perpendicular bisector of one of the
two shorter edges meets the longest edge: at c / (2 cos B) from B, or b / (2 cos C) from C.
"""

from collections.abc import Callable, Collection
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.caching import cached_by_values
from htcp_jax.errors import InputError
from htcp_jax.model import kinematics, surface
from htcp_jax.model.robot import Robot, capsule_label
from htcp_jax.model.surface import (
    Corners,
    Triangles,
    area,
    check_count,
    components_dot,
    halved_triangles,
    longest_edge_first,
    square_norm,
)
from htcp_jax.model.workpiece import Workpiece

FEW, MANY = 20_000, 300_000  # default number of points: about FEW for thick bodies, at most about MANY for thin ones
THINNED, EXCESS = 80_000, 3  # a cover for which THINNED points suffice is thinned out if it has EXCESS times as many
SHARE = 4  # ratio of a body's radius to the default covering radius
FINEST_M = 0.002  # minimum of the default covering radius
DENSEST_M = 0.0002  # minimum of the spacing that is suggested
LEVELS = 2  # a spacing may give so many times the expected points, as each cut halves a triangle
ROUNDING = 1e-6  # relative rounding error of a covering radius; nearly flat triangles cost digits


class PointCover(NamedTuple):
    """P points on a mesh, and their covering radius."""

    points: Float[np.ndarray, "P 3"]  # [m]
    radius_m: float  # every point of the mesh is within this distance of one of the points


class NearbyBody(NamedTuple):
    """The thinnest body that can come near a mesh."""

    label: str  # for messages
    radius_m: float


def denser_spacing(workpiece: Workpiece, lack_m: float) -> float | None:
    """Return a spacing of points at which the subtracted covering radius may explain a lack of clearance [m].

    The new covering radius is at most 0.9 (r - `lack_m`) for a present one of r, with a spacing of one significant
    digit. None if the lack is larger than r, no spacing of at least `DENSEST_M` suffices, or the mesh might get more
    than `surface.MOST_POINTS` points, as estimated from the present number. Narrow triangles may need more.

    Args:
        workpiece: The part, whose points may cover a mesh.
        lack_m: The required clearance minus the measured one [m].
    """
    radius_m = workpiece.covering_radius_m
    spacing = 1.8 * (radius_m - max(lack_m, 0.0))
    if spacing < DENSEST_M:
        return None
    spacing = _one_digit(spacing, np.floor)
    expected = len(workpiece.cloud) * (2 * radius_m / spacing) ** 2
    return spacing if LEVELS * expected <= surface.MOST_POINTS else None


def thinnest_nearby(robot: Robot, distance_m: float | None = None, excluded: Collection[int] = ()) -> NearbyBody | None:
    """Return the thinnest body of the robot that can come near a mesh; None if no body can.

    Args:
        robot: The robot.
        distance_m: Distance of the mesh from the first joint's origin [m]. None: half of the maximum reach, for a
            workpiece whose poses are unknown; this excludes the bodies near the base.
        excluded: Indices of links whose bodies are not tested against the mesh.
    """
    distance_m = kinematics.max_reach(robot) / 2 if distance_m is None else distance_m
    is_near = (kinematics.body_reach(robot) >= distance_m) & ~np.isin(robot.capsule_link, list(excluded))
    if not is_near.any():
        return None
    radius = np.where(is_near, np.asarray(robot.capsule_radius), np.inf)
    return NearbyBody(capsule_label(robot, robot.capsule_names[int(radius.argmin())]), float(radius.min()))


@cached_by_values(2)
def cover_mesh(
    triangles: Triangles, source: str, spacing: float | None = None, body: NearbyBody | None = None
) -> PointCover:
    """Return points that cover a mesh: the corners of its triangles and of their pieces.

    If narrow or small triangles give many more points than needed, the points are thinned out.

    Args:
        triangles: F >= 1 triangles [m].
        source: Name of the mesh in messages.
        spacing: The widest gap between points [m]: twice the required covering radius. None: half of the body's radius,
            but at least twice FINEST_M; a mesh gets at least about FEW points and at most about MANY.
        body: The thinnest body that can come near; None: about FEW points.

    Raises:
        InputError: For a mesh without an area, a spacing that is not positive, and if more than MOST points would be
            needed.
    """
    total = area(triangles).sum()
    if not total > 0:
        raise InputError(f"{source}: the mesh has no area")
    if spacing is not None and not 0 < spacing < np.inf:
        raise InputError(f"{source}: the spacing is {spacing} m; it must be more than 0")
    wanted = _default_radius(total, body) if spacing is None else spacing / 2
    required = f"a spacing of {2 * wanted:.3g} m"
    if spacing is None and body is not None and wanted < _default_radius(total, None):
        required += f", as fine as {body.label} with a radius of {1e3 * body.radius_m:.4g} mm requires"
    regular = total / (2 * wanted**2)  # number of points of a square grid
    fewer = 2 * wanted * np.sqrt(LEVELS * regular / surface.MOST_POINTS)
    check_count(regular, required, source, f" to {_one_digit(fewer, np.ceil):g} or more")
    left = np.ascontiguousarray(np.moveaxis(triangles, 0, 2))
    points, reached, done = [*left], 0.0, 0
    while left.shape[2]:
        left = longest_edge_first(left)
        reach = _covering_radius(left)
        coarse = reach > wanted
        reached = max(reached, float(reach[~coarse].max(initial=0.0)))
        done += reach.size - int(coarse.sum())
        left, middle = halved_triangles(left[:, :, coarse])
        points.append(middle)
        if regular < THINNED and done + left.shape[2] > 2 * EXCESS * max(regular, FEW):
            return _thinned_cover(triangles, wanted, required, source)
        check_count((done + left.shape[2]) / 2, required, source)
    return PointCover(_distinct_points(np.concatenate(points, axis=1).T), reached * (1 + ROUNDING))


def _thinned_cover(triangles: Triangles, radius_m: float, required: str, source: str) -> PointCover:
    """Return a cover with fewer points: balls of `radius_m` about the points contain all triangles.

    A ball contains a piece of a triangle if it contains the piece's corners. Pieces that no ball contains are cut until
    a ball about their own middle contains them.
    """
    left, kept = np.ascontiguousarray(np.moveaxis(triangles, 0, 2)), np.empty((0, 3))
    while left.shape[2]:
        left = longest_edge_first(left)
        extent = _furthest_corner(left, left.mean(axis=0))
        if len(kept) and (fitting := np.flatnonzero(extent <= radius_m)).size:
            parts = left[:, :, fitting]
            _, nearest = scipy.spatial.cKDTree(kept).query(parts.mean(axis=0).T, distance_upper_bound=radius_m)
            point = np.append(kept, [[np.inf] * 3], axis=0)[nearest].T  # infinite: no point is within radius_m
            is_covered = _furthest_corner(parts, point) <= radius_m
            left, extent = (np.delete(each, fitting[is_covered], axis=-1) for each in (left, extent))
        is_small = extent <= radius_m / 2
        kept = np.concatenate([kept, _greedy_middles(left[:, :, is_small], radius_m)])
        left, _ = halved_triangles(left[:, :, ~is_small])
        check_count(left.shape[2] / 2, required, source)
    return PointCover(kept, radius_m * (1 + ROUNDING))


def _greedy_middles(corners: Corners, radius_m: float) -> Float[np.ndarray, "P 3"]:
    """Select middles of triangles, greedily and in order, until each triangle lies within `radius_m` of one of them."""
    middle = corners.mean(axis=0).T
    tree, is_left, kept = scipy.spatial.cKDTree(middle), np.ones(len(middle), bool), []
    for row in np.lexsort(middle.T):
        if is_left[row]:
            near = np.array(tree.query_ball_point(middle[row], radius_m))
            is_left[near[_furthest_corner(corners[:, :, near], middle[row][:, None]) <= radius_m]] = False
            kept.append(row)
    return middle[kept]


def _furthest_corner(corners: Corners, point: Float[np.ndarray, "3 #F"]) -> Float[np.ndarray, "F"]:
    """Return the distance of each triangle's furthest corner from a point [m]; one point per triangle."""
    return np.sqrt(np.max([square_norm(corner - point) for corner in corners], axis=0))


def _one_digit(value: float, rounded: Callable[[float], float]) -> float:
    """Return a number with one significant digit, rounded down by np.floor or up by np.ceil."""
    digit = 10.0 ** np.floor(np.log10(value))
    return float(f"{rounded(round(value / digit, 9)) * digit:.0e}")


def _default_radius(total: float, body: NearbyBody | None) -> float:
    """Return the default covering radius [m] for a total area [m2], estimated as for points on a square grid."""
    coarsest, finest = (float(np.sqrt(total / (2 * count))) for count in (FEW, MANY))
    required = coarsest if body is None else max(body.radius_m / SHARE, FINEST_M)
    return max(min(required, coarsest), finest)


def _covering_radius(corners: Corners) -> Float[np.ndarray, "F"]:
    """Return each triangle's covering radius [m]. The longest edge is from b to c, so the largest angle is at a."""
    b, c, a = corners
    bc, ba, ca = c - b, a - b, a - c
    square, square_b, square_c = square_norm(bc), square_norm(ba), square_norm(ca)
    with np.errstate(divide="ignore", invalid="ignore"):
        # |b - a| |c - a| |b - c| / (4 area), squared; 16 area^2 = 4 |bc x ba|^2
        acute = square * square_b * square_c / (4 * square_norm(np.cross(bc, ba, axis=0)))
        obtuse = square * np.fmax(square_b / components_dot(ba, bc), -square_c / components_dot(ca, bc)) ** 2 / 4
    is_acute = components_dot(ba, ca) > 0
    return np.sqrt(np.where(is_acute, np.fmin(acute, square / 3), np.fmin(obtuse, square / 4)))


def _distinct_points(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "p 3"]:
    points = points + 0.0  # -0.0 is 0.0
    points = points[np.lexsort(points.T)]
    return points[np.concatenate([[True], (points[1:] != points[:-1]).any(axis=1)])]
