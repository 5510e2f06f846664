"""Margin: no planner accepts a target with less clearance than the job requires.

Scenarios that are not planned give the reason: a start in collision, or a target out of reach.
"""

from functools import cache

import made_once
import numpy as np
import pytest
import stranger_jobs

import htcp_jax
from htcp_jax.model.scenario import OutOfReach, make_scenario, stack
from htcp_jax.model.task import TCP_POSITION
from htcp_jax.motion.plans import is_tracked
from htcp_jax.planning.batch import plan
from htcp_jax.planning.registry import names
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.runs.summary import summarise
from htcp_jax.settings import Settings
from htcp_jax.status import Status
from htcp_jax.validation import validate_results

SLOW = {"nspace-ip", "nspace-cmaes", "nspace-adam", "hybrid", "nspace-sample"}


def scene():
    return made_once.robot(), made_once.duct()


@cache
def tight(margin_m):
    """Scenarios in which every planner comes close to the wall."""
    return [
        make_scenario(*scene(), made_once.START, rotation=rotation, margin_m=margin_m, number=k)
        for k, rotation in enumerate([(0.8, -0.3), (0.4, 0.1), (0.2, -0.2)])
    ]


@pytest.mark.parametrize("method", [pytest.param(m, marks=pytest.mark.slow if m in SLOW else ()) for m in names()])
def test_no_tracked_target_has_less_than_the_margin(method):
    """Regression: with a margin of 0.5 mm, targets had 0.0461 mm of clearance without any message."""
    margin_m = 2e-3
    plans = plan(*scene(), tight(margin_m), method)
    tracked = is_tracked(plans.status)
    assert tracked.sum() > 150 and not tracked.all()
    assert plans.clearance[tracked].min() >= margin_m
    assert (plans.path_clear[tracked] == 1).all()


def test_on_the_device_too():
    """Check the margin with step QPs on the device, which have the same success criterion as on the host."""
    plans = plan(*scene(), tight(2e-3), "baseline", Settings(qp="device"))
    assert plans.clearance[is_tracked(plans.status)].min() >= 2e-3


def test_a_margin_of_nothing_asks_for_a_clearance_above_zero():
    clearance = np.array([-1e-9, 0.0, 1e-12, 5e-4, 4.999e-4])
    np.testing.assert_array_equal(
        TCP_POSITION.is_satisfied(clearance, np.zeros(()), np.zeros(())), [False, False, True, True, True]
    )
    np.testing.assert_array_equal(
        TCP_POSITION.is_satisfied(clearance, np.zeros(()), np.array(5e-4)), [False, False, False, True, False]
    )


def test_what_is_reachable_keeps_the_margin_too():
    near = reachable_prefixes(*scene(), stack(tight(0.0)[:1]), resolution_rad=0.45, proof_cells=0).prefix
    far = reachable_prefixes(*scene(), stack(tight(0.03)[:1]), resolution_rad=0.45, proof_cells=0).prefix
    assert 0 < far[0] < near[0]


COLLIDES = (0.1, -1.6, 0.3, 0.0, 0.4, -2.0)


@pytest.mark.parametrize("method", ["baseline", "nspace-sqp", pytest.param("hybrid", marks=pytest.mark.slow)])
def test_a_start_in_collision_is_a_scenario_without_targets(method):
    """Regression: such scenarios were "complete" after a jump of 0.94 rad. A valid one in the batch is unaffected."""
    good = tight(5e-4)[1]
    bad = make_scenario(*scene(), COLLIDES, margin_m=5e-4, number=7)
    plans = plan(*scene(), [bad, good], method)
    assert plans.status[0, 0] == Status.START_IN_COLLISION and (plans.status[0, 1:] == Status.NOT_ATTEMPTED).all()
    assert summarise(plans).failures[0].status == Status.START_IN_COLLISION
    alone = plan(*scene(), [good], method)
    np.testing.assert_array_equal(plans.x[1], alone.x[0])


def test_a_target_out_of_reach_is_a_scenario_without_targets():
    """Regression: one pose out of reach ended the complete sweep."""
    with pytest.raises(OutOfReach, match="reaches"):
        make_scenario(*scene(), made_once.START, shift=(5.0, 0.0, 0.0))
    far = make_scenario(*scene(), made_once.START, shift=(5.0, 0.0, 0.0), beyond_reach="record")
    plans = plan(*scene(), [far, tight(5e-4)[1]], "baseline")
    assert plans.status[0, 0] == Status.OUT_OF_REACH and (plans.status[0, 1:] == Status.NOT_ATTEMPTED).all()
    assert is_tracked(plans.status[1]).all()


@pytest.mark.slow
def test_a_plan_that_leaves_its_start_says_so_and_its_way_there_is_clear(tmp_path):
    """Regression: hybrid continued from a configuration other than the given start without a message.

    MuJoCo and the triangles of the mesh check the segment to it at 1,000 samples.
    """
    job = stranger_jobs.box_job(tmp_path)
    plan = htcp_jax.plan(job, method="hybrid")
    assert plan.plans.joint_step[0, 0] > 0.1 and plan.plans.path_clear[0, 0] == 1
    assert " rad to the first configuration, by " in plan.facts()["transfer"]
    plan.save(tmp_path / "out")
    found = validate_results(tmp_path / "out", between=1000).methods["hybrid"]
    assert found.refuted == 0 and found.paths_touching == 0 and found.paths == found.checked == 52
