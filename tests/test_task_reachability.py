"""Reachability with a task, and approaches in free space: all results satisfy every row, by MuJoCo's poses."""

from dataclasses import replace

import numpy as np
import pytest
from small_motions import SMALL, check_segment, first_of, segments

from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.model.scenario import stack
from htcp_jax.motion import Execution, Problem
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.transfers import other_configurations
from htcp_jax.planning.batch import plan
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.reachability.configuration_search import ConfigurationSearch
from htcp_jax.spec import GP50
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.records import data_of
from htcp_jax.validation.task_check import PartPose, check_rows

ON_PATH = {"point": "tcp", "on": "path"}
CONE = {"axis": "tcp.z", "towards": "-path.normal", "cone_deg": 40}
SQUARE = {"axis": "tcp.z", "towards": [0.8, -0.6, 0.0]}
HOME = (0.9, -2.0, 0.2, 0.3, 0.9, -1.0)


def job_of(task, **more):
    return load_config({"task": task, "method": "beam", **more})


def broken(job, part, one, x, t):
    """Violated rows of the job's task at configurations x and targets t of the path, in words."""
    T = np.asarray(one.T_world_workpiece)
    place = PartPose(T[:3, :3], T[:3, 3], data_of(part), np.maximum(t - int(one.on_path), 0))
    arm = MujocoArm(GP50, limits="simulation")
    checks = check_rows(job.task, arm, x, place, job.settings.tolerance_m, job.settings.tolerance_rad)
    return [why for n, row in enumerate(checks, 1) for k in range(len(x)) if (why := row.reason(n, k))]


def reached(task, targets, **more):
    job = job_of(task)
    robot, part, one = scene(job)
    one = first_of(one, targets)
    found = reachable_prefixes(robot, part, stack([one]), job.settings, task=task_of_job(job, robot), **more)
    t = np.arange(int(one.on_path), int(found.prefix[0]))
    assert not broken(job, part, one, found.x[0, t], t)
    return found, one


@pytest.mark.slow
def test_what_is_reachable_in_a_cone_is_in_it_and_what_is_not_is_proven_so():
    """Reachability bounds with a cone; with a free tool orientation all of the path is reachable in this pose."""
    found, one = reached([ON_PATH, CONE], 56, resolution_rad=0.3)
    assert one.on_path < found.prefix[0] <= found.most[0] < one.count
    assert reached([ON_PATH], 56, resolution_rad=0.3, proof_cells=0)[0].prefix[0] == one.count


@pytest.mark.slow
def test_a_task_that_holds_the_tcp_nowhere_is_searched_from_configurations_all_over():
    plane = {"point": "tcp", "on": "plane", "through_m": [1.2, 0.0, 0.0], "normal": [1, 0, 0]}
    job = job_of([plane, {**CONE, "towards": [1, 0, 0], "cone_deg": 20}])
    robot, part, one = scene(job)
    problem = problem_of(job, robot, part, one)
    inputs = lane_inputs(problem.scenarios, np.zeros(1, int), np.array([40]))
    here = ConfigurationSearch(problem.checkers[0], robot, np.zeros(1)).search(inputs, 0.1)
    assert (here.at.clearance[0] > one.margin_m).sum() > 30 and here.resolution_rad[0] == np.pi
    assert not broken(job, part, one, here.at.x[0, here.at.clearance[0] > -np.inf], np.full(64, 40))


def problem_of(job, robot, part, one):
    return Problem.of(robot, part, one, job.settings, task_of_job(job, robot), execution=Execution(threads=1))


@pytest.mark.slow
@pytest.mark.parametrize("row", [CONE, SQUARE, {"orientation": [0, 0.7, 0, 0.7], "within_deg": 20}])
def test_other_configurations_at_the_path_s_first_point_hold_the_task_there(row):
    job = job_of([ON_PATH, row])
    robot, part, one = scene(job)
    problem, first = problem_of(job, robot, part, one), int(one.on_path)
    at, lane = other_configurations(problem, problem.checkers[0], np.array([0]), 0, first)
    x = at.x
    assert len(x) > 3 and not lane.any()
    assert not broken(job, part, one, x, np.full(len(x), first))


@pytest.mark.slow
def test_a_start_is_chosen_in_the_cone_and_joined_to_home():
    job = job_of([ON_PATH, {**CONE, "cone_deg": 60}], start_rad="auto", home_rad=HOME)
    robot, part, one = scene(job)
    one = first_of(one, 5)
    plans = plan(Problem.of(robot, part, one, SMALL, task_of_job(job, robot)), "beam")
    assert plans.executable.all() and (plans.start[0] == HOME).all()
    np.testing.assert_array_equal(one.goals[0], one.goals[1])
    assert not broken(job, part, one, plans.x[0], np.arange(5))
    for t, configurations in segments(plans, 0):
        assert 0 < plans.segment_clearance[0, t] <= check_segment(one, t, configurations, SMALL.tube_m) + 1e-9


@pytest.mark.slow
def test_an_approach_in_free_space_ends_in_the_cone():
    """Approach in free space to a target in the cone: its straight lines lead out of the arm's reach."""
    job = job_of([ON_PATH, {**CONE, "cone_deg": 60}])
    robot, part, one = scene(job)
    one = first_of(one, 16)
    targets, goals = one.targets.copy(), one.goals.copy()
    targets[5], goals[5, :3] = 9.0, 9.0
    one = replace(one, targets=targets, task_goals=goals)
    plans = plan(Problem.of(robot, part, one, replace(SMALL, smooth=True), task_of_job(job, robot)), "beam")
    assert plans.executable.all()
    assert not broken(job, part, one, plans.x[0, 1:], np.arange(1, 16))
    assert (one.goals[5, :3] == 9).all()
