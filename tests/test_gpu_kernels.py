"""GPU kernels, interpreted: equal to the CPU code, to known solutions, and to other solvers.

The interior point methods differ only in the rounding of sums over rows. Near the end rounding decides their steps:
reordering the rows of a QP changes the result as much.
"""

from functools import partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import qpsolvers
import toy
from test_qp import ORACLE, dense_answer

from htcp_jax.backend import Backend, compiled_for, triton
from htcp_jax.clearance import is_clear, minimum_clearance
from htcp_jax.solvers import cma_es, gpu_kernels
from htcp_jax.solvers.interior_point import DenseSolution, solve_dense

pytestmark = pytest.mark.skipif(triton() is None, reason="this JAX has no Triton backend of Pallas")
INTERPRETED = Backend("gpu", has_kernels=True, interprets=True)


def one_by_kernel(H, c, G, h, tolerance=1e-11, iterations=30) -> DenseSolution:
    with compiled_for(INTERPRETED):
        return DenseSolution(*gpu_kernels.solve(H, c, G, h, tolerance, iterations))


by_kernel = made_once.quick_jit(jax.vmap(one_by_kernel))
by_xla = made_once.quick_jit(jax.vmap(solve_dense))


def random_qps(n, m, count=64, seed=0):
    """Strictly convex QPs with 0 strictly feasible: H (count, n, n), c, G, h."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, n, n))
    H = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n)
    return H, rng.normal(size=(count, n)), rng.normal(size=(count, m, n)), rng.uniform(0, 1, (count, m))


def residuals(qps, found: DenseSolution):
    """Violations of the KKT conditions, in numpy (count, 4)."""
    H, c, G, h = qps
    y, multipliers = np.asarray(found.y), np.asarray(found.multipliers)
    free_radius = h - np.einsum("bmn,bn->bm", G, y)
    dual = np.einsum("bij,bj->bi", H, y) + c + np.einsum("bmn,bm->bn", G, multipliers)
    gap = np.abs(np.mean(multipliers * free_radius, axis=1))
    return np.stack([np.abs(dual).max(1), -free_radius.min(1), -multipliers.min(1), gap], axis=1)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 5), (3, 16), (4, 84), (5, 130)])
def test_the_interior_point_kernel_ends_where_the_loops_of_xla_do(n, m):
    qps = random_qps(n, m)
    ours, theirs = by_kernel(*qps), by_xla(*qps)
    off = np.abs(ours.y - theirs.y).max(axis=1)
    assert np.mean(off < 1e-9) > 0.9 and off.max() < 1e-4, np.sort(off)[-8:]
    for found in (ours, theirs):
        assert residuals(qps, found).max() < 1e-9 and np.asarray(found.error).max() < 1e-9


@pytest.mark.parametrize("degenerate", [False, True])
@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_interior_point_kernel_finds_the_answer_that_a_qp_was_built_from(n, degenerate):
    """Compare objectives: with nearly active rows the minimiser is ill-conditioned, the objective is not."""
    rng = np.random.default_rng(n)
    made = [dense_answer(rng, n, 40, degenerate) for _ in range(20)]
    H, c, G, h, y = (np.array(part) for part in zip(*made, strict=True))
    box = np.broadcast_to(np.concatenate([np.eye(n)[:-1], -np.eye(n)[:-1]]), (20, 2 * n - 2, n))
    G, h = np.concatenate([G, box], axis=1), np.concatenate([h, np.full((20, 2 * n - 2), 2.0)], axis=1)
    found = by_kernel(H, c, G, h)
    assert np.asarray(found.error).max() < 1e-9
    got = np.asarray(found.y)
    value = [0.5 * np.einsum("bi,bij,bj->b", x, H, x) + np.einsum("bi,bi->b", c, x) for x in (got, y)]
    np.testing.assert_allclose(*value, rtol=0, atol=1e-8)
    assert residuals((H, c, G, h), found).max() < 1e-9


@pytest.mark.parametrize("name", [ORACLE])
def test_the_interior_point_kernel_agrees_with_another_solver(name):
    qps = random_qps(4, 30, count=20, seed=9)
    for k, y in enumerate(np.asarray(by_kernel(*qps).y)):
        np.testing.assert_allclose(y, qpsolvers.solve_qp(*(part[k] for part in qps), solver=name), atol=1e-7)


def test_rows_that_say_the_same_or_nothing_do_not_mislead_the_kernel():
    """Duplicate rows, zero rows, and inactive limits do not change the solution; infinite limits behave as on a CPU."""
    H, c, G, h = random_qps(3, 10)
    plain = by_xla(H, c, G, h).y
    more = np.concatenate([G, G, 0 * G, G], axis=1), np.concatenate([h, h, h, 0 * h + 1e3], axis=1)
    ours = by_kernel(H, c, *more)
    np.testing.assert_allclose(ours.y, plain, rtol=0, atol=1e-6)
    np.testing.assert_allclose(ours.y, by_xla(H, c, *more).y, rtol=0, atol=1e-6)
    endless = np.where(np.arange(10) == 3, np.inf, h)
    for ours, theirs in zip(by_kernel(H, c, G, endless), by_xla(H, c, G, endless), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_interior_point_kernel_keeps_its_best_iterate_where_rounding_ends_it():
    H, c = np.diag([1e-3, 1e-3, 0.0]), np.array([0.0, 0.0, -1.0])
    G = np.array([[0.0, 0.0, 1.0], [1e-9, 0.0, 1.0], [0.0, 1e-9, 1.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    h = np.array([[0.0, 0.0, 0.0, r, r, r, r] for r in (0.5, 1e-3, 1e-6)])
    found = by_kernel(*(np.broadcast_to(part, (3, *part.shape)) for part in (H, c, G)), h)
    assert np.asarray(found.error).max() < 1e-9 and np.isfinite(found.y).all()


def test_a_lane_of_the_interior_point_kernel_does_not_notice_the_others():
    """Compare a lane alone, in a batch, and under two vmaps: the same bits."""
    qps = random_qps(3, 20, count=6)
    together = by_kernel(*qps)
    twice = made_once.quick_jit(jax.vmap(jax.vmap(one_by_kernel)))(
        *(part.reshape(2, 3, *part.shape[1:]) for part in qps)
    )
    for k in range(6):
        alone = made_once.quick_jit(one_by_kernel)(*(part[k] for part in qps))
        for a, b, c in zip(alone, together, twice, strict=True):
            np.testing.assert_array_equal(a, b[k])
            np.testing.assert_array_equal(a, c[k // 3, k % 3])


def test_a_gpu_gets_the_kernels_and_a_cpu_what_it_had():
    """Count the kernels in the traced program, as the choice is made when tracing."""
    qp = [part[0] for part in random_qps(3, 20)]
    state, key = cma_es.start(jnp.zeros(3), 0.3), jax.random.PRNGKey(0)

    def kernels(backend):
        with compiled_for(backend):
            made = jax.make_jaxpr(solve_dense)(*qp), jax.make_jaxpr(partial(cma_es.ask, population=4))(state, key)
        return [str(program).count("pallas_call") for program in made]

    assert kernels(Backend.of("cpu")) == kernels(Backend("gpu")) == [0, 0]
    assert kernels(Backend.of("gpu")) == [1, 1]


# The square roots of a covariance


@made_once.quick_jit
def square_roots(C):
    with compiled_for(INTERPRETED):
        return jax.vmap(gpu_kernels.square_roots)(C)


def covariances(n, count=50):
    """Symmetric positive definite matrices up to condition 1e6, including diagonal ones and equal eigenvalues."""
    rng = np.random.default_rng(n)
    turn = np.linalg.qr(rng.normal(size=(count, n, n)))[0]
    C = turn * 10.0 ** rng.uniform(-4, 2, (count, 1, n)) @ turn.transpose(0, 2, 1)
    C[:3] = np.eye(n), np.diag(np.arange(n, 0, -1.0)), np.ones((n, n)) + 1e-3 * np.eye(n)
    return (C + C.transpose(0, 2, 1)) / 2


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7])
def test_the_kernels_square_roots_are_those_of_numpys_eigenvalues(n):
    C = covariances(n)
    axes, whiten = (np.asarray(part) for part in square_roots(C))
    value, vector = np.linalg.eigh(C)
    scale = value[:, -1]
    np.testing.assert_allclose((axes @ axes.transpose(0, 2, 1) - C) / scale[:, None, None], 0.0, atol=1e-14)
    length = np.linalg.norm(axes, axis=1)
    np.testing.assert_allclose((length**2 - value) / scale[:, None], 0.0, atol=1e-14)
    assert (np.diff(length) >= -1e-14 * length[:, -1:]).all()
    across = (axes / length[:, None, :]).transpose(0, 2, 1) @ (axes / length[:, None, :])
    np.testing.assert_allclose(across, np.broadcast_to(np.eye(n), across.shape), atol=1e-14)
    inverse = (vector / np.sqrt(value)[:, None, :]) @ vector.transpose(0, 2, 1)
    np.testing.assert_allclose(whiten * np.sqrt(value[:, :1, None]), inverse * np.sqrt(value[:, :1, None]), atol=1e-9)


def test_the_longest_component_of_each_axis_is_positive_whatever_the_order_of_the_coordinates():
    axes = np.asarray(square_roots(covariances(3))[0])[3:]
    longest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None, :], axis=1)
    assert (longest > 0).all()
    turned = np.asarray(square_roots(covariances(3)[:, ::-1, ::-1])[0])[3:, ::-1]
    np.testing.assert_allclose(turned, axes, atol=1e-9)


def test_a_covariance_that_is_none_gives_finite_axes():
    """Check a matrix with an eigenvalue that rounding made negative: it is replaced by the nearest valid one."""
    axes, whiten = square_roots(np.array([[[1.0, 1.0], [1.0, 1.0 - 1e-15]], [[0.0, 0.0], [0.0, 0.0]]]))
    assert np.isfinite(axes).all() and np.isfinite(whiten).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_generation_by_the_gpus_formulas_is_that_of_the_cpu_but_for_signs(seed):
    """Compare mean, step size, covariance and paths from the same samples, to rounding."""
    rng, r = np.random.default_rng(seed), cma_es.strategy_parameters(20, 3)
    state = cma_es.start(jnp.array([1.0, -2.0, 0.5]), 0.3)._replace(C=jnp.asarray(covariances(3)[seed + 5]))
    samples, cost = rng.normal(size=(20, 3)), rng.normal(size=20)
    cpu = made_once.quick_jit(lambda *a: cma_es.tell(*a, r))(state, samples, cost)
    with compiled_for(INTERPRETED):
        gpu = made_once.quick_jit(lambda *a: cma_es.tell(*a, r))(state, samples, cost)
    for ours, theirs in zip(gpu, cpu, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-12)


def test_clear_by_a_margin_is_the_verdict_of_the_distance():
    scene, where = toy.scene(), jax.tree.map(jnp.asarray, toy.scenario())

    def each(query, *rows):
        of = partial(query, scene.robot, scene.obstacles, where)
        return made_once.quick_jit(jax.vmap(of))(*rows)

    x = np.random.default_rng(0).uniform(-1.5, 1.5, (64, 4))
    D = each(minimum_clearance, x)
    margin = jnp.maximum(D + np.tile([1e-9, -1e-9, 1e-3, 0.0], 16), 0.0)
    with compiled_for(INTERPRETED):
        np.testing.assert_array_equal(each(is_clear, x, margin), D > margin)
    assert 10 < (D > margin).sum() < 54
