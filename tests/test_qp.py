"""Step QPs built backwards from a known answer: their KKT conditions, and solvers compared with each other."""

from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import qpsolvers
from scipy.optimize import nnls

from htcp_jax.errors import InputError
from htcp_jax.planning.tracking.step_qps import make_solver
from htcp_jax.settings import Settings
from htcp_jax.solvers import ClarabelSolver, QPSolversSolver
from htcp_jax.solvers.interior_point import solve_dense
from htcp_jax.solvers.step_qp import QPStatus, StepQP, assemble, row_count, scaled_weights

_DENSE = made_once.quick_jit(solve_dense)
WEIGHTS = 2 * np.array(Settings().q_weights)
N = len(WEIGHTS)
ORACLE = pytest.param(
    "quadprog",
    marks=pytest.mark.skipif("quadprog" not in qpsolvers.available_solvers, reason="quadprog is not installed"),
)
# qpsolvers warns of converting the matrices of direct calls from dense to sparse: not our hot path.
pytestmark = pytest.mark.filterwarnings("ignore::qpsolvers.warnings.SparseConversionWarning")


def random_answer(rng, rows):
    """A step QP and its minimiser y, chosen first. Then multipliers, and the linear cost and bounds that fit both."""
    y = rng.normal(size=N) * 10.0 ** rng.uniform(-3, 0)
    A, G = rng.normal(size=(3, N)), 0.5 * rng.normal(size=(rows, N))
    active = rng.random(rows) < 0.3
    at_upper = rng.random(N) < 0.15
    at_lower = (rng.random(N) < 0.15) & ~at_upper
    if active.sum() + at_upper.sum() + at_lower.sum() > N - 3:
        return random_answer(rng, rows)  # more active rows than unknowns: multipliers would not be unique
    mu = np.where(active, rng.uniform(0.1, 10, rows), 0.0)
    nu = np.where(at_upper, rng.uniform(0.1, 10, N), 0.0) - np.where(at_lower, rng.uniform(0.1, 10, N), 0.0)
    linear = -(WEIGHTS * y + A.T @ rng.normal(size=3) + G.T @ mu + nu)
    h = G @ y + np.where(active, 0.0, rng.uniform(0.01, 1, rows))
    upper = y + np.where(at_upper, 0.0, rng.uniform(0.01, 3, N))
    lower = y - np.where(at_lower, 0.0, rng.uniform(0.01, 3, N))
    return StepQP(WEIGHTS, linear, A, A @ y, G, h, lower, upper), y


def batch(qps) -> StepQP:
    return StepQP(*(np.stack(field) for field in zip(*qps, strict=True)))


def random_batch(count, rows, seed):
    rng = np.random.default_rng(seed)
    qps, answers = zip(*(random_answer(rng, rows) for _ in range(count)), strict=True)
    return batch(qps), np.stack(answers)


def infeasible(rng, rows, kind):
    """A random QP made infeasible: by a clearance row and the limits, by the task and the limits, or by two rows."""
    qp, _ = random_answer(rng, rows)
    if kind == "limits":
        G = qp.G.copy()
        G[0] = np.abs(G[0])
        h = qp.h.copy()
        h[0] = G[0] @ qp.lb - 0.05
        return qp._replace(G=G, h=h)
    if kind == "task":
        A = np.abs(qp.A)
        return qp._replace(A=A, b=A @ qp.ub + 0.05)
    G, h = qp.G.copy(), qp.h.copy()
    A, b = qp.A.copy(), qp.b.copy()
    A[0], b[0] = G[0], h[0] + 0.01  # the task requires what the row forbids
    return qp._replace(A=A, b=b, G=G, h=h)


@pytest.mark.parametrize("rows", [1, 8])
@pytest.mark.parametrize("name", ["clarabel", "qpsolvers:clarabel", ORACLE])
def test_a_solver_finds_the_answer_that_a_qp_was_built_from(name, rows):
    solver = ClarabelSolver(WEIGHTS, rows) if name == "clarabel" else QPSolversSolver(name.removeprefix("qpsolvers:"))
    qps, answers = random_batch(100, rows, seed=rows)
    y, status = solver.solve(qps)
    assert (status == QPStatus.SOLVED).all()
    np.testing.assert_allclose(y, answers, rtol=0, atol=1e-6)  # of steps up to 2 rad; tolerance 1e-8 on residuals


@pytest.mark.parametrize("rows", [1, 8])
def test_an_answer_fulfils_the_kkt_conditions(rows):
    """KKT conditions of the answers.

    Feasible, and minus the cost's gradient lies in the cone of the active constraints (non-negative least squares).
    """
    qps, _ = random_batch(50, rows, seed=10 + rows)
    y, _ = ClarabelSolver(WEIGHTS, rows).solve(qps)
    for k in range(50):
        qp = StepQP(*(field[k] for field in qps))
        np.testing.assert_allclose(qp.A @ y[k], qp.b, atol=1e-8)
        assert (qp.G @ y[k] <= qp.h + 1e-8).all()
        assert (y[k] <= qp.ub + 1e-8).all() and (y[k] >= qp.lb - 1e-8).all()
        near = qp.G @ y[k] > qp.h - 1e-6, y[k] > qp.ub - 1e-6, y[k] < qp.lb + 1e-6
        cone = np.concatenate([qp.A, -qp.A, qp.G[near[0]], np.eye(N)[near[1]], -np.eye(N)[near[2]]]).T
        _, residual = nnls(cone, -(qp.P * y[k] + qp.q))
        assert residual < 1e-5


@pytest.mark.parametrize("rows", [1, 8])
@pytest.mark.parametrize("kind", ["limits", "task", "row"])
@pytest.mark.parametrize("name", ["clarabel", ORACLE])
def test_infeasible_is_an_answer(name, kind, rows):
    solver = ClarabelSolver(WEIGHTS, rows) if name == "clarabel" else QPSolversSolver(name)
    rng = np.random.default_rng(rows)
    y, status = solver.solve(batch([infeasible(rng, rows, kind) for _ in range(30)]))
    assert (status == QPStatus.INFEASIBLE).all()
    np.testing.assert_array_equal(y, 0.0)


@pytest.mark.parametrize("name", ["clarabel", ORACLE])
def test_a_joint_without_limits_has_infinite_bounds(name):
    """Infinite bounds for joints without limits: all bounds that the answer does not touch."""
    solver = ClarabelSolver(WEIGHTS, 8) if name == "clarabel" else QPSolversSolver(name)
    qps, answers = random_batch(40, 8, seed=2)
    above, below = qps.ub > answers + 1e-9, qps.lb < answers - 1e-9
    y, status = solver.solve(qps._replace(ub=np.where(above, np.inf, qps.ub), lb=np.where(below, -np.inf, qps.lb)))
    assert (status == QPStatus.SOLVED).all()
    np.testing.assert_allclose(y, answers, rtol=0, atol=1e-6)


def mixed_batch(rows=8):
    """A batch of solvable, infeasible and broken QPs, and the indices of the broken ones."""
    rng = np.random.default_rng(5)
    qps = [infeasible(rng, rows, "limits") if k % 5 == 3 else random_answer(rng, rows)[0] for k in range(60)]
    broken = {}
    for k, (field, value) in {
        7: ("q", np.nan), 14: ("A", np.nan), 21: ("G", np.nan), 22: ("h", np.nan), 29: ("b", np.nan),
        36: ("A", np.inf), 37: ("q", np.inf), 44: ("ub", np.nan),
    }.items():  # fmt: skip
        spoiled = getattr(qps[k], field).copy()
        spoiled.flat[0] = value
        broken[k] = qps[k] = qps[k]._replace(**{field: spoiled})
    return batch(qps), np.array(sorted(broken))


def pick(qps: StepQP, which) -> StepQP:
    return StepQP(*(field[which] for field in qps))


@pytest.mark.parametrize("name", ["clarabel", ORACLE])
def test_a_broken_qp_fails_and_leaves_no_trace(name):
    """Broken QPs (NaN or infinity in any field): FAILED and zero; all others bitwise as without them."""
    make = (lambda: ClarabelSolver(WEIGHTS, 8)) if name == "clarabel" else lambda: QPSolversSolver(name)
    qps, broken = mixed_batch()
    y, status = make().solve(qps)
    assert (status[broken] == QPStatus.FAILED).all()
    np.testing.assert_array_equal(y[broken], 0.0)
    healthy = np.setdiff1d(np.arange(60), broken)
    alone = make().solve(pick(qps, healthy))
    np.testing.assert_array_equal(y[healthy], alone.y)
    np.testing.assert_array_equal(status[healthy], alone.status)
    assert {*status[healthy]} == {QPStatus.SOLVED, QPStatus.INFEASIBLE}


def test_answers_are_bitwise_the_same_in_any_order_alone_and_on_any_thread():
    qps, _ = mixed_batch()
    y, status = ClarabelSolver(WEIGHTS, 8).solve(qps)

    def check(order, solution):
        np.testing.assert_array_equal(solution.y, y[order])
        np.testing.assert_array_equal(solution.status, status[order])

    used = ClarabelSolver(WEIGHTS, 8)
    for seed in range(4):
        order = np.random.default_rng(seed).permutation(60)
        check(order, used.solve(pick(qps, order)))
    for k in range(60):
        check([k], ClarabelSolver(WEIGHTS, 8).solve(pick(qps, [k])))
    orders = [np.random.default_rng(10 + t).permutation(60) for t in range(8)]
    with ThreadPoolExecutor(4) as pool:
        for order, solution in zip(
            orders, pool.map(lambda o: ClarabelSolver(WEIGHTS, 8).solve(pick(qps, o)), orders), strict=True
        ):
            check(order, solution)


def test_a_panic_of_the_core_fails_one_qp_and_the_solver_is_built_anew():
    """Panic of Clarabel's Rust core: one QP fails and the solver is rebuilt.

    Such a panic is no subclass of Exception; a keyboard interrupt must still get through.
    """
    qps, _ = random_batch(3, 8, seed=0)
    clean = ClarabelSolver(WEIGHTS, 8).solve(qps)

    class Breaking:
        def __init__(self, working, breakage):
            self.working, self.breakage, self.calls = working, breakage, 0

        def update(self, **data):
            self.calls += 1
            if self.calls == 2:
                raise self.breakage
            self.working.update(**data)

        def solve(self):
            return self.working.solve()

    class FirstBreaks(ClarabelSolver):
        def __init__(self, breakage):
            self.breakage = breakage
            super().__init__(WEIGHTS, 8)

        def build(self):
            breakage, self.breakage = self.breakage, None
            return Breaking(super().build(), breakage) if breakage else super().build()

    y, status = FirstBreaks(type("PanicException", (BaseException,), {})("index out of bounds")).solve(qps)
    np.testing.assert_array_equal(status, [QPStatus.SOLVED, QPStatus.FAILED, QPStatus.SOLVED])
    np.testing.assert_array_equal(y[[0, 2]], clean.y[[0, 2]])
    np.testing.assert_array_equal(y[1], 0.0)

    with pytest.raises(KeyboardInterrupt):
        FirstBreaks(KeyboardInterrupt()).solve(qps)


@pytest.mark.parametrize("rows", ["per-body", "smallest"])
@pytest.mark.parametrize("cost_about", ["reference", "previous"])
def test_the_step_qp_is_equation_9_row_by_row(rows, cost_about):
    """Step QP of equation (9).

    In x: |x - about|_Q^2, Jac (x - x_ref) = C_next - C_ref, D_k + grad D_k (x - x_ref) >= margin, limits.
    """
    rng = np.random.default_rng(0)
    bodies, margin = 8, 5e-4
    x_ref, x_previous = rng.normal(size=(2, N))
    to_target, jac = rng.normal(size=3), rng.normal(size=(3, N))
    D, gradient = rng.normal(size=bodies), rng.normal(size=(bodies, N))
    lower, upper = -4 - rng.random(N), 4 + rng.random(N)
    settings = Settings(clearance_rows=rows, cost_about=cost_about)
    given = map(jnp.asarray, (x_ref, x_previous, to_target, jac, D, gradient, margin, lower, upper))
    qp = StepQP(*map(np.asarray, assemble(settings, *given)))

    about = x_ref if cost_about == "reference" else x_previous
    kept = [int(np.argmin(D))] if rows == "smallest" else range(bodies)
    assert qp.G.shape == (row_count(settings, bodies), N) == (len(kept), N)
    for _ in range(10):
        x, other = x_ref + 0.3 * rng.normal(size=(2, N))

        def cost(x):
            return np.sum(settings.q_weights * (x - about) ** 2)  # the smallest weight is 1

        def cost_of_step(y):
            return 0.5 * np.sum(qp.P * y * y) + qp.q @ y

        ours = cost_of_step(x - x_ref) - cost_of_step(other - x_ref)
        np.testing.assert_allclose(ours, cost(x) - cost(other), atol=1e-12)
        np.testing.assert_allclose(qp.A @ (x - x_ref) - qp.b, jac @ (x - x_ref) - to_target, atol=1e-13)
        for row, body in enumerate(kept):
            linearised = D[body] + gradient[body] @ (x - x_ref)
            free_radius = qp.h[row] - qp.G[row] @ (x - x_ref)
            np.testing.assert_allclose(free_radius, linearised - margin, atol=1e-13)
        np.testing.assert_allclose(qp.ub - (x - x_ref), upper - x, atol=1e-13)
        np.testing.assert_allclose((x - x_ref) - qp.lb, x - lower, atol=1e-13)


def short_steps(count, length, seed):
    """Step QPs with solutions of a given length [rad], found by multipliers in extended precision.

    The cost is that of a step from rest, q = 0; about half of the solutions have an active clearance row.
    """
    rng = np.random.default_rng(seed)
    qps, answers = [], []
    for k in range(count):
        A, G = rng.normal(size=(3, N)), 0.5 * rng.normal(size=(4, N))
        active = np.concatenate([A, G[: k % 2]]).astype(np.longdouble)
        multipliers = rng.uniform(0.1, 1, len(active)) * np.where(np.arange(len(active)) < 3, 1, -1)
        y = multipliers.astype(np.longdouble) @ active / WEIGHTS.astype(np.longdouble)
        factor = length / np.abs(y).max()
        y, b, h = factor * y, factor * (A @ y), factor * (G @ y)
        h[k % 2 :] += 0.01
        qps.append(
            StepQP(WEIGHTS, np.zeros(N), A, b.astype(float), G, h.astype(float), np.full(N, -3.0), np.full(N, 3.0))
        )
        answers.append(y.astype(float))
    return batch(qps), np.stack(answers)


@pytest.mark.parametrize("name", ["clarabel", ORACLE])
@pytest.mark.parametrize("length", [2e-5, 2e-3, 0.2])
def test_qpsolvers_solves_short_steps_as_accurately_as_long_ones_for_weights_of_any_unit(name, length):
    qps, answers = short_steps(40, length, seed=1)
    for factor in (1e-12, 1.0, 1e12):
        y, status = QPSolversSolver(name).solve(qps._replace(P=factor * qps.P))
        assert (status == QPStatus.SOLVED).all()
        np.testing.assert_allclose(y, answers, rtol=0, atol=1e-5 * length)


@pytest.mark.parametrize("name", ["clarabel", ORACLE])
def test_no_step_is_the_exact_solution_of_a_qp_of_qpsolvers_that_requires_none(name):
    """Regression: ECOS calls its solutions of such QPs inaccurate, so that a plan ended at its start."""
    qps, _ = short_steps(3, 0.2, seed=2)
    y, status = QPSolversSolver(name).solve(qps._replace(b=0 * qps.b, h=np.abs(qps.h)))
    assert (status == QPStatus.SOLVED).all() and not y.any()


@pytest.mark.filterwarnings("always::qpsolvers.warnings.SparseConversionWarning")
@pytest.mark.parametrize("name", ["clarabel", ORACLE])
def test_a_solver_of_qpsolvers_gets_matrices_of_the_kind_that_it_needs(name, recwarn):
    """Regression: a plan by Clarabel, HiGHS, OSQP, QPALM or SCS began with three lines of warnings."""
    QPSolversSolver(name).solve(short_steps(1, 0.2, seed=2)[0])
    assert not recwarn.list


@pytest.mark.parametrize("limit", [1e6, 1e8, 1e300, np.inf])
def test_limits_that_are_far_away_change_nothing(limit):
    """Clarabel fails with finite bounds of 1e8 and more, so a step QP has infinite ones instead."""
    x, row = jnp.zeros(N), jnp.ones((1, N))
    far = jnp.full(N, limit)
    qp = assemble(Settings(), x, x, jnp.zeros(3), jnp.ones((3, N)), jnp.ones(1), row, jnp.asarray(0.0), -far, far)
    assert np.isneginf(qp.lb).all() and np.isposinf(qp.ub).all()


@pytest.mark.parametrize("factor", [1e-12, 1e-6, 7.0, 1e6, 1e12])
def test_only_the_ratios_of_the_weights_matter(factor):
    given = np.array([5.0, 5.0, 2.0, 1.0, 5.0, 10.0])
    np.testing.assert_array_equal(scaled_weights(given), given)
    np.testing.assert_array_equal(scaled_weights(np.ones(7)), np.ones(7))
    np.testing.assert_allclose(scaled_weights(factor * given), given, rtol=1e-15)
    assert scaled_weights((1e-15, 1.0, 1e15)).max() == pytest.approx(1e6)


def test_the_seam_makes_the_solver_that_the_settings_name():
    assert isinstance(make_solver(Settings().on("cpu"), 8), ClarabelSolver)
    assert make_solver(Settings().on("gpu"), 8) is None  # lane functions solve the QPs
    assert isinstance(make_solver(Settings(qp="qpsolvers:clarabel"), 8), QPSolversSolver)
    with pytest.raises(InputError, match=r"'gurobbi' is not installed; valid: .*clarabel"):
        make_solver(Settings(qp="qpsolvers:gurobbi"), 8)


def test_a_looser_tolerance_gives_a_looser_answer():
    qps, answers = random_batch(30, 8, seed=3)
    error = {t: np.abs(ClarabelSolver(WEIGHTS, 8, t).solve(qps).y - answers).max() for t in (1e-4, 1e-9)}
    assert error[1e-9] < 1e-7 < error[1e-4] < 0.1


# The small dense QP on the device


def dense_answer(rng, n, m, degenerate=False):
    """An epigraph QP as posed by the minimisers on the sphere, and its answer: the last unknown has no curvature."""
    root = rng.normal(size=(n - 1, n - 1)) * 0.1
    H = np.zeros((n, n))
    H[:-1, :-1] = root @ root.T + 1e-3 * np.eye(n - 1)
    y = 0.1 * rng.normal(size=n)
    G = np.concatenate([rng.normal(size=(m, n - 1)) * 0.05, np.ones((m, 1))], axis=1)
    active = np.zeros(m, bool)
    active[: min(n, m)] = rng.random(min(n, m)) < 0.7
    active[0] = True
    multipliers = np.where(active, rng.uniform(0.1, 1, m), 0.0)
    multipliers /= multipliers.sum()  # so that the last unknown's cost is -1
    h = G @ y + np.where(active, 0.0, 10.0 ** rng.uniform(-9 if degenerate else -2, 0, m))
    return H, -(H @ y + G.T @ multipliers), G, h, y


@pytest.mark.parametrize("n", [2, 3, 4, 5])
@pytest.mark.parametrize("degenerate", [False, True])
def test_the_dense_solver_finds_the_answer_that_a_qp_was_built_from(n, degenerate):
    """Answers of the dense solver: objective, feasibility and stationarity.

    With nearly active rows the answer itself is ill-conditioned.
    """
    rng = np.random.default_rng(n)
    for m in (1, 5, 40, 100):
        for _ in range(5):
            H, c, G, h, y = dense_answer(rng, n, m, degenerate)
            box = np.eye(n)[:-1]
            G, h = np.concatenate([G, box, -box]), np.concatenate([h, np.full(2 * n - 2, 2.0)])
            found = _DENSE(*map(jnp.asarray, (H, c, G, h)))
            got = np.asarray(found.y)
            assert found.error < 2e-10
            assert (G @ got <= h + 1e-10).all() and (np.asarray(found.multipliers) >= 0).all()
            np.testing.assert_allclose(0.5 * got @ H @ got + c @ got, 0.5 * y @ H @ y + c @ y, rtol=0, atol=1e-8)
            residual = H @ got + c + G.T @ np.asarray(found.multipliers)
            np.testing.assert_allclose(residual, 0.0, atol=2e-10)


def test_the_dense_solver_keeps_its_best_iterate_where_rounding_ends_it():
    """Best iterate of the dense solver where rounding ends it.

    Planes through the starting point and hardly any curvature: past its best iterate the error grew again.
    """
    H, c = jnp.diag(jnp.array([1e-3, 1e-3, 0.0])), jnp.array([0.0, 0.0, -1.0])
    G = np.array([[0.0, 0.0, 1.0], [1e-9, 0.0, 1.0], [0.0, 1e-9, 1.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    for radius in (0.5, 1e-3, 1e-6):
        h = np.array([0.0, 0.0, 0.0, radius, radius, radius, radius])
        found = _DENSE(H, c, *map(jnp.asarray, (G, h)))
        assert found.error < 1e-9 and np.isfinite(found.y).all()


@pytest.mark.parametrize("name", [ORACLE])
def test_the_dense_solver_agrees_with_another_one(name):
    rng = np.random.default_rng(9)
    for _ in range(40):
        n, m = 4, 30
        root = rng.normal(size=(n, n))
        H, c = root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)
        G, h = rng.normal(size=(m, n)), rng.uniform(0.0, 1.0, m)
        found = _DENSE(*map(jnp.asarray, (H, c, G, h)))
        np.testing.assert_allclose(found.y, qpsolvers.solve_qp(H, c, G, h, solver=name), atol=1e-7)
