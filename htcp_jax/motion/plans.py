"""Results of planning: the configuration and status at every target, and the outcome of each scenario.

    plans.tracked                     # (S, T) True where a target is tracked
    plans.outcomes.complete           # (S,)   True where all targets of a scenario are tracked
    plans.outcome(12).failed          # the first target of scenario 12 that is not tracked; None if all are

A method fills in the arrays of `problem.empty_plans()`, and adds via points by `_replace`. The returned plans are
final: each later step (`check_remaining_paths`, `begin_at_home`, `verify_motions`, `smooth`, `tighten`) returns new
plans, with copies of the columns that it changes.

Only this module derives a scenario's end from the statuses. Charts and viewers that have only statuses use `outcomes`.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from htcp_jax.motion.sparse_columns import DeadEnds, ViaPoints
from htcp_jax.status import MOTION, SegmentStatus, Status

NO_TARGET = -1  # status: the scenario has no such target, or is not planned yet
PATH_UNKNOWN = -1  # value of path_clear: not checked


class Outcome(NamedTuple):
    """Outcome of one scenario."""

    scenario: int  # row of the scenario
    targets: int  # number of targets; 0 if the scenario is not planned
    tracked: int  # number of tracked targets
    executable: int  # number of targets, from the first on, that a proven motion leads to
    failed: int | None  # index of the first target that is not tracked; None if all are
    status: Status | None  # status of the failed target; None if there is none
    blocked_paths: int  # number of tracked targets whose joint path from the previous row is known to collide
    # status of the segment after the last executable target; VALID or SAMPLED if no tracked target follows
    segment_status: SegmentStatus

    @property
    def complete(self) -> bool:
        """True if the scenario is planned and every target is tracked."""
        return self.targets > 0 and self.failed is None

    @property
    def can_be_driven(self) -> bool:
        """True if a proven motion leads to the scenario's last target."""
        return 0 < self.targets == self.executable

    @property
    def reason(self) -> str:
        """Reason why the motion ended: the status of the segment to a tracked target, or that of the failed target.

        "complete" if it did not end early.
        """
        if self.executable < self.tracked:
            return self.segment_status.words
        return "complete" if self.status is None else self.status.words


class Outcomes(NamedTuple):
    """Outcomes of S scenarios, one column each; see `Outcome`."""

    targets: Int[np.ndarray, "S"]
    tracked: Int[np.ndarray, "S"]
    executable: Int[np.ndarray, "S"]
    failed: Int[np.ndarray, "S"]  # -1 if all targets are tracked
    status: Int8[np.ndarray, "S"]  # NO_TARGET if all targets are tracked
    blocked_paths: Int[np.ndarray, "S"]
    segment_status: Int8[np.ndarray, "S"]  # `status.SegmentStatus`

    @property
    def planned(self) -> Bool[np.ndarray, "S"]:
        """True for scenarios that are planned."""
        return self.targets > 0

    @property
    def complete(self) -> Bool[np.ndarray, "S"]:
        """True for scenarios that are planned and have every target tracked."""
        return self.planned & (self.failed < 0)

    @property
    def can_be_driven(self) -> Bool[np.ndarray, "S"]:
        """True for scenarios with a proven motion to their last target."""
        return self.planned & (self.executable == self.targets)

    def of(self, scenario: int) -> Outcome:
        """Return the outcome of the scenario in one row."""
        targets, tracked, executable, failed, status, blocked, segment_status = (
            int(column[scenario]) for column in self
        )
        known = int(scenario), targets, tracked, executable
        if failed < 0:
            return Outcome(*known, None, None, blocked, SegmentStatus(segment_status))
        return Outcome(*known, failed, Status(status), blocked, SegmentStatus(segment_status))


class Retract(NamedTuple):
    """Proven motion from the last target of the only scenario back to the start, by straight joint paths."""

    x: Float[np.ndarray, "R N"]  # configurations after the last target, of which the last one is the start [rad or m]
    clearance: Float[np.ndarray, "R"]  # lower bound on D along the path to each of them [m]


class Plans(NamedTuple):
    """The plans of S scenarios with up to T targets each, for a robot of N joints; numpy arrays on the host.

    Targets that are not tracked have NaN in `x`, `tcp`, `clearance`, `residual`, `orientation_error` and `joint_step`.
    If a scenario has fewer than T targets, the remaining ones have the status NO_TARGET.
    """

    start: Float[np.ndarray, "S N"]  # the configuration that the plan starts from [rad or m]
    x: Float[np.ndarray, "S T N"]  # configurations [rad or m]
    tcp: Float[np.ndarray, "S T 3"]  # tool centre point, world [m]
    # Goal of the task's rows at each target; for an approach that leaves its lines, the path's first point
    target: Float[np.ndarray, "S T M"]  # the TCP's xyz for the paper's task [m]; NaN where there is no target
    clearance: Float[np.ndarray, "S T"]  # D(x, O), smallest over all rows [m]
    residual: Float[np.ndarray, "S T"]  # error of the task's points: |tcp - target| [m]
    orientation_error: Float[np.ndarray, "S T"]  # largest angle error of the task [rad]; NaN if it has no angles
    status: Int8[np.ndarray, "S T"]  # htcp_jax.status.Status, or NO_TARGET
    iterations: Int[np.ndarray, "S T"]  # number of step QPs solved for the target; 0 if planned backwards without any
    joint_step: Float[np.ndarray, "S T"]  # |x_t - x_{t-1}|, where x_{-1} is the start [rad]
    recovery: Int[np.ndarray, "S T"]  # 0: none; k: stage k of the method's recovery; last stage + 1: planned backwards
    path_clear: Int8[np.ndarray, "S T"]  # joint path from the previous row: 1 clear, 0 blocked, -1 unknown
    segment_status: Int8[np.ndarray, "S T"]  # `status.SegmentStatus` of the segment from the previous row
    segment_clearance: Float[np.ndarray, "S T"]  # lower bound on D along this segment [m]; NaN if it is not proven
    via_points: ViaPoints  # via points of segments that are not straight joint paths
    compile_s: float  # wall time spent waiting for compilation, or for processes to start [s]
    run_s: float  # wall time spent planning, without compilation [s]
    dead_ends: DeadEnds = DeadEnds.of({})  # dead ends of the search, and the attempts after them
    # First targets of the second and of each later seam, in all scenarios; the segments to them are transfers
    seam_begins: tuple[int, ...] = ()
    retract: Retract | None = None  # from the last seam done back to the start, see `way_back`; None: all reversed
    cpu_s: float = 0.0  # processor time of all threads and processes, without `Execution.warm_up` [s]; NaN: unknown

    @classmethod
    def empty(
        cls,
        start: Float[np.ndarray, "S N"],
        target: Float[np.ndarray, "S T M"],
        count: Int[np.ndarray, "S"] | int | None = None,
    ) -> "Plans":
        """Return plans without any attempted target, with new arrays to write into.

        Args:
            start: The configurations that the plans start from [rad or m].
            target: The targets [m].
            count: Number of targets of each scenario, which are the first ones of its row; None: T.
        """
        shape, joints = target.shape[:2], start.shape[1]
        count = np.broadcast_to(shape[1] if count is None else count, shape[:1])
        exists = np.arange(shape[1])[None, :] < count[:, None]
        arrays: dict[str, Any] = {name: np.full((*shape, *([joints] if name == "x" else [])), EMPTY[name], kind)
                  for name, kind in _KINDS.items()}  # fmt: skip
        arrays["tcp"] = np.full((*shape, 3), EMPTY["tcp"])
        arrays["status"][exists] = Status.NOT_ATTEMPTED
        arrays |= {"start": np.array(start, float), "target": np.array(target)}
        return cls(**arrays, via_points=ViaPoints.none(joints), compile_s=0.0, run_s=0.0)

    @classmethod
    def concatenate(cls, parts: "Sequence[Plans]") -> "Plans":
        """Return the plans of all parts in one table; their T may differ. Times are added up."""
        longest = max(part.status.shape[1] for part in parts)
        wide = [part.widened(longest).arrays() for part in parts]
        rows = [len(part.status) for part in parts]
        columns: dict[str, Any] = {name: np.concatenate([arrays[name] for arrays in wide]) for name in ARRAYS}
        return cls(
            **columns,
            via_points=consecutive([part.via_points for part in parts], rows),
            compile_s=sum(part.compile_s for part in parts),
            run_s=sum(part.run_s for part in parts),
            dead_ends=consecutive([part.dead_ends for part in parts], rows),
            seam_begins=parts[0].seam_begins,
            cpu_s=sum(part.cpu_s for part in parts),
        )

    @property
    def exists(self) -> Bool[np.ndarray, "S T"]:
        """True for existing targets; in an unfinished run, only for those of planned scenarios."""
        return self.status != NO_TARGET

    @property
    def tracked(self) -> Bool[np.ndarray, "S T"]:
        """True for tracked targets."""
        return is_tracked(self.status)

    @property
    def attempted(self) -> Bool[np.ndarray, "S T"]:
        """True for attempted targets: tracked targets, and targets at which a scenario ended."""
        return self.exists & (self.status != Status.NOT_ATTEMPTED)

    @property
    def blocked(self) -> Bool[np.ndarray, "S T"]:
        """True for tracked targets whose joint path from the previous row is known to collide."""
        return self.tracked & (self.path_clear == 0)

    def way_back(self, scenario: int) -> "Retract | None":
        """Return the motion from the end of the last seam that is done back to the start; None: all reversed.

        Missing seams follow the others, so the motion ends before the first target of one.
        """
        after = int(self.executable[scenario].sum())
        if after == self.executable.shape[1]:
            return self.retract
        ends_before_a_missing_seam = after in self.seam_begins and not self.tracked[scenario, after]
        return self.retract if ends_before_a_missing_seam else None

    @property
    def begins_seam(self) -> Bool[np.ndarray, "T"]:
        """True for the first targets of the second and of each later seam."""
        return np.isin(np.arange(self.status.shape[1]), self.seam_begins)

    @property
    def seam_of_targets(self) -> Int[np.ndarray, "T"]:
        """Number of the seam of each target, counted from 0."""
        return np.cumsum(self.begins_seam)

    @property
    def executable(self) -> Bool[np.ndarray, "S T"]:
        """True for targets that a proven motion leads to.

        Such a target and all earlier targets are tracked. On every segment from the start to the target, the arm is
        proven to be clear and the TCP to stay on its path.
        """
        return np.logical_and.accumulate(self.tracked & np.isin(self.segment_status, MOTION), axis=1)

    @property
    def step_s(self) -> float:
        """Run time per attempted target [s]; NaN if none was attempted."""
        attempted = int(self.attempted.sum())
        return self.run_s / attempted if attempted else math.nan

    @property
    def outcomes(self) -> Outcomes:
        """Outcomes of all scenarios."""
        return outcomes(self.status, self.path_clear, self.segment_status)

    def outcome(self, scenario: int) -> Outcome:
        """Return the outcome of the scenario in one row."""
        row = slice(scenario, scenario + 1)
        found = outcomes(self.status[row], self.path_clear[row], self.segment_status[row])
        return found.of(0)._replace(scenario=scenario)

    def before(self, scenario: int | np.ndarray, target: int | np.ndarray) -> Float[np.ndarray, "*n N"]:
        """Return the configuration before each target: that of the previous row, or the start [rad or m]."""
        first = np.asarray(target) == 0
        return np.where(first[..., None], self.start[scenario], self.x[scenario, np.maximum(target, 1) - 1])

    def rows(self, which: slice | np.ndarray | Sequence[int]) -> "Plans":
        """Return the plans of some scenarios; times remain those of all scenarios."""
        numbers = np.arange(len(self.status))[which]
        kept: dict[str, Any] = {name: array[which] for name, array in self.arrays().items()}
        return self._replace(**kept, via_points=self.via_points.rows(numbers), dead_ends=self.dead_ends.rows(numbers))

    def widened(self, targets: int) -> "Plans":
        """Return the plans with columns for `targets` targets, T or more; in new columns no target exists."""
        more = targets - self.status.shape[1]
        wider: dict[str, Any] = {name: self._padded(name, more) for name in (*_KINDS, "target", "tcp")}
        return self._replace(**wider)

    def with_targets(self, row: Int[np.ndarray, "S R"], exists: Bool[np.ndarray, "S R"]) -> "Plans":
        """Return plans whose targets are copies of these plans' targets; via points and dead ends are not changed.

        Args:
            row: For each target of the result, the index of the target to copy.
            exists: True for existing targets.
        """
        s, found = np.arange(len(row))[:, None], dict[str, Any]()
        for name, empty in EMPTY.items():
            column = getattr(self, name)
            there = exists.reshape(*exists.shape, *[1] * (column.ndim - 2))
            found[name] = np.where(there, column[s, row], np.asarray(empty, column.dtype))
        return self._replace(**found)

    def narrowed(self) -> "Plans":
        """Return the plans without those last columns in which no scenario has a target."""
        longest = int(np.flatnonzero(self.exists.any(axis=0)).max(initial=-1)) + 1
        return self._replace(**{name: getattr(self, name)[:, :longest] for name in (*_KINDS, "target", "tcp")})

    def without_configurations(self) -> "Plans":
        """Return the plans with only the data for a summary, to save memory.

        The last axis of `start`, `x`, `tcp` and `target` becomes empty, and via points are removed.
        """
        bare: dict[str, Any] = {name: getattr(self, name)[..., :0].copy() for name in ("start", "x", "tcp", "target")}
        return self._replace(**bare, via_points=ViaPoints.none(0))

    def with_own(self, *names: str) -> "Plans":
        """Return the plans with writable copies of the named fields."""
        return self._replace(**{name: getattr(self, name).copy() for name in names})

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the fields with one row per scenario, by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def _padded(self, name: str, more: int) -> np.ndarray:
        array = getattr(self, name)
        return np.pad(array, [(0, 0), (0, more)] + [(0, 0)] * (array.ndim - 2), constant_values=EMPTY[name])


_OTHERS = "via_points", "compile_s", "run_s", "dead_ends", "seam_begins", "retract", "cpu_s"
ARRAYS = tuple(name for name in Plans._fields if name not in _OTHERS)

# Values of targets that a scenario does not have; targets that were not attempted differ only in their status.
EMPTY = {
    "x": np.nan, "tcp": np.nan, "target": np.nan, "clearance": np.nan, "residual": np.nan, "orientation_error": np.nan,
    "status": NO_TARGET, "iterations": 0, "joint_step": np.nan, "recovery": 0, "path_clear": PATH_UNKNOWN,
    "segment_status": int(SegmentStatus.NOT_CHECKED), "segment_clearance": np.nan,
}  # fmt: skip
_KINDS = {
    "x": float, "clearance": float, "residual": float, "orientation_error": float, "status": np.int8,
    "iterations": np.int32, "joint_step": float, "recovery": np.int8, "path_clear": np.int8, "segment_status": np.int8,
    "segment_clearance": float,
}  # fmt: skip


def consecutive(parts: Sequence[Any], rows: Sequence[int]) -> Any:
    """Concatenate the via points, or the dead ends, of consecutive plans.

    Args:
        parts: Via points, or dead ends, of each plan.
        rows: Number of scenarios in each plan.
    """
    first = np.concatenate([[0], np.cumsum(rows)[:-1]]).astype(np.int32)
    moved = [part._replace(scenario=part.scenario + before) for part, before in zip(parts, first, strict=True)]
    return type(parts[0])(*(np.concatenate(column) for column in zip(*moved, strict=True)))


def is_tracked(status: np.ndarray) -> np.ndarray:
    """Return True where `status` is that of a tracked target; any shape."""
    return (status >= 0) & (status <= Status.TRACKED_AFTER_RECOVERY)


def outcomes(
    status: Int8[np.ndarray, "S T"],
    path_clear: Int8[np.ndarray, "S T"] | None = None,
    segment_status: Int8[np.ndarray, "S T"] | None = None,
) -> Outcomes:
    """Return the outcomes of scenarios from their statuses.

    Args:
        status: As in `Plans`.
        path_clear: As in `Plans`; None if unknown.
        segment_status: As in `Plans`; None if unknown.
    """
    exists, tracked = status != NO_TARGET, is_tracked(status)
    blocked = tracked & (path_clear == 0) if path_clear is not None else np.zeros_like(tracked)
    missed = exists & ~tracked
    first = np.logical_not(np.logical_or.accumulate(missed, axis=1)).sum(axis=1)  # T where none is missed
    failed = np.where(missed.any(axis=1), first, -1)
    ended = np.append(status, np.full((len(status), 1), NO_TARGET, status.dtype), axis=1)
    segment_status = np.full_like(status, SegmentStatus.NOT_CHECKED) if segment_status is None else segment_status
    executable = np.logical_and.accumulate(tracked & np.isin(segment_status, MOTION), axis=1).sum(axis=1)
    best = np.where(
        (segment_status == SegmentStatus.SAMPLED).any(axis=1), SegmentStatus.SAMPLED, SegmentStatus.VALID
    ).astype(segment_status.dtype)[:, None]
    after = np.append(np.where(tracked, segment_status, best), best, axis=1)
    return Outcomes(
        targets=exists.sum(axis=1),
        tracked=tracked.sum(axis=1),
        executable=executable,
        failed=failed,
        status=ended[np.arange(len(status)), failed],
        blocked_paths=blocked.sum(axis=1),
        segment_status=after[np.arange(len(status)), executable],
    )
