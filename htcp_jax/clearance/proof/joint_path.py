"""Joint paths that can be proven: straight ones, and polynomials with a tolerance of each joint.

On an interval of half-width h about m, derivatives of a polynomial x(s) of degree n are bounded by Taylor's theorem,

    |x'(s)| <= sum_{k=1}^{n} |x^(k)(m)| h^(k-1) / (k-1)!        |x''(s)| <= sum_{k=2}^{n} |x^(k)(m)| h^(k-2) / (k-2)!

These bounds are exact in the limit, and no sample is taken.
"""

from math import factorial
from typing import NamedTuple

import jax.numpy as jnp

from htcp_jax.clearance.proof.motion_bound import JointSweep
from htcp_jax.types import Anywhere, Float, Joints, Scalar

COEFFICIENTS = 6  # of a polynomial of the fifth degree, as controllers use at most


class StraightPath(NamedTuple):
    """The straight joint path from a to b [rad or m]."""

    a: Joints
    b: Joints

    def about(self, place: Scalar, half: Scalar) -> tuple[Joints, JointSweep]:
        """Return x at a place, and the motion of the joints on the interval of half-width `half` about it."""
        return self.a + place * (self.b - self.a), JointSweep(self.b - self.a, half)


class PolynomialPath(NamedTuple):
    """All joint paths near a polynomial: x(s) = sum_k c_k s^k, and each joint within `off` of it."""

    coefficients: Float[Anywhere, "*n C N"]  # c_0, c_1, ... [rad or m]
    off: Joints  # largest distance of each joint from the polynomial [rad or m]

    def about(self, place: Scalar, half: Scalar) -> tuple[Joints, JointSweep]:
        """Return x at a place, and the motion of the joints on the interval of half-width `half` about it."""
        derivatives = self._derivatives(place)
        speeds, bends = (
            sum(jnp.abs(own) * half**k / factorial(k) for k, own in enumerate(derivatives[first:])) for first in (1, 2)
        )
        return derivatives[0], JointSweep(derivatives[1], half, speeds, bends, self.off)

    def _derivatives(self, place: Scalar) -> list[Joints]:
        """Return x and all its derivatives with respect to s, by Horner's scheme; at least three rows."""
        c = list(self.coefficients) + [jnp.zeros_like(self.coefficients[0])] * max(0, 3 - len(self.coefficients))
        found = []
        while c:
            value = c[-1]
            for own in reversed(c[:-1]):
                value = value * place + own
            found.append(value)
            c = [k * own for k, own in enumerate(c)][1:]
        return found


JointPath = StraightPath | PolynomialPath
