"""Motions: the configurations that an arm passes from a plan's start, joined by straight joint paths.

    motion(plans, 12, on_path)                       # motion of scenario 12
    cost(motions(plans, on_path), len(plans.x))      # motion costs of all scenarios

A motion has only the executable part of a plan.

This module also computes a motion's figures: number of dwells, smoothness, guaranteed clearance. Equation (3) of the
paper minimises `||x||_Q^2` with Q = V'V, where V takes finite differences of consecutive configurations. This is the
unweighted sum of `|x_{t+1} - x_t|^2`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from htcp_jax.model import ONE_POINT_M
from htcp_jax.motion.plans import Plans
from htcp_jax.status import Kind, Status

OnPath = int | Int[np.ndarray, "S"]  # index of the first target that is a point of the path, see `Scenario`


class Motion(NamedTuple):
    """Motion of one scenario, one row per configuration, beginning at the start; empty if no target is executable."""

    x: Float[np.ndarray, "n N"]  # [rad or m]
    target: Int[np.ndarray, "n"]  # target that the row leads to; for a dwell, the target at which the tool stays
    kind: Int8[np.ndarray, "n"]  # `status.Kind` of the motion from the previous row to this row
    # Shares of the segment at which the motion to this row begins and ends; 0 and 1 without via points
    span: Float[np.ndarray, "n 2"] | None = None  # [1]; None: all via points, if any, are dwells at targets


class Motions(NamedTuple):
    """Motions of S scenarios, one after the other; see `Motion`."""

    scenario: Int[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    target: Int[np.ndarray, "n"]
    kind: Int8[np.ndarray, "n"]
    span: Float[np.ndarray, "n 2"]  # [1]

    def of(self, scenario: int) -> Motion:
        """Return the motion of one scenario, given by its row."""
        return Motion(*(column[self.scenario == scenario] for column in self[1:]))

    @property
    def steps(self) -> Float[np.ndarray, "n"]:
        """Length |x_k - x_{k-1}| of each joint step from the previous row [rad]; 0 at the starts."""
        first = np.diff(self.scenario, prepend=-1) != 0
        return np.where(first, 0.0, np.linalg.norm(np.diff(self.x, axis=0, prepend=self.x[:1]), axis=1))


def motion(plans: Plans, scenario: int, on_path: int, *, retract: bool = False) -> Motion:
    """Return the motion of one scenario, up to its last executable target.

    Args:
        plans: The plans.
        scenario: Row of the scenario.
        on_path: Index of the first target that is a point of the path, `Scenario.on_path`.
        retract: True to append the motion back to the start: `Plans.retract`, or through the same configurations.
    """
    there = motions(plans.rows([scenario]), on_path).of(0)
    if not retract:
        return there
    if (own := plans.way_back(scenario)) is not None:
        x = own.x
        last = np.full(len(x), there.target[-1])
        back = Motion(x, last, np.full(len(x), Kind.RETRACT, np.int8), np.tile([0.0, 1.0], (len(x), 1)))
        return Motion(*map(np.concatenate, zip(there, back, strict=True)))
    x, target, kind, span = (column[-2::-1] for column in there)
    back = Motion(x, target, np.full_like(kind, Kind.RETRACT), span)
    return Motion(*map(np.concatenate, zip(there, back, strict=True)))


def motions(plans: Plans, on_path: OnPath, rows: Bool[np.ndarray, "S T"] | None = None) -> Motions:
    """Return the motions of all scenarios.

    Args:
        plans: The plans.
        on_path: Index of the first target that is a point of the path: one for all scenarios, or one per scenario.
        rows: True for the targets to include; None: the executable targets.
    """
    rows = plans.executable if rows is None else rows
    begun, (s, t) = np.flatnonzero(rows.any(axis=1)), np.nonzero(rows)
    via_points = plans.via_points
    passed = rows[via_points.scenario, via_points.target]
    scenario = np.concatenate([begun, via_points.scenario[passed], s])
    target = np.concatenate([np.zeros_like(begun), via_points.target[passed], t])
    x = np.concatenate([plans.start[begun], via_points.x[passed], plans.x[s, t]])
    place = np.repeat([0, 1, 2], [len(begun), passed.sum(), len(s)])  # on each segment: start, via points, row
    end = np.concatenate([np.zeros(len(begun)), via_points.share[passed], np.ones(len(s))])
    stays = np.concatenate([np.zeros(len(begun), bool), via_points.stays[passed], np.zeros(len(s), bool)])
    order = np.lexsort((place, target, scenario))
    scenario, target, end, stays = scenario[order], target[order], end[order], stays[order]
    kind = _motion_kinds(target, stays, np.broadcast_to(on_path, len(rows))[scenario])
    kind[(transfers(plans)[scenario] & (target == 0)) | plans.begins_seam[target]] = Kind.TRANSFER
    same = (np.diff(scenario, prepend=-1) == 0) & (np.diff(target, prepend=-1) == 0)
    span = np.stack([np.where(same, np.append(0.0, end[:-1]), 0.0)[: len(end)], end], axis=1)
    return Motions(scenario, x[order], target - (kind == Kind.DWELL), kind, span)


def _motion_kinds(target: np.ndarray, stays: np.ndarray, on_path: np.ndarray) -> Int8[np.ndarray, "n"]:
    """Return the `status.Kind` of the motion to each configuration; transfers are not marked."""
    kind = np.where(target > on_path, np.where(stays, Kind.DWELL, Kind.PROCESS), Kind.APPROACH)
    return kind.astype(np.int8)


def transfers(plans: Plans) -> Bool[np.ndarray, "S"]:
    """Return True for scenarios whose arm first moves from the start to another configuration.

    This is the case if the segment to the first target has via points, or if the first target was tracked by a
    recovery.
    """
    found = (plans.status[:, :1] == Status.TRACKED_AFTER_RECOVERY).any(axis=1)
    found[plans.via_points.scenario[plans.via_points.target == 0]] = True
    return found


class LargestJointSteps(NamedTuple):
    """Largest travel of a joint between two targets of the path, for each of S scenarios."""

    step: Float[np.ndarray, "S"]  # [rad; m for a slide]; NaN if the motion does not reach the path's second point
    target: Int[np.ndarray, "S"]  # target at the end of the segment; -1 if `step` is NaN
    joint: Int[np.ndarray, "S"]  # index of the joint; -1 if `step` is NaN


def largest_joint_steps(plans: Plans, on_path: OnPath) -> LargestJointSteps:
    """Return the largest travel of a joint between two targets of the path, summed over the segment's via points.

    Args:
        plans: The plans.
        on_path: Index of the first target that is a point of the path: one for all scenarios, or one per scenario.
    """
    found, travel = motions(plans, on_path), np.full(plans.x.shape, np.nan)
    segment = found.target + (found.kind == Kind.DWELL)
    rows = np.flatnonzero((found.kind == Kind.PROCESS) | (found.kind == Kind.DWELL))
    own = found.scenario[rows], segment[rows]
    travel[own] = 0.0
    np.add.at(travel, own, np.abs(found.x[rows] - found.x[rows - 1]))
    count, targets, joints = travel.shape
    flat = np.full((count, 1 + targets * joints), -1.0)  # the first column is the maximum if there is no step
    flat[:, 1:] = np.where(np.isnan(travel), -1.0, travel).reshape(count, targets * joints)
    best = flat.argmax(axis=1)
    target, joint = np.divmod(best - 1, max(1, joints))
    step = flat[np.arange(count), best]
    return LargestJointSteps(
        np.where(best > 0, step, np.nan), np.where(best > 0, target, -1), np.where(best > 0, joint, -1)
    )


class MotionFigures(NamedTuple):
    """Figures of S scenarios, one column each; NaN if undefined."""

    dwells: Float[np.ndarray, "S"]  # number of dwells [1]
    motion_cost_rad2: Float[np.ndarray, "S"]  # equation (3), see `cost` [rad^2]
    path_step_max_rad: Float[np.ndarray, "S"]  # see `largest_step`
    curvature_max_rad_m2: Float[np.ndarray, "S"]  # see `curvature`
    segment_clearance_min_m: Float[np.ndarray, "S"]  # see `narrowest_segment`


def motion_figures(plans: Plans, on_path: OnPath) -> MotionFigures:
    """Return all figures of the scenarios' motions.

    Args:
        plans: The plans.
        on_path: Index of the first target that is a point of the path: one for all scenarios, or one per scenario.
    """
    found, count = motions(plans, on_path), len(plans.status)
    begun = plans.executable.any(axis=1)
    return MotionFigures(
        dwells=np.where(begun, dwells(plans, on_path).sum(axis=1), np.nan),
        motion_cost_rad2=np.where(begun, cost(found, count), np.nan),
        path_step_max_rad=largest_step(found, count),
        curvature_max_rad_m2=np.fmax.reduce(curvature(plans, on_path), axis=1, initial=np.nan),
        segment_clearance_min_m=narrowest_segment(plans)[1],
    )


def dwells(plans: Plans, on_path: OnPath) -> Bool[np.ndarray, "S T"]:
    """Return True for targets of the path at which the arm dwells: the tool stays while the arm reconfigures.

    The arm then moves on to the next target, which must be executable.
    """
    found = np.zeros_like(plans.tracked)
    turns = _turns(plans) & (np.arange(found.shape[1]) > np.reshape(on_path, (-1, 1)))
    found[:, :-1] = turns[:, 1:]
    return found


def cost(found: Motions, count: int) -> Float[np.ndarray, "S"]:
    """Return the cost of equation (3), ||x||_Q^2 with Q = V'V [rad^2].

    It is the sum of |x_{k+1} - x_k|^2 over all configurations from the start to the last executable target. A smoother
    motion along the same path costs less.

    Args:
        found: The motions.
        count: Number of scenarios, S.
    """
    return np.bincount(found.scenario, found.steps**2, count).astype(float)


def largest_step(found: Motions, count: int) -> Float[np.ndarray, "S"]:
    """Return the largest |x_{k+1} - x_k| on the path, dwells included [rad].

    It is NaN if the motion does not reach the path's second point. Equation (3) sums the squares of such steps.

    Args:
        found: The motions.
        count: Number of scenarios, S.
    """
    most = np.full(count, np.nan)
    on_path = (found.kind == Kind.PROCESS) | (found.kind == Kind.DWELL)
    np.fmax.at(most, found.scenario[on_path], found.steps[on_path])
    return most


def curvature(plans: Plans, on_path: OnPath) -> Float[np.ndarray, "S T"]:
    """Return |q''|, the curvature of the joint path at the points of the path [rad/m2].

    It is computed by central differences over the path's arc length, and is proportional to the joint accelerations at
    a constant feed rate. Equation (3), in contrast, sums squared first differences.

    Points closer than ONE_POINT_M are one point, with the configuration of the last of them. The arc length does not
    grow during a dwell, so |q''| is undefined at a target where the arm dwells and at the next target. The result is
    NaN there, at both ends of each seam and everywhere off the path.
    """
    path = plans.executable & (np.arange(plans.x.shape[1]) >= np.reshape(on_path, (-1, 1)))
    ahead = np.linalg.norm(np.diff(plans.target, axis=1), axis=2)
    ahead[:, plans.begins_seam[1:]] = np.inf
    points = path.copy()
    points[:, :-1] &= ~(path[:, 1:] & (ahead < ONE_POINT_M))
    s, t = np.nonzero(points)
    breaks = _turns(plans) | plans.begins_seam
    x, place, turned = plans.x[s, t], plans.target[s, t], np.cumsum(breaks, axis=1)[s, t]
    straight = (np.diff(s) == 0) & (np.diff(turned) == 0)  # True: no dwell, and no other seam, before the next point
    length = np.where(straight, np.linalg.norm(np.diff(place, axis=0), axis=1), 1.0)
    slope = np.diff(x, axis=0) / length[:, None]
    bend = 2 * np.linalg.norm(np.diff(slope, axis=0), axis=1) / (length[:-1] + length[1:])
    found = np.full(plans.status.shape, np.nan)
    found[s[1:-1], t[1:-1]] = np.where(straight[:-1] & straight[1:], bend, np.nan)
    return found


def narrowest_segment(
    plans: Plans, without_transfer: bool = False
) -> tuple[Int[np.ndarray, "S"], Float[np.ndarray, "S"]]:
    """Return each scenario's target whose segment has the least guaranteed clearance, and this clearance [m].

    The result is -1 and NaN if no target is executable.

    Args:
        plans: The plans.
        without_transfer: True excludes the segments to later seams and, with a transfer, to the first target.
    """
    clear = np.where(plans.executable, plans.segment_clearance, np.inf)
    if without_transfer:
        clear[transfers(plans), 0] = np.inf
        clear[:, plans.begins_seam] = np.inf
    target, least = clear.argmin(axis=1), clear.min(axis=1)
    return np.where(np.isinf(least), -1, target), np.where(np.isinf(least), np.nan, least)


def _turns(plans: Plans) -> Bool[np.ndarray, "S T"]:
    """Return True for executable targets on whose segment the arm changes its configuration while the tool stays."""
    found, via_points = np.zeros_like(plans.tracked), plans.via_points
    found[via_points.scenario[via_points.stays], via_points.target[via_points.stays]] = True
    return found & plans.executable & ~plans.begins_seam
