"""Independent check of configurations at the waypoints of a public problem, by its rules.

The code is independent of the planner: poses are products of matrices (`path_problems.poses`), distances between
capsules and boxes are MuJoCo's.
"""

from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from benchmarks.path_problems import PathProblem, poses

STEP = np.deg2rad(7.0), 0.02  # largest step of a hinge and of a slide [rad, m], CppFlow's rule
DT_S = 1 / 30  # of IKLink's rule
SLACK = 1e-9  # [m or rad]; larger than rounding errors
FAR_M = 10.0
_CAPSULE, _BOX = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX


class Verdicts(NamedTuple):
    """Results for T configurations."""

    position_m: Float[np.ndarray, "T"]  # errors
    rotation_rad: Float[np.ndarray, "T"]
    clearance_m: Float[np.ndarray, "T"]  # minimum over all pairs
    inside: Bool[np.ndarray, "T"]  # within the joint limits
    steps: Float[np.ndarray, "T1 N"]  # between consecutive ones, of hinges modulo a turn [rad or m]
    good: Bool[np.ndarray, "T"]  # waypoints at which all rules hold
    calm: Bool[np.ndarray, "T1"]  # steps that are not larger than STEP
    reconfigurations: int  # steps that exceed a joint's speed limit, by IKLink's rule
    length: float  # of the path of hinges [rad], the sum of |dx|
    slide_m: float  # the same of slides

    @property
    def valid(self) -> bool:
        """True if the complete path is valid by CppFlow's rules."""
        return bool(self.good.all() and self.calm.all())


def check(problem: PathProblem, x: Float[np.ndarray, "T N"]) -> Verdicts:
    """Check configurations at the waypoints, in order [rad or m]; NaN where there is none."""
    arm = problem.arm
    there = np.isfinite(x).all(axis=1)
    T = poses(arm, np.where(there[:, None], x, 0.0))
    tip = T[arm.tip]
    position = np.linalg.norm(tip[:, :3, 3] - problem.position, axis=1)
    turned = Rotation.from_matrix(np.swapaxes(tip[:, :3, :3], 1, 2) @ problem.rotation).magnitude()
    lower, upper = (np.array([getattr(joint, side) for joint in arm.moving]) for side in ("lower", "upper"))
    slides = np.array([joint.slides for joint in arm.moving])
    inside = ((x >= lower - SLACK) & (x <= upper + SLACK)).all(axis=1)
    clear = clearance(problem, T)
    steps = np.diff(x, axis=0)
    steps = np.where(slides, steps, (steps + np.pi) % (2 * np.pi) - np.pi)
    speed = np.array([joint.speed for joint in arm.moving])
    good = there & inside & (clear > 0)
    good &= (position <= problem.tolerance[0] + SLACK) & (turned <= problem.tolerance[1] + SLACK)
    calm = (np.abs(steps) <= np.where(slides, STEP[1], STEP[0]) + SLACK).all(axis=1)
    fast = (np.abs(steps) > speed * DT_S + SLACK).any(axis=1)
    length = float(np.nansum(np.linalg.norm(steps[:, ~slides], axis=1)))
    return Verdicts(
        position, turned, clear, inside, steps, good, calm, int(fast.sum()), length,
        float(np.nansum(np.abs(steps[:, slides]))),
    )  # fmt: skip


def clearance(problem: PathProblem, T: dict[str, Float[np.ndarray, "T 4 4"]]) -> Float[np.ndarray, "T"]:
    """Minimum distance of the checked pairs for some poses of the links [m]."""
    arm, boxes = problem.arm, problem.boxes
    spec = mujoco.MjSpec()
    for link, numbers in arm.capsules.items():
        half = max(np.linalg.norm(numbers[3:6] - numbers[:3]) / 2, 1e-9)
        spec.worldbody.add_geom(name=link, type=_CAPSULE, size=[numbers[6], half, 0])
    for k, box in enumerate(boxes):
        quaternion = Rotation.from_euler("xyz", box[3:6]).as_quat(scalar_first=True)
        spec.worldbody.add_geom(name=f"box {k}", type=_BOX, pos=box[:3], quat=quaternion, size=box[6:] / 2)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    pairs = [(model.geom(a).id, model.geom(b).id) for a, b in _checked(problem)]
    own = {model.geom(link).id: _ends(numbers, T[link]) for link, numbers in arm.capsules.items()}
    least, turn = np.full(len(T[arm.tip]), np.inf), np.empty(4)
    for t in range(len(least)):
        for geom, (p, q) in own.items():
            data.geom_xpos[geom] = (p[t] + q[t]) / 2
            length = np.linalg.norm(q[t] - p[t])
            mujoco.mju_quatZ2Vec(turn, (q[t] - p[t]) / length if length > 0 else np.array([0, 0, 1.0]))
            mujoco.mju_quat2Mat(data.geom_xmat[geom], turn)
        least[t] = min(mujoco.mj_geomDistance(model, data, a, b, FAR_M, None) for a, b in pairs)
    return least


def _ends(numbers: Float[np.ndarray, "7"], T: Float[np.ndarray, "T 4 4"]) -> tuple[np.ndarray, np.ndarray]:
    return tuple(T[:, :3, :3] @ end + T[:, :3, 3] for end in (numbers[:3], numbers[3:6]))


def _checked(problem: PathProblem) -> list[tuple[str, str]]:
    """Names of the pairs that must not touch: links, except neighbours and ignored pairs, and links with boxes."""
    arm = problem.arm
    links = [
        (a, b)
        for a, b in combinations(arm.capsules, 2)
        if frozenset((a, b)) not in arm.ignored and arm.parents.get(a) != b and arm.parents.get(b) != a
    ]
    return links + [(link, f"box {k}") for link in arm.capsules for k in range(len(problem.boxes))]


# Reachability


def reachable(problem: PathProblem) -> Bool[np.ndarray, "T"]:
    """Mask of the waypoints for which a configuration within the joint limits is found, without collision checks.

    The search is damped least squares (Sugihara, Solvability-unconcerned inverse kinematics, 2011) from STARTS random
    configurations each.
    """
    arm, rng, count = problem.arm, np.random.default_rng(0), len(problem.position)
    lower, upper = (np.array([getattr(joint, side) for joint in arm.moving]) for side in ("lower", "upper"))
    ends = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    found = np.zeros(count, bool)
    for _ in range(STARTS):
        left = np.flatnonzero(~found)
        x = rng.uniform(*ends, (len(left), len(lower)))
        for _ in range(NEWTON):
            error, slopes = _error(problem, x, left)
            damping = (DAMPING * (error * error).sum(axis=1) + 1e-12)[:, None, None]
            step = np.linalg.solve(slopes @ np.swapaxes(slopes, 1, 2) + damping * np.eye(6), error[:, :, None])
            x = np.clip(x + (np.swapaxes(slopes, 1, 2) @ step)[:, :, 0], lower, upper)
        error, _ = _error(problem, x, left)
        near = np.linalg.norm(error[:, :3], axis=1) <= problem.tolerance[0]
        found[left[near & (np.linalg.norm(error[:, 3:], axis=1) <= problem.tolerance[1])]] = True
    return found


STARTS, NEWTON, DAMPING = 100, 100, 0.1


def _error(problem: PathProblem, x: Float[np.ndarray, "n N"], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors from the tip to its waypoints, translation and rotation vector in the world, and the tip's Jacobian."""
    arm = problem.arm
    T = poses(arm, x)
    tip = T[arm.tip]
    turn = Rotation.from_matrix(problem.rotation[rows] @ np.swapaxes(tip[:, :3, :3], 1, 2)).as_rotvec()
    columns = []
    for joint in arm.moving:
        axis = (T[joint.child][:, :3, :3] @ joint.axis) / np.linalg.norm(joint.axis)
        arms = np.cross(axis, tip[:, :3, 3] - T[joint.child][:, :3, 3])
        columns.append(np.hstack([axis, 0 * axis] if joint.slides else [arms, axis]))
    return np.hstack([problem.position[rows] - tip[:, :3, 3], turn]), np.stack(columns, axis=2)
