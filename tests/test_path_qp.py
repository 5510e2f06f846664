"""QP of a complete path, equation (3): minima by their multipliers, closed forms, constraints of every answer."""

from itertools import pairwise

import clarabel
import numpy as np
import pytest
from scipy import optimize, sparse
from scipy.linalg import block_diag

from htcp_jax.solvers.path_qp import PathQP, path_cost, solve_path_qp

EXACT = 2e-6  # accuracy of an interior-point method, relative to 1


def random_path(rng, count=4, joints=3, rows=2, radius=0.3):
    """Random configurations, some with an equality; rows of all directions, close enough to stop some steps."""
    shape = count, rows, joints
    stays = (rng.random(count) < 0.2)[:, None]
    most, least = (np.where(stays, 0.0, rng.uniform(0.1, 1, (count, joints)) * radius) for _ in range(2))
    return PathQP(
        rng.normal(size=(count + 1, joints)), rng.uniform(0.2, 5, joints), rng.random(count) < 0.5,
        rng.normal(size=(count, 1, joints)), rng.normal(size=shape), rng.exponential(0.1, (count, rows)),
        rng.normal(size=shape), rng.exponential(0.1, (count, rows)), -least, most,
    )  # fmt: skip


def free(x, weights=None, **changes):
    """A path QP without constraints, except for those in `changes`."""
    count, joints = len(x) - 1, x.shape[1]
    rows, far = np.zeros((count, 0, joints)), np.full((count, joints), 1e3)
    nothing = PathQP(
        x, np.ones(joints) if weights is None else np.asarray(weights), np.zeros(count, bool),
        np.zeros((count, 1, joints)), rows, rows[..., 0], rows, rows[..., 0], -far, far,
    )  # fmt: skip
    return nothing._replace(**changes)


def cost(qp, y):
    """Sum over the path of w' (x_i - x_{i-1})^2, one configuration after another."""
    x = [qp.x[0], *(qp.x[1:] + y)]
    return sum(float(qp.weights @ (b - a) ** 2) for a, b in pairwise(x))


def left(qp, y):
    """Slack of all inequalities except the bounds, from their definition; the start does not move."""
    y = np.concatenate([np.zeros((1, y.shape[1])), y])
    at = [qp.h[i] - qp.G[i] @ y[i + 1] for i in range(len(qp.h))]
    half_way = [qp.c[i] - qp.C[i] @ (y[i] + y[i + 1]) / 2 for i in range(len(qp.c))]
    return np.concatenate([*at, *half_way])


def task(qp, y):
    return np.concatenate([qp.A[i] @ y[i] for i in np.flatnonzero(qp.constrained)] or [np.zeros(0)])


def is_a_minimum(qp, y):
    """Return whether y is a minimum, and which inequalities are active.

    The cost's gradient must be a combination of the equations and, with non-negative weights, of the active
    inequalities (dense). For a convex QP these Karush-Kuhn-Tucker conditions suffice.
    """
    zero, size = np.zeros_like(y), y.size
    pull = optimize.approx_fprime(y.ravel(), lambda flat: cost(qp, flat.reshape(y.shape)), 1e-7)
    slope = lambda of: np.stack([of(qp, e.reshape(y.shape)) - of(qp, zero) for e in np.eye(size)], axis=1)  # noqa: E731
    equations, inequalities = slope(task), np.concatenate([slope(left), -np.eye(size), np.eye(size)])
    tight = np.concatenate([left(qp, y), (qp.upper - y).ravel(), (y - qp.lower).ravel()]) < 1e-5
    holds, near = np.concatenate([equations, inequalities[tight]]).T, 1e-4 * np.linalg.norm(pull)
    least = [(None, None)] * len(equations) + [(0, None)] * int(tight.sum())
    if not least:
        return np.linalg.norm(pull) < 1e-6, tight
    within = np.concatenate([pull + near, near - pull])
    found = optimize.linprog(np.zeros(len(least)), np.concatenate([holds, -holds]), within, bounds=least)
    held = np.zeros(len(tight))
    held[tight] = found.x[len(equations) :] if found.success else 0.0
    return found.success, held > 1e-3


def by_clarabel(qp):
    """Minimum by Clarabel: the definition in dense matrices, whose columns are the answers to unit steps."""
    unit, zero = np.eye(qp.lower.size).reshape(-1, *qp.lower.shape), np.zeros_like(qp.lower)
    first = int(qp.begins_anywhere)
    segments = lambda x: np.sqrt(qp.weights) * np.diff(x[first:], axis=0)  # noqa: E731
    D = np.stack([segments(np.concatenate([np.zeros((1, e.shape[1])), e])).ravel() for e in unit], axis=1)
    tasks, rows = (np.stack([of(qp, e) - of(qp, zero) for e in unit], axis=1) for of in (task, left))
    rows = np.concatenate([tasks, -rows, np.eye(zero.size), -np.eye(zero.size)])
    bounds = np.concatenate([np.zeros(len(tasks)), left(qp, zero), qp.upper.ravel(), -qp.lower.ravel()])
    cones = [clarabel.ZeroConeT(len(tasks)), clarabel.NonnegativeConeT(len(bounds) - len(tasks))]
    options = clarabel.DefaultSettings()
    options.verbose = False
    cost, pull = sparse.triu(2 * D.T @ D, format="csc"), 2 * D.T @ segments(qp.x).ravel()
    found = clarabel.DefaultSolver(cost, pull, sparse.csc_matrix(rows), bounds, cones, options).solve()
    assert str(found.status) == "Solved"
    return np.asarray(found.x).reshape(zero.shape)


@pytest.mark.parametrize("begins_anywhere", [False, True])
def test_it_finds_what_a_general_solver_finds(begins_anywhere):
    """Same steps as by Clarabel, which gets all equations and inequalities, with single joints that cannot move."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        qp = random_path(rng, count=12, joints=5, rows=3)
        moves = rng.random(qp.lower.shape) < 0.9
        qp = qp._replace(lower=moves * qp.lower, upper=moves * qp.upper, begins_anywhere=begins_anywhere)
        qp.A[seed % 12] *= seed % 2  # a row of zeros, too
        y, expected = solve_path_qp(qp), by_clarabel(qp)
        np.testing.assert_allclose(y, expected, atol=1e-4)
        start = int(begins_anywhere)
        assert path_cost((qp.x + np.pad(y, ((1, 0), (0, 0))))[start:], qp.weights) == pytest.approx(
            path_cost((qp.x + np.pad(expected, ((1, 0), (0, 0))))[start:], qp.weights), abs=1e-6
        )


def test_it_finds_the_minimum():
    """Minima of random paths, with all kinds of active constraints, also halfway to the first one."""
    stopped = np.zeros(4, int)
    for seed in range(25):
        qp = random_path(np.random.default_rng(seed))
        y = solve_path_qp(qp)
        minimum, held = is_a_minimum(qp, y)
        assert minimum and not is_a_minimum(qp, 0.9 * y)[0]
        at, half_way, bounds = np.split(held, [qp.h.size, qp.h.size + qp.c.size])
        moves = (qp.upper > qp.lower).ravel()
        stopped += [at.any(), half_way.any(), (bounds & np.tile(moves, 2)).any(), half_way[: qp.c.shape[1]].any()]
    assert (stopped >= 3).all()


def test_without_an_active_inequality_it_solves_the_equations_of_its_multipliers():
    """Solution of the dense KKT system: stationary along the path, with the held configurations on their task."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        x, held = rng.normal(size=(9, 4)), np.arange(8) % 3 > 0
        A, w = rng.normal(size=(8, 2, 4)), rng.uniform(0.2, 5, 4)
        V = np.kron(np.eye(8) - np.eye(8, k=-1), np.eye(4))
        W, rows = np.kron(np.eye(8), np.diag(w)), block_diag(*A)[np.repeat(held, 2)]
        top = np.hstack([2 * V.T @ W @ V, rows.T])
        system = np.vstack([top, np.hstack([rows, np.zeros((len(rows), len(rows)))])])
        right = np.concatenate([-2 * V.T @ W @ np.diff(x, axis=0).ravel(), np.zeros(len(rows))])
        expected = np.linalg.solve(system, right)[:32].reshape(8, 4)
        np.testing.assert_allclose(solve_path_qp(free(x, w, constrained=held, A=A)), expected, atol=EXACT)


def test_a_path_whose_last_configuration_stays_becomes_straight_and_even():
    """Straight path with even steps from the fixed start to the fixed end, for any weights."""
    rng = np.random.default_rng(3)
    x, bound = rng.normal(size=(7, 5)), np.full((6, 5), 1e3)
    bound[-1] = 0.0
    for weights in (np.ones(5), rng.uniform(0.1, 10, 5)):
        y = solve_path_qp(free(x, weights, lower=-bound, upper=bound))
        np.testing.assert_array_equal(y[-1], 0)
        np.testing.assert_allclose(x[1:] + y, np.linspace(x[0], x[-1], 7)[1:], atol=EXACT)


def test_a_path_that_may_end_anywhere_stays_at_its_start():
    x = np.random.default_rng(4).normal(size=(6, 3))
    np.testing.assert_allclose(x[1:] + solve_path_qp(free(x)), np.tile(x[0], (5, 1)), atol=EXACT)


def test_one_configuration_on_its_task_gives_way_where_joints_are_light():
    """Closed form for one configuration: the nearest to the start in the weighted norm, on the plane of the task."""
    rng = np.random.default_rng(5)
    for weights in (np.ones(3), np.array([1.0, 30.0, 1.0])):
        x, a = rng.normal(size=(2, 3)), rng.normal(size=3)
        back = x[0] - x[1]
        expected = back - a / weights * (a @ back) / (a / weights @ a)
        qp = free(x, weights, constrained=np.array([True]), A=a[None, None])
        np.testing.assert_allclose(solve_path_qp(qp)[0], expected, atol=EXACT)


@pytest.mark.parametrize("factor", [0.0, 1e-6, 1.0, 100.0])
def test_every_answer_keeps_what_it_has_to_and_costs_no_more_than_before(factor):
    """Constraints and cost of answers for 100 configurations: tight and loose rows, tiny trust regions."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        qp = random_path(rng, count=100, joints=6, rows=5, radius=[0.2, 1e-4][seed % 2])
        qp = qp._replace(h=factor * qp.h, c=factor * qp.c, A=rng.normal(size=(100, 3, 6)))
        y = solve_path_qp(qp)
        assert (qp.lower <= y).all() and (y <= qp.upper).all()
        assert left(qp, y).min() >= -EXACT and np.abs(task(qp, y)).max() <= EXACT
        assert cost(qp, y) <= cost(qp, np.zeros_like(y)) and (factor < 1 or y.any())


def test_a_row_that_no_step_breaks_changes_nothing():
    """Inactive rows: bitwise the same answer, at configurations and halfway; once a row is near, another one."""
    qp = random_path(np.random.default_rng(7), count=8, joints=4)
    y, rng = solve_path_qp(qp), np.random.default_rng(8)
    more, far = rng.normal(size=(8, 1, 4)), np.full((8, 1), 3.0)  # beyond any step of 0.3
    for rows, bounds in (("G", "h"), ("C", "c")):
        joined = {rows: np.concatenate([getattr(qp, rows), more], axis=1)}
        again = qp._replace(**joined, **{bounds: np.concatenate([getattr(qp, bounds), far], axis=1)})
        np.testing.assert_array_equal(solve_path_qp(again), y)
        near = again._replace(**{bounds: np.concatenate([getattr(qp, bounds), 0 * far], axis=1)})
        assert np.abs(solve_path_qp(near) - y).max() > 1e-3


def test_only_the_ratios_of_the_weights_matter():
    qp = random_path(np.random.default_rng(11), count=8, joints=4)
    y = solve_path_qp(qp)
    for factor in (1e-12, 1e12):
        again = solve_path_qp(qp._replace(weights=factor * qp.weights))
        np.testing.assert_allclose(again, y, rtol=0, atol=1e-9)


def test_where_the_solver_breaks_down_nothing_moves():
    qp = random_path(np.random.default_rng(9))
    qp.x[2, 1] = np.nan
    np.testing.assert_array_equal(solve_path_qp(qp), np.zeros_like(qp.lower))


def test_the_cost_of_a_path_is_that_of_its_steps():
    qp = random_path(np.random.default_rng(10))
    assert path_cost(qp.x, qp.weights) == pytest.approx(cost(qp, np.zeros_like(qp.lower)), rel=1e-14)


def test_a_row_is_kept_that_only_the_longest_step_breaks():
    """Rows that only the longest step violates: they stop a joint just before the end of its trust region."""
    pulled = np.array([1.0, -1.0, 1.0])
    x, bound, none = np.outer([0, 20, 30], pulled), np.full((2, 3), 0.3), np.zeros((2, 0))
    towards = np.tile(-pulled, (2, 1, 1))
    np.testing.assert_allclose(solve_path_qp(free(x, lower=-bound, upper=bound)), -0.3 * np.tile(pulled, (2, 1)))
    for rows, bounds, row, most in (("G", "h", 0, 0.9), ("G", "h", 1, 0.9), ("C", "c", 0, 0.45), ("C", "c", 1, 0.9)):
        limits = np.full((2, 1), np.inf)
        limits[row] = 0.95 * most
        other = {"G": {"C": towards[:, :0], "c": none}, "C": {"G": towards[:, :0], "h": none}}[rows]
        qp = free(x, lower=-bound, upper=bound, **{rows: towards, bounds: limits}, **other)
        np.testing.assert_allclose(left(qp, solve_path_qp(qp))[row], 0, atol=EXACT)
