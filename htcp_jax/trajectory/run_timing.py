"""Time parameterisation of all scenarios in a run: `time_run(run, "20mm/s")` writes one file per method into the run.

Timing does not change plans. A run may be timed again: with another feed or other limits, all times are replaced; with
the same, only missing scenarios are timed. Scenarios are timed one by one, so their order and the number of processes
do not influence the times. Torques are computed for a block of scenarios at once.
"""

import os
import pickle
from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pyarrow as pa

from htcp_jax.device import processes
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.io.robots import RATES, JointLimits
from htcp_jax.jobs import build
from htcp_jax.model import Robot, Workpiece
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans, motion
from htcp_jax.runs import Run, open_run, timing_file
from htcp_jax.runs import open as plan_sets
from htcp_jax.spec import PlanConfig
from htcp_jax.system import files, lock, stop_message
from htcp_jax.trajectory.figures import ProgramFigures, program_figures
from htcp_jax.trajectory.joint_torques import TORQUES_EVERY_S, PeakTorque, model_of, peak_torques, torques
from htcp_jax.trajectory.limits import joint_limits
from htcp_jax.trajectory.limits_file import check_ranges, limits_of_job
from htcp_jax.trajectory.plan_program import PlanProgram, requested_feed, requested_feeds, timed_plan, with_program
from htcp_jax.trajectory.program import NothingToTimeError
from htcp_jax.trajectory.timed_motion import TimedMotion

BLOCK = 64  # number of scenarios per write and torque computation, limited by memory
EACH_PAYS, MOST = 128, 16  # number of scenarios that justify one more process; maximum number of processes
PART = 4  # number of scenarios per work unit of a process
LIMITS = "velocity", "acceleration", "jerk", "full_speed_s", "full_acceleration_s"  # keys of `program`
NEAR_PART = "near_part_m", "near_part_speed"  # more keys, if programs are slower near the part


class _TimingSettings(NamedTuple):
    """Feed rate and overrides with which a run is timed."""

    feed_m_s: float  # with feeds by seam, the largest one
    seam_feeds: dict[str, float]  # by the seam's name [m/s]; empty: one feed
    overrides: tuple[str, ...]


class _TimedScenario(NamedTuple):
    """Figures and samples of one timed scenario."""

    figures: ProgramFigures
    timed: TimedMotion | None  # samples for the torques; None if the arm's model has no inertias
    effort: np.ndarray  # effort limits of the joints [N m or N]


def time_run(
    run: Run,
    feed: str | None = None,
    methods: Sequence[str] | None = None,
    *,
    overrides: Sequence[str] = (),
    stated: JointLimits | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    workers: int | None = 1,
    block: int = BLOCK,
) -> Run:
    """Time every scenario of a run whose motion leads to its last target.

    Args:
        run: The run.
        feed: Feed rate of the TCP on the path, such as "20mm/s"; None: the seams' own, or the job's.
        methods: Names of methods; None: all methods with results.
        overrides: Changes to the job's section `program`, as on the command line.
        stated: Limits in a file, whose ranges all motions must satisfy; None: no file. Its other limits are overrides,
            see `limits_overrides`.
        progress: Function that is called with a method, the number of its finished scenarios, and their total.
        workers: Number of processes; None: chosen by the number of scenarios.
        block: Number of scenarios that are computed together and then written.

    Returns:
        The run, whose `scenarios()` now include the times.

    Raises:
        InputError: If the feed rate is invalid, if the run has no results or lacks a method, if an arm has no velocity
            limits, if a motion leaves a range in `stated`, if files have changed, or if the folder is in use or cannot
            be written.
        Interrupted: On SIGINT and SIGTERM; finished times are kept.
    """
    job = with_program(run.config, overrides)
    feeds = requested_feeds(feed, job)
    by_seam = () if isinstance(feeds, float) else feeds
    seam_feeds = dict(zip((seam.name for seam in job.workpiece.seams), by_seam, strict=False))
    requested = _TimingSettings(max(by_seam, default=feeds), seam_feeds, tuple(overrides))
    timer = _Timer(plan_sets.plans_of_run(run), requested)
    chosen = _chosen_methods(timer.found, methods)
    check_limits(timer.jobs)
    if stated is not None:
        _check_motions(timer, chosen, stated)
    stopped = f"stopped; finished times are in {run.folder}; run the same command to resume"
    with stop_message(lambda: stopped), lock.locked(run.folder), lock.signals() as came:
        find = _finder(timer, chosen, workers)
        for method in chosen:
            _time_method(timer, method, find, block, progress, came)
    return run


def check_limits(jobs: Iterable[PlanConfig]) -> None:
    """Check that the arms in some jobs have valid joint limits.

    Raises:
        InputError: If an arm has no velocity limits, or if a list of limits has not one value per joint.
    """
    for job in {repr((build.robot_key(job), job.program)): job for job in jobs}.values():
        robot = build.robot_of(job.robot, tree=job.tree)
        joint_limits(robot, job.program, limits_of_job(job, robot))


def _check_motions(timer: "_Timer", methods: Sequence[str], stated: JointLimits) -> None:
    """Check that all motions that lead to their last target are within the ranges in a file.

    Raises:
        InputError: For the motion that is farthest outside, among those of arms with the same ranges.
    """
    on_path = np.array([job.on_path for job in timer.jobs])
    arms: dict[tuple[bytes, bytes], tuple[Robot, list[int]]] = {}
    for number, job in enumerate(timer.jobs):
        arm = timer.arm(job)
        arms.setdefault((np.asarray(arm.lower).tobytes(), np.asarray(arm.upper).tobytes()), (arm, []))[1].append(number)
    for method in methods:
        plans = timer.plans(method)
        timed = [plans.outcome(scenario).can_be_driven for scenario in range(len(plans.x))]
        moved = motion.motions(plans, on_path, plans.executable & np.array(timed)[:, None])
        for arm, scenarios in arms.values():
            own = np.isin(moved.scenario, scenarios)
            moved_by_arm = motion.Motions(*(column[own] for column in moved))
            check_ranges(stated, arm, moved_by_arm, f"{timer.found.folder}, {method}")


def _chosen_methods(found: plan_sets.RunPlans, methods: Sequence[str] | None) -> tuple[str, ...]:
    for method in methods or ():
        if method not in found.methods:
            raise InputError(f"{found.folder} has no plans by {method!r}; valid: {', '.join(found.methods)}")
    return found.methods if methods is None else tuple(methods)


class _Timer:
    """Timer for the scenarios of a run; arms and parts that scenarios share are read once."""

    def __init__(self, found: plan_sets.RunPlans, requested: _TimingSettings):
        self.found, self.requested = found, requested
        self.plans: Callable[[str], Plans] = cache(found.plans)
        self._known: dict[tuple[str, str], Any] = {}

    def _once(self, what: str, key: object, make: Callable[[], Any]) -> Any:
        """Return the result of `make`, which is called once for equal keys."""
        if (known := (what, repr(key))) not in self._known:
            self._known[known] = make()
        return self._known[known]

    def __reduce__(self):
        """Pickle the folder's name only; a worker process reads the folder itself."""
        return _opened, (self.found.folder.resolve(), self.requested, os.urandom(8))

    @cached_property
    def jobs(self) -> list[PlanConfig]:
        """Jobs of the scenarios, with the overrides of the section `program`."""
        return [with_program(job, self.requested.overrides) for job in self.found.jobs]

    @property
    def made_with(self) -> timing_file.Timing:
        """The timing settings as a `Timing` without rows."""
        job = with_program(self.found.config, self.requested.overrides)
        limits = {key: job.program.model_dump(mode="json")[key] for key in LIMITS}
        if job.program.near_part_speed < 1:
            limits |= {key: getattr(job.program, key) for key in NEAR_PART}
        if (stated := self._limits_in_file(job)) is not None:
            limits |= {
                kind: Path(stated.file).name
                for kind in RATES
                if limits[kind] is None and not np.isnan(stated.rates(kind)).all()
            }
        if self.requested.seam_feeds:
            limits[timing_file.SEAM_FEEDS] = self.requested.seam_feeds
        return timing_file.Timing(self.requested.feed_m_s, limits, timing_file.SCHEMA.empty_table())

    def feed_m_s(self, scenario: int) -> float:
        """Return the required feed rate of a scenario: its seam's own, or that of the run."""
        return requested_feed(None, self.jobs[scenario]) if self.requested.seam_feeds else self.requested.feed_m_s

    def known(self, method: str) -> timing_file.Timing:
        """Return a method's existing times if they have the same settings, else a `Timing` without rows.

        A damaged file is ignored.
        """
        try:
            there = timing_file.read_timing(self.found.folder, self.found.run.manifest.shards, method)
        except InputError:
            there = None
        return there if there is not None and there[:2] == self.made_with[:2] else self.made_with

    def missing(self, method: str) -> list[int]:
        """Return a method's scenarios with results but without times."""
        shards = [shard for shard in self.found.run.manifest.shards if shard.method == method]
        planned = {number for shard in shards for number in shard.scenario_numbers}
        return sorted(planned - set(self.known(method).rows["scenario"].to_pylist()))

    def one(self, method: str, scenario: int) -> _TimedScenario | None:
        """Time a scenario; None if no motion leads to its last target."""
        plans, job = self.plans(method), self.jobs[scenario]
        if not plans.outcome(scenario).can_be_driven:
            return None
        arm = self.arm(job)
        goals = build.scenario_of(job, arm, self._part(job, arm)).goals if job.task_rows else None
        robot = robots.lengthen_tool(arm, job.robot.tool_extension_m)
        limits = joint_limits(robot, job.program, self._limits_in_file(job))
        try:
            made = timed_plan(plans, scenario, job, robot, goals, limits, self.feed_m_s(scenario), method)
        except NothingToTimeError:
            return None
        return _TimedScenario(program_figures(made.program, made.limits), self._timed(made), np.asarray(robot.effort))

    def _timed(self, made: PlanProgram) -> TimedMotion | None:
        return None if self._model(made.job) is None else made.program.timed(made.program.long_step_s(TORQUES_EVERY_S))

    def loads(self, block: Sequence[int], found: Sequence[_TimedScenario | None]) -> dict[int, PeakTorque]:
        """Return the peak torques of a block's motions, by scenario; an arm's motions are computed at once."""
        arms: dict[str, dict[int, _TimedScenario]] = {}
        for number, one in zip(block, found, strict=True):
            if one is not None and one.timed is not None:
                arms.setdefault(repr(build.robot_key(self.jobs[number])), {})[number] = one
        loads: dict[int, PeakTorque] = {}
        for own in arms.values():
            number, first = next(iter(own.items()))
            motions, torque = [one.timed for one in own.values()], self._torques(self.jobs[number])
            loads |= zip(own, peak_torques(torque, motions, first.effort), strict=True)
        return loads

    def _torques(self, job: PlanConfig) -> Callable:
        key, locked = build.robot_key(job), dict(job.robot.locked)
        return self._once("torques", key, lambda: torques(self._model(job), locked, self.arm(job).coupling))

    def _model(self, job: PlanConfig) -> mujoco.MjModel | None:
        """Return the model of a job's arm with its inertias; None if a link has no inertia."""
        return self._once("model", build.robot_key(job), lambda: model_of(job.robot, job.tree))

    def arm(self, job: PlanConfig) -> Robot:
        """Return a job's arm, without the tool's extension."""
        return self._once("arm", build.robot_key(job), lambda: build.robot_of(job.robot, job.cell, job.tree))

    def _limits_in_file(self, job: PlanConfig) -> JointLimits | None:
        """Return the limits in the file that a job names; None if it names no file."""
        if job.robot.limits_file is None:
            return None
        return self._once("limits", build.robot_key(job), lambda: limits_of_job(job, self.arm(job)))

    def _part(self, job: PlanConfig, arm: Robot) -> Workpiece:
        key = build.workpiece_key(job)
        return self._once("part", (build.robot_key(job), key), lambda: build.workpiece_of(key, arm))


def _time_method(
    timer: _Timer, method: str, find: Callable, block: int, progress: Callable | None, came: list[int]
) -> None:
    """Time a method's missing scenarios block by block, and write the times after every block."""
    missing, known = timer.missing(method), timer.known(method)
    everything = len(missing) + len(known.rows)
    for first in range(0, len(missing), block):
        if progress is not None:
            progress(method, everything - len(missing) + first, everything)
        if came:
            raise Interrupted(_stop_text(timer, method, everything - len(missing) + first, everything), came[0])
        numbers = missing[first : first + block]
        found = find(method, numbers)
        loads = timer.loads(numbers, found)
        rows = [
            _timing_row(number, timer.feed_m_s(number), one, loads.get(number))
            for number, one in zip(numbers, found, strict=True)
        ]
        known = known._replace(rows=pa.concat_tables([known.rows, pa.Table.from_pylist(rows, timing_file.SCHEMA)]))
        _write(timer.found.run, method, known)
    if progress is not None:
        progress(method, everything, everything)


def _stop_text(timer: _Timer, method: str, done: int, of: int) -> str:
    return f"stopped; {done} of {of} scenarios of {method} are timed in {timer.found.folder}; the same command resumes"


def _write(run: Run, method: str, timing: timing_file.Timing) -> None:
    files.make_folder(run.folder, timing_file.TIMING)
    name = str(timing_file.timing_file(run.folder, method).relative_to(run.folder))
    files.write_atomically(run.folder, name, timing_file.timing_bytes(timing, run.manifest.shards, method))


def _timing_row(number: int, feed_m_s: float, one: _TimedScenario | None, peak_torque: PeakTorque | None) -> dict:
    """Return a scenario's row in the file of times."""
    row = {"scenario": number, "feed_m_s": feed_m_s}
    if one is None:
        return row
    found = one.figures
    row |= {"cycle_time_s": found.duration_s, "path_time_s": found.path_s, "feed_reason": found.reason}
    row["feed_target"] = found.reached_target
    row |= {"feed_held_share": _or_none(found.held_share), "feed_reached_m_s": _or_none(found.reached_m_s)}
    for share in found.path_shares:
        row |= {f"{share.limit}_share": share.share, f"{share.limit}_joint": share.joint}
    return row | (
        {"torque_share": peak_torque.share, "torque_joint": peak_torque.joint}
        if peak_torque is not None and peak_torque.share
        else {}
    )


def _or_none(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _finder(timer: _Timer, methods: Sequence[str], workers: int | None) -> Callable[[str, Sequence[int]], list]:
    """Return a function that times scenarios of a method in `workers` processes; None: a suitable number."""
    if workers is None:
        missing = sum(len(timer.missing(method)) for method in methods)
        workers = min(os.cpu_count() or 1, MOST, missing // EACH_PAYS)
    if workers < 2:
        return lambda method, block: [timer.one(method, number) for number in block]
    shared = pickle.dumps((timer,))

    def find(method: str, block: Sequence[int]) -> list[_TimedScenario | None]:
        parts = [(method, block[first : first + PART]) for first in range(0, len(block), PART)]
        return list(chain(*processes.spread([processes.ON_CPU] * workers, _time_part, shared, parts, None).results))

    return find


# Functions that run in a worker


def _opened(folder: Path, requested: _TimingSettings, _: bytes) -> _Timer:
    return _Timer(plan_sets.RunPlans(open_run(folder)), requested)


def _time_part(notify: Callable, timer: _Timer, part: tuple[str, Sequence[int]]) -> list[_TimedScenario | None]:
    method, numbers = part
    return [timer.one(method, number) for number in numbers]
