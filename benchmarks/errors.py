"""Proven errors of part, tool, joints and cloud, tested by draws in MuJoCo's geometry and by a search for collisions.

    python -m benchmarks errors [--draws N] [--sets N] [--only TEXT] [--job JOB.yaml MOTION.csv]...

Example jobs are planned, and further jobs with their motions may be given. For several sets of errors by seed, the
largest proven scale is computed by `htcp_jax.proving`. Then

- N errors (10,000) are drawn inside the proven set, half of them at corners, each with a place on the motion, half of
  the places near the decisive one. MuJoCo moves the arm; each point of the part and each body of the arm itself is
  compared with the bodies in NumPy. The number of collisions must be 0. Fixtures of the cell are not compared.
- The smallest scale at which a corner of the set collides is searched, at the places with the smallest scales, by
  descents from corner to corner on the distance that `htcp_jax` measures to the same capsules, pieces and points.

The exit code is 1 after a collision, or if the median of the second scale / the proven one is more than 1.5.
"""

import argparse
import json
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float

import htcp_jax
from htcp_jax.caching import cache_folder
from htcp_jax.clearance.obstacles.cloud import Cloud
from htcp_jax.clearance.obstacles.obstacles import minimum_clearance
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.clearance.proof.error_bound import ErrorSet
from htcp_jax.clearance.proof.error_scene import ErrorScene
from htcp_jax.io.motions import controller_of, read_motion
from htcp_jax.model import axis_angle_matrix
from htcp_jax.motion import Problem
from htcp_jax.proving import motion_curves, scene_of
from htcp_jax.proving.curves import JointCurves
from htcp_jax.proving.scaled_errors import ErrorScale, _bounded, _Open, error_scale, scene_with
from htcp_jax.proving.scene import ProofScene
from htcp_jax.proving.stated_errors import _tool_bodies, error_set
from htcp_jax.spec import ErrorsConfig
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.validate import _compiled

JOBS = "duct", "cone", "pipe", "palletizer"
SEED, MOST_RATIO, INSIDE = 5, 1.5, 0.9999
ROWS, TOP, CORNERS, PASSES = 64, 6, 6, 4
TOUCHES_M = 1e-9


class Case(NamedTuple):
    """A motion in a job's scene."""

    name: str
    scene: ProofScene
    curves: JointCurves

    @property
    def problem(self) -> Problem:
        """The problem of the scene."""
        return self.scene.problem


class Draw(NamedTuple):
    """n errors: displacements as matrices, joint errors and growth of points."""

    part: Float[np.ndarray, "n 4 4"]  # world
    tool: Float[np.ndarray, "n 4 4"]  # in the frame of the tool's errors
    joints: Float[np.ndarray, "n N"]  # [rad or m]
    grows_m: Float[np.ndarray, "n"]


def main() -> int:
    """Test the sets of all jobs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=10_000, help="number of draws in each set")
    parser.add_argument("--sets", type=int, default=20, help="number of sets")
    parser.add_argument("--only", default="", help="only example jobs whose name contains this")
    parser.add_argument("--plans", type=Path, help="folder that keeps the motions of example jobs for the next run")
    parser.add_argument("--job", nargs=2, action="append", default=[], help="a further job, and its motion")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    cache_folder.enable()
    with TemporaryDirectory() as folder:
        kept = chosen.plans or Path(folder)
        cases = [planned(name, kept / name) for name in JOBS if chosen.only in name]
    cases += [case_of(job, Path(motion)) for job, motion in chosen.job]
    ratios, collisions = [], 0
    for number in range(chosen.sets):
        case = cases[number % len(cases)]
        found = tested(
            case,
            stated(case.problem.robot.dof, number // len(cases) + 2 * number, SEED + number),
            chosen.draws,
            SEED + number,
        )
        print(json.dumps({"set": number, "job": case.name, **found}), flush=True)
        ratios.append(found["ratio"])
        collisions += found["collisions"]
    median = float(np.median(ratios))
    print(json.dumps({"sets": chosen.sets, "collisions": collisions, "median_ratio": round(median, 3)}))
    return int(collisions > 0 or median > MOST_RATIO)


def planned(name: str, folder: Path) -> Case:
    """Plan an example job into a folder, unless a motion is there, and return its motion as a case."""
    motion = folder / "motion.csv"
    if not motion.exists():
        folder.mkdir(parents=True, exist_ok=True)
        htcp_jax.plan(name).write(folder)
    return case_of(name, motion)


def case_of(job: Any, motion: Path) -> Case:
    """Return the motion in a file as a case."""
    scene = scene_of(job)
    controller = controller_of(scene.job, scene.problem.robot, of_model=True)
    found = read_motion(motion, scene.problem.robot, controller)
    return Case(str(job), scene, motion_curves(scene.problem, found))


def stated(dof: int, kind: int, seed: int) -> ErrorsConfig:
    """Return half-widths by seed: of the part's shift, of the part, of part and tool, of tool and joints, or of all."""
    draw = np.random.default_rng(seed)
    size = lambda most: (most * draw.uniform(0.1, 1, 3)).tolist()  # noqa: E731
    part = {"shift_m": size(1e-3), "turn_rad": size(1e-3)}
    tool = {"shift_m": size(1e-3), "turn_rad": size(3e-3)}
    joints = (5e-4 * draw.uniform(0.1, 1, dof)).tolist()
    every = {"part": part, "tool": tool, "joints_rad": joints, "cloud_m": 2e-4}
    chosen = [{"part": {"shift_m": part["shift_m"]}}, {"part": part}, {"part": part, "tool": tool}]
    chosen += [{"tool": tool, "joints_rad": joints}, every]
    return ErrorsConfig.model_validate(chosen[kind % len(chosen)])


def tested(case: Case, errors: ErrorsConfig, draws: int, seed: int) -> dict[str, Any]:
    """Return the proven scale of a set, the collisions in it, and the scale at which a search finds the first one."""
    numbers, began = error_set(case.problem, case.scene.job, errors), time.perf_counter()
    found = error_scale(case.problem, case.curves, numbers)
    seconds = time.perf_counter() - began
    draw, x = inside(case, numbers, found, draws, seed)
    hits = collisions(case, numbers, draw, x)
    first = first_collision(case, numbers, found, seed)
    return {
        "errors": list(errors.model_dump(exclude_defaults=True)),
        "scale": round(found.scale, 5),
        "first_collision": round(first, 5),
        "ratio": round(first / max(found.scale, 1e-12), 4),
        "draws": draws,
        "collisions": int(hits.sum()),
        "seconds": round(seconds, 2),
        "intervals": found.intervals,
    }


def signs(count: int, size: int, seed: int) -> Float[np.ndarray, "n s"]:
    """Return numbers from -1 to 1 in rows, every second row at a corner."""
    found = np.random.default_rng(seed).uniform(-1, 1, (count, size))
    found[::2] = np.where(found[::2] < 0, -1.0, 1.0)
    return found


def draw_of(errors: ErrorSet, units: Float[np.ndarray, "n s"]) -> Draw:
    """Return errors from rows of 12 + N + 1 shares of the half-widths, from -1 to 1."""
    dof = len(errors.joints)
    part = displacements(units[:, :3] * errors.part_shift_m, units[:, 3:6] * errors.part_turn_rad, errors.part_about_m)
    tool = displacements(units[:, 6:9] * errors.tool_shift_m, units[:, 9:12] * errors.tool_turn_rad, np.zeros(3))
    return Draw(part, tool, units[:, 12 : 12 + dof] * errors.joints, np.abs(units[:, -1]) * errors.cloud_m)


def displacements(shift, turn, about) -> Float[np.ndarray, "n 4 4"]:
    """Return rotations by vectors [rad] about a point [m], followed by shifts [m]."""
    T = np.tile(np.eye(4), (len(shift), 1, 1))
    T[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
    T[:, :3, 3] = about + shift - T[:, :3, :3] @ about
    return T


def inside(case: Case, errors: ErrorSet, found: ErrorScale, count: int, seed: int):
    """Return errors inside the proven set, and a configuration of the motion for each."""
    draw = np.random.default_rng(seed + 1)
    row, s = draw.integers(0, len(case.curves.segment), count), draw.uniform(0, 1, count)
    if found.segment is not None:
        near = draw.uniform(0, 1, count) < 0.5
        own = np.flatnonzero(case.curves.segment == found.segment)
        row[near] = own[draw.integers(0, len(own), near.sum())]
        s[near] = np.clip(found.place + 0.05 * draw.normal(size=near.sum()), 0, 1)
    units = INSIDE * found.scale * signs(count, 13 + len(errors.joints), seed)
    return draw_of(errors, units), configurations(case.curves, row, s)


def configurations(curves: JointCurves, row, s) -> Float[np.ndarray, "n N"]:
    """Return configurations at places on paths."""
    return np.einsum("nc,ncj->nj", s[:, None] ** np.arange(curves.coefficients.shape[1]), curves.coefficients[row])


def collisions(case: Case, errors: ErrorSet, draw: Draw, x: Float[np.ndarray, "n N"]) -> Bool[np.ndarray, "n"]:
    """Return True for errors with which a body touches the part or another body, by MuJoCo's kinematics."""
    job, problem = case.scene.job, case.problem
    arm: MujocoArm = _compiled(job.robot, job.tree)
    robot = scene_with(problem, errors).robot
    count = len(arm.names)
    assert robot.capsule_names[:count] == arm.names
    poses = arm.arm_poses(x + draw.joints)
    ends, axes = np.stack([poses.p, poses.q], axis=2), poses.axes
    origin, rotation = arm.frames(x + draw.joints, "tcp")
    T = np.tile(np.eye(4), (len(x), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation, origin
    frame = T @ np.linalg.inv(np.asarray(robot.T_link_tcp)) @ errors.T_link_tool
    moved = frame @ draw.tool @ np.linalg.inv(frame)
    tool = np.flatnonzero(errors.is_tool[:count])
    ends[:, tool] = np.einsum("nij,nkej->nkei", moved[:, :3, :3], ends[:, tool]) + moved[:, None, None, :3, 3]
    axes[:, tool] = np.einsum("nij,nkjl->nkil", moved[:, :3, :3], axes[:, tool])
    hit = np.zeros(len(x), bool)
    for each in problem.obstacles:
        if isinstance(each, Cloud):
            hit |= _touches_part(arm, problem, each, draw, ends, axes)
        if isinstance(each, SelfCollision):
            for a, b in each.pairs:
                if max(a, b) < count and arm.hulls[a] is None and arm.hulls[b] is None:
                    apart = _between_axes(ends[:, a], ends[:, b])
                    hit |= apart <= arm.radius[a] + arm.radius[b]
    return hit


def _touches_part(arm: MujocoArm, problem: Problem, cloud: Cloud, draw: Draw, ends, axes) -> Bool[np.ndarray, "n"]:
    T = np.asarray(problem.scenarios.T_world_workpiece[0])
    points = np.asarray(cloud.points)[: cloud.count] @ T[:3, :3].T + T[:3, 3]
    tree, back = scipy.spatial.cKDTree(points), np.linalg.inv(draw.part)
    ends = np.einsum("nij,nkej->nkei", back[:, :3, :3], ends) + back[:, None, None, :3, 3]
    axes, hit = np.einsum("nij,nkjl->nkil", back[:, :3, :3], axes), np.zeros(len(ends), bool)
    near_to = arm.beside_workpiece().radius
    for k in np.flatnonzero(near_to > 0):
        p, q = ends[:, k, 0], ends[:, k, 1]
        within = near_to[k] + float(cloud.cover) + draw.grows_m
        length = arm.length[k]
        steps = int(np.ceil(2 * length / near_to[k])) + 1
        far = tree.query(0.5 * (p + q))[0] > 0.5 * length + within
        rows = np.flatnonzero(~far & ~hit)
        share = np.concatenate([[0.0, 1.0], (np.arange(steps) + 0.5) / steps])
        sampled = p[rows, None] + share[:, None] * (q - p)[rows, None]
        reach = np.broadcast_to(np.hypot(within, length / (2 * steps))[rows, None], sampled.shape[:2])
        found = tree.query_ball_point(sampled.reshape(-1, 3), reach.reshape(-1), return_sorted=False)
        counts = np.fromiter(map(len, found), int, len(found))
        row, point = (
            np.repeat(np.repeat(rows, len(share)), counts),
            points[np.fromiter(chain(*found), int, counts.sum())],
        )
        near = np.linalg.norm(_project(ends[row, k], point) - point, axis=1) <= within[row]
        row, point = row[near], point[near]
        if (hull := arm.hulls[k]) is None:
            hit[row] = True
            continue
        for n in np.unique(row).tolist():
            local = (point[row == n] - 0.5 * (p[n] + q[n])) @ axes[n, k]
            cover = float(cloud.cover + draw.grows_m[n])
            hit[n] = hull.clearance(local[:, None], cover) <= cover
    return hit


def _between_axes(a: Float[np.ndarray, "n 2 3"], b: Float[np.ndarray, "n 2 3"]) -> Float[np.ndarray, "n"]:
    """Return the distances of segments [m], by alternating projections from nine starts."""
    least = np.full(len(a), np.inf)
    for start in np.linspace(0, 1, 9):
        on = a[:, 0] + start * (a[:, 1] - a[:, 0])
        for _ in range(20):
            other = _project(b, on)
            on = _project(a, other)
        least = np.minimum(least, np.linalg.norm(on - _project(b, on), axis=1))
    return least


def _project(axis: Float[np.ndarray, "n 2 3"], point: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    d = axis[:, 1] - axis[:, 0]
    along = np.einsum("ni,ni->n", point - axis[:, 0], d) / np.maximum(np.einsum("ni,ni->n", d, d), 1e-300)
    return axis[:, 0] + np.clip(along, 0, 1)[:, None] * d


def distances(case: Case, errors: ErrorSet) -> Callable:
    """Return a function of configurations and errors (as shares of the half-widths) that measures clearances [m]."""
    batch = _MEASURES.setdefault(id(case.problem), _measure_of(scene_with(case.problem, errors)))

    def measured(x: Float[np.ndarray, "n N"], units: Float[np.ndarray, "n s"]) -> Float[np.ndarray, "n"]:
        parts = []
        for first in range(0, len(x), ROWS):
            own = [np.resize(each[first : first + ROWS], (ROWS, each.shape[1])) for each in (x, units)]
            parts.append(np.asarray(batch(*own, jax.tree.map(jnp.asarray, errors)))[: len(x) - first])
        return np.concatenate(parts)

    return measured


_MEASURES: dict[int, Callable] = {}  # by problem, compiled once for all sets


def _measure_of(scene: ErrorScene) -> Callable:
    """Return the compiled function of configurations, shares of the half-widths, and errors.

    Convex pieces are not moved, so that the tool must have none.
    """
    assert not (_tool_bodies(scene.robot) & scene.has_piece).any()

    def about(shift, turn, centre):
        angle = jnp.sqrt(jnp.sum(turn * turn) + 1e-30)
        R = axis_angle_matrix((turn / angle)[None], angle[None])[0]
        return R, centre + shift - R @ centre

    def measure(x, units, errors):
        robot, where, dof = scene.robot, jax.tree.map(jnp.asarray, scene.where), len(errors.joints)
        R, t = about(units[:3] * errors.part_shift_m, units[3:6] * errors.part_turn_rad, errors.part_about_m)
        T = where.T_world_workpiece
        T = jnp.asarray(T).at[:3, :3].set(R @ T[:3, :3]).at[:3, 3].set(R @ T[:3, 3] + t)
        plane = jnp.asarray(where.interior_plane)
        normal = R @ plane[:3]
        plane = jnp.append(normal, plane[3] + jnp.where(jnp.isfinite(plane[3]), normal @ t, 0.0))
        R, t = about(units[6:9] * errors.tool_shift_m, units[9:12] * errors.tool_turn_rad, jnp.zeros(3))
        F = errors.T_link_tool[:3, :3]
        R = F @ R @ F.T
        t = errors.T_link_tool[:3, 3] + F @ t - R @ errors.T_link_tool[:3, 3]
        tool = errors.is_tool[:, None]
        ends = [jnp.where(tool, end @ R.T + t[None], end) for end in (robot.capsule_p, robot.capsule_q)]
        robot = replace(robot, capsule_p=ends[0], capsule_q=ends[1])
        where = replace(where, T_world_workpiece=T, interior_plane=plane)
        grows = jnp.abs(units[-1]) * errors.cloud_m
        obstacles = [replace(o, cover=o.cover + grows) if isinstance(o, Cloud) else o for o in scene.obstacles]
        return minimum_clearance(robot, tuple(obstacles), where, x + units[12 : 12 + dof] * errors.joints)

    return jax.jit(jax.vmap(measure, in_axes=(0, 0, None)))


def first_collision(case: Case, errors: ErrorSet, found: ErrorScale, seed: int) -> float:
    """Return the smallest scale at which a search finds a collision."""
    measure = distances(case, errors)
    x = _places(case, errors, found, seed)
    active = _active(errors)
    units = np.repeat(signs(2 * CORNERS, 13 + len(errors.joints), seed)[::2][None], len(x), axis=0)
    places = np.repeat(np.arange(len(x)), CORNERS)
    corner, level = units.reshape(len(places), -1), 1.1 * found.scale
    best = measure(x[places], level * corner)
    for _ in range(PASSES):
        changed = False
        for k in active:
            other = corner.copy()
            other[:, k] *= -1
            new = measure(x[places], level * other)
            better = new < best
            corner[better], best = other[better], np.minimum(best, new)
            changed |= bool(better.any())
        if not changed:
            break
    low, high = np.full(len(places), found.scale), np.full(len(places), 4.0 * found.scale)
    high[measure(x[places], high[:, None] * corner) > 0] = np.inf
    for _ in range(14):
        middle = np.where(np.isfinite(high), 0.5 * (low + high), low)
        is_hit = measure(x[places], middle[:, None] * corner) <= 0
        low, high = np.where(is_hit, low, middle), np.where(is_hit, middle, high)
    return float(high.min())


def _active(errors: ErrorSet) -> list[int]:
    sizes = np.concatenate([*errors[:2], *errors[3:5], errors.joints, [errors.cloud_m]])
    return np.flatnonzero(sizes[:-1] > 0).tolist()


def _places(case: Case, errors: ErrorSet, found: ErrorScale, seed: int) -> Float[np.ndarray, "n N"]:
    """Return the configurations of the motion with the smallest scales, and the decisive one."""
    curves, draw = case.curves, np.random.default_rng(seed)
    row, s = np.tile(np.arange(len(curves.segment)), 3), np.repeat([0.0, 0.5, 1.0], len(curves.segment))
    if found.segment is not None:
        own = np.flatnonzero(curves.segment == found.segment)
        row = np.concatenate([row, np.repeat(own, 32)])
        s = np.concatenate([s, np.tile(np.clip(found.place + 0.02 * draw.normal(size=32), 0, 1), len(own))])
    scene, rows = scene_with(case.problem, errors), _Open(row, s, np.zeros(len(s)))
    scale = _bounded(scene, curves, rows, 0.0, 2 * found.scale)[0]
    chosen = np.argsort(scale, kind="stable")[:TOP]
    return configurations(curves, row[chosen], s[chosen])
