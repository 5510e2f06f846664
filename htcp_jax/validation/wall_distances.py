"""Distances of MuJoCo's capsules from a wall, for validation, with provably safe pruning by a k-d tree.

MuJoCo computes distances to a cloud's points (`MujocoArm.distances`); scipy's tree only excludes points. A capsule's
axis is cut into pieces. For a piece with centre m and half length h, let d be the distance from m to the nearest point
of the cloud. Let s be the point of the axis nearest to the cloud, and e its distance: the clearance is D = e - radius.

- d - radius is an upper bound on the clearance, because m lies on the axis.
- If s is an end of the axis, its distance e is known exactly, as both ends are pieces with h = 0.
- Otherwise the line from s to its nearest point, of length e, is perpendicular to the axis. The piece that contains s
  has |m - s| <= h, so this point lies within sqrt(e^2 + h^2) of m: e >= sqrt(d^2 - h^2).

For a mesh, `mesh_clearance` computes the distances from MuJoCo's axes to the triangles, which are first cut into small
ones; the tree contains their centres. Let g be the largest distance from a centre to a corner of its triangle. Then
d - g replaces d in the lower bound above, and the radius of the ball below grows by g.

Let U be the smallest upper bound of all pieces. A piece with sqrt(d^2 - h^2) - radius > U cannot contain s. For
a piece that may contain s, the nearest point lies within sqrt((U + radius)^2 + h^2) of m. The remaining pieces are cut
finer until this ball contains few points; all of them are measured.

If a capsule is nearer than required and contains a convex hull of a mesh, the larger of both distances is used
(`convex_hull`).
"""

from collections.abc import Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, cKDTree

from htcp_jax.validation.cloud_discs import CloudDiscs
from htcp_jax.validation.mesh_clearance import axis_distances, crosses, cut_into_grains, point_distances
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm

COARSE = 0.5  # half length of the initial pieces / radius
FINE_M = 0.01  # half length at which pieces are not cut further
ROUNDING_M = 1e-9  # added to every bound for rounding errors
FACETS_AT_ONCE = 2_000_000  # maximum number of point-facet distances in memory


class AxisPieces(NamedTuple):
    """Pieces of capsule axes: row of the configuration, capsule, centre (0 at p, 1 at q), and half length [m]."""

    row: Int[np.ndarray, "m"]
    capsule: Int[np.ndarray, "m"]
    centre: Float[np.ndarray, "m"]
    half: Float[np.ndarray, "m"]

    def only(self, which: Bool[np.ndarray, "m"]) -> "AxisPieces":
        """Return the pieces for which `which` is True."""
        return AxisPieces(*(values[which] for values in self))


class Wall:
    """Points of a cloud, or triangles of a mesh, with a k-d tree, in the workpiece frame [m].

    Args:
        cloud: The points; not used for a mesh.
        interior: "hull" for an interior rule by the convex hull of the points or triangles, "none" for no rule.
        direction: Direction into the part; None: the world's x axis.
        triangles: Corners of the mesh's triangles; None for a cloud.
    """

    def __init__(
        self,
        cloud: Float[np.ndarray, "P 3"],
        interior: str,
        direction: Float[np.ndarray, "3"] | None = None,
        triangles: Float[np.ndarray, "F 3 3"] | None = None,
    ):
        self.triangles = None if triangles is None else cut_into_grains(triangles)
        self.middle = cloud if triangles is None else self.triangles.mean(axis=1)
        corners = cloud if triangles is None else self.triangles
        self.grain = 0.0 if triangles is None else float(np.linalg.norm(corners - self.middle[:, None], axis=2).max())
        self.tree = cKDTree(self.middle, leafsize=64)
        self.corners = cloud if triangles is None else triangles.reshape(-1, 3)
        planes = ConvexHull(self.corners).equations if interior == "hull" else np.empty((0, 4))
        self.normal, self.offset, self.direction = planes[:, :3].copy(), -planes[:, 3], direction

    @cached_property
    def discs(self) -> CloudDiscs:
        """Flat discs at the points of the cloud."""
        return CloudDiscs(self.middle, self.tree)

    def outside(self, points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m"]:
        """Return each point's largest signed distance from the planes of the hull's facets [m]; negative inside."""
        step = max(1, FACETS_AT_ONCE // max(1, len(self.offset)))
        parts = [points[k : k + step] @ self.normal.T - self.offset for k in range(0, len(points), step)]
        return np.concatenate([part.max(axis=1, initial=-np.inf) for part in parts] or [np.empty(0)])


class WallDistances:
    """Distances of an arm's capsules from a wall, whose point p is at rotate @ p + translate in the world.

    Args:
        arm: The arm.
        wall: The wall.
        rotate: Rotation from the wall's frame to the world (3, 3).
        translate: Translation from the wall's frame to the world (3,) [m].
    """

    def __init__(self, arm: MujocoArm, wall: Wall, rotate: np.ndarray, translate: np.ndarray):
        self.arm, self.wall, self.rotate, self.translate = arm, wall, rotate, translate

    def local(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return world points transformed to the workpiece's frame [m]."""
        return (points - self.translate) @ self.rotate

    def ends_outside(self, ends: np.ndarray, requested: np.ndarray) -> np.ndarray:
        """Return the signed distances of the requested ends of axes from the wall's hull [m]; NaN for the others."""
        found = np.full(requested.shape, np.nan)
        found[requested] = self.wall.outside(self.local(ends[requested]))
        return found

    def tip_crosses(self, arm_poses: ArmPoses, contact_m: float) -> Bool[np.ndarray, "n"]:
        """Return a mask, True where the bare tip passes through a triangle of the mesh or a disc of the cloud.

        Args:
            arm_poses: The arm at n configurations.
            contact_m: Length of the bare tip, from the TCP, that may touch the wall.
        """
        if not len(self.wall.middle):
            return np.zeros(len(arm_poses.tcp), bool)
        mesh = self.wall.triangles
        grain = self.wall.grain if mesh is not None else float(self.wall.discs.radius.max())
        first, tcp = self.local(self.arm.tip_start(arm_poses)), self.local(arm_poses.tcp)
        length = np.linalg.norm(tcp - first, axis=1)
        last = tcp + (first - tcp) * np.minimum(1.0, contact_m / np.maximum(length, contact_m + 1e-12))[:, None]
        length = np.linalg.norm(last - first, axis=1)
        row, share = _samples(np.maximum(1, np.ceil(length / (2 * grain))).astype(int))
        reach = grain + ROUNDING_M + np.minimum(length[row] / 2, grain)  # search radius around a sample's centre
        found = self.wall.tree.query_ball_point(
            first[row] + share[:, None] * (last - first)[row], reach, return_sorted=False
        )
        row = np.repeat(row, [len(near) for near in found])
        near = np.concatenate([np.empty(0, int), *(np.array(near, int) for near in found)])
        ends = first[row], last[row]
        through = self.wall.discs.crossed(*ends, near) if mesh is None else crosses(*ends, mesh[near])
        return np.bincount(row[through], minlength=len(first)) > 0

    def hulls_to_wall(self, arm_poses: ArmPoses, below: np.ndarray) -> np.ndarray:
        """Return the distance from the wall, by hulls or capsules without a hull [m]; inf if none is within `below`."""
        found, wall, arm = np.full(len(below), np.inf), self.wall, self.arm
        if not len(wall.middle):
            return found
        each = wall.middle[:, None] if wall.triangles is None else wall.triangles
        pieces = initial_pieces(arm, len(below))
        centres = self.local(centres_of(arm_poses, pieces))
        near = self.may_hold(pieces, wall.tree.query(centres, workers=-1)[0], below)
        pieces = pieces.only(near)
        points = wall.tree.query_ball_point(centres[near], self._reach(pieces, below), return_sorted=False)
        for first, last in _equal_runs(pieces.row * len(arm.radius) + pieces.capsule):
            k, c = pieces.row[first], pieces.capsule[first]
            own = np.unique(np.concatenate(points[first:last]).astype(int))
            near = self._near_axis(arm_poses.p[k, c], arm_poses.q[k, c], own, arm.radius[c] + below[k])
            own, distance = own[near < arm.radius[c] + below[k]], near.min(initial=np.inf) - arm.radius[c]
            if len(own):
                hull, middle = arm.hulls[c], (arm_poses.p[k, c] + arm_poses.q[k, c]) / 2
                if hull is not None:
                    world = each[own] @ self.rotate.T + self.translate
                    distance = max(distance, hull.clearance((world - middle) @ arm_poses.axes[k, c], below[k]))
                found[k] = min(found[k], distance)
        return found

    def _near_axis(self, p: np.ndarray, q: np.ndarray, rows: np.ndarray, within: float) -> np.ndarray:
        """Return the distances of some of the wall's points or triangles from an axis [m].

        For triangles, only the smallest distance and distances near `within` are exact; others are the centres'
        distances.

        Args:
            p: Start of the axis, world [m].
            q: End of the axis, world [m].
            rows: Indices of the points or triangles.
            within: Distance of interest [m].
        """
        axis, wall = np.stack([self.local(p), self.local(q)]), self.wall
        found = point_distances(*np.broadcast_to(axis[:, None], (2, len(rows), 3)), wall.middle[rows])
        if wall.triangles is None or not len(rows):
            return found
        least, reach = found.min(), wall.grain + ROUNDING_M
        exact = (found <= least + reach) | ((found >= within) & (found <= within + reach))
        ends = np.broadcast_to(axis[:, None], (2, exact.sum(), 3))
        found[exact] = axis_distances(*ends, wall.triangles[rows[exact]])
        return found

    def measured(self, x: np.ndarray, arm_poses: ArmPoses, pieces: AxisPieces, upper: np.ndarray) -> np.ndarray:
        """Return the clearance to points (by MuJoCo) or triangles [m]; inf if it is proven to be above `upper`."""
        row, capsule, point = self._candidates(arm_poses, pieces, upper)
        clearance = np.full(len(x), np.inf)
        if self.wall.triangles is not None:
            axis = (self.local(ends[row, capsule]) for ends in (arm_poses.p, arm_poses.q))
            found = axis_distances(*axis, self.wall.triangles[point]) - self.arm.radius[capsule]
            np.minimum.at(clearance, row, found)
            return clearance
        world = self.wall.middle[point] @ self.rotate.T + self.translate
        for first, last in _equal_runs(row):
            found = self.arm.distances(x[row[first]], capsule[first:last], world[first:last])
            clearance[row[first]] = found.min()
        return clearance

    def _candidates(self, arm_poses: ArmPoses, pieces: AxisPieces, upper: np.ndarray) -> np.ndarray:
        """Return all points that can be the nearest ones if the clearance is at most `upper`; see the module.

        Returns:
            The indices (configuration, capsule, point) of the candidates, (3, m), sorted.
        """
        radius = self.arm.radius
        if not len(self.wall.middle):
            return np.empty((3, 0), int)
        while len(pieces.row):
            reach = self._reach(pieces, upper)
            centres = self.local(centres_of(arm_poses, pieces))
            distance = self.wall.tree.query(centres, distance_upper_bound=reach.max() + ROUNDING_M)[0]
            upper = lowered(upper, pieces, distance - radius[pieces.capsule])
            kept = self.may_hold(pieces, distance, upper)
            pieces, centres = pieces.only(kept), centres[kept]
            if pieces.half.max(initial=0.0) <= FINE_M:
                break
            pieces = _cut_pieces(pieces, arm_poses)
        if not len(pieces.row):
            return np.empty((3, 0), int)
        points = self.wall.tree.query_ball_point(centres, self._reach(pieces, upper), return_sorted=False)
        count = [len(found) for found in points]
        shape = len(upper), len(radius), len(self.wall.middle)
        triples = np.repeat(pieces.row, count), np.repeat(pieces.capsule, count), np.concatenate(points).astype(int)
        return np.stack(np.unravel_index(np.unique(np.ravel_multi_index(triples, shape)), shape))

    def _reach(self, pieces: AxisPieces, upper: np.ndarray) -> np.ndarray:
        """Return the largest possible distance from each piece's centre to the nearest point, given `upper` [m]."""
        reach = np.maximum(0.0, upper[pieces.row] + self.arm.radius[pieces.capsule])
        return np.hypot(reach, pieces.half) + self.wall.grain + ROUNDING_M

    def may_hold(self, pieces: AxisPieces, distance: np.ndarray, upper: np.ndarray) -> np.ndarray:
        """Return False for the pieces that cannot contain the nearest point of an axis, see the module."""
        nearest = np.maximum(0.0, distance - self.wall.grain)
        least = np.sqrt(np.maximum(0.0, nearest**2 - pieces.half**2)) - self.arm.radius[pieces.capsule]
        return ~(least > upper[pieces.row] + ROUNDING_M)


def initial_pieces(arm: MujocoArm, n: int) -> AxisPieces:
    """Return the ends of every capsule's axis, and pieces with half lengths of at most COARSE radii, n times.

    The number of pieces is computed from the lengths in the model, because lengths at a configuration have rounding
    errors.
    """
    capsule, centre, half = [], [], []
    for k, (length, radius) in enumerate(zip(arm.length.tolist(), arm.radius.tolist(), strict=True)):
        count = int(np.ceil(length / (2 * COARSE * abs(radius))))
        parts = (np.arange(count) + 0.5) / max(1, count)
        centre += [0.0, 1.0, *parts] if count else [0.0]
        half += [0.0, 0.0, *(length / 2 / count,) * count] if count else [0.0]
        capsule += [k] * (count + 2 if count else 1)
    each = len(capsule)
    return AxisPieces(np.repeat(np.arange(n), each), *(np.tile(column, n) for column in (capsule, centre, half)))


def _samples(count: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Divide each of n segments into `count` equal parts; return each part's segment and its centre, from 0 to 1."""
    row = np.repeat(np.arange(len(count)), count)
    return row, (np.arange(len(row)) - (np.cumsum(count) - count)[row] + 0.5) / count[row]


def _cut_pieces(pieces: AxisPieces, arm_poses: ArmPoses) -> AxisPieces:
    """Return the pieces, each cut into four, except pieces of length 0."""
    whole, split = pieces.only(pieces.half == 0), pieces.only(pieces.half > 0)
    length = np.linalg.norm((arm_poses.p - arm_poses.q)[split.row, split.capsule], axis=1)
    quarters = np.array([-0.75, -0.25, 0.25, 0.75])
    centre = split.centre[:, None] + quarters * (split.half / length)[:, None]
    cut = AxisPieces(*(np.repeat(v, 4) for v in split))._replace(
        centre=centre.ravel(), half=np.repeat(split.half / 4, 4)
    )
    return AxisPieces(*(np.concatenate(both) for both in zip(whole, cut, strict=True)))


def centres_of(arm_poses: ArmPoses, pieces: AxisPieces) -> np.ndarray:
    """Return the centres of pieces, world [m]."""
    p, q = arm_poses.p[pieces.row, pieces.capsule], arm_poses.q[pieces.row, pieces.capsule]
    return p + pieces.centre[:, None] * (q - p)


def _equal_runs(row: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first and last index (exclusive) of each run of equal numbers in a sorted array."""
    changes = np.flatnonzero(np.diff(row, prepend=-1, append=-1))
    return zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True)


def lowered(upper: np.ndarray, pieces: AxisPieces, values: np.ndarray) -> np.ndarray:
    """Return each configuration's minimum of `upper` and of the values of its pieces."""
    upper = upper.copy()
    np.minimum.at(upper, pieces.row, values)
    return upper
