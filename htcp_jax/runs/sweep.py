"""Planning of every scenario of a grid by several methods, shard by shard, into a run folder.

    run = htcp_jax.sweep("sweeps/robot", methods="baseline,nspace-sqp", out="out/robot")
    run.frame()

A shard is one method on a block of scenarios, which are planned together. It is the unit of work of a worker: if a
process dies, only its unfinished shard is lost. Results do not depend on the size of shards or on the machine. To
continue an interrupted sweep, repeat the same call.
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

from htcp_jax.device import devices
from htcp_jax.device import tables as device_tables
from htcp_jax.errors import InputError, Interrupted, Lost
from htcp_jax.jobs import Batch, Sweep, grid_axes, load_sweep, seeded
from htcp_jax.motion import Execution, Plans, Problem, manipulability, start_cause
from htcp_jax.planning import Progress as ShardProgress
from htcp_jax.planning import methods as planning_methods
from htcp_jax.planning import registry
from htcp_jax.runs import writer
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.input_files import anchor_files, file_hashes
from htcp_jax.runs.local import Shard, plan_here, scenarios_of
from htcp_jax.runs.manifest import Manifest, Span, spans
from htcp_jax.runs.provenance import code_of, planned_by
from htcp_jax.runs.run_folder import Run
from htcp_jax.runs.running import FinishedShard
from htcp_jax.runs.tables import joint_columns, scenario_table, target_table
from htcp_jax.spec import TASK_ROWS, obstacle_kind
from htcp_jax.system import SignalReceived, locked, output_files, signals, stop_message, temporary_folder

SHARD_SCENARIOS = 512  # default size of a shard, equal on every machine; smaller shards leave lanes unused


class SweepProgress(NamedTuple):
    """Progress of one method, counted over all its shards in the run."""

    method: str
    scenarios_done: int
    scenarios: int
    targets_tracked: int
    targets: int
    starts: int | None = None  # of the current shard, see `planning.batch.Progress`


def sweep(
    spec: str | Path | Mapping[str, Any] | Sweep,
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
    """Plan all scenarios of a sweep by several methods, and return the run.

    Args:
        spec: The sweep: a file, an example, a mapping, or a loaded sweep, see `load_sweep`.
        methods: "all", comma-separated names, or a list of names.
        out: The run folder; None: a temporary folder that is deleted with the returned run.
        config: Configuration that replaces the sweep's own, see `load_sweep`.
        overrides: Changes to the configuration, see `load_sweep`.
        limit: Maximum number of scenarios; the first ones of the grid are planned. None: all.
        seed: Value of `settings.seed`; None: the configuration's.
        progress: Function that is called with the `SweepProgress` of a method while it advances.
        finished: Function that is called with each shard after it has been written.
        threads: Number of engines per process, see `Execution`.
        shard_scenarios: Number of scenarios per shard; None: SHARD_SCENARIOS. A folder with results keeps its number.
        on: "here" plans on this machine, in several processes if that is faster. "ray" or `"ray:<address>"` sends
            the shards to the workers of a Ray cluster, see `ray_`.
        device: Device to plan on, such as "cpu"; None: a GPU if there is one. With Ray it must be None or "cpu".
        targets_in_all: See `Execution`; None: the number of targets of the shards to plan.

    Raises:
        InputError: If the input is invalid, or if the folder contains another sweep, is in use or cannot be written.
        Interrupted: On SIGINT or SIGTERM; finished shards are kept in the folder.
        Lost: If workers are lost; finished shards are kept in the folder.
    """
    with devices.on(devices.choose(device_of(on, device))[0]):
        chosen = method_names(methods)
        if isinstance(spec, Sweep):
            if config is not None or overrides or seed is not None:
                raise InputError("the sweep is loaded already; pass config, overrides and seed to load_sweep")
        else:
            spec = load_sweep(spec, config, seeded(overrides, seed))
        for name, value in (("limit", limit), ("shard_scenarios", shard_scenarios)):
            if value is not None and not 1 <= value <= grid_axes.MOST:
                raise InputError(f"{name} is {value}; valid: 1 to {grid_axes.MOST:,}")
        batch = spec.batch(limit)
        requested = _manifest(spec, batch, chosen, limit, shard_scenarios or SHARD_SCENARIOS)
        execution = Execution(device, threads, targets_in_all=targets_in_all)
        planned = _planner(on, chosen, batch, spec, execution)
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
                if came:  # the workers ended because they received the signal, too
                    raise Interrupted(_resume_message(run), came[0]) from None
                raise Lost(f"{lost}; {_resume_message(run)}") from None
            return run


def device_of(on: str, device: str | None) -> str | None:
    """Return the device of this process. With Ray it is the CPU, as the workers use the GPUs.

    Args:
        on: Where shards are planned, see `sweep`.
        device: Name of the requested device, see `device.devices`.

    Raises:
        InputError: If `on` is invalid, or if a device other than the CPU is requested with Ray.
    """
    if on == "here":
        return device
    if on.partition(":")[0] != "ray":
        raise InputError(f"on is {on!r}; valid: here, ray, ray:<address of a cluster>")
    if device not in (None, "cpu"):
        raise InputError(f"device is {device!r}; with Ray it must be cpu; to use GPUs of the workers, set ray.num_gpus")
    return "cpu"


def keep_plans(spec: Sweep, plans: Mapping[str, Plans], out: str | Path, shard_scenarios: int = SHARD_SCENARIOS) -> Run:
    """Write existing plans as a run, and return the run. Existing files in `out` are deleted.

    Args:
        spec: The sweep.
        plans: Plans by name of the method, with one row per scenario of the grid.
        out: The run folder.
        shard_scenarios: Number of scenarios per shard.

    Raises:
        InputError: If the folder cannot be written.
    """
    batch, folder = spec.batch(), Path(out)
    shutil.rmtree(folder, ignore_errors=True)
    with output_files.made_folder(folder):
        run = writer.begin(folder, _manifest(spec, batch, tuple(plans), None, shard_scenarios))
        for method, found in plans.items():
            for span in spans(run.manifest):
                own = found.rows(slice(span.first, span.last + 1))
                run = writer.add(run, method, span, tables(batch, method, span, own), own, planned_by())
    return run


def method_names(methods: str | Sequence[str]) -> tuple[str, ...]:
    """Return the names of the requested methods.

    Args:
        methods: "all", comma-separated names, or a list of names.

    Raises:
        InputError: If the list is empty, or if a method is unknown, cannot be imported, or is repeated.
    """
    if methods == "all":
        return tuple(registry.descriptions())
    names = [name.strip() for name in methods.split(",")] if isinstance(methods, str) else list(methods)
    if not any(names):
        raise InputError(f"no methods; valid: all, {', '.join(registry.names())}")
    for name in names:
        if name not in registry.names():
            raise InputError(f"unknown method {name!r}; valid: all, {', '.join(registry.names())}")
        planning_methods.find(name)
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"method {name} is given twice")
    return tuple(names)


def tables(batch: Batch, method: str, span: Span, plans: Plans) -> dict[str, pa.Table]:
    """Return the rows of a shard in the tables of targets and of scenarios, by name of the table."""
    rows = slice(span.first, span.last + 1)
    joints, points = joint_columns(batch.robot), batch.points[rows]
    varied = tuple(points[0].varied)
    numbers = np.array([point.number for point in points])
    return {
        "targets": target_table(method, numbers, plans, joints, _manipulability(batch, span, plans)),
        "scenarios": scenario_table(method, points, plans, joints, varied, _causes(batch, span, plans)),
    }


def _manipulability(batch: Batch, span: Span, plans: Plans) -> Float[np.ndarray, "S T"]:
    """Return the manipulability at each target of a shard's scenarios [m/rad]; NaN at targets that are not tracked."""
    (cell, scenarios), found = scenarios_of(batch, span), np.full(plans.status.shape, np.nan)
    s, t = np.nonzero(plans.tracked)
    for number in np.unique(cell[s]).tolist():
        own, here = batch.cells[number], cell[s] == number
        where = s[here], t[here]
        goals, longer = np.asarray(scenarios.goals)[where], np.asarray(scenarios.tool_extension_m)[where[0]]
        found[where] = manipulability.manipulability(own.robot, own.task, plans.x[where], goals, longer)
    return found


def _causes(batch: Batch, span: Span, plans: Plans) -> dict[int, start_cause.StartCause]:
    """Return the reasons why scenarios of a shard could not begin, by index in the shard; others are not included."""
    found: dict[int, start_cause.StartCause] = {}
    (cell, scenarios), status = scenarios_of(batch, span), plans.status[:, 0]
    for number in np.unique(cell[np.isin(status, start_cause.CAUSES)]).tolist():
        own, rows = batch.cells[number], np.flatnonzero(cell == number)
        some, execution = device_tables.gather(scenarios, rows), Execution(threads=1)
        problem = Problem(own.robot, own.workpiece, some, own.settings, own.task, own.obstacles, execution)
        causes = start_cause.start_causes(problem, status[rows], rounds=1)
        found |= {int(rows[s]): cause for s, cause in causes.items()}
    return found


def _manifest(spec: Sweep, batch: Batch, methods: tuple[str, ...], limit: int | None, shard_scenarios: int) -> Manifest:
    """Return the manifest of a requested run; it contains no shards yet."""
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
        code=_code(spec, methods),
        shard_scenarios=shard_scenarios,
        methods=methods,
    )


def _code(spec: Sweep, methods: tuple[str, ...]) -> dict[str, str]:
    """Return the SHA-256 of the code of methods, obstacles and task rows that other packages define."""
    kinds = code_of(obstacle_kind.OBSTACLES, (kind.name for kind in spec.config.cell.obstacles))
    rows = code_of(TASK_ROWS, (row.name for row in spec.config.task))
    return code_of(registry.METHODS, methods) | kinds | rows


def _planner(on: str, methods: tuple[str, ...], batch: Batch, spec: Sweep, execution: Execution):
    """Return a context manager that yields plan(shards, report), which yields a `PlannedShard` for each shard."""
    if on == "here":
        return contextlib.nullcontext(partial(plan_here, batch, execution))
    from htcp_jax.runs.ray_ import on_ray  # here, as Ray is an optional dependency

    registry.METHODS.refuse_own(methods)
    obstacle_kind.OBSTACLES.refuse_own(kind.name for kind in spec.config.cell.obstacles)
    TASK_ROWS.refuse_own(row.name for row in spec.config.task)
    return on_ray(batch, spec.config, on.partition(":")[2])


def _progress(manifest: Manifest, method: str, shard: ShardProgress | None) -> SweepProgress:
    """Return the progress of a method, from its finished shards and the progress of the current one."""
    kept = [record for record in manifest.shards if record.method == method]
    done, tracked = (shard.scenarios_done, shard.targets_tracked) if shard else (0, 0)
    done += sum(record.last - record.first + 1 for record in kept)
    tracked += sum(record.tracked for record in kept)
    return SweepProgress(method, done, manifest.count, tracked, manifest.targets, shard and shard.starts)


def _resume_message(run: Run) -> str:
    manifest = run.manifest
    there, all_ = len(manifest.shards), len(manifest.methods) * len(spans(manifest))
    if not there:
        return "stopped before anything was finished; nothing was written"
    return f"stopped; {there} of {all_} shards are finished in {run.folder}; run the same command to resume"


class _Scratch:
    """A temporary folder that is deleted when this object is deleted."""

    def __init__(self):
        held = contextlib.ExitStack()
        self.folder = held.enter_context(temporary_folder())
        weakref.finalize(self, held.close)


@contextlib.contextmanager
def _folder(out: str | Path | None) -> Iterator[tuple[Path, Any, Callable[[], None]]]:
    """Yield the run folder, an object to keep while a temporary folder is used, and a function to discard the folder.

    The function removes a new folder without results; it is also called at the end of the block. If `out` is None, the
    folder is temporary.
    """
    if out is None:
        scratch = _Scratch()
        yield scratch.folder, scratch, lambda: None
        return
    folder = Path(out)
    with output_files.made_folder(folder) as is_new:

        def discard() -> None:
            if is_new and not any(folder.glob("*/*.parquet")):
                shutil.rmtree(folder, ignore_errors=True)

        try:
            yield folder, None, discard
        finally:
            discard()
