"""Deviation of a program's file from the program's motion.

A file contains configurations, and its player joins them:

- `linear`: linearly in the joints and in time.
- `quintic`: by polynomials of degree 5 with the file's velocities and accelerations, as ROS 2's
  joint_trajectory_controller does (its documentation, Trajectory Representation, quintic splines).
- `straight`: the file contains the configurations of the motion, whose straight joint paths are proven.

The deviation is the distance between both motions at the same time, for `straight` at the same place of the motion:
controllers that read these files time the path between two configurations by themselves. It is measured at times at
most EVERY_S apart, and at least in the middle of two configurations; relative to the part if the part moves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.model import Robot
from htcp_jax.status import Kind
from htcp_jax.trajectory.displacement import tcp_at
from htcp_jax.trajectory.program import Program
from htcp_jax.trajectory.timed_motion import LINEAR, QUINTIC, STRAIGHT, TimedMotion

EVERY_S, MOST_TIMES = 0.002, 400_000
ROWS = 4096  # configurations whose TCP is computed at once

Ends = tuple[np.ndarray, np.ndarray]  # values at two configurations


class FileMotion(NamedTuple):
    """Configurations in a program's file, without joints that follow others, and how players join them."""

    timed: TimedMotion
    joined: tuple[str, ...] = (LINEAR,)


class Deviation(NamedTuple):
    """Largest deviation of a file from the program's motion, for one kind of joining its configurations."""

    joined: str  # `linear`, `quintic` or `straight`, see the module
    tcp_m: float  # largest distance of the TCP [m]
    time_s: float  # its time [s]
    path_m: float  # largest distance of the TCP on the path [m]; 0 if the tool does not follow a path
    path_time_s: float  # its time [s]
    joint: str  # name of the joint that deviates most
    joint_deviation: float  # its deviation [rad or m]


def deviations(robot: Robot, program: Program, file: FileMotion) -> list[Deviation]:
    """Return the deviations of a file, for each kind of joining its configurations.

    Args:
        robot: The robot with the job's tool.
        program: The program.
        file: The configurations in the file.
    """
    if len(file.timed.time_s) < 2:
        return []
    time = _times_between(file.timed.time_s)
    if STRAIGHT in file.joined:  # corners are rounded most at the configurations
        time = np.union1d(time, file.timed.time_s)
    motion = program.at(time)
    tcp, on_path = _tcp(robot, motion.x), np.isin(motion.kind, (Kind.PROCESS, Kind.DWELL))
    found = []
    for joined in file.joined:
        x = joined_configurations(program, file.timed, joined, time)
        found.append(_largest(motion, x, np.linalg.norm(_tcp(robot, x) - tcp, axis=1), on_path, joined))
    return found


def worst_deviation(found: list[Deviation]) -> Deviation:
    """Return the deviation that is largest on the path, or, if none is on the path, the largest one."""
    return max(found, key=lambda each: (each.path_m, each.tcp_m))


def joined_configurations(
    program: Program, timed: TimedMotion, joined: str, time: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n N"]:
    """Return the configurations at which a file's player is, at times that increase [s].

    Args:
        program: The program.
        timed: Configurations in the file.
        joined: `linear`, `quintic` or `straight`, see the module.
        time: The times [s].
    """
    if joined == STRAIGHT:
        return program.straight_at(time)
    leg = np.clip(np.searchsorted(timed.time_s, time, side="right") - 1, 0, len(timed.time_s) - 2)
    duration_s = np.diff(timed.time_s)[leg][:, None]
    w = np.clip((time - timed.time_s[leg])[:, None] / duration_s, 0.0, 1.0)
    return JOINS[joined](w, duration_s, *((x[leg], x[leg + 1]) for x in timed[1:4]))


def _linear(w: np.ndarray, duration_s: np.ndarray | float, x: Ends, velocity: Ends, acceleration: Ends) -> np.ndarray:
    """Return the configurations at shares w of the time between two configurations, joined linearly."""
    return x[0] + w * (x[1] - x[0])


def _quintic(w: np.ndarray, duration_s: np.ndarray | float, x: Ends, velocity: Ends, acceleration: Ends) -> np.ndarray:
    """Return what `_linear` returns, for the polynomial of degree 5 with the velocities and accelerations at both ends.

    The terms of degree 3 to 5 have no value, slope and second derivative at w = 0, and supply the rest at w = 1.
    """
    v0, v1 = (duration_s * each for each in velocity)
    a0, a1 = (duration_s**2 * each for each in acceleration)
    value, slope, second = x[1] - x[0] - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
    third = 10 * value - 4 * slope + 0.5 * second
    fourth = -15 * value + 7 * slope - second
    fifth = 6 * value - 3 * slope + 0.5 * second
    return x[0] + w * (v0 + w * (0.5 * a0 + w * (third + w * (fourth + w * fifth))))


JOINS = {LINEAR: _linear, QUINTIC: _quintic}


def _largest(
    motion: TimedMotion,
    x: Float[np.ndarray, "n N"],
    far: Float[np.ndarray, "n"],
    on_path: Bool[np.ndarray, "n"],
    joined: str,
) -> Deviation:
    """Return the largest of n deviations, from a file's configurations x and its TCP's distances [m]."""
    off, on = np.abs(x - motion.x).max(axis=0), np.where(on_path, far, 0.0)
    time, joint = motion.time_s.tolist(), int(off.argmax())
    tcp, path = (float(each.max()) for each in (far, on))
    when = (time[far.argmax()], time[on.argmax()])
    return Deviation(joined, tcp, when[0], path, when[1], motion.joint_names[joint], float(off[joint]))


def _times_between(time: Float[np.ndarray, "n"]) -> Float[np.ndarray, "m"]:
    """Return times between those of a file's configurations, at most MOST_TIMES, or one between any two."""
    gap = np.diff(time)
    every = max(EVERY_S, float(gap.sum()) / MOST_TIMES)
    pieces = np.maximum(2, np.ceil(gap / every - 1e-9)).astype(int)
    first = np.cumsum(pieces - 1) - (pieces - 1)
    number = np.arange((pieces - 1).sum()) - np.repeat(first, pieces - 1) + 1
    return np.repeat(time[:-1], pieces - 1) + number * np.repeat(gap / pieces, pieces - 1)


def _tcp(robot: Robot, x: Float[np.ndarray, "n N"]) -> Float[np.ndarray, "n 3"]:
    """Return the TCP's positions [m], ROWS at a time, so that few sizes are compiled."""
    return np.concatenate([tcp_at(robot, x[first : first + ROWS])[0] for first in range(0, len(x), ROWS)])
