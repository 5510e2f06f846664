"""Plan one job from Python: `htcp_jax.plan(...)` returns a `Plan`. The command `htcp plan` uses it, too."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from htcp_jax import jobs, runs, sequencing, trajectory
from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import THE_WORKPIECE, SelfCollision
from htcp_jax.device import devices
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config, source_of, with_kinds
from htcp_jax.model import (
    Robot,
    Scenario,
    Task,
    Workpiece,
    denser_spacing,
    interior_rule,
    place_of,
    tool_angles_at,
    with_own_tool,
)
from htcp_jax.model import robot as robots
from htcp_jax.model import scenario as scenarios
from htcp_jax.motion import Execution, Motion, Plans, Problem, Tried
from htcp_jax.motion import manipulability as manipulabilities
from htcp_jax.motion import motion as motions
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.motion import start_cause as start_causes
from htcp_jax.notebook import html_facts
from htcp_jax.planning import LostPlace, RefusedSegment, batch, lost_place, refused_segment, registry
from htcp_jax.planning import methods as planning_methods
from htcp_jax.proving import ErrorScale, error_scale, error_set, errors_record, prove_curves, scale_text, straight
from htcp_jax.reachability import Obstruction
from htcp_jax.reachability import obstruction as obstructions
from htcp_jax.runs import MotionSummary, SeamOrder, failure_texts, plan_folder, provenance, summarise_motion
from htcp_jax.runs import summary as summaries
from htcp_jax.spec import TOOL_ANGLES, PlanConfig, TaskRowKind, ToolAxisRow, obstacle_kind, tool_axis_row
from htcp_jax.status import NOT_TRIED, SegmentStatus, Status
from htcp_jax.system import output_files

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


BEGINS_IN_COLLISION = Status.HOME_IN_COLLISION, Status.START_IN_COLLISION
RATED = 10  # tracked targets of a plan that ends early from which on `facts` reports the time per target
NOTABLE_RAD = 0.1  # `facts` reports the first segment if the joints travel farther than this from the given start


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A job, its scene, and the plan of its one scenario."""

    job: PlanConfig
    robot: Robot  # with the job's tool and its extension
    workpiece: Workpiece
    scenario: Scenario  # its tool extension is 0, as `robot` contains it
    plans: Plans  # the scenario axis of every array has length 1
    obstacles: Obstacles = ()  # those in addition to the workpiece
    device: str | None = None  # name of the device that planned the job, see `device.devices`; None: a GPU, if any
    order: SeamOrder | None = None  # order of the seams and reasons for missing ones; None for one seam
    arguments: str = "JOB"  # the job as arguments of a command, for the next step after a failure

    @cached_property
    def summary(self) -> summaries.Summary:
        """Summary of the plan: numbers of targets, times, clearances and errors."""
        return summaries.summarise(self.plans)

    @cached_property
    def motion_summary(self) -> MotionSummary:
        """Length of the proven motion, its minimum clearance, its dwells and its smoothness."""
        return summarise_motion(self.plans, int(self.scenario.on_path))

    def motion(self, *, retract: bool = False) -> Motion:
        """Return the motion from home or the start to the last executable target: its configurations, and their kinds.

        Args:
            retract: True appends the motion back to home or the start.
        """
        return motions.motion(self.plans, 0, int(self.scenario.on_path), retract=retract)

    @property
    def complete(self) -> bool:
        """True if a proven motion leads from the given start to the last target."""
        return self.outcome.can_be_driven

    @property
    def outcome(self) -> plan_arrays.Outcome:
        """The plan's outcome: how many targets it reaches and why it ends, see `motion.plans.Outcome`."""
        return self.plans.outcome(0)

    def facts(self, *, verbose: bool = False) -> dict[str, str]:
        """Return the summary as text by label; the length and clearance of the proven motion come first.

        Args:
            verbose: True appends details: the motion, straight joint paths, the walls, and the interior rule.
        """
        s = self.summary
        recovered = f", {s.after_recovery} of them by a recovery" if s.after_recovery else ""
        facts = {
            **({} if self.order is None else self.order.facts()),
            **self.motion_summary.facts(),
            **self._way_back(),
            **self._errors(),
            **self._reduced_margin(),
            **self._length(),
            **self._joint_step(),
            **self._indexed_facts(),
            "targets tracked": f"{s.tracked} of {s.targets} ({100 * s.success_rate:.2f} %){recovered}",
            **self._distances(),
            **self._singular(),
            "workpiece": self.workpiece_place,
            "planning time": f"{s.run_s:.2f} s{self._rate()}, and {s.compile_s:.2f} s of compilation",
            **self._checked(),
        }
        return facts | self._details() if verbose else facts

    @property
    def workpiece_place(self) -> str:
        """Text with the workpiece's pose, in the world or on its link, and the origin subtracted from its files."""
        T = np.asarray(self.scenario.T_world_workpiece)
        return place_of(self.workpiece, T, self.robot.part_link)

    @cached_property
    def manipulability(self) -> Float[np.ndarray, "T"]:
        """Smallest singular value of the task's Jacobian at each target [m/rad]; NaN at targets that are not tracked.

        See `motion.manipulability`.
        """
        with devices.on(devices.choose(self.device)[0]):
            goals = np.asarray(self.scenario.goals)
            tasks = [(each.task, each.here) for each in self._tasks]
            return manipulabilities.along(self.robot, tasks, self.plans.x[0], goals)

    def _singular(self) -> dict[str, str]:
        """Return a line with the smallest manipulability on the path, its target, and the median; {} if unknown."""
        at = self._least_manipulability
        if at is None:
            return {}
        middle = np.nanmedian(self.manipulability[self.scenario.on_path :])
        return {
            "manipulability": f"{self.manipulability[at]:.3g} m/rad minimum, at target {at}; {middle:.3g} m/rad median"
        }

    @property
    def _least_manipulability(self) -> int | None:
        """Index of the target on the path with the smallest manipulability; None if none of them is tracked."""
        first = int(self.scenario.on_path)
        known = self.manipulability[first:]
        return None if np.isnan(known).all() else first + int(np.nanargmin(known))

    def _rate(self) -> str:
        """Return the time per target as text; "" for a few targets, where the search for others prevails."""
        s = self.summary
        return f" ({s.step_ms:.2f} ms per target)" if s.tracked >= RATED or self.complete else ""

    def _length(self) -> dict[str, str]:
        """Return a line with the lengths of the motion in joint space and of the TCP's path; {} without a motion."""
        x, plans = self.motion().x, self.plans
        here = plans.executable[0] & (np.arange(plans.x.shape[1]) >= self.scenario.on_path)
        if not len(x):
            return {}
        steps = np.linalg.norm(np.diff(plans.tcp[0], axis=0), axis=1)
        path = steps[here[1:] & here[:-1] & ~plans.begins_seam[1:]].sum()  # without the air moves between seams
        joints = np.linalg.norm(np.diff(x, axis=0), axis=1).sum()
        return {"motion length": f"{joints:.3g} rad in the joints; {1e3 * path:.4g} mm of the tool's path"}

    def _reduced_margin(self) -> dict[str, str]:
        """Return a line with the segments that have less than `transfer_margin_m`; {} if there are none."""
        plans = self.plans
        here = np.flatnonzero(plans.executable[0] & (plans.segment_status[0] == SegmentStatus.REDUCED_MARGIN))
        found = [f"at least {1e3 * plans.segment_clearance[0, t]:.3g} mm on the segment to target {t}" for t in here]
        most_mm, within_mm = 1e3 * self.job.transfer_margin_m, 1e3 * self.job.transfer_falloff_m
        required = f"; required: {most_mm:g} mm, less within {within_mm:g} mm of both ends of an air move"
        return {"transfer margin": ", ".join(found) + required} if found else {}

    def _way_back(self) -> dict[str, str]:
        """Return a line with the clearance on the way back home if it is smaller than on the motion; else {}."""
        back_m = None if self.order is None else self.order.retract_clearance_m
        if back_m is None or not back_m < self.motion_summary.clearance_m:
            return {}
        return {"way back home": f"guaranteed clearance at least {1e3 * back_m:.3g} mm"}

    @cached_property
    def error_scale(self) -> ErrorScale | None:
        """Largest scale of the job's errors with which the motion stays proven; None without errors, or a motion."""
        x = self.motion().x
        if self.job.errors is None or len(x) < 2:
            return None
        curves = straight(x)
        with devices.on(devices.choose(self.device)[0]):
            if not prove_curves(self._problem, curves).proven:  # as far as it leads, a motion is proven with a margin
                return None
            return error_scale(self._problem, curves, error_set(self._problem, self.job, self.job.errors))

    def _errors(self) -> dict[str, str]:
        """Return a line with the largest scale of the job's errors that is proven, and what limits it; or {}."""
        if self.job.errors is None:
            return {}
        scale, facts = self.error_scale, {"errors": scale_text(self.job.errors, self.error_scale)}
        if scale is None or scale.scale >= 1 or not scale.cover_m:
            return facts
        return facts | failure_texts.denser_mesh(self.workpiece, scale.lack_m(self.motion_summary.clearance_m))

    def _joint_step(self) -> dict[str, str]:
        """Return a line with the largest travel of a joint between consecutive targets; {} if the motion has none."""
        found = self.motion_summary
        if found.joint_step_joint is None:
            return {}
        slides, step = self.robot.sliding[found.joint_step_joint], found.joint_step_max_rad
        size = f"{1e3 * step:.3g} mm" if slides else f"{np.rad2deg(step):.3g} deg"
        name = self.robot.joint_names[found.joint_step_joint]
        return {"largest joint step": f"{size} of {name}, on the segment to target {found.joint_step_target}"}

    @property
    def indexed(self) -> list[runs.IndexedAxes]:
        """Positions of the indexed axes on each seam that the motion reaches; empty without such axes."""
        names = [] if self.order is None else [seam.name for seam in self.job.workpiece.seams]
        return runs.indexed_axes(self.robot, self.plans, int(self.scenario.on_path), names)

    def _indexed_facts(self) -> dict[str, str]:
        """Return a line with the positions of the indexed axes on each seam; {} without such axes."""
        found = self.indexed
        return {"indexed axes": "; ".join(each.description for each in found)} if found else {}

    def _checked(self) -> dict[str, str]:
        """Return lines for the checked bodies, self-collision pairs and fixtures; fixtures on links come first."""
        facts = jobs.build.checked_facts(self.robot, self.obstacles, is_tree=self.job.tree is not None)
        count = sum(len(each.unchecked) for each in self.obstacles if isinstance(each, SelfCollision))
        return facts | ({"pairs not checked": f"{count} that could touch; htcp report names them"} if count else {})

    def _details(self) -> dict[str, str]:
        end = self.outcome
        return {
            **self.motion_summary.details(),
            "straight joint paths": f"{end.blocked_paths} of {end.tracked} between consecutive targets collide",
            **self._nearest_bodies(),
            "clearance is to": self.workpiece.walls,
            "interior rule": f"{interior_rule(self.workpiece, self.scenario)} "
            "(deep inside the part, bodies must stay within its convex hull)",
        }

    def _nearest_bodies(self) -> dict[str, str]:
        """Return a line with the pair of bodies at the minimum clearance. The first call compiles for seconds."""
        clearance = np.where(self.plans.tracked[0], self.plans.clearance[0], np.inf)
        at = int(clearance.argmin())
        if not np.isfinite(clearance[at]):
            return {}
        with devices.on(devices.choose(self.device)[0]):
            found = start_causes.closest_bodies(self._problem, np.asarray(self.plans.x[0, at]))
        return {"minimum clearance": f"at target {at}: {found.body} next to {found.other}"}

    def _distances(self) -> dict[str, str]:
        s, required = self.summary, self._required()
        if not s.tracked:
            return {"clearance": required}
        least = "" if self.robot.pieces is None else "at least "  # larger distances of pieces are not recorded
        facts = {
            "clearance": f"{s.clearance_min_mm:.3g} mm minimum, {least}{s.clearance_mean_mm:.3g} mm mean; {required}"
        }
        if cover_m := self.workpiece.covering_radius_m:
            measured = f"at least {s.clearance_min_mm + 1e3 * cover_m:.3g} mm to points on the part"
            cost = failure_texts.subtracted(self.workpiece, 1e-3 * s.clearance_min_mm)
            facts["clearance measured"] = f"{measured}; {cost}"
        facts["TCP distance"] = f"{s.tcp_distance_mean_mm:.3g} mm mean, {s.tcp_distance_max_mm:.3g} mm maximum"
        mean, largest = s.orientation_error_mean_deg, s.orientation_error_max_deg
        if mean is not None:
            facts["orientation error"] = f"{mean:.3g} deg mean, {largest:.3g} deg maximum"
        if self.tool_angles is not None:
            for name, values in zip(TOOL_ANGLES, self.tool_angles.T, strict=True):
                known = values[np.isfinite(values)]
                if len(known):
                    words = name.removesuffix("_deg").replace("_", " ")
                    facts[words] = f"{known.min():.4g} to {known.max():.4g} deg"
        as_given = not self.motion_summary.transfer_legs
        if as_given and (turn := self.plans.joint_step[0, 0]) > NOTABLE_RAD:
            begin = "home" if self.scenario.auto_start else "the given start"
            facts["first segment"] = f"{turn:.2f} rad in the joints, from {begin} to the first configuration"
        return facts

    @cached_property
    def tool_angles(self) -> Float[np.ndarray, "T 3"] | None:
        """Work angle, travel angle and spin at each target [degrees]; None if no task has a row with tool angles."""
        if not self.tool_axis_rows:
            return None
        found = np.full((self.plans.status.shape[1], 3), np.nan)
        known = self.robot, self.workpiece, self.plans.x[0]
        with devices.on(devices.choose(self.device)[0]):
            rows = {row for _, row in self.tool_axis_rows}
            by_row = {row: tool_angles_at(self.scenario, row, *known) for row in rows}
        for here, row in self.tool_axis_rows:
            found[here] = by_row[row][here]
        return found

    @property
    def tool_axis_rows(self) -> list[tuple[slice, ToolAxisRow]]:
        """Targets of each seam whose task has a row with the tool's angles, and this row."""
        bounds = pairwise((0, *self.plans.seam_begins, self.plans.status.shape[1]))
        rows = zip(bounds, map(tool_axis_row, self.job.tasks), strict=True)
        return [(slice(*ends), row) for ends, row in rows if row is not None]

    def _required(self) -> str:
        """Return the required clearance as text; where seams have their own, the smallest and the largest one."""
        margins = [jobs.margin_of(self.job, seam) for seam in self.job.workpiece.seams] or [self.job.margin_m]
        low, high = 1e3 * min(margins), 1e3 * max(margins)
        return f"{high:g} mm required" if low == high else f"{low:g} to {high:g} mm required, by seam"

    @property
    def _seam_names(self) -> list[str]:
        """Name of the seam of each target, for a job with several seams."""
        return [self.job.workpiece.seams[seam].name for seam in self.plans.seam_of_targets.tolist()]

    @cached_property
    def obstruction(self) -> Obstruction | None:
        """The body with the smallest clearance at the failed target, and its obstacle.

        None if all targets are tracked, or if no body of the arm collides at the failed one, see `blocked_target`.
        """
        if (failed := obstructions.blocked_target(self.plans, 0)) is None:
            return None
        x_last, scenario = self.plans.before(0, failed), self.scenario
        if (lost := self._lost_place) is not None:
            x_last, scenario = lost.x_last, lost.scenario
        with devices.on(devices.choose(self.device)[0]):
            own = self._task_at(failed)
            task, known = own.task, (self.robot, self.workpiece, own.in_scenario(scenario))
            return obstructions.obstruction(*known, x_last, failed, self.job.settings, self.obstacles, task)

    @cached_property
    def start_cause(self) -> start_causes.StartCause | None:
        """The reason why the plan could not begin; None if it began. The reasons are listed in `start_cause.CAUSES`."""
        if (status := self.plans.status[:, 0])[0] not in start_causes.CAUSES:
            return None
        with devices.on(devices.choose(self.device)[0]):
            return start_causes.start_causes(self._problem, status)[0]

    @cached_property
    def _problem(self) -> Problem:
        """The job's scenario with the task of its first seam as a problem, to measure single configurations."""
        own, execution = self._task_at(0), Execution(self.device, threads=1)
        one = scenarios.stack([own.in_scenario(self.scenario)])
        return Problem(self.robot, self.workpiece, one, self.job.settings, own.task, self.obstacles, execution)

    @cached_property
    def refused_segment(self) -> RefusedSegment | None:
        """The segment to the failed target that violates its conditions the least; None if none is known.

        It is measured if the search found no configuration there, or no segment to one, see `refused_segment`.
        """
        end, at = self.outcome, self.obstruction
        if end.status not in failure_texts.MEASURED or end.failed is None or at is None or not at.reached:
            return None
        lost, problem, x_last = self._lost_place, self._problem, self.plans.before(0, end.failed)
        one, x_last = (self.scenario, x_last) if lost is None else (lost.scenario, lost.x_last)
        limited = scenarios.with_max_joint_step(scenarios.stack([one]), self.job.settings.max_joint_step_rad)
        with devices.on(devices.choose(self.device)[0]):
            return refused_segment(problem.with_scenarios(limited), x_last, end.failed, at.x)

    @property
    def _nearest_attempt(self) -> Obstruction | None:
        """The colliding body in the configuration that came nearest to a valid beginning; None if there is none."""
        if self.start_cause is None or (found := self.start_cause.attempt) is None:
            return None
        label = robots.capsule_label(self.robot, found.body)
        return Obstruction(found.body, found.point, found.depth_m, 0.0, True, found.x, found.other, body_label=label)

    @cached_property
    def _lost_place(self) -> LostPlace | None:
        """The inserted goal between two targets at which the plan failed; None if it failed elsewhere."""
        failed = self.outcome.failed
        if failed is None or self.outcome.status in NOT_TRIED or self.plans.begins_seam[failed]:
            return None
        own = self._task_at(failed)
        scenario = own.in_scenario(self.scenario)
        return lost_place(self.robot, own.task, scenario, self.job.settings, self.plans, failed)

    @cached_property
    def _tasks(self) -> list[jobs.TargetTask]:
        """The tasks of the seams, with their targets."""
        return jobs.tasks_of_targets(self.job, self.robot, self.plans.seam_of_targets)

    def _task_at(self, target: int) -> jobs.TargetTask:
        """Return the task at a target."""
        return next(each for each in self._tasks if each.here[target])

    @property
    def dead_ends(self) -> dict[int, Tried]:
        """The beam search's attempts to continue after its dead ends, by the target of the dead end."""
        return self.plans.dead_ends.on(0)

    def failure(self) -> dict[str, str]:
        """Return text by label: the failed target, the reason and the colliding body; empty if the plan is complete."""
        if self.order is not None:
            missing = self.order.failure()
            each = {"next": f"htcp reachability {self.arguments} --each   tests every target of each seam"}
            return missing | each if missing else {}
        end, refused = self.outcome, self.refused_segment
        facts = {} if end.status is None else {f"failed at target {end.failed}": failure_texts.reason(end, refused)}
        if (lost := self._lost_place) is not None and end.failed is not None:
            place = f"{100 * lost.share:.0f} % of the way from target {end.failed - 1}"
            facts[f"failed at target {end.failed}"] += f"; at {place}"
        for target, tried in self.dead_ends.items():  # the search got past earlier dead ends
            if end.failed is not None and target >= end.failed:
                facts[f"after the dead end at target {target}"] = failure_texts.attempts(tried, self.job.settings)
        bound = self.job.settings.max_joint_step_rad
        if bound is not None and end.failed is not None and end.failed > self.scenario.on_path:
            facts["joint steps"] = (
                f"settings.max_joint_step_rad allows {bound} from target to target; "
                "try a larger bound, or targets that are closer together"
            )
        if self.start_cause is not None:
            facts["cause"] = self.start_cause.description
        elif self.obstruction is not None and (self.obstruction.reached or end.failed or self.job.start is not None):
            facts[self.obstruction.heading] = self.obstruction.description
        nearest = self.start_cause and self.start_cause.attempt
        if refused is not None:
            nearest = self._nearest_at(refused)
            facts["segment"] = refused.description(nearest.description if nearest else "")
            facts |= failure_texts.aim(refused, self.job)
        start_m = None if self.start_cause is None or not self.start_cause.depth_m < 0 else -self.start_cause.depth_m
        lack_m = np.inf
        if nearest is not None and nearest.other == THE_WORKPIECE:
            lack_m = nearest.depth_m + (self.job.margin_m if refused is None else refused.margin_m)
        if spacing := denser_spacing(self.workpiece, lack_m):
            facts |= failure_texts.coarse_mesh(self.workpiece.covering_radius_m, lack_m)
        facts |= failure_texts.next_step(end, refused, self.dead_ends, self.job, self.arguments, spacing, start_m)
        if end.executable < end.tracked:
            facts[f"no segment to target {end.executable}"] = end.segment_status.message
        return facts

    def _nearest_at(self, refused: RefusedSegment) -> start_causes.Attempt | None:
        """Return the bodies nearest to each other where a segment is refused; None if it is clear there."""
        if refused.leaves_path or refused.verdict == SegmentStatus.VALID:
            return None
        with devices.on(devices.choose(self.device)[0]):
            return start_causes.closest_bodies(self._problem, refused.x)

    def frame(self) -> "pandas.DataFrame":
        """Return a table with one row per target, with the columns of the table of targets of a sweep."""
        return runs.tables.table_frame(
            runs.tables.target_table(
                self.job.method,
                np.zeros(1, int),
                self.plans,
                runs.tables.joint_columns(self.robot),
                self.manipulability[None],
                runs.tables.follower_columns(self.robot, self.plans.x),
                None if self.tool_angles is None else self.tool_angles[None],
            )
        )

    def figure(self) -> "Figure":
        """Draw the arm in the workpiece, and the clearance along the path."""
        from htcp_jax.viewer import draw_plan, glyphs  # here, as matplotlib takes half a second to import

        return draw_plan(
            self.robot,
            self.workpiece,
            self.scenario,
            self.plans,
            title=f"{self.job.method}: {self.summary.tracked} of {self.summary.targets} targets",
            obstruction=self.obstruction or self._nearest_attempt,
            fixtures=jobs.build.drawn_of(self.job.cell, self.robot),
            normals=glyphs(self.job.task_rows, self.workpiece, np.asarray(self.scenario.T_world_workpiece)),
            angles=None if self.tool_angles is None else (self.tool_axis_rows, self.tool_angles),
            seams=() if self.order is None else [seam.name for seam in self.job.workpiece.seams],
        )

    def record(self) -> dict[str, Any]:
        """Return the contents of summary.json.

        It contains the summary, a description of the failed target, versions, commit and plugins, the complete job
        with absolute file paths, and the SHA-256 of these files.
        """
        known = {"method": self.job.method, "validated": None, **plan_folder.summary_record(self.summary)}
        known["motion"] = self.motion_summary.record()
        if self.order is not None:
            known["order"] = self.order.record()
        if self.job.errors is not None:
            known["errors"] = errors_record(self.job.errors, self.error_scale)
        if self.robot.indexed:
            known["indexed"] = [each.record() for each in self.indexed]
        if (joint := self.motion_summary.joint_step_joint) is not None:
            known["motion"]["joint_step_joint"] = self.robot.joint_names[joint]
        at = self._least_manipulability
        known["manipulability_min_m_rad"] = None if at is None else float(self.manipulability[at])
        known["manipulability_min_target"] = at
        known["colliding_body"] = self.obstruction and self.obstruction.record()
        known["dead_ends"] = [{"target": target} | tried.record() for target, tried in self.dead_ends.items()]
        known["cause"] = self.start_cause and self.start_cause.description
        config = self.job.model_dump()
        files = runs.input_files.file_hashes(runs.input_files.anchor_files(config))
        plugins = provenance.plugins_of(registry.METHODS, [self.job.method]) | provenance.plugins_of_kinds(self.job)
        with devices.on(devices.choose(self.device)[0]):
            return {**known, **provenance.planned_by(), "plugins": plugins, "config": config, "files": files}

    def write(self, folder: Path, *, retract: bool = False) -> None:
        """Write motion.csv, trajectory.csv, trajectory.npz, summary.json and plan.png into an existing folder.

        Args:
            folder: The folder; it must exist.
            retract: True appends the motion back to home or the start in motion.csv.
        """
        seams = None if self.order is None else self._seam_names
        moved = self.motion(retract=retract)
        plan_folder.write_motion_csv(folder / "motion.csv", self.robot, moved, seams)
        known = self.plans, self.manipulability
        plan_folder.write_trajectory_csv(
            folder / "trajectory.csv", self.robot, *known, seams=seams, angles=self.tool_angles
        )
        plan_folder.write_trajectory_npz(folder / "trajectory.npz", self.robot, self.plans)
        output_files.write_json(folder / "summary.json", self.record())
        self.figure().savefig(folder / "plan.png", pil_kwargs={"compress_level": 1})  # in a fifth of the time

    def save(self, folder: str | Path, *, retract: bool = False) -> None:
        """Write the five files of `write` into `folder`: all or none.

        Results of `htcp validate` for an earlier plan in this folder are removed.

        Args:
            folder: The folder; it is created if it does not exist.
            retract: See `write`.

        Raises:
            InputError: If the files cannot be written, or if the folder contains a run.
        """
        plan_folder.refuse_run(Path(folder))
        with output_files.written_whole(Path(folder)) as scratch:
            self.write(scratch, retract=retract)
        forget_validation(Path(folder))

    def __str__(self) -> str:
        done = self.workpiece.name if self.order is None else self.order.done
        return f"{self.job.method}: {self.robot.name}, {done}"

    def __repr__(self) -> str:
        return f"Plan({self}, {self.summary.tracked} of {self.summary.targets} targets tracked)"

    def _repr_html_(self) -> str:
        return html_facts(str(self), self.facts() | self.failure())


def open_plan(folder: str | Path) -> Plan:
    """Open the plan in a folder of `htcp plan`, with its scene. Its times are 0, as they are not saved with it.

    Raises:
        InputError: If the folder contains no plan of one job, if a file is damaged, or if a cloud, path or model has
            changed since planning.
    """
    found = runs.open_plans(folder)
    if not isinstance(found, runs.open.FolderPlan):
        raise InputError(f"{folder} contains a run, not one plan of htcp plan")
    job, robot, workpiece, scenario = jobs.build.resolved_scene(found.config, str(folder))
    robot, scenario = with_own_tool(robot, scenario)
    obstacles, plans = jobs.build.obstacles_of(job.cell, robot), found.plans(job.method)
    return Plan(job, robot, workpiece, scenario, plans, obstacles, order=found.order)


def forget_validation(folder: Path) -> None:
    """Remove the results of `htcp validate` for an earlier plan from a folder."""
    (folder / plan_folder.VALIDATION).unlink(missing_ok=True)


def plan(
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    *,
    method: str | registry.Method | None = None,
    progress: Callable[[batch.Progress], None] | None = None,
    device: str | None = None,
    obstacles: Sequence[obstacle_kind.ObstacleKind | Mapping[str, Any]] = (),
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None = None,
) -> Plan:
    """Plan one job, and return the job with its plan.

    Args:
        config: The job: a YAML file, the name of an example, or a mapping of a file's keys, such as
            {"workpiece": {"rotation_y_rad": 0.5}}. None: the default job.
        overrides: Changes to the job, as on the command line, ["margin_m=0.001"], or as values, {"margin_m": 0.001,
            "workpiece.rotation_y_rad": 0.5}.
        method: The planning method: a name in `methods()`, or a `Method`. None: the job's.
        progress: Function that is called while planning, with the number of scenarios and targets planned so far.
        device: The device, see `device.devices`. None: a GPU if there is one.
        obstacles: Obstacles in addition to the job's, as `ObstacleKind` values or as mappings as in a job file.
        task: Task rows that replace the job's, as `TaskRowKind` values or as mappings as in a job file.

    Raises:
        InputError: If the input is invalid, or if the start collides.
    """
    if method is not None:
        name = method if isinstance(method, str) else method.name
        overrides = {**overrides, "method": name} if isinstance(overrides, Mapping) else [*overrides, f"method={name}"]
    with devices.on(devices.choose(device)[0]):
        job = with_kinds(load_config(config, overrides), obstacles, task)
    chosen = None if isinstance(method, str) else method
    known = {"source": source_of(config), "arguments": failure_texts.arguments(config, overrides)}
    return plan_job(job, chosen, **known, progress=progress, device=device)


def plan_job(
    job: PlanConfig,
    method: registry.Method | None = None,
    *,
    source: str = "the configuration",
    arguments: str = "JOB",
    progress: Callable[[batch.Progress], None] | None = None,
    device: str | None = None,
) -> Plan:
    """Plan a job that `jobs.load_config` has loaded, and return the job with its plan.

    Args:
        job: The job.
        method: The planning method; None: the job's.
        source: Name of the job, for messages.
        arguments: The job as arguments of a command, see `Plan.arguments`.
        progress: See `plan`.
        device: See `plan`.

    Raises:
        InputError: See `plan`.
    """
    first = devices.choose(device)[0]
    job = job.model_copy(update={"settings": job.settings.on(first.platform)})
    with devices.on(first):
        chosen = method or planning_methods.find(job.method)
        job, robot = jobs.build.with_robot(job, source)
        if len(job.workpiece.seams) > 1:
            return replace(_plan_seams(job, robot, chosen, progress, device), arguments=arguments)
        workpiece = jobs.build.workpiece_of(job.workpiece, robot)
        scenario = jobs.build.scenario_of(job, robot, workpiece)
        all_obstacles = jobs.build.obstacles_of(job.cell, robot)
        task, execution = jobs.build.task_of_job(job, robot), Execution(device)
        problem = Problem.of(
            robot, workpiece, scenario, job.settings, task, all_obstacles, execution, check_starts=True
        )
        _check_errors(problem, job)
        plans = batch.plan(problem, chosen, progress)
        robot, scenario = with_own_tool(robot, scenario)
    return Plan(job, robot, workpiece, scenario, plans, all_obstacles, device, arguments=arguments)


def _check_errors(problem: Problem, job: PlanConfig) -> None:
    """Check that the problem has what the job states errors of.

    Raises:
        InputError: See `proving.error_set`.
    """
    if job.errors is not None:
        error_set(problem, job, job.errors)


def _plan_seams(
    job: PlanConfig,
    robot: Robot,
    method: registry.Method,
    progress: Callable[[batch.Progress], None] | None,
    device: str | None,
) -> Plan:
    """Plan a resolved job with several seams, see `sequencing`."""
    sequencing.check_solver()
    found = jobs.seam_scenarios.seam_scenarios(job, robot)
    all_obstacles, names = jobs.build.obstacles_of(job.cell, robot), [seam.name for seam in job.workpiece.seams]

    def problem_of(part: Workpiece, given: Scenario, task: Task) -> Problem:
        return Problem.of(robot, part, given, job.settings, task, all_obstacles, Execution(device))

    problems = [
        problem_of(found.workpiece, scenarios.with_goals_of(found.scenarios, task.numbers), task)
        for task in found.tasks
    ]
    problem = problems[0]
    _check_errors(problem, job)
    began = time.perf_counter()
    home = None if problem.begins_anywhere[0] else np.asarray(problem.scenarios.x_home[0])
    speed = joint_speeds(robot, job)
    plans = sequencing.plan_seams(problems, found.variants, home, speed, method, progress)
    if any(each.status[0, 0] in BEGINS_IN_COLLISION for each in plans.best.values()):
        start_causes.check_starts(problem, ())
    seams = found.variants.seam[[plan.variant for plan in plans.found]] if plans.found else np.empty(0, int)
    moves, seed = sequencing.moves_between(problem, plans.found, home, speed), job.settings.seed
    sequence = sequencing.find_sequence(seams, plans.found, found.before, moves, seed, progress)
    done = [visit.variant for visit in sequence.visits]
    missing = sorted(set(range(len(names))) - set(found.variants.seam[done].tolist()))
    lost = {s: plans.best.get(s) or sequencing.not_joined(problem, found.variants, s) for s in missing}
    job, workpiece, scenario = jobs.seam_scenarios.in_order(found, robot, done, missing)
    seam = jobs.seam_of_rows(workpiece)
    seam = np.append(np.zeros(len(scenario.targets) - len(seam), int), seam)
    tasks = jobs.tasks_of_targets(job, robot, seam)
    whole = [(problem_of(workpiece, each.in_scenario(scenario), each.task), each.here) for each in tasks]
    made = sequencing.whole_plans(whole, sequence, list(lost.values()))
    made = made._replace(compile_s=plans.compile_s, run_s=time.perf_counter() - began - plans.compile_s)
    reasons = {names[s]: plan.outcome(0) for s, plan in lost.items()}
    order = SeamOrder.of(job, made, sequence, reasons)
    robot, scenario = with_own_tool(robot, scenario)
    return Plan(job, robot, workpiece, scenario, made, all_obstacles, device, order)


def joint_speeds(robot: Robot, job: PlanConfig) -> Float[np.ndarray, "N"]:
    """Return the full speeds of the joints [rad/s or m/s]; 1 where neither the job nor the model limits them."""
    speed = np.broadcast_to(trajectory.stated_limits(robot, job.program).velocity, (len(robot.joint_names),))
    return np.where(np.isfinite(speed), speed, 1.0)


def methods() -> "pandas.DataFrame":
    """Return a table of the planning methods: name (index), title and description.

    If a method of another package cannot be imported, it is excluded, with a UserWarning that contains the reason.
    """
    import pyarrow as pa

    known = registry.descriptions().items()
    rows = [{"method": name, "title": title, "description": description} for name, (title, description) in known]
    return runs.tables.table_frame(pa.Table.from_pylist(rows)).set_index("method")
