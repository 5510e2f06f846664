"""Writing of a run folder: begin or continue the run, then add shard by shard. The caller must lock the folder."""

import hashlib
import math
import warnings
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from htcp_jax.errors import InputError
from htcp_jax.io import arrays
from htcp_jax.motion import Plans
from htcp_jax.runs.columns import described
from htcp_jax.runs.identity import identity, identity_differences
from htcp_jax.runs.manifest import (
    MANIFEST,
    TABLES,
    FileRecord,
    Manifest,
    Seconds,
    ShardRecord,
    is_shard_name,
    plugins_for,
    shard_name,
)
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.run_folder import Run, file_fault, open_run
from htcp_jax.system import files as io_files

REMEDY = "delete the folder, or choose another --out"


def begin(folder: Path, requested: Manifest, keep: Any = None) -> Run:
    """Create the requested run in a folder, or continue it, and return the run with its finished shards.

    Shards with a damaged file are dropped, so that they are planned again. One warning per method reports them. Their
    files, and those of a shard that a killed process did not finish, are deleted.

    Args:
        folder: The run folder.
        requested: Manifest of the requested run, without shards.
        keep: An object to which the run keeps a reference, such as a temporary folder.

    Raises:
        InputError: If the folder contains another run, more scenarios than requested, or results without a manifest, or
            if it cannot be written.
    """
    _lay_out(folder)
    if not (folder / MANIFEST).exists():
        if strangers := _unlisted(folder, set()):
            raise InputError(f"{folder} contains results without a {MANIFEST}, such as {strangers[0]}; {REMEDY}")
        return _write_manifest(Run(folder, requested, keep))
    old = open_run(folder)
    _refuse_other(old, requested)
    _refuse_other_code(old, requested)
    _warn_of_other_software(old)
    kept = {name: getattr(old.manifest, name) for name in ("shards", "planned_by", "started")}
    methods = tuple(dict.fromkeys((*old.methods, *requested.methods)))
    kept |= {"methods": methods, "code": old.manifest.code | requested.code}
    kept |= {"plugins": old.manifest.plugins | requested.plugins}
    run = Run(folder, requested.model_copy(update=kept), keep)
    shards = _valid_shards(run, requested.methods)
    for file in _unlisted(folder, {shard_name(shard.method, shard.first, shard.last) for shard in shards}):
        if is_shard_name(file.name, methods):
            file.unlink(missing_ok=True)
        else:
            warnings.warn(f"{file} does not belong to this run and is left unchanged", stacklevel=3)
    return _write_manifest(_with_shards(run, shards))


def add(
    run: Run,
    method: str,
    scenarios: Sequence[int],
    tables: dict[str, pa.Table],
    plans: Plans,
    by: dict,
    cores: int | None = None,
) -> Run:
    """Write a shard, and return the run that includes it.

    Args:
        run: The run.
        method: Method of the shard.
        scenarios: Scenarios of the shard, as indices in `Manifest.numbers`.
        tables: Rows of the shard, by name of the table.
        plans: Plans of the shard.
        by: Provenance of the shard, from `provenance.planned_by`.
        cores: Number of CPU cores that planned the shard; None: unknown.

    Raises:
        InputError: If the shard cannot be written; the run on disk is then unchanged.
    """
    manifest = run.manifest
    numbers = tuple(manifest.numbers[row] for row in scenarios)
    first, last = numbers[0], numbers[-1]
    name, gaps = shard_name(method, first, last), last - first >= len(numbers)
    used = plugins_for(manifest.plugins, [method])
    made = {"run": manifest.name, **by, **({"plugins": used} if used else {})}
    rows = {table: described(own, table, manifest.joints, made) for table, own in tables.items()}
    files = {table: _write_parquet(run.folder, table, name, own) for table, own in rows.items()}
    planned_by = manifest.planned_by if by in manifest.planned_by else (*manifest.planned_by, by)
    tracked, known = int(plans.tracked.sum()), None if math.isnan(plans.cpu_s) else plans.cpu_s
    shard = ShardRecord(
        method=method, first=first, last=last, numbers=numbers if gaps else None, tracked=tracked, cores=cores,
        compile_s=plans.compile_s, run_s=plans.run_s, cpu_s=known, planned_by=planned_by.index(by), **files,
    )  # fmt: skip
    run = Run(run.folder, manifest.model_copy(update={"planned_by": planned_by}), run._keep)
    return _write_manifest(_with_shards(run, (*manifest.shards, shard)))


def _refuse_other(old: Run, requested: Manifest) -> None:
    differing = identity_differences(_identity(old.manifest), _identity(requested))
    if differing:
        more = f" (and {len(differing) - 1} more)" if differing[1:] else ""
        raise InputError(f"{old.folder} contains another sweep: {differing[0]}{more}; {REMEDY}")
    if requested.count < old.manifest.count and requested.scenarios is None:
        raise InputError(
            f"{old.folder} contains this sweep with {old.manifest.count} scenarios, more than {requested.count}; "
            + REMEDY
        )
    if lost := {*old.manifest.numbers} - {*requested.numbers}:
        raise InputError(f"{old.folder} contains scenario {min(lost)} of this sweep, which is not requested; {REMEDY}")


def _refuse_other_code(old: Run, requested: Manifest) -> None:
    """Raise InputError if the code of a method or kind of another package has changed since planning."""
    for name, code in requested.code.items():
        if old.manifest.shards and old.manifest.code.get(name, code) != code:
            raise InputError(f"the code of {name} has changed since {old.folder} was planned; {REMEDY}")


def _warn_of_other_software(old: Run) -> None:
    if old.manifest.planned_by:
        if differing := identity_differences(old.manifest.planned_by[-1], planned_by()):
            line = f"{old.folder} was planned with other software, and its plans are kept: {differing[0]}"
            warnings.warn(line, stacklevel=4)


def _identity(manifest: Manifest) -> dict:
    return identity(manifest.config, manifest.grid, manifest.dtype, manifest.files)


def _valid_shards(run: Run, requested: tuple[str, ...]) -> tuple[ShardRecord, ...]:
    """Return the recorded shards whose files are valid; warn of damaged ones."""
    whole, damaged = [], defaultdict(list)
    for shard in run.manifest.shards:
        files = run.shard_files(shard).values()
        if faults := [f"{file} {problem}" for file, record in files if (problem := file_fault(file, record))]:
            damaged[shard.method].append((shard, faults[0]))
        else:
            whole.append(shard)
    for method, lost in damaged.items():
        scenarios = ", ".join(f"{shard.first} to {shard.last}" for shard, _ in lost)
        then = f"are planned again by {method}" if method in requested else f"of {method} are now unfinished"
        more = f" (and {len(lost) - 1} more shards)" if lost[1:] else ""
        warnings.warn(f"{lost[0][1]}{more}; scenarios {scenarios} {then}", stacklevel=4)
    return tuple(whole)


def _with_shards(run: Run, shards: tuple[ShardRecord, ...]) -> Run:
    """Return the run with other shards in its manifest, and with the total times of these shards."""
    seconds = {}
    for method in run.methods:
        own = [shard for shard in shards if shard.method == method]
        known = None if any(s.cpu_s is None for s in own) else sum(s.cpu_s for s in own)
        wall = {"compile_s": sum(s.compile_s for s in own), "run_s": sum(s.run_s for s in own)}
        seconds[method] = Seconds(**wall, cpu_s=known)
    order = tuple(sorted(shards, key=lambda shard: (run.methods.index(shard.method), shard.first)))
    return Run(run.folder, run.manifest.model_copy(update={"shards": order, "seconds": seconds}), run._keep)


def _write_manifest(run: Run) -> Run:
    io_files.write_atomically(run.folder, MANIFEST, (run.manifest.model_dump_json(indent=2) + "\n").encode())
    return run


def _write_parquet(folder: Path, table: str, name: str, rows: pa.Table) -> FileRecord:
    doubles = [field.name for field in rows.schema if pa.types.is_floating(field.type)]
    words = [name for name in rows.column_names if name not in doubles and name not in ("via_points", "via_shares")]
    data = arrays.parquet_bytes(rows, use_dictionary=words, use_byte_stream_split=doubles)
    io_files.write_atomically(folder, f"{table}/{name}", data)
    return FileRecord(rows=len(rows), bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def _lay_out(folder: Path) -> None:
    for table in TABLES:
        io_files.make_folder(folder, table)


def _unlisted(folder: Path, expected: set[str]) -> list[Path]:
    """Return the result files in a run folder whose names are not expected."""
    files = [file for table in TABLES for file in sorted((folder / table).glob("*.parquet"))]
    return [file for file in files if file.name not in expected]
