"""Which orientations the tool can have with its tip on a target: a cover of cells, whatever does not collide for sure.

Unit quaternions, q and -q the same, are the four faces of a cube in four dimensions, seen from its middle: on each one
component is 1, and the others are between -1 and 1. A face is cut into cubes, and these are halved. Seen from the
middle nothing gets longer, so a cube of half side h covers rotations within 2 sqrt(3) h of its middle's.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance.exclusion import tool_collides
from htcp_jax.clearance.scene import Scene, own_scene
from htcp_jax.planner.kernel import Kernel, Load, Table
from htcp_jax.planner.lane_inputs import LaneInputs
from htcp_jax.planner.lanes import gather
from htcp_jax.planner.programs import Kernels
from htcp_jax.settings import Settings

MANY = Load(cpu=Table(1024, 1), gpu=Table(4096, 4096))  # of what is asked by the thousand
HOPELESS = 20_000  # cells at a target, beyond which no proof is near
CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)


class ToolCells(NamedTuple):
    """Orientations of the tool at targets, as cells about unit quaternions."""

    lane: Int[np.ndarray, "n"]  # which target
    quaternion: Float[np.ndarray, "n 4"]  # w, x, y, z
    radius_rad: Float[np.ndarray, "lanes"]  # of each target's cells


def tool(settings: Settings, scene: Scene, lane: LaneInputs, quaternion, rho):
    """Whether the tool collides in all of a cell."""
    scene = own_scene(scene, lane.tool_extension_m)
    return tool_collides(scene, lane, lane.margin_m, lane.target, quaternion, rho)


TOOL = Kernel("tool", tool, MANY)


def tool_cells(kernels: Kernels, inputs: LaneInputs, resolution_rad: float, most: int) -> ToolCells:
    """The cells in which the tool may be clear, for many targets: halved until they are as small as the resolution; of
    a target that has more than `most` of these, the larger ones. A target without any has no posture at all."""
    lanes = len(inputs.row)
    kept, radius, half = [np.empty((0, 4))] * lanes, np.full(lanes, np.inf), 1.0
    lane, one = np.repeat(np.arange(lanes), 4), np.tile(np.arange(4), lanes)
    cube = np.zeros((len(lane), 3))
    while len(lane):
        q, rho = _quaternions(one, cube), 2 * np.sqrt(3) * half
        keep = ~kernels(TOOL, gather(inputs, lane), q, np.full(len(q), rho))
        counts = np.bincount(lane[keep], minlength=lanes)
        for k in np.unique(lane[counts[lane] <= most]):
            kept[k], radius[k] = q[keep & (lane == k)], rho
        keep &= (rho > resolution_rad) & (counts[lane] <= HOPELESS)
        lane, one, half = np.repeat(lane[keep], 8), np.repeat(one[keep], 8), half / 2
        cube = (cube[keep][:, None] + half * CORNERS[None]).reshape(-1, 3)
    return ToolCells(np.repeat(np.arange(lanes), [len(own) for own in kept]), np.concatenate(kept), radius)


def _quaternions(one: np.ndarray, cube: np.ndarray) -> np.ndarray:
    """The middles of cubes on the faces whose component `one` is 1, as unit quaternions."""
    q = np.ones((len(one), 4))
    others = np.array([[k for k in range(4) if k != face] for face in range(4)])[one]
    np.put_along_axis(q, others, cube, axis=1)
    return q / np.linalg.norm(q, axis=1)[:, None]
