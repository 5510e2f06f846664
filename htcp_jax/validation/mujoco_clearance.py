"""Clearance between MuJoCo's capsules and the walls, for validation, with provably safe pruning by a k-d tree.

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

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import ConvexHull, cKDTree

from htcp_jax.spec import config
from htcp_jax.validation.carried import CarriedBody
from htcp_jax.validation.cloud_discs import CloudDiscs
from htcp_jax.validation.mesh_clearance import axis_distances, crosses, cut_into_grains, point_distances
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm
from htcp_jax.validation.scene_rules import WorkpieceData

COARSE = 0.5  # half length of the initial pieces / radius
FINE_M = 0.01  # half length at which pieces are not cut further
ROUNDING_M = 1e-9  # added to every bound for rounding errors
SOLVER_M = 1e-5  # error of mj_geomDistance, which is iterative
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


def wall_of(part: config.WorkpieceConfig, workpiece: WorkpieceData) -> Wall:
    """Return the wall of a job's workpiece.

    If a user-supplied part has no inlet direction, the direction of the hull's facet nearest to the inlet is used.
    Without an inlet there is no interior rule.
    """
    triangles = workpiece.triangles if len(workpiece.triangles) else None
    given = None if part.is_along_world_x else part.inlet_direction
    if part.is_along_world_x or part.interior != "hull" or given is not None:
        direction = None if given is None else np.array(given) / np.linalg.norm(given)
        return Wall(workpiece.cloud, part.interior, direction, triangles)
    if workpiece.inlet is None:
        return Wall(workpiece.cloud, "none", None, triangles)
    wall = Wall(workpiece.cloud, "hull", None, triangles)
    wall.direction = -wall.normal[(wall.normal @ workpiece.inlet - wall.offset).argmax()]
    return wall


class TargetClearances(NamedTuple):
    """Results at n configurations, from which `CheckedScene.between` derives bounds."""

    arm_poses: ArmPoses
    clearance: Float[np.ndarray, "n"]  # [m]
    samples: Float[np.ndarray, "n M 3"]  # points on the capsules' axes, world [m]
    distance: Float[np.ndarray, "n M"]  # distance of the samples from their nearest points [m]
    ends: Float[np.ndarray, "n E 3"]  # ends of all capsules' axes, world [m]
    outside: Float[np.ndarray, "n E"]  # signed distance of these ends from the hull [m]; NaN if not checked
    surroundings: Float[np.ndarray, "n R"]  # distances of `mujoco_cell.MujocoCell.distances` [m]
    to_others: Float[np.ndarray, "n"]  # smallest of `surroundings`, by hulls if capsules are too near [m]
    to_wall: Float[np.ndarray, "n"]  # distance to the cloud's points or the mesh's triangles [m]

    def less_cover(self, cover_m: float) -> Float[np.ndarray, "n"]:
        """Return the clearance with the covering radius `cover_m` subtracted from the distance to the wall [m]."""
        return _worse(np.minimum(self.to_wall - cover_m, self.to_others), self.outside)


class CheckedScene:
    """Arm and wall to check; a wall's point p is at rotate @ p + translate in the world.

    Interior rule: beyond the depth `interior_depth_m` from the start of the wall, along its direction, the ends of all
    capsules' axes must lie in the hull. The rule does not apply if the part moves, or if the arm's base is also beyond
    this depth. If the wall has no direction, the rule is along the world's x axis, wherever the base is.

    Args:
        arm: The arm.
        wall: The wall.
        rotate: Rotation from the wall's frame to the world (3, 3).
        translate: Translation from the wall's frame to the world (3,) [m].
        interior_depth_m: Depth at which the interior rule begins.
        surroundings: Function with the arguments and result of `mujoco_cell.MujocoCell.distances`; None: no other
            obstacles.
        carried: Fixtures that move with links; the interior rule does not apply to them.
        by_hulls: Function with the arguments and result of `mujoco_cell.MujocoCell.by_hulls`; None: hulls are used only
            for distances from the wall.
    """

    def __init__(
        self,
        arm: MujocoArm,
        wall: Wall,
        rotate: np.ndarray,
        translate: np.ndarray,
        interior_depth_m: float,
        surroundings: Callable[[np.ndarray, ArmPoses, np.ndarray | None], np.ndarray] | None = None,
        carried: Sequence[CarriedBody] = (),
        by_hulls: Callable[[np.ndarray, ArmPoses, np.ndarray, np.ndarray], np.ndarray] | None = None,
    ):
        self.carried, self._others_by_hulls = carried, by_hulls
        self.surroundings = surroundings or (lambda x, arm_poses, may: np.empty((len(x), 0)))
        self.arm, self.wall, self.rotate, self.translate = arm, wall, rotate, translate
        self.along = np.array([1.0, 0.0, 0.0]) if wall.direction is None else rotate @ wall.direction
        self.interior_from = ((wall.corners @ rotate.T + translate) @ self.along).min(initial=np.inf) + interior_depth_m
        if arm.root or (wall.direction is not None and (arm.base @ self.along > self.interior_from).any()):
            self.interior_from = np.inf

    def at(
        self, x: Float[np.ndarray, "n N"], below: float | Float[np.ndarray, "n"] = -np.inf, cover_m: float = 0.0
    ) -> TargetClearances:
        """Return the clearance of every configuration.

        Args:
            x: Configurations [rad or m].
            below: Clearance below which hulls in capsules are measured [m]. A larger clearance may be returned as this
                value.
            cover_m: Covering radius of the wall's points [m], by which hulls are measured farther from the wall.
        """
        arm_poses = self.arm.arm_poses(x)
        pieces = _initial_pieces(self.arm, len(x))
        samples = _centres(arm_poses, pieces)
        distance = self.wall.tree.query(self.local(samples), workers=-1)[0]
        upper = _lowered(np.full(len(x), np.inf), pieces, distance - self.arm.radius[pieces.capsule])
        kept = pieces.only(self._may_hold(pieces, distance, upper))
        surroundings = self.surroundings(x, arm_poses, None)
        to_wall = self._measured(x, arm_poses, kept, upper)
        to_wall = np.minimum(to_wall, self.carried_clearance(x, to_wall))
        to_others = surroundings.min(axis=1, initial=np.inf)
        below = np.broadcast_to(below, len(x))
        doubt = self._in_doubt(np.minimum(to_wall - cover_m, to_others), below)
        if len(doubt):
            some = ArmPoses(*(values[doubt] for values in arm_poses))
            least = below[doubt] + cover_m
            near, to_others[doubt] = self._by_hulls(x[doubt], some, surroundings[doubt], below[doubt], least)
            to_wall[doubt] = np.where(to_wall[doubt] < least, np.minimum(near, least), to_wall[doubt])
        ends = np.concatenate([arm_poses.p, arm_poses.q], axis=1)
        outside = self._outside(ends, ends @ self.along > self.interior_from)
        each = len(x), len(pieces.row) // max(1, len(x))
        clearance = _worse(np.minimum(to_wall, to_others), outside)
        samples, distance = samples.reshape(*each, 3), distance.reshape(each)
        return TargetClearances(
            arm_poses, clearance, samples, distance, ends, outside, surroundings, to_others, to_wall
        )

    def between(
        self, x: Float[np.ndarray, "n N"], a: Int[np.ndarray, "n"], known: TargetClearances, below: float
    ) -> tuple[ArmPoses, Float[np.ndarray, "n"]]:
        """Return the clearance at configurations between configurations with known results, where it is small.

        The distance of a sample or of an axis's end changes by at most its displacement, and the distance of two bodies
        by at most both displacements. So most configurations need no measurement.

        Args:
            x: Configurations [rad or m].
            a: For each configuration, the row in `known` before it; it lies between the rows a and a + 1.
            known: The known results.
            below: Largest clearance of interest, at least 0 [m].

        Returns:
            The TCP and the capsules, and the clearance where it is at most `below`, inf elsewhere [m].
        """
        arm_poses = self.arm.arm_poses(x)
        pieces = _initial_pieces(self.arm, len(x))
        samples = _centres(arm_poses, pieces).reshape(len(x), -1, 3)
        near = [known.distance[b] - np.linalg.norm(samples - known.samples[b], axis=2) for b in (a, a + 1)]
        distance = np.maximum(0.0, np.maximum(*near)).reshape(-1)
        upper = np.full(len(x), below)
        kept = pieces.only(self._may_hold(pieces, distance, upper))
        ends = np.concatenate([arm_poses.p, arm_poses.q], axis=1)
        moved = [np.linalg.norm(ends - known.ends[b], axis=2) for b in (a, a + 1)]
        furthest = [each.max(axis=1, initial=0.0)[:, None] for each in moved]
        may = (
            np.maximum(known.surroundings[a] - 2 * furthest[0], known.surroundings[a + 1] - 2 * furthest[1])
            <= below + SOLVER_M
        )
        surroundings = self.surroundings(x, arm_poses, may)
        clearance = np.minimum(self._measured(x, arm_poses, kept, upper), surroundings.min(axis=1, initial=np.inf))
        clearance = np.minimum(clearance, self.carried_clearance(x, np.minimum(upper, clearance)))
        doubt = self._in_doubt(clearance, upper)
        if len(doubt):
            some = ArmPoses(*(values[doubt] for values in arm_poses))
            least = upper[doubt]
            clearance[doubt] = np.minimum(*self._by_hulls(x[doubt], some, surroundings[doubt], least, least))
        proven = [known.outside[b] + each < 0 for b, each in zip((a, a + 1), moved, strict=True)]
        outside = self._outside(ends, (ends @ self.along > self.interior_from) & ~proven[0] & ~proven[1])
        clearance = _worse(clearance, outside)
        return arm_poses, np.where(clearance <= below, clearance, np.inf)

    def carried_clearance(self, x: Float[np.ndarray, "n N"], upper: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the distance of fixtures that move with links from the wall [m]; exact only up to `upper`."""
        found, wall = np.full(len(x), np.inf), self.wall
        each = wall.middle[:, None] if wall.triangles is None else wall.triangles
        for body in self.carried if len(each) else ():
            (centre, radius), (position, axes) = body.ball, body.poses(x)
            middle = self.local(position + axes @ centre)
            near = np.minimum(np.maximum(upper, 0.0), wall.tree.query(middle)[0]) + radius + wall.grain + ROUNDING_M
            for k, points in enumerate(wall.tree.query_ball_point(middle, near)):
                if points:
                    world = each[points] @ self.rotate.T + self.translate
                    found[k] = min(found[k], body.clearance((world - position[k]) @ axes[k]))
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

    def _in_doubt(self, clearance: np.ndarray, below: np.ndarray) -> np.ndarray:
        """Return the rows in which hulls may have a larger clearance than capsules."""
        return np.flatnonzero(clearance < below) if any(self.arm.hulls) else np.empty(0, int)

    def _by_hulls(
        self, x: np.ndarray, arm_poses: ArmPoses, surroundings: np.ndarray, below: np.ndarray, to_wall: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances from the wall and from other obstacles, by hulls if capsules are within a bound [m].

        Args:
            x: Configurations [rad or m].
            arm_poses: The arm's capsules at these configurations.
            surroundings: Distances by capsules from the other obstacles [m].
            below: Bounds for the distances from the other obstacles [m].
            to_wall: Bounds for the distances from the wall [m]; a larger distance may be any number above its bound.
        """
        near = self._hulls_to_wall(arm_poses, to_wall)
        near = np.minimum(near, self.carried_clearance(x, np.minimum(near, to_wall)))
        if self._others_by_hulls is not None:
            surroundings = self._others_by_hulls(x, arm_poses, surroundings, below)
        return near, surroundings.min(axis=1, initial=np.inf)

    def _hulls_to_wall(self, arm_poses: ArmPoses, below: np.ndarray) -> np.ndarray:
        """Return the distance from the wall, by hulls or capsules without a hull [m]; inf if none is within `below`."""
        found, wall, arm = np.full(len(below), np.inf), self.wall, self.arm
        if not len(wall.middle):
            return found
        each = wall.middle[:, None] if wall.triangles is None else wall.triangles
        pieces = _initial_pieces(arm, len(below))
        centres = self.local(_centres(arm_poses, pieces))
        near = self._may_hold(pieces, wall.tree.query(centres, workers=-1)[0], below)
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

    def _measured(self, x: np.ndarray, arm_poses: ArmPoses, pieces: AxisPieces, upper: np.ndarray) -> np.ndarray:
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
            centres = self.local(_centres(arm_poses, pieces))
            distance = self.wall.tree.query(centres, distance_upper_bound=reach.max() + ROUNDING_M)[0]
            upper = _lowered(upper, pieces, distance - radius[pieces.capsule])
            kept = self._may_hold(pieces, distance, upper)
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

    def _may_hold(self, pieces: AxisPieces, distance: np.ndarray, upper: np.ndarray) -> np.ndarray:
        nearest = np.maximum(0.0, distance - self.wall.grain)
        least = np.sqrt(np.maximum(0.0, nearest**2 - pieces.half**2)) - self.arm.radius[pieces.capsule]
        return least <= upper[pieces.row] + ROUNDING_M

    def _outside(self, ends: np.ndarray, requested: np.ndarray) -> np.ndarray:
        found = np.full(requested.shape, np.nan)
        found[requested] = self.wall.outside(self.local(ends[requested]))
        return found

    def local(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Return world points transformed to the workpiece's frame [m]."""
        return (points - self.translate) @ self.rotate


def _initial_pieces(arm: MujocoArm, n: int) -> AxisPieces:
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


def _centres(arm_poses: ArmPoses, pieces: AxisPieces) -> np.ndarray:
    p, q = arm_poses.p[pieces.row, pieces.capsule], arm_poses.q[pieces.row, pieces.capsule]
    return p + pieces.centre[:, None] * (q - p)


def _equal_runs(row: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield first and last index (exclusive) of each run of equal numbers in a sorted array."""
    changes = np.flatnonzero(np.diff(row, prepend=-1, append=-1))
    return zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True)


def _lowered(upper: np.ndarray, pieces: AxisPieces, values: np.ndarray) -> np.ndarray:
    """Return each configuration's minimum of `upper` and of the values of its pieces."""
    upper = upper.copy()
    np.minimum.at(upper, pieces.row, values)
    return upper


def _worse(clearance: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Return the clearance after the interior rule [m].

    If ends of axes are outside the hull, it is at most minus their largest distance from the hull.
    """
    furthest = np.where(outside > 0, outside, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(furthest > 0, np.minimum(clearance, -furthest), clearance)
