"""`CollisionChecker`: states and validity of configurations, and proofs of the straight joint paths between them.

    checker = problem.checkers[0]
    inputs = lane_inputs(problem.scenarios, scenario, target)
    here = checker.states(inputs, checker.project(inputs, q))
    good = checker.valid(inputs, here)
    proof = checker.edges(inputs, a, b, tube)

There is one checker per device. It also tests the tool's bare tip, which is not a collision body: the tip has to come
near the wall, and the job defines what it may touch (`tip_guard`).
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.obstacles import CLOSE_M, TipGuard
from htcp_jax.clearance.proof import ROUNDING_M, bisection, joint_path, margin, motion_proof
from htcp_jax.device import Executor, tables
from htcp_jax.model import TCP_POSITION, Task
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.motion.step_functions import (
    ADVANCE,
    CLEAR,
    MAY_BE_VALID,
    PROVE,
    PROVE_POLYNOMIAL,
    SETTLE,
    STAY_IN_TUBE,
    TIP,
    ProofResolution,
    State,
    advance_of,
)
from htcp_jax.motion.tip_motions import TipMotions
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus

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
        guard: Walls that the tool's bare tip must not pass through; None if the tip may touch anywhere.
    """

    def __init__(self, executor: Executor, settings: Settings, guard: TipGuard | None = None):
        self.executor, self.task = executor, executor.task
        self._settings, self._guard, self._advance = settings, guard, advance_of(settings)
        self._tip = executor.tip_bounds if guard is not None else None

    def states(self, inputs: LaneInputs, q: Configurations) -> State:
        """Return the states of configurations q at their targets: clearance, residual, TCP and linearisation."""
        return self.executor(ADVANCE, inputs, q, np.zeros_like(q))

    def stepped(self, inputs: LaneInputs, q: Configurations, y: Configurations) -> State:
        """Return the states after steps y [rad or m] from configurations q.

        Their linearisation has the rows of clearance that step QPs use (`settings.clearance_rows`).
        """
        return self.executor(self._advance, inputs, q, y)

    def valid(self, inputs: LaneInputs, at: State, among: Rows | bool = True) -> Rows:
        """Return True for states that satisfy task and margin, with the bare tip outside of walls.

        States not marked by `among` get False.
        """
        return self.tip_free(inputs, at.x, self.task.is_satisfied(at.clearance, at.residual, inputs.margin_m) & among)

    def tip_free(self, inputs: LaneInputs, q: Configurations, among: Rows) -> Rows:
        """Return True for configurations marked by `among` whose bare tip does not pass through a wall."""
        good = np.array(among)
        if self._guard is not None and good.any():
            tip = self.executor(TIP, *tables.gather((inputs, q), good))
            good[good] = ~self._guard.passes(tip[:, 0], tip[:, 1])
        return good

    def may_be_valid(self, inputs: LaneInputs, q: Configurations) -> Rows:
        """Return False for configurations that are certainly not `valid`; this costs less than their states."""
        return self.executor(MAY_BE_VALID, inputs, q)

    def project(self, inputs: LaneInputs, q: Configurations) -> Configurations:
        """Return configurations moved onto their targets by inverse kinematics, if it converges; they may collide."""
        return self.executor(SETTLE, inputs, q)

    def edges(
        self,
        inputs: LaneInputs,
        a: Configurations,
        b: Configurations,
        tube: motion_proof.Tube | None = None,
        *,
        kept: float | Float[np.ndarray, "n"] = 0.0,
        resolution_m: float | Float[np.ndarray, "n"] = -ROUNDING_M,
        deepest: int | Int[np.ndarray, "n"] = motion_proof.DEEPEST,
        tip: bool = True,
    ) -> bisection.Proof:
        """Prove or refute that the straight joint paths from a to b are valid; return one `Proof` per path.

        On a valid path the bodies are clear by the tube's margin, the TCP stays in its tube, the task's rows are
        satisfied where the tube requires them, and the bare tip is outside of walls.

        Args:
            inputs: Scenario and target of each path.
            a: Starts of the paths [rad or m].
            b: Ends of the paths [rad or m].
            tube: Allowed regions of the TCP; None: anywhere.
            kept: Share of D that must remain, see `clearance.proof.motion_proof.query_on`; with 0, the proven clearance
                is the required one.
            resolution_m: The proof is D > -resolution_m, see `query_on`.
            deepest: Maximum number of halvings, see `query_on`.
            tip: True to check the tip at configurations between a and b, see `tip_motions`; if it passes through a wall
                at one of them, the verdict is IN_COLLISION.
        """
        proof = self.executor(*prove_call(self.task, inputs, a, b, tube, kept, resolution_m, deepest))
        if self._guard is None or not tip:
            return proof
        proven = proof.verdict == SegmentStatus.VALID
        passes = proven & ~self._tip_free_along(inputs, a, b, proven)
        return proof._replace(verdict=np.where(passes, int(SegmentStatus.IN_COLLISION), proof.verdict))

    def clear_edges(
        self,
        inputs: LaneInputs,
        a: Configurations,
        b: Configurations,
        margin_m: Float[np.ndarray, "n"],
        *,
        kept: float | Float[np.ndarray, "n"] = 0.0,
    ) -> bisection.Proof:
        """Prove or refute that the straight joint paths from a to b are clear, without task and bare tip, see `edges`.

        Args:
            inputs: Scenario and target of each path.
            a: Starts of the paths [rad or m].
            b: Ends of the paths [rad or m].
            margin_m: Required clearance [m]; -inf: only D > 0.
            kept: Share of D that must remain, see `edges` [1].
        """
        return self.edges(inputs, a, b, free_tubes(self.task, inputs, margin_m), kept=kept, tip=False)

    def polynomial_edges(
        self,
        inputs: LaneInputs,
        coefficients: Float[np.ndarray, "n C N"],
        off: Float[np.ndarray, "n N"],
        margin_m: Float[np.ndarray, "n"],
        *,
        kept: float | Float[np.ndarray, "n"] = 0.0,
    ) -> bisection.Proof:
        """Prove or refute that all joint paths near polynomials are clear; return one `Proof` per polynomial.

        The task and the bare tip are not checked. A polynomial of any degree up to the fifth uses one executable.

        Args:
            inputs: Scenario and target of each path.
            coefficients: c_0, c_1, ... of x(s) = sum_k c_k s^k with 0 <= s <= 1 [rad or m].
            off: Largest distance of each joint from the polynomial [rad or m].
            margin_m: Required clearance [m]; -inf: only D > 0.
            kept: Share of D that must remain, see `edges` [1].
        """
        rows = np.zeros((len(off), joint_path.COEFFICIENTS, off.shape[1]))
        rows[:, : coefficients.shape[1]] = coefficients
        path, tube = joint_path.PolynomialPath(rows, off), free_tubes(self.task, inputs, margin_m)
        inputs = _measuring_up_to(inputs, tube.margin)
        return self.executor(PROVE_POLYNOMIAL, inputs, path, tube, _resolution(len(off), kept))

    def path_clear(
        self, inputs: LaneInputs, a: Configurations, b: Configurations, margin_m: Float[np.ndarray, "n"] | None = None
    ) -> Rows:
        """Return True for straight joint paths that are clear by `settings.path_test`, the bare tip included.

        With `bisection` the paths are proven to be clear, by the executable of `edges`. With `samples` only the
        configurations between `settings.path_steps` equal steps are tested, without the ends and without a margin.

        Args:
            inputs: Scenario and target of each path.
            a: Starts of the paths [rad or m].
            b: Ends of the paths [rad or m].
            margin_m: Required clearance on each path [m]; None, or -inf: only D > 0.
        """
        if self._settings.path_test == "bisection":
            tube = free_tubes(self.task, inputs, margin_m)
            proof = self.edges(inputs, a, b, tube, resolution_m=motion_proof.RESOLUTION_M)
            return proof.verdict == SegmentStatus.VALID
        clear, steps = np.ones(len(a), bool), self._settings.path_steps
        for step in range(1, steps):
            if clear.any():
                own, start, end = tables.gather((inputs, a, b), clear)
                clear[clear] = self.executor(CLEAR, own, start + step / steps * (end - start))
        return self._tip_free_along(inputs, a, b, clear)

    def stays_on_path(self, inputs: LaneInputs, a: Configurations, b: Configurations, tube: motion_proof.Tube) -> Rows:
        """Return True for straight joint paths on which the tool is proven to stay on its path, clear or not.

        This is one of the conditions of `edges` with the same tube, and costs a fraction of it. On segments of the path
        the TCP stays within `settings.path_tolerance_m` of the line from the previous target and advances along it, and
        the task's other rows are satisfied. Before the path and between seams the result is True.

        Args:
            inputs: Scenario and target of each path.
            a: Starts of the paths [rad or m].
            b: Ends of the paths [rad or m].
            tube: Allowed regions of the TCP, from `Problem.tubes` for the same rows.
        """
        return self.executor(STAY_IN_TUBE, inputs, a, b, tube) == SegmentStatus.VALID

    def _tip_free_along(self, inputs: LaneInputs, a: Configurations, b: Configurations, among: Rows) -> Rows:
        """Return True for paths marked by `among` whose bare tip does not pass through a wall, see `edges`."""
        good = np.array(among)
        if self._guard is not None and good.any():
            passing = TipMotions(self.executor, self._guard, self._tip, *tables.gather((inputs, a, b), good)).passing()
            good[np.flatnonzero(good)[passing]] = False
        return good


def prove_call(
    task: Task,
    inputs: LaneInputs,
    a,
    b,
    tube: motion_proof.Tube | None = None,
    kept=0.0,
    resolution_m=-ROUNDING_M,
    deepest=motion_proof.DEEPEST,
) -> tuple:
    """Return the lane function and the tables with which `CollisionChecker.edges` calls the executor."""
    closely = _resolution(len(a), kept, resolution_m, deepest)
    tube = free_tubes(task, inputs) if tube is None else tube
    if tube.margin is None:
        tube = tube._replace(margin=margin.constant(np.full(len(a), -np.inf)))
    return PROVE, _measuring_up_to(inputs, tube.margin), a, b, tube, closely


def _measuring_up_to(inputs: LaneInputs, required: margin.Margin) -> LaneInputs:
    """Return inputs with which convex pieces are measured as far as the required clearance.

    With a scenario's own margin they are measured up to CLOSE_M above it, see `narrow_phase`.
    """
    beyond = required.most_m > inputs.margin_m + CLOSE_M
    return inputs._replace(margin_m=np.where(beyond, required.most_m, inputs.margin_m))


def free_tubes(task: Task, inputs: LaneInputs, margin_m: Float[np.ndarray, "n"] | None = None) -> motion_proof.Tube:
    """Return tubes without conditions on the TCP or the task.

    Args:
        task: The task.
        inputs: Scenario and target of each path.
        margin_m: Required clearance on each path [m]; None, or -inf: only D > 0.
    """
    count, rows = len(inputs.row), (None, None)
    required = margin.constant(np.full(count, -np.inf) if margin_m is None else margin_m)
    if task.parts != TCP_POSITION.parts:
        rows = np.stack([inputs.target, inputs.target], axis=1), np.zeros(count, bool)
    return motion_proof.Tube(np.zeros((count, 3)), np.zeros((count, 3)), np.full(count, np.inf), *rows, required)


def _resolution(count: int, kept=0.0, resolution_m=-ROUNDING_M, deepest=motion_proof.DEEPEST) -> ProofResolution:
    """Return the resolution of `count` proofs."""
    return ProofResolution(*(np.broadcast_to(value, count) for value in (kept, resolution_m, np.asarray(deepest, int))))
