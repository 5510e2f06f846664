"""Published arms, unmodified: capsules that enclose every triangle, and a job planned with them."""

import numpy as np
import pytest
from enclosed import are_enclosed
from published import MODELS, path_of
from small_cell import small_job

import htcp_jax
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_capsules_hold_every_triangle_tightly(name):
    """Capsules around every triangle, with at most 2.5 times the convex hull's volume in the mean."""
    arm = import_robot(path_of(name), MODELS[name].tcp)
    fitted = [cover for cover in arm.covers.values() if cover.fitted]
    assert fitted and all(are_enclosed(cover.enclosed, list(cover.fitted.values())) for cover in fitted)
    assert np.mean([cover.ratio for cover in fitted]) <= 2.5


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_a_job_is_planned(name, tmp_path):
    arm = tmp_path / "arm.xml"
    arm.write_text(arm_xml(import_robot(path_of(name), MODELS[name].tcp), name))
    plan = htcp_jax.plan(small_job(arm, tmp_path, MODELS[name].out), method="baseline")
    assert plan.complete and plan.summary.tracked == len(plan.plans.target[0])


@pytest.mark.parametrize("name", ["panda", "fetch"])
def test_one_capsule_a_body_holds_it_too(name):
    arm = import_robot(path_of(name), MODELS[name].tcp, most=1)
    fitted = [cover for cover in arm.covers.values() if cover.fitted]
    assert all(len(cover.fitted) == 1 and are_enclosed(cover.enclosed, list(cover.fitted.values())) for cover in fitted)
    assert ("torso_lift_joint" in arm.joint_names) == (name == "fetch")
    assert {"panda": "panda_finger_joint1", "fetch": "r_wheel_joint"}[name] in arm.frozen
