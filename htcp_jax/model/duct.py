"""The workpiece that ships with the package: a generated duct from a round inlet to a flat outlet, and its weld.

A section in the y-z plane is a closed curve. Each of its halves (above and below the height zc) is half a
superellipse |y/a|^n + |(z - zc)/b|^n = 1 with its own b and n; the halves meet at (+-a, zc). Monotone cubics
interpolate the six parameters along x through the stations below, without overshoot.
Both ends are open, as in the measured duct that the parameters were fitted to.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.caching import cached_by_values

# x, a, zc, b above, b below, n above, n below; lengths in m
# fmt: off
STATIONS = np.array([
    [0.00, 0.1740, 0.1890, 0.1740, 0.1740, 2.00, 2.00],
    [0.18, 0.1740, 0.1890, 0.1740, 0.1740, 2.00, 2.00],
    [0.22, 0.1777, 0.1922, 0.1715, 0.1800, 2.00, 2.06],
    [0.30, 0.1799, 0.2015, 0.1494, 0.1906, 1.89, 2.31],
    [0.40, 0.1818, 0.2061, 0.1156, 0.1984, 1.72, 2.66],
    [0.50, 0.1830, 0.1979, 0.0867, 0.1920, 1.68, 3.01],
    [0.60, 0.1831, 0.1862, 0.0641, 0.1756, 1.75, 3.51],
    [0.70, 0.1825, 0.1786, 0.0480, 0.1552, 2.06, 4.27],
    [0.80, 0.1815, 0.1719, 0.0500, 0.1273, 3.42, 5.68],
    [0.88, 0.1810, 0.1700, 0.0600, 0.0980, 4.00, 6.00],
    [0.96, 0.1780, 0.1900, 0.0700, 0.0800, 5.00, 6.00],
])

WELD_KNOTS = np.array([
    [0.1857, -0.1737, 0.1708], [0.2532, -0.1743, 0.1670], [0.3557, -0.1753, 0.1513],
    [0.4508, -0.1758, 0.1334], [0.5352, -0.1759, 0.1200], [0.6152, -0.1757, 0.1123],
    [0.7053, -0.1753, 0.1106], [0.7865, -0.1751, 0.1171], [0.8457, -0.1752, 0.1292],
    [0.8940, -0.1755, 0.1468], [0.9431, -0.1756, 0.1745],
])
# fmt: on

POINTS = 50_015  # number of points in the paper's cloud
WELD_POINTS = 94
INLET = (0.0, 0.0, 0.19138)  # centre of the inlet, the via point of the approach [m]


@cache
def _sections() -> Any:
    import scipy  # here, so that reading a job does not load it

    return scipy.interpolate.PchipInterpolator(STATIONS[:, 0], STATIONS[:, 1:], extrapolate=False)


class DuctSection(NamedTuple):
    """Parameters of the duct's sections at P positions along x; lengths in m. NaN outside the duct's length."""

    a: Float[np.ndarray, "P"]
    zc: Float[np.ndarray, "P"]
    b_above: Float[np.ndarray, "P"]
    b_below: Float[np.ndarray, "P"]
    n_above: Float[np.ndarray, "P"]
    n_below: Float[np.ndarray, "P"]

    def half(self, above) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
        """Return b and n of the half that each of P points lies in.

        Args:
            above (Array): True for the upper half (P,).
        """
        return np.where(above, self.b_above, self.b_below), np.where(above, self.n_above, self.n_below)


def section(x: Float[np.ndarray, "P"]) -> DuctSection:
    """Return the duct's sections at `x` [m]."""
    return DuctSection(*np.moveaxis(_sections()(x), -1, 0))


def surface(x: Float[np.ndarray, "P"], angle: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P 3"]:
    """Return the points of the duct's surface [m] at positions `x` [m] and polar angles `angle` [rad].

    The angle is measured in the section scaled to half axes of 1. Equal steps of this angle space points evenly, also
    where n = 6; the usual superellipse angle leaves gaps there.
    """
    at = section(x)
    b, n = at.half(np.sin(angle) >= 0.0)
    radius = (np.abs(np.cos(angle)) ** n + np.abs(np.sin(angle)) ** n) ** (-1.0 / n)
    return np.stack([x, at.a * radius * np.cos(angle), at.zc + b * radius * np.sin(angle)], axis=-1)


@cached_by_values(2)
def duct_cloud(points: int = POINTS, seed: int = 0) -> Float[np.ndarray, "{points} 3"]:
    """Return `points` random points [m], uniform by area on the duct's surface; the same bytes for the same seed.

    Each point is drawn in two steps: a cell of a fine grid, with a probability proportional to its area, then a uniform
    position in the cell. Cells of 2 mm are nearly flat, so the points are uniform on the surface.
    """
    rows, columns = 480, 720
    x = np.linspace(STATIONS[0, 0], STATIONS[-1, 0], rows + 1)
    angle = np.linspace(-np.pi, np.pi, columns + 1)
    grid = np.meshgrid(x, angle, indexing="ij")
    corner = surface(grid[0].ravel(), grid[1].ravel()).reshape(rows + 1, columns + 1, 3)
    diagonal = corner[1:, 1:] - corner[:-1, :-1]
    other_diagonal = corner[1:, :-1] - corner[:-1, 1:]
    area = np.cumsum(np.linalg.norm(np.cross(diagonal, other_diagonal), axis=-1))

    rng = np.random.Generator(np.random.PCG64(seed))
    row, column = np.divmod(np.searchsorted(area, rng.random(points) * area[-1], side="right"), columns)
    u, v = rng.random((2, points))
    return surface(x[row] + u * (x[1] - x[0]), angle[column] + v * (angle[1] - angle[0]))


@cached_by_values(2)
def weld(points: int = WELD_POINTS) -> Float[np.ndarray, "{points} 3"]:
    """Return the weld on the duct's wall as `points` points [m], from the inlet inwards.

    The points are equally spaced by arc length along the cubic spline through WELD_KNOTS.
    """
    import scipy

    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(WELD_KNOTS, axis=0), axis=1)))
    return equal_steps(scipy.interpolate.CubicSpline(chord, WELD_KNOTS), chord[-1], points)


def equal_steps(
    curve: Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]], end: float, points: int, closed: bool = False
) -> Float[np.ndarray, "{points} 3"]:
    """Return points on a curve, equally spaced by arc length.

    Args:
        curve: Function from parameters (n,) to points (n, 3).
        end: Last parameter; the first is 0.
        points: Number of points.
        closed: True for a closed loop: the last point is then one step before the first.
    """
    fine = np.linspace(0.0, end, 20_001)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(curve(fine), axis=0), axis=1)))
    return curve(np.interp(np.linspace(0.0, length[-1], points, endpoint=not closed), length, fine))
