"""One scenario as the peers that plan motions see it. What is asked of postures and ways is answered by htcp_jax's own
kernels: inverse kinematics from wherever a peer samples, exact clearance, the proof of a joint path. What is left to a
peer is the search."""

from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance.obstacles.obstacles import clearance
from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.device.kernel import DEEP, Kernel
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import tcp_position
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.motion_check import tubes
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.settings import Settings
from htcp_jax.status import Status, Way


class Brought(NamedTuple):
    """Postures (n, N) [rad] that were brought onto a target, and how they stand to it."""

    x: np.ndarray
    clearance: np.ndarray  # [m]
    residual: np.ndarray  # [m]
    tcp: np.ndarray  # world [m]

    def of(self, which: np.ndarray | int) -> "Brought":
        """Some of them, or one."""
        return Brought(*(column[which] for column in self))


def bring(settings: Settings, scene: Scene, lane: LaneInputs, x) -> Brought:
    """A posture brought onto the lane's target by inverse kinematics."""
    robot, task = scene.robot, scene.task
    x, _ = reanchor(robot, x, lane.target, task.fine_m, task=task)
    D = clearance(robot, scene.obstacles, lane, x)
    return Brought(x, D, task.off(robot, x, lane.target), tcp_position(robot, x))


BRING = Kernel("bring", bring, DEEP)


class Cell:
    """One scenario of a problem."""

    def __init__(self, problem: Problem, scenario: int):
        scenarios = problem.scenarios
        self.problem, self.scenario = problem, scenario
        self.start, self.count = scenarios.x_start[scenario], int(scenarios.count[scenario])
        self.targets, self.on_path = scenarios.targets[scenario, : self.count], int(scenarios.on_path[scenario])
        self.margin = float(scenarios.margin_m[scenario])
        robot = problem.robot
        self.lower = np.maximum(np.asarray(robot.lower), -np.pi)
        self.upper = np.minimum(np.asarray(robot.upper), np.pi)

    def bring(self, x: np.ndarray, target: int) -> Brought:
        """Postures (n, N), n >= 1, brought onto a target; not all arrive, nor clear."""
        return Brought(*self.problem.checkers[0].kernels(BRING, self._lanes(np.full(len(x), target)), x))

    def counts(self, here: Brought) -> np.ndarray:
        """Which of them are on their target and keep the margin."""
        return self.problem.task.counts(here.clearance, here.residual, self.margin)

    def brought_clear(self, x: np.ndarray, target: int) -> Brought:
        """Those of the postures that arrive on the target and keep the margin."""
        here = self.bring(x, target)
        return here.of(self.counts(here))

    def proven(self, a: np.ndarray, b: np.ndarray, target: int, turns: np.ndarray | bool = False) -> np.ndarray:
        """Which straight joint paths from a to b (n, N), n >= 1, are proven as (a part of) the way to a target. turns:
        whether the arm changes its posture at the target before."""
        target, turns = np.full(len(a), target), np.broadcast_to(turns, len(a))
        tube = tubes(self.problem, np.full(len(a), self.scenario), target, turns)
        return self.problem.checkers[0].edges(self._lanes(target), a, b, tube).verdict == Way.PROVEN

    def uniform(self, draw: np.random.Generator, count: int) -> np.ndarray:
        """Postures drawn within the joint limits."""
        return draw.uniform(self.lower, self.upper, (count, len(self.lower)))

    def surroundings(self) -> tuple[Scene, LaneInputs]:
        """What the clearance of a single posture is asked with."""
        scene = Scene(self.problem.robot, self.problem.obstacles, self.problem.task)
        lane = jax.tree.map(lambda leaf: leaf[0], self._lanes(np.zeros(1, int)))
        return jax.device_put((scene, lane))

    def record(self, plans: Plans, target: int, x_before: np.ndarray, here: Brought) -> None:
        """Write a target down as tracked, on a way that is proven."""
        row = self.scenario, target
        plans.x[row], plans.tcp[row], plans.clearance[row], plans.residual[row] = here.x, here.tcp, *here[1:3]
        plans.joint_step[row] = np.linalg.norm(here.x - x_before)
        plans.status[row], plans.path_clear[row] = Status.TRACKED, 1

    def _lanes(self, target: np.ndarray) -> LaneInputs:
        return lane_inputs(self.problem.scenarios, np.full(len(target), self.scenario), target)
