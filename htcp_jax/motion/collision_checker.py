"""`CollisionChecker`: states and validity of configurations, and proofs of the straight joint paths between them.

    checker = problem.checkers[0]
    inputs = lane_inputs(problem.scenarios, scenario, target)
    here = checker.states(inputs, checker.project(inputs, q))
    good = checker.valid(inputs, here)
    proof = checker.edges(inputs, a, b, tube)

There is one checker per device. Compiled functions, padded tables and the walls around the tool's bare tip are behind
it. The tip is not a collision body: it has to come near the wall, and the job defines what it may touch (`tip_guard`).
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.obstacles import tip_guard
from htcp_jax.clearance.proof import bisection, motion_bound, motion_proof
from htcp_jax.device import Executor, tables
from htcp_jax.model import Task
from htcp_jax.model import task as tasks
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.motion.step_functions import ADVANCE, PATH_CLEAR, PROVE, SETTLE, TIP, ProofResolution, State, advance_of
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus

PLACES = 100  # intervals of a joint path at whose ends the tip is checked

Configurations = Float[np.ndarray, "n N"]
Rows = Bool[np.ndarray, "n"]


class CollisionChecker:
    """Checks of configurations and of straight joint paths, in one scene and on one device.

    All arguments are tables with one row per lane: `inputs` has the scenario's data and the target, see `lane_inputs`,
    `q`, `a` and `b` have configurations [rad or m]. Rows do not influence each other. `executor` runs a planner's own
    compiled functions in the same scene.

    Args:
        executor: Runs compiled functions in the scene.
        settings: Settings of the planner.
        guard: The walls that the tool's bare tip must not pass through; None if it may touch anywhere.
    """

    def __init__(self, executor: Executor, settings: Settings, guard: tip_guard.TipGuard | None = None):
        self.executor, self.task = executor, executor.task
        self._settings, self._guard, self._advance = settings, guard, advance_of(settings)

    def states(self, inputs: LaneInputs, q: Configurations) -> State:
        """Return clearance, residual, TCP and linearisation of configurations at their targets."""
        return self.executor(ADVANCE, inputs, q, np.zeros_like(q))

    def stepped(self, inputs: LaneInputs, q: Configurations, y: Configurations) -> State:
        """Return the states after steps y [rad or m] of step QPs.

        Their linearisation has the rows of clearance that step QPs use (`settings.clearance_rows`).
        """
        return self.executor(self._advance, inputs, q, y)

    def valid(self, inputs: LaneInputs, at: State, among: Rows | bool = True) -> Rows:
        """Return True for states of `among` that satisfy the task and the margin, with the bare tip out of walls."""
        return self.tip_free(inputs, at.x, self.task.is_satisfied(at.clearance, at.residual, inputs.margin_m) & among)

    def tip_free(self, inputs: LaneInputs, q: Configurations, among: Rows) -> Rows:
        """Return True for configurations of `among` whose bare tip passes through no wall."""
        good = np.array(among)
        if self._guard is not None and good.any():
            tip = self.executor(TIP, *tables.gather((inputs, q), good))
            good[good] = ~self._guard.passes(tip[:, 0], tip[:, 1])
        return good

    def project(self, inputs: LaneInputs, q: Configurations) -> Configurations:
        """Return configurations brought onto their targets, as far as inverse kinematics gets; they may collide."""
        return self.executor(SETTLE, inputs, q)

    def edges(
        self,
        inputs: LaneInputs,
        a: Configurations,
        b: Configurations,
        tube: motion_proof.Tube | None = None,
        *,
        kept: float | Float[np.ndarray, "n"] = 0.0,
        resolution_m: float | Float[np.ndarray, "n"] = -motion_bound.ROUNDING_M,
        deepest: int | Int[np.ndarray, "n"] = motion_proof.DEEPEST,
        tip: bool = True,
    ) -> bisection.Proof:
        """Return proofs that the straight joint paths from a to b are valid all along.

        The bodies are clear, the TCP stays in its tube, the task's rows hold where the tube requires them, and the bare
        tip is out of the walls.

        Args:
            inputs: Scenario and target of each path.
            a: Starts of the paths [rad or m].
            b: Ends of the paths [rad or m].
            tube: Allowed regions of the TCP; None: anywhere.
            kept: Share of D that must remain, see `clearance.proof.motion_proof.prove`.
            resolution_m: D is proven to be more than minus that, see `prove`.
            deepest: Most halvings, see `prove`.
            tip: False if the tip is not checked; else it is at PLACES - 1 places between a and b, and the verdict of a
                path on which it passes through a wall is IN_COLLISION.
        """
        proof = self.executor(*prove_call(self.task, inputs, a, b, tube, kept, resolution_m, deepest))
        if self._guard is None or not tip:
            return proof
        proven = proof.verdict == SegmentStatus.VALID
        passes = proven & ~self._tip_free_along(inputs, a, b, proven)
        return proof._replace(verdict=np.where(passes, int(SegmentStatus.IN_COLLISION), proof.verdict))

    def path_clear(self, inputs: LaneInputs, a: Configurations, b: Configurations) -> Rows:
        """Return True for straight joint paths that are clear by `settings.path_test`, the bare tip included.

        The test by proof uses the executable for motions, so that no other one is compiled.
        """
        if self._settings.path_test == "bisection":
            return self.edges(inputs, a, b, resolution_m=motion_proof.RESOLUTION_M).verdict == SegmentStatus.VALID
        return self._tip_free_along(inputs, a, b, self.executor(PATH_CLEAR, inputs, a, b))

    def _tip_free_along(self, inputs: LaneInputs, a: Configurations, b: Configurations, among: Rows) -> Rows:
        good = np.array(among)
        if self._guard is not None and good.any():
            inputs, a, b = tables.gather((inputs, a, b), good)
            x = a[:, None] + (np.arange(1, PLACES) / PLACES)[None, :, None] * (b - a)[:, None]
            many = tables.gather(inputs, np.repeat(np.arange(len(a)), PLACES - 1))
            free = self.tip_free(many, x.reshape(-1, a.shape[1]), np.ones(len(a) * (PLACES - 1), bool))
            good[good] = free.reshape(len(a), -1).all(axis=1)
        return good


def prove_call(
    task: Task,
    inputs: LaneInputs,
    a,
    b,
    tube: motion_proof.Tube | None = None,
    kept=0.0,
    resolution_m=-motion_bound.ROUNDING_M,
    deepest=motion_proof.DEEPEST,
) -> tuple:
    """Return the lane function and the tables of `CollisionChecker.edges`, see `Executor.preparing`."""
    closely = ProofResolution(
        *(np.broadcast_to(value, len(a)) for value in (kept, resolution_m, np.asarray(deepest, int)))
    )
    return PROVE, inputs, a, b, free_tubes(task, inputs) if tube is None else tube, closely


def free_tubes(task: Task, inputs: LaneInputs) -> motion_proof.Tube:
    """Return tubes without conditions on the TCP or the task."""
    count = len(inputs.row)
    rows = ()
    if task.parts != tasks.TCP_POSITION.parts:
        rows = np.stack([inputs.target, inputs.target], axis=1), np.zeros(count, bool)
    return motion_proof.Tube(np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, np.inf), *rows)
