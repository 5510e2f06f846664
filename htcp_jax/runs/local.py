"""Planning of a sweep's shards in this process, one after the other."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.device import tables
from htcp_jax.jobs import grid
from htcp_jax.model import Scenario
from htcp_jax.motion import Plans
from htcp_jax.planning import batch
from htcp_jax.runs.manifest import Span
from htcp_jax.runs.provenance import planned_by


class Shard(NamedTuple):
    """One method on a block of scenarios."""

    method: str
    span: Span


class PlannedShard(NamedTuple):
    """A shard's plans with their provenance, see `provenance.planned_by`."""

    shard: Shard
    plans: Plans
    by: dict


def plan_here(
    batch: grid.Batch,
    threads: int | None,
    device: str | None,
    targets_in_all: int | None,
    shards: Sequence[Shard],
    report: Callable,
) -> Iterator[PlannedShard]:
    """Plan the shards one by one.

    report(method, batch.Progress of the current shard) is called as a shard advances; an exception in it ends the work.
    threads, device: see `batch.plan`. targets_in_all: Number of targets of all shards, by default of those given.
    """
    by = planned_by()
    targets_in_all = targets_in_all or sum(int(scenarios_of(batch, each.span)[1].count.sum()) for each in shards)
    for shard in shards:
        block = scenarios_of(batch, shard.span)
        plans = plan_cells(batch.cells, *block, shard.method, threads, report, device, targets_in_all)
        yield PlannedShard(shard, plans, by)


def scenarios_of(batch: grid.Batch, span: Span) -> tuple[Int[np.ndarray, "S"], Scenario]:
    """Return the cells' indices and the stacked scenarios of a block."""
    rows = slice(span.first, span.last + 1)
    return batch.cell[rows], tables.gather(batch.scenarios, rows)


def plan_cells(
    cells: Sequence[grid.PlannerInputs],
    cell: Int[np.ndarray, "S"],
    scenarios: Scenario,
    method: str,
    threads: int | None,
    report: Callable | None = None,
    device: str | None = None,
    targets_in_all: int | None = None,
) -> Plans:
    """Plan stacked scenarios, each with the robot, workpiece and settings of its cell; one planner call per cell.

    Args:
        cells: The cells.
        cell: Index of each scenario's cell.
        scenarios: Stacked.
        method: Name of the method.
        threads: See `batch.plan`.
        report: See `plan_here`.
        device: See `batch.plan`.
        targets_in_all: See `batch.plan`.
    """
    parts: list[tuple[np.ndarray, Plans]] = []
    everything = len(cell), int(scenarios.count.sum())
    for number in dict.fromkeys(cell.tolist()):
        rows = np.flatnonzero(cell == number)
        whole = len(rows) == len(cell)
        robot, workpiece, settings, task, obstacles = cells[number]
        plans = batch.plan(
            robot,
            workpiece,
            scenarios if whole else tables.gather(scenarios, rows),
            method,
            settings,
            progress=report and partial(_add_up, report, method, [done for _, done in parts], *everything),
            threads=threads,
            device=device,
            targets_in_all=targets_in_all,
            task=task,
            obstacles=obstacles,
        )
        if whole:
            return plans
        parts.append((rows, plans))
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    return Plans.concatenate([plans for _, plans in parts]).rows(order)


def _add_up(
    report: Callable, method: str, finished: Sequence[Plans], count: int, targets: int, now: batch.Progress
) -> None:
    """Report the progress of one cell as the progress of all cells."""
    done = sum(len(plans.status) for plans in finished) + now.scenarios_done
    tracked = sum(int(plans.tracked.sum()) for plans in finished) + now.targets_tracked
    report(method, batch.Progress(done, count, tracked, targets))
