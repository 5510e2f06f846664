"""Step QP on the device: known answers, KKT conditions, and a comparison with Clarabel on real problems."""

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from test_qp import WEIGHTS, batch, infeasible, random_batch

from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import gp50
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Execution, Plans, Problem
from htcp_jax.planning.batch import plan
from htcp_jax.planning.method import Method
from htcp_jax.planning.methods import BUILT_IN
from htcp_jax.planning.tracking.engine import Engine
from htcp_jax.planning.tracking.lanes import Work
from htcp_jax.planning.tracking.step_qps import make_solver
from htcp_jax.settings import Settings
from htcp_jax.solvers import ClarabelSolver
from htcp_jax.solvers.active_set import solve_step
from htcp_jax.solvers.step_qp import QPSolver, QPStatus, StepQP, row_count
from htcp_jax.status import Status

solve = made_once.quick_jit(jax.vmap(solve_step))
[BASELINE] = [method for method in BUILT_IN if method.name == "baseline"]
START = np.array([0.0, -2.3, 0.5, 0.0, 0.5, -2.0])


def solved(qps: StepQP):
    return jax.tree.map(np.asarray, solve(jax.tree.map(jnp.asarray, qps)))


@pytest.mark.parametrize("rows", [1, 8])
def test_it_finds_the_answer_that_a_qp_was_built_from(rows):
    qps, answers = random_batch(500, rows, seed=rows)
    y, status = solved(qps)
    assert (status == QPStatus.SOLVED).all()
    np.testing.assert_allclose(y, answers, rtol=0, atol=1e-10)


@pytest.mark.parametrize("kind", ["limits", "task", "rows"])
def test_it_certifies_a_qp_that_has_no_solution(kind):
    rng = np.random.default_rng(3)
    y, status = solved(batch([infeasible(rng, 8, kind) for _ in range(100)]))
    assert (status == QPStatus.INFEASIBLE).all() and (y == 0).all()


def test_rows_that_say_the_same_or_nothing_change_nothing():
    qps, answers = random_batch(100, 4, seed=9)
    rng = np.random.default_rng(9)
    again = 10.0 ** rng.uniform(-3, 3, 100)[:, None]
    G = np.concatenate([qps.G, again[..., None] * qps.G, 0.0 * qps.G[:, :1]], axis=1)
    h = np.concatenate([qps.h, again * qps.h, 0.0 * qps.h[:, :1]], axis=1)
    y, status = solved(qps._replace(G=G, h=h))
    assert (status == QPStatus.SOLVED).all()
    np.testing.assert_allclose(y, answers, rtol=0, atol=1e-9)
    # 0 y <= -1 is clearly infeasible.
    assert (solved(qps._replace(G=G, h=np.concatenate([h[:, :-1], h[:, -1:] - 1], axis=1))).status == 1).all()


def test_a_joint_without_limits_is_free():
    qps, _ = random_batch(100, 8, seed=4)
    wide = qps._replace(ub=np.full_like(qps.ub, 1e3), lb=np.full_like(qps.lb, -1e3))
    free = qps._replace(ub=np.full_like(qps.ub, np.inf), lb=np.full_like(qps.lb, -np.inf))
    np.testing.assert_array_equal(solved(free).status, solved(wide).status)
    np.testing.assert_allclose(solved(free).y, solved(wide).y, rtol=0, atol=1e-10)


def test_a_task_that_a_singular_configuration_cannot_do_is_infeasible():
    qps, _ = random_batch(20, 2, seed=5)
    A, b = qps.A.copy(), qps.b.copy()
    A[:, 2] = A[:, 0] + A[:, 1]
    b[:, 2] = b[:, 0] + b[:, 1] + 0.1
    assert (solved(qps._replace(A=A, b=b)).status == QPStatus.INFEASIBLE).all()


@pytest.mark.parametrize("field", StepQP._fields)
def test_a_qp_with_a_nan_fails_and_the_others_do_not_notice(field):
    qps, answers = random_batch(5, 8, seed=6)
    broken = getattr(qps, field).copy()
    broken[2].flat[0] = np.nan
    y, status = solved(qps._replace(**{field: broken}))
    assert status.tolist() == [0, 0, QPStatus.FAILED, 0, 0] and (y[2] == 0).all()
    np.testing.assert_allclose(np.delete(y, 2, 0), np.delete(answers, 2, 0), rtol=0, atol=1e-10)


class Recorder:
    """Clarabel, with a record of every QP it was given."""

    def __init__(self, solver: QPSolver):
        self._solver, self.seen = solver, []

    def solve(self, qps):
        self.seen.append(qps)
        return self._solver.solve(qps)


class Recorded(Method):
    """The baseline with one engine, whose step QPs are recorded."""

    name, title, description = "recorded", "Recorded", "a record of the step QPs"

    def __init__(self):
        self.seen = []

    def plan(self, problem: Problem) -> Plans:
        [checker] = problem.checkers
        rows = row_count(problem.settings, checker.executor.sizes[1])
        solver = Recorder(make_solver(problem.settings, rows))
        plans, work = problem.empty_plans(), Work(problem.to_plan.tolist(), 1)
        Engine(problem, checker, solver, BASELINE, plans, work).run()
        self.seen = solver.seen
        return plans


def recorded(settings, margin_m) -> StepQP:
    """Step QPs of a few hard poses."""
    scene = gp50(), load_workpiece()
    hard = [(0.8, -0.3), (0.7, 0.3), (0.6, 0.0), (0.2, -0.3)]
    method = Recorded()
    scenarios = [make_scenario(*scene, START, rotation=r, margin_m=margin_m) for r in hard]
    plan(Problem.of(*scene, scenarios, settings), method)
    return jax.tree.map(lambda *part: np.concatenate(part), *method.seen)


@pytest.mark.parametrize(
    ("settings", "margin_m", "least"),
    [(Settings(), 5e-4, 30), (Settings(**made_once.PAPER_CHOICES), 0.0, 0)],
)
def test_it_agrees_with_clarabel_on_the_step_qps_of_real_plans(settings, margin_m, least):
    qps = recorded(settings, margin_m)
    assert len(qps.b) > 200
    tighter = qps._replace(h=qps.h - 0.05)  # as if the wall were 5 cm nearer: then many are infeasible
    qps = jax.tree.map(lambda a, b: np.concatenate([a, b]), qps, tighter)
    ours = solved(qps)
    theirs = ClarabelSolver(WEIGHTS, qps.h.shape[1], tolerance=1e-10).solve(qps)
    np.testing.assert_array_equal(ours.status, theirs.status)
    assert (theirs.status == QPStatus.INFEASIBLE).sum() >= least
    np.testing.assert_allclose(ours.y, theirs.y, rtol=0, atol=1e-6)


def test_planning_with_it_tracks_the_same_targets_and_does_not_depend_on_the_batch():
    scene, settings = (gp50(), load_workpiece()), Settings(qp="device")
    scenarios = [
        make_scenario(*scene, START, rotation=r, margin_m=5e-4, number=k)
        for k, r in enumerate([(0.4, 0.1), (0.8, -0.3), (0.7, 0.3)])
    ]
    device = plan(Problem.of(*scene, scenarios, settings, execution=Execution(threads=2)), "nspace-sqp")
    host = plan(Problem.of(*scene, stack(scenarios), Settings()), "nspace-sqp")
    np.testing.assert_array_equal(device.status == Status.NOT_ATTEMPTED, host.status == Status.NOT_ATTEMPTED)
    alone = plan(Problem.of(*scene, scenarios[1:2], settings), "nspace-sqp")
    for name in ("x", "status", "clearance", "iterations"):
        np.testing.assert_array_equal(getattr(alone, name)[0], getattr(device, name)[1], err_msg=name)
