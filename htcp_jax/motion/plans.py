"""What planning returns, and what it says of itself: which targets there are, which are tracked, how scenarios ended.

    plans.tracked                     # (S, T) True where a target is tracked
    plans.outcomes.complete           # (S,)   True where all targets of a scenario are
    plans.outcome(12).failed          # the first target of scenario 12 that is not; None where all are

Nobody else reads an end out of the statuses: charts and viewers that have statuses alone ask `outcomes`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from htcp_jax.motion.knots import Knots
from htcp_jax.status import Status, Way

NO_TARGET = -1  # a status: the scenario has no such target, or it is not planned yet
UNKNOWN = -1  # of path_clear


class Outcome(NamedTuple):
    """How one scenario ended."""

    scenario: int  # its row
    targets: int  # that it has; 0 where it is not planned
    tracked: int  # of them
    executable: int  # of these, in a row from the first, those that a proven motion leads to
    failed: int | None  # the first target that is not tracked
    status: Status | None  # what became of that one
    blocked_paths: int  # tracked targets whose joint path from the row before is known to collide
    way: Way  # to the target after the last executable one; PROVEN where there is none that is tracked

    @property
    def complete(self) -> bool:
        """Whether it is planned and every target is tracked."""
        return self.targets > 0 and self.failed is None

    @property
    def can_be_driven(self) -> bool:
        """Whether a proven motion leads to its last target."""
        return 0 < self.targets == self.executable

    @property
    def reason(self) -> str:
        """What ended its motion, in words: the way to a tracked target, or the search; "complete" if nothing did."""
        if self.executable < self.tracked:
            return self.way.words
        return "complete" if self.status is None else self.status.words


class Outcomes(NamedTuple):
    """How S scenarios ended, a column each; see `Outcome`."""

    targets: Int[np.ndarray, "S"]
    tracked: Int[np.ndarray, "S"]
    executable: Int[np.ndarray, "S"]
    failed: Int[np.ndarray, "S"]  # -1 for none
    status: Int8[np.ndarray, "S"]  # NO_TARGET where none failed
    blocked_paths: Int[np.ndarray, "S"]
    way: Int8[np.ndarray, "S"]  # `status.Way`

    @property
    def planned(self) -> Bool[np.ndarray, "S"]:
        """Which scenarios are planned."""
        return self.targets > 0

    @property
    def complete(self) -> Bool[np.ndarray, "S"]:
        """Which scenarios are planned with every target tracked."""
        return self.planned & (self.failed < 0)

    @property
    def can_be_driven(self) -> Bool[np.ndarray, "S"]:
        """To the last target of which scenarios a proven motion leads."""
        return self.planned & (self.executable == self.targets)

    def of(self, scenario: int) -> Outcome:
        """That of one row."""
        targets, tracked, executable, failed, status, blocked, way = (int(column[scenario]) for column in self)
        ended = (None, None) if failed < 0 else (failed, Status(status))
        return Outcome(int(scenario), targets, tracked, executable, *ended, blocked, Way(way))


class Plans(NamedTuple):
    """The plans of S scenarios with up to T targets each, for a robot of N joints; numpy arrays on the host.

    Rows of targets that are not tracked hold NaN in `x`, `tcp`, `clearance`, `residual`,
    `orientation_error` and `joint_step`; those of targets that a scenario does not have, the status NO_TARGET.
    """

    start: Float[np.ndarray, "S N"]  # the posture that the plan starts from [rad or m]
    x: Float[np.ndarray, "S T N"]  # configurations [rad or m]
    tcp: Float[np.ndarray, "S T 3"]  # tool centre point, world [m]
    target: Float[np.ndarray, "S T M"]  # where the task's rows, the TCP's xyz, should be [m]; NaN where there is none
    clearance: Float[np.ndarray, "S T"]  # D(x, O), smallest over all rows [m]
    residual: Float[np.ndarray, "S T"]  # of the task's points: |tcp - target| [m]
    orientation_error: Float[np.ndarray, "S T"]  # largest angle from what the task holds [rad]; NaN if it holds none
    status: Int8[np.ndarray, "S T"]  # htcp_jax.status.Status, or NO_TARGET
    iterations: Int[np.ndarray, "S T"]  # step QPs solved for the target; 0 where one was pushed there
    joint_step: Float[np.ndarray, "S T"]  # |x_t - x_{t-1}|, the start being x_{-1} [rad]
    escape: Int[np.ndarray, "S T"]  # 0 none, k = stage k of the method's escapes, one more: planned backwards
    path_clear: Int8[np.ndarray, "S T"]  # joint path from the row before: 1 clear, 0 blocked, -1 unknown
    way: Int8[np.ndarray, "S T"]  # `status.Way`: whether the way from the row before is a proven motion
    way_clearance: Float[np.ndarray, "S T"]  # D all along that way, at least [m]; NaN where it is not proven
    knots: Knots  # postures on ways that are no straight joint path
    compile_s: float  # wall time in which somebody waited for compilation, or for processes to start [s]
    run_s: float  # wall time spent planning, compilation apart [s]

    @classmethod
    def empty(
        cls,
        start: Float[np.ndarray, "S N"],
        target: Float[np.ndarray, "S T M"],
        count: Int[np.ndarray, "S"] | int | None = None,
    ) -> "Plans":
        """Plans in which nothing is attempted yet, with arrays to write into: `start` is copied, `target` is not.

        count: how many targets each scenario has, the first of its row; None: all of them.
        """
        shape, joints = target.shape[:2], start.shape[1]
        count = np.broadcast_to(shape[1] if count is None else count, shape[:1])
        exists = np.arange(shape[1])[None, :] < count[:, None]
        arrays = {name: np.full((*shape, *([joints] if name == "x" else [])), EMPTY[name], kind)
                  for name, kind in _KINDS.items()}  # fmt: skip
        arrays["tcp"] = np.full((*shape, 3), EMPTY["tcp"])
        arrays["status"][exists] = Status.NOT_ATTEMPTED
        knots = Knots.none(joints)
        return cls(start=np.array(start, float), target=target, **arrays, knots=knots, compile_s=0.0, run_s=0.0)

    @classmethod
    def concatenate(cls, parts: "Sequence[Plans]") -> "Plans":
        """The rows of all parts, one after the other, and their seconds added up; T may differ."""
        longest = max(part.status.shape[1] for part in parts)
        wide = [part.widened(longest).arrays() for part in parts]
        return cls(
            **{name: np.concatenate([arrays[name] for arrays in wide]) for name in ARRAYS},
            knots=Knots.concatenate([part.knots for part in parts], [len(part.status) for part in parts]),
            compile_s=sum(part.compile_s for part in parts),
            run_s=sum(part.run_s for part in parts),
        )

    @property
    def exists(self) -> Bool[np.ndarray, "S T"]:
        """Which targets there are, planned ones in a run that is not finished."""
        return self.status != NO_TARGET

    @property
    def tracked(self) -> Bool[np.ndarray, "S T"]:
        """Which targets are tracked."""
        return is_tracked(self.status)

    @property
    def attempted(self) -> Bool[np.ndarray, "S T"]:
        """Which targets somebody worked on: the tracked ones, and those at which a scenario ended."""
        return self.exists & (self.status != Status.NOT_ATTEMPTED)

    @property
    def blocked(self) -> Bool[np.ndarray, "S T"]:
        """Which tracked targets lie behind a joint path that is known to collide."""
        return self.tracked & (self.path_clear == 0)

    @property
    def executable(self) -> Bool[np.ndarray, "S T"]:
        """Which targets a proven motion leads to: tracked, as is everything before them, and each on a way from the row
        before, the first from the scenario's start, on which the arm is clear and the TCP keeps to its path."""
        return np.logical_and.accumulate(self.tracked & (self.way == Way.PROVEN), axis=1)

    @property
    def step_s(self) -> float:
        """Run time by attempted target [s]; NaN where none was."""
        attempted = int(self.attempted.sum())
        return self.run_s / attempted if attempted else math.nan

    @property
    def outcomes(self) -> Outcomes:
        """How every scenario ended."""
        return outcomes(self.status, self.path_clear, self.way)

    def outcome(self, scenario: int) -> Outcome:
        """How the scenario in one row ended."""
        row = slice(scenario, scenario + 1)
        return outcomes(self.status[row], self.path_clear[row], self.way[row]).of(0)._replace(scenario=scenario)

    def before(self, scenario: int | np.ndarray, target: int | np.ndarray) -> Float[np.ndarray, "*n N"]:
        """The postures that the joint paths to targets leave: those of the rows before, or the start."""
        first = np.asarray(target) == 0
        return np.where(first[..., None], self.start[scenario], self.x[scenario, np.maximum(target, 1) - 1])

    def rows(self, which: slice | np.ndarray | Sequence[int]) -> "Plans":
        """The plans of some scenarios; the seconds stay those of all."""
        numbers = np.arange(len(self.status))[which]
        return self._replace(
            **{name: array[which] for name, array in self.arrays().items()}, knots=self.knots.rows(numbers)
        )

    def widened(self, targets: int) -> "Plans":
        """The same with columns for this many targets, T or more; the new ones do not exist."""
        more = targets - self.status.shape[1]
        return self._replace(**{name: self._padded(name, more) for name in (*_KINDS, "target", "tcp")})

    def narrowed(self) -> "Plans":
        """The same without the columns of which no scenario has a target, the last ones."""
        longest = int(np.flatnonzero(self.exists.any(axis=0)).max(initial=-1)) + 1
        return self._replace(**{name: getattr(self, name)[:, :longest] for name in (*_KINDS, "target", "tcp")})

    def without_postures(self) -> "Plans":
        """What a summary needs, for less memory: `start`, `x`, `tcp` and `target` lose their last axis' columns."""
        bare = {name: getattr(self, name)[..., :0].copy() for name in ("start", "x", "tcp", "target")}
        return self._replace(**bare, knots=Knots.none(0))

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields with a row a scenario, by name."""
        return {name: getattr(self, name) for name in ARRAYS}

    def _padded(self, name: str, more: int) -> np.ndarray:
        array = getattr(self, name)
        return np.pad(array, [(0, 0), (0, more)] + [(0, 0)] * (array.ndim - 2), constant_values=EMPTY[name])


ARRAYS = tuple(name for name in Plans._fields if name not in ("knots", "compile_s", "run_s"))

# What a row holds of a target that a scenario does not have; one that is not attempted has another status.
EMPTY = {
    "x": np.nan, "tcp": np.nan, "target": np.nan, "clearance": np.nan, "residual": np.nan, "orientation_error": np.nan,
    "status": NO_TARGET, "iterations": 0, "joint_step": np.nan, "escape": 0, "path_clear": UNKNOWN,
    "way": int(Way.UNKNOWN), "way_clearance": np.nan,
}  # fmt: skip
_KINDS = {
    "x": float, "clearance": float, "residual": float, "orientation_error": float, "status": np.int8,
    "iterations": np.int32, "joint_step": float, "escape": np.int8, "path_clear": np.int8, "way": np.int8,
    "way_clearance": float,
}  # fmt: skip


def is_tracked(status: np.ndarray) -> np.ndarray:
    """Where `status` says tracked; any shape."""
    return (status >= 0) & (status <= Status.TRACKED_AFTER_ESCAPE)


def outcomes(
    status: Int8[np.ndarray, "S T"],
    path_clear: Int8[np.ndarray, "S T"] | None = None,
    way: Int8[np.ndarray, "S T"] | None = None,
) -> Outcomes:
    """How scenarios with these statuses ended. path_clear, way: as in `Plans`; None where nothing is known of them."""
    exists, tracked = status != NO_TARGET, is_tracked(status)
    blocked = tracked & (path_clear == 0) if path_clear is not None else np.zeros_like(tracked)
    missed = exists & ~tracked
    first = np.logical_not(np.logical_or.accumulate(missed, axis=1)).sum(axis=1)  # T where none is missed
    failed = np.where(missed.any(axis=1), first, -1)
    ended = np.append(status, np.full((len(status), 1), NO_TARGET, status.dtype), axis=1)
    way = np.full_like(status, Way.UNKNOWN) if way is None else way
    executable = np.logical_and.accumulate(tracked & (way == Way.PROVEN), axis=1).sum(axis=1)
    after = np.append(np.where(tracked, way, Way.PROVEN), np.full((len(way), 1), Way.PROVEN, way.dtype), axis=1)
    return Outcomes(
        targets=exists.sum(axis=1),
        tracked=tracked.sum(axis=1),
        executable=executable,
        failed=failed,
        status=ended[np.arange(len(status)), failed],
        blocked_paths=blocked.sum(axis=1),
        way=after[np.arange(len(status)), executable],
    )
