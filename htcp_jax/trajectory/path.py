"""Parameterisation of a section by s, the variable of its time scaling: the TCP's arc length if the tool feeds.

With sigma(u) = |J(q) q'| the arc length is the integral of sigma over u, and u(s) is the cubic spline through its
inverse on a grid. The curve over s and its derivatives are those of q(u(s)), by the chain rule.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from htcp_jax.model import Robot
from htcp_jax.trajectory.curve import Blend, Curve, Derivatives
from htcp_jax.trajectory.displacement import tcp_at

FINE, HALVINGS = 13, 8  # positions on a corner, and halvings between two corners
CLOSE = 0.01  # of the step between positions on a corner: closer ones are merged, else rounding dominates the splines


class PathCurve(NamedTuple):
    """A curve over s."""

    curve: Curve
    place: Float[np.ndarray, "m"]  # the grid over s: [m] if the tool feeds, else time at full speed [s]
    at_corner: Float[np.ndarray, "k 2"]  # s at begin and end of corners
    spline: CubicSpline | None  # u(s); None: s is u

    def u(self, place: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Return the curve's own parameter u at positions s."""
        return place if self.spline is None else np.clip(self.spline(place), 0.0, self.curve.u[-1])

    def at(self, place: Float[np.ndarray, "n"]) -> Derivatives:
        """Evaluate the joints and their derivatives by s."""
        found = self.curve.at(self.u(place))
        if self.spline is None:
            return found
        a, b, c = (self.spline(place, k)[:, None] for k in (1, 2, 3))
        _, first, second, third = found
        return Derivatives(
            found.x, first * a, second * a * a + first * b, third * a**3 + 3 * second * a * b + first * c
        )


def path_of_blend(robot: Robot, blend: Blend) -> PathCurve:
    """Parameterise a section by s."""
    curve = blend.curve
    u = curve.grid(FINE, HALVINGS)
    ends = curve.u[:, None] + np.array([-1, 1]) * curve.blend_length[:, None]
    if not blend.on_process:
        return PathCurve(curve, u, ends, None)
    u = _without_coinciding(curve, u)
    here = curve.at(u)
    rate = np.linalg.norm(np.einsum("nij,nj->ni", tcp_at(robot, here.x)[1], here.first), axis=1)
    length = CubicSpline(u, rate).antiderivative()
    place = length(u)
    return PathCurve(curve, place, length(ends), CubicSpline(place, u))


def _without_coinciding(curve: Curve, u: Float[np.ndarray, "m"]) -> Float[np.ndarray, "k"]:
    """Remove positions that nearly coincide with the one before, as where two corners almost touch."""
    leg = curve.leg(u)
    corner = leg + (2 * (u - curve.u[leg]) > np.diff(curve.u)[leg])
    return u[np.diff(u, prepend=-np.inf) > CLOSE * 2 / (FINE - 1) * curve.blend_length[corner]]
