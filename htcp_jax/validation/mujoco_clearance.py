"""Clearance of MuJoCo's arm from the wall, other obstacles and fixtures that move with links, for validation.

If a capsule is nearer than required and contains a convex hull of a mesh, the larger of both distances is used
(`convex_hull`). `wall_distances` has the distances from the wall.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.spec import config
from htcp_jax.validation.carried import CarriedBody
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm
from htcp_jax.validation.scene_rules import WorkpieceData
from htcp_jax.validation.wall_distances import ROUNDING_M, Wall, WallDistances, centres_of, initial_pieces, lowered

SOLVER_M = 1e-5  # error of mj_geomDistance, which is iterative


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


class CheckedScene(WallDistances):
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
        super().__init__(arm, wall, rotate, translate)
        self.carried, self._others_by_hulls = carried, by_hulls
        self.surroundings = surroundings or (lambda x, arm_poses, may: np.empty((len(x), 0)))
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
        pieces = initial_pieces(self.arm, len(x))
        samples = centres_of(arm_poses, pieces)
        distance = self.wall.tree.query(self.local(samples), workers=-1)[0]
        upper = lowered(np.full(len(x), np.inf), pieces, distance - self.arm.radius[pieces.capsule])
        kept = pieces.only(self.may_hold(pieces, distance, upper))
        surroundings = self.surroundings(x, arm_poses, None)
        to_wall = self.measured(x, arm_poses, kept, upper)
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
        outside = self.ends_outside(ends, ends @ self.along > self.interior_from)
        each = len(x), len(pieces.row) // max(1, len(x))
        clearance = _worse(np.minimum(to_wall, to_others), outside)
        samples, distance = samples.reshape(*each, 3), distance.reshape(each)
        return TargetClearances(
            arm_poses, clearance, samples, distance, ends, outside, surroundings, to_others, to_wall
        )

    def between(
        self,
        x: Float[np.ndarray, "n N"],
        a: Int[np.ndarray, "n"],
        known: TargetClearances,
        below: float,
        recorded: float | Float[np.ndarray, "n"] = -np.inf,
    ) -> tuple[ArmPoses, Float[np.ndarray, "n"]]:
        """Return the clearance at configurations between configurations with known results, where it is small.

        The distance of a sample or of an axis's end changes by at most its displacement, and the distance of two bodies
        by at most both displacements. So most configurations need no measurement.

        Args:
            x: Configurations [rad or m].
            a: For each configuration, the row in `known` before it; it lies between the rows a and a + 1.
            known: The known results.
            below: Largest clearance of interest, at least 0 [m].
            recorded: Clearance recorded there [m]; hulls are measured in capsules that have less.

        Returns:
            The TCP and the capsules, and the clearance where it is at most `below`, inf elsewhere [m].
        """
        arm_poses = self.arm.arm_poses(x)
        pieces = initial_pieces(self.arm, len(x))
        samples = centres_of(arm_poses, pieces).reshape(len(x), -1, 3)
        near = [known.distance[b] - np.linalg.norm(samples - known.samples[b], axis=2) for b in (a, a + 1)]
        distance = np.maximum(0.0, np.maximum(*near)).reshape(-1)
        upper = np.full(len(x), below)
        kept = pieces.only(self.may_hold(pieces, distance, upper))
        ends = np.concatenate([arm_poses.p, arm_poses.q], axis=1)
        moved = [np.linalg.norm(ends - known.ends[b], axis=2) for b in (a, a + 1)]
        furthest = [each.max(axis=1, initial=0.0)[:, None] for each in moved]
        may = ~(  # True also for NaN, as in all comparisons below
            np.maximum(known.surroundings[a] - 2 * furthest[0], known.surroundings[a + 1] - 2 * furthest[1])
            > below + SOLVER_M
        )
        surroundings = self.surroundings(x, arm_poses, may)
        clearance = np.minimum(self.measured(x, arm_poses, kept, upper), surroundings.min(axis=1, initial=np.inf))
        clearance = np.minimum(clearance, self.carried_clearance(x, np.minimum(upper, clearance)))
        enough = np.maximum(upper, recorded)
        doubt = self._in_doubt(np.where(clearance <= below, clearance, np.inf), enough)
        if len(doubt):
            some = ArmPoses(*(values[doubt] for values in arm_poses))
            least = enough[doubt]
            clearance[doubt] = np.minimum(*self._by_hulls(x[doubt], some, surroundings[doubt], least, least))
        proven = [known.outside[b] + each < 0 for b, each in zip((a, a + 1), moved, strict=True)]
        outside = self.ends_outside(ends, (ends @ self.along > self.interior_from) & ~proven[0] & ~proven[1])
        clearance = _worse(clearance, outside)
        return arm_poses, np.where(clearance > below, np.inf, clearance)

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
        near = self.hulls_to_wall(arm_poses, to_wall)
        near = np.minimum(near, self.carried_clearance(x, np.minimum(near, to_wall)))
        if self._others_by_hulls is not None:
            surroundings = self._others_by_hulls(x, arm_poses, surroundings, below)
        return near, surroundings.min(axis=1, initial=np.inf)


def _worse(clearance: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Return the clearance after the interior rule [m].

    If ends of axes are outside the hull, it is at most minus their largest distance from the hull.
    """
    furthest = np.where(outside > 0, outside, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(furthest > 0, np.minimum(clearance, -furthest), clearance)
