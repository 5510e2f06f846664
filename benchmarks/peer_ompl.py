"""OMPL's projected RRT-Connect as one of the `peers`.

The search proceeds from target to target. If inverse kinematics from the current configuration succeeds, its result is
used. Otherwise the arm has to change its configuration with the tool at rest, which is a constrained problem: on the
manifold the TCP is at the target (3 equations, so 3 of 6 dimensions remain), the start is the current configuration,
and goals are configurations there from which inverse kinematics succeeds. `ProjectedStateSpace` projects to the
manifold by Newton steps, `RRTConnect` searches it, and a configuration is valid if it keeps the margin.

Half of the goals are drawn uniformly within the joint limits, half about the current configuration. OMPL checks
configurations `DELTA_RAD` apart, so its result is proven afterwards; if that fails, the search is repeated until the
time is over.
"""

import time
from dataclasses import dataclass

import jax
import mujoco
import numpy as np
from ompl import base, geometric, util

from benchmarks.peer_cell import Brought, Cell
from htcp_jax.clearance import minimum_clearance
from htcp_jax.motion import Plans, Problem, ViaPoints
from htcp_jax.planning import Method
from htcp_jax.spec import GP50
from htcp_jax.status import Status

DELTA_RAD = 0.05  # between the configurations that OMPL checks
RANGE_RAD = 0.5  # longest motion that connects its trees
ONTO_M = 1e-4  # tolerance of its projection, the default
DRAWS = 256  # for goals, per round
AHEAD = 10  # number of later targets by which goals are ranked
ROUND_S = 2.0  # of RRT-Connect with the known goals, before more are drawn

clearance_of = jax.jit(lambda scene, lane, x: minimum_clearance(scene.robot, scene.obstacles, lane, x))


class AtPoint(base.Constraint):
    """Constraint that the TCP is at a point, by MuJoCo's kinematics."""

    def __init__(self, point: np.ndarray):
        self._model = mujoco.MjModel.from_xml_path(str(GP50))
        self._data, self.point = mujoco.MjData(self._model), point
        super().__init__(self._model.nv, 3, ONTO_M)

    def function(self, x: np.ndarray, out: np.ndarray) -> None:
        """Write the TCP's position relative to the point [m] into `out`."""
        self._data.qpos[:] = x
        mujoco.mj_kinematics(self._model, self._data)
        out[:] = self._data.site_xpos[0] - self.point

    def jacobian(self, x: np.ndarray, out: np.ndarray) -> None:
        """Write the derivatives of `function` into `out`."""
        self._data.qpos[:] = x
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        jacobian = np.empty((3, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian, None, 0)
        out[:] = jacobian


@dataclass(frozen=True)
class ProjectedRRTConnect(Method):
    """The planner."""

    limit_s: float  # for a scenario
    name: str = "ompl-projected"
    title: str = "OMPL, projected RRT-Connect"
    description: str = "changes configuration at targets by OMPL's constrained planning"

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios, one after the other."""
        util.setLogLevel(util.LogLevel.LOG_NONE)
        util.RNG.setSeed(problem.settings.seed + 1)
        plans, segments = problem.empty_plans(), []
        for scenario in problem.to_plan.tolist():
            segments += _Search(Cell(problem, scenario), self.limit_s).run(plans)
        return plans._replace(via_points=ViaPoints.of(segments, plans.x.shape[2]))


class _Search:
    """Search of one scenario."""

    def __init__(self, cell: Cell, limit_s: float):
        self._cell, self._until = cell, time.process_time() + limit_s
        self._draw = np.random.default_rng(cell.problem.settings.seed)
        self._surroundings = cell.surroundings()
        clearance_of(*self._surroundings, cell.start)  # compiled here

    def run(self, plans: Plans) -> list[tuple[int, int, np.ndarray]]:
        """Plan, target by target, and return the via points of the segments."""
        cell, x, segments = self._cell, self._cell.start, []
        for target in range(cell.count):
            via_points, here = self._segment(target, x)
            if here is None:
                plans.status[cell.scenario, target] = Status.RECOVERY_EXHAUSTED
                break
            cell.record(plans, target, x, here)
            if len(via_points):
                segments.append((cell.scenario, target, via_points))
            x = here.x
        return segments

    def _segment(self, target: int, x: np.ndarray) -> tuple[np.ndarray, Brought | None]:
        """Find via points to a target and the configuration there; None if the time is over."""
        here, none = self._cell.brought_clear(x[None], target), x[:0].reshape(0, len(x))
        if len(here.x) and self._cell.proven(x[None], here.x, target)[0]:
            return none, here.of(0)
        before, after = none, here.of(slice(0, 0))
        while time.process_time() < self._until:
            more, there = self._goals(target, x)
            before = np.concatenate([before, more])
            after = Brought(*(np.concatenate(columns) for columns in zip(after, there, strict=True)))
            if not len(before):
                continue
            order = np.lexsort((np.linalg.norm(before - x, axis=1), -self._ahead(target, after)))
            via_points = self._turned(target, x, before[order])
            if via_points is None:
                continue
            goal = int(np.argmin(np.linalg.norm(before - via_points[-1], axis=1)))
            segment_status = np.concatenate([x[None], via_points[:-1], before[goal : goal + 1]])
            if self._cell.proven(segment_status[:-1], segment_status[1:], target, True).all():
                return segment_status[1:], after.of(goal)
        return none, None

    def _goals(self, target: int, x: np.ndarray) -> tuple[np.ndarray, Brought]:
        """Draw goals for a change of configuration, and the configurations at the target reached from them."""
        cell, about = self._cell, 10 ** self._draw.uniform(-1.5, 0.0, (DRAWS // 2, 1))
        near = x + about * self._draw.normal(size=(DRAWS // 2, len(x)))
        draws = np.concatenate([near, cell.uniform(self._draw, DRAWS // 2)])
        after = cell.brought_clear(np.clip(draws, cell.lower, cell.upper), target)
        if target <= cell.on_path or not len(after.x):
            return after.x, after
        before = cell.bring(after.x, target - 1)
        good = cell.is_satisfied(before)
        good[good] = cell.proven(before.x[good], after.x[good], target) if good.any() else False
        return before.x[good], after.of(good)

    def _ahead(self, target: int, here: Brought) -> np.ndarray:
        """Number of next targets, up to AHEAD, for which inverse kinematics succeeds from each configuration."""
        count, going, x = np.zeros(len(here.x), int), np.arange(len(here.x)), here.x
        for later in range(target + 1, min(target + 1 + AHEAD, self._cell.count)):
            there = self._cell.bring(x, later)
            good = self._cell.is_satisfied(there)
            going, x = going[good], there.x[good]
            count[going] += 1
            if not len(going):
                break
        return count

    def _turned(self, target: int, x: np.ndarray, goals: np.ndarray) -> np.ndarray | None:
        """Find configurations from x (excluded) to one of the goals; None if none are found in time."""
        ambient, bounds = base.RealVectorStateSpace(len(x)), base.RealVectorBounds(len(x))
        for joint, (low, high) in enumerate(zip(self._cell.lower, self._cell.upper, strict=True)):
            bounds.setLow(joint, low)
            bounds.setHigh(joint, high)
        ambient.setBounds(bounds)
        if target <= self._cell.on_path:
            constraint, space = None, ambient
            information = base.SpaceInformation(space)
            information.setStateValidityCheckingResolution(DELTA_RAD / space.getMaximumExtent())
        else:
            constraint = AtPoint(self._cell.targets[target - 1])
            space = base.ProjectedStateSpace(ambient, constraint)
            information = base.ConstrainedSpaceInformation(space)
            space.setDelta(DELTA_RAD)

        def state(configuration: np.ndarray):
            made, onto = information.allocState(), configuration.copy()
            if constraint is not None:
                constraint.project(onto)
                made.copy(onto.tolist())
                return made
            for joint, value in enumerate(onto.tolist()):
                made[joint] = value
            return made

        def valid(state) -> bool:
            configuration = np.array([state[joint] for joint in range(len(x))])
            return float(clearance_of(*self._surroundings, configuration)) > self._cell.margin

        setup, goal = geometric.SimpleSetup(information), base.GoalStates(information)
        setup.setStateValidityChecker(valid)
        setup.setStartState(state(x))
        for configuration in goals:  # OMPL takes them in this order
            goal.addState(state(configuration))
        setup.setGoal(goal)
        planner = geometric.RRTConnect(information)
        planner.setRange(RANGE_RAD)
        setup.setPlanner(planner)
        until = min(self._until, time.process_time() + ROUND_S)
        setup.solve(base.PlannerTerminationCondition(lambda: time.process_time() > until))
        if not setup.haveExactSolutionPath():
            return None
        path = setup.getSolutionPath()
        path.interpolate()
        return np.array([[state[joint] for joint in range(len(x))] for state in path.getStates()])[1:]
