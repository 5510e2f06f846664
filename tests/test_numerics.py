"""Numerical primitives: finite gradients everywhere, exact distances and solutions, reproducible random keys."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from htcp_jax.numerics import fold_keys, one_by_one, safe_divide, safe_norm, segment_parameter, solve_spd

RNG = np.random.default_rng(0)


def both_gradients(function, *arguments):
    """Forward and reverse gradient with respect to all arguments, flattened."""
    numbers = tuple(range(len(arguments)))
    forward, reverse = jax.jacfwd(function, numbers)(*arguments), jax.jacrev(function, numbers)(*arguments)
    return [np.concatenate([np.ravel(g) for g in jax.tree.leaves(tree)]) for tree in (forward, reverse)]


def test_a_quotient_is_zero_where_the_divisor_is_and_its_gradient_stays_finite():
    a, b = jnp.array([3.0, -2.0, 0.0, 5.0]), jnp.array([2.0, 4.0, 0.0, 0.0])
    np.testing.assert_array_equal(safe_divide(a, b), [1.5, -0.5, 0.0, 0.0])
    for gradient in both_gradients(lambda a, b: jnp.sum(safe_divide(a, b)), a, b):
        np.testing.assert_array_equal(gradient, [0.5, 0.25, 0.0, 0.0, -0.75, 0.125, 0.0, 0.0])


@pytest.mark.parametrize("scale", [1e-120, 1e-9, 1.0, 1e9, 1e120])
def test_a_norm_is_unbiased_at_every_scale(scale):
    v = scale * RNG.normal(size=(50, 3))
    np.testing.assert_allclose(safe_norm(jnp.asarray(v)), scale * np.linalg.norm(v / scale, axis=1), rtol=1e-15)


def test_the_gradient_of_a_norm_is_the_unit_vector_and_zero_at_the_origin():
    v = RNG.normal(size=3)
    for gradient in both_gradients(safe_norm, jnp.asarray(v)):
        np.testing.assert_allclose(gradient, v / np.linalg.norm(v), rtol=1e-14)
    for gradient in both_gradients(safe_norm, jnp.zeros(3)):
        np.testing.assert_array_equal(gradient, 0.0)


def test_a_segments_closest_point_is_closer_than_every_other_one():
    p, q, point = RNG.normal(size=(3, 200, 3))
    s = np.asarray(segment_parameter(jnp.asarray(p), jnp.asarray(q), jnp.asarray(point)))
    assert (s >= 0).all() and (s <= 1).all()
    assert (s == 0).any() and (s == 1).any() and ((s > 0) & (s < 1)).any()

    def distance(s):
        return np.linalg.norm(p + s[:, None] * (q - p) - point, axis=1)

    for other in np.linspace(0, 1, 101):
        assert (distance(s) <= distance(np.full(200, other)) + 1e-15).all()


def test_a_segment_of_no_length_has_parameter_zero_and_a_finite_gradient():
    p, point = jnp.ones(3), jnp.array([2.0, -1.0, 0.5])
    assert segment_parameter(p, p, point) == 0.0
    for gradient in both_gradients(segment_parameter, p, p, point):
        assert np.isfinite(gradient).all()


@pytest.mark.parametrize("n", range(1, 7))
def test_the_unrolled_cholesky_solves_what_lapack_solves(n):
    for condition in (1.0, 1e4, 1e8):
        basis = np.linalg.qr(RNG.normal(size=(n, n)))[0]
        a = basis @ np.diag(np.geomspace(1, 1 / condition, n)) @ basis.T
        x = RNG.normal(size=n)
        found = solve_spd(jnp.asarray(a), jnp.asarray(a @ x))
        np.testing.assert_allclose(found, x, atol=1e-14 * condition)


def test_a_singular_system_gives_a_finite_answer():
    assert np.isfinite(solve_spd(jnp.ones((3, 3)), jnp.array([1.0, 2.0, 3.0]), floor=1e-30)).all()


def test_a_folded_key_depends_on_every_number_and_on_their_order():
    key = jax.random.key(3)
    numbers = [(1, 2, 3), (1, 2, 4), (1, 3, 3), (2, 2, 3), (2, 1, 3), (1, 2), (1, 2, 3, 0)]
    drawn = [int(jax.random.bits(fold_keys(key, *n))) for n in numbers]
    assert len(set(drawn)) == len(numbers)
    assert drawn[0] == int(jax.random.bits(fold_keys(key, *map(jnp.int32, numbers[0]))))


@one_by_one
def _search(shared, rows, limits):
    return jax.vmap(lambda row, limit: jnp.sum(jnp.where(shared < row, shared, 0.0)) + limit)(rows, limits)


def test_lanes_one_by_one_equal_a_loop_over_them():
    shared, rows, limits = jnp.arange(20.0), jnp.asarray(RNG.uniform(0, 20, (3, 4, 5))), jnp.asarray(RNG.normal(size=5))
    expected = np.array([[_search(shared, row, limits) for row in plane] for plane in rows])
    lane = jax.vmap(_search, in_axes=(None, 0, None))
    np.testing.assert_array_equal(jax.jit(jax.vmap(lane, in_axes=(None, 0, None)))(shared, rows, limits), expected)
    across = jax.vmap(lane, in_axes=(None, 1, None))(shared, rows, limits)
    np.testing.assert_array_equal(across, expected.swapaxes(0, 1))


def test_what_is_searched_must_be_shared():
    with pytest.raises(ValueError, match="same for all lanes"):
        jax.vmap(_search)(jnp.ones((2, 20)), jnp.ones((2, 5)), jnp.ones((2, 5)))
