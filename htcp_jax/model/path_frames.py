"""Directions along a tool path: normals that point from the wall into the free space, tangents, and orientations.

The path's file may contain them. Otherwise normals are computed from the cloud, and tangents from the path.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.surface import cloud_normals

NEIGHBOURS = 60  # wall points used to fit a normal


class PathFrames(NamedTuple):
    """Directions at the T points of a path, in the workpiece frame; None if the path's file has none."""

    normals: Float[np.ndarray, "T 3"] | None = None  # unit
    tangents: Float[np.ndarray, "T 3"] | None = None  # unit, in the path's direction
    rotations: Float[np.ndarray, "T 3 3"] | None = None  # orientations of the tool's frame


def wall_normals(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Return the unit normals of the wall at a path, see `surface.cloud_normals`."""
    _, near = scipy.spatial.cKDTree(cloud).query(path, k=min(NEIGHBOURS, len(cloud)))
    return cloud_normals(path, cloud[near], cloud)


def tangents(path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Return the unit tangents of a path, by central differences; coincident neighbours get the same tangent.

    Raises:
        InputError: For a path of zero length.
    """
    ahead = np.linalg.norm(np.diff(path, axis=0), axis=1)
    apart = np.concatenate([[True], ahead > 1e-9])
    if not (ahead > 1e-9).any():
        raise InputError("the path has no tangent, because all of its points coincide")
    found = np.gradient(path[apart], axis=0)[np.cumsum(apart) - 1]
    length = np.linalg.norm(found, axis=1, keepdims=True)
    back = length[:, 0] <= 1e-9  # where the path reverses
    found[back], length[back] = np.diff(path, axis=0, append=path[-1:])[back], 1.0
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)
