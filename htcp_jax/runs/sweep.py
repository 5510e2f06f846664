"""Planning of every scenario of a grid by several methods, shard by shard, into a run folder.

    run = htcp_jax.sweep("sweeps/robot", methods="baseline,nspace-sqp", out="out/robot")
    run.frame()

A shard is one method on a block of scenarios, which are planned together. It is the unit of work of a worker: if a
process dies, only its unfinished shard is lost. Shards grow until one takes about a minute, see `shards`. A thread
writes each shard while the next one is planned. Results do not depend on the size of shards or on the machine. To
continue an interrupted sweep, repeat the same call.
"""

import contextlib
import shutil
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from htcp_jax.backend import default_device
from htcp_jax.device import devices
from htcp_jax.errors import InputError, Interrupted, Lost, did_you_mean
from htcp_jax.jobs import Batch, Sweep, chosen_numbers, grid_axes, load_sweep, seeded
from htcp_jax.motion import Execution, Plans
from htcp_jax.planning import Progress as ShardProgress
from htcp_jax.planning import methods as planning_methods
from htcp_jax.planning import registry
from htcp_jax.runs import writer
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.input_files import recorded_inputs
from htcp_jax.runs.local import plan_here
from htcp_jax.runs.manifest import MANIFEST, DrawnAxis, Manifest
from htcp_jax.runs.plan_folder import SUMMARY
from htcp_jax.runs.provenance import code_of, code_of_kinds, planned_by, plugins_of, plugins_of_kinds
from htcp_jax.runs.run_folder import Run
from htcp_jax.runs.running import FinishedShard
from htcp_jax.runs.shards import Shard, ShardSizes
from htcp_jax.runs.tables import joint_columns, sparse
from htcp_jax.runs.written_run import SweepProgress, WrittenRun, tables
from htcp_jax.spec import TASK_ROWS, obstacle_kind
from htcp_jax.system import SignalReceived, locked, output_files, signals, stop_message, temporary_folder


def sweep(
    spec: str | Path | Mapping[str, Any] | Sweep,
    methods: str | Sequence[str] = "all",
    out: str | Path | None = None,
    *,
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    limit: int | None = None,
    scenarios: Sequence[int] | None = None,
    sample: int | None = None,
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
        scenarios: Numbers of the scenarios to plan; None: all. A scenario keeps its number and its results.
        sample: Number of scenarios to draw from the grid, without repetition, by the seed; None: all.
        seed: Value of `settings.seed`; None: the configuration's.
        progress: Function that is called with the `SweepProgress` of a method while it advances.
        finished: Function that is called with each shard after it has been written.
        threads: Number of engines per process, see `Execution`.
        shard_scenarios: Number of scenarios per shard; None: as many as are planned in about a minute.
        on: "here" plans on this machine, in several processes if that is faster. "ray" or `"ray:<address>"` sends
            the shards to the workers of a Ray cluster, see `ray_`.
        device: Device to plan on, such as "cpu"; None: a GPU if there is one. With Ray it must be None or "cpu".
        targets_in_all: See `Execution`; None: the number of targets of the shards to plan.

    Raises:
        InputError: If the input is invalid, or if the folder contains another sweep, is in use or cannot be written.
        Interrupted: On SIGINT or SIGTERM; finished shards are kept in the folder.
        Lost: If workers are lost; finished shards are kept in the folder.
    """
    chosen_devices = devices.choose(device_of(on, device))
    first = chosen_devices[0]
    with devices.on(first):
        chosen = method_names(methods)
        if isinstance(spec, Sweep):
            if config is not None or overrides or seed is not None:
                raise InputError("the sweep is loaded already; pass config, overrides and seed to load_sweep")
        else:
            spec = load_sweep(spec, config, seeded(overrides, seed))
        for name, value in (("limit", limit), ("shard_scenarios", shard_scenarios)):
            if value is not None and not 1 <= value <= grid_axes.MOST:
                raise InputError(f"{name} is {value}; valid: 1 to {grid_axes.MOST:,}")
        platform = "gpu" if on != "here" and spec.config.ray.num_gpus else first.platform
        spec = spec.on(platform)
        numbers = chosen_numbers(len(spec), spec.config.settings.seed, limit, scenarios, sample)
        batch = spec.batch(limit, numbers)
        requested = _manifest(spec, batch, chosen, limit, numbers, is_sample=sample is not None)
        cores = devices.cores() if on == "here" else max(1, int(spec.config.ray.num_cpus))
        sizes = ShardSizes.on(platform, cores, batch.scenarios.targets.shape[1], len(chosen_devices))
        if shard_scenarios is not None:
            sizes = ShardSizes(shard_scenarios, shard_scenarios)
        execution = Execution(device, threads, targets_in_all=targets_in_all)
        planned = _planner(on, chosen, batch, spec, execution, sizes)
        with _folder(out) as (folder, keep, discard), locked(folder), planned as plan, signals() as came:
            written = WrittenRun(writer.begin(folder, requested, keep), batch, first, finished)

            def stopped() -> str:
                discard()
                return _resume_message(written.run)

            def report_progress(method: str, shard: ShardProgress | None = None) -> None:
                if came:
                    raise SignalReceived
                written.refuse_failure()
                if progress is not None:
                    progress(written.progress(method, shard))

            try:
                with stop_message(stopped), written:
                    missing = [Shard(method, rows) for method in chosen for rows in written.run.missing(method)]
                    for method in chosen:
                        report_progress(method)
                    for each in plan(missing, report_progress):
                        written.add(each)
                        report_progress(each.shard.method)
                    written.wait()
            except SignalReceived:
                raise Interrupted(_resume_message(written.run) + written.failure, came[0]) from None
            except Lost as lost:
                if came:  # the workers ended because they received the signal, too
                    raise Interrupted(_resume_message(written.run) + written.failure, came[0]) from None
                raise Lost(f"{lost}; {_resume_message(written.run)}{written.failure}") from None
            return written.run


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


def keep_plans(spec: Sweep, plans: Mapping[str, Plans], out: str | Path, shard_scenarios: int = grid_axes.MOST) -> Run:
    """Write plans made on the default device as a run, and return the run. Existing files in `out` are deleted.

    Args:
        spec: The sweep.
        plans: Plans by name of the method, with one row per scenario of the grid.
        out: The run folder.
        shard_scenarios: Number of scenarios per shard.

    Raises:
        InputError: If the folder cannot be written.
    """
    spec = spec.on(default_device().platform)
    batch, folder = spec.batch(), Path(out)
    shutil.rmtree(folder, ignore_errors=True)
    with output_files.made_folder(folder):
        run = writer.begin(folder, _manifest(spec, batch, tuple(plans)))
        missing = [Shard(method, rows) for method in plans for rows in run.missing(method)]
        for method, rows in ShardSizes(shard_scenarios, shard_scenarios).cut(missing):
            own = plans[method].rows(slice(rows[0], rows[-1] + 1))
            rows_of = tables(batch, method, rows, own)
            run = writer.add(run, method, rows, rows_of, own, planned_by(), devices.cores())
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
            known = registry.names()
            hint = "; the package of a method of your own may not be installed"
            valid = f"valid: all, {', '.join(known)}"
            raise InputError(f"unknown method {name!r}; {did_you_mean(name, known)}{valid}{hint}")
        planning_methods.find(name)
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"method {name} is given twice")
    return tuple(names)


def _manifest(
    spec: Sweep,
    batch: Batch,
    methods: tuple[str, ...],
    limit: int | None = None,
    numbers: tuple[int, ...] | None = None,
    is_sample: bool = False,
) -> Manifest:
    """Return the manifest of a requested run; it contains no shards yet.

    Raises:
        InputError: If the numbers are so large that arrays with a row for each number would be mostly empty.
    """
    full, targets = len(spec), int(batch.scenarios.count.sum())
    if numbers is not None and (reason := sparse(numbers[-1] + 1, batch.scenarios.targets.shape[1], targets)):
        raise InputError(f"{reason}; choose smaller numbers or more scenarios, or use random axes")
    config, grid, files = recorded_inputs(spec)
    dtype = str(batch.scenarios.targets.dtype)
    return Manifest(
        name=spec.name,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        config=config,
        grid=tuple(grid),
        drawn=tuple(DrawnAxis(**axis) for group in spec.groups for axis in grid_axes.drawn_axes(group)),
        dtype=dtype,
        files=files,
        config_hash=config_hash(identity(config, grid, dtype, files)),
        seed=spec.config.settings.seed,
        joints=joint_columns(batch.robot),
        targets=targets,
        full=full,
        limit=limit,
        count=len(batch.points),
        scenarios=numbers,
        is_sample=is_sample,
        code=_code(spec, methods),
        plugins=plugins_of(registry.METHODS, methods) | plugins_of_kinds(spec.config),
        methods=methods,
    )


def _code(spec: Sweep, methods: tuple[str, ...]) -> dict[str, str]:
    """Return the SHA-256 of the code of methods, obstacles and task rows that other packages define."""
    return code_of(registry.METHODS, methods) | code_of_kinds(spec.config)


def _planner(
    on: str, methods: tuple[str, ...], batch: Batch, spec: Sweep, execution: Execution, sizes: ShardSizes
) -> contextlib.AbstractContextManager[Callable]:
    """Return a context manager that yields plan(missing, report), which yields a `PlannedShard` for each shard."""
    if on == "here":
        return contextlib.nullcontext(partial(plan_here, batch, execution, sizes))
    from htcp_jax.runs.ray_ import on_ray  # here, as Ray is an optional dependency

    registry.METHODS.refuse_own(methods)
    obstacle_kind.OBSTACLES.refuse_own(kind.name for kind in spec.config.cell.obstacles)
    TASK_ROWS.refuse_own(row.name for row in spec.config.task_rows)
    return on_ray(batch, spec.config, sizes, on.partition(":")[2])


def _resume_message(run: Run) -> str:
    manifest = run.manifest
    done = sum(shard.scenarios.rows for shard in manifest.shards)
    if not done:
        return "stopped before anything was finished; nothing was written"
    all_ = len(manifest.methods) * manifest.count
    return f"stopped; {done:,} of {all_:,} plans are finished in {run.folder}; run the same command to resume"


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

    Raises:
        InputError: If the folder contains a plan, which a run would hide.
    """
    if out is None:
        scratch = _Scratch()
        yield scratch.folder, scratch, lambda: None
        return
    folder = Path(out)
    if (folder / SUMMARY).exists() and not (folder / MANIFEST).exists():
        raise InputError(f"{folder} contains a plan of htcp plan ({SUMMARY}); choose another folder for the run")
    with output_files.made_folder(folder) as is_new:

        def discard() -> None:
            if is_new and not any(folder.glob("*/*.parquet")):
                shutil.rmtree(folder, ignore_errors=True)

        try:
            yield folder, None, discard
        finally:
            discard()
