"""Planner in a separate package: inverse kinematics from many restarts at every target.

It solves no step QPs. At each target the last configuration and random neighbours of it are moved onto the target; of
those that satisfy the task and are clear, the nearest is taken. The caller checks the joint path there afterwards
(`Plans.path_clear`).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

import htcp_jax
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.status import Status

RESTARTS, SPREAD_RAD = 64, 0.3


@jax.jit
def restarts(robot, obstacles, task, scenario, x, target, key):
    """Configurations (RESTARTS, N) on the target, the first from x itself, with their clearance and residual [m]."""
    robot = lengthen_tool(robot, scenario.tool_extension_m)
    noise = SPREAD_RAD * jax.random.normal(key, (RESTARTS, x.shape[0])).at[0].set(0.0)

    def one(x):
        x, _ = htcp_jax.reanchor(robot, x, target, task.fine_m, task=task)
        x = jnp.clip(x, robot.lower, robot.upper)
        return x, htcp_jax.clearance.clearance(robot, obstacles, scenario, x), task.off(robot, x, target)

    return jax.vmap(one)(x[None, :] + noise)


@dataclass(frozen=True)
class RandomRestarts:
    """A planner with random restarts at every target, described above."""

    name: str = "random-restarts"
    title: str = "Random restarts"
    description: str = "inverse kinematics from 64 random neighbours at every target, no step QPs"

    def plan(self, problem: Problem) -> Plans:
        """Plan one scenario after the other, on one device, in one thread."""
        plans = problem.empty_plans()
        for s in problem.to_plan:
            scenario = jax.tree.map(lambda leaf, s=s: leaf[s], problem.scenarios)
            self._plan_one(problem, scenario, plans, int(s))
            problem.progress(0, 1)
        return plans

    def _plan_one(self, problem: Problem, scenario, plans: Plans, s: int) -> None:
        key = jax.random.fold_in(jax.random.key(problem.settings.seed), int(scenario.number))
        x = scenario.x_start
        for t in range(int(scenario.count)):
            target = scenario.targets[t]
            scene = problem.robot, problem.obstacles, problem.task
            found = restarts(*scene, scenario, x, target, jax.random.fold_in(key, t))
            around, clearance, residual = map(np.asarray, found)
            good = problem.task.counts(clearance, residual, scenario.margin_m)
            if not good.any():
                plans.status[s, t] = Status.ESCAPE_EXHAUSTED
                return
            step = np.where(good, np.linalg.norm(around - x, axis=1), np.inf)
            best = int(np.argmin(step))
            x = around[best]
            plans.status[s, t] = Status.TRACKED
            plans.x[s, t], plans.joint_step[s, t] = x, step[best]
            plans.tcp[s, t] = htcp_jax.tcp_position(lengthen_tool(problem.robot, scenario.tool_extension_m), x)
            plans.clearance[s, t], plans.residual[s, t] = clearance[best], residual[best]
            problem.progress(1, 0)


RANDOM_RESTARTS = RandomRestarts()
