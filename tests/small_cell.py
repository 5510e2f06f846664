"""A short job for any arm: a line of points over a flat plate that stands square in front of its tool."""

from pathlib import Path

import numpy as np

import htcp_jax
from htcp_jax.scene.kinematics import jacobian, tcp_pose
from htcp_jax.scene.tool import Tool

TOOL = {
    "tip_m": [0, 0, 0.16],
    "bodies": [{"name": "spindle of the job", "p_m": [0, 0, 0.02], "q_m": [0, 0, 0.1], "radius_m": 0.015}],
}
POINTS, STEP_M, GAP_M = 8, 0.005, 0.004  # of the path; its height over the plate
PLATE = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(-0.1, 0.1, 41)), axis=-1).reshape(-1, 2)


def job(arm: Path, folder: Path, along: str = "z", seed: int = 0) -> dict:
    """The job's configuration; its files are written into `folder`. along: the axis of the flange that points out."""
    tool = _turned(along)
    robot = htcp_jax.load_robot(arm, tool=Tool.model_validate(tool))
    x = _handy(robot, np.random.default_rng(seed))
    T = np.asarray(tcp_pose(robot, x))
    path = T[:3, 3] + np.outer(STEP_M * np.arange(1, POINTS + 1), T[:3, 0])
    plate = T[:3, 3] + GAP_M * T[:3, 2] + PLATE @ T[:3, :2].T
    for name, points in (("path.csv", path), ("plate.xyz", plate)):
        np.savetxt(folder / name, points, delimiter=",")
    return {
        "robot": {"model": str(arm), "tool": tool},
        "workpiece": {"cloud": str(folder / "plate.xyz"), "path": str(folder / "path.csv"), "interior": "none"},
        "start_rad": x.tolist(),
    }
