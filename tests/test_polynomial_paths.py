"""Bounds and proofs on polynomial joint paths with a tolerance of each joint."""

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from test_coupling import followers, within

from htcp_jax.clearance.proof.joint_path import PolynomialPath
from htcp_jax.clearance.proof.motion_bound import body_sweep, tcp_sweep
from htcp_jax.model import kinematics

C = 6


def random_path(rng: np.random.Generator, degree: int, joints: int) -> np.ndarray:
    """Coefficients of a polynomial whose value and derivatives are about 1 (C, N)."""
    c = rng.normal(size=(C, joints)) / (1 + np.arange(C))[:, None]
    c[degree + 1 :] = 0
    return c


@pytest.mark.parametrize("arm", ["gp50", "followers"])
def test_bodies_near_a_polynomial_move_no_further_than_the_bounds_at_1000_configurations(arm):
    """Half of the configurations have every joint at the limit of its tolerance."""
    robot = made_once.robot() if arm == "gp50" else followers()[0]
    n = len(robot.lower)

    def bounds(c, off, place, half):
        x, sweep = PolynomialPath(c, off).about(place, half)
        return x, sweep, body_sweep(robot, x, sweep), tcp_sweep(robot, x, sweep)

    def ends(x):
        return jnp.stack(kinematics.capsule_segments(robot, x)), kinematics.tcp_position(robot, x)

    bounded, frames = made_once.quick_jit(bounds), made_once.quick_jit(jax.vmap(ends))
    rng, tightest = np.random.default_rng(5), 0.0
    for number in range(24):
        degree, half, wide = rng.integers(1, C), rng.choice([1e-3, 0.02, 0.2]), rng.choice([0.0, 1e-3, 0.05])
        c, place = random_path(rng, degree, n), rng.uniform(half, 1 - half)
        c[0] = within(robot, 1, number)[0] if arm == "followers" else c[0]
        off = np.full(n, wide)
        x, sweep, moves, tcp = bounded(c, off, place, half)
        s = np.linspace(-half, half, 1000)
        path = np.polynomial.polynomial.polyval(place + s, c).T
        assert (np.abs(path - np.asarray(x)) <= half * np.asarray(sweep.speeds) + 1e-12).all()
        signs = rng.choice([-1.0, 1.0], path.shape) * np.where(rng.random(path.shape) < 0.5, 1, rng.random(path.shape))
        there, at = frames(path + signs * off)
        middle, tcp_middle = (each[0] for each in frames(np.asarray(x)[None]))
        moved = np.linalg.norm(np.asarray(there) - np.asarray(middle), axis=-1).max(axis=(0, 1))
        assert (moved <= np.asarray(moves.travel) + 1e-12).all()
        linear = np.stack([moves.p, moves.q]) * (s / half)[:, None, None, None]
        bent = np.linalg.norm(np.asarray(there) - np.asarray(middle) - linear, axis=-1).max(axis=(0, 1))
        assert (bent <= np.asarray(moves.bend) + 1e-12).all()
        off_line = np.asarray(at) - np.asarray(tcp_middle) - s[:, None] * np.asarray(tcp.velocity)
        assert (np.linalg.norm(off_line, axis=1) <= 0.5 * s**2 * float(tcp.bend) + float(tcp.off) + 1e-12).all()
        tightest = max(tightest, float((moved / np.maximum(moves.travel, 1e-9)).max()))
    assert tightest > 0.9
