"""Prove or refute motions: `htcp_jax.prove(robot, x, obstacles=...)`.

```python
proof = htcp_jax.prove("cell.yaml", x)      # x: configurations (n, N), or a batch of motions (M, n, N)
proof.proven                                 # True, or one value per motion
proof.clearance_m                            # guaranteed clearance of each segment [m]
```

A segment is proven if all joint paths that belong to it are clear, see `curves.JointCurves`. It is refuted if one of
them collides that the controller takes for certain, or would take without a servo's lag. Otherwise it is undecided: a
path inside a corner, or within the lag, may collide, or a mesh may be nearer than the points on it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Obstacle
from htcp_jax.clearance.proof import bisection
from htcp_jax.device import devices, tables
from htcp_jax.errors import InputError
from htcp_jax.motion import CollisionChecker, Problem
from htcp_jax.motion import raised_bounds as bounds
from htcp_jax.proving.curves import JointCurves, straight
from htcp_jax.proving.scene import Cell, scene_of
from htcp_jax.spec import ObstacleKind, TaskRowKind
from htcp_jax.status import SegmentStatus, UndecidedCause

KEPT = 0.5  # share of the clearance at an interval's middle that is proven on the interval
Margins = float | Float[np.ndarray, "m"]  # required clearance: one, or one per segment [m]; 0: any above 0
TIGHT = 0.99  # this share for the segments of files that decide the guaranteed clearance, see `tighten`


@dataclass(frozen=True, eq=False)
class MotionProof:
    """Results of proofs, one per segment; a batch of M motions has arrays (M, m), one motion has arrays (m,)."""

    verdict: Int[np.ndarray, "*M m"]  # `status.SegmentStatus`
    clearance_m: Float[np.ndarray, "*M m"]  # guaranteed clearance on all of the segment [m]; NaN if it is not proven
    place: Float[np.ndarray, "*M m"]  # share of the segment at which it is refuted or undecided [1]; NaN if proven
    queries: Int[np.ndarray, "*M m"]  # number of checked intervals, without those of paths that are not proven
    cause: Int[np.ndarray, "*M m"]  # `status.UndecidedCause` of undecided segments; NONE of others

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The fields, in their order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @property
    def proven(self) -> Bool[np.ndarray, "*M"]:
        """True for motions of which every segment is proven."""
        return np.asarray((self.verdict == SegmentStatus.VALID).all(axis=-1))

    @property
    def is_refuted(self) -> Bool[np.ndarray, "*M m"]:
        """True for refuted segments."""
        return ~np.isin(self.verdict, (SegmentStatus.VALID, SegmentStatus.UNDECIDED))

    @property
    def refuted(self) -> Bool[np.ndarray, "*M"]:
        """True for motions of which a segment is refuted."""
        return np.asarray(self.is_refuted.any(axis=-1))

    @property
    def guaranteed_m(self) -> Float[np.ndarray, "*M"]:
        """Guaranteed clearance of each motion [m]; NaN if it is not proven, infinite without obstacles."""
        return np.asarray(self.clearance_m.min(axis=-1, initial=np.inf))

    def with_rows(self, rows: Int[np.ndarray, "k"], **changes: np.ndarray) -> "MotionProof":
        """Return one motion's proof with other values of some fields in some rows."""
        new = {name: getattr(self, name).copy() for name in changes}
        for name, values in changes.items():
            new[name][rows] = values
        return replace(self, **new)


def prove(
    cell: Cell,
    x: Float[np.ndarray, "*M n N"],
    *,
    obstacles: Sequence[Obstacle | ObstacleKind | Mapping[str, Any]] = (),
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    margin_m: float = 0.0,
    tracking_rad: float | Sequence[float] = 0.0,
    kept: float = KEPT,
    device: str | None = None,
) -> MotionProof:
    """Prove or refute that motions along straight joint paths are clear.

    Args:
        cell: A robot, or a job: a file, the name of an example, a mapping; see `scene_of`.
        x: Configurations of one motion (n, N), or of M motions (M, n, N), in the order of `robot.joint_names`
            [rad or m].
        obstacles: Obstacles in addition to the job's.
        task: Task rows that replace the job's.
        overrides: Changes to the job, see `htcp_jax.plan`.
        margin_m: Required clearance [m].
        tracking_rad: Largest distance of each joint from the motion, as by a servo's lag [rad or m]; one value, or one
            per joint.
        kept: Share of the clearance at an interval's middle that the proof guarantees on the whole interval. A larger
            share gives a larger guaranteed clearance and takes longer.
        device: The device; None: a GPU if there is one.

    Returns:
        One verdict per segment between consecutive configurations.

    Raises:
        InputError: For invalid input, or configurations of the wrong number of joints or that are not finite.
    """
    check_margin(margin_m)
    problem = scene_of(cell, overrides, obstacles=obstacles, task=task, device=device).problem
    x = _configurations(x, problem)
    motions, points, joints = (1, *x.shape) if x.ndim == 2 else x.shape
    flat = x.reshape(motions, points, joints)
    curves = straight(flat.reshape(-1, joints))
    within = np.arange(motions * points - 1) % points < points - 1  # without the steps from motion to motion
    curves = JointCurves(*tables.gather(tuple(curves), within))
    curves = curves._replace(segment=np.arange(len(curves.segment)))
    lag = tracking_of(tracking_rad, joints)
    found = prove_within(problem, curves, lag, margin_m=margin_m, kept=kept)
    shape = (points - 1,) if x.ndim == 2 else (motions, points - 1)
    return MotionProof(*(each.reshape(shape) for each in found.arrays))


def with_margin(problem: Problem, margin_m: float) -> Problem:
    """Return the problem with at least this margin [m], so that distances of convex pieces are known beyond it."""
    scenarios = problem.scenarios
    return problem.with_scenarios(replace(scenarios, margin_m=np.maximum(scenarios.margin_m, margin_m)))


def check_margin(margin_m: float) -> None:
    """Check a required clearance [m].

    Raises:
        InputError: If it is below 0 or not finite.
    """
    if not 0 <= margin_m < np.inf:
        raise InputError(f"margin_m is {margin_m}; it must be 0 or more")


def tracking_of(tracking_rad: float | Sequence[float], joints: int) -> Float[np.ndarray, "N"]:
    """Return the largest distance of each joint from a motion [rad or m].

    Args:
        tracking_rad: One value, or one per joint [rad or m].
        joints: Number of joints.

    Raises:
        InputError: For another number of values, and for values below 0 or not finite.
    """
    lag = np.asarray(tracking_rad, float)
    if lag.ndim > 1 or (lag.ndim and lag.shape != (joints,)) or not (lag >= 0).all() or not np.isfinite(lag).all():
        raise InputError(f"tracking_rad is {tracking_rad}; valid: one number of 0 or more, or {joints} of them")
    return np.broadcast_to(lag, joints)


def prove_within(
    problem: Problem,
    curves: JointCurves,
    lag: Float[np.ndarray, "N"],
    *,
    margin_m: Margins = 0.0,
    kept: float = KEPT,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> MotionProof:
    """Prove or refute joint paths from which each joint may be away by a servo's lag.

    A segment that is undecided with the lag, but refuted without it, is refuted.

    Args:
        problem: The problem, see `scene_of`.
        curves: The joint paths, without the lag.
        lag: Largest distance of each joint from the paths [rad or m].
        margin_m: Required clearance, or that of each segment [m]; 0: any above 0.
        kept: See `prove`.
        progress: See `prove_curves`.
    """
    found = prove_curves(problem, curves.within(lag), margin_m=margin_m, kept=kept, progress=progress)
    undecided = np.flatnonzero(found.verdict == SegmentStatus.UNDECIDED)
    if not lag.any() or not len(undecided):
        return found
    exact = prove_curves(problem, curves.of_segments(undecided), margin_m=_margins_at(margin_m, undecided), kept=kept)
    return found.with_rows(
        undecided,
        verdict=np.where(exact.is_refuted, exact.verdict, found.verdict[undecided]),
        place=np.where(exact.is_refuted, exact.place, found.place[undecided]),
        queries=found.queries[undecided] + exact.queries,
        cause=np.where(exact.verdict == SegmentStatus.VALID, int(UndecidedCause.TRACKING), exact.cause),
    )


def tighten(
    problem: Problem, curves: JointCurves, found: MotionProof, *, margin_m: Margins = 0.0, kept: float = KEPT
) -> MotionProof:
    """Return a motion's proof with tighter bounds on the segments that decide its guaranteed clearance.

    The clearance is at most the guaranteed one / `kept`, so other segments need no tighter bound.

    Args:
        problem: The problem.
        curves: The joint paths, with the servo's lag.
        found: Their proof.
        margin_m: Required clearance, or that of each segment [m].
        kept: Share of the clearance with which they were proven.
    """
    loose = np.flatnonzero(found.clearance_m < found.guaranteed_m / kept)
    if not found.proven or not len(loose):
        return found
    again = prove_curves(problem, curves.of_segments(loose), margin_m=_margins_at(margin_m, loose), kept=TIGHT)
    clearance, queries = found.clearance_m.copy(), found.queries.copy()
    clearance[loose] = np.fmax(clearance[loose], again.clearance_m)
    queries[loose] += again.queries

    def more(k: int) -> bounds.Proving[float]:
        margin = float(np.max(_margins_at(margin_m, np.array([k]))))
        return _raised(curves.of_segments(np.array([k])), margin)

    def proven(asked: list[tuple[JointCurves, float]]) -> list[Float[np.ndarray, "_"]]:
        return [prove_curves(problem, own, margin_m=margin, kept=TIGHT).clearance_m for own, margin in asked]

    bounds.together([bounds.raise_smallest(clearance, more)], proven)
    return replace(found, clearance_m=clearance, queries=queries)


def _raised(curves: JointCurves, margin_m: float) -> bounds.Proving[float]:
    """Return the clearance that proofs of parts of one segment's paths guarantee [m]; yield parts and the margin."""
    own = curves._replace(segment=np.arange(len(curves.segment)))
    clearance = yield own, margin_m

    def more(j: int) -> bounds.Proving[float]:
        return bounds.raised(lambda begin, end: (own.between(j, begin, end), margin_m), clearance[j])

    yield from bounds.raise_smallest(clearance, more)
    return clearance.min()


def prove_curves(
    problem: Problem,
    curves: JointCurves,
    *,
    margin_m: Margins = 0.0,
    kept: float = KEPT,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> MotionProof:
    """Prove or refute that joint paths are clear in a problem's first scenario; one verdict per segment.

    Distances from a mesh are those from points on it, less their covering radius. These distances prove; those from the
    points refute.

    Args:
        problem: The problem, see `scene_of`.
        curves: The joint paths.
        margin_m: Required clearance, or that of each segment [m].
        kept: See `prove`.
        progress: Function that is called with the numbers of paths proven so far, and of all paths.
    """
    found = _proven(problem, curves, margin_m, kept, progress)
    refuted = np.flatnonzero(found.is_refuted)
    if not len(refuted) or (of_points := problem.without_covering_radius) is problem:
        return found
    again = _proven(of_points, curves.of_segments(refuted), _margins_at(margin_m, refuted), kept)
    proven = again.verdict == SegmentStatus.VALID
    return found.with_rows(
        refuted,
        verdict=np.where(proven, int(SegmentStatus.UNDECIDED), again.verdict),
        place=np.where(proven, found.place[refuted], again.place),
        queries=found.queries[refuted] + again.queries,
        cause=np.where(proven, int(UndecidedCause.MESH_POINTS), again.cause),
    )


def _proven(
    problem: Problem,
    curves: JointCurves,
    margin_m: Margins,
    kept: float,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> MotionProof:
    """Return the verdicts by the problem's distances, see `prove_curves`."""
    done, count = 0, len(curves.segment)
    if not count:
        empty = np.zeros(0)
        return MotionProof(empty.astype(np.int32), empty, empty, *(empty.astype(np.int32) for _ in range(2)))

    def run(checker: CollisionChecker, share: slice) -> bisection.Proof:
        nonlocal done
        parts = []
        for part in tables.portions(tables.gather(tuple(curves), share)):
            parts.append(_proofs(problem, checker, JointCurves(*part), margin_m, kept))
            done += len(part[-1])
            progress(done, count)
        return tables.concatenate(parts)

    with devices.on(problem.devices[0]):
        found = tables.interleaved(problem.in_threads(run, min(problem.threads, count)))
    return _by_segment(curves, found)


def _proofs(
    problem: Problem, checker: CollisionChecker, curves: JointCurves, margin_m: Margins, kept: float
) -> bisection.Proof:
    """Return one proof per joint path; straight ones are proven by the executable that plans use."""
    count = len(curves.segment)
    required = np.broadcast_to(_margins_at(margin_m, curves.segment), count)
    inputs, margins = problem.inputs(np.zeros(count, int), 0), np.where(required > 0, required, -np.inf)
    if curves.is_straight:
        a = curves.coefficients[:, 0]
        return checker.clear_edges(inputs, a, a + curves.coefficients[:, 1], margins, kept=kept)
    return checker.polynomial_edges(inputs, curves.coefficients, curves.off, margins, kept=kept)


def _margins_at(margin_m: Margins, segments: Int[np.ndarray, "k"]) -> Margins:
    """Return the required clearance on some segments [m]."""
    return margin_m[segments] if isinstance(margin_m, np.ndarray) else margin_m


def _by_segment(curves: JointCurves, proofs: bisection.Proof) -> MotionProof:
    """Return the proofs of all paths as one verdict per segment."""
    count = int(curves.segment[-1]) + 1
    # A path that may not be taken refutes nothing.
    unproven = np.where(curves.is_certain, proofs.verdict, int(SegmentStatus.UNDECIDED))
    verdict = np.where(proofs.verdict == SegmentStatus.VALID, int(SegmentStatus.VALID), unproven)
    place = curves.span[:, 0] + proofs.place * (curves.span[:, 1] - curves.span[:, 0])
    # The first refuted path of a segment decides, else the first undecided one, else all are proven.
    rank = np.where(verdict == SegmentStatus.VALID, 2, np.where(verdict == SegmentStatus.UNDECIDED, 1, 0))
    order = np.lexsort((place, rank, curves.segment))
    first = order[np.searchsorted(curves.segment[order], np.arange(count))]
    proven = rank[first] == 2
    clearance, queries = np.full(count, np.inf), np.zeros(count, np.int64)
    np.minimum.at(clearance, curves.segment, proofs.clearance)
    np.add.at(queries, curves.segment, proofs.queries)
    cause = np.where(curves.is_certain[first], int(UndecidedCause.SUBDIVISION), int(UndecidedCause.CORNER))
    return MotionProof(
        verdict[first].astype(np.int32),
        np.where(proven, clearance, np.nan),
        np.where(proven, np.nan, place[first]),
        queries,
        np.where(rank[first] == 1, cause, int(UndecidedCause.NONE)),
    )


def _configurations(x: Any, problem: Problem) -> Float[np.ndarray, "*M n N"]:
    """Return validated configurations.

    Raises:
        InputError: For a wrong shape, for fewer than two configurations, and for a value that is not finite.
    """
    x, names = np.asarray(x, float), problem.robot.joint_names
    if x.ndim not in (2, 3) or x.shape[-1] != len(names) or x.shape[-2] < 2:
        raise InputError(
            f"the configurations have the shape {x.shape}; valid: (n, {len(names)}) or (M, n, {len(names)}), with n of "
            f"2 or more, for the joints {', '.join(names)}"
        )
    if not np.isfinite(x).all():
        where = np.argwhere(~np.isfinite(x))[0].tolist()
        raise InputError(f"the value of {names[where[-1]]} at index {tuple(where[:-1])} is not finite")
    return x
