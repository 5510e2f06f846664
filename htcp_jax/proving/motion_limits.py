"""Use of the joints' limits by a motion: position, velocity, acceleration, jerk.

A segment's polynomial is split into PIECES equal parts. On each, the Bernstein coefficients bound the polynomial and
its derivatives (Farouki and Rajan, "On the numerical condition of polynomials in Bernstein form", 1987). The first and
the last coefficient are values of the polynomial; by them alone a limit is reported as violated.
"""

from math import comb
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.io.robots import LIMIT_ROUNDING, JointLimits
from htcp_jax.model import Robot
from htcp_jax.spec import PlanConfig
from htcp_jax.trajectory import limits_of_job, stated_limits

PIECES = 16  # parts of a segment
CHUNK = 2000  # segments at a time
ROUNDING = 1e-3  # share of a limit by which rates may exceed it: files round times and positions
RATES = ("velocity", "acceleration", "jerk")


class LimitUse(NamedTuple):
    """Largest use of one kind of limit by a joint."""

    quantity: str  # "position", "velocity", "acceleration" or "jerk"
    joint: str  # name of the joint
    is_slide: bool  # True: lengths in m, False: angles in rad
    largest: float  # bound on the position or the rate's magnitude [rad or m, per s, s2 or s3]
    limit: float | None  # the limit, in the unit of `largest` [rad or m, per s, s2 or s3]; None: none is stated
    share: float | None  # largest / limit; for positions the distance from the range's middle / half the range [1]
    excess: float | None  # largest excess over the limit, 0 if it is kept [rad or m, per s, s2 or s3]
    segment: int  # segment on which it occurs
    is_violated: bool


def limit_uses(
    robot: Robot,
    coefficients: Float[np.ndarray, "m K N"],
    time_s: Float[np.ndarray, "n"] | None,
    job: PlanConfig | None = None,
) -> tuple[LimitUse, ...]:
    """Return the use of the limits by a motion.

    Positions: one entry per violated joint, or the joint nearest to its limit. Rates: one entry per violated joint, or
    the joint with the largest share; only if there are times. For straight segments only the velocity is defined.

    Args:
        robot: The robot.
        coefficients: The segments' polynomials, see `curves.JointCurves` [rad or m].
        time_s: Times of the configurations; None: unknown.
        job: The job with further limits; None: only the robot's.

    Raises:
        InputError: For a file of limits that is invalid.
    """
    stated = None if job is None else limits_of_job(job, robot)
    found = _positions(robot, coefficients, stated)
    if time_s is None:
        return found
    limits = stated_limits(robot, None if job is None else job.program, stated)
    order, h = coefficients.shape[1] - 1, np.diff(time_s)
    slides = np.asarray(robot.sliding, bool)
    for rate in range(1, min(order, 3) + 1):
        coefficients = coefficients[:, 1:] * np.arange(1, coefficients.shape[1])[None, :, None]
        value = coefficients / (h**rate)[:, None, None]
        bound, seen = (np.abs(each).max(axis=1) for each in _ranges(value))
        limit = np.asarray(getattr(limits, RATES[rate - 1]), float)
        found += _rates(robot, RATES[rate - 1], bound, seen, limit, slides)
    return found


def _positions(
    robot: Robot, coefficients: Float[np.ndarray, "m K N"], stated: JointLimits | None
) -> tuple[LimitUse, ...]:
    names, lower, upper = robot.joint_names, np.asarray(robot.lower, float), np.asarray(robot.upper, float)
    slides = np.asarray(robot.sliding, bool)
    if robot.coupling is None and stated is not None:
        file_lower, file_upper = stated.ranges(robot.slides, lower, upper)
        lower, upper = np.maximum(lower, file_lower), np.minimum(upper, file_upper)
    bound, seen = _ranges(coefficients)
    excess = np.maximum(lower - bound[:, 0], bound[:, 1] - upper)  # (m, N)
    surely = np.maximum(lower - seen[:, 0], seen[:, 1] - upper)
    segment, violated = excess.argmax(axis=0), surely.max(axis=0, initial=-np.inf) > LIMIT_ROUNDING
    uses = []
    for k, name in enumerate(names):
        row = int(segment[k])
        high = bound[row, 1, k] - upper[k] >= lower[k] - bound[row, 0, k]
        largest, limit = (bound[row, 1, k], upper[k]) if high else (bound[row, 0, k], lower[k])
        half = 0.5 * (upper[k] - lower[k])
        share = float(abs(largest - 0.5 * (upper[k] + lower[k])) / half) if 0 < half < np.inf else None
        known = np.isfinite(limit)
        over = float(max(excess[row, k], 0.0)) if known else None
        given = float(limit) if known else None
        uses.append(
            LimitUse(
                "position", name, bool(slides[k]), float(largest), given, share, over, row, bool(violated[k] and known)
            )
        )
    return _worst(uses)


def _rates(
    robot: Robot,
    quantity: str,
    bound: Float[np.ndarray, "m N"],
    seen: Float[np.ndarray, "m N"],
    limit: Float[np.ndarray, "N"],
    slides: Bool[np.ndarray, "N"],
) -> tuple[LimitUse, ...]:
    uses, segment = [], bound.argmax(axis=0)
    for k, name in enumerate(robot.joint_names):
        row, known = int(segment[k]), bool(0 < limit[k] < np.inf)
        largest = float(bound[row, k])
        given, share = (float(limit[k]), largest / float(limit[k])) if known else (None, None)
        over = max(largest - float(limit[k]), 0.0) if known else None
        violated = known and float(seen[:, k].max()) > limit[k] * (1 + ROUNDING)
        uses.append(LimitUse(quantity, name, bool(slides[k]), largest, given, share, over, row, bool(violated)))
    return _worst(uses)


def _worst(uses: list[LimitUse]) -> tuple[LimitUse, ...]:
    """Return the violated uses, or else the one with the largest share, or without limits the largest one."""
    violated = tuple(use for use in uses if use.is_violated)
    return violated or (max(uses, key=lambda use: (use.share is not None, use.share or 0.0, abs(use.largest))),)


def _ranges(
    coefficients: Float[np.ndarray, "m K N"],
) -> tuple[Float[np.ndarray, "m 2 N"], Float[np.ndarray, "m 2 N"]]:
    """Return bounds on polynomials on 0 <= s <= 1, and the smallest and largest values at the ends of the parts."""
    count = coefficients.shape[1]
    split = _bernstein(count)
    bounds, values = [], []
    for first in range(0, len(coefficients), CHUNK):
        found = np.einsum("pik,mkn->mpin", split, coefficients[first : first + CHUNK], optimize=True)
        ends = found[:, :, [0, -1]]
        for kept, given in ((bounds, found), (values, ends)):
            kept.append(np.stack([given.min(axis=(1, 2)), given.max(axis=(1, 2))], axis=1))
    return np.concatenate(bounds), np.concatenate(values)


def _bernstein(count: int) -> Float[np.ndarray, "P K K"]:
    """Return the matrices from a polynomial's coefficients to its Bernstein coefficients on each part."""
    degree, width, found = count - 1, 1.0 / PIECES, []
    for part in range(PIECES):
        a = part * width
        shift = np.array(
            [[comb(k, j) * a ** (k - j) * width**j if k >= j else 0.0 for k in range(count)] for j in range(count)]
        )
        change = np.array(
            [[comb(i, j) / comb(degree, j) if i >= j else 0.0 for j in range(count)] for i in range(count)]
        )
        found.append(change @ shift)
    return np.stack(found)
