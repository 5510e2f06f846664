"""Deviation of a motion from the job's path: distance of the TCP, errors of the task's rows, share of the path.

All figures are measured at sampled places of the segments: both ends, and BETWEEN places between them.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.model import Robot, Task
from htcp_jax.model import robot as robots
from htcp_jax.motion import Problem
from htcp_jax.numerics import safe_norm
from htcp_jax.proving.curves import JointCurves
from htcp_jax.status import Kind
from htcp_jax.trajectory import in_padded_sizes, tcp_at

BETWEEN = 8  # sampled places between the ends of a joint path
NEAR_M = 1e-3  # configurations within this distance of the path, or its tolerance, begin and end the process
TIED_M = 1e-5  # points of the path count as equally near within this distance
JUMP = 3.0  # consecutive samples cover the path between them if it is at most this times as long as the TCP's step
PROGRESS = 1e-6  # motion along the path, counted in targets, below which a segment does not lead along it
ARRIVAL = 1e-6  # travel of an indexed axis on the first segment of a seam that does not count [rad or m]
CHUNK = 4096  # sampled places at a time
PROCESS = (Kind.PROCESS.words, Kind.DWELL.words)  # kinds of rows on the path in this package's files


class RowDeviation(NamedTuple):
    """Largest error of one row of the task."""

    row: str  # the row, as the job writes it
    error: float  # error, or violation of a cone or band [rad if `is_angle`, else m]
    is_angle: bool
    segment: int | None  # segment on which it occurs; None: the row is never violated


class IndexedTravel(NamedTuple):
    """Largest travel of an indexed axis on a segment of the path, where it must stand still."""

    joint: str
    slides: bool  # True for a prismatic joint
    travel: float  # [rad or m]
    segment: int | None  # segment with this travel; None: the axis stands still


class PathTask(NamedTuple):
    """A task along a path."""

    task: Task
    names: tuple[str, ...]  # its rows as text; empty: the TCP on the path
    here: Bool[np.ndarray, "T"]  # True for the points of the path at which it applies
    goals: Float[np.ndarray, "T G"]  # its goals there; meaningless at other points


class PathDeviation(NamedTuple):
    """Deviation of a motion from the job's path, at sampled places; of poses, `segment` and others count poses."""

    first: int  # first segment that is compared with the path
    last: int  # last one
    distance_m: float  # largest distance of the TCP from the path
    segment: int  # segment on which it occurs
    tolerance_m: float  # the job's path tolerance
    length_m: float  # length of the path
    covered_m: float  # length of the path that the TCP passes within NEAR_M, or within the tolerance
    rows: tuple[RowDeviation, ...]
    points: int = 0  # number of seams of one target
    missed: tuple[int, ...] = ()  # numbers of those, in the job's order, that no configuration comes near
    indexed: tuple[IndexedTravel, ...] = ()  # travel of the indexed axes on segments along the path


class _Path(NamedTuple):
    """Path of a job as a polyline for each seam."""

    points: Float[np.ndarray, "T 3"]  # world, or the part's frame if the part moves [m]
    along: Float[np.ndarray, "T"]  # length from the first point, without the gaps between seams [m]
    begins: tuple[int, ...]  # first points of the second and of each later seam

    @property
    def gaps(self) -> Int[np.ndarray, "_"]:
        """Pieces of the polyline that lead from seam to seam."""
        return np.array(self.begins, int) - 1

    @property
    def singles(self) -> Int[np.ndarray, "p"]:
        """Points that are seams of one target; none if there is only one seam."""
        ends = np.array([0, *self.begins, len(self.points)])
        return ends[:-1][np.diff(ends) == 1] if self.begins else np.empty(0, int)

    def seams_of(
        self, distance: Float[np.ndarray, "n"], place: Float[np.ndarray, "n"], near_m: float
    ) -> Int[np.ndarray, "n"]:
        """Return each configuration's seam, from the first to the last one near it; -1 before, between and after.

        Args:
            distance: Distances from the path [m].
            place: Places of the path's nearest points, counted in targets.
            near_m: Distance within which configurations count as near [m].
        """
        found, seam = np.full(len(place), -1), np.searchsorted(self.begins, place, "right")
        for number in range(1 + len(self.begins)):
            near = np.flatnonzero((distance <= near_m) & (seam == number))
            if len(near):
                found[near[0] : near[-1] + 1] = number
        return found


def has_path(problem: Problem) -> bool:
    """Return True if the problem's first scenario has a path of two points or more, or several seams."""
    return _path(problem) is not None


def near_path_m(problem: Problem) -> float:
    """Return the distance within which configurations count as on the path [m]."""
    return max(NEAR_M, problem.settings.tube_m)


def tcp_positions(problem: Problem, x: Float[np.ndarray, "n N"]) -> Float[np.ndarray, "n 3"]:
    """Return the TCP's positions with the scenario's tool, world, or the part's frame if the part moves [m]."""
    return tcp_at(_with_tool(problem), x)[0]


def path_deviation(
    problem: Problem,
    curves: JointCurves,
    x: Float[np.ndarray, "n N"],
    kind: tuple[str, ...] | None,
    tasks: Sequence[PathTask],
) -> PathDeviation | None:
    """Return the deviation of a motion from the path of the problem's first scenario.

    Args:
        problem: The problem.
        curves: The motion's joint paths.
        x: Its configurations [rad or m].
        kind: Kind of each configuration in the motion's file; None: unknown.
        tasks: The tasks along the path.

    Returns:
        The deviation; None if the path has fewer than two points, or if no configuration is near it.
    """
    path, near_m = _path(problem), near_path_m(problem)
    if path is None:
        return None
    on = _process(problem, path, x, kind, near_m)
    certain = np.flatnonzero(curves.is_certain & on[curves.segment])
    visits = _visits(path, tcp_positions(problem, x), near_m)
    if not len(certain) and not len(visits.row):
        return None
    share = np.linspace(0, 1, BETWEEN + 2)
    powers = share[:, None] ** np.arange(curves.coefficients.shape[1])
    sampled = np.einsum("pk,mkn->mpn", powers, curves.coefficients[certain]).reshape(-1, x.shape[1])
    segment = np.repeat(curves.segment[certain], len(share))
    tcp = tcp_positions(problem, sampled) if len(sampled) else np.empty((0, 3))
    distance, place = _nearest(path, tcp)
    covered = _covered(path, tcp, place, distance <= near_m)
    to = np.minimum(visits.row, len(on) - 1)  # segments at whose beginning, or last end, points are visited
    distance, place = np.append(distance, visits.distance_m), np.append(place, visits.point)
    sampled, segment = np.concatenate([sampled, x[visits.row]]), np.append(segment, to)
    worst, segments = int(distance.argmax()), np.append(np.flatnonzero(on), to)
    return PathDeviation(
        int(segments.min()),
        int(segments.max()),
        float(distance[worst]),
        int(segment[worst]),
        float(problem.settings.tube_m),
        float(path.along[-1]),
        covered,
        _row_deviations(problem, path, sampled, place, segment, tasks),
        len(path.singles),
        visits.missed,
        _indexed_travel(problem, path, curves, x, on, _says_process(kind)) if problem.robot.indexed else (),
    )


def _indexed_travel(
    problem: Problem,
    path: _Path,
    curves: JointCurves,
    x: Float[np.ndarray, "n N"],
    on: Bool[np.ndarray, "m"],
    is_known: bool,
) -> tuple[IndexedTravel, ...]:
    """Return the travel of the indexed axes on the path: a bound, which is 0 if they stand still.

    In a file of samples, an air move ends between two samples. Therefore up to ARRIVAL does not count on the first
    segment of a seam.

    Args:
        problem: The problem.
        path: Its path.
        curves: The motion's joint paths.
        x: Its configurations [rad or m].
        on: True for segments on the path.
        is_known: False if `on` means only near the path. Then segments that do not lead along it are excluded, as the
            end of an air move.
    """
    begins = on & ~np.append(False, on[:-1])
    if not is_known:
        on = _leading_along(on, _nearest(path, tcp_positions(problem, x))[1])
    here, found = np.flatnonzero(on[curves.segment]), []
    travel = np.abs(curves.coefficients[here, 1:]).sum(axis=1)
    travel[begins[curves.segment[here], None] & (travel <= ARRIVAL)] = 0.0
    for joint in np.flatnonzero(problem.indexed).tolist():
        worst = int(travel[:, joint].argmax()) if len(here) else 0
        most = float(travel[worst, joint]) if len(here) else 0.0
        slides = bool(problem.robot.sliding[joint])
        segment = int(curves.segment[here[worst]]) if most > 0 else None
        found.append(IndexedTravel(problem.robot.joint_names[joint], slides, most, segment))
    return tuple(found)


def _leading_along(on: Bool[np.ndarray, "m"], place: Float[np.ndarray, "m+1"]) -> Bool[np.ndarray, "m"]:
    """Return those segments near the path that lead along it: without the ends of air moves.

    Args:
        on: True for segments near the path.
        place: Places on the path nearest to the configurations, counted in targets.
    """
    along = np.flatnonzero(on & (np.abs(np.diff(place)) > PROGRESS))
    seam = np.cumsum(on & ~np.append(False, on[:-1]))
    first, last = (np.full(seam[-1] + 1, k) for k in (len(on), -1))
    np.minimum.at(first, seam[along], along)
    np.maximum.at(last, seam[along], along)
    row = np.arange(len(on))
    return on & (row >= first[seam]) & (row <= last[seam])


def seams_of_segments(
    problem: Problem, x: Float[np.ndarray, "n N"], kind: tuple[str, ...] | None
) -> Int[np.ndarray, "n-1"]:
    """Return the number of the seam that each segment of a motion leads along; -1 for other segments.

    Args:
        problem: The problem.
        x: The motion's configurations [rad or m].
        kind: Kind of each configuration in the motion's file; None: unknown.
    """
    path = _path(problem)
    if path is None:
        return np.full(len(x) - 1, -1)
    on = _process(problem, path, x, kind, near_path_m(problem))
    place = _nearest(path, tcp_positions(problem, x))[1]
    on = on if _says_process(kind) else _leading_along(on, place)
    return np.where(on, np.searchsorted(path.begins, place[1:], "right"), -1)


def pose_deviation(problem: Problem, points: Float[np.ndarray, "n 3"]) -> PathDeviation | None:
    """Return the deviation of TCP positions from the path [m]; None without a path, or if no position is near it.

    The positions from the first to the last one that is near each seam are compared.
    """
    path, near_m = _path(problem), near_path_m(problem)
    if path is None or not len(points):
        return None
    distance, place = _nearest(path, points)
    along, visits = np.flatnonzero(path.seams_of(distance, place, near_m) >= 0), _visits(path, points, near_m)
    covered = _covered(path, points[along], place[along], distance[along] <= near_m)
    distance[visits.row] = np.minimum(distance[visits.row], visits.distance_m)
    compared = np.union1d(along, visits.row)
    if not len(compared):
        return None
    first, last = int(compared[0]), int(compared[-1])
    worst = int(compared[distance[compared].argmax()])
    tolerance_m, length_m = float(problem.settings.tube_m), float(path.along[-1])
    about = float(distance[worst]), worst, tolerance_m, length_m, covered, ()
    return PathDeviation(first, last, *about, len(path.singles), visits.missed)


class _Visits(NamedTuple):
    """Visits of seams of one target."""

    point: Int[np.ndarray, "v"]  # the visited points of the path
    row: Int[np.ndarray, "v"]  # nearest configuration to each
    distance_m: Float[np.ndarray, "v"]  # its distance
    missed: tuple[int, ...]  # numbers of the seams that are not visited


def _visits(path: _Path, tcp: Float[np.ndarray, "n 3"], near_m: float) -> _Visits:
    """Return the visits of seams of one target by TCP positions within a distance of them [m]."""
    points = path.singles
    if not len(points):
        return _Visits(points, points, np.empty(0), ())
    distance, row = scipy.spatial.KDTree(tcp).query(path.points[points])
    near = distance <= near_m
    number = np.searchsorted(path.begins, points[~near], "right")
    return _Visits(points[near], np.asarray(row)[near], distance[near], tuple(number.tolist()))


def _with_tool(problem: Problem) -> Robot:
    return robots.lengthen_tool(problem.robot, float(problem.scenarios.tool_extension_m[0]))


def _path(problem: Problem) -> _Path | None:
    here = problem.scenarios
    rows = slice(int(here.on_path[0]), int(here.count[0]))
    points = np.asarray(here.targets[0][rows, :3], float)
    if len(points) < 2:
        return None
    begins = problem.workpiece.seam_begins
    pieces = np.linalg.norm(np.diff(points, axis=0), axis=1)
    pieces[np.array(begins, int) - 1] = 0.0
    path = _Path(points, np.append(0.0, np.cumsum(pieces)), begins)
    return path if path.along[-1] > 0 or len(path.singles) else None


def _says_process(kind: tuple[str, ...] | None) -> TypeGuard[tuple[str, ...]]:
    """Return True if the file has rows on the path by their kind."""
    return kind is not None and any(name.lower() in PROCESS for name in kind[1:])


def _process(
    problem: Problem, path: _Path, x: Float[np.ndarray, "n N"], kind: tuple[str, ...] | None, near_m: float
) -> Bool[np.ndarray, "m"]:
    """Return True for the segments on the path."""
    if _says_process(kind):
        return np.array([name.lower() in PROCESS for name in kind[1:]])
    seam = path.seams_of(*_nearest(path, tcp_positions(problem, x)), near_m)
    return (seam[:-1] >= 0) & (seam[:-1] == seam[1:])


def _nearest(path: _Path, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return the distances of points from the path [m], and the places of its nearest points, counted in targets.

    Among places that are equally near, such as both ends of a closed path, the one nearest to the previous point's
    place is chosen.
    """
    a, d = path.points[:-1], np.diff(path.points, axis=0)
    squared = np.maximum((d * d).sum(axis=1), 1e-30)
    distance, place, before = np.empty(len(points)), np.empty(len(points)), 0.0
    size = max(1, CHUNK * 64 // len(d))
    for first in range(0, len(points), size):
        off = points[first : first + size, None] - a
        share = np.clip((off * d).sum(axis=2) / squared, 0, 1)
        apart = np.linalg.norm(off - share[..., None] * d, axis=2)
        apart[:, path.gaps] = np.inf
        least = apart.min(axis=1)
        distance[first : first + size] = least
        for k in range(len(least)):
            near = np.flatnonzero(apart[k] <= least[k] + TIED_M)
            at = near + share[k, near]
            before = place[first + k] = at[np.abs(at - before).argmin()]
    return distance, place


def _covered(
    path: _Path, tcp: Float[np.ndarray, "n 3"], place: Float[np.ndarray, "n"], near: Bool[np.ndarray, "n"]
) -> float:
    """Return the length of the path between consecutive places that are near it [m]."""
    s = np.interp(place, np.arange(len(path.along)), path.along)
    low, high = np.minimum(s[:-1], s[1:]), np.maximum(s[:-1], s[1:])
    step = np.linalg.norm(np.diff(tcp, axis=0), axis=1)
    counted = near[:-1] & near[1:] & (high - low <= JUMP * step + NEAR_M)
    low, high = low[counted], high[counted]
    order, covered, end = np.argsort(low), 0.0, 0.0
    for begin, until in zip(low[order].tolist(), high[order].tolist(), strict=True):
        covered += max(0.0, until - max(begin, end))
        end = max(end, until)
    return covered


def _row_deviations(
    problem: Problem,
    path: _Path,
    x: Float[np.ndarray, "n N"],
    place: Float[np.ndarray, "n"],
    segment: Int[np.ndarray, "n"],
    tasks: Sequence[PathTask],
) -> tuple[RowDeviation, ...]:
    """Return the largest error of each row; that of a row which several tasks have is the largest of all."""
    found = dict[tuple[str, int], RowDeviation]()
    own_point = np.floor(place).astype(int)
    before = np.clip(own_point, 0, len(path.points) - 2)
    both = np.stack([before, before + 1], axis=1)
    for task, names, here, goals in tasks:
        own = np.flatnonzero(here[own_point])
        if not len(own):
            continue
        ends = np.where(here[both[own]], both[own], own_point[own, None])
        between = task.interpolated(goals[ends], place[own] - before[own], path.points[ends])
        (errors,) = in_padded_sizes(partial(_row_errors, task), _with_tool(problem), x[own], between)
        for k, part in enumerate(task.parts):
            worst = int(errors[:, k].argmax())
            error, name = float(errors[worst, k]), names[k] if k < len(names) else "TCP on path"
            row = RowDeviation(name, error, bool(part.angular), int(segment[own[worst]]) if error > 0 else None)
            key = name, names[:k].count(name)
            found[key] = max(found.get(key, row), row, key=lambda each: each.error)
    return tuple(found.values())


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, None, 0, 0))
def _row_errors(task: Task, robot: Robot, x, goal):
    """Return each row's error, or the violation of its inequalities [m or rad]."""
    value, found, v = task.value(robot, x), [], 0
    for start, part in zip(task.starts, task.parts, strict=True):
        own = value[v : v + part.size], goal[start : start + part.numbers]
        v += part.size
        error = safe_norm(part.error(*own)) if part.equalities else jnp.zeros(())
        broken = jnp.max(-part.slack(*own), initial=0.0) if part.inequalities else jnp.zeros(())
        found.append(jnp.maximum(error, broken))
    return (jnp.stack(found),)
