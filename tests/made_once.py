"""Objects that several tests need and that are slow to make: made once per session."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from htcp_jax.clearance import Obstacle, Scene, minimum_clearance
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.proof.bisection import Proof, initial_state
from htcp_jax.clearance.proof.joint_path import StraightPath
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.clearance.proof.motion_proof import DEEPEST, query_on
from htcp_jax.device.executor import QUICK, ExecutableCache
from htcp_jax.device.lane_function import LaneFunction
from htcp_jax.io.parts.point_cloud import load_geometry
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model.duct import section
from htcp_jax.model.kinematics import capsule_segments, tcp_position
from htcp_jax.model.mesh_points import cover_mesh
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion.measured_rows import MeasuredRows

START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)
MEASURED = Path(__file__).parents[2] / "shared" / "data" / "duct"
PAPER_CHOICES = {  # settings of `configs/paper.yaml` that decide which targets fail and how paths are checked
    "clearance_rows": "smallest",
    "cost_about": "previous",
    "aim_above_m": 0.0,
    "path_check": "none",
    "path_test": "samples",
}
quick_jit = partial(jax.jit, compiler_options=QUICK["cpu"])  # compiles in half the time; for functions of few rows
RECORDED = Path(__file__).parent / "data" / "subproblems.npz"


@cache
def robot() -> Robot:
    return gp50()


@cache
def duct() -> Workpiece:
    """Generated duct."""
    return load_workpiece()


def section_value(points: np.ndarray) -> np.ndarray:
    """|y/a|^n + |(z - zc)/b|^n - 1 of the duct at points (P, 3): 0 on its surface, negative in the bore."""
    x, y, z = points.T
    at = section(x)
    b, n = at.half(z >= at.zc)
    return np.abs(y / at.a) ** n + np.abs((z - at.zc) / b) ** n - 1.0


@cache
def scene() -> Scene:
    return Scene(robot(), make_obstacle(duct()))


@cache
def nominal() -> Scenario:
    """Middle scenario of the robot sweep on the generated duct, as device arrays."""
    return jax.tree.map(jnp.asarray, make_scenario(robot(), duct(), START))


def nearest_name(robot: Robot, obstacle: Obstacle, row: int, x: np.ndarray, margin_m: float = 0.0) -> str:
    """Name of the part of an obstacle that is nearest to the body of a row at x, in the middle scenario."""
    where = stack([replace(nominal(), margin_m=np.array(margin_m))])
    return MeasuredRows(robot, (obstacle,), where, np.asarray(x)[None]).other(row, 0)


@cache
def measured_duct() -> Workpiece:
    """Measured workpiece; skips the test where its data is missing."""
    if not MEASURED.exists():
        pytest.skip("the measured workpiece is not here (../shared/data/duct next to the repository)")
    return load_workpiece(MEASURED / "cloud.xyz", MEASURED / "weld.csv", inlet=(0.0, 0.0, 0.19138))


@cache
def seven_joints(folder: Path) -> Robot:
    """Arm with seven hinges in a row, whose last capsule is a sphere; its model file is written into `folder`."""
    links, close = "", ""
    for i in range(7):
        axis = "0 0 1" if i % 2 == 0 else "0 1 0"
        links += f'<body pos="0 0 0.3"><joint name="j{i}" axis="{axis}" range="-170 170"/>'
        links += '<geom type="capsule" size="0.05" fromto="0 0 0.05 0 0 0.25"/>'
        close += "</body>"
    links += '<geom type="sphere" size="0.04" pos="0 0 0.3"/><site name="tcp" pos="0.05 0 0.35"/>'
    path = folder / "seven.xml"
    path.write_text(f'<mujoco model="seven"><worldbody>{links}{close}</worldbody></mujoco>')
    return load_robot(path)


def configurations(of: Robot, count: int, seed: int = 0) -> np.ndarray:
    """Uniform draws within the joint limits (count, N)."""
    lower, upper = np.maximum(of.lower, -np.pi), np.minimum(of.upper, np.pi)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def configurations_near(x: np.ndarray, count: int, width: float, seed: int = 0) -> np.ndarray:
    """Uniform draws at most `width` [rad] from x in every joint (count, N)."""
    return np.asarray(x) + np.random.default_rng(seed).uniform(-width, width, (count, len(x)))


def prove(scene, where, a, b, tube=None, resolution_m=-ROUNDING_M, deepest=DEEPEST, kept=0.0) -> Proof:
    """Proof or refutation of one straight joint path, by queries one after the other; each measures all rows."""
    query = query_on(scene, where, StraightPath(a, b), tube, resolution_m, deepest, kept)
    return jax.lax.while_loop(lambda search: search.going, lambda search: query(search, None)[0], initial_state()).proof


def load_cloud(file: Path | str, spacing: float | None = None) -> np.ndarray:
    """Points of a cloud's file, or those that cover the mesh in a file."""
    found = load_geometry(file)
    return cover_mesh(found.triangles, str(file), spacing).points if len(found.triangles) else found.points


def compiled_from(executables: ExecutableCache, *lane_functions: LaneFunction) -> list:
    """Executables of some lane functions in a cache, as pairs (lane function, executable)."""
    return [(key[0], executable) for key, executable in executables._compiled.items() if key[0] in lane_functions]


@cache
def in_rows(function: Callable, count: int, jit: Callable = quick_jit) -> Callable:
    """`function(*shared, *row)` as `call(shared, *rows)` for any number of rows, by one program for `count` of them."""
    compiled = jit(lambda shared, rows: jax.lax.map(lambda row: function(*shared, *row), rows))

    def padded(leaf, first: int) -> np.ndarray:
        leaf = np.asarray(leaf)
        return np.resize(leaf[first : first + count], (count, *leaf.shape[1:]))

    def call(shared: tuple, *rows):
        total = len(jax.tree.leaves(rows)[0])
        parts = [compiled(shared, jax.tree.map(partial(padded, first=first), rows)) for first in range(0, total, count)]
        return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:total], *parts)

    return call


class Pose(NamedTuple):
    """All that distances to the duct read of a scenario."""

    T_world_workpiece: jax.Array
    interior_plane: jax.Array


def _clearance_and_tcp(robot, obstacles, where, x):
    return minimum_clearance(robot, obstacles, where, x), tcp_position(robot, x)


def measured(where, x: np.ndarray, arm: Robot | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Clearance (n,) of the robot, or of one with another tool, in the duct and its TCP (n, 3) [m] at x (n, 6)."""
    pose = Pose(*map(jnp.asarray, (where.T_world_workpiece, where.interior_plane)))
    return in_rows(_clearance_and_tcp, 200, jax.jit)((arm or robot(), scene().obstacles, pose), x)


ENDS = jax.jit(jax.vmap(lambda robot, x: (*capsule_segments(robot, x), tcp_position(robot, x)), (None, 0)))
