"""The two plates of a fillet, found in the part's mesh around each point of the path.

At a point of the path the mesh is cut across the path a few times, before and after the point. Within the radius the
cuts are line segments. Segments whose facets have normals within SAME_PLATE_RAD of each other belong to
one plate; the two plates with the most length, at an angle of at least LEAST_FOLD_RAD, are those of the fillet.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.path_frames import PathFrames
from htcp_jax.model.surface import crossed
from htcp_jax.model.workpiece import Workpiece

SAME_PLATE_RAD = np.deg2rad(3)
COPLANAR_M = 1e-4  # difference of distances of faces that touch, of which the larger one is the plate
PARALLEL = np.sin(SAME_PLATE_RAD)
LEAST_FOLD_RAD = np.deg2rad(20)  # smallest angle between the plates' planes
LEAST_ACROSS = 0.5  # sine of the smallest angle between a plate's normal and the path
CUTS = -0.31, -0.13, 0.13, 0.31  # places of the cuts along the path [radii]; none at the end of a seam


class _Cuts(NamedTuple):
    """Line segments in which planes across the path cut triangles."""

    lengths: Float[np.ndarray, "k"]  # [m]
    normals: Float[np.ndarray, "k 3"]  # unit normals of the triangles, across the path
    distances: Float[np.ndarray, "k"]  # of the point from the segments' lines [m]


def with_plates(part: Workpiece, within_m: float, plate_1_faces: Float[np.ndarray, "3"]) -> Workpiece:
    """Return a part whose path has the normals of a fillet's plates, found in the part's mesh.

    Plates face the side of the path's normals if its file has some, else the side that the triangles' order of corners
    states; the path's normals are then half way between those of the plates.

    Args:
        part: The part.
        within_m: Radius around a point of the path in which the plates are looked for [m].
        plate_1_faces: Direction in the part's frame; plate 1 is the one that faces it more.

    Raises:
        InputError: For a part without triangles, a path with plates, and a point with fewer than two plates.
    """
    if not len(part.triangles):
        raise InputError(f"workpiece.plates: {part.name} has no mesh; add columns n1x ... n2z to the path's file")
    if part.frames.plates is not None:
        raise InputError("workpiece.plates: the path's file has the plates' normals; omit the key or these columns")
    normals, tangents = part.frames.normals, part.tangents
    if np.isnan(tangents).any():
        raise InputError("workpiece.plates: a seam of one point has no tangent; its file must have the plates' normals")
    bounds = part.triangles.min(axis=1), part.triangles.max(axis=1)
    found = np.empty((len(part.path), 2, 3))
    for k, (point, along) in enumerate(zip(part.path, tangents, strict=True)):
        pair = _two_plates(_cuts(part.triangles, bounds, point, along, within_m))
        if len(pair) < 2:
            what = f"within {1e3 * within_m:g} mm of point {k + 1} of the path the part has {len(pair) or 'no'} plate"
            raise InputError(f"workpiece.plates: {what}{'' if len(pair) else 's'}, but a fillet has two; set within_m")
        if normals is not None:
            pair = np.where(pair @ normals[k] < 0, -1.0, 1.0)[:, None] * pair
        found[k] = pair[np.argsort(-(pair @ plate_1_faces), kind="stable")]
    if normals is None:
        normals = found.sum(axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = PathFrames(normals, part.frames.tangents, part.frames.rotations, found)
    return part.with_path(part.name, part.path, frames, part.seam_begins)


def _cuts(
    triangles: Float[np.ndarray, "M 3 3"],
    bounds: tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "M 3"]],
    point: Float[np.ndarray, "3"],
    along: Float[np.ndarray, "3"],
    radius_m: float,
) -> _Cuts:
    """Return the segments in which planes across the path cut the triangles, within a radius of a point.

    Args:
        triangles: The mesh [m].
        bounds: Smallest and largest coordinates of each triangle [m].
        point: The point.
        along: The path's tangent.
        radius_m: The radius.
    """
    margin = np.abs(along) * max(CUTS) * radius_m + radius_m
    near = (bounds[0] <= point + margin).all(axis=1) & (bounds[1] >= point - margin).all(axis=1)
    corners = triangles[near]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths, normals, away = [], [], []
    for share in CUTS:
        centre = point + share * radius_m * along
        height = (corners - centre) @ along
        above = height >= 0
        cut = above.any(axis=1) & ~above.all(axis=1)
        ends = crossed(corners[cut], height[cut], above[cut])[1]
        lengths.append(_length_within(ends[:, 0] - centre, ends[:, 1] - centre, radius_m))
        normals.append(facing[cut])
        away.append(ends[:, 0] - point)
    across = np.concatenate(normals)
    across -= (across @ along)[:, None] * along
    size, length = np.linalg.norm(across, axis=1), np.concatenate(lengths)
    kept = (length > 0) & (size > LEAST_ACROSS * np.linalg.norm(np.concatenate(normals), axis=1))
    across = across[kept] / size[kept, None]
    return _Cuts(length[kept], across, np.abs(np.sum(across * np.concatenate(away)[kept], axis=1)))


def _length_within(a: Float[np.ndarray, "k 3"], b: Float[np.ndarray, "k 3"], radius_m: float) -> Float[np.ndarray, "k"]:
    """Return the length of the part of each segment from a to b that lies within a radius of the origin [m]."""
    d = b - a
    square = np.maximum((d * d).sum(axis=1), 1e-300)
    middle = -(a * d).sum(axis=1) / square
    inside = radius_m**2 - (a * a).sum(axis=1) + middle**2 * square
    half = np.sqrt(np.maximum(inside, 0.0) / square)
    share = np.clip(middle + half, 0.0, 1.0) - np.clip(middle - half, 0.0, 1.0)
    return np.where(inside > 0, share, 0.0) * np.sqrt(square)


def _two_plates(cuts: _Cuts) -> Float[np.ndarray, "p 3"]:
    """Return the normals of the plates with the most length: 2, or fewer if there are fewer.

    Of both sides of a plate, the one that is nearer to the path counts.
    """
    lengths = cuts.lengths.copy()
    normals, totals, distances = list[np.ndarray](), list[float](), list[float]()
    while lengths.any():
        first = cuts.normals[lengths.argmax()]
        same = (lengths > 0) & (cuts.normals @ first >= np.cos(SAME_PLATE_RAD))
        mean = lengths[same] @ cuts.normals[same]
        normals.append(mean / np.linalg.norm(mean))
        totals.append(lengths[same].sum())
        distances.append(lengths[same] @ cuts.distances[same] / totals[-1])
        lengths[same] = 0.0
    best = list[np.ndarray]()
    for k in np.argsort(-np.array(totals), kind="stable"):
        sides = [j for j, other in enumerate(normals) if np.linalg.norm(np.cross(other, normals[k])) < PARALLEL]
        nearest = min(distances[j] for j in sides) + COPLANAR_M
        normal = normals[max((j for j in sides if distances[j] <= nearest), key=totals.__getitem__)]
        if not best or (len(best) == 1 and np.linalg.norm(np.cross(best[0], normal)) >= np.sin(LEAST_FOLD_RAD)):
            best.append(normal)
    return np.array(best).reshape(-1, 3)
