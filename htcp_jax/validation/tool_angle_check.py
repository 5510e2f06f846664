"""Independent check of a tool's work angle, travel angle and spin, in numpy with orientations from MuJoCo."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.spec import ToolAxisRow
from htcp_jax.validation.result import ROUNDING_M


class PathAxes(NamedTuple):
    """Directions at n places of the path, from which a row's angles are measured."""

    frames: Float[np.ndarray, "n 3 3"]  # orientations of the path's frame in the world: x tangent, z normal
    zero: Float[np.ndarray, "n"]  # work angle from the normal at which the row's is 0 [rad]
    sense: Float[np.ndarray, "n"]  # 1 where both increase in the same sense, else -1


def path_axes(
    row: ToolAxisRow, frames: Float[np.ndarray, "n 3 3"], plates: Float[np.ndarray, "n 2 3"] | None
) -> PathAxes:
    """Return the directions from which a row's angles are measured.

    Args:
        row: The row.
        frames: Orientations of the path's frame in the world: x along the tangent, z along the normal.
        plates: Normals of both plates of a fillet in the world; None: the path has none.
    """
    if row.plate is None or plates is None:
        return PathAxes(frames, np.zeros(len(frames)), np.ones(len(frames)))
    t, b, n = np.moveaxis(frames, 2, 0)
    both = plates - (plates * t[:, None]).sum(axis=2, keepdims=True) * t[:, None]  # across the seam
    both /= np.linalg.norm(both, axis=2, keepdims=True)
    normal, other = both[:, row.plate], both[:, 1 - row.plate]
    along = other - (other * normal).sum(axis=1, keepdims=True) * normal
    zero = np.arctan2((along * b).sum(axis=1), (along * n).sum(axis=1))
    return PathAxes(frames, zero, np.sign((np.cross(normal, along) * t).sum(axis=1)))


def tool_angles(
    row: ToolAxisRow, rotation: Float[np.ndarray, "n 3 3"], axes: PathAxes
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return the work angle, travel angle and spin of a tool [rad], and the lengths of their projections.

    Each angle is that of a unit vector's projection to a plane; a rotation by d in this plane moves the unit vector by
    the angle asin(length sin d).

    Args:
        row: The row that names the tool's axis.
        rotation: Orientations of the frame of the tool's axis, in the world.
        axes: The path's directions.
    """
    _, k, sign = row.axis_of
    to_tip, x = sign * rotation[:, :, k], rotation[:, :, (k + 1) % 3]
    t, b, n = np.moveaxis(axes.frames, 2, 0)
    pairs = [((-to_tip * u).sum(axis=1), (-to_tip * v).sum(axis=1)) for u, v in ((b, n), (-t, n))]
    pairs.append(((x * np.cross(to_tip, t)).sum(axis=1), (x * t).sum(axis=1)))
    angles = np.stack([np.arctan2(*pair) for pair in pairs], axis=1)
    angles[:, 0] = (axes.sense * (angles[:, 0] - axes.zero) + np.pi) % (2 * np.pi) - np.pi
    return angles, np.stack([np.hypot(*pair) for pair in pairs], axis=1)


def angle_deviations(
    row: ToolAxisRow,
    rotation: Float[np.ndarray, "n 3 3"],
    axes: PathAxes,
    wider: Float[np.ndarray, "n"] | None = None,
) -> Float[np.ndarray, "2 n"]:
    """Return the largest deviation of an angle with one value, and the largest one outside a range [rad].

    Args:
        row: The row.
        rotation: Orientations of the frame of the tool's axis, in the world.
        axes: The path's directions.
        wider: Smallest half width of the ranges [rad]; None: as the row says.
    """
    found = np.zeros((2, len(rotation)))
    wider = np.zeros(len(rotation)) if wider is None else wider
    for (name, value), angle, length in zip(
        row.angles(), *(each.T for each in tool_angles(row, rotation, axes)), strict=True
    ):
        if value == "free":
            continue
        lower, upper = np.deg2rad(row.bounds_deg(name))
        off = (angle - 0.5 * (lower + upper) + np.pi) % (2 * np.pi) - np.pi
        beyond = np.clip(np.abs(off) - 0.5 * (upper - lower), 0.0, 0.5 * np.pi)
        moved = np.arcsin(np.clip(length * np.sin(beyond), 0.0, 1.0))
        moved = np.maximum(moved - np.maximum(wider - 0.5 * (upper - lower), 0.0), 0.0)
        at = found[int(isinstance(value, tuple))]
        np.maximum(at, np.where(moved > ROUNDING_M, moved, 0.0), out=at)
    return found
