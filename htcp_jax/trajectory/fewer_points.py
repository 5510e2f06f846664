"""Fewer configurations for a program's file, placed where they are needed.

Of samples of the program's motion, at most N are chosen so that the piecewise linear motion between them deviates
little from the program's motion at the same time. The deviation is the largest displacement of a point of the arm, the
ends of its bodies and the TCP, to first order |J(x) dx|: one length in metres, which limits the tool's path error and
the loss of clearance alike, as no weights of joints do. From each chosen sample the next one is the farthest whose
chord is within a tolerance, and the tolerance is the smallest, by bisection, that needs at most N samples. Times at
which the program stops, and both ends, are always chosen.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.trajectory.deviation import JOINS, FileMotion, deviations, worst_deviation
from htcp_jax.trajectory.displacement import arm_at
from htcp_jax.trajectory.program import Program
from htcp_jax.trajectory.timed_motion import LINEAR, TimedMotion

STEP_S, CANDIDATES = 0.001, 20_000  # time between candidates, and their number in a long motion
NUMBERS = 20_000_000  # maximum number of elements of the Jacobians in memory
ROWS = 1024  # configurations whose Jacobians are computed at once
INSIDE = 32  # maximum number of samples that are compared with a chord
PRECISION, FINEST = 1.02, 1e-7  # ratio of tolerances at which bisection ends; smallest tolerance / largest
LOOSEST, CLOSER, TRIES = (
    4.0,
    0.8,
    24,
)  # for the smallest number: first tolerance / required, ratio, number of tolerances
MOMENT_S = 1e-6  # time before a configuration at which its kind and target are read


def fewer_points(
    robot: Robot,
    program: Program,
    most: int,
    joined: tuple[str, ...] = (LINEAR,),
    control_step_s: float | None = None,
) -> FileMotion:
    """Return at most `most` configurations of a program's motion, placed where they are needed.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        most: Maximum number of configurations.
        joined: How players join the configurations, `linear` or `quintic`, see `deviation`; each kind counts.
        control_step_s: Step of which all times must be multiples [s]; None: any times.

    Raises:
        InputError: If the program stops at more places.
    """
    found = candidates(robot, program, most, joined, control_step_s)
    return FileMotion(samples(program, found.time[chosen(found, most)]), joined)


def fewest_points(
    robot: Robot,
    program: Program,
    tolerance_m: float,
    joined: tuple[str, ...] = (LINEAR,),
    control_step_s: float | None = None,
) -> int | None:
    """Return a number of configurations for which `fewer_points` keeps a tolerance on the path.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        tolerance_m: Maximum distance of the TCP from the program's motion on the path [m].
        joined: As in `fewer_points`.
        control_step_s: As in `fewer_points`.

    Returns:
        The smallest number found; None if no number is found.
    """

    def is_kept(indices: Int[np.ndarray, "m"]) -> bool:
        file = FileMotion(samples(program, found.time[indices]), joined)
        return worst_deviation(deviations(robot, program, file)).path_m <= tolerance_m

    found = candidates(robot, program, CANDIDATES // 2, joined, control_step_s)
    too_few = len(found.stops) - 1
    for number in range(TRIES):
        kept = within(found, LOOSEST * CLOSER**number * tolerance_m)
        if is_kept(kept) and is_kept(chosen(found, len(kept))):
            enough = len(kept)
            while enough - too_few > 1:
                middle = (enough + too_few) // 2
                too_few, enough = (too_few, middle) if is_kept(chosen(found, middle)) else (middle, enough)
            return enough
        too_few = len(kept)
    return None


def samples(program: Program, time: Float[np.ndarray, "n"]) -> TimedMotion:
    """Return the program's motion at n times [s], each with kind and target of the motion that ends there."""
    before = program.at(np.maximum(time - MOMENT_S, 0.0))
    return program.at(time)._replace(kind=before.kind, target=before.target, span=before.span)


class Candidates(NamedTuple):
    """Samples of a program's motion, of which some are chosen."""

    time: Float[np.ndarray, "n"]  # [s]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    velocity: Float[np.ndarray, "n N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "n N"]  # [rad/s2 or m/s2]
    jacobian: Float[np.ndarray, "n P3 N"]  # of P points of the arm by the coordinates [m/rad or 1]
    stops: Int[np.ndarray, "k"]  # indices of the samples at which the arm is at rest: both ends, and each stop
    joined: tuple[str, ...]  # how players join them, see `deviation`


def candidates(
    robot: Robot,
    program: Program,
    most: int,
    joined: tuple[str, ...] = (LINEAR,),
    control_step_s: float | None = None,
) -> Candidates:
    """Return the samples of a program's motion of which at most `most` are chosen.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        most: Maximum number of configurations in the file.
        joined: How players join the configurations, `linear` or `quintic`, see `deviation`; the deviation counts for
            each.
        control_step_s: Step of which all times must be multiples [s]; None: any times.

    Raises:
        InputError: If the program stops at more places.
    """
    ends = np.append(0.0, program.ends_s)
    if most < len(ends):
        stops = f"the program begins, ends and stops at {len(ends)} configurations"
        raise InputError(f"--max-points is {most}; {stops}, so at least {len(ends)} are needed")
    count = max(CANDIDATES, 2 * most)
    count = max(2, min(count, NUMBERS // _elements(robot, program)))
    step = max(STEP_S, program.duration_s / count)
    if control_step_s is None:
        pieces = [np.linspace(a, b, 2 + int((b - a) / step))[1:] for a, b in pairwise(ends.tolist())]
        stops = np.append(0, np.cumsum([len(piece) for piece in pieces]))
        time = np.concatenate([ends[:1], *pieces])
    else:
        last = np.ceil(ends / control_step_s - 1e-9).astype(int)  # the first step at or after each stop
        steps = np.union1d(np.arange(0, last[-1], max(1, round(step / control_step_s))), last)
        stops, time = np.searchsorted(steps, np.unique(last)), control_step_s * steps
    _, x, velocity, acceleration, *_ = program.at(time)
    parts = [_jacobians(robot, x[first : first + ROWS]) for first in range(0, len(x), ROWS)]
    return Candidates(time, x, velocity, acceleration, np.concatenate(parts), stops, joined)


def chosen(found: Candidates, most: int) -> Int[np.ndarray, "m"]:
    """Return the indices of at most `most` candidates whose piecewise linear motion deviates least, see the module."""
    if len(found.time) <= most:
        return np.arange(len(found.time))
    kept, high = found.stops, max(_off(found, i, j) for i, j in pairwise(found.stops.tolist()))
    low = FINEST * high
    while high > PRECISION * low:
        middle = np.sqrt(low * high)
        fitting = within(found, middle, most)
        if fitting[-1] == len(found.time) - 1:
            kept, high = fitting, middle
        else:
            low = middle
    return kept


def within(found: Candidates, tolerance_m: float, most: int | None = None) -> Int[np.ndarray, "m"]:
    """Return the indices of candidates whose piecewise linear motion deviates by at most `tolerance_m`.

    Args:
        found: The candidates.
        tolerance_m: Largest displacement of a point of the arm [m].
        most: Number of indices after which the search ends; None: it ends at the last candidate.
    """
    kept, span = [0], 1
    for last in found.stops[1:].tolist():
        while kept[-1] < last and len(kept) != most:
            following = _farthest(found, kept[-1], last, span, tolerance_m)
            span = following - kept[-1]
            kept.append(following)
    return np.array(kept)


def _farthest(found: Candidates, first: int, last: int, span: int, tolerance_m: float) -> int:
    """Return the farthest index up to `last` whose chord from `first` is within a tolerance; `span` is a first guess.

    Chords are assumed to deviate more the longer they are.
    """
    good, bad = first + 1, last + 1
    while bad - good > 1:
        trial = min(good + span, last) if bad > last else (good + bad) // 2
        if _off(found, first, trial) <= tolerance_m:
            good, span = trial, 2 * span
        else:
            bad = trial
    return good


def _off(found: Candidates, first: int, last: int) -> float:
    """Return the largest displacement of a point of the arm between two samples, joined linearly [m]."""
    if last - first < 2:
        return 0.0
    inside, duration_s = slice(first + 1, last, -(-(last - first - 1) // INSIDE)), found.time[last] - found.time[first]
    w = (found.time[inside] - found.time[first])[:, None] / duration_s
    ends = [(x[first], x[last]) for x in (found.x, found.velocity, found.acceleration)]
    steps = [JOINS[joined](w, duration_s, *ends) - found.x[inside] for joined in found.joined]
    moved = [(found.jacobian[inside] @ step[:, :, None]).reshape(len(w), -1, 3) for step in steps]
    return float(np.sqrt(max((each * each).sum(axis=2).max() for each in moved)))


def _jacobians(robot: Robot, x: Float[np.ndarray, "k N"]) -> Float[np.ndarray, "k P3 N"]:
    """Return the Jacobians of the arm's points by its coordinates x."""
    arm = arm_at(robot, x)
    slopes = arm.jacobian if arm.factors is None else arm.jacobian @ arm.factors
    return slopes.reshape(len(x), -1, slopes.shape[-1])


def _elements(robot: Robot, program: Program) -> int:
    """Return the number of elements of one sample's Jacobians."""
    return _jacobians(robot, program.at(np.zeros(1)).x)[0].size
