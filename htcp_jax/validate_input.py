"""What is to be validated, read from a sweep's run folder or from the folder of one plan.

The results come as recorded. Their targets are worked out anew, by the scene's rules in plain numpy: scenario.py and
the pose rule of workpiece.py are among what is validated.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.config import PlanConfig, WorkpieceConfig, validate
from htcp_jax.errors import InputError
from htcp_jax.job import robot_of, workpiece_of
from htcp_jax.metrics import is_tracked
from htcp_jax.results import SUMMARY, TRAJECTORY, read_plan
from htcp_jax.run_folder import MANIFEST, Run, open_run
from htcp_jax.run_identity import file_hash
from htcp_jax.workpiece import Workpiece

ARRAYS = "status", "path_clear", "x", "tcp", "target", "clearance"
XYZ = "xyz"


class Pose(NamedTuple):
    """How a scenario differs from its configuration."""

    start: Float[np.ndarray, "N"]
    rotation_y_rad: float
    rotation_z_rad: float
    shift_m: Float[np.ndarray, "3"]
    tool_extension_m: float
    path: str  # key of `Results.workpieces`


class Track(NamedTuple):
    """What one method recorded for one scenario with T targets; NaN where a target is not tracked."""

    method: str
    scenario: int
    pose: Pose
    tracked: Bool[np.ndarray, "T"]
    blocked: Bool[np.ndarray, "T"]  # joint path from the row before, as recorded
    x: Float[np.ndarray, "T N"]
    tcp: Float[np.ndarray, "T 3"]
    target: Float[np.ndarray, "T 3"]
    clearance: Float[np.ndarray, "T"]


class Results(NamedTuple):
    """All that is to be validated."""

    folder: Path
    config: PlanConfig
    workpieces: dict[str, Workpiece]  # by their tool path; they share their cloud
    count: int  # of the tracks
    tracks: Iterable[Track]
    files: dict[str, str]  # SHA-256 of the files that hold the results


def read_results(folder: Path) -> Results:
    """The results in `folder`. Raises InputError for a folder that holds neither a run nor a plan, for damaged files,
    and for a cloud, path or model that has changed since the run."""
    folder = Path(folder)
    if (folder / MANIFEST).exists():
        return _read_run(open_run(folder))
    if (folder / SUMMARY).exists():
        return _read_plan(folder)
    raise InputError(f"{folder} holds neither a run of htcp sweep ({MANIFEST}) nor a plan of htcp plan ({SUMMARY})")


def result_files(run: Run) -> dict[str, str]:
    """SHA-256 of the files with a run's finished results, by their names in its folder."""
    files = (run.shard_files(shard)["targets"] for shard in run.manifest.shards)
    return {str(file.relative_to(run.folder)): record.sha256 for file, record in files}


def turned_and_moved(part: WorkpieceConfig, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) from the workpiece frame to the world: about the pivot, first about world
    y, then about world z, applied to the neutral pose; then the shift."""
    (cy, sy), (cz, sz) = ((np.cos(angle), np.sin(angle)) for angle in (pose.rotation_y_rad, pose.rotation_z_rad))
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotate, pivot = about_z @ about_y, np.array(part.pivot_m)
    return rotate, pivot + rotate @ (np.array(part.neutral_translation_m) - pivot) + pose.shift_m


def targets_of(
    part: WorkpieceConfig, tcp: np.ndarray, inlet: np.ndarray | None, path: np.ndarray
) -> Float[np.ndarray, "T 3"]:
    """The targets, world: the start's TCP, steps to the inlet, steps from there to the path, the path."""
    to_inlet, to_path = part.approach_to_inlet, part.approach_to_path
    if inlet is None:
        legs = [(tcp, path[0], to_inlet + to_path)]
    else:
        legs = [(tcp, inlet, to_inlet), (inlet, path[0], to_path)]
    steps = [a + (b - a) * (k / count) for a, b, count in legs for k in range(1, count + 1)]
    return np.array([tcp, *steps, *path])


def _read_run(run: Run) -> Results:
    manifest, config = run.manifest, run.config
    for name, known in manifest.files.items():
        if file_hash(name) != known:
            raise InputError(f"{name} is not what it was when {run.folder} was planned")
    paths = _paths(run)
    workpieces = {path: _workpiece(config, path) for path in paths.values()}
    count = sum(shard.last - shard.first + 1 for shard in manifest.shards)
    if not count:
        raise InputError(f"{run.folder} has no finished shard yet")
    return Results(run.folder, config, workpieces, count, _tracks(run, paths), result_files(run))


def _tracks(run: Run, paths: dict[str, str]) -> Iterator[Track]:
    """Method by method, so that only one method's results are in memory."""
    for method in dict.fromkeys(shard.method for shard in run.manifest.shards):
        plans = run.plans(method)._asdict()
        for row in run.scenarios(method).to_pylist():
            pose = Pose(
                start=np.array([row[f"start_{joint}"] for joint in run.manifest.joints]),
                rotation_y_rad=row["rotation_y_rad"],
                rotation_z_rad=row["rotation_z_rad"],
                shift_m=np.array([row[f"shift_{axis}_m"] for axis in XYZ]),
                tool_extension_m=row["tool_extension_m"],
                path=paths[row["path"]],
            )
            yield _track(method, row["scenario"], pose, {name: plans[name][row["scenario"]] for name in ARRAYS})


def _paths(run: Run) -> dict[str, str]:
    """The tool paths of a run by the names in its table of scenarios."""
    axes = [axis for group in run.manifest.grid for axis in group["axes"]]
    full = [name for axis in axes for name in axis.get("workpiece.path", {}).get("values", ())]
    named = {}
    for path in dict.fromkeys([run.config.workpiece.path, *full]):
        if named.setdefault(Path(path).name, path) != path:
            raise InputError(f"{run.folder}: two tool paths are called {Path(path).name}; they cannot be told apart")
    return named


def _read_plan(folder: Path) -> Results:
    method, raw, arrays = read_plan(folder, ARRAYS)
    config: PlanConfig = validate(raw, PlanConfig, str(folder / SUMMARY), of_record=True)
    part, start = config.workpiece, np.array(config.start_rad)
    count, joints = arrays["status"].size, len(start)
    shapes = {"x": (count, joints), "tcp": (count, 3), "target": (count, 3)}
    for name, array in arrays.items():
        if array.shape != shapes.get(name, (count,)) or array.dtype.kind not in "fiu":
            raise InputError(f"{folder / TRAJECTORY}: {name} has the shape {array.shape}; damaged")
    extension = config.robot.tool_extension_m
    pose = Pose(start, part.rotation_y_rad, part.rotation_z_rad, np.array(part.shift_m), extension, part.path)
    workpieces = {part.path: _workpiece(config, part.path)}
    files = {TRAJECTORY: file_hash(folder / TRAJECTORY)}
    return Results(folder, config, workpieces, 1, [_track(method, 0, pose, arrays)], files)


def _track(method: str, scenario: int, pose: Pose, arrays: dict[str, np.ndarray]) -> Track:
    there = arrays["status"] >= 0
    status, path_clear, *values = (arrays[name][there] for name in ARRAYS)
    return Track(method, scenario, pose, is_tracked(status), path_clear == 0, *values)


def _workpiece(config: PlanConfig, path: str) -> Workpiece:
    """Only its points, path and inlet are used, and that it is a mesh."""
    return workpiece_of(config.workpiece.model_copy(update={"path": path}), robot_of(config.robot))
