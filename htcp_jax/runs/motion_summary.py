"""Summary of one scenario's motion, as text and for JSON."""

import math
from typing import Any, NamedTuple

import numpy as np

from htcp_jax.motion import Plans, motion
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.status import Kind, SegmentStatus

LEAST_MM = 0.01  # a smaller guaranteed clearance is reported as "more than 0 mm"


class MotionSummary(NamedTuple):
    """Figures of one scenario's executable motion, see `motion.motion`; NaN or None if undefined."""

    end: plan_arrays.Outcome  # how many targets the plan reaches, and why it ends
    dwells: tuple[int, ...]  # targets at which the arm changes its configuration while the tool stays at the target
    cost_rad2: float  # cost of equation (3) [rad^2]
    path_step_max_rad: float  # largest joint step on the path
    joint_step_max_rad: float  # largest travel of a joint between two targets of the path [rad; prismatic joint: m]
    joint_step_target: int | None  # target at the end of the segment with this travel
    joint_step_joint: int | None  # index of the joint with this travel
    curvature_max_rad_m2: float  # largest curvature of the joint path
    curvature_at: int | None  # target at which the curvature is largest
    clearance_m: float  # guaranteed clearance along the motion
    clearance_target: int | None  # target at the end of the segment with this clearance
    transfer_rad: float  # length of the joint path from home to the plan's first configuration
    transfer_legs: int  # number of straight joint paths in the transfer; 0 if there is no transfer
    after_transfer_m: float  # guaranteed clearance along the motion without the transfer
    after_transfer_target: int | None  # target at the end of the segment with this clearance
    on_path: int  # index of the first target on the path
    seam_begins: tuple[int, ...]  # first targets of later seams

    def facts(self) -> dict[str, str]:
        """Return text by label: the executable part, why it ends, guaranteed clearance, transfer and dwells."""
        end, there = self.end, self._can_be_run()
        if not end.executable:
            return {"can be run": there}
        least = f"{self.proven}; minimum on the segment to target {self.clearance_target} ({self.phase.words})"
        if self.transfer_legs and self.clearance_target == 0 and self.after_transfer_target is not None:
            least += f"; {_at_least(self.after_transfer_m)} after the transfer"
        return {"can be run": there, "guaranteed clearance": least, **self._transfer(), **self._dwells()}

    def _can_be_run(self) -> str:
        end, n = self.end, self.end.executable
        if n == end.targets:
            sampled = (
                "; a row of the task is sampled on its path, not proven"
                if end.segment_status == SegmentStatus.SAMPLED
                else ""
            )
            return f"yes: all {n} targets{sampled}"
        if n < end.tracked:
            why = f"the segment to target {n} is {end.segment_status.words}"
        else:
            why = f"target {n}: {end.status.ended}"
        return f"to target {n - 1}, the first {n} of {end.targets}; {why}" if n else f"no; {why}"

    def _transfer(self) -> dict[str, str]:
        legs = self.transfer_legs
        paths = f"{legs} straight joint paths" if legs > 1 else "one straight joint path"
        return {"transfer": f"{self.transfer_rad:.3g} rad to the first configuration, by {paths}"} if legs else {}

    def _dwells(self) -> dict[str, str]:
        count = len(self.dwells)
        return {"dwells": f"{count}, {_target_list(self.dwells)}; the tool stands still there"} if count else {}

    def details(self) -> dict[str, str]:
        """Return more text by label: smoothness, and "dwells" if there are none; empty if there is no motion."""
        if not self.end.executable:
            return {}
        none = "none (changes of configuration while the tool stays at a target)"
        return ({} if self.dwells else {"dwells": none}) | {"smoothness": self._smoothness()}

    @property
    def phase(self) -> Kind:
        """Kind of the motion with the guaranteed clearance."""
        if (self.transfer_legs and self.clearance_target == 0) or self.clearance_target in self.seam_begins:
            return Kind.TRANSFER
        return Kind.APPROACH if (self.clearance_target or 0) <= self.on_path else Kind.PROCESS

    @property
    def proven(self) -> str:
        """The guaranteed clearance as text, such as "at least 3.6 mm"."""
        return _at_least(self.clearance_m)

    def _smoothness(self) -> str:
        text = f"sum of squared joint steps {self.cost_rad2:.4g} rad2"
        if not math.isnan(self.path_step_max_rad):
            text += f"; on the path, steps up to {self.path_step_max_rad:.3g} rad"
        if self.curvature_at is not None:
            text += f", curvature up to {self.curvature_max_rad_m2:.4g} rad/m2 (target {self.curvature_at})"
        return text

    def record(self) -> dict[str, Any]:
        """Return the summary as a mapping for JSON."""
        end, figures = self.end, self._asdict()
        for name in ("end", "after_transfer_m", "after_transfer_target", "on_path", "seam_begins"):
            del figures[name]
        return {"executable": end.executable, "segment_status": end.segment_status.name, **figures}


def summarise_motion(plans: Plans, on_path: int, scenario: int = 0) -> MotionSummary:
    """Return the summary of one scenario's motion.

    Args:
        plans: The plans.
        on_path: Index of the first target on the path.
        scenario: Row of the scenario in `plans`.
    """
    alone = plans.rows([scenario])
    (found,) = zip(*motion.motion_figures(alone, on_path), strict=True)
    _, cost, step, bend, clearance = map(float, found)
    turning, at = np.flatnonzero(motion.dwells(alone, on_path)[0]), int(motion.narrowest_segment(alone)[0][0])
    after, after_m = (each[0] for each in motion.narrowest_segment(alone, without_transfer=True))
    bent = motion.curvature(alone, on_path)[0]
    largest = motion.largest_joint_steps(alone, on_path)
    there_is = not math.isnan(largest.step[0])
    there = motion.motions(alone, on_path)
    transfer = there.steps[(there.kind == Kind.TRANSFER) & (there.target == 0)]
    return MotionSummary(
        end=plans.outcome(scenario),
        dwells=tuple(turning.tolist()),
        cost_rad2=cost,
        path_step_max_rad=step,
        joint_step_max_rad=float(largest.step[0]),
        joint_step_target=int(largest.target[0]) if there_is else None,
        joint_step_joint=int(largest.joint[0]) if there_is else None,
        curvature_max_rad_m2=bend,
        curvature_at=None if math.isnan(bend) else int(np.nanargmax(bent)),
        clearance_m=clearance,
        clearance_target=None if at < 0 else at,
        transfer_rad=float(transfer.sum()) if len(transfer) else math.nan,
        transfer_legs=max(0, len(transfer) - 1),
        after_transfer_m=float(after_m),
        after_transfer_target=None if after < 0 else int(after),
        on_path=on_path,
        seam_begins=plans.seam_begins,
    )


def _at_least(clearance_m: float) -> str:
    """Format a guaranteed clearance [m] as text."""
    least = 1e3 * clearance_m
    return f"at least {least:.3g} mm" if least >= LEAST_MM else "more than 0 mm"


def _target_list(targets: tuple[int, ...]) -> str:
    """Return text for targets, such as "at target 3" or "at targets 3, 7 and 9"."""
    *others, last = map(str, targets)
    return f"at targets {', '.join(others)} and {last}" if others else f"at target {last}"
