"""A motion with time, looked at by MuJoCo alone: is every posture of it clear, and the tool on its path?

Nothing is asked of the curve, its bounds or its law: postures as they are written are put where MuJoCo's kinematics has
them, and measured to the plan's scene, as `htcp validate` does.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.program.timed import Timed
from htcp_jax.status import Kind
from htcp_jax.validation.mujoco_clearance import CheckedScene
from htcp_jax.validation.records import read_results
from htcp_jax.validation.result import ROUNDING_M
from htcp_jax.validation.task_check import Place, hold_between, holds_tcp
from htcp_jax.validation.track import from_line, scene_of
from htcp_jax.validation.validate import parts_of

AT_ONCE = 256  # postures; what is near them all is in memory


class TimedCheck(NamedTuple):
    """What was found at n postures."""

    touches: Bool[np.ndarray, "n"]
    leaves: Bool[np.ndarray, "n"]  # the TCP is further from its path than the tolerance, or an axis out of its cone
    beyond: Bool[np.ndarray, "n"]  # a joint is outside its limits
    clearance_min_m: float
    off_max_m: float  # of the TCP, from the lines between the targets; 0 where the task does not hold it

    @property
    def refuted(self) -> int:
        """How many of the postures do not stand."""
        return int((self.touches | self.leaves | self.beyond).sum())


def check_timed(folder: str | Path, timed: Timed, method: str, scenario: int = 0) -> TimedCheck:
    """The motion of a plan that is on record in `folder`. Raises InputError as `open_plans` does."""
    results = read_results(Path(folder))
    track = next(one for one in results.tracks if (one.method, one.scenario) == (method, scenario))
    arm, wall, beside = parts_of(results, track)
    scene, targets, on_path = scene_of(results, arm, wall, beside, track)
    clearance, tcp = _at(scene, timed.x)
    settings = track.config.settings
    leaves, off = np.zeros(len(timed.x), bool), np.zeros(len(timed.x))
    held = np.flatnonzero(np.isin(timed.kind, (Kind.FEED, Kind.DWELL)))
    if len(held):
        to = timed.target[held]
        before = np.where(timed.kind[held] == Kind.DWELL, to, to - 1)
        if holds_tcp(track.config.task):
            off[held] = from_line(tcp[held], targets[before], targets[to])
            leaves[held] = off[held] > settings.tube_m + ROUNDING_M
        if track.config.task:
            part = results.workpiece(track.config)
            ends = [Place(scene.rotate, scene.translate, part, end - on_path) for end in (before, to)]
            cones = [row for row in track.config.task if row.axis is not None and row.limit_deg is not None]
            inside = hold_between(cones, arm, timed.x[held], *ends, settings.tolerance_m, settings.tolerance_rad)
            leaves[held] |= ~inside.all(axis=0)
    beyond = ((timed.x < arm.lower - ROUNDING_M) | (timed.x > arm.upper + ROUNDING_M)).any(axis=1)
    return TimedCheck(clearance <= 0, leaves, beyond, float(clearance.min()), float(off.max()))


def _at(scene: CheckedScene, x: Float[np.ndarray, "n N"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
    """Clearance and TCP at postures [m], some at a time."""
    found = [scene.at(x[first : first + AT_ONCE]) for first in range(0, len(x), AT_ONCE)]
    return np.concatenate([one.clearance for one in found]), np.concatenate([one.postures.tcp for one in found])
