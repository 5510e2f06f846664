"""Largest scale of a set of errors up to which a motion stays proven, by bisection of its joint paths.

An interval's scale is a lower bound for all of its configurations, see `clearance.proof.error_bound`; that of its
middle alone is an upper bound on what the method can prove. Intervals are halved until the smallest lower bound is at
least 1 - GAP times the smallest upper bound.
"""

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance.proof import error_bound, error_pairs, error_scene
from htcp_jax.device import devices
from htcp_jax.model import robot as robots
from htcp_jax.motion import Problem
from htcp_jax.proving.curves import JointCurves

GAP = 0.02  # share of the scale that is not proven in favour of speed
TRIED = 1.0, 4.0, 16.0, 64.0  # largest scales that are looked for, one after the other
DEEPEST = 40  # maximum number of halvings
FARTHEST_M = 0.03  # longer intervals, by the largest displacement of a body, are halved at once
ROWS = 64  # intervals that are bounded together
EMPTY = 1e-9  # a smaller scale is none


class ErrorScale(NamedTuple):
    """Largest scale of a set of errors that is proven, and where it is decided."""

    scale: float  # [1]; 0: nothing is proven
    is_more: bool  # True: larger scales than `scale` were not tried
    segment: int | None  # segment that decides; None: none does
    place: float  # share of the segment [1]
    body: int | None  # index of the capsule that decides
    obstacle: int | None  # number of the obstacle
    intervals: int  # number of bounded intervals
    slides: bool = False  # True: some joints slide, so that errors of joints are in rad or m
    cover_m: float = 0.0  # covering radius of the points on the part's mesh, if they decide [m]; else 0

    def lack_m(self, clearance_m: float) -> float:
        """Return the clearance that is lacking at the scale 1 [m], if a clearance without errors suffices for `scale`.

        Args:
            clearance_m: The clearance of the motion, less the required one [m].
        """
        return clearance_m * (1 / self.scale - 1) if self.scale else np.inf


class _Open(NamedTuple):
    """Intervals of joint paths."""

    row: Int[np.ndarray, "n"]  # path
    middle: Float[np.ndarray, "n"]  # on the path, 0 to 1 [1]
    half: Float[np.ndarray, "n"]  # half of the width [1]


def scene_with(problem: Problem, errors: error_bound.ErrorSet) -> error_scene.ErrorScene:
    """Return the scene of a problem's first scenario, with errors."""
    where = jax.tree.map(lambda leaf: leaf[0], problem.scenarios)
    robot = robots.lengthen_tool(problem.robot, float(where.tool_extension_m))
    return error_scene.ErrorScene(robot, problem.obstacles, where, errors)


def error_scale(
    problem: Problem,
    curves: JointCurves,
    errors: error_bound.ErrorSet,
    *,
    margin_m: float = 0.0,
    gap: float = GAP,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> ErrorScale:
    """Return the largest scale of a set of errors up to which joint paths are proven to be clear.

    Args:
        problem: The problem, see `scene_of`; its first scenario counts.
        curves: The joint paths, with the servo's lag.
        errors: The errors at the scale 1.
        margin_m: Required clearance [m].
        gap: Largest share by which the result may be less than what is provable at single configurations [1].
        progress: Function that is called with the numbers of intervals bounded so far, and known so far.
    """
    with devices.on(problem.devices[0]):
        scene = scene_with(problem, errors)
        count = len(curves.segment)
        whole = _Open(np.arange(count), np.full(count, 0.5), np.full(count, 0.5))
        for most in TRIED:
            least = _bounded(scene, curves, whole._replace(half=np.zeros(count)), margin_m, most)[0].min(initial=most)
            if least < most:
                break
        low, best, done, depth, rows = least, least, 0, 0, whole
        where = -1, 0.5, -1, -1
        while len(rows.row):
            is_short = _travel(scene, curves, rows) <= FARTHEST_M
            short = _of(rows, is_short)
            scale, body, obstacle = _bounded(scene, curves, short, margin_m, best)
            limited = _of(short, scale < best)
            best = min(
                best,
                _bounded(scene, curves, limited._replace(half=0 * limited.half), margin_m, best)[0].min(initial=best),
            )
            final = (scale >= (1 - gap) * best) | (depth >= DEEPEST) | (best <= EMPTY)
            if final.any():
                k = int(np.where(final, scale, np.inf).argmin())
                if scale[k] <= low:
                    low, where = scale[k], (int(short.row[k]), float(short.middle[k]), int(body[k]), int(obstacle[k]))
            again = ~is_short
            again[is_short] = ~final
            done, depth, rows = done + len(rows.row), depth + 1, _halved(_of(rows, again))
            progress(done, done + len(rows.row))
    row, place, body, obstacle = where
    begin, end = curves.span[row] if row >= 0 else (0.0, 1.0)
    decides = row >= 0 and body >= 0
    return ErrorScale(
        float(low) if low > EMPTY else 0.0,
        bool(best >= TRIED[-1]),
        int(curves.segment[row]) if decides else None,
        float(begin + place * (end - begin)),
        body if decides else None,
        obstacle if decides else None,
        done,
        any(scene.robot.sliding),
        scene.clouds[obstacle].cover if obstacle in scene.clouds and scene.clouds[obstacle].of_part else 0.0,
    )


def _travel(scene: error_scene.ErrorScene, curves: JointCurves, rows: _Open) -> Float[np.ndarray, "n"]:
    """Return the largest displacement of a body from an interval's middle [m]."""
    parts = [np.zeros(0)]
    for first in range(0, len(rows.row), ROWS):
        places = scene.places(*_motion(curves, _of(rows, slice(first, first + ROWS))))
        parts.append(scene.moves(places, 0.0).max(axis=1))
    return np.concatenate(parts)


def _of(rows: _Open, chosen) -> _Open:
    return _Open(*(each[chosen] for each in rows))


def _halved(rows: _Open) -> _Open:
    half = 0.5 * rows.half
    middle = np.concatenate([rows.middle - half, rows.middle + half])
    return _Open(np.tile(rows.row, 2), middle, np.tile(half, 2))


def _bounded(scene: error_scene.ErrorScene, curves: JointCurves, rows: _Open, margin_m: float, most: float):
    """Return the scale of each interval, and the body and the obstacle that decide it, -1 if none does."""
    count = len(rows.row)
    scale, body, obstacle = np.full(count, float(most)), np.full(count, -1), np.full(count, -1)
    for first in range(0, count, ROWS):
        part = _of(rows, slice(first, first + ROWS))
        places = scene.places(*_motion(curves, part))
        found = error_pairs.limits_at(scene, places, margin_m, most)
        order = np.argsort(-found.scale, kind="stable")  # the smallest one of an interval is written last
        at = first + found.place[order]
        scale[at], body[at], obstacle[at] = found.scale[order], found.body[order], found.obstacle[order]
    return scale, body, obstacle


def _motion(curves: JointCurves, rows: _Open):
    """Return the middles of intervals, and the joints' motion on them, see `Places` [rad or m]."""
    c, off = curves.coefficients[rows.row], curves.off[rows.row]
    s, h = rows.middle[:, None], rows.half[:, None]
    derivatives, power = [], c
    for k in range(c.shape[1]):
        factors = np.array([factorial(j) / factorial(j - k) for j in range(k, c.shape[1])])
        powers = s ** np.arange(c.shape[1] - k)
        derivatives.append(np.einsum("nc,ncj->nj", powers * factors, power[:, k:]))
    moved = [np.abs(own) * h**k / factorial(k) for k, own in enumerate(derivatives)]
    rest = sum(moved[2:], np.zeros_like(off)) + off
    rates = h * (derivatives[1] if len(derivatives) > 1 else np.zeros_like(off))
    return derivatives[0], rates, np.abs(rates) + rest, rest
