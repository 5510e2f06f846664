"""Checks of an engine's lanes: measurement, success criterion, and clearance of the joint path."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from htcp_jax.clearance.proof.motion_proof import RESOLUTION_M
from htcp_jax.device.programs import Kernels
from htcp_jax.device.tables import gather, portions
from htcp_jax.model.scenario import Scenario
from htcp_jax.motion.kernels import CHECK_PATH, Measured, advance_of
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.plans import Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.proofs import clear_paths
from htcp_jax.motion.tip_check import TipCheck, tip_checks
from htcp_jax.planning.tracking.lanes import TRACK, Lanes
from htcp_jax.planning.tracking.null_space import Anchored
from htcp_jax.settings import Settings


class LaneChecks:
    """Checks by kernels. With `tip`, no target counts as reached if the tool's bare tip passes through a wall there."""

    def __init__(
        self, kernels: Kernels, scenarios: Scenario, settings: Settings, check_paths: bool, tip: TipCheck | None
    ):
        self.kernels = kernels
        self._scenarios, self._settings, self._tip = scenarios, settings, tip
        self._advance = advance_of(settings)
        self.of_steps = check_paths or settings.path_check == "all"  # True if joint paths are checked
        self.of_escapes = self.of_steps or settings.path_check == "escapes"

    def inputs(self, lanes: Lanes, round_: int | np.ndarray = 0) -> LaneInputs:
        """Return the lanes' kernel inputs. round_: of draws."""
        return lane_inputs(self._scenarios, lanes.scenario, lanes.target, seed=self._settings.seed, round_=round_)

    def advanced(self, lanes: Lanes, y: np.ndarray) -> Measured:
        """Return the lanes measured after steps y (lanes, N)."""
        return self.kernels(self._advance, self.inputs(lanes), lanes.x_ref, y)

    def measured(self, lanes: Lanes, x: np.ndarray) -> Measured:
        """Return the lanes measured at configurations x (lanes, N)."""
        return self.kernels(self._advance, self.inputs(lanes), x, np.zeros_like(x))

    def linearised(self, lanes: Lanes) -> tuple[Lanes, np.ndarray]:
        """Return new lanes with their linearisation, ready to be tracked, and their clearance."""
        now = self.measured(lanes, lanes.x_ref)
        return lanes._replace(x_ref=now.x, linear=now.linear, phase=np.full_like(lanes.phase, TRACK)), now.clearance

    def keeps_margin(self, lanes: Lanes, here: Measured | Anchored) -> np.ndarray:
        """True for lanes on their target with the required margin."""
        margin_m = self._scenarios.margin_m[lanes.scenario]
        return self.kernels.task.counts(here.clearance, here.residual, margin_m)

    def tip_passes(self, lanes: Lanes, x: np.ndarray, among: np.ndarray) -> np.ndarray:
        """True for each lane of `among` whose tool tip passes through a wall at x."""
        through = np.zeros(len(x), bool)
        if self._tip is not None and among.any():
            through[among] = self._tip.at(self.inputs(gather(lanes, among)), x[among])
        return through

    def at_target(self, lanes: Lanes, here: Measured | Anchored) -> np.ndarray:
        """True for lanes that meet the success criterion: margin kept on the target, and the tool's tip out of the
        walls."""
        good = self.keeps_margin(lanes, here)
        return good & ~self.tip_passes(lanes, here.x, good)

    def path_clear(self, lanes: Lanes, x: np.ndarray, asked: bool) -> np.ndarray:
        """Return 1 for each clear joint path from a lane's last target to x, 0 if it is not; -1 if not `asked`."""
        if not (asked and len(x)):
            return np.full(len(x), -1, np.int8)
        inputs = self.inputs(lanes)
        clear = _clear(self.kernels, self._settings, inputs, lanes.x_previous, x)
        if self._tip is not None:
            clear = clear & ~self._tip.along(inputs, lanes.x_previous, x)
        return clear.astype(np.int8)


def check_remaining_paths(problem: Problem, plans: Plans) -> None:
    """Fill in path_clear for tracked targets whose path was not checked while planning."""
    s, t = np.nonzero(plans.tracked & (plans.path_clear < 0))
    if not len(s):
        return
    kernels = problem.kernels  # made here, before there are threads
    tips = tip_checks(kernels, problem.tip_guard)

    def check(number: int) -> None:
        own, mine = number % len(kernels), slice(number, None, problem.threads)
        for row, at in portions((s[mine], t[mine])):
            ways = lane_inputs(problem.scenarios, row, at), plans.before(row, at), plans.x[row, at]
            clear = _clear(kernels[own], problem.settings, *ways)
            plans.path_clear[row, at] = clear if tips[own] is None else clear & ~tips[own].along(*ways)

    with ThreadPoolExecutor(problem.threads) as pool:
        list(pool.map(check, range(problem.threads)))


def _clear(kernels: Kernels, settings: Settings, inputs: LaneInputs, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """True for joint paths that are clear by the test of `settings.path_test`. The test by proof uses the executable
    for motions, with `motion_proof.proven_clear`'s resolution, so that no other one has to be compiled."""
    if settings.path_test == "bisection":
        return clear_paths(kernels, inputs, a, b, RESOLUTION_M)
    return kernels(CHECK_PATH, inputs, a, b)
