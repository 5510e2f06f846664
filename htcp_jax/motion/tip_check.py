"""Whether the tool's bare tip passes through a wall, at a posture and along a joint path, for many lanes at once.

The tip is no body: it has to come near the wall, and what it may touch there is the job's to say (`tip_guard`).
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

PLACES = 100  # of a joint path at which its tip is looked at


def tip(settings: Settings, scene: Scene, lane: LaneInputs, x):
    """The tool's bare tip at x in the workpiece's frame, from the last body to the TCP."""
    return in_workpiece(lane, tip_segment(own_scene(scene, lane.tool_extension_m).robot, x))


TIP = Kernel("tip", tip, STEP)


class TipCheck(NamedTuple):
    """The kernels that say where the tip is, and the walls that it must not pass through."""

    kernels: Kernels
    guard: TipGuard

    def at(self, inputs: LaneInputs, x: Float[np.ndarray, "n N"]) -> Bool[np.ndarray, "n"]:
        """Whether the tip passes through a wall at each lane's configuration."""
        tip = self.kernels(TIP, inputs, x)
        return self.guard.passes(tip[:, 0], tip[:, 1])

    def along(
        self, inputs: LaneInputs, a: Float[np.ndarray, "n N"], b: Float[np.ndarray, "n N"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether it does anywhere between each lane's a and b, as far as PLACES tell."""
        fraction = (np.arange(1, PLACES) / PLACES)[None, :, None]
        x = a[:, None] + fraction * (b - a)[:, None]
        row = np.repeat(np.arange(len(a)), PLACES - 1)
        through = self.at(jax.tree.map(lambda table: table[row], inputs), x.reshape(len(row), -1))
        return through.reshape(len(a), -1).any(axis=1)


def tip_checks(kernels: Sequence[Kernels], guard: TipGuard | None) -> list[TipCheck | None]:
    """One for each; None where the tip may touch anywhere."""
    return [None if guard is None else TipCheck(own, guard) for own in kernels]


def out_of_walls(
    tip: TipCheck | None, inputs: LaneInputs, x: Float[np.ndarray, "n N"], among: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Which of some lanes, `among`, keep the tool's bare tip out of the walls at x; all of them where it may touch."""
    good = np.array(among)
    if tip is not None and good.any():
        good[good] = ~tip.at(*jax.tree.map(lambda table: table[good], (inputs, x)))
    return good
