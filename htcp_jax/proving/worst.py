"""Where a refuted motion collides: the place of the deepest contact found on a segment, its body and its obstacle."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.motion import Problem, start_cause
from htcp_jax.proving.curves import JointCurves

PLACES = 65  # configurations on a path that are measured first
ROUNDS = 4  # times that the neighbourhood of the deepest one is measured again


class Contact(NamedTuple):
    """Configuration with the smallest clearance that was found on a segment."""

    segment: int
    place: float  # share of the segment [1]
    x: Float[np.ndarray, "N"]  # [rad or m]
    body: str  # label of the body
    other: str  # name of the obstacle or the other body
    clearance_m: float  # D; below 0 in collision [m]


def deepest_contact(problem: Problem, curves: JointCurves, segment: int) -> Contact:
    """Return the configuration with the smallest clearance on a segment, by samples around the smallest ones.

    Args:
        problem: The problem, see `scene.scene_of`.
        curves: The joint paths.
        segment: Number of the segment.
    """
    best = None
    for row in np.flatnonzero(curves.segment == segment):
        low, high = 0.0, 1.0
        for _ in range(ROUNDS):
            s = np.linspace(low, high, PLACES)
            x = np.polynomial.polynomial.polyval(s, curves.coefficients[row]).T
            clearance = start_cause.clearances_at(problem, x)
            k = int(clearance.argmin())
            begin, end = curves.span[row]
            if best is None or clearance[k] < best[0]:
                best = float(clearance[k]), float(begin + s[k] * (end - begin)), x[k]
            low, high = s[max(k - 1, 0)], s[min(k + 1, PLACES - 1)]
    if best is None:
        raise ValueError(f"no path belongs to segment {segment}")
    clearance_m, place, x = best
    return Contact(segment, place, x, *start_cause.nearest_bodies(problem, x), clearance_m)
