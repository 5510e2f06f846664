"""Short job for any arm: a line of points in front of a flat plate perpendicular to its tool."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import htcp_jax
from htcp_jax.model import Robot
from htcp_jax.model.kinematics import jacobian, tcp_pose
from htcp_jax.spec.tool import Tool, ToolBody

LENGTH_M, POINTS, STEP_M = 0.16, 6, 0.005  # of the tool, the path
PLATE_M, GAP_M = 0.005, 0.004  # between points of the plate, between it and the path
TRIED = 64  # random configurations


def small_job(arm: Path, folder: Path, out: tuple = (0, 0, 1), seed: int = 0) -> dict:
    """Job configuration; its files are written into `folder`. out: outward direction of the flange, in its frame."""
    ahead = np.array(out, float)
    tip, p, q = (tuple((length * ahead).tolist()) for length in (LENGTH_M, 0.02, 0.1))
    body = {"name": "spindle of the job", "p_m": p, "q_m": q, "radius_m": 0.015}
    robot = htcp_jax.load_robot(arm, tool=Tool(tip, bodies=(ToolBody(**body),)))
    x = _handy_configuration(robot, np.random.default_rng(seed))
    T = np.asarray(jax.jit(tcp_pose)(robot, jnp.asarray(x)))
    ahead, across = T[:3, :3] @ ahead, np.linalg.svd((T[:3, :3] @ ahead)[None])[2][1:]
    path = T[:3, 3] + np.outer(STEP_M * np.arange(1, POINTS + 1), across[0])
    grid = PLATE_M * np.stack(np.meshgrid(*2 * [np.arange(-16, 17)]), axis=-1).reshape(-1, 2)
    for name, points in (("path.csv", path), ("plate.xyz", T[:3, 3] + GAP_M * ahead + grid @ across)):
        np.savetxt(folder / name, points, delimiter=",")
    return {
        "robot": {"model": str(arm), "tool": {"tip_m": list(tip), "bodies": [body | {"p_m": list(p), "q_m": list(q)}]}},
        "workpiece": {"cloud": str(folder / "plate.xyz"), "path": str(folder / "path.csv"), "interior": "none"},
        "start_rad": x.tolist(),
    }


def _handy_configuration(robot: Robot, draw: np.random.Generator) -> np.ndarray:
    """Random configuration in the middle half of the limits with the largest minimum singular value of the Jacobian."""
    low, high = (np.clip(np.asarray(limit), -np.pi, np.pi) for limit in (robot.lower, robot.upper))
    tried = draw.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, (TRIED, len(low)))
    slopes = np.asarray(jax.jit(jax.vmap(jacobian, (None, 0)))(robot, jnp.asarray(tried)))
    return tried[np.linalg.svd(slopes, compute_uv=False)[:, -1].argmax()]
