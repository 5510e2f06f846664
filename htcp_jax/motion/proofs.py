"""Proofs of straight joint paths by one kernel: motions between targets, and free paths.

The conditions on a path are data, so that one executable serves all callers.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.obstacles.scene import Scene, own_scene
from htcp_jax.clearance.proof.bisection import Proof, begun, of_proven
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.clearance.proof.motion_proof import DEEPEST, Tube, look_on
from htcp_jax.device.batching import Loop
from htcp_jax.device.kernel import TRACKED, Kernel
from htcp_jax.device.programs import Kernels
from htcp_jax.device.stretches import by_stretches
from htcp_jax.device.tables import gather
from htcp_jax.model.task import TCP_POSITION, Task
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.settings import Settings
from htcp_jax.status import Way

Postures = Float[np.ndarray, "n N"]


class Closely(NamedTuple):
    """Resolution of a proof, see `prove`."""

    kept: Float[jax.Array, ""]
    resolution_m: Float[jax.Array, ""]  # [m]
    deepest: Int[jax.Array, ""]


def prove_way(settings: Settings, scene: Scene, lane: LaneInputs, a, b, tube: Tube, closely: Closely) -> Loop:
    """Prove or refute that the straight joint path from a to b is a motion. The loop's result is a `Proof`, see
    `of_proven`."""
    own = own_scene(scene, lane.tool_extension_m)
    look = look_on(own, lane, a, b, tube, closely.resolution_m, closely.deepest, closely.kept)
    return Loop(jax.tree.map(jnp.asarray, begun()), lambda far: far.going, look, lambda far: of_proven(far.proof))


PROVE = Kernel("prove", prove_way, TRACKED, refill=by_stretches)


def proofs_of(
    kernels: Kernels,
    inputs: LaneInputs,
    a: Postures,
    b: Postures,
    tube: Tube,
    kept: float | Float[np.ndarray, "n"] = 0.0,
    resolution_m: float | Float[np.ndarray, "n"] = -ROUNDING_M,
    deepest: int | Int[np.ndarray, "n"] = DEEPEST,
    lane: Int[np.ndarray, "n"] | None = None,
) -> Proof:
    """Return proofs of straight joint paths from a to b [rad or m], one per lane; with `lane`, several per lane."""
    if lane is not None:
        inputs, tube = gather((inputs, tube), lane)
    return kernels(*prove_call(inputs, a, b, tube, kept, resolution_m, deepest))


def prove_call(inputs: LaneInputs, a, b, tube: Tube, kept=0.0, resolution_m=-ROUNDING_M, deepest=DEEPEST) -> tuple:
    """Return the kernel and its tables for these arguments, see `Kernels.preparing`."""
    closely = Closely(*(np.broadcast_to(value, len(a)) for value in (kept, resolution_m, np.asarray(deepest, int))))
    return PROVE, inputs, a, b, tube, closely


def clear_paths(
    kernels: Kernels,
    inputs: LaneInputs,
    a: Postures,
    b: Postures,
    resolution_m: float | Float[np.ndarray, "n"] = -ROUNDING_M,
    deepest: int | Int[np.ndarray, "n"] = DEEPEST,
) -> Bool[np.ndarray, "n"]:
    """True for each straight joint path that is proven clear, wherever the TCP moves on it."""
    tube = free_tubes(kernels.task, inputs)
    return proofs_of(kernels, inputs, a, b, tube, 0.0, resolution_m, deepest).verdict == Way.PROVEN


def free_tubes(task: Task, inputs: LaneInputs) -> Tube:
    """Return tubes without conditions on the TCP or the task."""
    count = len(inputs.row)
    rows = ()
    if task.parts != TCP_POSITION.parts:
        rows = np.stack([inputs.target, inputs.target], axis=1), np.zeros(count, bool)
    return Tube(np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, np.inf), *rows)
