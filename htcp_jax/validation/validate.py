"""Independent validation of results, by MuJoCo's kinematics and distances and without the planner's code.

    found = validate_results("out/workpiece")
    found.validated                       # True if every tracked configuration is confirmed
    found.methods["hybrid"].clearance_min_mm

Every tracked configuration must be at its target, collision-free and within the joint limits, and the saved clearance,
TCP and target must be correct; otherwise the target is refuted. Clearance from a mesh is measured to its triangles;
the saved clearance must be a lower bound on it. If the job requires it, the tool's bare tip must not pass through the
triangles. Between targets, the straight joint paths are checked in small steps. A collision, a path deviation or a
violated row of the task on a joint path refutes the target at its end if the segment is saved as proven. Other
collisions are only counted.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import scipy

from htcp_jax.errors import InputError
from htcp_jax.jobs import build
from htcp_jax.runs import Run, plan_folder
from htcp_jax.spec import config, feed, model_source
from htcp_jax.system import files, output_files
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell
from htcp_jax.validation.mujoco_clearance import Wall, wall_of
from htcp_jax.validation.records import read_results
from htcp_jax.validation.result import STEP_RAD, MethodCheck, RowDeviation, TargetPlace, Validation
from htcp_jax.validation.scene_rules import Results, Track
from htcp_jax.validation.task_check import RowCheck
from htcp_jax.validation.track import TrackCheck, check

LISTED = 100  # maximum number of refuted targets in the list
UNSTATED_MM_S = 10.0  # feed rate for the joint speeds if no job states one [mm/s]
BOUNDS = (
    "The convex piece in a capsule is measured only where the capsule is nearer than the plan records: "
    "clearances are lower bounds."
)
MOST_BETWEEN = 10_000  # maximum number of steps between two targets, limited by memory


def validate_results(
    source: str | Path | Run,
    *,
    between: int = 20,
    only_claimed: bool = False,
    step_rad: float = STEP_RAD,
    feed_mm_s: float | None = None,
    progress: Callable[[float, int], None] | None = None,
) -> Validation:
    """Validate the results of a run, or in the folder of a run or a plan.

    Args:
        source: The run, or the folder of the run or the plan.
        between: Minimum number of steps per joint path; a longer path has more, so that no joint moves by more than
            `step_rad` per step. 0: only the targets are checked.
        only_claimed: True to sample only segments that are saved as motions or have via points; others are not counted.
        step_rad: Maximum joint step [rad or m].
        feed_mm_s: Feed rate of the TCP on the path [mm/s], for the joint speeds; None: the largest one that the jobs
            of the results state, or UNSTATED_MM_S.
        progress: Function that is called with the number of checked tracks and of all tracks. The current one counts as
            the share of its samples that are checked.

    Raises:
        InputError: If the folder contains no results, if results are damaged, or if an argument is out of range.
    """
    if not 0 <= between <= MOST_BETWEEN:
        raise InputError(f"between is {between}; valid: 0 to {MOST_BETWEEN:,}")
    if feed_mm_s is not None and not 0 < feed_mm_s < np.inf:
        raise InputError(f"the feed rate is {feed_mm_s:g} mm/s; it must be positive")
    began = time.perf_counter()
    results = read_results(source if isinstance(source, Run) else Path(source))
    parts, joints = LoadedParts(results), ()
    checked, report, feeds, has_hulls = [], progress or (lambda checked, count: None), set[str](), False
    for track in results.tracks:
        arm, wall, surroundings = parts.of(track)
        joints, done, has_hulls = joints or arm.joints, len(checked), has_hulls or any(arm.hulls)
        feeds |= {text for text in track.config.stated_feeds if text is not None}
        given = results, arm, wall, surroundings, track, between, only_claimed, step_rad
        checked.append(check(*given, lambda share, done=done: report(done + share, results.count)))
        report(len(checked), results.count)
    if feed_mm_s is None:
        feed_mm_s = max((1e3 * feed.feed_of(text) for text in feeds), default=UNSTATED_MM_S)
    methods = {
        name: _sum_up([one for one in checked if one.method == name], joints, feed_mm_s)
        for name in dict.fromkeys(one.method for one in checked)
    }
    refuted = tuple(one for each in checked for one in each.refuted)
    seconds = time.perf_counter() - began
    depth, pair = max((each.deepest for each in parts.cells.values()), default=(0.0, ""))
    excluded = f"{pair}, {1e3 * depth:.3g} mm" if pair else None
    found = not refuted, methods, refuted, between, feed_mm_s, seconds, results.files, excluded
    lacking = [
        f"The plan lacks the seam {name!r}, which is not validated: {why}." for name, why in results.missing.items()
    ]
    bounds = (BOUNDS,) if has_hulls else ()
    return Validation(*found, (*lacking, *_unchecked(checked, parts.cells.values()), *bounds))


def validation_record(found: Validation) -> dict[str, Any]:
    """Return a validation as a mapping, the contents of validation.json."""
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
    """Write validation.json, and in a plan's folder the value "validated" in summary.json, atomically.

    An existing validation of the same results with more samples between the targets is kept, with a warning.

    Raises:
        InputError: If the folder cannot be written.
    """
    recorded = validation_record(found)
    if _is_stronger(folder / plan_folder.VALIDATION, recorded):
        warnings.warn(
            f"{folder / plan_folder.VALIDATION} is not overwritten: it validates the same results with more samples "
            f"than --between {found.between}",
            stacklevel=2,
        )
    else:
        output_files.write_json(folder / plan_folder.VALIDATION, recorded)
    summary = folder / plan_folder.SUMMARY
    if summary.exists():
        output_files.write_json(summary, files.read_json(summary, folder) | {"validated": found.validated})


def _is_stronger(file: Path, recorded: dict[str, Any]) -> bool:
    """Return True if `file` contains a validation of the same results with more samples between the targets.

    It must also have the same verdict and at least the keys of `recorded`, the new validation.
    """
    try:
        known = files.read_json(file, file.parent)
        same = all(known[key] == recorded[key] for key in ("files", "validated"))
        return same and known["between"] > recorded["between"] and _record_keys(known) >= _record_keys(recorded)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False  # the file is missing or damaged


def _record_keys(recorded: dict[str, Any]) -> set[str]:
    """Return the keys of a validation and of its methods, which depend on the version that wrote it."""
    return {*recorded, *(f"{method}.{key}" for method, check in recorded["methods"].items() for key in check)}


class LoadedParts:
    """Arms, workpieces and cells of tracks; each is loaded once."""

    def __init__(self, results: Results):
        self._results, self._arm = results, cache(_compiled)
        self._walls: dict[tuple, Wall] = {}
        self.cells: dict[tuple, MujocoCell] = {}

    def of(self, track: Track) -> tuple[MujocoArm, Wall, MujocoCell | None]:
        """Return the arm with its tool, the workpiece and the other obstacles of a track; None without obstacles.

        Raises:
            InputError: If a model cannot be read, or if the arm's number of joints differs from the saved plan's.
        """
        job, joints = track.config, track.x.shape[1]
        arm = self._arm(job.robot, job.tree)
        if len(arm.joints) != joints:
            found = f"the saved plan has {joints} joints, but the model has {len(arm.joints)}"
            raise InputError(f"{self._results.folder}: {found}")
        # One wall for several paths on it; the density of points on a mesh depends on the arm.
        key = build.walls_key(build.workpiece_key(job)), build.robot_key(job)
        if key not in self._walls:
            self._walls[key] = wall_of(job.workpiece, self._results.workpiece(job))
        return arm, self._walls[key], self._cell(job, arm)

    def _cell(self, job: config.PlanConfig, arm: MujocoArm) -> MujocoCell | None:
        cell, key = job.cell, (job.robot, job.tree, job.cell)
        if not (cell.self_collision or cell.model or cell.clouds or cell.obstacles):
            return None
        if key not in self.cells:
            plain = self._arm(job.robot.model_copy(update={"tool_extension_m": 0.0}), job.tree)
            self.cells[key] = MujocoCell(cell, arm, plain)
        return self.cells[key]


def _compiled(robot: config.RobotConfig, tree: model_source.ModelSource | None) -> MujocoArm:
    """Return the arm of a job, or of its cell."""
    source = tree or robot.file
    return MujocoArm(
        source,
        robot.tool_extension_m,
        robot.limits,
        tcp=robot.tcp or model_source.default_tcp(source),
        **({} if tree else {"base_m": robot.base_m, "base_rpy_rad": robot.base_rpy_rad}),
        tool=robot.tool,
        locked=dict(robot.locked),
        pieces=robot.bodies != "capsules",
    )


def _sum_up(checked: Sequence[TrackCheck], joints: Sequence[str], feed_mm_s: float) -> MethodCheck:
    """Return a method's results, combined from its tracks."""
    targets = [(one.scenario, target) for one in checked for target in one.target.tolist()]
    paths = [(one.scenario, target) for one in checked for target in one.leads_to.tolist()]
    checked_between = checked[0].touches is not None

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name) for one in checked])

    clearance = all_of("clearance")
    clearance_min, clearance_at = _worst(np.argmin, clearance, targets)
    tcp_error_max, tcp_error_at = _worst(np.argmax, all_of("tcp_error"), targets)
    between_min = between_at = deviation_max = deviation_at = None
    if checked_between:
        along = np.concatenate([clearance, all_of("clearance_between")])
        between_min, between_at = _worst(np.argmin, along, [*targets, *paths])
        proven = [place for place, is_claimed in zip(paths, all_of("claimed"), strict=True) if is_claimed]
        deviation_max, deviation_at = _worst(np.argmax, all_of("deviation")[all_of("claimed")], proven)
    less_cover = None
    if any(one.less_cover is not None for one in checked):
        each = [one.clearance if one.less_cover is None else one.less_cover for one in checked]
        less_cover, _ = _worst(np.argmin, np.concatenate(each), targets)
    ratio = all_of("speed") * feed_mm_s / 1e3
    path, joint = np.unravel_index(ratio.argmax(), ratio.shape) if ratio.any() else (None, None)
    return MethodCheck(
        checked=sum(one.tracked for one in checked),
        refuted=sum(len(one.refuted) for one in checked),
        tcp_error_max_mm=tcp_error_max,
        tcp_error_max_at=tcp_error_at,
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
    """Return the deviation with the largest ratio to its tolerance, for every row of the task."""
    found = dict[tuple[int, type], RowDeviation]()
    for one in checked:
        for row in one.rows if len(one.on_path) else ():
            if not row.unchecked:
                own = _row_deviation(one, row)
                found[row.key] = max(found.get(row.key, own), own, key=lambda each: each.off / each.most)
    return tuple(found[key] for key in sorted(found, key=lambda key: key[0]))


def _unchecked(checked: Sequence[TrackCheck], cells: Iterable[MujocoCell]) -> tuple[str, ...]:
    """Return sentences on obstacles without shapes, and on rows without an independent check."""
    obstacles = sorted({name for cell in cells for name in cell.unmeasured})
    lines = [f"The obstacle {name!r} is not measured: it has no shapes for MuJoCo." for name in obstacles]
    rows = {row.label for one in checked for row in one.rows if row.unchecked}
    return *lines, *(f"The row {row} is not validated: its kind defines no method deviation." for row in sorted(rows))


def _row_deviation(one: TrackCheck, row: RowCheck) -> RowDeviation:
    """Return the largest deviation from a row of the task in one track."""
    k = int(np.argmax(np.where(np.isinf(row.most), -1.0, row.off / row.most)))
    at = one.scenario, int(one.on_path[k])
    return RowDeviation(
        f"task.{row.number}: {row.row}", row.factor * float(row.off[k]), row.factor * float(row.most[k]), row.unit, at
    )


def _worst(
    which: Callable, values: np.ndarray, places: Sequence[TargetPlace]
) -> tuple[float | None, TargetPlace | None]:
    """Return the worst value, converted from m to mm, and its place; None and None without values.

    Args:
        which: Function that returns the index of the worst value: argmin or argmax.
        values: The values [m].
        places: The place of each value.
    """
    if not values.size:
        return None, None
    at = int(which(values))
    return 1e3 * float(values[at]), places[at]
