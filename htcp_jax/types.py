"""Array types of the package, with named axes.

Axes: N joints, K bodies (capsules), P points, T targets, S scenarios, L lanes, M rows of a QP.
"""

from jaxtyping import Array, Bool, Float, Int

Scalar = Float[Array, ""]
Vector3 = Float[Array, "3"]
Pose = Float[Array, "4 4"]
Joints = Float[Array, "N"]

__all__ = ["Array", "Bool", "Float", "Int", "Joints", "Pose", "Scalar", "Vector3"]
