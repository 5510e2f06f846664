"""The engine: who else is in the batch has no influence, nothing compiles twice, one broken QP breaks one scenario."""

import itertools
from dataclasses import replace

import made_once
import numpy as np
import pytest

from htcp_jax.planner import batch, kernels
from htcp_jax.planner.batch import plan
from htcp_jax.planner.engine import Engine
from htcp_jax.planner.lanes import gather
from htcp_jax.scene.robot_file import gp50
from htcp_jax.scene.scenario import make_scenario, stack
from htcp_jax.scene.workpiece_file import load_workpiece
from htcp_jax.settings import Settings
from htcp_jax.solvers.clarabel_ import ClarabelSolver
from htcp_jax.solvers.step_qp import QPSolution, QPStatus
from htcp_jax.status import Status

START = np.array([0.0, -2.3, 0.5, 0.0, 0.5, -2.0])
# With one row and margin 0 the last bit of rounding decides who gets stuck.
PAPER = Settings(**made_once.PAPER_CHOICES)
COMPARED = ("x", "status", "clearance", "residual", "iterations", "escape", "path_clear")


@pytest.fixture(scope="module")
def scene():
    return gp50(), load_workpiece()


def poses(scene, *rotations):
    return [
        make_scenario(*scene, START, rotation=rotation, margin_m=0.0, number=k) for k, rotation in enumerate(rotations)
    ]


@pytest.fixture(scope="module")
def scenarios(scene):
    return poses(scene, (0.4, 0.1), (0.8, -0.3), (0.6, 0.0), (0.2, -0.3), (0.5, 0.2))


@pytest.fixture(scope="module", params=["baseline", "nspace-sqp", "keep-clear", "cspace-sample"])
def planned(request, scene, scenarios):
    return request.param, plan(*scene, scenarios, request.param, PAPER, threads=2)


@pytest.mark.parametrize("method", ["nspace-sqp", "cspace-sample"])
@pytest.mark.parametrize("after_escape", ["accept", "track"])
def test_which_phase_goes_first_has_no_influence(method, after_escape, scene, scenarios, monkeypatch):
    """On a GPU the one that most lanes are in, so that an escape's calls are fewer and fuller; on a CPU all of them."""
    settings, calls = replace(PAPER, after_escape=after_escape), []
    run, turn = kernels.Kernels._run, Engine._turn

    def counted(self, name, tables):
        calls.append((name, len(tables[0].row)))
        return run(self, name, tables)

    def one_turn(self):
        _, counts = np.unique(self._lanes.phase, return_counts=True)
        ((phase, lanes),) = turn(self)
        assert lanes.size == counts.max() and (lanes.phase == phase).all()
        return [(phase, lanes)]

    monkeypatch.setattr(kernels.Kernels, "_run", counted)
    both, all_phases = plan(*scene, scenarios, method, settings, threads=1), list(calls)
    calls.clear()
    monkeypatch.setattr(kernels.Kernels, "pays_by_lane", False)
    monkeypatch.setattr(Engine, "_turn", one_turn)
    same(both, plan(*scene, scenarios, method, settings, threads=1), slice(None), slice(None))
    escape = "walk 0" if method == "nspace-sqp" else "sample 0"
    every, fuller = ([lanes for name, lanes in log if name == escape] for log in (all_phases, calls))
    assert sum(fuller) == sum(every) and len(fuller) < len(every)


def every_other(self, lanes, x, asked):
    """A path check that blocks half of the paths asked about, whichever."""
    if not asked:
        return np.full(len(x), -1, np.int8)
    return (np.floor(1e3 * x[:, -1]) % 2).astype(np.int8)


@pytest.mark.parametrize(("check", "path_check"), [(Engine._path_clear, "none"), (every_other, "escapes")])
def test_the_best_candidate_is_the_nearest_whose_path_is_clear(check, path_check, scene, scenarios, monkeypatch):
    """Of equals the first; and one that is not clear only where none is."""
    best, chosen = Engine._best, []

    def watched(self, lanes, owner, number, x):
        rows, clear = best(self, lanes, owner, number, x)
        all_clear = self._path_clear(gather(lanes, owner), x, self._check_escapes)
        for k, (row, is_clear) in enumerate(zip(rows, clear, strict=True)):
            own = [r for r in np.flatnonzero(owner == k) if all_clear[r]] or list(np.flatnonzero(owner == k))
            assert row in own and is_clear == all_clear[row]
            if is_clear:
                far = [(np.linalg.norm(x[r] - lanes.x_previous[k]), number[r]) for r in own]
                assert (np.linalg.norm(x[row] - lanes.x_previous[k]), number[row]) == min(far)
            chosen.append(len(own))
        return rows, clear

    monkeypatch.setattr(Engine, "_path_clear", check)
    monkeypatch.setattr(Engine, "_best", watched)
    plan(*scene, scenarios, "cspace-sample", replace(PAPER, path_check=path_check), threads=1)
    assert max(chosen) > 1


def test_a_walk_goes_on_from_where_it_came_to(scene, scenarios, monkeypatch):
    """Every null-space step but the first begins where the one before it ended."""
    run, ends = kernels.Kernels._run, {}

    def followed(self, name, tables):
        result = run(self, name, tables)
        if name in ("enter", "walk 0"):
            task = tables[0]
            for k, at in enumerate(zip(task.number.tolist(), task.row.tolist(), strict=True)):
                if name == "walk 0":
                    np.testing.assert_array_equal(tables[2][k], ends[at][-1])
                    assert tables[3][k] == len(ends[at]) - 1
                ends.setdefault(at, []).append(result.x[k])
        return result

    monkeypatch.setattr(kernels.Kernels, "_run", followed)
    plan(*scene, scenarios, "nspace-sqp", PAPER, threads=1)
    assert max(map(len, ends.values())) > 2


def same(a, b, rows_a, rows_b):
    for name in COMPARED:
        np.testing.assert_array_equal(getattr(a, name)[rows_a], getattr(b, name)[rows_b], err_msg=name)


def test_a_scenario_is_planned_the_same_to_the_last_bit_alone_in_a_batch_and_on_one_thread(planned, scene, scenarios):
    method, together = planned
    same(plan(*scene, scenarios[1:2], method, PAPER), together, [0], [1])
    same(plan(*scene, scenarios[::-1], method, PAPER, threads=1), together, slice(None, None, -1), slice(None))


def test_every_tracked_target_is_reached_and_clear_and_nothing_follows_a_failure(planned):
    _, plans = planned
    tracked = plans.status <= Status.TRACKED_AFTER_ESCAPE
    assert (plans.residual[tracked] <= PAPER.tolerance_m).all()
    assert (plans.clearance[tracked] > 0).all()
    assert np.isnan(plans.x[~tracked]).all()
    for row in plans.status:
        after = row[np.argmax(row > Status.TRACKED_AFTER_ESCAPE) + 1 :]
        assert (row <= Status.TRACKED_AFTER_ESCAPE).all() or (after == Status.NOT_ATTEMPTED).all()


def test_the_joint_step_is_the_distance_from_the_configuration_before(planned, scenarios):
    _, plans = planned
    starts = np.stack([s.x_start for s in scenarios])[:, None]
    steps = np.linalg.norm(np.diff(np.concatenate([starts, plans.x], axis=1), axis=1), axis=2)
    np.testing.assert_allclose(steps, plans.joint_step, atol=1e-15)


def test_an_escape_gets_further_than_the_baseline(scene, scenarios):
    tracked = {
        method: (plan(*scene, scenarios, method, PAPER).status <= Status.TRACKED_AFTER_ESCAPE).sum()
        for method in ("baseline", "nspace-sqp")
    }
    assert tracked["nspace-sqp"] > tracked["baseline"] + 20


def test_a_second_plan_compiles_nothing_whatever_the_number_of_scenarios(scene, scenarios):
    plan(*scene, scenarios[:1], "baseline", PAPER)
    before = len(kernels._PROGRAMS)
    again = plan(*scene, scenarios[:3], "baseline", PAPER)
    assert len(kernels._PROGRAMS) == before and again.compile_s == 0


@pytest.mark.skipif(kernels.jax.default_backend() != "cpu", reason="a GPU launches a loop's kernels one by one")
def test_on_a_cpu_a_kernel_is_one_native_function(planned):
    """A library call in a loop, to LAPACK say, would have XLA dispatch its parts one by one: nothing else would
    fail, and everything take twice the time. Those that every method needs, and the walks' way in."""
    tracking = {kernels.prepare, kernels.advance, kernels.check_path}
    kinds = {*tracking, kernels.enter_null_space}
    programs = [(work, program) for (work, *_), program in kernels._PROGRAMS.items() if work in kinds]
    assert tracking <= {work for work, _ in programs}
    for work, program in programs:
        assert " while(" not in program.as_text().partition("\nENTRY ")[2], work.__name__


class Broken(ClarabelSolver):
    """Clarabel that breaks down on every QP of the workpiece pose whose first target step is `victim`."""

    victim: np.ndarray

    def solve(self, qps):
        y, status = super().solve(qps)
        hit = np.isclose(qps.b, self.victim, atol=1e-12).all(axis=1)
        return QPSolution(np.where(hit[:, None], np.nan, y), np.where(hit, QPStatus.FAILED, status))


def test_a_qp_that_breaks_down_fails_its_scenario_and_no_other(scene, scenarios, monkeypatch):
    whole = plan(*scene, scenarios[:3], "baseline", PAPER)
    # Target 1 of scenario 1 is where its first real step goes.
    Broken.victim = scenarios[1].targets[1] - whole.tcp[1, 0]
    monkeypatch.setattr(batch, "make_solver", lambda s, joints, rows: Broken(2 * np.array(s.q_weights), rows))
    broken = plan(*scene, scenarios[:3], "baseline", PAPER)
    same(broken, whole, [0, 2], [0, 2])
    assert broken.status[1, 1] == Status.QP_FAILED
    assert (broken.status[1, 2:] == Status.NOT_ATTEMPTED).all()


def test_candidates_of_a_sampling_escape_never_depend_on_the_order_of_scenarios(scene, scenarios):
    few = Settings(**made_once.PAPER_CHOICES, samples=6, sample_steps=20)
    one = plan(*scene, scenarios[1:3], "nspace-sample", few)
    other = plan(*scene, scenarios[2:0:-1], "nspace-sample", few)
    same(one, other, [0, 1], [1, 0])


@pytest.mark.slow
@pytest.mark.parametrize("method", ["baseline", "nspace-sqp"])
def test_a_hundred_starts_in_one_call_are_planned_as_each_is_alone(scene, method):
    offsets = itertools.islice(itertools.product((-0.2, -0.1, 0.0, 0.1, 0.2), repeat=3), 100)
    many = [
        make_scenario(*scene, START + np.array([0, 0, *offset, 0]), margin_m=0.0, number=k)
        for k, offset in enumerate(offsets)
    ]
    together = plan(*scene, stack(many), method, PAPER, check_paths=False)
    for k, one in enumerate(many):
        same(plan(*scene, [one], method, PAPER, check_paths=False), together, [0], [k])
