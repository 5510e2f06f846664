"""Toy arm of four joints and two capsules that reaches under a shelf of 200 points: a plan takes some 10 ms."""

from dataclasses import fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import made_once
import numpy as np
import yaml

from htcp_jax.clearance import Scene
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Execution, Plans, Problem
from htcp_jax.motion.plans import ARRAYS
from htcp_jax.planning.batch import plan
from htcp_jax.settings import Settings

ARM = """
<mujoco model="toy"><worldbody>
  <body pos="0 0 0.3"><joint name="j1" axis="0 0 1" range="-170 170"/>
    <body><joint name="j2" axis="0 1 0" range="-120 120"/>
      <body pos="0 0 0.4"><joint name="j3" axis="0 1 0" range="-150 150"/>
        <geom name="forearm" type="capsule" size="0.03" fromto="0 0 0 0 0 0.36"/>
        <body pos="0 0 0.4"><joint name="j4" axis="0 1 0" range="-150 150"/>
          <geom name="tool" type="capsule" size="0.02" fromto="0 0 0 0 0 0.16"/><site name="tcp" pos="0 0 0.2"/>
  </body></body></body></body>
</worldbody></mujoco>
"""
START = tuple(np.radians([0.0, 0.0, 100.0, 30.0]).tolist())
TARGETS = 10  # of the path
ROWS = 64  # configurations that `measured` evaluates at a time
SHELF_M = 0.36  # height above the floor; the path is 6 cm lower
# A narrow beam and few samples: the search is as short as it can be.
SETTINGS = Settings(
    q_weights=(1.0,) * 4, beam_width=6, min_beam_width=6, self_motions=6, self_motion_rounds=2, samples=8,
    sample_steps=20, population=8, generations=5,
)  # fmt: skip


@cache
def robot() -> Robot:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "toy.xml"
        file.write_text(ARM)
        return load_robot(file)


@cache
def workpiece() -> Workpiece:
    along, across = np.linspace(0.42, 0.8, 20), np.linspace(-0.2, 0.2, 10)
    shelf = np.stack(np.meshgrid(along, across, [SHELF_M]), axis=-1).reshape(-1, 3)
    x = np.linspace(0.42, 0.66, TARGETS)
    path = np.stack([x, 0.04 * np.sin(6 * x), np.full(TARGETS, SHELF_M - 0.06)], axis=1)
    home = (0.0, 0.0, 0.0)
    return Workpiece("shelf", shelf, path, interior="none", pivot=home, neutral_translation=home)


@cache
def scene() -> Scene:
    return Scene(robot(), make_obstacle(workpiece()))


def scenario(number: int = 0, start=START, approach: tuple[int, int] = (2, 2), part=None, **changes) -> Scenario:
    """Scenario with 2 targets before the path, at the shelf or another part."""
    choices = {"rotation": (0.0, 0.0), "approach": approach, "number": number} | changes
    return make_scenario(robot(), part or workpiece(), start, **choices)


@cache
def scenarios() -> tuple[Scenario, ...]:
    """Scenarios of different poses, lengths, margins and tools, in which step QPs get stuck at different targets."""
    return (
        scenario(0),
        scenario(1, shift=(0.0, 0.05, 0.03), margin_m=0.0),
        scenario(2, shift=(0.03, 0.0, -0.05), approach=(4, 2)),
        scenario(3, rotation=(0.1, 0.3), tool_extension_m=0.02),
        scenario(4, rotation=(-0.1, -0.3)),
    )


def problem(of=None, settings: Settings = SETTINGS, part=None, check_paths: bool = True, **execution) -> Problem:
    """Problem of scenarios, by default of all, at the shelf or another part; `execution`: of an `Execution`."""
    made = robot(), part or workpiece(), scenarios() if of is None else of, settings
    return Problem.of(*made, execution=Execution(**execution), check_paths=check_paths)


def planned(of=None, method: str = "beam", settings: Settings = SETTINGS, progress=None, **more) -> Plans:
    """Plans of a `problem`."""
    return plan(problem(of, settings, **more), method, progress)


@cache
def plans_by(method: str = "beam", settings: Settings = SETTINGS) -> Plans:
    """Plans of all scenarios by one thread, made once and read-only."""
    plans = planned(method=method, settings=settings, threads=1)
    for array in plans.arrays().values():
        array.flags.writeable = False
    return plans


def measured(one: Scenario, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clearance (n,) and TCP (n, 3) [m] at configurations (n, 4), by brute force in NumPy over all points."""
    arm, T, rows = lengthen_tool(robot(), float(one.tool_extension_m)), one.T_world_workpiece, []
    cloud = workpiece().cloud @ T[:3, :3].T + T[:3, 3]
    for first in range(0, len(x), ROWS):
        part = x[first : first + ROWS]
        p, q, tcp = map(np.asarray, made_once.ENDS(arm, np.resize(part, (ROWS, 4))))
        d, ahead = (q - p)[:, :, None], cloud - p[:, :, None]  # rows, bodies, points
        s = np.clip((ahead * d).sum(-1) / (d * d).sum(-1), 0, 1)[..., None]
        distance = np.linalg.norm(ahead - s * d, axis=-1).min(-1) - np.asarray(arm.capsule_radius)
        rows += zip(distance.min(-1)[: len(part)], tcp[: len(part)], strict=True)
    return np.array([D for D, _ in rows]), np.array([tcp for _, tcp in rows])


def same(one: Plans, row: int, other: Plans, other_row: int, count: int) -> None:
    """Check that two plans of a scenario are equal to the last bit, via points included."""
    for name in ARRAYS:
        here, there = (getattr(plans, name)[r] for plans, r in ((one, row), (other, other_row)))
        if name != "start":
            here, there = here[:count], there[:count]
        np.testing.assert_array_equal(here, there, err_msg=name)
    for t in range(count):
        np.testing.assert_array_equal(one.via_points.on_segment(row, t), other.via_points.on_segment(other_row, t))


def write_job(
    folder: Path, targets: int = TARGETS, settings: Settings = SETTINGS, shift_m: tuple = (0.0, 0.0, 0.0), **changes
) -> Path:
    """Write a job with the arm, the shelf and these settings, and return its file; `changes` replace its sections."""
    (folder / "arm.xml").write_text(ARM)
    np.savetxt(folder / "shelf.xyz", workpiece().cloud)
    np.savetxt(folder / "path.csv", workpiece().path[:targets], delimiter=",")
    part = {"cloud": "shelf.xyz", "path": "path.csv", "interior": "none", "tip_contact_m": None}
    given = {each.name: getattr(settings, each.name) for each in fields(Settings)}
    usual = Settings(q_weights=settings.q_weights)
    given = {name: value for name, value in given.items() if value != getattr(usual, name)}
    job = {
        "robot": {"model": "arm.xml"},
        "start_rad": list(START),
        "workpiece": part | {"approach_to_inlet": 2, "approach_to_path": 2, "shift_m": list(shift_m)},
        "settings": given,
    }
    (folder / "job.yaml").write_text(yaml.safe_dump(job | changes))
    return folder / "job.yaml"


def write_sweep(folder: Path, **changes) -> None:
    """Write the files of a sweep over six starts, all of which track their 8 targets by the baseline."""
    write_job(folder, 3, shift_m=(0.45, 0.02, 0.0), **changes)
    starts = [{"start_rad.j3": {"offsets": [-0.1, 0, 0.1]}}, {"start_rad.j4": {"offsets": [0, 0.1]}}]
    (folder / "grid.yaml").write_text(yaml.safe_dump({"config": "job.yaml", "grid": starts}))
