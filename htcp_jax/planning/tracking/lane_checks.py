"""Checks of an engine's lanes: measurement, success criterion, and clearance of the joint path."""

import numpy as np

from htcp_jax.motion import CollisionChecker, Problem, lane_inputs, segment_tubes, step_functions
from htcp_jax.planning.tracking.lanes import TRACK, Lanes


class LaneChecks:
    """Measurements and collision checks of tables of lanes.

    With `check_paths` every joint path is checked, regardless of the settings.
    """

    def __init__(self, problem: Problem, checker: CollisionChecker, check_paths: bool):
        self._checker, self.executor = checker, checker.executor
        self._scenarios, self._seed = problem.scenarios, problem.settings.seed
        self.of_steps = check_paths or problem.settings.path_check == "all"  # True if joint paths are checked
        self.of_recoveries = self.of_steps or problem.settings.path_check == "recoveries"

    def inputs(self, lanes: Lanes, round_: int | np.ndarray = 0) -> lane_inputs.LaneInputs:
        """Return the inputs of lane functions for these lanes; `round_` is the number of the round of draws."""
        return lane_inputs.lane_inputs(self._scenarios, lanes.scenario, lanes.target, seed=self._seed, round_=round_)

    def advanced(self, lanes: Lanes, y: np.ndarray) -> step_functions.State:
        """Return the lanes' states after steps y (lanes, N) [rad or m]."""
        return self._checker.stepped(self.inputs(lanes), lanes.x_ref, y)

    def measured(self, lanes: Lanes, x: np.ndarray) -> step_functions.State:
        """Return the lanes' states at configurations x (lanes, N) [rad or m]."""
        return self._checker.stepped(self.inputs(lanes), x, np.zeros_like(x))

    def linearised(self, lanes: Lanes) -> tuple[Lanes, np.ndarray]:
        """Return new lanes with their linearisation, ready to be tracked, and the lanes' clearance [m]."""
        now = self.measured(lanes, lanes.x_ref)
        return lanes._replace(x_ref=now.x, linear=now.linear, phase=np.full_like(lanes.phase, TRACK)), now.clearance

    def keeps_margin(self, lanes: Lanes, here: step_functions.State) -> np.ndarray:
        """Return True for lanes that are on their target and satisfy the margin."""
        margin_m, _ = self._scenarios.margins_to(lanes.scenario, lanes.target)
        return self.executor.task.is_satisfied(here.clearance, here.residual, margin_m)

    def tip_free(self, lanes: Lanes, x: np.ndarray, among: np.ndarray) -> np.ndarray:
        """Return True for lanes marked by `among` whose bare tip at x does not pass through a wall.

        Args:
            lanes: The lanes.
            x: The lanes' configurations (lanes, N) [rad or m].
            among: True for lanes to check (lanes,).
        """
        return self._checker.tip_free(self.inputs(lanes), x, among)

    def at_target(self, lanes: Lanes, here: step_functions.State, among: np.ndarray | bool = True) -> np.ndarray:
        """Return True for lanes marked by `among` that meet the success criterion, see `CollisionChecker.valid`.

        Args:
            lanes: The lanes.
            here: States of the lanes.
            among: True for lanes to check (lanes,), or for all.
        """
        return self._checker.valid(self.inputs(lanes), here, among)

    def path_clear(self, lanes: Lanes, x: np.ndarray, requested: bool) -> np.ndarray:
        """Return 1 for each clear joint path from a lane's last target to x, 0 for a blocked one; -1 if not requested.

        A path on which a joint moves too far is not clear, see `Scenario.max_joint_step`, nor is one of a segment on
        which the arm has less clearance than `Scenario.segment_margin_m`.

        Args:
            lanes: The lanes.
            x: Ends of the paths (lanes, N) [rad or m].
            requested: True to check the paths.
        """
        most = lane_inputs.longest_joint_steps(self._scenarios, lanes.scenario, lanes.target)
        near = True if most is None else (np.abs(x - lanes.x_previous) <= most).all(axis=1)
        if not (requested and len(x)):
            return np.where(near, np.full(len(x), -1), 0).astype(np.int8)
        margin_m = segment_tubes.segment_margins(self._scenarios, lanes.scenario, lanes.target)
        return (near & self._checker.path_clear(self.inputs(lanes), lanes.x_previous, x, margin_m)).astype(np.int8)
