"""Planning engine: results do not depend on the batch, nothing compiles twice, a failed QP fails one scenario only."""

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import jax
import made_once
import numpy as np
import pytest

from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.device.kernel import STEP, Kernel
from htcp_jax.device.programs import PROGRAMS, Kernels, Programs
from htcp_jax.device.tables import gather_from
from htcp_jax.io.robot_file import gp50
from htcp_jax.io.workpiece_file import load_workpiece
from htcp_jax.model.scenario import make_scenario, stack
from htcp_jax.motion.kernels import ADVANCE, ADVANCE_SMALLEST, CHECK_PATH, PREPARE, STEPS_A_BURST
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.planning.batch import plan
from htcp_jax.planning.tracking import step_qps
from htcp_jax.planning.tracking.candidates import nearest
from htcp_jax.planning.tracking.engine import Engine
from htcp_jax.planning.tracking.stages import ENTER
from htcp_jax.planning.tracking.work import Work
from htcp_jax.settings import Settings
from htcp_jax.solvers.clarabel_ import ClarabelSolver
from htcp_jax.solvers.step_qp import QPSolution, QPStatus
from htcp_jax.status import Status

START = np.array([0.0, -2.3, 0.5, 0.0, 0.5, -2.0])
# With one row and margin 0 the last bit of rounding decides which scenarios get stuck.
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


@pytest.fixture
def calls(monkeypatch):
    """Log of all further kernel calls: name, tables, and result."""
    run, made = Kernels.__call__, []

    def followed(self, kernel, *tables):
        result = run(self, kernel, *tables)
        made.append((kernel.name, tables, result))
        return result

    monkeypatch.setattr(Kernels, "__call__", followed)
    return made


@pytest.mark.parametrize("method", ["nspace-sqp", "cspace-sample"])
@pytest.mark.parametrize("after_escape", ["accept", "track"])
def test_which_phase_goes_first_has_no_influence(method, after_escape, scene, scenarios, calls, monkeypatch):
    """Compare both orders: a GPU runs the phase with most lanes, with fewer, fuller calls; a CPU runs all phases."""
    settings = replace(PAPER, after_escape=after_escape)
    together, all_phases = plan(*scene, scenarios, method, settings, threads=1), list(calls)
    calls.clear()
    monkeypatch.setattr(Kernels, "pays_by_lane", False)
    same(together, plan(*scene, scenarios, method, settings, threads=1), slice(None), slice(None))
    escape = "walk 0" if method == "nspace-sqp" else "sample 0"
    every, fuller = ([len(tables[0].row) for name, tables, _ in log if name == escape] for log in (all_phases, calls))
    assert sum(fuller) == sum(every) and len(fuller) < len(every)


def test_the_best_candidate_is_the_nearest_whose_path_is_clear():
    """Check ties and path flags: the first of equal candidates wins, unchecked paths (-1) count as clear."""
    random = np.random.default_rng(0)
    for _ in range(200):
        owner = np.sort(random.integers(0, 4, 12))
        number = np.concatenate([random.permutation(count) for count in np.unique(owner, return_counts=True)[1]])
        change = random.choice([0.1, 0.2, 0.3], 12)
        clear = random.choice([-1, 0, 0, 1], 12)
        for who, best in zip(np.unique(owner), nearest(owner, number, change, clear), strict=True):
            own = np.flatnonzero(owner == who)
            good = [k for k in own if clear[k]]
            assert best in own
            if good:
                assert best == min(good, key=lambda k: (change[k], number[k]))


def test_a_walk_goes_on_from_where_it_came_to(scene, scenarios, calls):
    """Check that each chunk of null-space steps continues from the configuration and step count of the previous one."""
    plan(*scene, scenarios, "nspace-sqp", PAPER, threads=1)
    ends, longest = {}, 0
    for name, (inputs, *tables), result in calls:
        if name not in ("enter", "walk 0"):
            continue
        now, walked = result if name == "walk 0" else (result, np.zeros(len(inputs.row), int))
        for k, at in enumerate(zip(inputs.number.tolist(), inputs.row.tolist(), strict=True)):
            if name == "walk 0":
                np.testing.assert_array_equal(tables[1][k], ends[at][0])
                assert tables[2][k] == ends[at][1] < walked[k] <= ends[at][1] + STEPS_A_BURST
            ends[at] = now.x[k], walked[k]
            longest = max(longest, walked[k])
    assert longest > STEPS_A_BURST


def same(a, b, rows_a, rows_b):
    for name in COMPARED:
        np.testing.assert_array_equal(getattr(a, name)[rows_a], getattr(b, name)[rows_b], err_msg=name)


def test_a_scenario_is_planned_the_same_to_the_last_bit_alone_in_a_batch_and_on_one_thread(planned, scene, scenarios):
    method, together = planned
    same(plan(*scene, scenarios[1:2], method, PAPER), together, [0], [1])
    same(plan(*scene, scenarios[::-1], method, PAPER, threads=1), together, slice(None, None, -1), slice(None))


@pytest.mark.parametrize("method", ["nspace-sqp", "cspace-sample"])
def test_an_engine_without_work_goes_on_with_lanes_of_another(method, scene, scenarios, monkeypatch):
    """Check equal results when lanes move between engines in any phase."""
    alone = plan(*scene, scenarios, method, PAPER, threads=1)
    left, leave = [], Work.leave
    monkeypatch.setattr(Work, "leave", lambda self, lanes: left.append(lanes) or leave(self, lanes))
    same(alone, plan(*scene, scenarios, method, PAPER, threads=4), slice(None), slice(None))
    assert sum(lanes.size for lanes in left) > 0
    if method == "cspace-sample":
        assert any((lanes.candidate >= 0).any() for lanes in left)


@pytest.mark.parametrize("before_others_begin", [False, True])
def test_an_engine_that_breaks_lets_the_others_end(before_others_begin, scene, scenarios, monkeypatch):
    """Check that waiting engines end when one fails, also if it fails before the others have begun."""
    broken, advance, begun = threading.Event(), Engine._advance, ThreadPoolExecutor.submit

    def breaking(self, phase, lanes):
        if not broken.is_set():
            broken.set()
            raise ArithmeticError("broken")
        advance(self, phase, lanes)

    def after_the_first(self, *call):
        future = begun(self, *call)
        if before_others_begin and not broken.is_set():
            wait([future])
        return future

    monkeypatch.setattr(Engine, "_advance", breaking)
    monkeypatch.setattr(ThreadPoolExecutor, "submit", after_the_first)
    with pytest.raises(ArithmeticError, match="broken"):
        plan(*scene, scenarios, "baseline", PAPER, threads=3)


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
    before = len(PROGRAMS)
    again = plan(*scene, scenarios[:3], "baseline", PAPER)
    assert len(PROGRAMS) == before and again.compile_s == 0


@pytest.mark.parametrize("method", ["cspace-sample", "nspace-cmaes"])
def test_another_seed_compiles_nothing_and_draws_others(method, scene, scenarios):
    few = replace(PAPER, samples=8, population=8)
    first, before = plan(*scene, scenarios[:2], method, few), len(PROGRAMS)
    other = plan(*scene, scenarios[:2], method, replace(few, seed=1))
    assert len(PROGRAMS) == before and other.compile_s == 0
    assert not np.array_equal(first.x, other.x, equal_nan=True)


def test_a_setting_compiles_the_kernels_that_read_it_and_no_others(scene, scenarios):
    plan(*scene, scenarios[:2], "cspace-sample", replace(PAPER, samples=8))
    before = len(PROGRAMS)
    plan(*scene, scenarios[:2], "cspace-sample", replace(PAPER, samples=9))
    assert len(PROGRAMS) == before + 1  # the kernel that draws the samples
    plan(*scene, scenarios[:2], "cspace-sample", replace(PAPER, samples=9, max_null_space_steps=7, population=9))
    assert len(PROGRAMS) == before + 1


def test_a_kernel_sees_no_setting_that_it_does_not_name():
    """Check that reading an undeclared setting fails: programs are shared by declared settings only."""
    reads = lambda settings, *_: settings.alpha_rad + settings.samples  # noqa: E731
    kernel, lane = Kernel("mine", reads, STEP, ("alpha_rad",)), made_once.nominal()
    with pytest.raises(AttributeError, match="kernel 'mine' reads the setting samples, which it does not name"):
        kernel.of(PAPER)(made_once.scene(), lane)


def test_programs_can_be_given_back(scene, scenarios):
    programs = Programs()
    kernels = Kernels(Scene(scene[0], make_obstacle(scene[1])), PAPER, programs=programs)
    inputs = lane_inputs(stack(scenarios), np.arange(2), np.zeros(2, int))
    x = np.stack([START, START])
    there = kernels(ADVANCE, inputs, x, np.zeros_like(x))
    assert len(programs) == 1 and kernels.compile_s > 0
    programs.clear()
    assert len(programs) == 0
    np.testing.assert_array_equal(kernels(ADVANCE, inputs, x, np.zeros_like(x)).x, there.x)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="a GPU launches a loop's kernels one by one")
def test_on_a_cpu_a_kernel_is_one_native_function(planned):
    """Check the kernels that every method needs, and the start of self-motions, for loops outside native code.

    A library call in a loop, for example to LAPACK, would make XLA dispatch its parts one by one. No other test would
    fail, and everything would take twice the time.
    """
    programs = PROGRAMS.of(PREPARE, ADVANCE, ADVANCE_SMALLEST, CHECK_PATH, ENTER)
    assert {kernel.name for kernel, _ in programs} >= {"prepare", "advance", "check_path"}
    for kernel, program in programs:
        assert " while(" not in program.as_text().partition("\nENTRY ")[2], kernel.name


class Broken(ClarabelSolver):
    """Clarabel solver that fails on every QP whose TCP step (right-hand side b) is `victim`."""

    victim: np.ndarray

    def solve(self, qps):
        y, status = super().solve(qps)
        hit = np.isclose(qps.b, self.victim, atol=1e-12).all(axis=1)
        return QPSolution(np.where(hit[:, None], np.nan, y), np.where(hit, QPStatus.FAILED, status))


def test_a_qp_that_breaks_down_fails_its_scenario_and_no_other(scene, scenarios, monkeypatch):
    whole = plan(*scene, scenarios[:3], "baseline", PAPER)
    # The first actual step of scenario 1 leads to target 1.
    Broken.victim = scenarios[1].targets[1] - whole.tcp[1, 0]
    monkeypatch.setattr(step_qps, "make_solver", lambda s, joints, rows, *_: Broken(2 * np.array(s.q_weights), rows))
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


def test_rows_of_many_places_come_in_their_order():
    """Compare rows gathered from two alternating tables, some selections empty, with plain concatenation."""
    rng = np.random.default_rng(0)
    tables = [(rng.normal(size=(9, 2)), rng.integers(0, 99, 9)) for _ in range(2)]
    places = [(tables[k % 2], rng.integers(0, 9, k % 4)) for k in range(1, 12)]
    found = gather_from(places)
    for column, own in enumerate(found):
        np.testing.assert_array_equal(own, np.concatenate([table[column][rows] for table, rows in places]))
