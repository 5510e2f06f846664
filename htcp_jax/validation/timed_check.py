"""Validation of a timed motion by MuJoCo only: collisions at every configuration, and the task along the path.

The code is independent of the planner's curve, bounds and time scaling. As in `htcp validate`, MuJoCo's kinematics
places the arm at the written configurations. These are checked against the plan's scene and the rows of its task. The
bare tip must not pass through a mesh's triangles or a cloud's discs.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.status import Kind
from htcp_jax.trajectory import TimedMotion
from htcp_jax.validation.mujoco_arm import ArmPoses
from htcp_jax.validation.mujoco_clearance import CheckedScene
from htcp_jax.validation.records import read_results
from htcp_jax.validation.result import ONE_POINT_M, ROUNDING_M
from htcp_jax.validation.task_check import hold_between, holds_tcp, part_between, tasks_at
from htcp_jax.validation.track import from_line, required_m, scene_of
from htcp_jax.validation.validate import LoadedParts

AT_ONCE = 256  # number of configurations measured at once, with all points near them in memory
EVERY = 16  # one in EVERY configurations is measured; bounds on the displacement decide most others


class TimedCheck(NamedTuple):
    """Results of checking a timed motion's n configurations; True in a mask is a failure."""

    touches: Bool[np.ndarray, "n"]  # a body collides, or the bare tip passes through the wall
    leaves: Bool[np.ndarray, "n"]  # the TCP is farther from the path than the tolerance
    turns_back: Bool[np.ndarray, "n"]  # the TCP has moved backwards along the path since the previous one
    breaks: Bool[np.ndarray, "n"]  # a row of the task, other than the TCP's position, is violated
    beyond: Bool[np.ndarray, "n"]  # a joint is outside its limits
    clearance_min_m: float
    off_max_m: float  # largest distance of the TCP from the lines between targets; 0 if it is unconstrained

    @property
    def refuted(self) -> int:
        """Number of configurations that failed validation."""
        return int(np.any(self[:5], axis=0).sum())


class _PathConfigurations(NamedTuple):
    """Configurations at which the task must be satisfied, with their rows in the motion and adjacent targets."""

    rows: Int[np.ndarray, "m"]
    x: Float[np.ndarray, "m N"]
    tcp: Float[np.ndarray, "m 3"]
    before: Int[np.ndarray, "m"]
    to: Int[np.ndarray, "m"]
    span: Float[np.ndarray, "m 2"]  # begin and end of each one's piece of the curve, as shares of the targets' line


def check_timed(
    folder: str | Path,
    timed: TimedMotion,
    method: str,
    scenario: int = 0,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> TimedCheck:
    """Check the timed motion of a saved plan.

    Args:
        folder: The folder of the plan or the run.
        timed: The timed motion.
        method: The plan's method.
        scenario: The plan's scenario.
        progress: Function that is called with the number of checked configurations and of all configurations.

    Raises:
        InputError: If the folder contains no plans, or if a file is missing or damaged.
    """
    results = read_results(Path(folder))
    track = next(one for one in results.tracks if (one.method, one.scenario) == (method, scenario))
    arm, wall, surroundings = LoadedParts(results).of(track)
    scene, targets, on_path = scene_of(results, arm, wall, surroundings, track)
    part, settings = results.workpiece(track.config), track.config.settings
    contact_m = track.config.workpiece.tip_contact_m
    clearance, tcp, through = _measure(
        scene, timed.x, required_m(track), contact_m, progress or (lambda done, count: None)
    )
    off, (turns_back, breaks) = np.zeros(len(timed.x)), np.zeros((2, len(timed.x)), bool)
    held = _path_configurations(timed, tcp)
    tasks, is_held = list(tasks_at(track.config, part, held.to - on_path)), np.zeros(len(held.to), bool)
    for rows, which in tasks:
        is_held[which] = holds_tcp(rows)
    if is_held.any():
        stays = held.span[:, 0] == held.span[:, 1]
        shares = np.where(stays, held.span.T, [[0.0], [1.0]])  # the complete line unless the arm stays at a point
        line = targets[held.to] - targets[held.before]
        begin, end = (targets[held.before] + share[:, None] * line for share in shares)
        off[held.rows] = np.where(is_held, from_line(held.tcp, begin, end), 0.0)
        turns_back[held.rows] = is_held & _turns_back(held, end - begin)
    for rows, which in tasks:
        if not rows:
            continue
        to, shares = held.to[which] - on_path, held.span[which].T
        ends = [part_between(rows, scene.rotate, scene.translate, part, to, share) for share in shares]
        breaks[held.rows[which]] = ~hold_between(rows, arm, held.x[which], *ends, settings).all(axis=0)
    beyond = ~((timed.x >= arm.lower - ROUNDING_M) & (timed.x <= arm.upper + ROUNDING_M)).all(axis=1)
    leaves = ~(off <= settings.tube_m + ROUNDING_M)
    touches = ~(clearance > 0) | through
    return TimedCheck(touches, leaves, turns_back, breaks, beyond, float(clearance.min()), float(off.max()))


def _path_configurations(timed: TimedMotion, tcp: np.ndarray) -> _PathConfigurations:
    """Return the configurations on the path; during a dwell the span is 0 to 0, as the arm stays at its target."""
    rows = np.flatnonzero(np.isin(timed.kind, (Kind.PROCESS, Kind.DWELL)))
    dwells = timed.kind[rows] == Kind.DWELL
    to = timed.target[rows] + dwells
    given = timed.span
    span = np.stack([np.zeros(len(rows)), ~dwells], axis=1) if given is None else given[rows]
    return _PathConfigurations(rows, timed.x[rows], tcp[rows], to - 1, to, span)


def _turns_back(held: _PathConfigurations, line: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, "m"]:
    """Return a mask, True where the TCP has moved backwards along the path since the previous configuration.

    As the TCP may have passed a corner, it must have moved backwards along the lines of both configurations. If a line
    has length 0, any motion is allowed.
    """
    length = np.linalg.norm(line, axis=1, keepdims=True)
    forwards = line / np.maximum(length, ONE_POINT_M)
    moved = np.diff(held.tcp, axis=0)
    ahead = np.maximum(*((moved * part).sum(axis=1) for part in (forwards[:-1], forwards[1:])))
    bound = (np.diff(held.rows) == 1) & (length[1:, 0] >= ONE_POINT_M) & (length[:-1, 0] >= ONE_POINT_M)
    return np.append(False, bound & ~(ahead >= -ROUNDING_M))[: len(held.rows)]


def _measure(
    scene: CheckedScene,
    x: Float[np.ndarray, "n N"],
    required: float,
    contact_m: float | None,
    progress: Callable[[int, int], None],
) -> tuple[np.ndarray, ...]:
    """Return each configuration's clearance [m] and TCP, and a mask, True if the bare tip passes through the wall.

    A clearance is inf if it is known to be above 0 and above the minimum so far.
    """
    clearance, tcp, through = np.full(len(x), np.inf), np.empty((len(x), 3)), np.zeros(len(x), bool)
    rows = np.unique(np.append(np.arange(0, len(x), EVERY), len(x) - 1))  # rows of the measured configurations
    for first in range(0, max(1, len(rows) - 1), AT_ONCE):
        own = rows[first : first + AT_ONCE + 1]
        known = scene.at(x[own], required)
        clearance[own], tcp[own] = known.clearance, known.arm_poses.tcp
        through[own] = _through(scene, known.arm_poses, contact_m)
        between = np.setdiff1d(np.arange(own[0], own[-1]), own)
        below = max(0.0, float(clearance.min()))
        for some in np.array_split(between, -(-len(between) // (8 * AT_ONCE)) or 1):
            if len(some):
                before = np.searchsorted(own, some) - 1
                arm_poses, clearance[some] = scene.between(x[some], before, known, below)
                tcp[some], through[some] = arm_poses.tcp, _through(scene, arm_poses, contact_m)
        progress(int(own[-1]) + 1, len(x))
    return clearance, tcp, through


def _through(scene: CheckedScene, arm_poses: ArmPoses, contact_m: float | None) -> Bool[np.ndarray, "n"]:
    return np.zeros(len(arm_poses.tcp), bool) if contact_m is None else scene.tip_crosses(arm_poses, contact_m)
