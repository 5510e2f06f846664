"""What the rows of a task leave beside the legs of a motion, where they ask for more than the TCP on the path.

Where a corner is rounded, every point of the arm moves by at most a length m, and every direction turns by at most an
angle w. Angles count as lengths, by their tolerances, as in `scene.task`: a row's error changes by m + w c at most. At
targets equalities and bands hold to within the tolerance; between targets the proof has bands and cones widened by it.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.jobs.build import task_of_job
from htcp_jax.jobs.config import PlanConfig
from htcp_jax.planner.motion import Motion
from htcp_jax.program.stretches import Spare
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.task import Task
from htcp_jax.status import Kind


def with_rows(left: Spare, job: PlanConfig, robot: Robot, motion: Motion, aims: Float[np.ndarray, "T G"]) -> Spare:
    """What is left, with that of the job's task beside each leg; infinite before the path and on the way back.

    robot: with the job's tool; aims: what the task asks for at each target, see `Scenario`.
    """
    task = task_of_job(job, robot)
    on = np.isin(motion.kind, (Kind.FEED, Kind.DWELL))
    goals = aims[motion.target]
    rest, room = (np.where(on, part, np.inf) for part in _left(task, robot, motion.x, goals))
    rows, cones = (np.minimum(part[:-1], part[1:]) for part in (rest, np.maximum(room + task.tolerance_m, 0.0)))
    tube = left.tube if task.holds_tcp else np.full_like(left.tube, np.inf)
    return left._replace(tube=tube, rows=rows, cones=cones, length_per_rad=task.tolerance_m / task.tolerance_rad)


def _left(task: Task, robot: Robot, x: np.ndarray, goals: np.ndarray) -> tuple[jax.Array, jax.Array]:
    """What is left of the tolerance of the equalities, and the least room in bands and cones [m]."""

    def at(x, goal):
        value = task.value(robot, x)
        return task.tolerance_m - jnp.linalg.norm(task.error(value, goal)), task.room(value, goal)

    return jax.vmap(at)(jnp.asarray(x), jnp.asarray(goals))
