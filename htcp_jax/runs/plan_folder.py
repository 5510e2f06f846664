"""Reading and writing of the files of one plan. A file is written under a temporary name and then renamed."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import arrays
from htcp_jax.model import Robot
from htcp_jax.motion import Motion, Plans
from htcp_jax.motion import plans as plan_arrays
from htcp_jax.runs import tables
from htcp_jax.runs.identity import other_format
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.summary import Summary
from htcp_jax.spec import TOOL_ANGLES
from htcp_jax.status import Kind, SegmentStatus, Status
from htcp_jax.system import files, output_files

SUMMARY, TRAJECTORY = "summary.json", "trajectory.npz"
VALIDATION = "validation.json"  # file with the results of `htcp validate` for a plan or a run


class PlanRecord(NamedTuple):
    """Content of a saved plan's folder."""

    method: str
    config: dict  # the complete job
    files: dict[str, str]  # SHA-256 of the files that the job names, by path
    arrays: dict[str, np.ndarray]  # fields of `Plans` by name, for the plan's only scenario
    via_points: tuple[np.ndarray, np.ndarray, np.ndarray]  # target (n,), x (n, N), share (n,); see `ViaPoints`
    seam_begins: np.ndarray  # first targets of later seams
    retract: tuple[np.ndarray, np.ndarray] | None  # fields of `Retract`; None: the motion reversed
    missing: dict[str, str]  # reasons for seams that the plan lacks, by name
    order: dict | None  # the order of several seams, see `SeamOrder.record`


def refuse_run(folder: Path) -> None:
    """Check that a folder for a plan contains no run, which would hide the plan.

    Raises:
        InputError: If it contains one.
    """
    if (folder / MANIFEST).exists():
        raise InputError(f"{folder} contains a run of htcp sweep ({MANIFEST}); choose another folder for the plan")


def read_plan(folder: Path) -> PlanRecord:
    """Read the plan in a folder of `htcp plan`.

    Raises:
        InputError: If a file is missing, damaged or has another format.
    """
    try:
        summary = files.read_json(folder / SUMMARY, folder)
        method, config = str(summary["method"]), dict(summary["config"])
        hashes = {str(name): str(known) for name, known in summary["files"].items()}
        found = arrays.read_arrays(folder / TRAJECTORY, folder, leave=("joint_names",))
        target, x = found["via_point_target"], found["via_point_x"]
        via_points = target, x, found.get("via_point_share", np.zeros(len(target)))
        own = {name: found[name] for name in plan_arrays.ARRAYS}
        back = (found["retract_x"], found["retract_clearance"]) if "retract_x" in found else None
        missing = {str(name): str(reason) for name, reason in summary.get("order", {}).get("missing", {}).items()}
        begins = found.get("seam_begins", np.zeros(0, int))
        return PlanRecord(method, config, hashes, own, via_points, begins, back, missing, summary.get("order"))
    except OSError as error:
        raise InputError(f"{folder} contains no plan: cannot read {error.filename}: {error.strerror}") from None
    except InputError:
        raise
    except KeyError as error:
        raise other_format(folder, f"{SUMMARY} or {TRAJECTORY} has no {error.args[0]}") from None
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{folder}: {SUMMARY} or {TRAJECTORY} is damaged: {files.one_line(error)}") from None


def write_trajectory_csv(
    file: Path,
    robot: Robot,
    plans: Plans,
    manipulability: Float[np.ndarray, "T"],
    row: int = 0,
    seams: Sequence[str] | None = None,
    angles: Float[np.ndarray, "T 3"] | None = None,
) -> None:
    """Write a plan as a CSV file with one line per target.

    NaN (an unknown value) becomes an empty cell. Numbers have all digits, so that they are read back exactly.

    Args:
        file: The file.
        robot: The arm, for the names and units of its joints.
        plans: The plans.
        manipulability: Manipulability at each target [m/rad]; NaN if unknown.
        row: Row of the scenario in `plans`.
        seams: Name of each target's seam; None: no such column.
        angles: Work angle, travel angle and spin of the tool at each target [degrees]; None: no such columns.

    Raises:
        InputError: If the file cannot be written.
    """
    statuses = [Status(status).name for status in plans.status[row].tolist()]
    columns = {"target": range(len(statuses)), "status": statuses, **_configurations(robot, plans.x[row])}
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
    columns |= {} if angles is None else dict(zip(TOOL_ANGLES, angles.T, strict=True))
    columns |= {} if seams is None else {"seam": seams}
    _write_csv(file, columns)


def write_motion_csv(file: Path, robot: Robot, motion: Motion, seams: Sequence[str] | None = None) -> None:
    """Write a motion as a CSV file with one line per configuration: target, `status.Kind` and joint values.

    If no target is executable, the file has only a header. Numbers have all digits, so that they are read back exactly.

    Args:
        file: The file.
        robot: The arm, for the names and units of its joints.
        motion: The motion, see `motion.motion`.
        seams: Name of each target's seam, for a column after the kind; None: no such column.

    Raises:
        InputError: If the file cannot be written.
    """
    kinds = [Kind(kind).name for kind in motion.kind.tolist()]
    named = {} if seams is None else {"seam": [seams[target] for target in motion.target.tolist()]}
    _write_csv(file, {"target": motion.target, "kind": kinds, **named, **_configurations(robot, motion.x)})


def _configurations(robot: Robot, x: Float[np.ndarray, "n N"]) -> dict[str, np.ndarray]:
    """Return one column per joint, by name, for n configurations; those of joints that follow others come last."""
    return dict(zip(tables.joint_columns(robot), x.T, strict=True)) | tables.follower_columns(robot, x)


def _write_csv(file: Path, columns: Mapping[str, Iterable]) -> None:
    """Write columns of equal length as a CSV file; NaN becomes an empty cell."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for cells in zip(*columns.values(), strict=True):
        writer.writerow(["" if cell != cell else cell for cell in cells])
    output_files.write_text(file, stream.getvalue())


def write_trajectory_npz(file: Path, robot: Robot, plans: Plans, row: int = 0) -> None:
    """Write the arrays of one scenario as an .npz file without pickles, under the names of the fields of `Plans`.

    The array `start` has the shape (N,). Additional arrays are `joint_names` and, for n via points, `via_point_target`
    (n,), `via_point_x` (n, N) and `via_point_share` (n,), see `ViaPoints`. With several seams, also `seam_begins`, and
    `retract_x` (R, N) and `retract_clearance` (R,), see `Retract`.

    Args:
        file: The file.
        robot: The arm, for the names of its joints.
        plans: The plans.
        row: Row of the scenario in `plans`.

    Raises:
        InputError: If the file cannot be written.
    """
    arrays = {name: array[row] for name, array in plans.arrays().items()}
    via_points = plans.via_points.rows(np.array([row]))
    names = np.array(robot.joint_names)
    stream = io.BytesIO()
    arrays |= {f"via_point_{name}": getattr(via_points, name) for name in ("target", "x", "share")}
    if plans.seam_begins:
        arrays["seam_begins"] = np.array(plans.seam_begins)
    if plans.retract is not None:
        arrays |= {f"retract_{name}": array for name, array in plans.retract._asdict().items()}
    np.savez_compressed(stream, joint_names=names, **arrays)
    files.write_atomically(file.parent, file.name, stream.getvalue())


def summary_record(summary: Summary) -> dict:
    """Return a summary as a mapping for JSON, with the statuses of failed targets as text."""
    failed = [
        {"scenario": f.scenario, "target": f.target, "status": f.status.name, "reason": f.status.message}
        for f in summary.failures
    ]
    return {**summary._asdict(), "failures": failed}
