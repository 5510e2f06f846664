"""Shapes of a work cell, read from an MJCF file, at their poses in the world.

Planes, boxes, spheres, capsules and cylinders are read as primitives, meshes as triangles. The model's joints are in
their initial configuration. Visual geoms are ignored. The planner and `htcp validate` read meshes by the same function,
so that both check the same triangles and agree on which mesh is a solid.
"""

import warnings
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots.mujoco_models import compile_spec, upwards
from htcp_jax.io.robots.safe_xml import WORLD, model_files, read_spec
from htcp_jax.io.robots.shapes import Geom, Shapes
from htcp_jax.model import Fixture, fixture
from htcp_jax.spec import tool
from htcp_jax.types import Triple

THIN_M = 1e-6  # a thinner mesh is flat


class CellMesh(NamedTuple):
    """A mesh in a cell's file."""

    geom: mujoco.MjsGeom  # its geom in the parsed file, a box in its place
    triangles: Float[np.ndarray, "F 3 3"]  # in the geom's frame [m]
    is_solid: bool  # False for a surface, see `fixture.is_solid`


def load_cell(
    path: str | Path, *, moved: str | None = None, shift_m: Triple = tool.ZERO, rpy_rad: Triple = tool.ZERO
) -> tuple[Fixture, ...]:
    """Return the shapes in an MJCF file, after moving a body or the complete cell.

    The body and its descendants are rotated about the body's origin, then translated.

    Args:
        path: The file.
        moved: Name of the body; None: the complete cell is moved, and rotated about the world's origin.
        shift_m: Translation in the world [m].
        rpy_rad: Rotations about world x, then y, then z [rad].

    Raises:
        InputError: If a file or a mesh cannot be read, if the body is unknown, or if the model has no collision geom or
            one of an unsupported kind.
    """
    path = Path(path)
    spec = read_spec(path, meshes=True)
    shapes = Shapes(spec, path)
    model = compile_spec(spec, path)
    own = _moved_bodies(model, path, moved)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geoms = [geom for geom in shapes.geoms if geom.touches]
    if not geoms:
        raise InputError(f"{path}: no collision geoms; give a geom a contype or conaffinity other than 0")
    origin = np.zeros(3) if moved is None else data.xpos[model.body(moved).id]
    move = tool.pose(tuple(np.array(shift_m) + origin), rpy_rad) @ tool.pose(tuple(-origin), tool.ZERO)
    return tuple(
        _fixture(geom, shapes, model, data, path, move if own[model.geom_bodyid[geom.at]] else np.eye(4))
        for geom in sorted(geoms, key=lambda geom: geom.at)
    )


def read_meshes(path: str | Path) -> tuple[mujoco.MjSpec, list[CellMesh]]:
    """Read a cell's file for MuJoCo, which opens no mesh: a box takes the place of each.

    A geom without a name, on a body without a name, gets the name that `load_cell` gives to its shape.

    Args:
        path: The file.

    Returns:
        The parsed file, which MuJoCo compiles without masses, and the meshes for contact.

    Raises:
        InputError: If a file or a mesh cannot be read.
    """
    path = Path(path)
    spec = read_spec(path, meshes=True)
    shapes = Shapes(spec, path)
    compile_spec(spec, path)  # sets the geoms' indices
    found = []
    for geom, own in zip(list(spec.geoms), shapes.geoms, strict=True):
        if not geom.name and (geom.parent.name in ("", WORLD)):
            geom.name = _fallback_name(own)
        if own.touches and own.kind == "mesh":
            triangles = shapes.mesh(own)
            _note_if_flat(own.mesh, triangles, path)
            found.append(CellMesh(geom, triangles, fixture.is_solid(triangles)))
    return spec, found


def _fallback_name(geom: Geom) -> str:
    return f"{geom.kind} {geom.at}"


def thickness_m(points: Float[np.ndarray, "P 3"]) -> float:
    """Return the extent of points along the direction in which they vary least [m]."""
    away = points - points.mean(axis=0)
    return float(np.ptp(away @ np.linalg.eigh(away.T @ away)[1][:, 0]))


def _note_if_flat(name: str, triangles: Float[np.ndarray, "F 3 3"], path: Path) -> None:
    if thickness_m(triangles.reshape(-1, 3)) < THIN_M:
        what = f"{path}: mesh {name!r} is flat; it is a wall of thickness 0, which is checked on both sides"
        warnings.warn(what, Note, stacklevel=3)


def files_of_cell(path: str | Path) -> set[Path]:
    """Return the absolute paths of an MJCF file, its included files and its collision meshes.

    Raises:
        InputError: If a file cannot be read or a mesh file does not exist.
    """
    path = Path(path)
    shapes = Shapes(read_spec(path, meshes=True), path)
    meshes = {shapes.file(geom) for geom in shapes.geoms if geom.touches}
    return model_files(path) | {file.resolve() for file in meshes - {None}}


def _moved_bodies(model: mujoco.MjModel, path: Path, moved: str | None) -> Bool[np.ndarray, "B"]:
    """Return, for each body, True if it is moved: `moved` and its descendants, or all bodies if `moved` is None."""
    if moved is None:
        return np.ones(model.nbody, bool)
    names = [model.body(b).name for b in range(1, model.nbody)]
    if moved not in names:
        raise InputError(f"{path}: no body {moved!r} to move; bodies of the cell: {', '.join(names) or 'none'}")
    return np.array([model.body(moved).id in upwards(model, b) for b in range(model.nbody)])


def _fixture(
    geom: Geom, shapes: Shapes, model: mujoco.MjModel, data: mujoco.MjData, path: Path, move: np.ndarray
) -> Fixture:
    body = model.body(model.geom_bodyid[geom.at]).name if model.geom_bodyid[geom.at] else ""
    name = model.geom(geom.at).name or body or _fallback_name(geom)
    if geom.kind not in fixture.KINDS or (geom.mesh and geom.kind != "mesh"):
        kind = f"a {geom.kind} fitted to a mesh" if geom.mesh else f"a geom of type {geom.kind}"
        raise InputError(f"{path}: {name} is {kind}; valid in a cell: {', '.join(fixture.KINDS)}")
    T, none = np.eye(4), np.empty((0, 3, 3))
    if geom.kind != "mesh":
        T[:3, :3], T[:3, 3] = data.geom_xmat[geom.at].reshape(3, 3), data.geom_xpos[geom.at]
        return Fixture(name, geom.kind, move @ T, model.geom_size[geom.at].copy(), none)
    carrier = model.geom_bodyid[geom.at]
    T[:3, :3], T[:3, 3] = data.xmat[carrier].reshape(3, 3), data.xpos[carrier]
    T = move @ T
    _note_if_flat(geom.mesh, shapes.mesh(geom), path)
    triangles = shapes.shape(geom, model).triangles @ T[:3, :3].T + T[:3, 3]
    return Fixture(name, geom.kind, np.eye(4), np.zeros(3), triangles)
