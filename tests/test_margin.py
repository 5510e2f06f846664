"""Margin: no planner accepts a target with less clearance than the job requires.

Scenarios that are not planned give the reason: a start in collision, or a target out of reach.
"""

from dataclasses import replace
from functools import cache

import made_once
import numpy as np
import pytest
import stranger_jobs
import toy

import htcp_jax
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import OutOfReach
from htcp_jax.model.task import TCP_POSITION
from htcp_jax.motion.plans import is_tracked
from htcp_jax.planning.registry import names
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.runs.summary import summarise
from htcp_jax.status import Status
from htcp_jax.validation import validate_results

MARGIN_M = 0.01


@cache
def tight(margin_m):
    """Scenarios in which every planner comes close to the shelf."""
    poses = {"rotation": (0.0, 0.0)}, {"rotation": (0.1, 0.3)}, {"rotation": (-0.1, -0.3)}, {"shift": (0.0, 0.05, 0.03)}
    return tuple(toy.scenario(k, margin_m=margin_m, **pose) for k, pose in enumerate(poses))


def smallest(plans, scenarios):
    """Minimum clearance [m] of the tracked targets, by brute force."""
    rows = zip(scenarios, plans.x, plans.tracked, strict=True)
    return min(toy.measured(one, x[tracked])[0].min() for one, x, tracked in rows)


@pytest.mark.parametrize("method", names())
def test_no_tracked_target_has_less_than_the_margin(method):
    """Regression: with a margin of 0.5 mm, targets had 0.0461 mm of clearance without any message.

    Without a margin every method comes closer.
    """
    plans, free = (toy.planned(tight(margin_m), method, threads=1) for margin_m in (MARGIN_M, 0.0))
    tracked = is_tracked(plans.status)
    assert (tracked.sum(axis=1) > 1).all() and not tracked.all()
    assert plans.clearance[tracked].min() >= MARGIN_M and smallest(plans, tight(MARGIN_M)) >= MARGIN_M - 1e-14
    assert (plans.path_clear[tracked] == 1).all()
    assert 0 < smallest(free, tight(0.0)) < MARGIN_M


def test_on_the_device_too():
    """Check the margin with step QPs on the device, which have the same success criterion as on the host."""
    settings = replace(toy.SETTINGS, qp="device", path_check="none")
    plans = toy.planned(tight(MARGIN_M), "baseline", settings, threads=1)
    assert plans.tracked.sum() > 10 and smallest(plans, tight(MARGIN_M)) >= MARGIN_M - 1e-14


def test_a_margin_of_nothing_asks_for_a_clearance_above_zero():
    clearance = np.array([-1e-9, 0.0, 1e-12, 5e-4, 4.999e-4])
    np.testing.assert_array_equal(
        TCP_POSITION.is_satisfied(clearance, np.zeros(()), np.zeros(())), [False, False, True, True, True]
    )
    np.testing.assert_array_equal(
        TCP_POSITION.is_satisfied(clearance, np.zeros(()), np.array(5e-4)), [False, False, False, True, False]
    )


def test_what_is_reachable_keeps_the_margin_too():
    scenarios = stack([toy.scenario(0, margin_m=0.0), toy.scenario(1, margin_m=0.07)])
    found = reachable_prefixes(toy.robot(), toy.workpiece(), scenarios, toy.SETTINGS, resolution_rad=0.9, proof_cells=0)
    near, far = found.prefix
    assert 0 < far < near


@pytest.mark.parametrize("method", ["baseline", "nspace-sqp", "hybrid"])
def test_a_start_in_collision_is_a_scenario_without_targets(method):
    """Regression: such scenarios were "complete" after a jump of 0.94 rad. A valid one in the batch is unaffected."""
    good, x = tight(5e-4)[1], made_once.configurations(toy.robot(), 256)
    touching = x[np.argmin(toy.measured(good, x)[0])]
    bad = toy.scenario(7, start=touching, rotation=(0.1, 0.3), margin_m=5e-4)
    plans = toy.planned([bad, good], method, threads=1)
    assert plans.status[0, 0] == Status.START_IN_COLLISION and (plans.status[0, 1:] == Status.NOT_ATTEMPTED).all()
    assert summarise(plans).failures[0].status == Status.START_IN_COLLISION
    alone = toy.planned(good, method, threads=1)
    np.testing.assert_array_equal(plans.x[1], alone.x[0])


def test_a_target_out_of_reach_is_a_scenario_without_targets():
    """Regression: one pose out of reach ended the complete sweep."""
    with pytest.raises(OutOfReach, match="reaches"):
        toy.scenario(shift=(5.0, 0.0, 0.0))
    far = toy.scenario(shift=(5.0, 0.0, 0.0), beyond_reach="record")
    plans = toy.planned([far, tight(5e-4)[1]], "baseline", threads=1)
    assert plans.status[0, 0] == Status.OUT_OF_REACH and (plans.status[0, 1:] == Status.NOT_ATTEMPTED).all()
    assert is_tracked(plans.status[1])[:3].all()


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
