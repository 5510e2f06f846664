"""No proof of a joint motion in random worlds is refuted; `python tests/random_worlds.py` checks 2,000 worlds."""

import made_once
import numpy as np
import toy
from random_worlds import _to_box, _to_triangles, axes, check, checked

RNG = np.random.default_rng(0)


def test_no_proof_in_fifty_worlds_is_refuted_and_enough_motions_are_proven_refuted_and_grazing():
    found = check(range(50))
    assert found.wrong == [], found.counts


def test_proofs_that_allow_a_penetration_of_2_mm_are_refuted():
    assert any("proven, but the distance is" in line for seed in range(20) for line in checked(seed, 2e-3).wrong)


def test_the_axes_are_those_of_the_arm():
    x = RNG.uniform(-3, 3, (20, 4))
    for found, expected in zip(axes(x), made_once.ENDS(toy.robot(), x)[:2], strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-14)


def test_the_distances_of_triangles_and_boxes_are_those_of_dense_points():
    p, q = RNG.normal(size=(2, 40, 3))
    share = np.linspace(0, 1, 101)[:, None]
    places = p[:, None] + share * (q - p)[:, None]
    corners = RNG.normal(size=(3, 3))
    inside = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
    inside = inside[inside.sum(1) <= 1]
    triangle = corners[0] + inside @ (corners[1:] - corners[0])
    half = np.array([0.4, 1e-3, 0.7])
    in_box = np.clip(places, -half, half)
    sampled = np.linalg.norm(places[:, :, None] - triangle, axis=-1).min((1, 2))
    for found, dense in (
        (_to_triangles(p, q, corners[None]), sampled),
        (_to_box(p, q, (np.eye(3), np.zeros(3), half)), np.linalg.norm(places - in_box, axis=-1).min(1)),
    ):
        assert (found <= dense + 1e-10).all() and (found >= dense - 0.06).all()
