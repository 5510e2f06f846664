"""Interface of one scenario for other planners (peers) that plan motions.

Compiled functions of htcp_jax provide inverse kinematics from any sample, exact clearance, and the proof of a joint
path. Each peer contributes only its search.
"""

from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance import Scene, minimum_clearance
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import tcp_position
from htcp_jax.motion import Plans, Problem
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus, Status


class Brought(NamedTuple):
    """Configurations (n, N) after inverse kinematics to a target [rad], and their clearance and error there."""

    x: np.ndarray
    clearance: np.ndarray  # [m]
    residual: np.ndarray  # [m]
    tcp: np.ndarray  # world [m]

    def of(self, which: np.ndarray | int) -> "Brought":
        """Return some of the configurations, or one."""
        return Brought(*(column[which] for column in self))


def bring(settings: Settings, scene: Scene, lane: LaneInputs, x) -> Brought:
    """Move a configuration to the lane's target by inverse kinematics."""
    robot, task = scene.robot, scene.task
    x, _ = reanchor(robot, x, lane.target, task.fine_m, task=task)
    D = minimum_clearance(robot, scene.obstacles, lane, x)
    return Brought(x, D, task.residual_at(robot, x, lane.target), tcp_position(robot, x))


BRING = LaneFunction("bring", bring, STEP)


class Cell:
    """Scenario of a problem, with its compiled functions."""

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
        """Move configurations (n, N), n >= 1, to a target; not all converge, and some collide."""
        return Brought(*self.problem.checkers[0].executor(BRING, self._lanes(np.full(len(x), target)), x))

    def is_satisfied(self, here: Brought) -> np.ndarray:
        """Return the mask of the configurations that are on their target and satisfy the margin."""
        return self.problem.task.is_satisfied(here.clearance, here.residual, self.margin)

    def brought_clear(self, x: np.ndarray, target: int) -> Brought:
        """Move configurations to a target, and return those that are on it and keep the margin."""
        here = self.bring(x, target)
        return here.of(self.is_satisfied(here))

    def proven(self, a: np.ndarray, b: np.ndarray, target: int, turns: np.ndarray | bool = False) -> np.ndarray:
        """Return a mask of the straight joint paths from a to b, (n, N), that are proven as segments to a target.

        `turns` is True if the arm changes its configuration at the previous target.
        """
        target = np.full(len(a), target)
        tube = self.problem.tubes(self.scenario, target, turns=turns)
        return self.problem.checkers[0].edges(self._lanes(target), a, b, tube).verdict == SegmentStatus.VALID

    def uniform(self, draw: np.random.Generator, count: int) -> np.ndarray:
        """Draw configurations within the joint limits."""
        return draw.uniform(self.lower, self.upper, (count, len(self.lower)))

    def surroundings(self) -> tuple[Scene, LaneInputs]:
        """Return the scene and the lane's inputs for the clearance of a single configuration."""
        scene = Scene(self.problem.robot, self.problem.obstacles, self.problem.task)
        lane = jax.tree.map(lambda leaf: leaf[0], self._lanes(np.zeros(1, int)))
        return jax.device_put((scene, lane))

    def record(self, plans: Plans, target: int, x_before: np.ndarray, here: Brought) -> None:
        """Store a target as tracked, with a proven segment to it."""
        row = self.scenario, target
        plans.x[row], plans.tcp[row], plans.clearance[row], plans.residual[row] = here.x, here.tcp, *here[1:3]
        plans.joint_step[row] = np.linalg.norm(here.x - x_before)
        plans.status[row], plans.path_clear[row] = Status.TRACKED, 1

    def _lanes(self, target: np.ndarray) -> LaneInputs:
        return lane_inputs(self.problem.scenarios, np.full(len(target), self.scenario), target)
