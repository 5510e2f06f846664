"""Record of an engine: writes tracked and failed targets into the plans."""

import numpy as np

from htcp_jax.device import tables
from htcp_jax.motion import Plans, Problem, measured_rows, step_functions
from htcp_jax.planning.tracking.lanes import Lanes
from htcp_jax.status import Status


class Record:
    """Writes results into the plans, and counts newly tracked targets and newly finished scenarios."""

    def __init__(self, plans: Plans):
        self._plans = plans
        self.tracked = self.finished = 0

    def track(self, lanes: Lanes, now: step_functions.State, status: Status, recovery: int, clear: np.ndarray) -> None:
        """Record that every lane has reached its target.

        Args:
            lanes: The lanes.
            now: States of the lanes.
            status: TRACKED or TRACKED_AFTER_RECOVERY.
            recovery: See `Plans.recovery`.
            clear: Results of the joint paths (lanes,), see `Plans.path_clear`.
        """
        s, t, plans = lanes.scenario, lanes.target, self._plans
        plans.x[s, t], plans.tcp[s, t] = now.x, now.tcp
        plans.clearance[s, t], plans.residual[s, t] = now.clearance, now.residual
        plans.status[s, t], plans.recovery[s, t] = status, recovery
        plans.iterations[s, t] = lanes.iteration
        plans.joint_step[s, t] = np.linalg.norm(now.x - lanes.x_previous, axis=1)
        plans.path_clear[s, t] = clear
        self.tracked += len(s)

    def lose(self, lanes: Lanes, reason: np.ndarray | Status) -> None:
        """Record that the target of every given lane failed.

        Args:
            lanes: The lanes.
            reason: One status for all lanes, or one per lane (lanes,).
        """
        self._plans.status[lanes.scenario, lanes.target] = reason
        self._plans.iterations[lanes.scenario, lanes.target] = lanes.iteration

    def collide(self, lanes: Lanes) -> None:
        """Record that the starts of the lanes' scenarios are in collision."""
        self._plans.status[lanes.scenario, lanes.target] = Status.START_IN_COLLISION
        self.finished += lanes.size


def with_separate_errors(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with the residual split into a distance and an angle, if the task constrains angles."""
    if not problem.task.holds_angles or not plans.tracked.any():
        return plans
    s, t = np.nonzero(plans.tracked)
    where, goals = tables.gather(measured_rows.Placement.of(problem.scenarios), s), problem.scenarios.task_goals[s, t]
    residual, angle = plans.residual.copy(), plans.orientation_error.copy()
    residual[s, t], angle[s, t], _ = measured_rows.task_errors(problem.robot, problem.task, where, plans.x[s, t], goals)
    return plans._replace(residual=residual, orientation_error=angle)
