"""Import of a tool from a mesh: capsules and convex pieces about it, and the TCP, as a model for a job's `tool.model`.

The mesh's frame is that of the tool's model: its origin is put on the flange, z out of it.
"""

from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.parts import check_tool_extent, load_geometry
from htcp_jax.io.robots.body_covers import CapsuleFit, cover_body
from htcp_jax.io.robots.chain import Chain
from htcp_jax.io.robots.frames import frame
from htcp_jax.io.robots.mujoco_models import compile_spec
from htcp_jax.io.robots.shapes import Shape
from htcp_jax.io.robots.tcp import Tip
from htcp_jax.io.robots.vendor_import import ImportedArm
from htcp_jax.spec import WORLD
from htcp_jax.system import known_ending

MESHES = ".stl", ".obj", ".ply", ".step", ".stp"


def import_tool(
    path: Path,
    T_mesh_tcp: Float[np.ndarray, "4 4"],
    unit: str | None = None,
    *,
    most: int | None = None,
    tolerance_m: float | None = None,
) -> ImportedArm:
    """Read a tool's mesh, and fit capsules and convex pieces to it as to an arm's links.

    Args:
        path: The mesh.
        T_mesh_tcp: Pose of the TCP in the mesh's frame [m]; its z axis points out of the tool.
        unit: Unit of the mesh's coordinates, see `load_geometry`.
        most: Maximum number of fitted capsules, see `CapsuleFit`.
        tolerance_m: Tolerance of a closer fit, see `CapsuleFit`; None: at most capsule_fit.MOST capsules.

    Returns:
        The tool as an arm without joints, for `arm_xml`: one body, named after the file, that carries the TCP.

    Raises:
        InputError: For a file that cannot be read, a mesh without triangles, a size that no tool has, a TCP that is
            farther from the mesh than its size, and a tolerance out of range.
    """
    known_ending(path, MESHES)
    fit = CapsuleFit(most, tolerance_m)
    triangles = load_geometry(path, unit).triangles
    if not len(triangles):
        raise InputError(f"{path}: the file has no triangles; a tool needs a mesh")
    check_tool_extent(triangles.reshape(-1, 3), T_mesh_tcp[:3, 3], str(path), unit)
    name = path.stem if path.stem != WORLD else "tool"
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.worldbody.add_body(name=name, mass=1.0, inertia=[1.0, 1.0, 1.0])
    model = compile_spec(spec, path)
    cover = cover_body([Shape(name, "mesh", triangles, None)], name, set(), fit, close=True)
    return ImportedArm(
        model,
        Tip("tcp", 1, T_mesh_tcp),
        Chain(0, (), ()),
        joint_names=(),
        followers={},
        frozen=(),
        fixed={},
        bodies=(0, 1),
        covers={1: cover},
        massive=(),
        numbers={},
        excluded=(),
        visual=False,
        shapeless=(),
        disabled=(),
        unused=(),
        omitted=(),
    )


def bare_length_m(tool: ImportedArm) -> float:
    """Return the distance of an imported tool's TCP from its convex pieces [m]; 0 if it is inside one."""
    (cover,) = tool.covers.values()
    tip = tool.tip.T_body_tcp[None, :3, 3]
    return min(piece.missed_m(tip) for piece in cover.hulls.values())


def pose_along(position_m: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose at a position [m] whose z axis has a direction, turned from the axes by the least angle.

    For the direction -z, it is turned about x.
    """
    z = direction / np.linalg.norm(direction)
    quaternion = np.array([1.0 + z[2], -z[1], z[0], 0.0])
    if z[2] < -1.0 + 1e-12:
        quaternion = np.array([0.0, 1.0, 0.0, 0.0])
    return frame(position_m, quaternion / np.linalg.norm(quaternion))
