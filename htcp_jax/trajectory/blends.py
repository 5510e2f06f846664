"""Split of a motion into sections from stop to stop.

Each section is a blended curve that is close enough to the motion's polyline for the polyline's proof to cover it. The
arm stops where the tool begins or ceases to follow the path, before and after a dwell, and at a corner that cannot be
blended because the slack is too small or the tool would almost reverse.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.model import Robot
from htcp_jax.motion import Motion, Plans
from htcp_jax.motion import motion as motions
from htcp_jax.status import Kind
from htcp_jax.trajectory.curve import FARTHEST, Blend, Curve
from htcp_jax.trajectory.displacement import ArmLevers, Displacement, arm_at, bend_bound, displacement_bound, tcp_at
from htcp_jax.trajectory.limits import MotionLimits
from htcp_jax.trajectory.row_slack import RowSlacks

SHARE = 0.5  # share of the proven clearance, and of the remaining tolerance, that blending may use
HALVINGS = 12  # maximum number of halvings of a corner's blend length, after which the arm stops at the corner
ONE_MOMENT_S = 1e-3  # duration at full speed up to which legs may be merged
SHARPEST = 0.5  # cosine of half the largest angle by which the tool's path may turn without a stop
PIECES = 8  # number of pieces per leg for the bound on the TCP's distance from its line
SHARE_OF_LIMITS = 0.3  # share of the acceleration and jerk limits that a corner of the path should use at the feed


class MotionSlack(NamedTuple):
    """Slack of a motion's proof at each of its m legs: how far a curve may deviate from the polyline."""

    clearance: Float[np.ndarray, "m"]  # guaranteed clearance on the straight joint path [m]
    tube: Float[np.ndarray, "m"]  # allowed distance of the TCP from the line between a leg's ends [m]; inf: not limited
    rows: RowSlacks | None = None  # slack of the task's rows; None if the task constrains only the TCP's position

    def only(self, which: Int[np.ndarray, "k"]) -> "MotionSlack":
        """Return the slack of the legs in `which`."""
        return MotionSlack(self.clearance[which], self.tube[which], self.rows and self.rows.only(which))

    def replaced(self, which: Int[np.ndarray, "k"], by: "MotionSlack") -> "MotionSlack":
        """Return the slack of all legs, with the slack of the legs in `which` replaced."""
        clearance, tube, rows = self.clearance.copy(), self.tube.copy(), self.rows
        clearance[which], tube[which] = by.clearance, by.tube
        if rows and by.rows:
            rows = rows._replace(left=rows.left.copy())
            rows.left[which] = by.rows.left
        return MotionSlack(clearance, tube, rows)


def motion_slack(plans: Plans, scenario: int, motion: Motion, tube_m: float, robot: Robot | None = None) -> MotionSlack:
    """Return the slack of a plan's proof at each leg of its motion.

    Args:
        plans: The plans.
        scenario: Row of the plan.
        motion: The plan's motion.
        tube_m: Radius of the tube, `Settings.tube_m`.
        robot: The robot with the job's tool; required if the motion has via points between two targets.
    """
    there = int((motion.kind != Kind.RETRACT).sum())
    target, kind = motion.target[1:there], motion.kind[1:there]
    polyline = target + (kind == Kind.DWELL)
    clearance = plans.segment_clearance[scenario, polyline]
    off = plans.residual[scenario]
    off = np.fmax(off[polyline], off[np.maximum(polyline - 1, 0)])
    if robot is not None and motion.span is not None:
        at = _off_line(plans, scenario, motion, robot)[:there]
        off = np.maximum(off, np.maximum(at[1:], at[:-1]))
    tube = np.where(np.isin(kind, (Kind.PROCESS, Kind.DWELL)), tube_m - off, np.inf)
    back = len(motion.x) - there
    own = plans.way_back(scenario)
    after = clearance[::-1] if own is None else own.clearance
    return MotionSlack(np.append(clearance, after[:back]), np.append(tube, np.full(back, np.inf)))


def _off_line(plans: Plans, scenario: int, motion: Motion, robot: Robot) -> Float[np.ndarray, "n"]:
    """Return the TCP's distance, at via points, from its position interpolated between two targets [m]; 0 elsewhere."""
    off, share = np.zeros(len(motion.x)), motion.span[:, 1]
    inner = np.flatnonzero((share > 0) & (share < 1) & np.isin(motion.kind, (Kind.PROCESS, Kind.DWELL)))
    if len(inner):
        end = motion.target[inner] + (motion.kind[inner] == Kind.DWELL)
        a, b = plans.target[scenario, end - 1], plans.target[scenario, end]
        off[inner] = np.linalg.norm(tcp_at(robot, motion.x[inner])[0] - a - share[inner, None] * (b - a), axis=1)
    return off


def blends(
    robot: Robot,
    motion: Motion,
    left: MotionSlack,
    limits: MotionLimits,
    feed_m_s: float | Float[np.ndarray, "T"],
) -> list[Blend]:
    """Return the sections of a motion, in order; legs without motion are removed.

    Args:
        robot: The robot with the job's tool.
        motion: The motion.
        left: Slack at the motion's legs.
        limits: Limits of the joints.
        feed_m_s: Feed rate of the TCP on the path; one for each target, or one for all.
    """
    polyline = _merge_short_legs(_moving_legs(robot, motion, left), limits)
    if not len(polyline.row):
        return []
    step = np.where(polyline.on_process, polyline.length, _duration(polyline.x, limits))
    whole = Curve(np.append(0.0, np.cumsum(step)), polyline.x, np.zeros(len(polyline.x)))
    feed = np.asarray(feed_m_s)[motion.target[polyline.row]] if np.ndim(feed_m_s) else np.full(len(step), feed_m_s)
    wanted = _desired_lengths(whole, polyline.on_process, limits, np.append(feed, feed[-1]))
    blend_length = _blend_lengths(robot, polyline, whole, wanted)
    along = np.diff(polyline.arm.tcp, axis=0) / np.maximum(polyline.length, 1e-300)[:, None]
    turned = np.einsum("ij,ij->i", along[:-1], along[1:]) < 2 * SHARPEST**2 - 1
    stops = (
        (np.diff(polyline.group) != 0)
        | (np.diff(polyline.on_process) != 0)
        | (polyline.on_process[1:] & (np.diff(feed) != 0))
        | (polyline.on_process[1:] & turned)
        | (blend_length[1:-1] <= 0)
    )
    ends = [0, *(np.flatnonzero(stops) + 1).tolist(), len(polyline.x) - 1]
    return [_blend_of(whole, blend_length, a, b, polyline) for a, b in pairwise(ends)]


class _Polyline(NamedTuple):
    """Polyline of a motion, possibly with merged legs: k configurations, and m = k - 1 legs between them."""

    x: Float[np.ndarray, "k N"]  # configurations [rad or m]
    row: Int[np.ndarray, "m"]  # row of the motion to which each leg leads
    group: Int[np.ndarray, "m"]  # the arm stops between legs of different groups
    left: MotionSlack
    arm: ArmLevers

    @property
    def length(self) -> Float[np.ndarray, "m"]:
        """Distance between the TCPs at both ends of each leg [m]."""
        return np.linalg.norm(np.diff(self.arm.tcp, axis=0), axis=1)

    @property
    def on_process(self) -> Bool[np.ndarray, "m"]:
        """True for legs on which the tool follows the path."""
        return (self.group == Kind.PROCESS) & (self.length >= motions.ONE_POINT_M)


def _moving_legs(robot: Robot, motion: Motion, left: MotionSlack) -> _Polyline:
    """Return the polyline of the legs on which joints move.

    The transfer from the start and the approach form one group, and so does the transfer to each later seam: the arm
    stops at a seam of one target.
    """
    kept = np.flatnonzero(np.append(True, np.any(np.diff(motion.x, axis=0) != 0, axis=1)))
    row = kept[1:]
    kind, target = motion.kind[row], motion.target[row].astype(int)
    group = np.maximum(kind, Kind.APPROACH) + len(Kind) * np.where(kind == Kind.TRANSFER, target, 0)
    features = left.rows.features if left.rows else ()
    return _Polyline(motion.x[kept], row, group, left.only(row - 1), arm_at(robot, motion.x[kept], features))


def _merge_short_legs(polyline: _Polyline, limits: MotionLimits) -> _Polyline:
    """Return the polyline with very short legs merged with the previous leg.

    The first configuration of a short leg is replaced by the next one if the displacement is within the slack. Of
    consecutive short legs, those are merged that together are very short, or do not move the TCP on the path.
    """
    still = (polyline.group == Kind.PROCESS) & ~polyline.on_process
    short = (_duration(polyline.x, limits) < ONE_MOMENT_S) | still
    goes, first = [], -1  # first configurations of the legs to merge, and the first of consecutive ones
    for k in (np.flatnonzero(short[1:] & (polyline.group[1:] == polyline.group[:-1])) + 1).tolist():
        first = first if goes and goes[-1] == k - 1 else k
        if still[k] or first == k or _duration(polyline.x[[first, k + 1]], limits) < ONE_MOMENT_S:
            goes.append(k)
    if not goes:
        return polyline
    goes, to = np.array(goes), np.arange(len(polyline.x))
    for k in goes[::-1]:
        to[k] = to[k + 1]
    before, displacement = goes - 1, polyline.x[to[goes]] - polyline.x[goes]
    arm = polyline.arm.only(goes)
    moved = arm.moved(displacement_bound(arm, np.abs(polyline.x[goes] - polyline.x[before]), displacement))
    off = np.linalg.norm(polyline.arm.tcp[to[goes]] - polyline.arm.tcp[goes], axis=1)
    rest, fits = _less(polyline.left.only(before), moved._replace(tcp=moved.tcp + off))
    gone = np.zeros(len(polyline.x), bool)
    for k, fit in zip(goes[::-1], fits[::-1], strict=True):
        gone[k] = fit and (gone[k + 1] or to[k] == k + 1)  # all configurations up to the replacement are removed
    merged = np.flatnonzero(gone[goes])
    left = polyline.left.replaced(before[merged], rest.only(merged))
    kept = np.flatnonzero(~gone)
    last, first = kept[1:] - 1, kept[:-1]  # last and first of the merged legs; on the path the first leg's line is used
    row = np.where(polyline.group[first] == Kind.PROCESS, polyline.row[first], polyline.row[last])
    return _Polyline(polyline.x[kept], row, polyline.group[last], left.only(first), polyline.arm.only(kept))


def _less(whole: MotionSlack, by: Displacement) -> tuple[MotionSlack, Bool[np.ndarray, "k"]]:
    """Return the slack that a displacement of all legs leaves, and a mask of the legs with enough slack."""
    rest = MotionSlack(whole.clearance - by.bodies, whole.tube - by.tcp)
    fits = (rest.clearance >= SHARE * whole.clearance) & (rest.tube >= SHARE * whole.tube)
    if whole.rows:
        own = whole.rows.left - whole.rows.taken(by.features)
        fits &= (own >= SHARE * whole.rows.left).all(axis=1)
        rest = rest._replace(rows=whole.rows._replace(left=own))
    return rest, fits


def _duration(x: np.ndarray, limits: MotionLimits) -> Float[np.ndarray, "m"]:
    """Return the durations at full speed of the straight joint paths between consecutive configurations [s]."""
    return np.max(np.abs(np.diff(x, axis=0)) / limits.velocity, axis=1)


def _blend_of(whole: Curve, blend_length: np.ndarray, a: int, b: int, polyline: _Polyline) -> Blend:
    inner = blend_length[a : b + 1].copy()
    inner[[0, -1]] = 0.0
    return Blend(
        Curve(whole.u[a : b + 1] - whole.u[a], whole.x[a : b + 1], inner),
        polyline.row[a:b],
        bool(polyline.on_process[a]),
    )


def _desired_lengths(
    curve: Curve, on_process: np.ndarray, limits: MotionLimits, feed_m_s: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    """Return the blend length that the feed requires at each corner, at most half of the adjacent legs."""
    step, turns = np.diff(curve.u), np.abs(curve.turns)
    available = 0.5 * np.append(np.minimum(step[:-1], step[1:]), 0.0)
    available = np.append(0.0, available)
    feed_m_s = feed_m_s[:, None]
    bend = 15 / 16 * turns * feed_m_s**2 / (SHARE_OF_LIMITS * limits.acceleration)
    jerk = np.sqrt(1.45 * turns * feed_m_s**3 / (SHARE_OF_LIMITS * limits.jerk))
    needed = np.maximum(np.maximum(bend, jerk).max(axis=1), 0.05 * available)
    is_process = np.append(on_process, False) & np.append(False, on_process)
    return np.where(is_process, np.minimum(available, needed), available)


def _blend_lengths(robot: Robot, polyline: _Polyline, curve: Curve, wanted: np.ndarray) -> Float[np.ndarray, "k"]:
    """Return the largest blend length wanted / 2^i at each corner that the adjacent legs' slack allows; 0 if none."""
    arm, left = polyline.arm, polyline.left
    tries = np.append(wanted * 0.5 ** np.arange(HALVINGS)[:, None], np.zeros((1, len(wanted))), axis=0)
    slopes = np.abs(curve.slopes)
    steepest = np.maximum(np.append(slopes[:1], slopes, axis=0), np.append(slopes, slopes[-1:], axis=0))
    around, displacement = tries[..., None] * steepest, FARTHEST * tries[..., None] * curve.turns
    moved = arm.moved(displacement_bound(arm, around, displacement))
    tube = left.tube - _chord_deviation(robot, arm, curve, np.isfinite(left.tube))
    fits = (moved.bodies <= SHARE * _least_of_legs(left.clearance)) & (moved.tcp <= SHARE * _least_of_legs(tube))
    if left.rows:
        rows = left.rows.next_to_legs()
        fits &= (rows.taken(moved.features) <= SHARE * rows.left).all(axis=-1)
    fits[-1] = True
    return tries[np.argmax(fits, axis=0), np.arange(len(wanted))]


def _least_of_legs(legs: Float[np.ndarray, "m"]) -> Float[np.ndarray, "k"]:
    """Return the minimum of the values of both adjacent legs, for each configuration."""
    return np.minimum(np.append(legs[:1], legs), np.append(legs, legs[-1:]))


def _chord_deviation(robot: Robot, arm: ArmLevers, curve: Curve, which: np.ndarray) -> Float[np.ndarray, "m"]:
    """Return an upper bound on the chord deviation of the legs in `which` [m]; 0 for other legs.

    The chord deviation is the TCP's distance, on the straight joint path, from the line between the leg's ends.
    """
    found, legs = np.zeros(len(which)), np.flatnonzero(which)
    if not len(legs):
        return found
    share = np.arange(1, PIECES) / PIECES
    step = curve.x[legs + 1] - curve.x[legs]
    between = curve.x[legs, None] + share[:, None] * step[:, None]
    tcp = tcp_at(robot, between.reshape(-1, step.shape[1]))[0].reshape(len(legs), PIECES - 1, 3)
    a, b = arm.tcp[legs, None], arm.tcp[legs + 1, None]
    along = (b - a) / np.maximum(np.linalg.norm(b - a, axis=-1, keepdims=True), 1e-300)
    away = tcp - a
    away = np.linalg.norm(away - (away * along).sum(-1, keepdims=True) * along, axis=-1).max(axis=1)
    here = arm.only(legs)
    bend = here.moved(bend_bound(here, np.abs(step), step)).tcp
    found[legs] = away + bend / (8 * PIECES**2)
    return found
