"""Independent validation of results by MuJoCo's kinematics and distances, without the planner's code.

    found = validate("out/workpiece")
    found.validated                       # True if every tracked configuration is confirmed
    found.methods["hybrid"].clearance_min_mm

At the targets every tracked configuration must be at its target, be collision-free, keep the joint limits, and have the
saved clearance, TCP and target; otherwise it is refuted. The clearance to a mesh is to its triangles, and the saved one
must be a lower bound on it; if the job requires it, the tool's bare tip must not pass through them. Between the targets
the straight joint path is checked in small steps. A collision, a TCP away from its line or a violated row of the task
refutes a target only if the segment to it is saved as proven. Otherwise it is counted and saved.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.jobs import build, config
from htcp_jax.runs import plan_folder
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell
from htcp_jax.validation.mujoco_clearance import Wall, wall_of
from htcp_jax.validation.records import read_results
from htcp_jax.validation.result import MethodCheck, RowDeviation, TargetPlace, Validation
from htcp_jax.validation.scene_rules import Results, Track
from htcp_jax.validation.track import TrackCheck, check

LISTED = 100  # refuted configurations that are listed one by one


def validate_results(
    folder: str | Path,
    *,
    between: int = 20,
    feed_mm_s: float = 10.0,
    progress: Callable[[int, int], None] | None = None,
) -> Validation:
    """Check the run or the plan in `folder`.

    Args:
        folder: The folder of the run or the plan.
        between: Minimum number of steps of each joint path, more if a joint would turn by more than `STEP_RAD` in one;
            0 to check the targets only.
        feed_mm_s: Speed of the TCP along the straight lines between the targets.
        progress: Called with the number of checked tracks and of all.

    Raises:
        InputError: For a folder without results, for damaged ones, and for numbers out of range.
    """
    if between < 0:
        raise InputError(f"between is {between}; it must be 0 or more")
    if not 0 < feed_mm_s < np.inf:
        raise InputError(f"the feed rate is {feed_mm_s:g} mm/s; it must be positive")
    began = time.perf_counter()
    results = read_results(Path(folder))
    arms: dict[config.RobotConfig, MujocoArm] = {}
    walls: dict[tuple, Wall] = {}
    surroundings_by_arm: dict[tuple, MujocoCell] = {}
    checked = []
    for track in results.tracks:
        arm, wall = _arm_with_tool(arms, results, track), _wall(walls, results, track)
        surroundings = _cell_of_track(surroundings_by_arm, arms, track)
        checked.append(check(results, arm, wall, surroundings, track, between))
        if progress is not None:
            progress(len(checked), results.count)
    joints = next(iter(arms.values())).joints
    methods = {
        name: _sum_up([one for one in checked if one.method == name], joints, feed_mm_s)
        for name in dict.fromkeys(one.method for one in checked)
    }
    refuted = tuple(one for each in checked for one in each.refuted)
    seconds = time.perf_counter() - began
    depth, pair = max((each.deepest for each in surroundings_by_arm.values()), default=(0.0, ""))
    excluded = f"{pair}, {1e3 * depth:.3g} mm" if pair else None
    found = not refuted, methods, refuted, between, feed_mm_s, seconds, results.files, excluded
    return Validation(*found, _unchecked(checked, surroundings_by_arm.values()))


def validation_record(found: Validation) -> dict[str, Any]:
    """Return a validation as a mapping for JSON."""
    refuted = [one._asdict() for one in found.refuted[:LISTED]]
    versions = {"mujoco": mujoco.__version__, "scipy": scipy.__version__, "numpy": np.__version__}
    return {
        **found._asdict(),
        "refuted_count": len(found.refuted),
        "refuted": refuted,
        "methods": {
            name: check._asdict() | {"rows": [row._asdict() for row in check.rows]}
            for name, check in found.methods.items()
        },
        "versions": versions,
    }


def write_validation(folder: Path, found: Validation) -> None:
    """Write validation.json and, in the folder of a plan, "validated" in summary.json, atomically.

    A stronger validation of the same results is kept, with a warning: one with more points between the targets, at any
    feed rate.

    Raises:
        InputError: If the folder cannot be written.
    """
    recorded = validation_record(found)
    if _is_stronger(folder / plan_folder.VALIDATION, recorded):
        warnings.warn(
            f"{folder / plan_folder.VALIDATION} is kept: it validates the same results with more samples than "
            f"--between {found.between} does",
            stacklevel=2,
        )
    else:
        plan_folder.write_json(folder / plan_folder.VALIDATION, recorded)
    summary = folder / plan_folder.SUMMARY
    if summary.exists():
        plan_folder.write_json(summary, files.read_json(summary, folder) | {"validated": found.validated})


def _is_stronger(file: Path, recorded: dict[str, Any]) -> bool:
    """True if the validation in `file` is of the same results, with more points between the targets.

    It must have the same verdict and at least the keys of `recorded`.
    """
    try:
        known = files.read_json(file, file.parent)
        same = all(known[key] == recorded[key] for key in ("files", "validated"))
        return same and known["between"] > recorded["between"] and _record_keys(known) >= _record_keys(recorded)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False  # there is none, or it is damaged


def _record_keys(recorded: dict[str, Any]) -> set[str]:
    """Keys of a validation, including its methods'; later versions may have more."""
    return {*recorded, *(f"{method}.{key}" for method, check in recorded["methods"].items() for key in check)}


def parts_of(results: Results, track: Track) -> tuple[MujocoArm, Wall, MujocoCell | None]:
    """Load the arm, the workpiece and the other obstacles of a track.

    Raises:
        InputError: For a model that cannot be read.
    """
    arms: dict[config.RobotConfig, MujocoArm] = {}
    return _arm_with_tool(arms, results, track), _wall({}, results, track), _cell_of_track({}, arms, track)


def _arm_with_tool(arms: dict[config.RobotConfig, MujocoArm], results: Results, track: Track) -> MujocoArm:
    """The arm with the track's tool. Raises InputError if its number of joints differs from the saved one."""
    arm = _compiled(arms, track.config.robot)
    if len(arm.joints) != track.x.shape[1]:
        raise InputError(f"{results.folder}: {track.x.shape[1]} joints are saved, the model has {len(arm.joints)}")
    return arm


def _compiled(arms: dict[config.RobotConfig, MujocoArm], robot: config.RobotConfig) -> MujocoArm:
    """An arm; each is compiled once."""
    if robot not in arms:
        arms[robot] = MujocoArm(
            robot.file,
            robot.tool_extension_m,
            robot.limits,
            tcp="tcp" if robot.tcp is None else robot.tcp,
            base_m=robot.base_m,
            base_rpy_rad=robot.base_rpy_rad,
            tool=robot.tool,
            locked=dict(robot.locked),
            pieces=robot.bodies != "capsules",
        )
    return arms[robot]


def _cell_of_track(
    surroundings_by_arm: dict[tuple, MujocoCell], arms: dict[config.RobotConfig, MujocoArm], track: Track
) -> MujocoCell | None:
    """Obstacles of the track's arm other than the workpiece; None if there are none."""
    robot, cell = track.config.robot, track.config.cell
    if not (cell.self_collision or cell.model or cell.clouds or cell.obstacles):
        return None
    if (robot, cell) not in surroundings_by_arm:
        plain = _compiled(arms, robot.model_copy(update={"tool_extension_m": 0.0}))
        surroundings_by_arm[robot, cell] = MujocoCell(cell, _compiled(arms, robot), plain)
    return surroundings_by_arm[robot, cell]


def _wall(walls: dict[tuple, Wall], results: Results, track: Track) -> Wall:
    """The track's workpiece; each is loaded once, also for several paths along it."""
    key = (
        build.walls_key(build.workpiece_key(track.config)),
        build.robot_key(track.config),
    )  # the points on a mesh are as close as the arm needs
    if key not in walls:
        walls[key] = wall_of(track.config.workpiece, results.workpiece(track.config))
    return walls[key]


def _sum_up(checked: Sequence[TrackCheck], joints: Sequence[str], feed_mm_s: float) -> MethodCheck:
    """Combine one method's tracks."""
    targets = [(one.scenario, target) for one in checked for target in one.target.tolist()]
    paths = [(one.scenario, target) for one in checked for target in one.leads_to.tolist()]
    checked_between = checked[0].touches is not None

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) for one in checked])

    clearance = all_of("clearance")
    clearance_min, clearance_at = _worst(np.argmin, clearance, targets)
    between_min = between_at = deviation_max = deviation_at = None
    if checked_between:
        along = np.concatenate([clearance, all_of("clearance_between")])
        between_min, between_at = _worst(np.argmin, along, [*targets, *paths])
        deviation_max, deviation_at = _worst(np.argmax, all_of("deviation"), paths)
    less_cover = None
    if any(one.less_cover is not None for one in checked):
        each = [one.clearance if one.less_cover is None else one.less_cover for one in checked]
        less_cover, _ = _worst(np.argmin, np.concatenate(each), targets)
    ratio = all_of("speed") * feed_mm_s / 1e3
    path, joint = np.unravel_index(ratio.argmax(), ratio.shape) if ratio.any() else (None, None)
    return MethodCheck(
        checked=sum(one.tracked for one in checked),
        refuted=sum(len(one.refuted) for one in checked),
        tcp_error_max_mm=_worst(np.argmax, all_of("tcp_error"), targets)[0],
        clearance_min_mm=clearance_min,
        clearance_min_at=clearance_at,
        clearance_less_cover_min_mm=less_cover,
        clearance_off_max_mm=_worst(np.argmax, all_of("clearance_off"), targets)[0],
        tcp_off_max_mm=_worst(np.argmax, all_of("tcp_off"), targets)[0],
        target_off_max_mm=_worst(np.argmax, all_of("target_off"), targets)[0],
        paths=len(paths),
        paths_touching=int(all_of("touches").sum()) if checked_between else None,
        paths_blocked=sum(one.blocked for one in checked),
        clearance_between_min_mm=between_min,
        clearance_between_min_at=between_at,
        line_deviation_max_mm=deviation_max,
        line_deviation_max_at=deviation_at,
        speed_ratio_max=None if path is None else float(ratio[path, joint]),
        speed_joint=None if path is None else joints[joint],
        speed_at=None if path is None else paths[path],
        in_place_max_rad=float(all_of("in_place").max()) if paths else None,
        rows=_row_deviations(checked),
    )


def _row_deviations(checked: Sequence[TrackCheck]) -> tuple[RowDeviation, ...]:
    """Every row of the task where it deviates by the largest share of its tolerance."""
    found = [
        [_row_deviation(one, number) for number, row in enumerate(one.rows) if not row.unchecked]
        for one in checked
        if len(one.on_path)
    ]
    return tuple(max(rows, key=lambda row: row.off / row.most) for rows in zip(*found, strict=True))


def _unchecked(checked: Sequence[TrackCheck], surroundings_by_arm: Iterable[MujocoCell]) -> tuple[str, ...]:
    """Sentences on obstacles without shapes, and on rows without a check of their own."""
    obstacles = sorted({name for surroundings in surroundings_by_arm for name in surroundings.unmeasured})
    lines = [f"The obstacle {name!r} is not measured: it has no shapes for MuJoCo." for name in obstacles]
    rows = {f"task.{k} ({row.row})" for one in checked for k, row in enumerate(one.rows, 1) if row.unchecked}
    return *lines, *(f"The row {row} is not validated: its kind has no deviation." for row in sorted(rows))


def _row_deviation(one: TrackCheck, number: int) -> RowDeviation:
    """Largest deviation from a row of one track."""
    row = one.rows[number]
    k = int(np.argmax(row.off))
    at = one.scenario, int(one.on_path[k])
    return RowDeviation(
        f"task.{number + 1}: {row.row}", row.factor * float(row.off[k]), row.factor * row.most, row.unit, at
    )


def _worst(
    which: Callable, values: np.ndarray, places: Sequence[TargetPlace]
) -> tuple[float | None, TargetPlace | None]:
    """The worst of values [m] in mm, and its place; `which` is argmin or argmax."""
    if not values.size:
        return None, None
    at = int(which(values))
    return 1e3 * float(values[at]), places[at]
