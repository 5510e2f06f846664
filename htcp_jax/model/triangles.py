"""Triangles of a mesh: their areas, and division at the middle of the longest edge."""

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError

MOST = 3_000_000  # points
KEY = "workpiece.mesh_spacing_m"

Triangles = Float[np.ndarray, "F 3 3"]
Corners = Float[np.ndarray, "3 3 F"]  # triangles by corner and coordinate, as numpy is fastest along the last axis


def pieces(triangles: Triangles, edge_m: float, source: str) -> Float[np.ndarray, "G 3 3"]:
    """Cut the triangles until no edge is longer than `edge_m`.

    Raises:
        InputError: For more than 2 MOST pieces.
    """
    left = np.ascontiguousarray(np.moveaxis(triangles, 0, 2))
    done, count = [], 0
    while left.shape[2]:
        left = longest_edge_first(left)
        coarse = square_norm(left[1] - left[0]) > edge_m**2
        done.append(left[:, :, ~coarse])
        count += done[-1].shape[2]
        left, _ = halved_triangles(left[:, :, coarse])
        check_count((count + left.shape[2]) / 2, f"a spacing of {edge_m:.3g} m", source)
    return np.ascontiguousarray(np.moveaxis(np.concatenate(done, axis=2), 2, 0))


def area(triangles: Triangles) -> Float[np.ndarray, "F"]:
    """Return the area of each triangle [m2]."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def halved_triangles(corners: Corners) -> tuple[Float[np.ndarray, "3 3 2*F"], Float[np.ndarray, "3 F"]]:
    """Cut each triangle in two at the middle of its first edge, the longest; return the halves and the middles.

    Two triangles that share such an edge get the same middle, bit for bit.
    """
    b, c, a = corners
    middle = (b + c) / 2
    return np.concatenate([np.stack([a, b, middle]), np.stack([c, a, middle])], axis=2), middle


def longest_edge_first(corners: Corners) -> Corners:
    """Reorder each triangle's corners cyclically so that its longest edge comes first."""
    a, b, c = corners
    ab, bc, ca = square_norm(b - a), square_norm(c - b), square_norm(a - c)
    from_b, from_c = (bc > ab) & (bc >= ca), (ca > ab) & (ca > bc)
    turned = corners.copy()
    turned[:, :, from_b] = corners[[1, 2, 0]][:, :, from_b]
    turned[:, :, from_c] = corners[[2, 0, 1]][:, :, from_c]
    return turned


def components_dot(u: Float[np.ndarray, "3 F"], v: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    """Return the scalar product of each pair of vectors [m2]."""
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def square_norm(u: Float[np.ndarray, "3 F"]) -> Float[np.ndarray, "F"]:
    """Return the squared length of each vector [m2]."""
    return components_dot(u, u)


def check_count(points: float, spacing: str, source: str) -> None:
    """Raise an InputError for more than MOST points."""
    if points > MOST:
        raise InputError(f"{source}: more than {MOST:,} points at {spacing}; increase {KEY}")
