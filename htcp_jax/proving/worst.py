"""The first and the deepest contact found on a segment of a refuted motion: place, body and obstacle."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import mm_text
from htcp_jax.motion import Problem, start_cause
from htcp_jax.proving.curves import JointCurves

PLACES = 65  # configurations on a path that are measured first
ROUNDS = 4  # times that the neighbourhood of the deepest one is measured again
PAIRS = 3  # maximum number of pairs of bodies that are named at a configuration


class Contact(NamedTuple):
    """Configuration with the smallest clearance that was found on a segment, or the first one in collision."""

    segment: int
    place: float  # share of the segment [1]
    x: Float[np.ndarray, "N"]  # [rad or m]
    body: str  # label of the body
    other: str  # name of the obstacle or the other body
    clearance_m: float  # D; below 0 in collision [m]
    link: int  # number of the link to which the body belongs
    point: Float[np.ndarray, "3"]  # nearest point of the obstacle or the other body, world [m]
    is_capsule: bool = False  # True: a depth is that of the capsule about a convex piece, an upper bound
    of_mesh: bool = False  # True: to points on a mesh, so that a distance is an upper bound and a depth a lower one
    others: tuple["Contact", ...] = ()  # next pairs of bodies at this configuration, the smallest clearance first

    @property
    def depth(self) -> str:
        """The depth as text, with the kind of bound that it is."""
        above, below = ("at most ", "about ") if self.is_capsule else ("", "at least ")
        return f"{below if self.of_mesh else above}{-1e3 * self.clearance_m:.3g} mm"

    @property
    def text(self) -> str:
        """The bodies, and the depth or the distance, as text."""
        if self.clearance_m <= 0:
            return f"{self.body} is {self.depth} inside {self.other}"
        return f"{self.body} is {'at most ' if self.of_mesh else ''}{mm_text(self.clearance_m)} from {self.other}"

    @property
    def at(self) -> str:
        """The point as text."""
        return f"at ({', '.join(f'{value:.3f}' for value in self.point)}) m"


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
            s, x, clearance = _measured(problem, curves, rows, low, high)
            k, row = map(int, np.unravel_index(clearance.argmin(), s.shape))
            if best is None or clearance[k, row] < best[0]:
                begin, end = curves.span[rows[row]]
                best = float(clearance[k, row]), float(begin + s[k, row] * (end - begin)), x[k, row]
            least, each = clearance.argmin(axis=0), np.arange(len(rows))
            low, high = s[np.maximum(least - 1, 0), each], s[np.minimum(least + 1, PLACES - 1), each]
        clearance_m, place, at = best
        found.append(_contact(problem, segment, place, at, clearance_m))
        progress(len(found), len(segments))
    return found


def first_contact(problem: Problem, curves: JointCurves, segment: int, limit_m: float = 0.0) -> Contact | None:
    """Return the first configuration on a segment with a clearance of at most a limit, by samples.

    Args:
        problem: The problem, see `scene.scene_of`.
        curves: The joint paths.
        segment: Number of the segment.
        limit_m: The clearance [m]; 0: the first contact.

    Returns:
        The configuration; None if no sample has so small a clearance.
    """
    rows, low, high, found = np.flatnonzero(curves.segment == segment), 0.0, 1.0, None
    for _ in range(ROUNDS):
        s, x, clearance = _measured(problem, curves, rows, np.full(len(rows), low), np.full(len(rows), high))
        begin, end = curves.span[rows].T
        place = np.where(clearance <= limit_m, begin + s * (end - begin), np.inf)
        k, row = map(int, np.unravel_index(place.argmin(), s.shape))
        if not np.isfinite(place[k, row]):
            break
        found = float(place[k, row]), x[k, row], float(clearance[k, row])
        rows, low, high = rows[row : row + 1], float(s[max(k - 1, 0), row]), float(s[k, row])
    return None if found is None else _contact(problem, segment, *found)


def _measured(
    problem: Problem, curves: JointCurves, rows: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return PLACES parameters s between `low` and `high` on each path, the configurations there, and their D [m]."""
    s = np.linspace(low, high, PLACES)  # (PLACES, rows)
    powers = s[..., None] ** np.arange(curves.coefficients.shape[1])
    x = np.einsum("prk,rkn->prn", powers, curves.coefficients[rows])
    return s, x, start_cause.clearances_at(problem, x.reshape(-1, x.shape[2])).reshape(s.shape)


def _contact(problem: Problem, segment: int, place: float, x: np.ndarray, clearance_m: float) -> Contact:
    about, is_capsule = (int(segment), place, x), problem.robot.pieces is not None
    first, *others = (
        Contact(*about, own.body, own.other, -own.depth_m, own.link, own.point, is_capsule, own.of_mesh)
        for own in start_cause.closest_pairs(problem, x, PAIRS)
    )
    return first._replace(clearance_m=clearance_m, others=tuple(others))
