"""Scenes and motions of `prove`: Drake's shelf, planted collisions, and thin walls."""

import csv
import re
import subprocess
import sys
from collections.abc import Callable
from math import comb
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from benchmarks.prove_reference import ChainArm, chain_arm, smallest

SPHERES = "iiwa14_spheres_dense_collision.urdf"
TIERS = "50", "10", "02", "00"
GRID = 1000  # samples between two of which a collision is planted
JITTER_RAD = 0.02
SETTLED = 0.05  # share of the planted depth by which the true one may differ


class Boxes(NamedTuple):
    """Boxes along the world's axes."""

    names: tuple[str, ...]
    centre: Float[np.ndarray, "B 3"]  # [m]
    half: Float[np.ndarray, "B 3"]  # half edges [m]


class Planted(NamedTuple):
    """A straight motion past a ball."""

    a: Float[np.ndarray, "N"]
    b: Float[np.ndarray, "N"]
    centre: Float[np.ndarray, "3"]
    radius: float
    true_m: float  # smallest distance by the reference; below 0: in collision


def shelf(data: Path, tier: str) -> Boxes:
    """Return the table and bookcase of a tier, "50" to "00" mm."""
    lines = (data / f"boxes_tier_{tier}mm.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))[1:]
    numbers = np.array([row[1:] for row in rows], float)
    return Boxes(tuple(row[0] for row in rows), numbers[:, :3], numbers[:, 3:] / 2)


def waypoints(data: Path) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 7"]]:
    """Return the times and configurations of the path into the shelf."""
    rows = np.loadtxt(data / "waypoints_shelf.csv", delimiter=",", skiprows=1)
    return rows[:, 0], rows[:, 1:]


def quintics(t: Float[np.ndarray, "n"], q: Float[np.ndarray, "*M n N"]) -> Float[np.ndarray, "*M m 6 N"]:
    """Return the coefficients of quintic Bezier curves through waypoints, as Drake's benchmark joins them."""
    v = np.zeros_like(q)
    v[..., 1:-1, :] = (q[..., 2:, :] - q[..., :-2, :]) / (t[2:] - t[:-2])[:, None]
    step = np.diff(t)[:, None] / 5
    start, end = q[..., :-1, :], q[..., 1:, :]
    leave, arrive = step * v[..., :-1, :], step * v[..., 1:, :]
    points = start, start + leave, start + 2 * leave, end - 2 * arrive, end - arrive, end
    terms = [sum((-1) ** (k - i) * comb(5, k) * comb(k, i) * points[i] for i in range(k + 1)) for k in range(6)]
    return np.stack(terms, axis=-2)


def along(coefficients: Float[np.ndarray, "m C N"]) -> Callable[[np.ndarray], Float[np.ndarray, "n N"]]:
    """Return the function from places 0 to 1 on all segments together to configurations."""

    def path(s: np.ndarray) -> Float[np.ndarray, "n N"]:
        part = np.minimum((s * len(coefficients)).astype(int), len(coefficients) - 1)
        powers = (s * len(coefficients) - part)[:, None] ** np.arange(coefficients.shape[1])
        return np.einsum("nk,nkj->nj", powers, coefficients[part])

    return path


def jittered(q: Float[np.ndarray, "n N"], copies: int) -> Float[np.ndarray, "M n N"]:
    """Return copies of waypoints, each joint changed by up to 0.02 rad."""
    return q + np.random.default_rng(0).uniform(-JITTER_RAD, JITTER_RAD, (copies, *q.shape))


# Files


def without_meshes(data: Path, folder: Path) -> Path:
    """Return the file of the iiwa 14 with its 46 spheres alone."""
    text = re.sub("<visual>.*?</visual>", "", (data / SPHERES).read_text(encoding="utf-8"), flags=re.DOTALL)
    file = folder / "iiwa14.urdf"
    file.write_text(text, encoding="utf-8")
    return file


def imported(file: Path, folder: Path) -> Path:
    """Return the iiwa as an MJCF file by `htcp robot`; pairs of adjacent links are excluded, as Drake does."""
    pairs = "".join(
        f'<disable_collisions link1="iiwa_link_{k}" link2="iiwa_link_{k + 1}" reason="Adjacent"/>' for k in range(7)
    )
    (folder / "iiwa.srdf").write_text(f'<robot name="iiwa14">{pairs}</robot>', encoding="utf-8")
    options = ["--tcp", "iiwa_link_ee", "--srdf", str(folder / "iiwa.srdf"), "--replace"]
    command = [sys.executable, "-m", "htcp_jax", "robot", str(file), *options, "--out", str(folder / "iiwa.xml")]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return folder / "iiwa.xml"


def reference_of(file: Path) -> ChainArm:
    """Return the independent reference of an arm's file."""
    return chain_arm(mujoco.MjModel.from_xml_path(str(file)))


def box_cell(boxes: Boxes, file: Path) -> str:
    """Write boxes as a cell; return its path."""
    geoms = [
        f'<geom name="{name}" type="box" pos="{row(centre)}" size="{row(half)}"/>'
        for name, centre, half in zip(*boxes, strict=True)
    ]
    return cell(geoms, file)


def ball_cell(centre: np.ndarray, radius: float, file: Path) -> str:
    """Write a ball as a cell; return its path."""
    return cell([f'<geom name="ball" type="sphere" size="{radius!r}" pos="{row(centre)}"/>'], file)


def cell(geoms: list[str], file: Path) -> str:
    """Write geoms as a cell; return its path."""
    file.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>", encoding="utf-8")
    return str(file)


def row(values: np.ndarray) -> str:
    """Return numbers as an attribute of XML."""
    return " ".join(repr(float(value)) for value in values)


# Planted collisions


def plant(arm: ChainArm, limits: tuple[np.ndarray, np.ndarray], depth_m: float, rng: np.random.Generator) -> Planted:
    """Return a motion whose last body passes a small ball between two of 1,000 samples, all of which are clear.

    The ball is placed across the body's motion and its axis, so that the two overlap by `depth_m` in the middle between
    the samples, or miss each other if it is below 0. Random motions are drawn until the reference confirms that.

    Args:
        arm: The arm.
        limits: Lower and upper joint limits [rad].
        depth_m: Depth of the overlap [m].
        rng: Generator of the motions.
    """
    body, moment = len(arm.radius) - 1, 1e-6
    while True:
        a = rng.uniform(*limits)
        b = np.clip(a + rng.choice([-1, 1], len(a)) * rng.uniform(1, 4, len(a)), *limits)
        s = (rng.integers(100, GRID - 101) + 0.5) / (GRID - 1)
        p, q = (ends[:, body] for ends in arm.ends(a + (s + moment * np.arange(2))[:, None] * (b - a)))
        at = p + rng.random() * (q - p)
        across = np.cross(at[1] - at[0], (q - p)[0]) if (q != p).any() else np.cross(at[1] - at[0], rng.normal(size=3))
        if np.linalg.norm(across) < 1e-12:
            continue
        radius = rng.uniform(0.0005, 0.006)
        away = arm.radius[body] + radius - depth_m
        if away <= 0:
            continue
        centre = at[0] + across / np.linalg.norm(across) * away
        path = lambda places, a=a, b=b: a + places[:, None] * (b - a)  # noqa: E731
        ball = lambda x, centre=centre, radius=radius: arm.to_ball(x, centre, radius)  # noqa: E731
        if ball(path(np.linspace(0, 1, GRID))).min() <= 0:
            continue
        true, _ = smallest(path, ball, 20_000)
        if abs(true + depth_m) <= SETTLED * abs(depth_m) + 1e-6:
            return Planted(a, b, centre, radius, true)


def depths(count: int, rng: np.random.Generator) -> Float[np.ndarray, "count"]:
    """Return depths from 0.01 to 5 mm, evenly distributed by their logarithm [m]."""
    return np.exp(rng.uniform(np.log(1e-5), np.log(5e-3), count))
