"""Files of one plan, each written to a temporary file and moved into place."""

import contextlib
import csv
import dataclasses
import io
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.model import Robot
from htcp_jax.motion import Motion, Plans
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.runs.identity import other_format
from htcp_jax.runs.summary import Summary
from htcp_jax.status import Kind, SegmentStatus, Status
from htcp_jax.unfinished import temporary_folder

SUMMARY, TRAJECTORY = "summary.json", "trajectory.npz"
VALIDATION = "validation.json"  # results of `htcp validate` for a plan or a run


class PlanRecord(NamedTuple):
    """A saved plan."""

    method: str
    config: dict
    files: dict[str, str]  # SHA-256 of the files in the configuration
    arrays: dict[str, np.ndarray]  # of `Plans`, for the one scenario
    via_points: tuple[np.ndarray, np.ndarray, np.ndarray]  # target (n,), x (n, N), share (n,)


def read_plan(folder: Path) -> PlanRecord:
    """Return the plan in `folder`.

    Raises:
        InputError: For files that are missing, damaged or of another format.
    """
    try:
        summary = files.read_json(folder / SUMMARY, folder)
        method, config = str(summary["method"]), dict(summary["config"])
        hashes = {str(name): str(known) for name, known in summary["files"].items()}
        found = files.read_arrays(folder / TRAJECTORY, folder, leave=("joint_names",))
        target, x = found["via_point_target"], found["via_point_x"]
        via_points = target, x, found.get("via_point_share", np.zeros(len(target)))
        return PlanRecord(method, config, hashes, {name: found[name] for name in plan_arrays.ARRAYS}, via_points)
    except OSError as error:
        raise InputError(f"{folder} holds no plan: cannot read {error.filename}: {error.strerror}") from None
    except InputError:
        raise
    except KeyError as error:
        raise other_format(folder, f"{SUMMARY} or {TRAJECTORY} has no {error.args[0]}") from None
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{folder}: {SUMMARY} or {TRAJECTORY} is damaged: {files.one_line(error)}") from None


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[bool]:
    """Create `folder` with its parents, and yield True if it is new; new folders that are empty at the end are removed.

    Raises:
        InputError: If it cannot be made.
    """
    try:
        missing = [each for each in (folder, *folder.parents) if not each.exists()]  # a name may be too long
    except OSError as error:
        raise _unwritable(folder, error) from None
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(folder, error) from None
        yield bool(missing)
    finally:
        for each in missing:
            with contextlib.suppress(OSError):  # non-empty folders stay
                each.rmdir()


@contextlib.contextmanager
def written_whole(folder: Path) -> Iterator[Path]:
    """Yield a scratch folder whose files are moved into `folder` at the end of the block, or deleted if it raises.

    Raises:
        InputError: At once if `folder` cannot be made or written, and later if the files cannot be moved.
    """
    with made_folder(folder):
        try:
            with temporary_folder(folder) as scratch:
                yield scratch
                for file in sorted(scratch.iterdir()):
                    os.replace(file, folder / file.name)
        except OSError as error:
            raise _unwritable(folder, error) from None


def _unwritable(folder: Path, error: OSError) -> InputError:
    return InputError(f"cannot write to {folder}: {error.strerror}")


def write_trajectory_csv(
    file: Path, robot: Robot, plans: Plans, manipulability: Float[np.ndarray, "T"], row: int = 0
) -> None:
    """Write one line per target; NaN in `plans`, for unknown values, becomes an empty cell.

    Numbers round-trip exactly.

    Args:
        file: The file.
        robot: The arm, for the names and units of its joints.
        plans: The plans.
        manipulability: At each target [m/rad]; NaN if unknown.
        row: Row of the scenario.

    Raises:
        InputError: As `write_text` does.
    """
    statuses = [Status(status).name for status in plans.status[row].tolist()]
    columns = {"target": range(len(statuses)), "status": statuses, **_joint_columns(robot, plans.x[row])}
    for name, points in (("tcp", plans.tcp), ("target", plans.target)):
        columns |= {f"{name}_{axis}_m": points[row, :, k] for k, axis in enumerate("xyz")}
    columns |= {
        "clearance_m": plans.clearance[row],
        "residual_m": plans.residual[row],
        "orientation_error_rad": plans.orientation_error[row],
        "joint_step_rad": plans.joint_step[row],
        "iterations": plans.iterations[row],
        "recovery": plans.recovery[row],
        "path_clear": plans.path_clear[row],
        "segment_status": [
            SegmentStatus(code).name if code != SegmentStatus.NOT_CHECKED else ""
            for code in plans.segment_status[row].tolist()
        ],
        "segment_clearance_m": plans.segment_clearance[row],
        "manipulability_m_rad": manipulability,
    }
    _write_csv(file, columns)


def write_motion_csv(file: Path, robot: Robot, motion: Motion) -> None:
    """Write one line per configuration of a motion: its target, `status.Kind` and joints.

    No lines if no target is executable. Numbers round-trip exactly.

    Args:
        file: The file.
        robot: The arm, for the names and units of its joints.
        motion: See `motion.motion`.

    Raises:
        InputError: As `write_text` does.
    """
    kinds = [Kind(kind).name for kind in motion.kind.tolist()]
    _write_csv(file, {"target": motion.target, "kind": kinds, **_joint_columns(robot, motion.x)})


def _joint_columns(robot: Robot, x: Float[np.ndarray, "n N"]) -> dict[str, np.ndarray]:
    """Return the configurations, one column per joint."""
    units = ["m" if slides else "rad" for slides in robot.slides]
    names = [f"{name}_{unit}" for name, unit in zip(robot.joint_names, units, strict=True)]
    return dict(zip(names, x.T, strict=True))


def _write_csv(file: Path, columns: Mapping[str, Iterable]) -> None:
    """Write columns of equal length, NaN as empty cells."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for cells in zip(*columns.values(), strict=True):
        writer.writerow(["" if cell != cell else cell for cell in cells])
    write_text(file, stream.getvalue())


def write_trajectory_npz(file: Path, robot: Robot, plans: Plans, row: int = 0) -> None:
    """Write the arrays of `plans` for one scenario under the names of its fields; no pickles.

    `start` is (N,). Further arrays: `joint_names` and the via points' `via_point_target` (n,), `via_point_x` (n, N) and
    `via_point_share` (n,), see `ViaPoints`.

    Args:
        file: The file.
        robot: The arm, for the names of its joints.
        plans: The plans.
        row: Row of the scenario.

    Raises:
        InputError: If it cannot be written.
    """
    arrays = {name: array[row] for name, array in plans.arrays().items()}
    via_points = plans.via_points.rows(np.array([row]))
    names = np.array(robot.joint_names)
    stream = io.BytesIO()
    arrays |= {f"via_point_{name}": getattr(via_points, name) for name in ("target", "x", "share")}
    np.savez_compressed(stream, joint_names=names, **arrays)
    files.write_atomically(file.parent, file.name, stream.getvalue())


def write_json(file: Path, record: dict) -> None:
    """Write `record` as JSON, NaN and infinities as null.

    Raises:
        InputError: As `write_text` does.
    """
    write_text(file, json_text(record) + "\n")


def json_text(record: Any) -> str:
    """Return `record` as JSON, NaN and infinities as null."""
    return json.dumps(_json_value(record), indent=2, allow_nan=False)


@contextlib.contextmanager
def writable_file(file: Path) -> Iterator[None]:
    """Create the folder of a file that is written at the end of the block; it is removed again if it is empty then.

    Raises:
        InputError: At once, without side effects, if the file cannot be written.
    """
    with made_folder(file.parent):
        try:
            there = os.path.lexists(file)
            if file.exists() and not (file.is_file() or file.is_dir()):
                raise InputError(f"cannot write to {file}: not a regular file")
            file.open("ab").close()
            if not there:
                file.unlink()
        except OSError as error:
            raise _unwritable(file, error) from None
        yield


def append_text(file: Path, text: str) -> None:
    """Append to a file in UTF-8, after an empty line if it is not empty.

    Raises:
        InputError: If it cannot be written; the file is then unchanged.
    """
    before = 0
    try:
        before = file.stat().st_size if file.exists() else None
        with file.open("ab") as stream:
            stream.write(f"{chr(10) if before else ''}{text}".encode())
    except OSError as error:
        with contextlib.suppress(OSError):
            file.unlink() if before is None else os.truncate(file, before)
        raise _unwritable(file, error) from None


def write_text(file: Path, text: str) -> None:
    """Write a file in UTF-8 atomically.

    Raises:
        InputError: If it cannot be written; an existing file is then unchanged.
    """
    files.write_atomically(file.parent, file.name, text.encode())


def summary_record(summary: Summary) -> dict:
    """Return the summary with the failures' statuses as text."""
    failed = [
        {"scenario": f.scenario, "target": f.target, "status": f.status.name, "reason": f.status.message}
        for f in summary.failures
    ]
    return {**summary._asdict(), "failures": failed}


def _json_value(value: Any) -> Any:
    """Convert `value` to JSON's types."""
    if dataclasses.is_dataclass(value):
        value = dataclasses.asdict(value)
    if isinstance(value, dict):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
