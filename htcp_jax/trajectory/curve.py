"""Joint polyline with blended corners: a curve with three continuous derivatives.

Over a length u with the via points x_k at u_k and the slopes t_k between them, the curve is the polyline, except within
d_k of a corner, where with Delta = t_k - t_{k-1} and w = (u - u_k) / d_k

    q = x_k + t_{k-1} (u - u_k) + d_k Delta F(w),    F'' = 15/16 (1 - w^2)^2,    F(-1) = F'(-1) = 0,

so that F(1) = F'(1) = 1. The curve deviates from the polyline along Delta, by at most F(0) d_k Delta = 5/32 d_k Delta,
at the corner. It stays within the triangle that the corner spans: if the via points satisfy the joint limits, the curve
does, too.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

FARTHEST = 5 / 32  # F(0): distance of a blended corner from its via point, in d Delta


class Derivatives(NamedTuple):
    """A curve and its derivatives at n positions."""

    x: Float[np.ndarray, "n N"]
    first: Float[np.ndarray, "n N"]
    second: Float[np.ndarray, "n N"]
    third: Float[np.ndarray, "n N"]


class Curve(NamedTuple):
    """A blended polyline through k via points of N joints."""

    u: Float[np.ndarray, "k"]  # positions of the via points, increasing
    x: Float[np.ndarray, "k N"]  # via points [rad or m]
    # blend lengths d, in units of u: at most half of the adjacent legs; 0 at both ends
    blend_length: Float[np.ndarray, "k"]

    @property
    def slopes(self) -> Float[np.ndarray, "k1 N"]:
        """Derivatives dx / du on the polyline's k - 1 legs."""
        return np.diff(self.x, axis=0) / np.diff(self.u)[:, None]

    @property
    def turns(self) -> Float[np.ndarray, "k N"]:
        """Changes of slope Delta at the via points; 0 at both ends."""
        return np.pad(np.diff(self.slopes, axis=0), ((1, 1), (0, 0)))

    def leg(self, u: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Return the index of the leg at each position."""
        return np.clip(np.searchsorted(self.u, u, side="right") - 1, 0, len(self.u) - 2)

    def at(self, u: Float[np.ndarray, "n"]) -> Derivatives:
        """Return the curve and its derivatives with respect to u, at n positions u."""
        leg, slopes = self.leg(u), self.slopes
        ahead, slope = u - self.u[leg], slopes[leg]
        corner = leg + (2 * ahead > np.diff(self.u)[leg])
        blend_length = self.blend_length[corner]
        w = np.divide(u - self.u[corner], blend_length, out=np.full_like(u, 2.0), where=blend_length > 0)
        x, first = self.x[leg] + ahead[:, None] * slope, slope
        second, third = np.zeros_like(x), np.zeros_like(x)
        near = np.flatnonzero(np.abs(w) < 1)
        turn, after = self.turns[corner[near]], (corner == leg)[near, None]
        w, blend_length = w[near, None], blend_length[near, None]
        square, bump = w * w, 1 - w * w
        slope = 0.5 + 15 / 16 * w * (1 - square * (2 / 3 - square / 5))
        rise = 5 / 32 + w / 2 + 15 / 16 * square * (0.5 - square * (1 / 6 - square / 30))
        x[near] += turn * blend_length * (rise - after * w)
        first[near] += turn * (slope - after)
        second[near] = turn * (15 / 16 * bump * bump / blend_length)
        third[near] = turn * (-15 / 4 * w * bump / blend_length**2)
        return Derivatives(x, first, second, third)

    def grid(self, on_corner: int, on_leg: int) -> Float[np.ndarray, "m"]:
        """Return positions along the curve, both ends included.

        Args:
            on_corner: Number of positions on each corner.
            on_leg: Number of positions from the middle of a leg towards each corner, each at half the distance.
        """
        near = 0.5 ** np.arange(1, on_leg + 1)
        shares = np.concatenate([[0.0], near[::-1], 1 - near[1:], [1.0]])
        before, after = self.u[:-1] + self.blend_length[:-1], self.u[1:] - self.blend_length[1:]
        legs = before[:, None] + shares * (after - before)[:, None]
        corners = self.u[:, None] + np.linspace(-1, 1, on_corner) * self.blend_length[:, None]
        places = np.unique(np.concatenate([legs.ravel(), corners.ravel()]))
        return places[np.diff(places, prepend=-np.inf) > 1e-9 * self.u[-1]]


class Blend(NamedTuple):
    """A section of the motion: a curve from stop to stop."""

    curve: Curve  # over the TCP's path length [m] if the tool follows the path; else over the time at full speed [s]
    row: Int[np.ndarray, "m"]  # row of the motion to which each leg leads
    on_process: bool  # True if the tool follows the path
