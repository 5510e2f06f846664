"""Shapes of the bodies in a robot's model file, as triangles or capsules in the bodies' frames.

Meshes are read here, not by MuJoCo, which would transform them into their principal frames. Capsules and other
primitives that the model fits to a mesh are fitted by MuJoCo.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import scipy
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.parts.point_cloud import load_geometry
from htcp_jax.io.robots import collada_mesh
from htcp_jax.io.robots.capsule_fit import Capsule, Triangles
from htcp_jax.io.robots.frames import frame
from htcp_jax.io.robots.mujoco_models import delete_all

ENDINGS = ".stl", ".obj", ".ply"
SIDES = 48  # number of sides of the prism about a cylinder

_Kind = mujoco.mjtGeom
_Vertices = Float[np.ndarray, "V 3"]


class MeshAsset(NamedTuple):
    """A mesh in a model file, before its own file is read; the fields are MJCF's attributes of a mesh."""

    file: str  # name in the model; "" if the model contains the corners
    scale: Float[np.ndarray, "3"]
    refpos: Float[np.ndarray, "3"]  # [m]
    refquat: Float[np.ndarray, "4"]
    corners: _Vertices  # corners of a mesh without a file [m]
    faces: Int[np.ndarray, "F 3"]
    inertia: mujoco.mjtMeshInertia


class Geom(NamedTuple):
    """A geom in a model file, without pose and size, which are available from the compiled model."""

    at: int  # index in the model
    kind: str  # box, capsule, ...
    mesh: str  # name of the geom's mesh, or of the mesh to which the geom is fitted; "" if there is none
    fitscale: float
    touches: bool  # True for a collision geom, False for a visual one


class Shape(NamedTuple):
    """A shape in the frame of its body [m]: triangles, or a capsule with the triangles to which the model fits it."""

    name: str
    kind: str  # box, capsule, ...
    triangles: Triangles
    capsule: Capsule | None


class Shapes:
    """Geoms and meshes of a model file.

    They are removed from `spec`, in which boxes replace the geoms that would open a file.
    """

    def __init__(self, spec: mujoco.MjSpec, path: Path):
        self._path, self._folders = path, [spec.compiler.meshdir, ""]
        self._fitaabb = spec.compiler.fitaabb
        self._meshes = {mesh.name: _mesh(mesh) for mesh in spec.meshes}
        self._taken = [(geom, _taken(geom)) for geom in spec.geoms]
        delete_all(spec, spec.meshes)
        self._triangles = cache(self._triangles)

    @property
    def geoms(self) -> list[Geom]:
        """All geoms; their indices are valid once `spec` is compiled."""
        return [taken._replace(at=int(geom.id)) for geom, taken in self._taken]

    def shape(self, geom: Geom, model: mujoco.MjModel) -> Shape:
        """Return a geom of the compiled model as a shape.

        Raises:
            InputError: For a mesh that cannot be read, and for a fit to a mesh that fails.
        """
        T, size = frame(model.geom_pos[geom.at], model.geom_quat[geom.at]), model.geom_size[geom.at]
        name, mesh = model.geom(geom.at).name, np.empty((0, 3, 3))
        if geom.mesh:
            mesh = _moved_triangles(T, self._triangles(geom.mesh))
        if geom.kind == "mesh":
            return Shape(name, geom.kind, mesh, None)
        if geom.mesh:
            T_mesh_fit, size = self._fit(geom)
            T = T @ T_mesh_fit
        if geom.kind in ("capsule", "sphere"):
            half = size[1] if geom.kind == "capsule" else 0.0
            return Shape(name, geom.kind, mesh, Capsule.along_z(T, size[0], half))
        return Shape(name, geom.kind, _moved_triangles(T, _SOLIDS[geom.kind](size)), None)

    def mesh(self, geom: Geom) -> Triangles:
        """Return the triangles of a geom's mesh in the geom's frame [m].

        Raises:
            InputError: For a mesh that cannot be read.
        """
        return self._triangles(geom.mesh)

    def file(self, geom: Geom) -> Path | None:
        """Return the file of a geom's mesh; None if the geom has no mesh, or the model contains the mesh.

        Raises:
            InputError: If the file does not exist.
        """
        name = self._meshes[geom.mesh].file if geom.mesh else ""
        return _find(name, self._path, self._folders) if name else None

    def _triangles(self, name: str) -> Triangles:
        """Return a mesh with the model's translation, rotation and scale applied, in this order.

        Raises:
            InputError: For a name that the model lacks, and for a mesh that cannot be read.
        """
        mesh = self._meshes.get(name)
        if mesh is None:
            known = ", ".join(sorted(self._meshes)) or "none"
            raise InputError(f"{self._path}: a geom has the mesh {name!r}, which <asset> lacks; meshes: {known}")
        if mesh.file:
            file = _find(mesh.file, self._path, self._folders)
            is_collada = file.suffix.lower() == collada_mesh.ENDING
            if not is_collada and file.suffix.lower() not in ENDINGS:
                raise InputError(
                    f"{file}: unsupported mesh format; save it as {' or '.join(ENDINGS)} and name that in {self._path}"
                )
            triangles = collada_mesh.read_triangles(file) if is_collada else load_geometry(file).triangles
        else:
            triangles = mesh.corners[mesh.faces] if len(mesh.faces) else _hull_triangles(mesh.corners)
        if not len(triangles):
            raise InputError(f"{self._path}: mesh {mesh.file or name!r} has no triangles")
        turn = frame(np.zeros(3), mesh.refquat / np.linalg.norm(mesh.refquat))[:3, :3]
        return (triangles - mesh.refpos) @ turn * mesh.scale

    def _fit(self, geom: Geom) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "3"]]:
        """Return pose and size of the primitive that MuJoCo fits to a mesh, in the mesh's frame.

        Raises:
            InputError: If the fit fails.
        """
        triangles = self._triangles(geom.mesh)
        corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        spec = mujoco.MjSpec()
        spec.compiler.fitaabb = self._fitaabb
        arrays = {"uservert": corners.ravel(), "userface": faces.ravel().astype(np.int32)}
        spec.add_mesh(name="mesh", inertia=self._meshes[geom.mesh].inertia, **arrays)
        kind = getattr(_Kind, f"mjGEOM_{geom.kind.upper()}")
        spec.worldbody.add_geom(type=kind, meshname="mesh", fitscale=geom.fitscale)
        try:
            model = spec.compile()
        except ValueError as error:
            raise InputError(f"{self._path}: cannot fit a {geom.kind} to mesh {geom.mesh!r}: {error}") from None
        return frame(model.geom_pos[0], model.geom_quat[0]), model.geom_size[0]


def _mesh(mesh: mujoco.MjsMesh) -> MeshAsset:
    poses = (np.array(given, float) for given in (mesh.scale, mesh.refpos, mesh.refquat))
    corners = np.array(mesh.uservert, float).reshape(-1, 3)
    return MeshAsset(mesh.file, *poses, corners, np.array(mesh.userface, int).reshape(-1, 3), mesh.inertia)


def _taken(geom: mujoco.MjsGeom) -> Geom:
    kind = geom.type.name.removeprefix("mjGEOM_").lower()
    taken = Geom(-1, kind, geom.meshname, geom.fitscale, bool(geom.contype or geom.conaffinity))
    if geom.meshname or kind in ("mesh", "hfield", "sdf"):
        geom.type, geom.size, geom.meshname, geom.hfieldname = _Kind.mjGEOM_BOX, [1.0, 1.0, 1.0], "", ""
    return taken


def _find(name: str, path: Path, folders: list[str]) -> Path:
    """Find a mesh file of the model at `path`.

    It is searched next to the model, in the model's mesh folders, in the folder above, which contains urdf/ and meshes/
    in a ROS package, and for `package://` from the model's folder upwards.

    Raises:
        InputError: If the file does not exist.
    """
    scheme, _, rest = name.rpartition("://")
    home = path.resolve().parent
    if scheme == "package":
        package, _, inner = rest.partition("/")
        places = [folder / part for folder in (home, *home.parents) for part in (rest, inner)]
        missing = f"no package {package!r} with {inner} in {home} or above it; put it into one of these folders"
    else:
        places = [home / folder / rest for folder in folders]
        places += [home / folders[0] / Path(rest).name, home.parent / rest]
        missing = f"no such file in {home / folders[0]}"
    for place in places:
        if place.is_file():
            return place
    raise InputError(f"{path}: mesh {name}: {missing}")


def _moved_triangles(T: Float[np.ndarray, "4 4"], triangles: Triangles) -> Triangles:
    return triangles @ T[:3, :3].T + T[:3, 3]


def _hull_triangles(points: _Vertices) -> Triangles:
    try:
        return points[scipy.spatial.ConvexHull(points).simplices]
    except (scipy.spatial.QhullError, ValueError):
        return np.empty((0, 3, 3))


# Solids about the frame's origin, with MuJoCo's sizes; polyhedra enclose the round ones.


def _box(size: Float[np.ndarray, "3"]) -> Triangles:
    return _hull_triangles(np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3) * size)


def _cylinder(size: Float[np.ndarray, "3"]) -> Triangles:
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    rim = size[0] / np.cos(np.pi / SIDES) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return _hull_triangles(np.concatenate([np.column_stack([rim, np.full(SIDES, z)]) for z in (-size[1], size[1])]))


def _ellipsoid(size: Float[np.ndarray, "3"]) -> Triangles:
    from trimesh.creation import icosphere  # a slow import that few arms need

    ball = icosphere(subdivisions=3)
    inside = np.einsum("fi,fi->f", ball.face_normals, ball.triangles[:, 0]).min()
    return ball.triangles / inside * size


_SOLIDS = {"box": _box, "cylinder": _cylinder, "ellipsoid": _ellipsoid}
