"""A run whose shards are written by a thread, while the next ones are planned."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
import pyarrow as pa
from jaxtyping import Float

from htcp_jax.device import devices
from htcp_jax.device import tables as device_tables
from htcp_jax.jobs import Batch
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.model import tool_angles_at
from htcp_jax.motion import Execution, Plans, Problem, manipulability, start_cause
from htcp_jax.planning import Progress
from htcp_jax.runs import writer
from htcp_jax.runs.local import PlannedShard, scenarios_of
from htcp_jax.runs.manifest import Span
from htcp_jax.runs.run_folder import Run
from htcp_jax.runs.running import FinishedShard
from htcp_jax.runs.tables import follower_columns, joint_columns, scenario_table, target_table
from htcp_jax.spec import TOOL_ANGLES, tool_axis_row


class SweepProgress(NamedTuple):
    """Progress of one method, counted over all its shards in the run."""

    method: str
    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int
    starts: int | None = None  # of the current shard, see `planning.batch.Progress`
    is_planning: bool = False  # True while a shard is planned


class WrittenRun:
    """A run to which a thread adds planned shards, one after the other, while the next ones are planned.

    At the end of its context all added shards are written.

    Args:
        run: The run.
        batch: The scenarios.
        device: Device that measures configurations for the tables.
        finished: Function that is called, in the thread that calls `add` and `wait`, with each written shard.
    """

    def __init__(
        self, run: Run, batch: Batch, device: jax.Device, finished: Callable[[FinishedShard], None] | None = None
    ):
        self.run, self._batch, self._device, self._finished = run, batch, device, finished
        self._thread = ThreadPoolExecutor(1)
        self._writing: Future[FinishedShard] | None = None
        self._done: Counter[str] = Counter()  # by method
        self._tracked: Counter[str] = Counter()
        for shard in run.manifest.shards:
            self._count(shard.method, shard.scenarios.rows, shard.tracked)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_) -> None:
        self._thread.shutdown()

    def add(self, planned: PlannedShard) -> None:
        """Write a shard in the thread, after the shard before it.

        Raises:
            InputError: If the shard before it cannot be written.
        """
        self.wait()
        self._count(planned.shard.method, len(planned.shard.rows), int(planned.plans.tracked.sum()))
        self._writing = self._thread.submit(self._write, planned)

    def wait(self) -> None:
        """Wait until the last shard is written.

        Raises:
            InputError: If it cannot be written.
        """
        if self._writing is not None:
            shard = self._writing.result()
            self._writing = None
            if self._finished is not None:
                self._finished(shard)

    @property
    def failure(self) -> str:
        """Words about the error with which the last shard's writing has ended, if any, after the context."""
        error = self._writing and self._writing.exception()
        return f"; the last shard is not saved: {error}" if error else ""

    def refuse_failure(self) -> None:
        """Raise the exception with which the last shard's writing has ended, if any."""
        if self._writing is not None and self._writing.done():
            self._writing.result()

    def progress(self, method: str, shard: Progress | None = None) -> SweepProgress:
        """Return the progress of a method, from its planned shards and the progress of the current one."""
        done, tracked = (shard.scenarios_done, shard.targets_tracked) if shard else (0, 0)
        done, tracked, manifest = done + self._done[method], tracked + self._tracked[method], self.run.manifest
        starts = shard and shard.starts
        return SweepProgress(method, done, manifest.count, tracked, manifest.targets, starts, shard is not None)

    def _count(self, method: str, scenarios: int, tracked: int) -> None:
        self._done[method] += scenarios
        self._tracked[method] += tracked

    def _write(self, planned: PlannedShard) -> FinishedShard:
        (method, rows), plans, by, cores = planned
        with devices.on(self._device):
            found = tables(self._batch, method, rows, plans)
        self.run = writer.add(self.run, method, rows, found, plans, by, cores)
        numbers = self.run.manifest.numbers
        span = Span(numbers[rows[0]], numbers[rows[-1]])
        return FinishedShard(method, span, plans, found["scenarios"]["margin_m"].to_numpy())


def tables(batch: Batch, method: str, rows: Sequence[int], plans: Plans) -> dict[str, pa.Table]:
    """Return the rows of a shard in the tables of targets and of scenarios, by name of the table."""
    joints, points = joint_columns(batch.robot), [batch.points[row] for row in rows]
    varied = tuple(points[0].varied)
    numbers = np.array([point.number for point in points])
    measured, followers = _manipulability(batch, rows, plans), _followers(batch, rows, plans)
    return {
        "targets": target_table(method, numbers, plans, joints, measured, followers, _angles(batch, rows, plans)),
        "scenarios": scenario_table(method, points, plans, joints, varied, _causes(batch, rows, plans)),
    }


def _manipulability(batch: Batch, rows: Sequence[int], plans: Plans) -> Float[np.ndarray, "S T"]:
    """Return the manipulability at each target of a shard's scenarios [m/rad]; NaN at targets that are not tracked."""
    (cell, scenarios), found = scenarios_of(batch, rows), np.full(plans.status.shape, np.nan)
    s, t = np.nonzero(plans.tracked)
    for number in np.unique(cell[s]).tolist():
        own, here = batch.cells[number], cell[s] == number
        where = s[here], t[here]
        goals = np.asarray(scenarios.goals)[where][:, : own.task.numbers]
        longer = np.asarray(scenarios.tool_extension_m)[where[0]]
        found[where] = manipulability.manipulability(own.robot, own.task, plans.x[where], goals, longer)
    return found


def _angles(batch: Batch, rows: Sequence[int], plans: Plans) -> Float[np.ndarray, "S T 3"]:
    """Return work angle, travel angle and spin of the tool at each target of a shard's scenarios [degrees].

    NaN before the path, at targets that are not tracked, and for a task without a row with tool angles.
    """
    (cell, scenarios), found = scenarios_of(batch, rows), np.full((*plans.status.shape, len(TOOL_ANGLES)), np.nan)
    for s, row in enumerate(rows):
        if (spec := tool_axis_row(batch.points[row].config.task)) is not None:
            own, count = jax.tree.map(lambda leaf, s=s: np.asarray(leaf[s]), scenarios), int(scenarios.count[s])
            x = plans.x[s, :count]
            found[s, :count] = tool_angles_at(own, spec, batch.cells[cell[s]].robot, batch.workpieces[row], x)
    return found


def _followers(batch: Batch, rows: Sequence[int], plans: Plans) -> dict[str, Float[np.ndarray, "S T"]]:
    """Return the columns of joints that follow others, for a shard's scenarios."""
    (cell, _), found = scenarios_of(batch, rows), follower_columns(batch.robot, plans.x)
    for number in np.unique(cell).tolist() if found else ():
        own = follower_columns(batch.cells[number].robot, plans.x[cell == number])
        for values, others in zip(found.values(), own.values(), strict=True):
            values[cell == number] = others
    return found


def _causes(batch: Batch, rows: Sequence[int], plans: Plans) -> dict[int, start_cause.StartCause]:
    """Return the reasons why scenarios of a shard could not begin, by index in the shard; others are not included."""
    found: dict[int, start_cause.StartCause] = {}
    (cell, scenarios), status = scenarios_of(batch, rows), plans.status[:, 0]
    for number in np.unique(cell[np.isin(status, start_cause.CAUSES)]).tolist():
        own, here = batch.cells[number], np.flatnonzero(cell == number)
        some, execution = device_tables.gather(scenarios, here), Execution(threads=1)
        some = scenario_functions.with_goals_of(some, own.task.numbers)
        problem = Problem(own.robot, own.workpiece, some, own.settings, own.task, own.obstacles, execution)
        causes = start_cause.start_causes(problem, status[here], rounds=1)
        found |= {int(here[s]): cause for s, cause in causes.items()}
    return found
