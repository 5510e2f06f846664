"""The files of one plan. Everything is written aside and moved into place whole."""

import contextlib
import csv
import dataclasses
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.formats.foreign import one_line
from htcp_jax.planner.motion import Motion
from htcp_jax.planner.plans import ARRAYS, Plans
from htcp_jax.runs.summary import Summary
from htcp_jax.scene.robot import Robot
from htcp_jax.status import Kind, Status, Way

LATER = "start", "way", "way_clearance", "orientation_error"
SUMMARY, TRAJECTORY = "summary.json", "trajectory.npz"
VALIDATION = "validation.json"  # of a plan and of a run, what `htcp validate` found


class PlanRecord(NamedTuple):
    """A plan as it was written."""

    method: str
    config: dict
    files: dict[str, str]  # SHA-256 of those that the configuration names; a plan of before knew none
    arrays: dict[str, np.ndarray]  # of `Plans`, for the one scenario; a plan of before had no LATER ones
    knots: tuple[np.ndarray, np.ndarray] | None  # target (n,), x (n, N)


def read_plan(folder: Path) -> PlanRecord:
    """The plan in `folder`. Raises InputError for files that are not there or damaged."""
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        method, config = str(summary["method"]), dict(summary["config"])
        files = {str(name): str(known) for name, known in summary.get("files", {}).items()}
        # np.load leaves a file that it opened itself open when it is no archive.
        with (folder / TRAJECTORY).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            known = [name for name in ARRAYS if name in file or name not in LATER]
            knots = (file["knot_target"], file["knot_x"]) if "knot_x" in file else None
            return PlanRecord(method, config, files, {name: file[name] for name in known}, knots)
    except OSError as error:
        raise InputError(f"{folder} holds no plan: cannot read {error.filename}: {error.strerror}") from None
    except Exception as error:  # foreign parsers on foreign bytes: whatever they raise, the files are bad
        raise InputError(f"{folder}: {SUMMARY} or {TRAJECTORY} is damaged: {one_line(error)}") from None


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[bool]:
    """`folder` is there, with all above it; what was made for this and is empty at the end vanishes again. Hands out
    whether it was made.

    Raises InputError if it cannot be made.
    """
    try:
        missing = [each for each in (folder, *folder.parents) if not each.exists()]  # a name may be too long to ask for
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
            with contextlib.suppress(OSError):  # what is in use stays
                each.rmdir()


@contextlib.contextmanager
def written_whole(folder: Path) -> Iterator[Path]:
    """A scratch folder whose files move into `folder` when the block ends well, and vanish when it does not.

    Raises InputError at once if `folder` cannot be made or written, and later if the files cannot be moved.
    """
    with made_folder(folder):
        try:
            scratch = Path(tempfile.mkdtemp(prefix=".part-", dir=folder))
        except OSError as error:
            raise _unwritable(folder, error) from None
        try:
            yield scratch
            for file in sorted(scratch.iterdir()):
                os.replace(file, folder / file.name)
        except OSError as error:
            raise _unwritable(folder, error) from None
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _unwritable(folder: Path, error: OSError) -> InputError:
    return InputError(f"cannot write to {folder}: {error.strerror}")


def write_trajectory_csv(file: Path, robot: Robot, plans: Plans, row: int = 0) -> None:
    """One line a target; cells of what is not known, NaN in `plans`, are empty. Numbers read back exactly."""
    statuses = [Status(status).name for status in plans.status[row].tolist()]
    columns = {"target": range(len(statuses)), "status": statuses, **_joints(robot, plans.x[row])}
    for name, points in (("tcp", plans.tcp), ("target", plans.target)):
        columns |= {f"{name}_{axis}_m": points[row, :, k] for k, axis in enumerate("xyz")}
    columns |= {
        "clearance_m": plans.clearance[row],
        "residual_m": plans.residual[row],
        "orientation_error_rad": plans.orientation_error[row],
        "joint_step_rad": plans.joint_step[row],
        "iterations": plans.iterations[row],
        "escape": plans.escape[row],
        "path_clear": plans.path_clear[row],
        "way": [Way(code).name if code != Way.UNKNOWN else "" for code in plans.way[row].tolist()],
        "way_clearance_m": plans.way_clearance[row],
    }
    _write_csv(file, columns)


def write_motion_csv(file: Path, robot: Robot, motion: Motion) -> None:
    """One line a posture that the arm passes: its target and `status.Kind`, see `planner.motion`, and the joints; none
    where no target is executable. Numbers read back exactly."""
    kinds = [Kind(kind).name for kind in motion.kind.tolist()]
    _write_csv(file, {"target": motion.target, "kind": kinds, **_joints(robot, motion.x)})


def _joints(robot: Robot, x: Float[np.ndarray, "n N"]) -> dict[str, np.ndarray]:
    """The configurations, a column a joint."""
    units = ["m" if slides else "rad" for slides in robot.slides]
    names = [f"{name}_{unit}" for name, unit in zip(robot.joint_names, units, strict=True)]
    return dict(zip(names, x.T, strict=True))


def _write_csv(file: Path, columns: Mapping[str, Iterable]) -> None:
    """Columns of one length, NaN as empty cells."""
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for cells in zip(*columns.values(), strict=True):
            writer.writerow(["" if cell != cell else cell for cell in cells])


def write_trajectory_npz(file: Path, robot: Robot, plans: Plans, row: int = 0) -> None:
    """The arrays of `plans` for one scenario under the names of its fields, `start` (N,) among them, `joint_names`, and
    the knots' `knot_target` (n,) and `knot_x` (n, N); no pickles."""
    arrays = {name: array[row] for name, array in plans.arrays().items()}
    knots = plans.knots.rows(np.array([row]))
    names = np.array(robot.joint_names)
    np.savez_compressed(file, joint_names=names, knot_target=knots.target, knot_x=knots.x, **arrays)


def write_json(file: Path, record: dict) -> None:
    """`record` as JSON, NaN and infinities as null. Raises InputError as `write_text` does."""
    write_text(file, json_text(record) + "\n")


def json_text(record: Any) -> str:
    """`record` as JSON, NaN and infinities as null."""
    return json.dumps(_plain(record), indent=2, allow_nan=False)


@contextlib.contextmanager
def writable_file(file: Path) -> Iterator[None]:
    """Make the folder of a file that is written at the end of the block; it vanishes again if it is empty then.

    Raises InputError at once, and leaves all as it was, if the file cannot be written.
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
    """Append to a file in UTF-8, after an empty line if it holds something. Raises InputError when it cannot be
    written; what was there is then as before."""
    before = 0
    try:
        before = file.stat().st_size if file.exists() else None
        with file.open("ab") as stream:
            stream.write(f"{chr(10) if before else ''}{text}".encode())
    except OSError as error:
        with contextlib.suppress(OSError):
            file.unlink() if before is None else os.truncate(file, before)
        raise _unwritable(file, error) from None


def part_of(file: Path) -> Path:
    """Name of a file while `write_text` writes it."""
    return file.with_name(f".part-{file.name}")


def write_text(file: Path, text: str) -> None:
    """A file in UTF-8, written aside and moved into place. Raises InputError when it cannot be written; what was there
    is then as before."""
    part = part_of(file)
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, file)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise _unwritable(file.parent, error) from None


def summary_record(summary: Summary) -> dict:
    """The summary with the failed targets in words."""
    failed = [
        {"scenario": f.scenario, "target": f.target, "status": f.status.name, "reason": f.status.message}
        for f in summary.failures
    ]
    return {**summary._asdict(), "failures": failed}


def _plain(value: Any) -> Any:
    """`value` in JSON's own types."""
    if dataclasses.is_dataclass(value):
        value = dataclasses.asdict(value)
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
