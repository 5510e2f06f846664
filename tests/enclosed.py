"""Enclosure check of triangles in capsules, independent of the capsule fit."""

import numpy as np

from htcp_jax.io.robots.capsule_fit import Capsule

FINEST = 10  # halvings of a triangle's sides


def from_axis(points: np.ndarray, capsule: Capsule) -> np.ndarray:
    """Distances of points (..., 3) from a capsule's axis, by the projection onto its line."""
    ahead = capsule.q - capsule.p
    share = np.clip((points - capsule.p) @ ahead / max(ahead @ ahead, 1e-300), 0, 1)
    return np.linalg.norm(points - capsule.p - share[..., None] * ahead, axis=-1)


def are_enclosed(triangles: np.ndarray, capsules: list[Capsule]) -> bool:
    """True if every triangle (F, 3, 3) lies in the union of the capsules.

    A capsule is convex: it encloses a triangle if it encloses the corners. A triangle that no single capsule encloses
    is split into four, recursively, until one capsule encloses each part; a corner outside all capsules gives False.
    Parts that remain, where two capsules just meet, are 1/1024 of the triangle's size and have their corners inside.
    """
    for _ in range(FINEST):
        inside = np.stack([from_axis(triangles, capsule) <= capsule.radius for capsule in capsules])
        if not inside.any(axis=0).all():
            return False
        a, b, c = triangles[~inside.all(axis=2).any(axis=0)].swapaxes(0, 1)
        if not len(a):
            return True
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return True
