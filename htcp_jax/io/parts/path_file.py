"""Normals, tangents and orientations in a path's file."""

from pathlib import Path

import numpy as np
import scipy

from htcp_jax.errors import InputError
from htcp_jax.io.parts.table import read_named
from htcp_jax.model import PathFrames

NORMALS, TANGENTS, QUATERNIONS = ("nx", "ny", "nz"), ("tx", "ty", "tz"), ("qw", "qx", "qy", "qz")
NEARLY_UNIT = 0.01


def read_frames(path: Path) -> PathFrames:
    """Read the columns nx,ny,nz, tx,ty,tz and qw,qx,qy,qz of a path's file, as far as its header names them.

    Raises:
        InputError: For a normal or tangent that is not of length 1, and for a quaternion of length 0.
    """
    found = read_named(path, (NORMALS, TANGENTS, QUATERNIONS))
    vectors = {}
    for names, what in ((NORMALS, "normal"), (TANGENTS, "tangent")):
        if (columns := found.get(names)) is not None:
            length = np.linalg.norm(columns, axis=1)
            if len(wrong := np.flatnonzero(~(np.abs(length - 1.0) < NEARLY_UNIT))):
                raise InputError(
                    f"{path}: the {what} of point {wrong[0] + 1} has the length {length[wrong[0]]:.4g}; 1 is needed"
                )
            vectors[names] = columns / length[:, None]
    quaternions = found.get(QUATERNIONS)
    if quaternions is not None and len(wrong := np.flatnonzero(~(np.linalg.norm(quaternions, axis=1) > 1e-9))):
        raise InputError(f"{path}: the quaternion of point {wrong[0] + 1} has the length 0")
    rotations = None
    if quaternions is not None:
        rotations = scipy.spatial.transform.Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    return PathFrames(vectors.get(NORMALS), vectors.get(TANGENTS), rotations)
