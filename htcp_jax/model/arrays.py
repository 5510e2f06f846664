"""Conversion of numbers from a caller or a file to checked arrays."""

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError

LARGEST_COORDINATE = 1e9  # [m]


def points(value: object, source: str, at_least: int) -> Float[np.ndarray, "P 3"]:
    """Return `value` as an array of points [m].

    Args:
        value: An array or lists of numbers, (P, 3).
        source: Name of the value in messages.
        at_least: Smallest valid number of points.

    Raises:
        InputError: For any other shape, too few points, and coordinates that are not finite or too large.
    """
    found = _as_floats(value, source)
    if found.ndim != 2 or found.shape[1] != 3:
        raise InputError(f"{source}: the shape is {found.shape}; it must be (points, 3)")
    check_points(found, source, at_least)
    return found


def triple(value: object, source: str) -> Float[np.ndarray, "3"]:
    """Return `value` as three numbers [m].

    Args:
        value: An array or a sequence of three numbers.
        source: Name of the value in messages.

    Raises:
        InputError: For any other shape, and for numbers that are not finite.
    """
    found = _as_floats(value, source)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise InputError(f"{source} is {value!r}; it must be three finite numbers [m]")
    return found


def check_points(points: Float[np.ndarray, "P 3"], source: str, at_least: int) -> None:
    """Raise InputError unless there are `at_least` points, all finite and within LARGEST_COORDINATE [m]."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"{source}: row {bad[0] + 1} contains NaN or an infinite number ({bad.size} such rows)")
    if len(points) < at_least:
        raise InputError(f"{source}: {len(points)} points, at least {at_least} are needed")
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise InputError(f"{source}: a coordinate is {np.abs(points).max():.3g} m, which is too large; give metres")


def _as_floats(value: object, source: str) -> Float[np.ndarray, "..."]:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{source}: it must be an array of numbers") from None
