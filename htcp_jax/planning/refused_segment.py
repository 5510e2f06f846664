"""Straight joint paths to a lost target, measured after planning: which condition they violate, where, and by how much.

A search ends at a target if it accepts no segment to it. Here the paths from the last configuration are measured again:
to the configuration that inverse kinematics finds at the target, and, from self-motions at the target before, to the
configurations to which the beam search extends these. They are a sample of those that the search tried.
"""

from collections import Counter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.errors import mm_text
from htcp_jax.model import surface
from htcp_jax.motion import CollisionChecker, Problem, lane_inputs, measured_rows
from htcp_jax.planning.beam.functions import EXTEND, SELF_MOTION, inputs_and_tubes
from htcp_jax.status import SegmentStatus

PLACES = np.linspace(0.0, 1.0, 33)  # places at which a path is measured, as shares of it
LEAVES = SegmentStatus.OFF_PATH, SegmentStatus.REVERSES  # verdicts about the tool; others are about clearance


class RefusedSegment(NamedTuple):
    """The path to a lost target that violates the least, of those that were measured."""

    verdict: SegmentStatus  # of the proof; VALID: the path is a proven motion, which the search did not use
    counts: dict[SegmentStatus, int]  # number of measured paths with each verdict
    share: float  # place of the worst violation, as a share of the path
    x: Float[np.ndarray, "N"]  # configuration there [rad or m]
    clearance_m: float  # D there; of a VALID path the smallest D at its places
    off_m: float  # distance of the TCP from the line there
    off_rad: float  # deviation from the required orientation there
    tube_m: float  # allowed distance from the line; inf: any
    end_clearance_m: float  # D at the target
    margin_m: float  # the required clearance there

    @property
    def leaves_path(self) -> bool:
        """True if the tool leaves the path or moves backwards, False if the arm is too near to an obstacle."""
        return self.verdict in LEAVES

    def description(self, where: str) -> str:
        """Return one line: how many paths collide or leave the path, and by how much the best one does.

        Args:
            where: Text about the nearest bodies at `x`, for a path that is not clear.
        """
        place = "at its end" if self.share == 1 else f"at {100 * self.share:.0f} % of it"
        if self.verdict == SegmentStatus.VALID:
            clearance = mm_text(self.clearance_m)
            return f"a proven segment leads there, with a clearance of {clearance}, but the search did not use it"
        if self.verdict == SegmentStatus.REVERSES:
            what = "moves the tool backwards along the path"
        elif self.leaves_path and self.off_m > self.tube_m:
            what = f"leaves the path by {mm_text(self.off_m)}, {mm_text(self.tube_m)} allowed"
        elif self.leaves_path:
            what = f"turns the tool by {np.rad2deg(self.off_rad):.3g} deg from its required direction"
        else:
            what = where
        if (count := sum(self.counts.values())) == 1:
            return f"the segment from the last configuration {_VERDICTS[self.verdict][0]}; {place}: {what}"
        parts = [f"{n} {_VERDICTS[each][1]}" for each, n in sorted(self.counts.items()) if n]
        return f"of {count} segments from the last configuration {', '.join(parts)}; the best one, {place}: {what}"


_VERDICTS = {  # about one segment, and about several
    SegmentStatus.IN_COLLISION: ("collides", "collide"),
    SegmentStatus.BELOW_MARGIN: ("comes nearer than the margin", "come nearer than the margin"),
    SegmentStatus.OFF_PATH: ("leaves the path", "leave the path"),
    SegmentStatus.REVERSES: ("moves the tool backwards", "move the tool backwards"),
    SegmentStatus.UNDECIDED: ("is neither proven nor refuted", "are neither proven nor refuted"),
}


def refused_segment(
    problem: Problem, x_last: Float[np.ndarray, "N"], target: int, x_goal: Float[np.ndarray, "N"]
) -> RefusedSegment | None:
    """Return the path to a lost target that violates the least; None if no path that reaches it was found.

    None also for a robot with indexed axes.

    Args:
        problem: The problem; its first scenario is measured.
        x_last: The last configuration before the target [rad or m].
        target: The lost target.
        x_goal: A configuration at the target, which may collide [rad or m].
    """
    if problem.robot.indexed:  # its axes stand still in the search, which is not repeated here
        return None
    checker, task = problem.checkers[0], problem.task
    a = _beginnings(problem, checker, x_last, target)
    zero = np.zeros(len(a), int)
    inputs, tube = inputs_and_tubes(problem, zero, zero + target, zero, False)
    b = np.concatenate([x_goal[None], checker.executor(EXTEND, inputs, a).at.x[1:]])
    reached = task.reached(checker.states(inputs, b).residual)
    if inputs.max_joint_step is not None:
        reached &= (np.abs(b - a) <= inputs.max_joint_step).all(axis=1)
    if not reached.any():
        return None
    a, b, inputs, tube = tables.gather((a, b, inputs, tube), reached)
    proof = checker.edges(inputs, a, b, tube)
    x = a[:, None] + PLACES[:, None] * (b - a)[:, None]
    every = np.repeat(np.arange(len(a)), len(PLACES))
    at = checker.states(tables.gather(inputs, every), x.reshape(-1, a.shape[1]))
    clearance, tcp = at.clearance.reshape(x.shape[:2]), at.tcp.reshape(*x.shape[:2], 3)
    off = _from_line(tube.start, tube.end, tcp)
    lacks, leaves = np.maximum(inputs.margin_m[:, None] - clearance, 0), np.maximum(off - tube.radius[:, None], 0)
    excess = np.where(
        proof.verdict == SegmentStatus.VALID, -clearance.min(axis=1), np.maximum(lacks, leaves).max(axis=1)
    )
    k = int(np.lexsort((excess, proof.verdict != SegmentStatus.VALID))[0])
    verdict = SegmentStatus(int(proof.verdict[k]))
    angles = np.zeros(len(PLACES)) if tube.goals is None else _angles(problem, inputs, tube.goals, k, x[k])
    worst = _worst_place(verdict, float(proof.place[k]), clearance[k], off[k], angles, float(tube.radius[k]))
    counts = Counter(SegmentStatus(int(each)) for each in proof.verdict)
    here = float(PLACES[worst]), x[k, worst], float(clearance[k, worst]), float(off[k, worst]), float(angles[worst])
    known = float(tube.radius[k]), float(clearance[k, -1]), float(inputs.margin_m[k])
    return RefusedSegment(verdict, dict(counts), *here, *known)


def _beginnings(
    problem: Problem, checker: CollisionChecker, x_last: Float[np.ndarray, "N"], target: int
) -> Float[np.ndarray, "n N"]:
    """Return the last configuration, and those of one round of self-motions from it [rad or m]."""
    if not checker.executor.freedom or not target:
        return x_last[None]
    number = np.arange(problem.settings.self_motions, dtype=np.int32)
    zero = np.zeros(len(number), int)
    inputs, _ = inputs_and_tubes(problem, zero, zero + target - 1, zero, True)
    x = np.repeat(x_last[None], len(number), axis=0)
    moved = checker.executor(SELF_MOTION, inputs, x, np.full_like(x, np.nan), number)
    return np.concatenate([x_last[None], moved.path.x[np.arange(moved.path.x.shape[1]) < moved.steps[:, None]]])


def _from_line(
    start: Float[np.ndarray, "n 3"], end: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n m 3"]
) -> Float[np.ndarray, "n m"]:
    """Return the distance of points from the lines between `start` and `end` [m]."""
    along, from_start = (end - start)[:, None], points - start[:, None]
    return np.linalg.norm(from_start - surface.nearest_share(from_start, along)[..., None] * along, axis=2)


def _angles(
    problem: Problem,
    inputs: lane_inputs.LaneInputs,
    goals: Float[np.ndarray, "n 2 G"],
    k: int,
    x: Float[np.ndarray, "m N"],
) -> Float[np.ndarray, "m"]:
    """Return the deviations from the orientations between two goals at configurations along path k [rad]."""
    inputs, goals = tables.gather((inputs, goals), np.full(len(x), k))
    between = problem.task.interpolated(goals, PLACES)
    return measured_rows.task_errors(problem.robot, problem.task, inputs, x, between)[1]


def _worst_place(
    verdict: SegmentStatus,
    place: float,
    clearance: Float[np.ndarray, "m"],
    off: Float[np.ndarray, "m"],
    angles: Float[np.ndarray, "m"],
    tube_m: float,
) -> int:
    """Return the index of the place at which a path violates its condition the most."""
    if verdict == SegmentStatus.REVERSES:
        return int(np.abs(PLACES - place).argmin())
    if verdict in LEAVES:
        return int(off.argmax() if off.max() > tube_m else angles.argmax())
    return int(clearance.argmin())
