"""ROS messages trajectory_msgs/JointTrajectory in YAML and JSON, of ROS 1 and ROS 2.

ros2_controllers' joint_trajectory_controller interpolates linearly between points with positions only, by cubic splines
if both points have velocities, and by quintic splines if they also have accelerations (its documentation, Trajectory
Representation).
"""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.motions.source import Rows, Source, listed
from htcp_jax.spec import parse_mapping
from htcp_jax.system import one_line

INSIDE = ("joint_trajectory", "trajectory", "message", "msg", "goal")  # keys of messages that contain the trajectory
TRAJECTORY = {"header", "joint_names", "points"}
ABOUT = {"type", "about", "header", "model_id"}  # without effect on the motion
STATES = "positions", "velocities", "accelerations"
POINT = {*STATES, "effort", "time_from_start"}
DURATION = ("sec", "nanosec"), ("secs", "nsecs")  # of ROS 2 and of ROS 1
MOST_YAML = 8 * 2**20  # maximum size of YAML that is not written as one list per line [bytes]
MOST_VALUES = 50_000_000
LIST_LINE = re.compile(r"\s*(- )?\s*(positions|velocities|accelerations|effort): \[([^\[\]{}#\"']*)\]\s*")
TIME_LINE = re.compile(r"\s*(- )?\s*time_from_start: \{(?:sec: (\d+), nanosec: (\d+)|secs: (\d+), nsecs: (\d+))\}\s*")
FROM_HERE = "The motion to the first configuration is not in the file."


class _Point(NamedTuple):
    line: int
    states: tuple[Sequence[Any] | None, ...]  # positions, velocities, accelerations
    effort: bool
    time: Any


def read_ros_yaml(source: Source) -> Rows:
    """Return the points of a message in YAML.

    Raises:
        InputError: See `_rows`; also for invalid YAML.
    """
    text = _one_document(source)
    fast = _fast_points(source, text)
    if fast is not None:
        return _rows(source, *fast, "line")
    if len(source.data) > MOST_YAML:
        raise InputError(
            f"{source.file}: {len(source.data):,} bytes of YAML; at most {MOST_YAML:,}, or one list of numbers per "
            "line, or JSON"
        )
    document, notes = _trajectory(source, parse_mapping(text, str(source.file)))
    return _rows(source, document, _points(source, document, notes), notes, "point")


def read_ros_json(source: Source) -> Rows:
    """Return the points of a message in JSON.

    Raises:
        InputError: See `_rows`; also for invalid JSON.
    """
    if source.data.count(b",") > MOST_VALUES:
        raise InputError(f"{source.file}: more than {MOST_VALUES:,} values")
    try:
        raw = json.loads(source.text, object_pairs_hook=lambda pairs: _without_repeats(pairs))
    except RecursionError:
        raise InputError(f"{source.file}: nested too deeply") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{source.file}, line {error.lineno}: not JSON ({error.msg})") from None
    except ValueError as error:
        raise InputError(f"{source.file}: not JSON ({one_line(error)})") from None
    document, notes = _trajectory(source, raw)
    return _rows(source, document, _points(source, document, notes), notes, "point")


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"the key {next(name for name in names if names.count(name) > 1)!r} is repeated")
    return found


def _one_document(source: Source) -> str:
    """Return the text of the file's only document; `ros2 topic echo` ends it with ---."""
    lines = source.text.splitlines()
    while lines and not lines[-1].strip("- \t"):
        lines.pop()
    breaks = [k for k, line in enumerate(lines) if line.rstrip() == "---" and any(_is_content(x) for x in lines[:k])]
    if breaks:
        source.fail(breaks[0] + 1, "a second message begins; valid: one JointTrajectory per file")
    return "\n".join(lines) + "\n"


def _is_content(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith(("#", "%")) and line.rstrip() != "---"


def _fast_points(source: Source, text: str) -> tuple[Mapping[str, Any], list[_Point], list[str]] | None:
    """Return the trajectory and the points of a file with one list per line, as this package writes it; else None."""
    head, found, body = text.partition("\npoints:\n")
    if not found or "_" in body.replace("time_from_start", ""):
        return None
    points: list[dict[str, Any]] = []
    for number, line in enumerate(body.splitlines(), start=head.count("\n") + 3):
        if not line.strip():
            continue
        if (lists := LIST_LINE.fullmatch(line)) is not None:
            begins, name, inside = lists.groups()
            try:
                value: Any = [float(cell) for cell in inside.split(",")] if inside.strip() else []
            except ValueError:
                return None
        elif (time := TIME_LINE.fullmatch(line)) is not None:
            begins, *numbers = time.groups()
            name = "time_from_start"
            sec, nanosec = (int(each) for each in numbers if each is not None)
            value = {"sec": sec, "nanosec": nanosec}
        else:
            return None
        if begins:
            points.append({"line": number})
        if not points or name in points[-1]:
            return None
        points[-1][name] = value
    document, notes = _trajectory(source, parse_mapping(head + "\npoints: []\n", str(source.file)))
    return document, [_point(point["line"], point) for point in points], notes


def _trajectory(source: Source, raw: Any) -> tuple[Mapping[str, Any], list[str]]:
    """Return the mapping with `points`, and notes about what is not used."""
    notes: list[str] = []
    for _ in range(5):
        if isinstance(raw, list) and len(raw) == 1:
            raw = raw[0]
        if not isinstance(raw, dict):
            break
        if "points" in raw:
            if unused := [str(key) for key in raw if key not in TRAJECTORY]:
                notes.append(f"Keys that are not used: {listed(unused)}.")
            return raw, notes
        inner = next((key for key in INSIDE if key in raw), None)
        if inner is None:
            break
        multi = raw.get("multi_dof_joint_trajectory")
        if isinstance(multi, dict) and multi.get("points"):
            raise InputError(f"{source.file}: multi_dof_joint_trajectory has points; only joint_trajectory can be read")
        others = [str(key) for key in raw if key not in ABOUT | {inner, "multi_dof_joint_trajectory"}]
        if others:
            notes.append(f"Keys that are not used: {listed(others)}.")
        raw = raw[inner]
    raise InputError(
        f"{source.file}: no JointTrajectory; valid: joint_names and points, or these below {listed(INSIDE)}"
    )


def _points(source: Source, document: Mapping[str, Any], notes: list[str]) -> list[_Point]:
    points, unused = document["points"], set()
    if not isinstance(points, list):
        raise InputError(f"{source.file}: points must be a list")
    for number, point in enumerate(points, start=1):
        if not isinstance(point, dict):
            source.fail_at(f"point {number}", "it must be a mapping with positions")
        unused |= point.keys() - POINT
    if unused:
        notes.append(f"Keys of points that are not used: {listed(sorted(map(str, unused)))}.")
    return [_point(number, point) for number, point in enumerate(points, start=1)]


def _point(line: int, point: Mapping[str, Any]) -> _Point:
    return _Point(
        line, tuple(point.get(key) for key in STATES), bool(point.get("effort")), point.get("time_from_start")
    )


def _rows(source: Source, document: Mapping[str, Any], points: list[_Point], notes: list[str], counted: str) -> Rows:
    """Return the rows of points.

    Raises:
        InputError: For missing names, points with a wrong number of values, values that are not numbers, and
            velocities, accelerations or times in some points only.
    """
    source.check_unit("a JointTrajectory", "rad")
    names = document.get("joint_names")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(f"{source.file}: joint_names must be a list of the joints' names")
    arrays = [_states(source, points, names, k, counted) for k in range(len(STATES))]
    if any(point.effort for point in points):
        notes.append("The efforts are not used.")
    if arrays[1] is None and arrays[2] is not None:
        notes.append("Accelerations without velocities are not used: the controller interpolates linearly.")
        arrays[2] = None
    time_s = _times(source, points, counted)
    if short := [str(p.line) for p in points if isinstance(p.time, dict) and len(p.time) < len(DURATION)]:
        notes.append(f"Parts of time_from_start that are missing are 0: {counted} {listed(short)}.")
    if time_s is None and arrays[1] is not None:
        source.fail_at(f"{counted} {points[0].line}", "velocities without time_from_start cannot be interpolated")
    default = "linear" if arrays[1] is None else "cubic" if arrays[2] is None else "quintic"
    about = f"JointTrajectory: {default} between points, as joint_trajectory_controller interpolates them."
    return Rows(
        source.renamed(names),
        arrays[0] if arrays[0] is not None else np.zeros((0, len(names))),
        np.array([point.line for point in points], int),
        time_s=time_s,
        velocity=arrays[1],
        acceleration=arrays[2],
        interpolation=default,
        notes=(about, FROM_HERE, *notes),
        counted=counted,
    )


def _states(source: Source, points: list[_Point], names: list[str], k: int, counted: str) -> np.ndarray | None:
    rows = [point.states[k] for point in points]
    with_values = [bool(row) for row in rows]
    if not any(with_values):
        if k == 0 and points:
            source.fail_at(f"{counted} {points[0].line}", "it has no positions")
        return None
    for point, row in zip(points, rows, strict=True):
        place = f"{counted} {point.line}"
        if not row:
            source.fail_at(place, f"it has no {STATES[k]}, which other points have")
        if not isinstance(row, list) or any(type(value) not in (int, float) for value in row):
            source.fail_at(place, f"{STATES[k]} must be a list of numbers")
        if len(row) != len(names):
            source.fail_at(place, f"{STATES[k]} has {len(row)} values for {len(names)} joints: {listed(names)}")
    try:
        return np.array(rows, float)
    except OverflowError:
        raise InputError(f"{source.file}: {STATES[k]} contain a number that is too large") from None


def _times(source: Source, points: list[_Point], counted: str) -> np.ndarray | None:
    if all(point.time is None for point in points):
        return None
    found = []
    for point in points:
        time = point.time
        if type(time) in (int, float):
            found.append(float(time))
            continue
        keys = next((keys for keys in DURATION if isinstance(time, dict) and time and time.keys() <= {*keys}), ())
        parts = [time.get(key, 0) for key in keys]
        if not parts or any(type(part) is not int for part in parts):
            place = f"{counted} {point.line}"
            source.fail_at(place, "time_from_start must be a number of seconds, {sec, nanosec} or {secs, nsecs}")
        sec, nanosec = parts
        found.append(sec + 1e-9 * nanosec)
    return np.array(found)
