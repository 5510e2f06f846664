"""Check that the tool's bare tip passes through no wall, at a configuration and along a joint path, for many lanes at
once.

The tip is not a collision body: it has to come near the wall, and the job defines what it may touch (`tip_guard`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.clearance.obstacles.obstacle import in_workpiece
from htcp_jax.clearance.obstacles.scene import Scene, own_scene
from htcp_jax.clearance.obstacles.tip_guard import TipGuard
from htcp_jax.device.kernel import STEP, Kernel
from htcp_jax.device.programs import Kernels
from htcp_jax.model.kinematics import tip_segment
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.settings import Settings

PLACES = 100  # intervals of a joint path at whose ends the tip is checked


def tip(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """Return the tool's bare tip at x in the workpiece's frame, from the last body to the TCP."""
    return in_workpiece(lane, tip_segment(own_scene(scene, lane.tool_extension_m).robot, x))


TIP = Kernel("tip", tip, STEP)


class TipCheck(NamedTuple):
    """The kernels that compute the tip's position, and the walls that it must not pass through."""

    kernels: Kernels
    guard: TipGuard

    def at(self, inputs: LaneInputs, x: Float[np.ndarray, "n N"]) -> Bool[np.ndarray, "n"]:
        """True for each lane whose tip passes through a wall at its configuration."""
        tip = self.kernels(TIP, inputs, x)
        return self.guard.passes(tip[:, 0], tip[:, 1])

    def along(
        self, inputs: LaneInputs, a: Float[np.ndarray, "n N"], b: Float[np.ndarray, "n N"]
    ) -> Bool[np.ndarray, "n"]:
        """True for each lane whose tip passes through a wall between its a and b, checked at PLACES samples."""
        fraction = (np.arange(1, PLACES) / PLACES)[None, :, None]
        x = a[:, None] + fraction * (b - a)[:, None]
        row = np.repeat(np.arange(len(a)), PLACES - 1)
        through = self.at(jax.tree.map(lambda table: table[row], inputs), x.reshape(len(row), -1))
        return through.reshape(len(a), -1).any(axis=1)


def tip_checks(kernels: Sequence[Kernels], guard: TipGuard | None) -> list[TipCheck | None]:
    """Return one check for each; None if the tip may touch anywhere."""
    return [None if guard is None else TipCheck(own, guard) for own in kernels]


def out_of_walls(
    tip: TipCheck | None, inputs: LaneInputs, x: Float[np.ndarray, "n N"], among: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """True for each lane of `among` whose bare tip is out of the walls at x; all of them if it may touch anywhere."""
    good = np.array(among)
    if tip is not None and good.any():
        good[good] = ~tip.at(*jax.tree.map(lambda table: table[good], (inputs, x)))
    return good
