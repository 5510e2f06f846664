"""Points that cover a mesh: no point of its triangles is further than a known distance from one of them.

Every triangle is cut at the middle of its longest edge until its own three corners cover it. Nothing is random: the
same mesh gives the same points, evenly spread for any shapes of its triangles.

Every body is thickened by the covering radius: a clearance is a lower bound at any spacing, and more conservative at a
coarser one. By default the spacing follows the thinnest body that can come near the mesh, within limits on the number
of points.

A triangle's covering radius is the largest distance of any of its points to the nearest corner. Where no angle is
obtuse, that is attained at the circumcentre. Otherwise the circumcentre lies outside, and it is attained where the
bisector of one of the two shorter edges meets the longest one: at c / (2 cos B) from B, or b / (2 cos C) from C.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model import kinematics
from htcp_jax.model.robot import Robot, capsule_label

MOST = 3_000_000  # points
FEW, MANY = 20_000, 300_000  # default numbers of points: about as many for any body, and no more for a thin one
THINNED, EXCESS = 80_000, 3  # up to so many, points that are EXCESS times as many are thinned out
SHARE = 4  # ratio of a body's radius to the covering radius that it requires,
FINEST_M = 0.002  # but it requires no smaller one than this
ROUNDING = 1e-6  # relative rounding error of a covering radius; nearly flat triangles cost digits
KEY = "workpiece.mesh_spacing_m"

Triangles = Float[np.ndarray, "F 3 3"]
Corners = Float[np.ndarray, "3 3 F"]  # the same, corner and coordinate first: numpy works along the last axis


class PointCover(NamedTuple):
    """P points on a mesh, and the distance [m] from any point of the mesh within which one of them lies."""

    points: Float[np.ndarray, "P 3"]
    radius_m: float


class NearbyBody(NamedTuple):
    """The thinnest body that can come near a mesh."""

    label: str  # for messages
    radius_m: float


def thinnest_nearby(robot: Robot, distance_m: float | None = None, excluded: Collection[int] = ()) -> NearbyBody | None:
    """Return the thinnest body that can come near a mesh, None if there is no such body.

    Args:
        robot: The robot.
        distance_m: Distance of the mesh from the first joint's origin [m]. None: half of the largest reach, for a
            workpiece, whose poses are not known; the bodies near the base do not extend as far.
        excluded: Links whose bodies are not tested against the mesh.
    """
    distance_m = kinematics.max_reach(robot) / 2 if distance_m is None else distance_m
    is_near = (kinematics.body_reach(robot) >= distance_m) & ~np.isin(robot.capsule_link, list(excluded))
    if not is_near.any():
        return None
    radius = np.where(is_near, np.asarray(robot.capsule_radius), np.inf)
    return NearbyBody(capsule_label(robot, robot.capsule_names[int(radius.argmin())]), float(radius.min()))


def cover_mesh(
    triangles: Triangles, source: str, spacing: float | None = None, body: NearbyBody | None = None
) -> PointCover:
    """Sample triangles: their corners and those of their pieces, until these cover the mesh.

    Narrow or small triangles have more corners than needed; a thinned set of points covers their mesh.

    Args:
        triangles: F >= 1 triangles [m].
        source: Name of the mesh in messages.
        spacing: The widest gap between points [m]: every point of the mesh has one of them within half of it. None:
            half of the body's radius, but no less than twice FINEST_M. A mesh gets about FEW points even if these are
            closer, and about MANY even if these are farther apart.
        body: The thinnest body that can come near; None: about FEW points.

    Raises:
        InputError: For a mesh without an area, a spacing that is not positive, and if more than MOST points would be
            needed.
    """
    total = area(triangles).sum()
    if not total > 0:
        raise InputError(f"{source}: the mesh has no area")
    if spacing is not None and not 0 < spacing < np.inf:
        raise InputError(f"{source}: a spacing of {spacing} m; it must be more than 0")
    wanted = _default_radius(total, body) if spacing is None else spacing / 2
    required = f"a spacing of {2 * wanted:.3g} m"
    if spacing is None and body is not None and wanted < _default_radius(total, None):
        required += f", so fine because of {body.label} with a radius of {1e3 * body.radius_m:.4g} mm"
    regular = total / (2 * wanted**2)  # number of points of a square grid
    _check_count(regular, required, source)
    left = np.ascontiguousarray(np.moveaxis(triangles, 0, 2))
    points, reached, done = [*left], 0.0, 0
    while left.shape[2]:
        left = _longest_edge_first(left)
        reach = _covering_radius(left)
        coarse = reach > wanted
        reached = max(reached, float(reach[~coarse].max(initial=0.0)))
        done += reach.size - int(coarse.sum())
        left, middle = _halved_triangles(left[:, :, coarse])
        points.append(middle)
        if regular < THINNED and done + left.shape[2] > 2 * EXCESS * max(regular, FEW):
            return _thinned_cover(triangles, wanted, required, source)
        _check_count((done + left.shape[2]) / 2, required, source)
    return PointCover(_distinct_points(np.concatenate(points, axis=1).T), reached * (1 + ROUNDING))


def _thinned_cover(triangles: Triangles, radius_m: float, required: str, source: str) -> PointCover:
    """Return middles of pieces so that each piece lies within `radius_m` of one of them.

    A piece is in a ball if its corners are. Pieces that no ball covers yet are cut until they are small enough to get
    one themselves.
    """
    left, kept = np.ascontiguousarray(np.moveaxis(triangles, 0, 2)), np.empty((0, 3))
    while left.shape[2]:
        left = _longest_edge_first(left)
        extent = _furthest_corner(left, left.mean(axis=0))
        if len(kept) and (fitting := np.flatnonzero(extent <= radius_m)).size:
            parts = left[:, :, fitting]
            _, nearest = scipy.spatial.cKDTree(kept).query(parts.mean(axis=0).T, distance_upper_bound=radius_m)
            point = np.append(kept, [[np.inf] * 3], axis=0)[nearest].T  # infinite: none is so close
            is_covered = _furthest_corner(parts, point) <= radius_m
            left, extent = (np.delete(each, fitting[is_covered], axis=-1) for each in (left, extent))
        is_small = extent <= radius_m / 2
        kept = np.concatenate([kept, _greedy_middles(left[:, :, is_small], radius_m)])
        left, _ = _halved_triangles(left[:, :, ~is_small])
        _check_count(left.shape[2] / 2, required, source)
    return PointCover(kept, radius_m * (1 + ROUNDING))


def _greedy_middles(corners: Corners, radius_m: float) -> Float[np.ndarray, "P 3"]:
    """Return middles of triangles so that each triangle lies within `radius_m` of one of them; greedily, in order."""
    middle = corners.mean(axis=0).T
    tree, is_left, kept = scipy.spatial.cKDTree(middle), np.ones(len(middle), bool), []
    for row in np.lexsort(middle.T):
        if is_left[row]:
            near = np.array(tree.query_ball_point(middle[row], radius_m))
            is_left[near[_furthest_corner(corners[:, :, near], middle[row][:, None]) <= radius_m]] = False
            kept.append(row)
    return middle[kept]


def _furthest_corner(corners: Corners, point: Float[np.ndarray, "3 #F"]) -> Float[np.ndarray, "F"]:
    """Return the distance of each triangle's furthest corner from its point [m]."""
    return np.sqrt(np.max([_square_norm(corner - point) for corner in corners], axis=0))


def _default_radius(total: float, body: NearbyBody | None) -> float:
    """Return the default covering radius [m] for a total area [m2], by the points of square grids."""
    coarsest, finest = (float(np.sqrt(total / (2 * count))) for count in (FEW, MANY))
    required = coarsest if body is None else max(body.radius_m / SHARE, FINEST_M)
    return max(min(required, coarsest), finest)


def pieces(triangles: Triangles, edge_m: float, source: str) -> Float[np.ndarray, "G 3 3"]:
    """Cut the triangles until no edge is longer than `edge_m`.

    Raises:
        InputError: For more than 2 MOST pieces.
    """
    left = np.ascontiguousarray(np.moveaxis(triangles, 0, 2))
    done, count = [], 0
    while left.shape[2]:
        left = _longest_edge_first(left)
        coarse = _square_norm(left[1] - left[0]) > edge_m**2
        done.append(left[:, :, ~coarse])
        count += done[-1].shape[2]
        left, _ = _halved_triangles(left[:, :, coarse])
        _check_count((count + left.shape[2]) / 2, f"a spacing of {edge_m:.3g} m", source)
    return np.ascontiguousarray(np.moveaxis(np.concatenate(done, axis=2), 2, 0))


def area(triangles: Triangles) -> Float[np.ndarray, "F"]:
    """Return the area of each triangle [m2]."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def covering_radius(triangles: Triangles) -> Float[np.ndarray, "F"]:
    """Return the exact covering radius of each triangle by its own corners [m]; see the module's docstring."""
    return _covering_radius(_longest_edge_first(np.moveaxis(triangles, 0, 2)))


def _covering_radius(corners: Corners) -> Float[np.ndarray, "F"]:
    """Return the covering radius. The longest edge is from b to c; the opposite angle, the largest, is at a."""
    b, c, a = corners
    bc, ba, ca = c - b, a - b, a - c
    square, square_b, square_c = _square_norm(bc), _square_norm(ba), _square_norm(ca)
    with np.errstate(divide="ignore", invalid="ignore"):
        # |b - a| |c - a| |b - c| / (4 area), squared; 16 area^2 = 4 |bc x ba|^2
        acute = square * square_b * square_c / (4 * _square_norm(np.cross(bc, ba, axis=0)))
        obtuse = square * np.fmax(square_b / _components_dot(ba, bc), -square_c / _components_dot(ca, bc)) ** 2 / 4
    is_acute = _components_dot(ba, ca) > 0
    return np.sqrt(np.where(is_acute, np.fmin(acute, square / 3), np.fmin(obtuse, square / 4)))


def _halved_triangles(corners: Corners) -> tuple[Float[np.ndarray, "3 3 2*F"], Float[np.ndarray, "3 F"]]:
    """Cut each triangle in two at the middle of its longest edge, the first; return the halves and these middles.

    Two neighbours with this edge have the same middle to the last bit.
    """
    b, c, a = corners
    middle = (b + c) / 2
    return np.concatenate([np.stack([a, b, middle]), np.stack([c, a, middle])], axis=2), middle


def _longest_edge_first(corners: Corners) -> Corners:
    """Return the corners in the same sense of rotation, beginning with the longest edge."""
    a, b, c = corners
    ab, bc, ca = _square_norm(b - a), _square_norm(c - b), _square_norm(a - c)
    from_b, from_c = (bc > ab) & (bc >= ca), (ca > ab) & (ca > bc)
    turned = corners.copy()
    turned[:, :, from_b] = corners[[1, 2, 0]][:, :, from_b]
    turned[:, :, from_c] = corners[[2, 0, 1]][:, :, from_c]
    return turned


def _distinct_points(points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "p 3"]:
    points = points + 0.0  # -0.0 is 0.0
    points = points[np.lexsort(points.T)]
    return points[np.concatenate([[True], (points[1:] != points[:-1]).any(axis=1)])]


def _components_dot(u: Float[np.ndarray, "3 F"], v: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _square_norm(u: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    return _components_dot(u, u)


def _check_count(points: float, spacing: str, source: str) -> None:
    if points > MOST:
        raise InputError(f"{source}: more than {MOST:,} points at {spacing}; see {KEY}")
