"""Colliding body, contact point and depth at a failed target, as brute force finds them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from hand_made import plans_with
from made_once import START, robot
from made_plan import made_plan

from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.model import Workpiece
from htcp_jax.model.duct import duct_cloud, weld
from htcp_jax.model.kinematics import capsule_segments, tcp_position
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.reachability.obstruction import blocked_target, obstruction, obstructions
from htcp_jax.settings import Settings
from htcp_jax.status import Status

TARGETS = 4, 40, 80, 104
SETTINGS = Settings()


@pytest.fixture(scope="module")
def workpiece():
    return Workpiece("duct", duct_cloud(3000), weld(), inlet=(0.0, 0.0, 0.19138), interior="none")


@pytest.fixture(scope="module")
def scenario(workpiece):
    return make_scenario(robot(), workpiece, START)


def nearest(x, scenario, workpiece):
    """Smallest distance of each body to the cloud by brute force, and the nearest point of the cloud."""
    p, q = map(np.asarray, capsule_segments(robot(), jnp.asarray(x)))
    T = np.asarray(scenario.T_world_workpiece)
    cloud = workpiece.cloud @ T[:3, :3].T + T[:3, 3]
    along = (q - p)[:, None]
    square = np.maximum((along**2).sum(axis=2), 1e-300)
    s = np.clip(((cloud[None] - p[:, None]) * along).sum(axis=2) / square, 0, 1)
    apart = np.linalg.norm(p[:, None] + s[..., None] * along - cloud[None], axis=2)
    return apart.min(axis=1) - np.asarray(robot().capsule_radius), cloud[apart.argmin(axis=1)]


@pytest.mark.parametrize("target", TARGETS)
def test_the_body_the_place_and_the_depth_are_those_of_brute_force(target, scenario, workpiece):
    """Body, point, depth and residual at a target, by brute force."""
    found = obstruction(robot(), workpiece, scenario, np.array(START), target, SETTINGS)
    distance, points = nearest(found.x, scenario, workpiece)
    worst = int(distance.argmin())
    assert found.body == robot().capsule_names[worst]
    np.testing.assert_allclose(found.depth_m, -distance[worst], atol=1e-12)
    np.testing.assert_allclose(found.point, points[worst], atol=1e-9)
    off = np.linalg.norm(tcp_position(robot(), jnp.asarray(found.x)) - scenario.targets[target])
    np.testing.assert_allclose(found.residual_m, off, atol=1e-12)
    assert found.reached == (off <= SETTINGS.tolerance_m)


def test_the_arm_is_brought_to_where_the_task_is_held():
    """Configuration of the obstruction with an orientation task: the cone holds, where a free tool leaves it."""
    rows = [{"point": "tcp", "on": "path"}, {"axis": "tcp.z", "towards": "-path.normal", "cone_deg": 40}]
    job = load_config({"task": rows})
    arm, part, scenario = scene(job)
    task, known = task_of_job(job, arm), (arm, part, scenario, np.array(START), 60, SETTINGS)
    held = obstruction(*known, task=task)
    anywhere = scenario.task_goals.copy()
    anywhere[:, -1] = np.pi  # a cone of 180 degrees
    free = obstruction(arm, part, replace(scenario, task_goals=anywhere), *known[3:], task=task)
    measure, goal = made_once.quick_jit(task.residual_at), jnp.asarray(scenario.task_goals[60])
    off = [float(measure(arm, jnp.asarray(found.x), goal)) for found in (held, free)]
    assert held.reached and off[0] <= SETTINGS.tolerance_m < off[1]


def test_a_pose_out_of_reach_is_off_by_a_length_and_an_angle():
    """Distance and angle from an unreached pose, separately (regression: one length that combined both)."""
    rows = [{"point": "tcp", "on": "path"}, {"orientation": [1.0, 0.0, 0.0, 0.0]}]
    job = load_config({"task": rows})
    arm, part, scenario = scene(job)
    targets, goals = scenario.targets.copy(), scenario.task_goals.copy()
    targets[60] = goals[60, :3] = [0.0, 0.0, 9.0]
    far = replace(scenario, targets=targets, task_goals=goals)
    found = obstruction(arm, part, far, np.array(START), 60, SETTINGS, task=task_of_job(job, arm))
    off = np.linalg.norm(np.asarray(tcp_position(arm, jnp.asarray(found.x))) - targets[60])
    assert not found.reached and found.residual_m == pytest.approx(off, abs=1e-9) and found.angle_rad > 1e-3
    assert " mm and " in found.description and " deg of the target" in found.description


def test_hundreds_at_once_are_each_as_alone(scenario, workpiece):
    rows = np.array(TARGETS * 50)
    inputs = lane_inputs(stack([scenario]), np.zeros(len(rows), int), rows)
    x = np.tile(START, (len(rows), 1))
    together = obstructions(robot(), make_obstacle(workpiece), inputs, x, inputs.target, SETTINGS)
    alone = [obstruction(robot(), workpiece, scenario, np.array(START), target, SETTINGS) for target in TARGETS]
    for one, other in zip(together, alone * 50, strict=True):
        jax.tree.map(np.testing.assert_array_equal, one._asdict(), other._asdict())


def test_the_sentence_tells_how_deep_how_free_or_how_far_off(scenario, workpiece):
    found = obstruction(robot(), workpiece, scenario, np.array(START), 80, SETTINGS)
    where = {"point": np.array([0.81, 0.1, 0.42]), "reached": True}
    known = found._replace(body="spindle", body_label="capsule spindle", **where)
    inside = known._replace(depth_m=0.0032).description
    assert inside == "capsule spindle is 3.2 mm inside the workpiece at (0.81, 0.10, 0.42) m there"
    clear = known._replace(depth_m=-0.0032)
    assert clear.heading == "closest approach"
    assert clear.description.startswith("no body collides; capsule spindle comes within 3.2 mm of the workpiece at")
    begin = "inverse kinematics from the last configuration comes only to within"
    end = "another configuration may reach it"
    off = known._replace(reached=False, residual_m=0.054)
    assert off.description == f"{begin} 54 mm of the target; {end}"
    turned = off._replace(angle_rad=0.1, within_bands=False).description
    assert turned == f"{begin} 54 mm and 5.73 deg of the target, outside of the task's cones and bands; {end}"


def test_a_body_that_is_clear_of_everything_is_no_cause(scenario, workpiece):
    """Cause of a failure where no body collides: never a body that is clear by 41 mm (regression)."""
    found = obstruction(robot(), workpiece, scenario, np.array(START), 80, SETTINGS)
    known, ended = found._replace(body="spindle", body_label="", reached=True), Status.QP_INFEASIBLE.ended
    assert known._replace(depth_m=0.003).cause(ended) == "spindle"
    assert known._replace(depth_m=-0.041).cause(ended) == "step QP infeasible"
    assert known._replace(depth_m=-0.041).description.startswith("no body collides")
    assert known._replace(depth_m=0.003, reached=False).cause(ended) == "not reached"


def test_a_target_out_of_reach_says_by_how_much(scenario, workpiece):
    far = scenario.targets.copy()
    far[5] = [0.0, 0.0, 9.0]
    found = obstruction(
        robot(), workpiece, type(scenario)(**(vars(scenario) | {"targets": far})), np.array(START), 5, SETTINGS
    )
    assert not found.reached and 5 < found.residual_m < 9 and "comes only to within" in found.description


def test_a_body_is_in_collision_at_the_first_failed_target_unless_the_status_says_that_none_is():
    A, LIMIT, NOT, TIP = (Status.TRACKED, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED, Status.TIP_BLOCKED)
    rows = [[A, A, LIMIT, NOT], [LIMIT, NOT, NOT, NOT], [A, A, A, A], [A, A, -1, -1], [A, TIP, NOT, NOT]]
    plans = plans_with(rows, joints=6)
    assert [blocked_target(plans, row) for row in range(len(rows))] == [2, 0, None, None, None]


def test_a_failed_plan_tells_it_in_its_table_its_files_and_its_picture(tmp_path):
    """Colliding body of a failed plan in its table, its record and its picture (regression)."""
    plan = made_plan(tmp_path)
    sentence = plan.obstruction.description
    assert plan.failure()["colliding body"] == sentence
    assert plan.record()["colliding_body"]["description"] == sentence
    texts = [text.get_text() for axes in plan.figure().axes for text in axes.texts]
    assert any(sentence in text for text in texts)
