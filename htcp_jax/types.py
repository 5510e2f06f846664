"""Array types for annotations, with named axes.

Axes: N joints, K bodies (capsules), P points, T targets, S scenarios, L lanes (rows of a batch), M rows of a QP.
"""

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    from jax import Array
else:

    class _OfJax(type):
        def __instancecheck__(cls, value: Any) -> bool:
            return "jax" in sys.modules and isinstance(value, sys.modules["jax"].Array)

    class Array(metaclass=_OfJax):
        """Stand-in for `jax.Array` in instance checks, so that jobs can be read without importing JAX."""


Anywhere = Array | np.ndarray  # an array on the device or on the host
Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Pose = Float[Array, "4 4"]
Joints = Float[Array, "N"]
Triple = tuple[float, float, float]  # Python floats, as in files and static fields

__all__ = ["Anywhere", "Array", "Bool", "Float", "Int", "Joints", "Pose", "Scalar", "Triple", "Vector3"]
