"""The geoms of a job's cell in MuJoCo: the arm's capsules, solids, surfaces, and fixtures that move with a link.

Vertices and faces of meshes are those that the planner reads, and so is the distinction of solids and surfaces, so that
both check the same bodies. All poses are computed by MuJoCo, and by the rules of the job, which are implemented here a
second time. MuJoCo replaces a mesh by its convex hull, which is exact for solids. A surface remains triangles, a wall
without thickness with two sides. It does not become a geom, so that also a flat sheet, which has no hull, is checked.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import THIN_M, read_meshes, thickness_m
from htcp_jax.io.parts import load_geometry
from htcp_jax.jobs import shapes_in_world
from htcp_jax.model import fixture
from htcp_jax.spec import config
from htcp_jax.validation.carried import CarriedBody
from htcp_jax.validation.mujoco_arm import MujocoArm

BODY, HULL, SHAPE = "body {} of the arm", "hull {} of the arm", "shape {} of the job"
MESH, CLOUD = "mesh {} of the cell", "cloud {} of the job"
_TYPES = {kind: getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}") for kind in fixture.PRIMITIVES}
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # also valid for meshes without volume
_CAPSULE, _MESH = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_MESH
_CORNERS = np.array(list(itertools.product((-1, 1), repeat=3)))


class Surface(NamedTuple):
    """A cloud or a mesh that is not a solid, at its pose in the world; it does not move."""

    points: Float[np.ndarray, "P 3"]
    triangles: Float[np.ndarray, "F 3 3"]  # none for a cloud
    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, "3"]
    excluded: frozenset[int]  # links from which no distance is checked


class _Rules:
    """The job's rules for its fixtures, by name."""

    def __init__(self, cell: config.CellConfig, arm: MujocoArm):
        self.of = {each.name: each for each in cell.fixtures}
        self._world = arm.link_of(config.WORLD)  # not 0 if the part moves, as the world then moves relative to it
        self._carriers = {name: arm.link_of(each.parent) for name, each in self.of.items()}
        self._excluded = {name: frozenset(map(arm.link_of, each.exclude)) for name, each in self.of.items()}

    def rule(self, name: str) -> config.FixtureConfig:
        """Return the rule for a fixture."""
        return self.of.get(name) or config.FixtureConfig(name=name)

    def moves(self, name: str) -> bool:
        """Return True if a moving link carries a fixture."""
        return self._carriers.get(name, self._world) != 0

    def excluded(self, name: str) -> frozenset[int]:
        """Return the links from which a fixture's distance is not checked."""
        return self._excluded.get(name, frozenset())


class CellGeoms:
    """Geoms of an arm and of the obstacles in a job's cell.

    `data` contains their poses in the world [m]: those of fixed geoms for zero joint values, any others for `bodies`,
    `hulls` and `carried`. `bodies` are the geoms of the arm's capsules, `hulls` those of the pieces in them, by
    capsule's geom. `solids` are fixed geoms, `surfaces` other fixed obstacles, `carried` the fixtures on moving links.
    `excluded` contains, by geom, the links from which no distance is checked. `unmeasured` names obstacles without
    shapes.

    Args:
        cell: The job's cell.
        arm: The arm with the job's tool.

    Raises:
        InputError: If a file cannot be read, or if a fixture in the job is unknown.
    """

    def __init__(self, cell: config.CellConfig, arm: MujocoArm):
        self._arm, self._rules = arm, _Rules(cell, arm)
        self._corners: dict[str, np.ndarray] = {}  # corners of meshes in the model, by the mesh's name
        self._triangles: list[tuple[mujoco.MjsGeom, np.ndarray]] = []
        given = [shapes_in_world(kind) for kind in cell.obstacles]
        self.unmeasured = [kind.name for kind, shapes in zip(cell.obstacles, given, strict=True) if not shapes]
        shapes = [shape for own in given for shape in own]
        spec = mujoco.MjSpec() if cell.model is None else self._read_model(Path(cell.model))
        self._add_arm(spec)
        for k, shape in enumerate(shapes):
            size = [0, 0, 1] if shape.kind == "plane" else shape.size  # MuJoCo requires a grid spacing
            spec.worldbody.add_geom(name=SHAPE.format(k), type=_TYPES[shape.kind], size=size)
        names_of_clouds = self._add_moving_clouds(spec, cell.clouds)
        self.model = _compiled(spec, cell.model)
        self.data = mujoco.MjData(self.model)
        self.bodies = [self._geom(BODY, k) for k in range(len(arm.radius))]
        self.hulls = {self.bodies[k]: self._geom(HULL, k) for k, hull in enumerate(arm.hulls) if hull is not None}
        fixtures = self._names_of_fixtures(spec, names_of_clouds)
        self._check_names(cell, [*fixtures.values(), *map(_stem, cell.clouds)])
        self.excluded = {g: self._rules.excluded(name) for g, name in fixtures.items()}
        self.carried = self._place_fixtures(cell, fixtures)
        for k, shape in enumerate(shapes):
            self._place(self._geom(SHAPE, k), shape.T_world[:3, 3], shape.T_world[:3, :3])
        self.surfaces = [*self._surfaces_of_model(), *self._surfaces_of_clouds(cell.clouds)]
        others = {*self.bodies, *self.hulls.values(), *(body.geom for body in self.carried)}
        others |= {int(geom.id) for geom, _ in self._triangles}
        self.solids = [g for g in range(self.model.ngeom) if g not in others]

    def _geom(self, name: str, k: int) -> int:
        return self.model.geom(name.format(k)).id

    # Before MuJoCo compiles the model

    def _read_model(self, path: Path) -> mujoco.MjSpec:
        """Return the cell's file without geoms that have no contacts, and with hulls for solids and moving meshes."""
        spec, meshes = read_meshes(path)
        for k, (geom, triangles, is_solid) in enumerate(meshes):
            moves = self._rules.moves(_name(geom))
            corners = np.unique(triangles.reshape(-1, 3), axis=0)
            if moves or (is_solid and thickness_m(corners) >= THIN_M):
                geom.type, geom.meshname = _MESH, MESH.format(k)
                self._add_mesh(spec, MESH.format(k), corners)
            else:
                self._triangles.append((geom, triangles))
        for geom in list(spec.geoms):
            if not (geom.contype or geom.conaffinity):
                spec.delete(geom)
        return spec

    def _add_arm(self, spec: mujoco.MjSpec) -> None:
        for k, (radius, hull) in enumerate(zip(self._arm.radius.tolist(), self._arm.hulls, strict=True)):
            spec.worldbody.add_geom(name=BODY.format(k), type=_CAPSULE, size=[radius, 1, 0])
            if hull is not None:
                name = HULL.format(k)
                spec.add_mesh(name=name, uservert=hull.points.ravel(), inertia=_SHELL)
                spec.worldbody.add_geom(name=name, type=_MESH, meshname=name)

    def _add_moving_clouds(self, spec: mujoco.MjSpec, clouds: Sequence[config.CloudConfig]) -> dict[str, str]:
        """Add the clouds that move with a link; return the fixtures' names by geom."""
        found = {CLOUD.format(k): cloud for k, cloud in enumerate(clouds) if self._rules.moves(_stem(cloud))}
        for name, cloud in found.items():
            R, t = _pose_of(cloud.base_m, cloud.base_rpy_rad)
            self._add_mesh(spec, name, load_geometry(cloud.cloud, cloud.unit).triangles.reshape(-1, 3) @ R.T + t)
            spec.worldbody.add_geom(name=name, type=_MESH, meshname=name)
        return {name: _stem(cloud) for name, cloud in found.items()}

    def _add_mesh(self, spec: mujoco.MjSpec, name: str, corners: Float[np.ndarray, "V 3"]) -> None:
        """Add the convex hull of corners, about their centre, as MuJoCo stores vertices as 32-bit numbers."""
        if thickness_m(corners) < THIN_M:  # it would have no hull
            corners = (corners[:, None] + THIN_M / 2 * _CORNERS).reshape(-1, 3)
        self._corners[name] = corners
        spec.add_mesh(name=name, uservert=(corners - _centre(corners)).ravel(), inertia=_SHELL)

    # After MuJoCo has compiled the model

    def _names_of_fixtures(self, spec: mujoco.MjSpec, names_of_clouds: Mapping[str, str]) -> dict[int, str]:
        """Return the names of all geoms that are not the arm's, by geom."""
        own, names = {*self.bodies, *self.hulls.values()}, {int(geom.id): _name(geom) for geom in spec.geoms}
        return {g: names_of_clouds.get(name, name) for g, name in sorted(names.items()) if g not in own}

    def _check_names(self, cell: config.CellConfig, known: Sequence[str]) -> None:
        if unnamed := [name for name in self._rules.of if name not in known]:
            raise InputError(f"{cell.model}: no geom or body {unnamed[0]!r}; give the fixture's geom this name")

    def _place_fixtures(self, cell: config.CellConfig, fixtures: Mapping[int, str]) -> list[CarriedBody]:
        """Set the poses of fixed geoms, and return the bodies of the geoms that move.

        A geom fixed in the world has the pose from the job. Any other has the pose in the file, in its parent's frame.
        """
        mujoco.mj_kinematics(self.model, self.data)
        self._shift_meshes()
        drawn = self.data.geom_xpos.copy(), self.data.geom_xmat.copy()
        if cell.model is not None:
            _move(self.model, self.data, cell)
        found = []
        for g, name in fixtures.items():
            rule = self._rules.rule(name)
            if rule.parent != config.WORLD:
                self._place(g, drawn[0][g], drawn[1][g].reshape(3, 3))
            t, R = self.data.geom_xpos[g].copy(), self.data.geom_xmat[g].reshape(3, 3).copy()
            if self._rules.moves(name):
                link, corners = self._arm.link_of(rule.parent), self._corners_of(g)
                found.append(CarriedBody(g, rule.parent, link, self.excluded[g], R, t, corners, self._arm))
            elif rule.parent != config.WORLD:
                (origin,), (rotation,) = self._frame(rule.parent)
                self._place(g, rotation @ t + origin, rotation @ R)
        return found

    def _shift_meshes(self) -> None:
        """Shift the mesh geoms by their centres, about which `_add_mesh` has added their corners."""
        for g, corners, _, turn in self._mesh_geoms():
            self.data.geom_xpos[g] += self.data.geom_xmat[g].reshape(3, 3) @ turn.T @ _centre(corners)

    def _mesh_geoms(self) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
        """Yield the geoms of meshes that are not the arm's, with corners, and position and axes of the mesh's frame.

        In MuJoCo a mesh's frame is its inertial frame; position and axes are relative to the mesh's centre.
        """
        for g in np.flatnonzero(self.model.geom_type == _MESH).tolist():
            mesh, turn = self.model.geom_dataid[g], np.empty(9)
            mujoco.mju_quat2Mat(turn, self.model.mesh_quat[mesh])
            if (corners := self._corners.get(self.model.mesh(mesh).name)) is not None:
                yield g, corners, self.model.mesh_pos[mesh], turn.reshape(3, 3)

    def _corners_of(self, geom: int) -> Float[np.ndarray, "V 3"]:
        """Return the corners of a box or a mesh in the geom's frame [m]."""
        for g, corners, position, turn in self._mesh_geoms():
            if g == geom:
                return (corners - _centre(corners) - position) @ turn
        return _CORNERS * self.model.geom_size[geom]

    def _place(self, geom: int, t: np.ndarray, R: np.ndarray) -> None:
        self.data.geom_xpos[geom], self.data.geom_xmat[geom] = t, R.ravel()

    def _frame(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return origin (1, 3) [m] and axes (1, 3, 3) of a link's frame in the world, for zero joint values."""
        return self._arm.frames(np.zeros((1, len(self._arm.joints))), name, tip=False)

    def _surfaces_of_model(self) -> Iterator[Surface]:
        for geom, triangles in self._triangles:
            t, R = self.data.geom_xpos[geom.id].copy(), self.data.geom_xmat[geom.id].reshape(3, 3).copy()
            yield Surface(triangles.reshape(-1, 3), triangles, R, t, self.excluded[geom.id])

    def _surfaces_of_clouds(self, clouds: Sequence[config.CloudConfig]) -> Iterator[Surface]:
        for cloud in (each for each in clouds if not self._rules.moves(_stem(each))):
            R, t = _pose_of(cloud.base_m, cloud.base_rpy_rad)
            if (parent := self._rules.rule(_stem(cloud)).parent) != config.WORLD:
                (origin,), (rotation,) = self._frame(parent)
                R, t = rotation @ R, rotation @ t + origin
            yield Surface(*load_geometry(cloud.cloud, cloud.unit), R, t, self._rules.excluded(_stem(cloud)))


def _compiled(spec: mujoco.MjSpec, path: str | None) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: not a cell that MuJoCo can read: {' '.join(str(error).split())}") from None


def _name(geom: mujoco.MjsGeom) -> str:
    """Return the name of a geom, or of its body if it has none."""
    return geom.name or (geom.parent.name if geom.parent.name != config.WORLD else "")


def _stem(cloud: config.CloudConfig) -> str:
    return Path(cloud.cloud).stem


def _centre(corners: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "3"]:
    return (corners.min(axis=0) + corners.max(axis=0)) / 2


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
