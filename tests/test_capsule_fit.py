"""Capsules hold every triangle of what they are fitted to, and little else; brute force and MuJoCo are the references."""

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import differential_evolution

from htcp_jax.scene.capsule_fit import Capsule, clip, cover, fit_capsule, hull_volume

SOLIDS = {
    "cube": trimesh.creation.box((1, 1, 1)),
    "slab": trimesh.creation.box((0.4, 0.3, 0.02)),
    "rod": trimesh.creation.cylinder(radius=0.05, height=0.8),
    "disc": trimesh.creation.cylinder(radius=0.1, height=0.01),
    "ball": trimesh.creation.icosphere(subdivisions=2, radius=0.07),
    "elbow": trimesh.util.concatenate(
        [trimesh.creation.box((0.6, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.5)).apply_translation((0.25, 0, 0.2))]
    ),
}


def triangles_of(solid: trimesh.Trimesh) -> np.ndarray:
    return np.asarray(solid.triangles, float)


def pieces(triangle: np.ndarray, capsules: list[Capsule], depth: int = 0) -> bool:
    """Whether a triangle lies in the capsules: whole in one of them, or all its quarters do, down to 0.1 mm of slack.

    A capsule is convex, so three corners inside are a triangle inside; it is shrunk by nothing and grown by nothing but
    where a quarter is so small that it cannot be told from its corners.
    """
    inside = np.array([capsule.depth(triangle) for capsule in capsules])
    if (inside >= 0).all(axis=1).any():
        return True
    if depth == 9:
        return bool((inside.max(axis=0) > -1e-12).all())
    if (inside < 0).all(axis=0).any():
        return False  # a corner outside of all
    a, b, c = triangle
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return all(pieces(np.array(part), capsules, depth + 1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)))
