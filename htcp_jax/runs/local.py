"""Planning of a sweep's shards in this process, one after the other."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.device import devices, tables
from htcp_jax.jobs import Batch, PlannerInputs
from htcp_jax.model import Scenario
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import Execution, Plans, Problem
from htcp_jax.planning import batch
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.shards import Shard, ShardSizes


class PlannedShard(NamedTuple):
    """The plans of a shard, their provenance from `provenance.planned_by`, and the number of CPU cores."""

    shard: Shard
    plans: Plans
    by: dict
    cores: int


def plan_here(
    batch: Batch, execution: Execution, sizes: ShardSizes, missing: Sequence[Shard], report: Callable
) -> Iterator[PlannedShard]:
    """Plan the missing scenarios shard by shard, and yield the plans of each shard.

    Args:
        batch: The scenarios of the sweep.
        execution: Devices, threads and processes. If `targets_in_all` is None, it is that of all missing scenarios.
        sizes: Sizes of the shards.
        missing: The scenarios to plan.
        report: Function that is called while a shard is planned, with the method and the shard's `batch.Progress`. An
            exception that it raises ends the planning.
    """
    by, methods = planned_by(), tuple(dict.fromkeys(each.method for each in missing))
    targets = execution.targets_in_all or sum(int(scenarios_of(batch, each.rows)[1].count.sum()) for each in missing)
    execution = replace(execution, targets_in_all=targets, warm_up=methods)
    for shard in sizes.cut(missing):
        plans = plan_cells(batch.cells, *scenarios_of(batch, shard.rows), shard.method, execution, report)
        execution = replace(execution, warm_up=())  # all are compiled
        sizes.note(shard, plans.run_s)
        yield PlannedShard(shard, plans, by, devices.cores())


def scenarios_of(batch: Batch, rows: Sequence[int]) -> tuple[Int[np.ndarray, "S"], Scenario]:
    """Return the scenarios of a block: the index of each scenario in `batch.cells`, and the stacked scenarios.

    Args:
        batch: The scenarios of the sweep.
        rows: Indices of the block's scenarios in it.
    """
    where = slice(rows.start, rows.stop) if isinstance(rows, range) else np.array(rows)
    return batch.cell[where], tables.gather(batch.scenarios, where)


def plan_cells(
    cells: Sequence[PlannerInputs],
    cell: Int[np.ndarray, "S"],
    scenarios: Scenario,
    method: str,
    execution: Execution,
    report: Callable | None = None,
) -> Plans:
    """Plan stacked scenarios, with one planner call per group of scenarios that share their inputs.

    Args:
        cells: The distinct inputs: robot, workpiece, settings, task and obstacles.
        cell: Index of each scenario's inputs in `cells`.
        scenarios: The stacked scenarios.
        method: Name of the method.
        execution: Devices, threads and processes. Only before the first group, executables are warmed up.
        report: See `plan_here`; None: no reports.
    """
    parts: list[tuple[np.ndarray, Plans]] = []
    everything = len(cell), int(scenarios.count.sum())
    for number in dict.fromkeys(cell.tolist()):
        rows = np.flatnonzero(cell == number)
        whole = len(rows) == len(cell)
        robot, workpiece, *others = cells[number]
        own = scenarios if whole else tables.gather(scenarios, rows)
        own = scenario_functions.with_goals_of(own, cells[number].task.numbers)
        problem = Problem.of(robot, workpiece, own, *others, execution)
        progress = report and partial(_add_up, report, method, [done for _, done in parts], *everything)
        plans = batch.plan(problem, method, progress)
        if whole:
            return plans
        parts.append((rows, plans))
        execution = replace(execution, warm_up=())
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    return Plans.concatenate([plans for _, plans in parts]).rows(order)


def _add_up(
    report: Callable, method: str, finished: Sequence[Plans], count: int, targets: int, now: batch.Progress
) -> None:
    """Report the total progress, given the progress `now` of one planner call and the `finished` plans."""
    done = sum(len(plans.status) for plans in finished) + now.scenarios_done
    tracked = sum(int(plans.tracked.sum()) for plans in finished) + now.targets_tracked
    report(method, batch.Progress(done, count, tracked, targets, now.starts))
