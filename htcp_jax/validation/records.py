"""What is to be validated, read from a sweep's run folder or from the folder of one plan.

The results come as recorded. Their targets are worked out anew, by the scene's rules in plain numpy: scenario.py and
the pose rule of workpiece.py are among what is validated.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.errors import InputError
from htcp_jax.formats.strict_model import validate
from htcp_jax.jobs.build import arm_of, part_of, robot_of, workpiece_of
from htcp_jax.jobs.config import PlanConfig, RobotConfig, WorkpieceConfig
from htcp_jax.planner.plans import is_tracked
from htcp_jax.runs.identity import file_hash, refuse_changed
from htcp_jax.runs.plan_folder import SUMMARY, TRAJECTORY, read_plan
from htcp_jax.runs.run_folder import MANIFEST, Run, open_run, result_files
from htcp_jax.scene.workpiece import Workpiece

ARRAYS = "status", "path_clear", "x", "tcp", "target", "clearance"
XYZ = "xyz"
MOST_WORKPIECES = 8  # of one run in memory


class Pose(NamedTuple):
    """How a scenario differs from its configuration."""

    start: Float[np.ndarray, "N"]
    rotation_x_rad: float
    rotation_y_rad: float
    rotation_z_rad: float
    shift_m: Float[np.ndarray, "3"]
    tool_extension_m: float


class Track(NamedTuple):
    """What one method recorded for one scenario with T targets; NaN where a target is not tracked."""

    method: str
    scenario: int
    config: PlanConfig  # the scenario's own, but for the pose
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
    workpiece: Callable[[PlanConfig], Workpiece]  # of a track's configuration
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


def turned_and_moved(part: WorkpieceConfig, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,) from the workpiece frame to the world: about the pivot, first about world
    x, then about y, then about z, applied to the neutral pose; then the shift."""
    angles = pose.rotation_x_rad, pose.rotation_y_rad, pose.rotation_z_rad
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(angle), np.sin(angle)) for angle in angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    rotate, pivot = about_z @ about_y @ about_x, np.array(part.pivot_m)
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
    refuse_changed(run.manifest.files, run.folder)
    count = sum(shard.last - shard.first + 1 for shard in run.manifest.shards)
    if not count:
        raise InputError(f"{run.folder} has no finished shard yet")
    return Results(run.folder, _workpieces(), count, _tracks(run), result_files(run))


def _tracks(run: Run) -> Iterator[Track]:
    """Method by method, so that only one method's results are in memory."""
    points = run.points()
    for method in dict.fromkeys(shard.method for shard in run.manifest.shards):
        plans = run.plans(method)._asdict()
        for row in run.scenarios(method).to_pylist():
            pose = Pose(
                start=np.array([row[f"start_{joint}"] for joint in run.manifest.joints]),
                rotation_x_rad=row["rotation_x_rad"],
                rotation_y_rad=row["rotation_y_rad"],
                rotation_z_rad=row["rotation_z_rad"],
                shift_m=np.array([row[f"shift_{axis}_m"] for axis in XYZ]),
                tool_extension_m=row["tool_extension_m"],
            )
            number = row["scenario"]
            arrays = {name: plans[name][number] for name in ARRAYS}
            yield _track(method, number, points[number].config, pose, arrays)


def _read_plan(folder: Path) -> Results:
    method, raw, known, arrays = read_plan(folder, ARRAYS)
    refuse_changed(known, folder)
    config: PlanConfig = validate(raw, PlanConfig, str(folder / SUMMARY))
    part, start = config.workpiece, np.array(config.start_rad)
    count, joints = arrays["status"].size, len(start)
    shapes = {"x": (count, joints), "tcp": (count, 3), "target": (count, 3)}
    for name, array in arrays.items():
        if array.shape != shapes.get(name, (count,)) or array.dtype.kind not in "fiu":
            raise InputError(f"{folder / TRAJECTORY}: {name} has the shape {array.shape}; damaged")
    angles = part.rotation_x_rad, part.rotation_y_rad, part.rotation_z_rad
    pose = Pose(start, *angles, np.array(part.shift_m), config.robot.tool_extension_m)
    files = {TRAJECTORY: file_hash(folder / TRAJECTORY)}
    return Results(folder, _workpieces(), 1, [_track(method, 0, config, pose, arrays)], files)


def _track(method: str, scenario: int, config: PlanConfig, pose: Pose, arrays: dict[str, np.ndarray]) -> Track:
    there = arrays["status"] >= 0
    status, path_clear, *values = (arrays[name][there] for name in ARRAYS)
    return Track(method, scenario, config, pose, is_tracked(status), path_clear == 0, *values)


def _workpieces() -> Callable[[PlanConfig], Workpiece]:
    """Loads workpieces, and keeps the last few. Only their points, path and inlet are used, and that it is a mesh."""

    @lru_cache(maxsize=MOST_WORKPIECES)
    def load(part: WorkpieceConfig, arm: RobotConfig) -> Workpiece:
        return workpiece_of(part, robot_of(arm))

    return lambda config: load(part_of(config), arm_of(config))
