"""Planners that `peers` compares with htcp_jax, in plain user code: one scenario, one target after the other.

Each is a function of a `Task` that returns its `Advance`.
"""

from collections.abc import Callable
from typing import NamedTuple

import clarabel
import jax
import mujoco
import numpy as np
from scipy import sparse
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from htcp_jax.jobs.grid import Batch
from htcp_jax.spec import GP50

SAMPLE_M = 0.02  # between samples of a capsule's axis


class Near(NamedTuple):
    """An arm and its K capsules at one configuration; world, [m]."""

    tcp: np.ndarray  # (3,)
    jacobian: np.ndarray  # (3, N), of the TCP
    clearance: np.ndarray  # (K,)
    gradient: np.ndarray  # (K, N)
    witness: np.ndarray  # (K, 3): the nearest points of the cloud


class Task:
    """Scenario in plain user code: MuJoCo, numpy, and a tree of the cloud."""

    def __init__(self, batch: Batch, tree: cKDTree, number: int):
        part, scenario = batch.workpiece, jax.tree.map(lambda leaf: leaf[number], batch.scenarios)
        self.start, self.targets = scenario.x_start, scenario.targets[: scenario.count]
        self.margin, self.settings = float(scenario.margin_m), batch.points[number].config.settings
        self.rotate, self.translate = scenario.T_world_workpiece[:3, :3], scenario.T_world_workpiece[:3, 3]
        self.interior_plane = scenario.interior_plane
        self.hull_normal, self.hull_offset = part.hull_normal, part.hull_offset
        self.lower, self.upper = np.asarray(batch.robot.lower), np.asarray(batch.robot.upper)
        self.tree, self.cloud = tree, part.cloud
        self.model = mujoco.MjModel.from_xml_path(str(GP50))
        self.data = mujoco.MjData(self.model)
        self.radius = self.model.geom_size[:, 0]
        self.half = np.where(self.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE, self.model.geom_size[:, 1], 0.0)
        samples = [np.linspace(-1, 1, 1 if half == 0 else int(np.ceil(2 * half / SAMPLE_M)) + 1) for half in self.half]
        self.samples = [s if len(s) > 1 else np.zeros(1) for s in samples]
        self.x, self.known = None, None

    def near(self, x: np.ndarray) -> Near:
        """Measure a configuration; the last result is cached."""
        if self.x is None or not np.array_equal(x, self.x):
            self.x, self.known = x.copy(), self._measure(x)
        return self.known

    def reached(self, x: np.ndarray, target: np.ndarray) -> bool:
        """True if the TCP is on the target and the arm is clear."""
        near = self.near(x)
        return np.linalg.norm(near.tcp - target) <= self.settings.tolerance_m and near.clearance.min() > 0

    def _measure(self, x: np.ndarray) -> Near:
        self.data.qpos[:] = x
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        jacobian = np.empty((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, 0)
        bodies = [self._capsule(k) for k in range(self.model.ngeom)]
        clearance, gradient, witness = (np.array(column) for column in zip(*bodies, strict=True))
        return Near(self.data.site_xpos[0].copy(), jacobian, clearance, gradient, witness)

    def _capsule(self, k: int) -> tuple[float, np.ndarray, np.ndarray]:
        """Clearance of capsule k, its gradient, and the nearest point."""
        axis = self.half[k] * self.data.geom_xmat[k, 2::3]
        middle, axis = self._local(self.data.geom_xpos[k]), axis @ self.rotate
        samples = middle + self.samples[k][:, None] * axis
        distance, _ = self.tree.query(samples)
        # The nearest point projects at right angles onto the axis, or onto one of its ends, which is a sample.
        apart = 0.5 * np.linalg.norm(samples[1] - samples[0]) if len(samples) > 1 else 0.0
        reach = np.hypot(distance.min(), apart) + 1e-9
        near = samples[distance**2 <= reach**2 + apart**2]
        points = self.cloud[np.unique(np.concatenate(self.tree.query_ball_point(near, reach)).astype(int))]
        along = (points - middle) @ axis / max(axis @ axis, 1e-300)
        on_axis = middle + np.clip(along, -1, 1)[:, None] * axis
        apart = np.linalg.norm(on_axis - points, axis=1)
        best = apart.argmin()
        clearance, at = apart[best] - self.radius[k], on_axis[best]
        normal = (at - points[best]) / apart[best]
        witness = self.rotate @ points[best] + self.translate
        for end in (middle - axis, middle + axis):  # beyond the interior plane they must be in the hull
            beyond = self.interior_plane[:3] @ (self.rotate @ end + self.translate) > self.interior_plane[3]
            if beyond and len(self.hull_offset):
                height = self.hull_normal @ end - self.hull_offset
                facet = height.argmax()
                if height[facet] > max(0.0, -clearance):
                    clearance, at, normal = -height[facet], end, -self.hull_normal[facet]
        motion = np.empty((3, self.model.nv))
        where = self.rotate @ at + self.translate
        mujoco.mj_jac(self.model, self.data, motion, None, where, self.model.geom_bodyid[k])
        return clearance, (self.rotate @ normal) @ motion, witness

    def _local(self, point: np.ndarray) -> np.ndarray:
        return (point - self.translate) @ self.rotate


Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]  # from x_{t-1} and target t to x_t, valid or not


def step_qps(task: Task) -> Advance:
    """Step QPs (9) with one row per capsule, up to 20 per target, each with a new Clarabel solver."""
    n, cost = len(task.start), sparse.csc_matrix(np.diag(2 * np.array(task.settings.q_weights)))
    quiet = clarabel.DefaultSettings()
    quiet.verbose = False

    def advance(x: np.ndarray, target: np.ndarray) -> np.ndarray:
        for _ in range(task.settings.max_step_qps):
            near = task.near(x)
            rows = sparse.csc_matrix(np.vstack([near.jacobian, -near.gradient, np.eye(n), -np.eye(n)]))
            bounds = np.concatenate([target - near.tcp, near.clearance - task.margin, task.upper - x, x - task.lower])
            cones = [clarabel.ZeroConeT(3), clarabel.NonnegativeConeT(len(bounds) - 3)]
            found = clarabel.DefaultSolver(cost, np.zeros(n), rows, bounds, cones, quiet).solve()
            if found.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
                return x
            x = np.clip(x + np.array(found.x), task.lower, task.upper)
            if task.reached(x, target):
                return x
        return x

    return advance


def slsqp(task: Task) -> Advance:
    """SLSQP on the nonlinear problem of each target, from x_{t-1}."""
    weights, bounds = np.array(task.settings.q_weights), list(zip(task.lower, task.upper, strict=True))

    def advance(x: np.ndarray, target: np.ndarray) -> np.ndarray:
        reach = {"type": "eq", "fun": lambda z: task.near(z).tcp - target, "jac": lambda z: task.near(z).jacobian}
        clear = {
            "type": "ineq",
            "fun": lambda z: task.near(z).clearance - task.margin,
            "jac": lambda z: task.near(z).gradient,
        }
        found = minimize(
            lambda z: weights @ (z - x) ** 2,
            x,
            jac=lambda z: 2 * weights * (z - x),
            method="SLSQP",
            bounds=bounds,
            constraints=[reach, clear],
        )
        return np.clip(found.x, task.lower, task.upper)

    return advance


def mink(task: Task) -> Advance:
    """Greedy differential inverse kinematics by mink, up to 20 steps to each target.

    Before each step, a small sphere is placed at every capsule's nearest point. Damping and minimum distance are those
    with most tracked targets among the values tried (1e-4 to 0.1, 0.5 to 5 mm).
    """
    import mink

    spec = mujoco.MjSpec.from_file(str(GP50))
    pairs = [([geom.name], [f"nearest to {geom.name}"]) for geom in spec.geoms]
    for _, (name,) in pairs:
        dot = spec.worldbody.add_body(name=name, mocap=True)
        dot.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-6, 0, 0])
    model = spec.compile()
    configuration = mink.Configuration(model)
    tool = mink.FrameTask("tcp", "site", position_cost=1.0, orientation_cost=0.0)
    avoid = mink.CollisionAvoidanceLimit(
        model, pairs, gain=1.0, minimum_distance_from_collisions=2e-3, collision_detection_distance=0.1
    )
    limits = [mink.ConfigurationLimit(model), avoid]

    def advance(x: np.ndarray, target: np.ndarray) -> np.ndarray:
        tool.set_target(mink.SE3.from_translation(target))
        for _ in range(task.settings.max_step_qps):
            configuration.data.mocap_pos[:] = task.near(x).witness
            configuration.update(x)
            try:
                velocity = mink.solve_ik(configuration, [tool], 1.0, "daqp", damping=1e-2, limits=limits)
            except mink.NoSolutionFound:
                return x
            x = np.clip(x + velocity, task.lower, task.upper)
            if task.reached(x, target):
                return x
        return x

    return advance
