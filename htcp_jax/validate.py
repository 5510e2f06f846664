"""The independent check of results: MuJoCo's kinematics and distances, and nothing of the planner's.

    found = validate("out/workpiece")
    found.validated                       # whether every tracked configuration stands as recorded
    found.methods["hybrid"].clearance_min_mm

At the targets every tracked configuration must reach its target, be clear, keep the joint limits, and have the
clearance, TCP and target on record; one that does not is refuted. Between the targets the straight joint path is walked
in small steps. What is found there refutes nothing, because no target is there: it is counted and told.
"""

import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import scipy

from htcp_jax.errors import InputError
from htcp_jax.results import write_json
from htcp_jax.robot import GP50
from htcp_jax.validate_arm import Arm
from htcp_jax.validate_input import SUMMARY, Results, Track, read_results
from htcp_jax.validate_track import Checked, Refuted, check
from htcp_jax.validate_wall import Wall

VALIDATION = "validation.json"
TOLD = 100  # refuted configurations that are told one by one


class MethodCheck(NamedTuple):
    """What was found for one method; None where there was nothing to measure."""

    checked: int  # tracked targets
    refuted: int
    tcp_error_max_mm: float | None  # |site - target|
    clearance_min_mm: float | None
    clearance_off_max_mm: float | None  # |MuJoCo's - recorded|, so are the next two
    tcp_off_max_mm: float | None
    target_off_max_mm: float | None
    paths: int  # straight joint paths between consecutive tracked targets, and from the start to the first
    paths_touching: int | None  # of them; None where nothing was looked at between the targets
    paths_blocked_on_record: int
    clearance_between_min_mm: float | None  # along the paths, targets included
    line_deviation_max_mm: float | None  # of the TCP from the straight line between two targets
    speed_ratio_max: float | None  # joint speed by its limit at the feed rate; None where the model has no limits
    speed_joint: str | None  # whose it is
    speed_at: tuple[int, int] | None  # scenario and target that the path leads to
    in_place_max_rad: float | None  # largest joint change between targets closer than the tolerance, for which the
    # feed rate leaves no time; among them the one from the start to the first target


class Validation(NamedTuple):
    """The result of `validate`."""

    validated: bool
    methods: dict[str, MethodCheck]
    refuted: tuple[Refuted, ...]
    between: int
    feed_mm_s: float
    seconds: float
    files: dict[str, str]  # SHA-256 of what was validated


def validate(
    folder: str | Path,
    *,
    between: int = 20,
    feed_mm_s: float = 10.0,
    progress: Callable[[int, int], None] | None = None,
) -> Validation:
    """Check the run or the plan in `folder`.

    between: steps of each joint path, 0 to look at the targets alone. feed_mm_s: speed of the TCP along the straight
    lines between the targets. progress: called with the tracks checked and their number.
    Raises InputError for a folder that holds no results, for damaged ones, and for numbers out of range.
    """
    if between < 0:
        raise InputError(f"between is {between}; it must be 0 or more")
    if not 0 < feed_mm_s < np.inf:
        raise InputError(f"the feed rate is {feed_mm_s:g} mm/s; it must be positive")
    began = time.perf_counter()
    results = read_results(Path(folder))
    wall = Wall(next(iter(results.workpieces.values())).cloud, results.config.workpiece.interior)
    arms: dict[float, Arm] = {}
    checked = []
    for track in results.tracks:
        checked.append(check(results, _arm(arms, results, track), wall, track, between))
        if progress is not None:
            progress(len(checked), results.count)
    joints = next(iter(arms.values())).joints
    methods = {
        name: _sum_up([one for one in checked if one.method == name], joints, feed_mm_s)
        for name in dict.fromkeys(one.method for one in checked)
    }
    refuted = tuple(one for each in checked for one in each.refuted)
    seconds = time.perf_counter() - began
    return Validation(not refuted, methods, refuted, between, feed_mm_s, seconds, results.files)


def record(found: Validation) -> dict[str, Any]:
    """A validation as JSON has it."""
    refuted = [one._asdict() for one in found.refuted[:TOLD]]
    versions = {"mujoco": mujoco.__version__, "scipy": scipy.__version__, "numpy": np.__version__}
    return {
        **found._asdict(),
        "refuted_count": len(found.refuted),
        "refuted": refuted,
        "methods": {name: check._asdict() for name, check in found.methods.items()},
        "versions": versions,
    }


def write_validation(folder: Path, found: Validation) -> None:
    """validation.json, and in the folder of a plan "validated" in summary.json; aside, then moved into place.
    Raises InputError when the folder cannot be written."""
    _replace(folder / VALIDATION, record(found))
    summary = folder / SUMMARY
    if summary.exists():
        _replace(summary, json.loads(summary.read_text(encoding="utf-8")) | {"validated": found.validated})


def _replace(file: Path, content: dict) -> None:
    part = file.with_name(f".{file.name}.part")
    try:
        write_json(part, content)
        os.replace(part, file)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"cannot write to {file.parent}: {error.strerror}") from None


def _arm(arms: dict[float, Arm], results: Results, track: Track) -> Arm:
    """The arm with the track's tool; each is compiled once."""
    robot, extension = results.config.robot, track.pose.tool_extension_m
    if extension not in arms:
        arms[extension] = Arm(GP50 if robot.model == "gp50" else Path(robot.model), extension, robot.limits)
    arm = arms[extension]
    if len(arm.joints) != track.x.shape[1]:
        raise InputError(f"{results.folder}: {track.x.shape[1]} joints on record, {len(arm.joints)} in the model")
    return arm


def _sum_up(checked: Sequence[Checked], joints: Sequence[str], feed_mm_s: float) -> MethodCheck:
    """One method's tracks together."""

    def most(name: str, factor: float = 1e3) -> float | None:
        parts = [getattr(one, name) for one in checked if getattr(one, name) is not None]
        found = np.concatenate(parts) if parts else np.empty(0)
        return factor * float(found.max()) if found.size else None

    clearance = np.concatenate([one.clearance for one in checked])
    walked = [one for one in checked if one.touches is not None]
    least = [*clearance, *(one.clearance_between for one in checked)]
    speed = np.concatenate([one.speed for one in checked])
    ratio = speed * feed_mm_s / 1e3
    where = [(one.scenario, target) for one in checked for target in one.leads_to.tolist()]
    path, joint = np.unravel_index(ratio.argmax(), ratio.shape) if ratio.any() else (None, None)
    return MethodCheck(
        checked=sum(one.tracked for one in checked),
        refuted=sum(len(one.refuted) for one in checked),
        tcp_error_max_mm=most("tcp_error"),
        clearance_min_mm=1e3 * float(clearance.min()) if clearance.size else None,
        clearance_off_max_mm=most("clearance_off"),
        tcp_off_max_mm=most("tcp_off"),
        target_off_max_mm=most("target_off"),
        paths=len(where),
        paths_touching=sum(int(one.touches.sum()) for one in walked) if walked else None,
        paths_blocked_on_record=sum(one.blocked for one in checked),
        clearance_between_min_mm=1e3 * float(min(least)) if walked and least else None,
        line_deviation_max_mm=most("deviation"),
        speed_ratio_max=None if path is None else float(ratio[path, joint]),
        speed_joint=None if path is None else joints[joint],
        speed_at=None if path is None else where[path],
        in_place_max_rad=most("in_place", 1.0),
    )
