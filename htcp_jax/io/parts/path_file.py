"""Reader of a path's file: points, normals, tangents and orientations."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import columns
from htcp_jax.io.parts.table import read_named
from htcp_jax.model import PathFrames

GUESSED = ("i", "j", "k")  # read as normals only if they are unit vectors; they may also be indices of cells


class PathPoints(NamedTuple):
    """Points of a path, and the directions in its file."""

    xyz: Float[np.ndarray, "T 3"]  # [m]
    frames: PathFrames


def read_path_points(
    path: Path, chosen: Mapping[str, int | str] = MappingProxyType({}), unit: str | None = None
) -> PathPoints:
    """Read a path's file: points, and the normals, tangents and quaternions that its header or the caller names.

    Args:
        path: The file.
        chosen: The column of each quantity, see `columns.chosen_columns`; empty: the columns that the header names, or
            the first three.
        unit: Unit of the points, a key of `columns.PER_METRE`; None: the header's unit, or m if the header has none.

    Raises:
        InputError: As `read_named` does, for a normal or tangent whose length is not 1, and for a quaternion of length
            0.
    """
    xyz, found = read_named(path, columns.DIRECTIONS, chosen, unit)
    vectors = {}
    for families, what in ((columns.NORMALS, "normal"), (columns.TANGENTS, "tangent")):
        for names in families:
            if what not in vectors and names in found:
                vectors[what] = _unit_vectors(found[names], names, what, path)
    quaternions = next((found[names] for names in columns.QUATERNIONS if names in found), None)
    if quaternions is not None and len(wrong := np.flatnonzero(~(np.linalg.norm(quaternions, axis=1) > 1e-9))):
        raise InputError(f"{path}: the quaternion at point {wrong[0] + 1} has the length 0")
    rotations = None
    if quaternions is not None:
        rotations = scipy.spatial.transform.Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    return PathPoints(xyz, PathFrames(vectors.get("normal"), vectors.get("tangent"), rotations))


def _unit_vectors(values: np.ndarray, names: tuple[str, ...], what: str, path: Path) -> np.ndarray | None:
    length = np.linalg.norm(values, axis=1)
    if len(wrong := np.flatnonzero(~(np.abs(length - 1.0) < columns.NEARLY_UNIT))):
        off = f"at point {wrong[0] + 1} has the length {length[wrong[0]]:.4g}"
        if names != GUESSED:
            raise InputError(f"{path}: the {what} {off}; it must be 1")
        warnings.warn(
            f"{path}: columns i, j, k are ignored: as a {what}, the vector {off} instead of 1", Note, stacklevel=4
        )
        return None
    return values / length[:, None]
