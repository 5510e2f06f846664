"""Directions along a tool path: normals that point from the wall into the free space, tangents, and orientations.

The path's file may contain them. Otherwise normals are computed from the cloud, and tangents from the path.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError
from htcp_jax.model.surface import cloud_normals

ONE_POINT_M = 1e-5  # points closer to each other than this are one point of the path
NEIGHBOURS = 60  # wall points used to fit a normal


class PathFrames(NamedTuple):
    """Directions at the T points of a path, in the workpiece frame; None if the path's file has none."""

    normals: Float[np.ndarray, "T 3"] | None = None  # unit
    tangents: Float[np.ndarray, "T 3"] | None = None  # unit, in the path's direction
    rotations: Float[np.ndarray, "T 3 3"] | None = None  # orientations of the tool's frame
    plates: Float[np.ndarray, "T 2 3"] | None = None  # unit normals of both plates of a fillet


def wall_normals(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Return the unit normals of the wall at a path, see `surface.cloud_normals`."""
    _, near = scipy.spatial.cKDTree(cloud).query(path, k=min(NEIGHBOURS, len(cloud)))
    return cloud_normals(path, cloud[near], cloud)


def tangents(path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """Return the unit tangents of a path, by central differences; points within ONE_POINT_M have the same one.

    Raises:
        InputError: For a path of zero length.
    """
    apart = _apart(path)
    places = path[apart]
    if len(places) == 1:
        raise InputError("the path has no tangent, because all of its points coincide")
    found = np.gradient(places, axis=0)
    back = np.linalg.norm(found, axis=1) <= 1e-9  # where the path reverses
    found[back] = np.diff(places, axis=0, append=places[-1:])[back]
    found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-300)
    return found[np.cumsum(apart) - 1]


def _apart(path: Float[np.ndarray, "T 3"]) -> Bool[np.ndarray, "T"]:
    """Return False for points within ONE_POINT_M of the last point with True; the first point has True."""
    found, last = np.ones(len(path), bool), 0
    for k in np.flatnonzero(np.append(False, np.linalg.norm(np.diff(path, axis=0), axis=1) <= ONE_POINT_M)):
        last = k - 1 if found[k - 1] else last
        found[k] = np.linalg.norm(path[k] - path[last]) > ONE_POINT_M
    return found
