"""Fewer postures for controllers that interpolate between few better than they follow many."""

import numpy as np

from htcp_jax.program.timed import Timed


def thinned(timed: Timed, within: float) -> Timed:
    """The motion with fewer of its postures: the first, the last, the last of each kind, and as many between them that
    no joint of a posture left out is further than `within` [rad or m] from where it is at that time on straight joint
    paths at constant speed between those that stay.

    One posture after the other is left out as long as a straight path from the last one that stayed still passes all
    since: the slopes that do are an interval for each joint. What the arm passes is not the motion that was proven, but
    `within` of it.
    """
    kept, anchor = [0], 0
    least = np.full(timed.x.shape[1], -np.inf)
    most = -least
    for k in range(1, len(timed.x)):
        slope, slack = _slope(timed, anchor, k, within)
        bends = (slope < least).any() or (slope > most).any()
        if k - 1 > anchor and (bends or timed.kind[k] != timed.kind[k - 1]):
            kept.append(anchor := k - 1)
            slope, slack = _slope(timed, anchor, k, within)
            least, most = slope - slack, slope + slack
        else:
            least, most = np.maximum(least, slope - slack), np.minimum(most, slope + slack)
    rows = np.unique([*kept, len(timed.x) - 1])
    return Timed(*(column[rows] for column in timed[:-1]), timed.joint_names)


def _slope(timed: Timed, first: int, last: int, within: float) -> tuple[np.ndarray, float]:
    """Of the straight path from one posture to another, and by how much it may differ there."""
    seconds = timed.time_s[last] - timed.time_s[first]
    return (timed.x[last] - timed.x[first]) / seconds, within / seconds
