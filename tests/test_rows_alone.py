"""Rows of a batch: neither the other rows, their order nor the number of threads changes a row's result, bitwise."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
import toy
from hypothesis import given, settings
from hypothesis import strategies as st

from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.device import Executor
from htcp_jax.device.tables import gather
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.joint_search import join
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import ADVANCE, CLEAR, PREPARE, PROVE, SETTLE, TRACK_CHUNK, ProofResolution
from htcp_jax.planning.methods import BUILT_IN, find
from htcp_jax.planning.tracking.stages import ENTER
from htcp_jax.reachability import reachable_prefixes

LANES = 150  # more than a table holds
KERNELS = {
    lane_function.name: lane_function for lane_function in (ADVANCE, PREPARE, TRACK_CHUNK, SETTLE, ENTER, CLEAR, PROVE)
}


@cache
def calls() -> dict[str, tuple]:
    """Tables of a call of each lane function, with lanes of different scenarios and targets."""
    random = np.random.default_rng(0)
    which, row = random.integers(0, len(toy.scenarios()), LANES), random.integers(0, 10, LANES)
    inputs = lane_inputs(stack(toy.scenarios()), which, row)
    a = np.array(toy.START) + random.normal(scale=0.2, size=(LANES, 4))
    b = a + random.normal(scale=0.3, size=a.shape)
    zero = np.zeros(LANES, np.int32)
    state = Executor(toy.scene(), toy.SETTINGS)(ADVANCE, inputs, a, np.zeros_like(a))
    tube = Tube(np.zeros((LANES, 3)), np.zeros((LANES, 3)), np.full(LANES, np.inf))
    closely = ProofResolution(np.zeros(LANES), np.full(LANES, 1e-5), np.full(LANES, 20))
    tables = {
        ADVANCE: (a, b - a),
        PREPARE: (state.x, a, state.linear),
        TRACK_CHUNK: (state.x, a, state.linear, zero),
        SETTLE: (a,),
        ENTER: (a,),
        CLEAR: (a,),
        PROVE: (a, b, tube, closely),
    }
    return {lane_function.name: (inputs, *own) for lane_function, own in tables.items()}


@cache
def results(name: str):
    return Executor(toy.scene(), toy.SETTINGS)(KERNELS[name], *calls()[name])


@pytest.mark.parametrize("name", KERNELS)
@settings(max_examples=10)
@given(rows=st.lists(st.integers(0, LANES - 1), min_size=1, max_size=2 * LANES), threads=st.integers(1, 3))
def test_a_row_of_a_lane_function_does_not_depend_on_the_other_rows_of_its_batch(name, rows, threads):
    """Call with any rows, repeated ones too, in any order: each has the result that it has in the first call."""
    found = Executor(toy.scene(), toy.SETTINGS, threads=threads)(KERNELS[name], *gather(calls()[name], np.array(rows)))
    jax.tree.map(np.testing.assert_array_equal, found, gather(results(name), np.array(rows)))


PAPER = {"path_check": "none", "cost_about": "previous", "clearance_rows": "smallest", "aim_above_m": 0.0}
CASES = {
    **{method.name: (method.name, {}) for method in BUILT_IN},
    **{f"{name} of the paper": (name, PAPER) for name in ("baseline", "cspace-sample", "nspace-sample", "nspace-sqp")},
    "nspace-sqp, tracked after it": ("nspace-sqp", {"path_check": "none", "after_recovery": "track"}),
    "nspace-sqp on the device": ("nspace-sqp", {"path_check": "none", "qp": "device"}),
    "beam, not smoothed": ("beam", {"smooth": False}),
    "beam with transfers": ("beam", {"transfers": True, "smooth": False}),
    "baseline, smoothed": ("baseline", {"smooth": True}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_scenario_s_plan_does_not_depend_on_the_others_of_its_batch(case):
    """Plan all scenarios by one thread, and again by two in the other order, but for two that are planned alone."""
    method, changes = CASES[case]
    chosen, several = replace(toy.SETTINGS, **changes), toy.scenarios()
    together, others = toy.plans_by(method, chosen), [4, 2, 0]
    backwards = toy.planned([several[s] for s in others], method, chosen, threads=2)
    assert together.tracked.any()
    for row, s in enumerate(others):
        toy.same(together, s, backwards, row, int(several[s].count))
    for s in (1, 3):
        toy.same(together, s, toy.planned(several[s], method, chosen, threads=1), 0, int(several[s].count))


def test_a_motion_from_home_does_not_depend_on_the_others_of_its_batch():
    """Scenarios that begin at home, some with a start to choose, next to those without a home."""
    home = (0.5, -0.3, 1.2, 0.4)
    several = (
        toy.scenario(0, home=home),
        toy.scenario(1, start=None, home=home),
        toy.scenario(2, shift=(0.0, 0.05, 0.03)),
        toy.scenario(3, start=None, rotation=(0.1, 0.3), home=home),
    )
    together, others = toy.planned(several, threads=1), toy.planned([several[3], several[0]], threads=2)
    assert (together.executable.sum(axis=1) > 5).all()
    for row, s in enumerate((3, 0)):
        toy.same(together, s, others, row, int(several[s].count))
    for s in (1, 2):
        toy.same(together, s, toy.planned(several[s], threads=1), 0, int(several[s].count))


def test_a_joint_path_does_not_depend_on_the_others_searched_for():
    """Join pairs alone, in another order, repeatedly, and more of them than are searched for at a time."""
    chosen = replace(toy.SETTINGS, search_rounds=30)
    checker, scenarios = CollisionChecker(Executor(toy.scene(), chosen), chosen), stack(toy.scenarios())
    plans = toy.plans_by()

    def joined(pairs):
        which, a = np.array(pairs) % 5, np.tile(toy.START, (len(pairs), 1))
        row = plans.tracked.sum(axis=1)[which] - 1 - np.array(pairs) // 5
        return join(checker, scenarios, which, np.array(pairs), a, plans.x[which, row], chosen)

    whole = joined(range(10))
    assert sum(own is not None and len(own) > 0 for own in whole) >= 3
    for pairs in ([9, 0, 3, 3, 8, 1], [4], [7], [*range(10)] * 4):
        for pair, own in zip(pairs, joined(pairs), strict=True):
            assert (own is None) == (whole[pair] is None)
            assert own is None or np.array_equal(own, whole[pair])


def test_reachability_does_not_depend_on_the_other_scenarios():
    scenarios = toy.scenarios()
    whole = reachable_prefixes(toy.robot(), toy.workpiece(), stack(scenarios), toy.SETTINGS, resolution_rad=0.9)
    for s in (0, 2):
        alone = reachable_prefixes(
            toy.robot(), toy.workpiece(), stack(scenarios[s : s + 1]), toy.SETTINGS, resolution_rad=0.9
        )
        np.testing.assert_array_equal(alone.x[0], whole.x[s, : int(scenarios[s].count)])
        assert alone.prefix[0] == whole.prefix[s] > 5 and alone.most[0] == whole.most[s]
        np.testing.assert_array_equal(alone.best[0], whole.best[s])


def test_the_scenarios_need_all_that_methods_do():
    """Check what makes the tests above count: recoveries, backward chains, via points, transfers, smoothed motions."""
    plain, smooth = toy.plans_by(settings=replace(toy.SETTINGS, smooth=False)), toy.plans_by()
    assert len(plain.via_points.x) > 10 and not np.array_equal(plain.x, smooth.x, equal_nan=True)
    for method in ("nspace-sqp", "cspace-sample"):
        assert toy.plans_by(method, replace(toy.SETTINGS, **PAPER)).recovery.any()
    hybrid = toy.plans_by("hybrid")
    assert (hybrid.recovery == find("hybrid").backwards).any()
