"""Obstacles other than the workpiece, in MuJoCo: the arm itself, a cell's shapes, and further clouds.

The poses of the cell's shapes (`cell_geoms`) and the pairs to check are determined independently of the planner. The
cell's MuJoCo model contains the arm's capsules, placed by MuJoCo's kinematics; mj_geomDistance computes the distances.
If a capsule is nearer than required, the convex hull in it is also measured, as a mesh geom, and the larger distance is
used. A mesh that is not a solid is measured by its triangles, like a workpiece. A fixture that moves with a link has
its exact shape here, not the planner's capsules.
"""

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.spec import config
from htcp_jax.validation.cell_geoms import CellGeoms, Surface
from htcp_jax.validation.mujoco_arm import FAR_M, ArmPoses, MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall
from htcp_jax.validation.own_pairs import ALWAYS, NEAR_M, SEED, OwnPairs, own_pairs, touch_m

SAMPLES = 2_000  # number of random configurations, to find pairs that nearly always overlap


class MujocoCell:
    """An arm and the obstacles in a job's cell.

    `bound` is True if a correct planner may save a smaller clearance than this class measures: for meshes that it
    represents by points, for fixtures that move with links, and for obstacles without shapes (`unmeasured`).

    Args:
        cell: The job's cell.
        arm: The arm with the job's tool.
        plain: The arm without a tool extension, as in the model.

    Raises:
        InputError: If MuJoCo cannot read a file.
    """

    def __init__(self, cell: config.CellConfig, arm: MujocoArm, plain: MujocoArm):
        geoms = CellGeoms(cell, arm)
        self._arm, self._model, self._data = arm, geoms.model, geoms.data
        self._bodies, self._hulls, self.carried = geoms.bodies, geoms.hulls, geoms.carried
        self.unmeasured = geoms.unmeasured
        meshes = [each for each in geoms.surfaces if len(each.triangles)]
        self.bound = bool(self.unmeasured or meshes or self.carried)
        self.walls = [self._wall(surface) for surface in geoms.surfaces]
        self.deepest = 0.0, ""  # largest overlap of unchecked capsules [m], and their names
        self._own = own_pairs(plain, self._apart) if cell.self_collision else OwnPairs([], [], [])
        self._pairs = [(self._bodies[a], self._bodies[b]) for a, b in self._own.checked]
        self._pairs += self._pairs_of_arm(geoms.solids, geoms.excluded, plain)
        self._carried_pairs = self._pairs_of_carried(geoms.solids, geoms.excluded, cell.self_collision)

    def _pairs_of_arm(
        self, solids: Sequence[int], excluded: Mapping[int, frozenset[int]], plain: MujocoArm
    ) -> list[tuple[int, int]]:
        """Return the pairs of a body of the arm and a solid, except those that touch where the arm stands."""
        arm = self._arm
        checked = [
            (body, g)
            for body, link in zip(self._bodies, arm.links, strict=True)
            for g in solids
            if link > 0 and link not in excluded.get(g, ())
        ]
        first = {self._bodies[k] for k in range(len(arm.links)) if arm.links[k] == 1 and not arm.root}
        at_zero = self._distances(plain.arm_poses(np.zeros((1, len(plain.joints)))), checked).min(axis=0)
        return [pair for pair, D in zip(checked, at_zero, strict=True) if D > 0 or pair[0] not in first]

    def distances(
        self, x: Float[np.ndarray, "n N"], arm_poses: ArmPoses, may: Bool[np.ndarray, "n R"] | None = None
    ) -> Float[np.ndarray, "n R"]:
        """Return the distances of all pairs that must not touch [m].

        Args:
            x: Configurations [rad or m].
            arm_poses: The arm's capsules at these configurations.
            may: Mask of the distances to compute; all others are inf. None: all are computed.

        Returns:
            In the first columns, the distances of pairs of shapes; then the distances to walls. The last column is the
            distance of fixtures that move with links; it is negative if meshes touch inside unchecked capsules.
        """
        may = np.ones((len(x), len(self._pairs) + len(self.walls) + 1), bool) if may is None else may
        to_walls = np.full((len(x), len(self.walls)), np.inf)
        for column, rows, wall in zip(to_walls.T, may[:, len(self._pairs) : -1].T, self.walls, strict=True):
            column[rows] = wall.at(x[rows]).clearance
        # Meshes in unchecked capsules, and fixtures that move with a link, are always measured.
        last = np.minimum(self._of_excluded(x, arm_poses), self._of_carried(x, arm_poses))[:, None]
        return np.hstack([self._distances(arm_poses, self._pairs, may[:, : len(self._pairs)]), to_walls, last])

    def by_hulls(
        self,
        x: Float[np.ndarray, "n N"],
        arm_poses: ArmPoses,
        capsules: Float[np.ndarray, "n R"],
        below: Float[np.ndarray, "n"],
    ) -> Float[np.ndarray, "n R"]:
        """Return the distances of `distances`, by hulls instead of capsules where capsules are nearer than `below` [m].

        Args:
            x: Configurations [rad or m].
            arm_poses: The arm's capsules at these configurations.
            capsules: The distances by capsules, see `distances`.
            below: Distance below which hulls are measured [m]. A larger distance to a wall may be returned as this
                value.
        """
        found, doubt, count = capsules.copy(), capsules < below[:, None], len(self._pairs)
        pairs = self._distances(arm_poses, self._pairs, doubt[:, :count], below)
        found[:, :count] = np.where(doubt[:, :count], pairs, capsules[:, :count])
        for k, wall in enumerate(self.walls, count):
            own = doubt[:, k]
            found[own, k] = wall.at(x[own], below[own]).clearance
        found[:, -1] = np.minimum(self._of_excluded(x, arm_poses), self._of_carried(x, arm_poses, below))
        return found

    def _of_excluded(self, x: Float[np.ndarray, "n N"], arm_poses: ArmPoses) -> Float[np.ndarray, "n"]:
        """Return the negated penetration depth of meshes that touch inside unchecked capsules [m]; inf if none."""
        pairs, found = [*self._own.by_mesh, *self._own.excluded], np.full(len(x), np.inf)
        depth = -self._apart(arm_poses, pairs)
        if depth.size and depth.max() > self.deepest[0]:
            a, b = pairs[int(depth.max(axis=0).argmax())]
            self.deepest = float(depth.max()), f"{self._arm.names[a]} and {self._arm.names[b]}"
        for k, pair in enumerate(self._own.by_mesh):
            for row in np.flatnonzero(~(depth[:, k] <= 0)):
                if not (deep := touch_m(self._arm, pair, x[row])) <= 0:
                    found[row] = np.minimum(found[row], -deep)
        return found

    def _of_carried(
        self, x: Float[np.ndarray, "n N"], arm_poses: ArmPoses, below: Float[np.ndarray, "n"] | None = None
    ) -> Float[np.ndarray, "n"]:
        """Return the distance of fixtures that move with links from all bodies except the workpiece [m]."""
        if not self.carried:
            return np.full(len(x), np.inf)
        found = self._carried_distances(x, arm_poses, self._carried_pairs, below).min(axis=1, initial=np.inf)
        for wall in self.walls:
            found = np.minimum(found, wall.carried_clearance(x, found))
        return found

    def _carried_distances(
        self,
        x: Float[np.ndarray, "n N"],
        arm_poses: ArmPoses,
        pairs: Sequence[tuple[int, int]],
        below: Float[np.ndarray, "n"] | None = None,
    ) -> Float[np.ndarray, "n R"]:
        found, places = np.empty((len(x), len(pairs))), {body.geom: body.poses(x) for body in self.carried if pairs}
        for k in range(len(x)):
            for geom, (position, axes) in places.items():
                self._data.geom_xpos[geom], self._data.geom_xmat[geom] = position[k], axes[k].ravel()
            one = ArmPoses(*(values[k : k + 1] for values in arm_poses))
            found[k] = self._distances(one, pairs, None, None if below is None else below[k : k + 1])[0]
        return found

    def _pairs_of_carried(
        self, solids: Sequence[int], excluded: Mapping[int, frozenset[int]], self_collision: bool
    ) -> list[tuple[int, int]]:
        """Return the pairs of a fixture that moves with a link and another fixture or a body of the arm.

        Pairs that nearly always overlap are excluded.
        """
        arm, carried = self._arm, self.carried
        found = [(body.geom, g) for body in carried for g in solids if body.link not in excluded.get(g, ())]
        if not (self_collision and carried):
            return found
        bodies = [(g, link, frozenset()) for g, link in zip(self._bodies, arm.links, strict=True)]
        apart = []
        for k, body in enumerate(carried):
            others = [*bodies, *((other.geom, other.link, other.excluded) for other in carried[k + 1 :])]
            apart += [
                (body.geom, g)
                for g, link, theirs in others
                if link != body.link and link not in body.excluded and body.link not in theirs
            ]
        x = arm.random(SAMPLES, SEED)
        near = (self._carried_distances(x, arm.arm_poses(x), apart) <= NEAR_M).mean(axis=0)
        return found + [pair for pair, share in zip(apart, near.tolist(), strict=True) if share < ALWAYS]

    def _apart(self, arm_poses: ArmPoses, pairs: Sequence[tuple[int, int]]) -> Float[np.ndarray, "n R"]:
        return self._distances(arm_poses, [(self._bodies[a], self._bodies[b]) for a, b in pairs])

    def _distances(
        self,
        arm_poses: ArmPoses,
        pairs: Sequence[tuple[int, int]],
        may: Bool[np.ndarray, "n R"] | None = None,
        below: Float[np.ndarray, "n"] | None = None,
    ) -> Float[np.ndarray, "n R"]:
        found = np.full((len(arm_poses.p), len(pairs)), np.inf)
        bodies = {geom: k for k, geom in enumerate(self._bodies)}
        for k, (p, q) in enumerate(zip(arm_poses.p, arm_poses.q, strict=True)):
            own = range(len(pairs)) if may is None else np.flatnonzero(may[k]).tolist()
            for geom in {geom for pair in own for geom in pairs[pair]} & bodies.keys():
                self._pose(geom, p[bodies[geom]], q[bodies[geom]])
            for pair in own:
                found[k, pair] = mujoco.mj_geomDistance(self._model, self._data, *pairs[pair], FAR_M, None)
                if below is not None and found[k, pair] < below[k] and set(pairs[pair]) & self._hulls.keys():
                    one = ArmPoses(*(values[k] for values in arm_poses))
                    found[k, pair] = max(found[k, pair], self._of_hulls(one, pairs[pair]))
        return found

    def _of_hulls(self, pose: ArmPoses, pair: tuple[int, int]) -> float:
        """Return the distance of a pair, by the hulls in its capsules, at one configuration [m]."""
        thickness, model = 0.0, self._model
        for geom in self._hulls.keys() & pair:
            k, hull = self._bodies.index(geom), self._hulls[geom]
            mesh, turn = model.geom_dataid[hull], np.empty(9)
            mujoco.mju_quat2Mat(turn, model.mesh_quat[mesh])  # in MuJoCo a mesh's frame is its inertial frame
            self._data.geom_xpos[hull] = (pose.p[k] + pose.q[k]) / 2 + pose.axes[k] @ model.mesh_pos[mesh]
            self._data.geom_xmat[hull] = (pose.axes[k] @ turn.reshape(3, 3)).ravel()
            thickness += self._arm.hulls[k].radius
        geoms = (self._hulls.get(geom, geom) for geom in pair)
        return mujoco.mj_geomDistance(model, self._data, *geoms, FAR_M, None) - thickness

    def _pose(self, geom: int, p: Float[np.ndarray, "3"], q: Float[np.ndarray, "3"]) -> None:
        """Set the pose of a geom of the arm so that its axis is from p to q, world [m]."""
        axis, length = p - q, math.dist(p, q)
        self._data.geom_xpos[geom], self._model.geom_size[geom, 1] = (p + q) / 2, length / 2
        if length:
            turn = np.empty(4)
            mujoco.mju_quatZ2Vec(turn, axis / length)
            mujoco.mju_quat2Mat(self._data.geom_xmat[geom], turn)

    def _wall(self, surface: Surface) -> CheckedScene:
        arm = self._arm.only(~np.isin(self._arm.links, [0, *surface.excluded]))
        carried = [body for body in self.carried if body.link not in surface.excluded]
        wall = Wall(surface.points, "none", None, surface.triangles if len(surface.triangles) else None)
        return CheckedScene(arm, wall, surface.R, surface.t, 0.0, carried=carried)
