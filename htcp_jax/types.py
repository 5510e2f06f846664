"""Array types of the package, with named axes.

Axes: N joints, K bodies (capsules), P points, T targets, S scenarios, L lanes, M rows of a QP.
"""

import numpy as np
from jaxtyping import Array, Bool, Float, Int

Anywhere = Array | np.ndarray  # on the device or on the host
Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Pose = Float[Array, "4 4"]
Joints = Float[Array, "N"]
Triple = tuple[float, float, float]  # Python's own numbers, as in files and static fields

__all__ = ["Anywhere", "Array", "Bool", "Float", "Int", "Joints", "Pose", "Scalar", "Triple", "Vector3"]
