"""Scenarios: the start, workpiece pose and targets of one plan. They are checked, then stacked into a batch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.pytree import register_pytree
from htcp_jax.types import Anywhere, Bool, Float, Int

NOT_REFUSED = -1
PLACE_ROUNDING = 1e-9  # rounding error of `Scenario.place`


@register_pytree
@dataclass(frozen=True)
class Scenario:
    """Data of one plan that may differ within a batch; in stacked scenarios every leaf has a leading axis S."""

    x_start: Float[Anywhere, "*S N"]  # [rad or m]; with `auto_start` a placeholder until the planner has chosen it
    x_home: Float[Anywhere, "*S N"]  # first configuration of the motion [rad or m]; NaN: x_start, when it is chosen
    auto_start: Bool[Anywhere, "*S"]  # True: the planner chooses the start, at the path's first point
    T_world_workpiece: Float[Anywhere, "*S 4 4"]  # [m]
    interior_plane: Float[Anywhere, "*S 4"]  # unit normal and offset [m], see `scenario_setup.interior_plane_of`
    targets: Float[Anywhere, "*S T M"]  # positions of the tool, world [m]; rows from `count` on are padding
    count: Int[Anywhere, "*S"]  # number of targets to track
    on_path: Int[Anywhere, "*S"]  # index of the first target that is a point of the path; earlier ones are the approach
    margin_m: Float[Anywhere, "*S"]  # required clearance at the targets
    segment_margin_m: Float[Anywhere, "*S"]  # required clearance on segments of the path; 0: only D > 0
    transfer_margin_m: Float[Anywhere, "*S"]  # required clearance before the path, if possible; 0: only D > 0
    transfer_falloff_m: Float[Anywhere, "*S"]  # distance from both ends of a motion within which it falls off
    tool_extension_m: Float[Anywhere, "*S"]
    number: Int[Anywhere, "*S"]  # the scenario's number, from which the random keys are folded
    refused: Int[Anywhere, "*S"]  # NOT_REFUSED, or the Status of a scenario that is not planned
    # with padding where the task of a seam has fewer numbers, see `with_goals_of`
    task_goals: Float[Anywhere, "*S T G"] | None = None  # goals of the task, see `task_rows` [m]; None: the targets
    obstacle_numbers: Float[Anywhere, "*S P"] | None = None  # numbers of obstacles of other packages [m]; None: none
    max_joint_step: Float[Anywhere, "*S T N"] | None = None  # maximum travel to a target [rad or m]; None: unlimited
    # If goals are inserted between targets, 3.25 is a quarter of the segment from target 3 to 4.
    place: Float[Anywhere, "*S T"] | None = None  # position of each row among the targets [1]; None: rows are targets
    # required clearance at each target and on the segment to it, 0: only D > 0; None: as above, everywhere
    seam_margins_m: Float[Anywhere, "*S T 2"] | None = None

    def __repr__(self) -> str:
        *batch, rows, _ = getattr(self.targets, "shape", (0, 0))  # leaves of a pytree may be no arrays
        return f"Scenario({' x '.join(map(str, batch))}{' scenarios, ' if batch else ''}{rows} targets)"

    @property
    def begins_anywhere(self) -> Bool[Anywhere, "*S"]:
        """True if the motion begins at the start, and the planner has not chosen the start yet."""
        return np.asarray(np.isnan(self.x_home).any(axis=-1))

    @property
    def segments(self) -> Int[Anywhere, "*S T"]:
        """Index of the target at the end of each row's segment; inserted goals are not counted, see `place`."""
        if self.place is None:
            return np.broadcast_to(np.arange(self.targets.shape[-2]), self.targets.shape[:-1])
        return np.ceil(np.asarray(self.place) - PLACE_ROUNDING).astype(int)

    @property
    def goals(self) -> Float[Anywhere, "*S T G"]:
        """Goals of the task at every target; for the paper's task, the targets."""
        return self.targets if self.task_goals is None else self.task_goals

    def margins_to(
        self, scenario: Int[np.ndarray, "n"], row: Int[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Return the required clearances at some targets of stacked scenarios, and on the segments to them [m].

        Args:
            scenario: Row of each target's scenario.
            row: Index of each target.

        Returns:
            The clearance at each target, and that on the segment of the path to it; 0: only D > 0.
        """
        if self.seam_margins_m is None:
            return self.margin_m[scenario], self.segment_margin_m[scenario]
        own = self.seam_margins_m[scenario, row]
        return own[:, 0], own[:, 1]


def without_pose(T_world_workpiece: Float[np.ndarray, "4 4"]) -> str:
    """Return the beginning of a message about a workpiece without a pose; "" for any other pose [m]."""
    if (np.asarray(T_world_workpiece) != np.eye(4)).any():
        return ""
    return "the workpiece is at the world's origin, not rotated, as in a job without a pose: "


def stack(scenarios: Sequence[Scenario]) -> Scenario:
    """Stack S scenarios into one batch: numpy leaves with a leading axis S.

    Shorter target lists are padded with their last target.

    Raises:
        InputError: For an empty list.
    """
    if not scenarios:
        raise InputError("no scenarios to plan")
    return concatenate([jax.tree.map(lambda leaf: np.asarray(leaf)[None], one) for one in scenarios])


def concatenate(parts: Sequence[Scenario]) -> Scenario:
    """Return the scenarios of several batches as one batch; shorter target lists are padded, see `stack`.

    Goals of tasks of fewer numbers are padded with 0, see `with_goals_of`.
    """
    longest, parts = max(part.targets.shape[1] for part in parts), _with_equal_goals(parts)

    def pad(rows):
        return None if rows is None else np.pad(rows, ((0, 0), (0, longest - rows.shape[1]), (0, 0)), mode="edge")

    names = "targets", "task_goals", "seam_margins_m"
    padded = [replace(part, **{name: pad(getattr(part, name)) for name in names}) for part in parts]
    return padded[0] if len(padded) == 1 else jax.tree.map(lambda *leaves: np.concatenate(leaves), *padded)


def _with_equal_goals(parts: Sequence[Scenario]) -> Sequence[Scenario]:
    """Return batches with goals of equally many numbers; all without goals if no batch has some."""
    sizes = {None if part.task_goals is None else part.task_goals.shape[-1] for part in parts}
    if len(sizes) == 1:
        return parts
    most = max(part.goals.shape[-1] for part in parts)
    goals = [np.pad(part.goals, ((0, 0), (0, 0), (0, most - part.goals.shape[-1]))) for part in parts]
    return [replace(part, task_goals=own) for part, own in zip(parts, goals, strict=True)]


def with_goals_of(scenarios: Scenario, numbers: int) -> Scenario:
    """Return scenarios, stacked or single, with the goals of a task of `numbers` numbers, without padding.

    The goals at targets of seams with another task are meaningless.
    """
    if scenarios.task_goals is None or scenarios.task_goals.shape[-1] == numbers:
        return scenarios
    return replace(scenarios, task_goals=scenarios.task_goals[..., :numbers])


def with_free_approach(scenarios: Scenario, which: Bool[np.ndarray, "S T"]) -> Scenario:
    """Replace some targets of the approach by the path's first point, so that the approach may leave its line.

    Args:
        scenarios: Stacked scenarios.
        which: True for the targets to replace.
    """
    s, first = np.arange(len(which)), np.minimum(scenarios.on_path, which.shape[1] - 1)
    targets, goals = (
        None if table is None else np.where(which[..., None], table[s, first][:, None], table)
        for table in (scenarios.targets, scenarios.task_goals)
    )
    return replace(scenarios, targets=targets, task_goals=goals)


def with_max_joint_step(scenarios: Scenario, most: float | Sequence[float] | None) -> Scenario:
    """Limit the travel of each joint between two targets of the path.

    Args:
        scenarios: Stacked scenarios.
        most: Maximum travel: one number for all joints, or one per joint [rad or m]; None: unlimited.
    """
    if most is None:
        return scenarios
    after = np.arange(scenarios.targets.shape[1]) > scenarios.on_path[:, None]
    bound = np.broadcast_to(np.asarray(most, float), scenarios.x_start.shape[1:])
    return replace(scenarios, max_joint_step=np.where(after[..., None], bound, np.inf))
