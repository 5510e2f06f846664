"""Check of a track, one method's results for one scenario: at its targets, and along the joint paths between them."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.robots import indexed_joints
from htcp_jax.runs import of_job
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell
from htcp_jax.validation.mujoco_clearance import CheckedScene, TargetClearances, Wall
from htcp_jax.validation.result import RECORD_M, ROUNDING_M, STEP_RAD, Refutation
from htcp_jax.validation.scene_rules import Results, Track, part_pose, targets_of
from htcp_jax.validation.task_check import PartPose as RowPlace
from htcp_jax.validation.task_check import (
    RowCheck,
    check_rows,
    follows_all,
    hold_between,
    holds_tcp,
    joined_rows,
    part_between,
    path_follower,
    tasks_at,
)

SAMPLES = 2000  # number of samples on joint paths that are checked together


class JointPaths(NamedTuple):
    """The m straight joint paths that form the segments of a track."""

    target: Int[np.ndarray, "m"]  # target at the end of the segment
    row: Int[np.ndarray, "m"]  # row of the measured configuration at the start of the segment
    a: Float[np.ndarray, "m N"]
    b: Float[np.ndarray, "m N"]
    line_a: Float[np.ndarray, "m 3"]  # start of the line that the TCP must follow; in a dwell it is equal to the end
    line_b: Float[np.ndarray, "m 3"]
    span: Float[np.ndarray, "m 2"]  # both ends of the joint path, as shares of the line from the previous target


class TrackCheck(NamedTuple):
    """Results of a track at its n tracked targets with a saved configuration, and along the m joint paths to them."""

    method: str
    scenario: int
    tracked: int  # number of targets saved as tracked
    blocked: int  # number of joint paths to tracked targets that are saved as blocked
    target: Int[np.ndarray, "n"]
    tcp_error: Float[np.ndarray, "n"]
    clearance: Float[np.ndarray, "n"]
    less_cover: Float[np.ndarray, "n"] | None  # clearance minus the mesh's covering radius [m]; None for a cloud
    clearance_off: Float[np.ndarray, "n"]
    tcp_off: Float[np.ndarray, "n"]
    target_off: Float[np.ndarray, "n"]
    refuted: list[Refutation]
    leads_to: Int[np.ndarray, "m"]  # target at the end of the segment
    claimed: Bool[np.ndarray, "m"]  # segments that the plan states to be motions on the path, see `Track.claimed`
    touches: Bool[np.ndarray, "m"] | None
    clearance_between: (
        Float[np.ndarray, "m"] | None
    )  # minimum [m]; inf if it is larger than at all targets and margin_m
    deviation: Float[np.ndarray, "m"] | None
    speed: Float[np.ndarray, "m N"]  # joint speed / limit at a feed rate of 1 m/s; 0 if targets coincide
    in_place: Float[np.ndarray, "m"]  # largest joint change if targets coincide [rad or m]
    on_path: Int[np.ndarray, "k"]  # those of the targets that are on the path
    rows: list[RowCheck]  # checks of the task's rows at the targets `on_path`; empty if the job has no task


def check(
    results: Results,
    arm: MujocoArm,
    wall: Wall,
    surroundings: MujocoCell | None,
    track: Track,
    between: int,
    only_claimed: bool = False,
    step_rad: float = STEP_RAD,
    progress: Callable[[float], None] = lambda share: None,
) -> TrackCheck:
    """Return the check of a track at its targets and along its joint paths.

    Args:
        results: The results to which the track belongs.
        arm: The arm, with the track's tool.
        wall: The workpiece.
        surroundings: Obstacles other than the workpiece; None if there are none.
        track: The track.
        between: Minimum number of steps per joint path; 0: joint paths are not checked.
        only_claimed: True to sample only the segments that are `Track.claimed`.
        step_rad: Maximum joint step between two samples [rad or m].
        progress: Function that is called with the share of the samples on joint paths that is checked, below 1.

    Raises:
        InputError: If the number of saved targets differs from the configuration's.
    """
    scene, targets, on_path = scene_of(results, arm, wall, surroundings, track)
    begins = on_path + np.array(results.workpiece(track.config).seam_begins, int)
    follows = (np.arange(len(targets)) > on_path) & ~np.isin(np.arange(len(targets)), begins)
    settings, t = track.config.settings, np.flatnonzero(track.tracked)
    rows = np.concatenate([track.start[None], track.x[t]])  # the start is row 0
    mesh, hulls = wall.triangles is not None, any(arm.hulls)
    cover_m = results.workpiece(track.config).cover_m if mesh else 0.0
    at = scene.at(rows, _required(track, t), cover_m)
    more = at.clearance[1:] - track.clearance[t]
    # A saved clearance may be smaller by the covering radius, or because it is a lower bound.
    bound = mesh or hulls or (surroundings is not None and surroundings.bound)
    found = {
        "tcp_error": _path_errors(results, arm, track, targets, t, on_path, at.arm_poses.tcp[1:]),
        "clearance": at.clearance[1:],
        "clearance_off": np.abs(np.minimum(more, 0.0) if bound else more),
        "tcp_off": np.linalg.norm(at.arm_poses.tcp[1:] - track.tcp[t], axis=1),
        "target_off": np.linalg.norm(targets[t] - track.target[t], axis=1),
    }
    tolerance, contact = settings.tolerance_m, track.config.workpiece.tip_contact_m
    through = np.zeros(len(t), bool)
    if mesh and contact is not None and len(t):
        through = scene.tip_crosses(ArmPoses(*(values[1:] for values in at.arm_poses)), contact)
    paths = _paths(track, rows, targets, t)
    moved, line = np.abs(paths.b - paths.a), paths.line_b - paths.line_a
    speed, in_place = _speed(arm, moved, np.linalg.norm(line, axis=1), tolerance)
    if track.config.home_rad is not None:
        in_place[paths.target == 0] = 0.0  # the motion to the first target begins at home
    between_seams = np.isin(paths.target, begins)
    in_place[between_seams], speed[between_seams] = 0.0, 0.0
    sampled = track.claimed[paths.target] if only_claimed else np.ones(len(paths.target), bool)
    least_m = _segment_margins(track, len(targets), begins)
    least = max(0.0, float(at.clearance.min()), float(least_m.max()))
    recorded_m = np.where(track.proven & np.isfinite(track.segment_clearance), track.segment_clearance, -np.inf)
    between_rows = _check_paths(scene, at, paths, sampled, between, step_rad, follows, least, recorded_m, progress)
    on, record_m = t[t >= on_path], ROUNDING_M if bound and not hulls else RECORD_M
    rows_hold = _check_task_rows(results, arm, track, scene, on, on_path)
    reasons = (
        *_at_targets(arm, track, t, tolerance, record_m, {**found, "through": through}),
        *_on_start(arm, track, at.clearance[0]),
        *_on_via_points(arm, track, paths),
        *_on_segments(track, paths, between_rows, follows, least_m, _tcp_is_held(results, track, on_path)),
        *_on_joint_steps(arm, track, paths, follows),
        *_on_indexed_axes(arm, track, paths, follows),
        *_on_rows(rows_hold, on),
        *_on_rows_between(results, arm, track, scene, paths, between, on_path, follows),
    )
    return TrackCheck(
        method=track.method,
        scenario=track.scenario,
        tracked=int(track.tracked.sum()),
        blocked=int((track.tracked & track.blocked).sum()),
        target=t,
        **found,
        less_cover=at.less_cover(cover_m)[1:] if mesh else None,
        refuted=[Refutation(track.method, track.scenario, *each) for each in reasons],
        leads_to=paths.target,
        claimed=track.claimed[paths.target],
        **between_rows,
        speed=speed,
        in_place=in_place,
        on_path=on,
        rows=rows_hold,
    )


def _path_errors(
    results: Results,
    arm: MujocoArm,
    track: Track,
    targets: Float[np.ndarray, "T 3"],
    t: Int[np.ndarray, "n"],
    on_path: int,
    tcp: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n"]:
    """Return the distance of the point that follows the path from targets t [m]; 0 where it may be elsewhere.

    Args:
        results: The results.
        arm: The arm, with the track's tool.
        track: The track.
        targets: All targets, world [m].
        t: Indices of targets.
        on_path: Index of the path's first point.
        tcp: Positions of the TCP at the targets t, world [m].
    """
    found = np.zeros(len(t))
    for rows, which in tasks_at(track.config, results.workpiece(track.config), np.maximum(t - on_path, 0)):
        if follows_all(rows):
            reached = path_follower(rows, arm, track.x[t[which]]) if rows else tcp[which]
            found[which] = np.linalg.norm(reached - targets[t[which]], axis=1)
    return found


def _tcp_is_held(results: Results, track: Track, on_path: int) -> Bool[np.ndarray, "T"]:
    """Return True for targets at which a row of the task holds the TCP on the path."""
    count = len(track.target)
    found = np.zeros(count, bool)
    point = np.maximum(np.arange(count) - on_path, 0)
    for rows, which in tasks_at(track.config, results.workpiece(track.config), point):
        found[which] = holds_tcp(rows)
    return found


def _segment_margins(track: Track, count: int, begins: Int[np.ndarray, "_"]) -> Float[np.ndarray, "T"]:
    """Return the required clearance on the segment of the path to each of `count` targets [m]."""
    job = track.config
    if job.margin_on != "segments" or all(seam.margin_m is None for seam in job.workpiece.seams):
        return np.full(count, job.segment_margin_m)
    each = [job.margin_m if seam.margin_m is None else seam.margin_m for seam in job.workpiece.seams]
    return np.array(each)[np.searchsorted(begins, np.arange(count), "right")]


def required_m(track: Track) -> float:
    """Return the smallest saved clearance of a track [m], at least 0."""
    saved = track.clearance[track.tracked]
    return max(0.0, float(saved.min()) - ROUNDING_M) if len(saved) else 0.0


def _required(track: Track, t: np.ndarray) -> np.ndarray:
    """Return the saved clearances at targets t, preceded by the smallest one (for the start), each at least 0 [m]."""
    return np.append(required_m(track), np.maximum(0.0, track.clearance[t] - ROUNDING_M))


def scene_of(
    results: Results, arm: MujocoArm, wall: Wall, surroundings: MujocoCell | None, track: Track
) -> tuple[CheckedScene, Float[np.ndarray, "T 3"], int]:
    """Return a track's arm in its surroundings, and its targets.

    Args:
        results: The results to which the track belongs.
        arm: The arm, with the track's tool.
        wall: The workpiece.
        surroundings: The other obstacles; None if there are none.
        track: The track.

    Returns:
        The scene, the targets, world [m], and the index of the path's first point among them.

    Raises:
        InputError: If the number of saved targets differs from the configuration's.
    """
    part, pose, workpiece = track.config.workpiece, of_job(track.config), results.workpiece(track.config)
    rotate, translate = part_pose(part, pose)
    inlet = None if workpiece.inlet is None else rotate @ workpiece.inlet + translate
    start = track.start if track.config.start is None else np.array(track.config.start)
    path = workpiece.path @ rotate.T + translate
    targets = targets_of(track.config, path_follower(track.config.tasks[0], arm, start[None])[0], inlet, path)
    if len(targets) != len(track.target):
        raise InputError(
            f"{results.folder}: scenario {track.scenario} has {len(track.target)} saved targets, "
            f"{len(targets)} by its configuration"
        )
    on_path = len(targets) - len(path)
    if (np.abs(track.target[1:on_path] - path[0]) < RECORD_M).all():  # the approach deviates from straight lines
        targets[1:on_path] = path[0]
    others = () if surroundings is None else (surroundings.distances, surroundings.carried, surroundings.by_hulls)
    own = arm.beside_workpiece()
    return CheckedScene(own, wall, rotate, translate, part.interior_depth_m, *others), targets, on_path


def _at_targets(
    arm: MujocoArm, track: Track, t: np.ndarray, tolerance_m: float, record_m: float, found: dict[str, np.ndarray]
) -> list[tuple[int, str]]:
    """Return the refuted targets, each with the reason; so do the functions below."""
    reasons = {}
    for k, target in enumerate(t.tolist()):
        own = {name: float(values[k]) for name, values in found.items()}
        reasons[target] = _failure_reasons(
            arm, tolerance_m, record_m, track.x[target], float(track.clearance[target]), own
        )
    return [(k, "; ".join(found)) for k, found in reasons.items() if found]


def _check_task_rows(
    results: Results, arm: MujocoArm, track: Track, scene: CheckedScene, t: np.ndarray, on_path: int
) -> list[RowCheck]:
    """Return the checks of the rows of the tasks at targets t of the path; empty if the job has no task.

    Without a task, the only requirement is the TCP's position, which `check` tests.
    """
    job, part, settings = track.config, results.workpiece(track.config), track.config.settings
    if not job.task_rows:
        return []
    found, tolerances = [], (settings.tolerance_m, settings.tolerance_rad)
    for task, which in tasks_at(job, part, t - on_path):
        place = RowPlace(scene.rotate, scene.translate, part, t[which] - on_path)
        found.append((check_rows(task, arm, track.x[t[which]], place, *tolerances), which))
    return joined_rows(found, len(t))


def _on_rows(rows: list[RowCheck], t: np.ndarray) -> Iterator[tuple[int, str]]:
    """Yield the targets in t at which a row of the task is violated."""
    for k, target in enumerate(t.tolist()):
        if reasons := [reason for one in rows if (reason := one.reason(k)) is not None]:
            yield target, "; ".join(reasons)


def _on_rows_between(
    results: Results,
    arm: MujocoArm,
    track: Track,
    scene: CheckedScene,
    paths: JointPaths,
    between: int,
    on_path: int,
    follows: Bool[np.ndarray, "T"],
) -> Iterator[tuple[int, str]]:
    """Yield the targets of proven segments along the path on which a row of the task is violated."""
    own = np.flatnonzero((track.proven & follows)[paths.target])
    if not track.config.task_rows or between < 2 or not len(own):
        return
    share = np.arange(1, between) / between
    path = np.repeat(own, len(share))
    x = paths.a[path] + np.tile(share, len(own))[:, None] * (paths.b[path] - paths.a[path])
    part, found = results.workpiece(track.config), dict[int, str]()
    for rows, which in tasks_at(track.config, part, paths.target[path] - on_path):
        here = np.unique(path[which])
        row, span = paths.target[here] - on_path, paths.span[here]
        places = [part_between(rows, scene.rotate, scene.translate, part, row, span[:, k]) for k in (0, 1)]
        places = [place._replace(point=place.point[np.searchsorted(here, path[which])]) for place in places]
        good, target = hold_between(rows, arm, x[which], *places, track.config.settings), paths.target[path[which]]
        for each in np.unique(target[~good.all(axis=0)]).tolist():
            number = int(np.argmin(good[:, target == each].all(axis=1)))
            what = f"task.{number + 1} ({rows[number]})"
            found[each] = f"the segment is recorded as valid, but violates {what}"
    yield from sorted(found.items())


def _failure_reasons(
    arm: MujocoArm, tolerance_m: float, record_m: float, x: np.ndarray, recorded: float, found: dict[str, float]
) -> list[str]:
    """Return the reasons why a configuration fails, as sentences."""
    reasons = []
    if not found["tcp_error"] <= tolerance_m + ROUNDING_M:  # also for NaN, as in all comparisons below
        reasons.append(f"the TCP is {1e3 * found['tcp_error']:.3f} mm from its target")
    if not found["clearance"] > -ROUNDING_M:
        reasons.append(f"the arm is in collision: clearance {1e3 * found['clearance']:.3f} mm")
    reasons += [f"{arm.joints[j]} is outside its limits at {x[j]:.6g}" for j in _beyond_limits(arm, x[None])]
    if found["through"]:
        reasons.append("the tool's tip passes through the wall")
    if not found["clearance_off"] <= record_m:
        reasons.append(f"its clearance is {1e3 * found['clearance']:.3f} mm, {1e3 * recorded:.3f} mm was saved")
    for name in ("tcp", "target"):
        if not found[f"{name}_off"] <= RECORD_M:
            reasons.append(f"the saved {name} is wrong by {1e3 * found[f'{name}_off']:.3f} mm")
    return reasons


def _paths(track: Track, rows: np.ndarray, targets: np.ndarray, t: np.ndarray) -> JointPaths:
    """Return the joint paths to those of the targets t whose previous target, or the start, has a configuration."""
    parts = []
    for k in np.flatnonzero(t == np.concatenate([[-1], t[:-1]])[: len(t)] + 1).tolist():
        x = np.concatenate([rows[k][None], track.via_points[t[k]], rows[k + 1][None]])
        count, to, before = len(x) - 1, targets[t[k]], targets[max(t[k] - 1, 0)]
        share = np.array([0.0, *track.via_shares[t[k]], 1.0])  # equal shares: the arm changes its configuration
        line = before + share[:, None] * (to - before)
        line[-1] = to
        span = np.stack([share[:-1], share[1:]], axis=1)
        parts.append((np.full(count, t[k]), np.full(count, k), x[:-1], x[1:], line[:-1], line[1:], span))
    if not parts:
        none, joints = np.zeros(0, int), np.zeros((0, rows.shape[1]))
        return JointPaths(none, none, joints, joints, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
    return JointPaths(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _beyond_limits(arm: MujocoArm, x: np.ndarray) -> np.ndarray:
    """Return the indices of the joints that are outside their limits in one of the configurations x (n, N)."""
    within = (x >= arm.lower - ROUNDING_M) & (x <= arm.upper + ROUNDING_M)
    return np.flatnonzero(~within.all(axis=0))


def _on_start(arm: MujocoArm, track: Track, clearance: float) -> Iterator[tuple[int, str]]:
    """Yield target 0 if it is tracked, but the start is outside the joint limits or collides."""
    if not track.tracked[:1].any():
        return
    for j in _beyond_limits(arm, track.start[None])[:1].tolist():
        yield 0, f"{arm.joints[j]} is outside its limits at the start"
    if not clearance > -ROUNDING_M:
        yield 0, f"the start is in collision: clearance {1e3 * clearance:.3f} mm"


def _on_via_points(arm: MujocoArm, track: Track, paths: JointPaths) -> Iterator[tuple[int, str]]:
    """Yield the targets of segments with a via point outside the joint limits, or with via points that go back."""
    for target in np.unique(paths.target).tolist():
        x, share = track.via_points[target], np.concatenate([[0.0], track.via_shares[target], [1.0]])
        for j in _beyond_limits(arm, x)[:1].tolist():
            yield target, f"{arm.joints[j]} is outside its limits at a via point"
        if not (np.diff(share) >= 0).all():
            yield target, "the shares of its via points do not increase from 0 to 1"


def _on_segments(
    track: Track,
    paths: JointPaths,
    found: dict[str, Any],
    follows: Bool[np.ndarray, "T"],
    margin_m: Float[np.ndarray, "T"],
    is_held: Bool[np.ndarray, "T"],
) -> list[tuple[int, str]]:
    """Return the targets of segments that are saved as proven motions, but collide, leave the path or lack the margin.

    A clearance on the path may be RECORD_M less than the margin.
    """
    if found["touches"] is None:
        return []
    proven, reasons = track.proven[paths.target], {}
    settings = track.config.settings
    away = is_held[paths.target] & proven & ~(found["deviation"] <= settings.tube_m + ROUNDING_M)
    for k in np.flatnonzero(track.claimed[paths.target] & found["touches"]).tolist():
        what = "is recorded as valid" if proven[k] else "has via points"
        reasons.setdefault(int(paths.target[k]), f"the segment {what}, but collides")
    guaranteed = track.segment_clearance[paths.target]
    for k in np.flatnonzero(proven & ~(found["clearance_between"] >= guaranteed - RECORD_M)).tolist():
        short = f"{1e3 * found['clearance_between'][k]:.3f} mm on the segment, {1e3 * guaranteed[k]:.3f} mm"
        reasons.setdefault(int(paths.target[k]), f"the clearance is {short} are recorded as guaranteed")
    least_m, near_m = margin_m[paths.target], found["clearance_between"]
    near = (least_m > 0) & proven & follows[paths.target] & ~(near_m >= least_m - RECORD_M)
    for k in np.flatnonzero(near).tolist():
        nearest = f"{1e3 * near_m[k]:.3f} mm, less than margin_m"
        reasons.setdefault(int(paths.target[k]), f"the segment is recorded as valid, but has a clearance of {nearest}")
    for k in np.flatnonzero(away).tolist():
        off = f"{1e3 * found['deviation'][k]:.3f} mm"
        reasons.setdefault(int(paths.target[k]), f"the segment is recorded as valid, but leaves its path by {off}")
    return sorted(reasons.items())


def _on_joint_steps(
    arm: MujocoArm, track: Track, paths: JointPaths, follows: Bool[np.ndarray, "T"]
) -> Iterator[tuple[int, str]]:
    """Yield the targets of segments along the path on which a joint travels farther than the job allows."""
    if (most := track.config.settings.max_joint_step_rad) is None:
        return
    travel = np.zeros(track.x.shape)
    np.add.at(travel, paths.target, np.abs(paths.b - paths.a))
    excess = travel - np.asarray(most)
    for target in np.flatnonzero(~(excess <= ROUNDING_M).all(axis=1)).tolist():
        if follows[target]:
            joint = int(excess[target].argmax())
            travelled = f"{travel[target, joint]:.6g} on the segment, more than the job allows"
            yield target, f"{arm.joints[joint]} travels {travelled}"


def _on_indexed_axes(
    arm: MujocoArm, track: Track, paths: JointPaths, follows: Bool[np.ndarray, "T"]
) -> Iterator[tuple[int, str]]:
    """Yield the targets of segments along the path on which an indexed axis moves at all."""
    config = track.config
    named = indexed_joints(config.robot.indexed, config.tree or config.robot.file)
    joints = [j for j, name in enumerate(arm.joints) if name in named]
    if not joints:
        return
    moved = (paths.a != paths.b)[:, joints] & follows[paths.target, None]
    for target in np.unique(paths.target[moved.any(axis=1)]).tolist():
        joint = joints[int(moved[paths.target == target].any(axis=0).argmax())]
        yield target, f"{arm.joints[joint]} moves on the segment, but is an indexed axis"


def _check_paths(
    scene: CheckedScene,
    at: TargetClearances,
    paths: JointPaths,
    sampled: Bool[np.ndarray, "m"],
    between: int,
    step_rad: float,
    follows: Bool[np.ndarray, "T"],
    least_m: float,
    recorded_m: Float[np.ndarray, "T"],
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Return collision, minimum clearance and path deviation of each sampled joint path, as fields of `TrackCheck`.

    A clearance is inf if it is larger than `least_m`. Hulls are measured where capsules have less than `recorded_m`.
    The path deviation is the TCP's distance from its line; it is 0 for targets where `follows` is False: up to the
    path's first point, and between seams.
    """
    if not between:
        return dict.fromkeys(("touches", "clearance_between", "deviation"))
    count = len(paths.target)
    least, deviation = np.full(count, np.inf), np.zeros(count)
    recorded = recorded_m[paths.target]
    every_path, every_x = samples_between(paths.a[sampled], paths.b[sampled], between, step_rad)
    via = np.flatnonzero(sampled & np.append(np.diff(paths.target) == 0, np.zeros(min(count, 1), bool)))
    every_path = np.concatenate([np.flatnonzero(sampled)[every_path], via])
    every_x = np.concatenate([every_x, paths.b[via]])
    for first in range(0, len(every_path), SAMPLES):
        progress(first / len(every_path))
        path, x = every_path[first : first + SAMPLES], every_x[first : first + SAMPLES]
        arm_poses, clearance = scene.between(x, paths.row[path], at, least_m, recorded[path])
        np.minimum.at(least, path, clearance)
        off = np.where(
            follows[paths.target[path]], from_line(arm_poses.tcp, paths.line_a[path], paths.line_b[path]), 0.0
        )
        np.maximum.at(deviation, path, off)
    return {"touches": ~(least > 0), "clearance_between": least, "deviation": deviation}


def samples_between(
    a: Float[np.ndarray, "m N"], b: Float[np.ndarray, "m N"], between: int, step_rad: float = STEP_RAD
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n N"]]:
    """Return samples inside straight joint paths; no joint moves by more than `step_rad` per step.

    Args:
        a: Starts of the paths [rad or m].
        b: Ends of the paths [rad or m].
        between: Minimum number of steps on a path with different ends.
        step_rad: Maximum joint step [rad or m].

    Returns:
        For every sample, the index of its path, and its configuration.
    """
    move = b - a
    furthest = abs(move).max(axis=1, initial=0.0)
    steps = np.where(furthest > 0, np.maximum(between, np.ceil(furthest / step_rad)), 1).astype(int)
    path, fraction = _sampled_fractions(steps)
    return path, a[path] + fraction[:, None] * move[path]


def _sampled_fractions(steps: Int[np.ndarray, "m"]) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Return path and fraction (0 to 1) of each point between two steps, for paths with `steps` steps."""
    path = np.repeat(np.arange(len(steps)), steps - 1)
    before = np.cumsum(steps - 1) - (steps - 1)
    return path, (np.arange(len(path)) - before[path] + 1) / steps[path]


def from_line(
    points: Float[np.ndarray, "n 3"], a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Return the distance of each point from its line segment a b [m].

    Args:
        points: The points [m].
        a: Starts of the lines [m].
        b: Ends of the lines [m].
    """
    along = b - a
    square = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    fraction = np.clip(((points - a) * along).sum(axis=1) / square, 0.0, 1.0)
    return np.linalg.norm(points - a - fraction[:, None] * along, axis=1)


def _speed(arm: MujocoArm, moved: np.ndarray, length: np.ndarray, tolerance_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the fields `speed` and `in_place` of `TrackCheck`.

    Targets closer than the tolerance count as coincident, as the feed rate leaves no time for joint motion between
    them.

    Args:
        arm: The arm.
        moved: Joint changes (m, N) [rad or m].
        length: Lengths of the TCP's lines (m,) [m].
        tolerance_m: Tolerance of the TCP's position [m].
    """
    apart = length > tolerance_m
    speed = np.divide(moved / arm.speed, length[:, None], out=np.zeros(moved.shape), where=apart[:, None])
    return speed, np.where(apart, 0.0, moved.max(axis=1, initial=0.0))
