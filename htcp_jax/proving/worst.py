"""The deepest contact found on a segment of a refuted motion: its place, its body and its obstacle."""

from collections.abc import Callable, Sequence
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
    is_capsule: bool = False  # True: a depth is that of the capsule about a convex piece, an upper bound

    @property
    def depth(self) -> str:
        """The depth as text."""
        return f"{'at most ' if self.is_capsule else ''}{-1e3 * self.clearance_m:.3g} mm"


def deepest_contact(problem: Problem, curves: JointCurves, segment: int) -> Contact:
    """Return the configuration with the smallest clearance on a segment, by samples around the smallest ones.

    Args:
        problem: The problem, see `scene.scene_of`.
        curves: The joint paths.
        segment: Number of the segment.
    """
    return deepest_contacts(problem, curves, [segment])[0]


def deepest_contacts(
    problem: Problem,
    curves: JointCurves,
    segments: Sequence[int],
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> list[Contact]:
    """Return the configuration with the smallest clearance on each of several segments, see `deepest_contact`.

    Args:
        problem: The problem, see `scene.scene_of`.
        curves: The joint paths.
        segments: Numbers of the segments.
        progress: Function that is called with the numbers of segments measured so far, and of all segments.

    Raises:
        ValueError: If no path belongs to a segment.
    """
    found: list[Contact] = []
    for segment in segments:
        rows = np.flatnonzero(curves.segment == segment)
        if not len(rows):
            raise ValueError(f"no path belongs to segment {segment}")
        low, high, best = np.zeros(len(rows)), np.ones(len(rows)), None
        for _ in range(ROUNDS):
            s = np.linspace(low, high, PLACES)  # (PLACES, rows)
            powers = s[..., None] ** np.arange(curves.coefficients.shape[1])
            x = np.einsum("prk,rkn->prn", powers, curves.coefficients[rows])
            clearance = start_cause.clearances_at(problem, x.reshape(-1, x.shape[2])).reshape(s.shape)
            k, row = map(int, np.unravel_index(clearance.argmin(), s.shape))
            if best is None or clearance[k, row] < best[0]:
                begin, end = curves.span[rows[row]]
                best = float(clearance[k, row]), float(begin + s[k, row] * (end - begin)), x[k, row]
            least, each = clearance.argmin(axis=0), np.arange(len(rows))
            low, high = s[np.maximum(least - 1, 0), each], s[np.minimum(least + 1, PLACES - 1), each]
        clearance_m, place, at = best
        bodies = start_cause.closest_bodies(problem, at)
        names = bodies.body, bodies.other
        found.append(Contact(int(segment), place, at, *names, clearance_m, problem.robot.pieces is not None))
        progress(len(found), len(segments))
    return found
