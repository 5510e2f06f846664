"""Public function for sweeps: plan every scenario of a grid by several methods, shard by shard, into a run folder.

    run = htcp_jax.sweep("sweeps/robot", methods="baseline,nspace-sqp", out="out/robot")
    run.frame()

A shard is one method on a block of scenarios, which advance together. It is the unit of work of a cluster's worker, and
lost if the process dies. The size of shards and the machine that plans them have no influence on results. The same call
again continues an interrupted sweep.
"""

import contextlib
import shutil
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from htcp_jax.clearance.obstacles import obstacle_kind
from htcp_jax.device import devices
from htcp_jax.device import tables as device_tables
from htcp_jax.errors import InputError, Interrupted, Lost
from htcp_jax.jobs import grid as grids
from htcp_jax.jobs import grid_axes, seeded
from htcp_jax.model import task_row_kind
from htcp_jax.motion import Plans, manipulability, start_cause
from htcp_jax.planning import Progress as ShardProgress
from htcp_jax.planning import registry
from htcp_jax.process_exit import stop_message
from htcp_jax.runs import writer
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.input_files import anchor_files, file_hashes
from htcp_jax.runs.local import Shard, plan_here, scenarios_of
from htcp_jax.runs.lock import SignalReceived, locked, signals
from htcp_jax.runs.manifest import Manifest, Span, spans
from htcp_jax.runs.plan_folder import made_folder
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.run_folder import Run
from htcp_jax.runs.running import FinishedShard
from htcp_jax.runs.tables import joint_columns, scenario_table, target_table
from htcp_jax.unfinished import temporary_folder

SHARD_SCENARIOS = 512  # fixed, so that shards are equal on every machine; fewer leave lanes unused


class SweepProgress(NamedTuple):
    """Progress of one method; all counts are totals."""

    method: str
    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int


def sweep(
    spec: str | Path | Mapping[str, Any] | grids.Sweep,
    methods: str | Sequence[str] = "all",
    out: str | Path | None = None,
    *,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    limit: int | None = None,
    seed: int | None = None,
    progress: Callable[[SweepProgress], None] | None = None,
    finished: Callable[[FinishedShard], None] | None = None,
    threads: int | None = None,
    shard_scenarios: int | None = None,
    on: str = "here",
    device: str | None = None,
    targets_in_all: int | None = None,
) -> Run:
    """Plan the grid of a sweep file, or of a mapping in place of one, and return the run.

    methods: "all", comma-separated names, or a list of names. out: the run folder; without one, a temporary folder that
    is deleted with the run. config, overrides, seed: see `load_sweep`; the seed is `settings.seed`.
    limit: plan only the first scenarios of the grid. shard_scenarios: scenarios per shard; a run folder keeps its first
    choice. finished: called with every written shard. on: "here" plans on this machine, in several processes if that is
    faster, or with `threads` engines in this one, see `batch.plan`; "ray" or "ray:<address>" sends the shards to Ray's
    workers, see `ray_`. device: of this process, see `device_of`. targets_in_all: see
    `batch.plan`, by default the targets of its own shards.

    Raises InputError for bad input, for a folder that holds another sweep, is in use or cannot be written;
    Interrupted on SIGINT and SIGTERM, and Lost if workers are lost. Finished shards are then kept in the folder.
    """
    with devices.on(devices.choose(device_of(on, device))[0]):
        chosen = method_names(methods)
        if isinstance(spec, grids.Sweep):
            if config is not None or overrides or seed is not None:
                raise InputError("config, overrides and seed belong to load_sweep when the sweep is loaded already")
        else:
            spec = grids.load_sweep(spec, config, seeded(overrides, seed))
        for name, value in (("limit", limit), ("shard_scenarios", shard_scenarios)):
            if value is not None and not 1 <= value <= grid_axes.MOST:
                raise InputError(f"{name} is {value}; it must be 1 or more, and {grid_axes.MOST:,} at most")
        batch = spec.batch(limit)
        requested = _manifest(spec, batch, chosen, limit, shard_scenarios or SHARD_SCENARIOS)
        planned = _planner(on, chosen, batch, spec, threads, device, targets_in_all)
        with _folder(out) as (folder, keep, discard), locked(folder), planned as plan, signals() as came:
            run = writer.begin(folder, requested, keep)

            def stopped() -> str:
                discard()
                return _resume_message(run)

            def report_progress(method: str, shard: ShardProgress | None = None) -> None:
                if came:
                    raise SignalReceived
                if progress is not None:
                    progress(_progress(run.manifest, method, shard))

            try:
                with stop_message(stopped):
                    shards = [Shard(method, span) for method in chosen for span in run.missing(method)]
                    for method in chosen:
                        report_progress(method)
                    for (method, span), plans, by in plan(shards, report_progress):
                        rows = tables(batch, method, span, plans)
                        run = writer.add(run, method, span, rows, plans, by)
                        if finished is not None:
                            finished(FinishedShard(method, span, plans, rows["scenarios"]["margin_m"].to_numpy()))
                        report_progress(method)
            except SignalReceived:
                raise Interrupted(_resume_message(run), came[0]) from None
            except Lost as lost:
                if came:  # the signal went to the workers, too
                    raise Interrupted(_resume_message(run), came[0]) from None
                raise Lost(f"{lost}; {_resume_message(run)}") from None
            return run


def device_of(on: str, device: str | None) -> str | None:
    """Return the device of this process, see `device.devices`: with Ray the CPU, to leave GPU memory to the workers.

    Raises:
        InputError: For an invalid `on`, and for another device with Ray.
    """
    if on == "here":
        return device
    if on.partition(":")[0] != "ray":
        raise InputError(f"on is {on!r}; valid: here, ray, ray:<address of a cluster>")
    if device not in (None, "cpu"):
        raise InputError(
            f"device is {device!r}; with Ray it can only be cpu; ray.num_gpus sets the GPUs of its workers"
        )
    return "cpu"


def keep_plans(
    spec: grids.Sweep, plans: Mapping[str, Plans], out: str | Path, shard_scenarios: int = SHARD_SCENARIOS
) -> Run:
    """Write existing plans as a run; the content of `out` is replaced.

    Args:
        spec: The sweep.
        plans: By the names of their methods; one row per scenario of the grid.
        out: The run folder.
        shard_scenarios: Scenarios per shard.

    Raises:
        InputError: If it cannot be written.
    """
    batch, folder = spec.batch(), Path(out)
    shutil.rmtree(folder, ignore_errors=True)
    with made_folder(folder):
        run = writer.begin(folder, _manifest(spec, batch, tuple(plans), None, shard_scenarios))
        for method, found in plans.items():
            for span in spans(run.manifest):
                own = found.rows(slice(span.first, span.last + 1))
                run = writer.add(run, method, span, tables(batch, method, span, own), own, planned_by())
    return run


def method_names(methods: str | Sequence[str]) -> tuple[str, ...]:
    """Return the methods named by "all", "a,b" or a list.

    Raises:
        InputError: For an empty list, and for a method that is unknown, cannot be imported, or is repeated.
    """
    if methods == "all":
        return tuple(registry.METHODS.all())
    names = [name.strip() for name in methods.split(",")] if isinstance(methods, str) else list(methods)
    if not any(names):
        raise InputError(f"no methods; valid: all, {', '.join(registry.names())}")
    for name in names:
        if name not in registry.names():
            raise InputError(f"unknown method {name!r}; valid: all, {', '.join(registry.names())}")
        registry.find(name)
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"method {name} is given twice")
    return tuple(names)


def tables(batch: grids.Batch, method: str, span: Span, plans: Plans) -> dict[str, pa.Table]:
    """Return the rows of a shard in both tables, see module `tables`."""
    rows = slice(span.first, span.last + 1)
    joints, points = joint_columns(batch.robot), batch.points[rows]
    varied = tuple(points[0].varied)
    numbers = np.array([point.number for point in points])
    return {
        "targets": target_table(method, numbers, plans, joints, _manipulability(batch, span, plans)),
        "scenarios": scenario_table(method, points, plans, joints, varied, _causes(batch, span, plans)),
    }


def _manipulability(batch: grids.Batch, span: Span, plans: Plans) -> Float[np.ndarray, "S T"]:
    """Return the manipulability of a shard's scenarios at their targets [m/rad]."""
    (cell, scenarios), found = scenarios_of(batch, span), np.full(plans.status.shape, np.nan)
    s, t = np.nonzero(plans.tracked)
    for number in np.unique(cell[s]).tolist():
        own, here = batch.cells[number], cell[s] == number
        where = s[here], t[here]
        goals, longer = np.asarray(scenarios.goals)[where], np.asarray(scenarios.tool_extension_m)[where[0]]
        found[where] = manipulability.manipulability(own.robot, own.task, plans.x[where], goals, longer)
    return found


def _causes(batch: grids.Batch, span: Span, plans: Plans) -> dict[int, start_cause.StartCause]:
    """Return the reasons of a shard's scenarios that could not begin, by their places in it."""
    found: dict[int, start_cause.StartCause] = {}
    (cell, scenarios), status = scenarios_of(batch, span), plans.status[:, 0]
    for number in np.unique(cell[np.isin(status, start_cause.CAUSES)]).tolist():
        own, rows = batch.cells[number], np.flatnonzero(cell == number)
        known = own.settings, own.task, own.obstacles
        some = start_cause.start_causes(
            own.robot, own.workpiece, device_tables.gather(scenarios, rows), status[rows], *known, rounds=1
        )
        found |= {int(rows[s]): cause for s, cause in some.items()}
    return found


def _manifest(
    spec: grids.Sweep, batch: grids.Batch, methods: tuple[str, ...], limit: int | None, shard_scenarios: int
) -> Manifest:
    """Return the manifest of a requested run, without shards."""
    config = spec.config.model_dump(mode="json")
    grid = [grid_axes.group_record(group, spec.stated) for group in spec.groups]
    named = anchor_files(config)
    for axis in (axis for group in grid for axis in group["axes"]):
        named += [
            (key, name)
            for key, words in grid_axes.FILE_KEYS.items()
            for name in axis.get(key, {}).get("values", ())
            if name not in words
        ]
    files = file_hashes(named)
    dtype = str(batch.scenarios.targets.dtype)
    return Manifest(
        name=spec.name,
        config=config,
        grid=tuple(grid),
        dtype=dtype,
        files=files,
        config_hash=config_hash(identity(config, grid, dtype, files)),
        seed=spec.config.settings.seed,
        joints=joint_columns(batch.robot),
        targets=int(batch.scenarios.count.sum()),
        full=len(spec),
        limit=limit,
        count=len(batch.points),
        shard_scenarios=shard_scenarios,
        methods=methods,
    )


def _planner(
    on: str,
    methods: tuple[str, ...],
    batch: grids.Batch,
    spec: grids.Sweep,
    threads: int | None,
    device: str | None,
    targets_in_all: int | None,
):
    """Return a context manager that yields plan(shards, report), an iterator of (shard, plans, provenance)."""
    if on == "here":
        return contextlib.nullcontext(partial(plan_here, batch, threads, device, targets_in_all))
    from htcp_jax.runs.ray_ import on_ray  # here, because it is an extra

    registry.METHODS.refuse_own(methods)
    obstacle_kind.OBSTACLES.refuse_own(kind.name for kind in spec.config.cell.obstacles)
    task_row_kind.TASK_ROWS.refuse_own(row.name for row in spec.config.task)
    return on_ray(batch, spec.config, on.partition(":")[2])


def _progress(manifest: Manifest, method: str, shard: ShardProgress | None) -> SweepProgress:
    """Return a method's progress: its finished shards, and the current one."""
    kept = [record for record in manifest.shards if record.method == method]
    done, tracked = (shard.scenarios_done, shard.targets_tracked) if shard else (0, 0)
    done += sum(record.last - record.first + 1 for record in kept)
    tracked += sum(record.tracked for record in kept)
    return SweepProgress(method, done, manifest.count, tracked, manifest.targets)


def _resume_message(run: Run) -> str:
    manifest = run.manifest
    there, all_ = len(manifest.shards), len(manifest.methods) * len(spans(manifest))
    if not there:
        return "stopped before anything was finished; nothing was written"
    return f"stopped; {there} of {all_} shards are finished in {run.folder}; the same command resumes"


class _Scratch:
    """A temporary folder, deleted with this object."""

    def __init__(self):
        held = contextlib.ExitStack()
        self.folder = held.enter_context(temporary_folder())
        weakref.finalize(self, held.close)


@contextlib.contextmanager
def _folder(out: str | Path | None) -> Iterator[tuple[Path, Any, Callable[[], None]]]:
    """Yield the run folder, an object that keeps it alive, and a function that removes it.

    A new folder without results is removed at the end.
    """
    if out is None:
        scratch = _Scratch()
        yield scratch.folder, scratch, lambda: None
        return
    folder = Path(out)
    with made_folder(folder) as is_new:

        def discard() -> None:
            if is_new and not any(folder.glob("*/*.parquet")):
                shutil.rmtree(folder, ignore_errors=True)

        try:
            yield folder, None, discard
        finally:
            discard()
