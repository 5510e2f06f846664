"""Speed near the part: on motions before and after the path, joints are slower within a distance of the part.

The clearance to the part is measured at samples of the motion and compared with `program.near_part_m`. It is not proven
between samples, as it only decides a speed.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.jobs import build
from htcp_jax.model import scenario as scenarios
from htcp_jax.motion import Execution, Problem
from htcp_jax.spec import PlanConfig
from htcp_jax.trajectory.path import PathCurve

SAMPLES = 8  # samples of the distance between two positions of a path's grid

ShareOfSpeed = Callable[[PathCurve], Float[np.ndarray, "m"]]


def near_part_speeds(job: PlanConfig) -> ShareOfSpeed | None:
    """Return a function that limits the speed on sections before and after the path.

    Returns:
        Function of a section, which returns at each position of its grid the largest share of full speed [1]; infinite
            where the arm is not near the part. None if the job requires no lower speed, or if the part has no walls.
    """
    if job.program.near_part_speed == 1:
        return None
    robot, workpiece, scenario = build.scene(job)
    if not len(workpiece.cloud):
        return None
    task = build.task_of_job(job, robot)
    one = scenarios.stack([scenarios.with_goals_of(scenario, task.numbers)])  # only the goal of target 0 is used
    problem = Problem(robot, workpiece, one, job.settings, task, (), Execution(threads=1))
    return partial(_shares, problem, job.program.near_part_m, job.program.near_part_speed)


def _shares(problem: Problem, near_m: float, share: float, path: PathCurve) -> Float[np.ndarray, "m"]:
    between = np.linspace(path.place[:-1], path.place[1:], SAMPLES, endpoint=False).T.ravel()
    x = path.at(np.append(between, path.place[-1])).x
    is_near = np.zeros(len(x), bool)
    for rows in tables.portions(np.arange(len(x))):
        inputs = problem.inputs(np.zeros(len(rows), int), 0)
        is_near[rows] = problem.checkers[0].states(inputs, x[rows]).clearance < near_m
    parts = is_near[:-1].reshape(-1, SAMPLES).any(axis=1)
    slow = np.append(parts, is_near[-1]) | np.append(False, parts)
    return np.where(slow, share, np.inf)
