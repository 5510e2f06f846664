"""Obstacles other than the workpiece, in MuJoCo: the arm itself, a cell's shapes, and further clouds.

The cell's file is read again; the poses of its shapes and the pairs to check are determined independently of the
planner. The cell's MuJoCo model contains the arm's capsules, placed by MuJoCo's kinematics; mj_geomDistance computes
the distances. If a capsule is nearer than required, the convex hull in it is also measured, as a mesh geom, and the
larger distance is used. MuJoCo replaces a non-convex mesh by its hull, so such a mesh is measured by its triangles,
like a workpiece. A fixture that moves with a link has its exact shape here, not the planner's capsules.
"""

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError
from htcp_jax.io.parts import load_geometry
from htcp_jax.io.robots import safe_xml
from htcp_jax.jobs import config, given_kinds
from htcp_jax.model import fixture
from htcp_jax.validation.carried import CarriedBody
from htcp_jax.validation.mujoco_arm import FAR_M, ArmPoses, MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall
from htcp_jax.validation.own_pairs import ALWAYS, NEAR_M, SEED, OwnPairs, own_pairs, touch_m

SAMPLES = 2_000  # number of random configurations, to find pairs that nearly always overlap
MOST_FACES = 400  # maximum number of faces of a mesh that is treated as convex
_TYPES = {kind: getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}") for kind in fixture.PRIMITIVES}
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # also valid for meshes without volume
_CAPSULE, _MESH = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_MESH


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
        self._arm, self.walls = arm, []
        spec = mujoco.MjSpec() if cell.model is None else _spec(Path(cell.model))
        for k, radius in enumerate(arm.radius.tolist()):
            spec.worldbody.add_geom(name=f"body {k} of the arm", type=_CAPSULE, size=[radius, 1, 0])
        hulls = {k: hull for k, hull in enumerate(arm.hulls) if hull is not None}
        for k, hull in hulls.items():
            name = f"hull {k} of the arm"
            spec.add_mesh(name=name, uservert=hull.points.ravel(), inertia=_SHELL)
            spec.worldbody.add_geom(name=name, type=_MESH, meshname=name)
        given = [given_kinds.shapes_in_world(kind) for kind in cell.obstacles]
        self.unmeasured = [kind.name for kind, shapes in zip(cell.obstacles, given, strict=True) if not shapes]
        self.bound = bool(self.unmeasured)
        shapes = [shape for own in given for shape in own]
        for k, shape in enumerate(shapes):
            size = [0, 0, 1] if shape.kind == "plane" else shape.size  # MuJoCo requires a grid spacing
            spec.worldbody.add_geom(name=f"shape {k} of the job", type=_TYPES[shape.kind], size=size)
        rules = {each.name: each for each in cell.fixtures}
        standing = arm.link_of(config.WORLD)  # not 0 if the part moves, as the world then moves relative to it
        carriers = {name: arm.link_of(each.parent) for name, each in rules.items()}
        stems = {f"cloud {k} of the job": Path(cloud.cloud).stem for k, cloud in enumerate(cell.clouds)}
        for (name, stem), cloud in zip(stems.items(), cell.clouds, strict=True):
            if carriers.get(stem, standing):
                R, t = _pose_of(cloud.base_m, cloud.base_rpy_rad)
                corners = load_geometry(cloud.cloud, cloud.unit).triangles.reshape(-1, 3) @ R.T + t
                spec.add_mesh(name=name, uservert=corners.ravel())
                spec.worldbody.add_geom(name=name, type=_MESH, meshname=name)
        try:
            self._model = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise InputError(f"{cell.model}: not a cell that MuJoCo can read: {' '.join(str(error).split())}") from None
        self._bodies = [self._model.geom(f"body {k} of the arm").id for k in range(len(arm.radius))]
        self._hulls = {self._bodies[k]: self._model.geom(f"hull {k} of the arm").id for k in hulls}
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        names = [_name(self._model, g) for g in range(self._model.ngeom)]
        own = {g: rules[stem] for g, name in enumerate(names) if (stem := stems.get(name, name)) in rules}
        if standing:
            arm_geoms = {*self._bodies, *self._hulls.values()}
            others = {g: stems.get(name, name) for g, name in enumerate(names) if g not in {*own, *arm_geoms}}
            own |= {g: config.FixtureConfig(name=name) for g, name in others.items()}
        known = {each.name for each in own.values()} | set(stems.values())
        if unnamed := [name for name in rules if name not in known]:
            raise InputError(f"{cell.model}: no geom or body {unnamed[0]!r}; give the fixture's geom this name")
        excluded = {g: frozenset(map(arm.link_of, each.exclude)) for g, each in own.items()}
        drawn = self._data.geom_xpos.copy(), self._data.geom_xmat.copy()
        if cell.model is not None:
            _move(self._model, self._data, cell)
        moved = self._data.geom_xpos.copy(), self._data.geom_xmat.copy()
        self.carried = [
            self._carried(g, each, excluded[g], *(moved if each.parent == config.WORLD else drawn))
            for g, each in own.items()
            if carriers.get(each.name, standing)
        ]
        for g, each in own.items():
            if each.parent != config.WORLD:
                self._place(g, each.parent, drawn[0][g], drawn[1][g].reshape(3, 3))
        for k, shape in enumerate(shapes):
            geom = self._model.geom(f"shape {k} of the job").id
            self._data.geom_xpos[geom], self._data.geom_xmat[geom] = shape.T_world[:3, 3], shape.T_world[:3, :3].ravel()
        others = {*self._bodies, *self._hulls.values(), *(body.geom for body in self.carried)}
        solids = [
            g
            for g in range(self._model.ngeom)
            if g not in others and not self._is_hollow(g, excluded.get(g, frozenset()))
        ]
        for cloud in cell.clouds:
            R, t = _pose_of(cloud.base_m, cloud.base_rpy_rad)
            name = Path(cloud.cloud).stem
            if name in rules and rules[name].parent != config.WORLD:
                (origin,), (rotation,) = arm.frames(np.zeros((1, len(arm.joints))), rules[name].parent, tip=False)
                R, t = rotation @ R, rotation @ t + origin
            if not carriers.get(name, standing):
                found = load_geometry(cloud.cloud, cloud.unit)
                apart = frozenset(map(arm.link_of, rules[name].exclude if name in rules else ()))
                self._add_wall(found.points, found.triangles, R, t, apart)
        self._own = own_pairs(plain, self._apart) if cell.self_collision else OwnPairs([], [], [])
        self.deepest = 0.0, ""  # largest overlap of unchecked capsules [m], and their names
        self._pairs = [(self._bodies[a], self._bodies[b]) for a, b in self._own.checked]
        checked = [
            (body, g)
            for body, link in zip(self._bodies, arm.links, strict=True)
            for g in solids
            if link > 0 and link not in excluded.get(g, ())
        ]
        first = {self._bodies[k] for k in range(len(arm.links)) if arm.links[k] == 1 and not arm.root}
        at_zero = self._distances(plain.arm_poses(np.zeros((1, len(plain.joints)))), checked).min(axis=0)
        self._pairs += [pair for pair, D in zip(checked, at_zero, strict=True) if D > 0 or pair[0] not in first]
        self._carried_pairs = self._pairs_of_carried(solids, excluded, cell.self_collision)
        self.bound |= bool(self.carried)

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
            for row in np.flatnonzero(depth[:, k] > 0):
                if (deep := touch_m(self._arm, pair, x[row])) > 0:
                    found[row] = min(found[row], -deep)
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
        self, solids: Sequence[int], excluded: dict[int, frozenset[int]], self_collision: bool
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

    def _carried(
        self, geom: int, rule: config.FixtureConfig, excluded: frozenset[int], positions: np.ndarray, axes: np.ndarray
    ) -> CarriedBody:
        """Return the body of a geom, in its parent's frame.

        Args:
            geom: The geom.
            rule: The fixture's entry in the job.
            excluded: Links from which no distance is checked.
            positions: Positions of all geoms, world [m].
            axes: Orientations of all geoms, as rows of 9 numbers.
        """
        model = self._model
        if model.geom_type[geom] == _MESH:
            mesh = model.mesh(model.geom_dataid[geom])
            corners = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]].astype(float)
        else:
            corners = np.array(list(itertools.product((-1, 1), repeat=3))) * model.geom_size[geom]
        R, t = axes[geom].reshape(3, 3), positions[geom]
        return CarriedBody(geom, rule.parent, self._arm.link_of(rule.parent), excluded, R, t, corners, self._arm)

    def _place(self, geom: int, parent: str, t: np.ndarray, R: np.ndarray) -> None:
        """Set a geom's pose, given relative to a parent frame, for zero joint values."""
        (origin,), (rotation,) = self._arm.frames(np.zeros((1, len(self._arm.joints))), parent, tip=False)
        self._data.geom_xpos[geom], self._data.geom_xmat[geom] = rotation @ t + origin, (rotation @ R).ravel()

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

    def _is_hollow(self, geom: int, excluded: frozenset[int]) -> bool:
        """Return True if a geom is a non-convex mesh; such a mesh is added as a wall of triangles."""
        import trimesh  # here, as the import is slow and few cells need it

        model = self._model
        if model.geom_type[geom] != _MESH:
            return False
        mesh = model.mesh(model.geom_dataid[geom])
        corners = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
        triangles = corners[model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]].astype(float)
        solid = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
        if solid.is_convex and len(triangles) <= MOST_FACES:
            return False
        R, t = self._data.geom_xmat[geom].reshape(3, 3), self._data.geom_xpos[geom]
        self._add_wall(triangles.reshape(-1, 3), triangles, R.copy(), t.copy(), excluded)
        return True

    def _add_wall(
        self, points: np.ndarray, triangles: np.ndarray, R: np.ndarray, t: np.ndarray, excluded: frozenset[int]
    ) -> None:
        arm = self._arm.only(~np.isin(self._arm.links, [0, *excluded]))
        carried = [body for body in self.carried if body.link not in excluded]
        self.bound |= len(triangles) > 0
        wall = Wall(points, "none", None, triangles if len(triangles) else None)
        self.walls.append(CheckedScene(arm, wall, R, t, 0.0, carried=carried))


def _name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or of its body if it has none."""
    body = int(model.geom_bodyid[geom])
    return model.geom(geom).name or (model.body(body).name if body else "")


def _spec(path: Path) -> mujoco.MjSpec:
    """Return the parsed cell file, without geoms that have no contacts."""
    spec = safe_xml.read_spec(path, meshes=True)
    spec.modelfiledir = str(path.parent.resolve())
    for geom in list(spec.geoms):
        if not (geom.contype or geom.conaffinity):
            spec.delete(geom)
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True
    return spec


def _move(model: mujoco.MjModel, data: mujoco.MjData, cell: config.CellConfig) -> None:
    """Apply the job's rotation and shift to the cell's geoms."""
    body = 0 if cell.moved is None else model.body(cell.moved).id
    origin = np.zeros(3) if body == 0 else data.xpos[body].copy()
    R, shift = _pose_of(cell.shift_m, cell.rpy_rad)
    for geom in range(model.ngeom):
        carrier = int(model.geom_bodyid[geom])
        while carrier not in (0, body):
            carrier = int(model.body_parentid[carrier])
        if carrier == body:
            data.geom_xpos[geom] = R @ (data.geom_xpos[geom] - origin) + origin + shift
            data.geom_xmat[geom] = (R @ data.geom_xmat[geom].reshape(3, 3)).ravel()


def _pose_of(position: tuple, rpy: tuple) -> tuple[np.ndarray, np.ndarray]:
    quaternion, R = np.empty(4), np.empty(9)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy), "XYZ")
    mujoco.mju_quat2Mat(R, quaternion)
    return R.reshape(3, 3), np.array(position)
