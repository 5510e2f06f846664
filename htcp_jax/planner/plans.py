"""What planning returns."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int8

from htcp_jax.status import Status


class Plans(NamedTuple):
    """The plans of S scenarios with T targets each, for a robot of N joints; numpy arrays on the host.

    Rows of targets that are not tracked hold NaN in `x`, `tcp`, `clearance`, `residual` and `joint_step`.
    """

    x: Float[np.ndarray, "S T N"]  # configurations [rad or m]
    tcp: Float[np.ndarray, "S T 3"]  # tool centre point, world [m]
    target: Float[np.ndarray, "S T M"]  # where the task's rows, the TCP's x, y, z, should be, world [m]; never NaN
    clearance: Float[np.ndarray, "S T"]  # D(x, O), smallest over capsules and points [m]
    residual: Float[np.ndarray, "S T"]  # of the task: |tcp - target| [m]
    status: Int8[np.ndarray, "S T"]  # htcp_jax.status.Status
    iterations: Int[np.ndarray, "S T"]  # step QPs solved for the target; 0 where one was pushed there
    joint_step: Float[np.ndarray, "S T"]  # |x_t - x_{t-1}|, the start being x_{-1} [rad]
    escape: Int[np.ndarray, "S T"]  # 0 none, k = stage k of the method's escapes, one more: planned backwards
    path_clear: Int8[np.ndarray, "S T"]  # joint path from the row before: 1 clear, 0 blocked, -1 unknown
    compile_s: float  # wall time spent compiling [s]
    run_s: float  # wall time spent planning, compilation apart [s]


def is_tracked(status: np.ndarray) -> np.ndarray:
    """Where `status` says tracked; any shape."""
    return (status >= 0) & (status <= Status.TRACKED_AFTER_ESCAPE)
