"""Parameterisation of a section by s, the variable of its time scaling.

If the tool follows the path, s is the TCP's arc length: the integral over u of sigma(u) = |J(q) q'|. u(s) is the cubic
spline through the inverse of s(u) on a grid. The curve over s is q(u(s)); its derivatives follow by the chain rule.
Otherwise s is the curve's own parameter u.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.model import Robot
from htcp_jax.trajectory.curve import Blend, Curve, Derivatives
from htcp_jax.trajectory.displacement import tcp_at

FINE, HALVINGS = 13, 8  # numbers of grid positions on a corner, and of halvings between two corners
CLOSE = 0.01  # share of a corner's step; closer positions are merged, as rounding would dominate the spline


class PathCurve(NamedTuple):
    """Curve of a section, parameterised by s."""

    curve: Curve
    place: Float[np.ndarray, "m"]  # grid of s: [m] if the tool follows the path, else time at full speed [s]
    at_corner: Float[np.ndarray, "k 2"]  # s at the begin and end of each corner
    spline: "scipy.interpolate.CubicSpline | None"  # u(s); None: s is u

    def u(self, place: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the curve's own parameter u at positions s."""
        return place if self.spline is None else np.clip(self.spline(place), 0.0, self.curve.u[-1])

    def at(self, place: Float[np.ndarray, "n"]) -> Derivatives:
        """Return the joint values and their derivatives with respect to s, at positions s."""
        found = self.curve.at(self.u(place))
        if self.spline is None:
            return found
        a, b, c = (self.spline(place, k)[:, None] for k in (1, 2, 3))
        _, first, second, third = found
        return Derivatives(
            found.x, first * a, second * a * a + first * b, third * a**3 + 3 * second * a * b + first * c
        )


def path_of_blend(robot: Robot, blend: Blend) -> PathCurve:
    """Return a section's curve, parameterised by s."""
    curve = blend.curve
    u = curve.grid(FINE, HALVINGS)
    ends = curve.u[:, None] + np.array([-1, 1]) * curve.blend_length[:, None]
    if not blend.on_process:
        return PathCurve(curve, u, ends, None)
    u = _without_coinciding(curve, u)
    here = curve.at(u)
    rate = np.linalg.norm(np.einsum("nij,nj->ni", tcp_at(robot, here.x)[1], here.first), axis=1)
    length = scipy.interpolate.CubicSpline(u, rate).antiderivative()
    place = length(u)
    return PathCurve(curve, place, length(ends), scipy.interpolate.CubicSpline(place, u))


def _without_coinciding(curve: Curve, u: Float[np.ndarray, "m"]) -> Float[np.ndarray, "k"]:
    """Return the positions without those that nearly coincide with the previous one, as between touching corners."""
    leg = curve.leg(u)
    corner = leg + (2 * (u - curve.u[leg]) > np.diff(curve.u)[leg])
    return u[np.diff(u, prepend=-np.inf) > CLOSE * 2 / (FINE - 1) * curve.blend_length[corner]]
