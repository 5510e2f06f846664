"""Comparison with other planners on one task: robot, path, workpiece and poses of sweeps/workpiece.yaml.

    python -m benchmarks peers [--scenarios N] [--real CLOUD PATH X Y Z] [--json FILE]
    python -m benchmarks peers --motions [--planners A,B] [--limit-s S] ...

Only the tool's position is constrained. All run on one thread, one scenario after the other, except htcp_jax, which
advances all scenarios together. "setup s" is the time to compile or to build models, which is not part of the time per
step. "cpu ms" is less than "ms a step" if other processes use the CPU.

- htcp_jax: its baseline and N-space SQP; the first run compiles, the second is timed.
- step QPs: the baseline's in a plain Python loop, with MuJoCo's kinematics, scipy's tree of the cloud, and Clarabel.
- SLSQP: scipy's solver on the nonlinear problem of each target, with the same distances and gradients.
- mink: differential inverse kinematics, the obstacle a moving sphere on the nearest point of each capsule.
- TrajOpt of tesseract-robotics, on all points.

A target is passed if by MuJoCo's kinematics and distances (`htcp_jax.validation`) the tool is within the tolerance, the
arm is clear and within its limits, and all earlier targets are passed.

With --motions other planners are compared by executable targets, see `peer_motions`: three methods of htcp_jax, OMPL's
projected RRT-Connect (`peer_ompl`) and Descartes' ladder graph (`peer_descartes`).
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial import cKDTree

from benchmarks import hardware, peer_motions, peer_planners, peer_trajopt
from benchmarks.figures import Figure, save
from benchmarks.peer_planners import Advance, Task
from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import Batch, load_sweep
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning.batch import plan
from htcp_jax.runs.parameters import of_job
from htcp_jax.spec import GP50
from htcp_jax.status import Status
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall
from htcp_jax.validation.result import ROUNDING_M
from htcp_jax.validation.scene_rules import part_pose, targets_of

SWEEP = Path(__file__).resolve().parents[1] / "sweeps" / "workpiece.yaml"
POSES = 49
PACKAGES = "mujoco", "scipy", "clarabel", "mink", "tesseract-robotics"
MOTION_PACKAGES = "mujoco", "scipy", "ompl", "tesseract-robotics-nanobind"
ROW = "{:20} {:>7} {:>6} {:>10} {:>10} {:>7} {:>8}  {}"


class Outcome(NamedTuple):
    """Results of a planner: the configurations (n, N) that it counts as tracked, one array per scenario."""

    found: list[np.ndarray]
    attempted: int
    run_s: float
    cpu_s: float
    setup_s: float
    note: str


class Clock:
    """Sum of the wall and CPU times of the blocks that run inside it [s]."""

    def __init__(self):
        self.wall = self.cpu = 0.0

    def __enter__(self) -> "Clock":
        self._began = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_) -> None:
        self.wall += time.perf_counter() - self._began[0]
        self.cpu += time.process_time() - self._began[1]


def ours(method: str) -> Callable[[Batch, list[Task]], Outcome]:
    """Return a planner that runs a method of htcp_jax."""

    def run(batch: Batch, tasks: list[Task]) -> Outcome:
        how = {"settings": tasks[0].settings, "execution": Execution(threads=1), "check_paths": False}
        first = plan(Problem.of(batch.robot, batch.workpiece, batch.scenarios, **how), method)
        with Clock() as clock:
            plans = plan(Problem.of(batch.robot, batch.workpiece, batch.scenarios, **how), method)
        found = [x[tracked] for x, tracked in zip(plans.x, plans.tracked, strict=True)]
        attempted = int(np.sum((plans.status >= 0) & (plans.status != Status.NOT_ATTEMPTED)))
        return Outcome(found, attempted, plans.run_s, clock.cpu, first.compile_s, "all scenarios advance together")

    return run


def theirs(make: Callable[[Task], Advance], note: str) -> Callable[[Batch, list[Task]], Outcome]:
    """Return a planner that plans target by target, scenario by scenario, each until its first failure."""

    def run(batch: Batch, tasks: list[Task]) -> Outcome:
        found, attempted, run, setup = [], 0, Clock(), Clock()
        for task in tasks:
            with setup:
                advance = make(task)
            x, rows = task.start, []
            with run:
                for target in task.targets:
                    x, attempted = advance(x, target), attempted + 1
                    if not task.reached(x, target):
                        break
                    rows.append(x)
            found.append(np.array(rows).reshape(-1, len(x)))
        return Outcome(found, attempted, run.wall, run.cpu, setup.wall, note)

    return run


PLANNERS = {
    "htcp_jax baseline": ours("baseline"),
    "htcp_jax nspace-sqp": ours("nspace-sqp"),
    "step QPs, Clarabel": theirs(peer_planners.step_qps, "the baseline's QPs in a plain Python loop"),
    "scipy SLSQP": theirs(peer_planners.slsqp, "the nonlinear problem of each target, the same loop"),
    "mink": theirs(peer_planners.mink, "greedy, moving spheres on the nearest points"),
    "TrajOpt": theirs(peer_trajopt.trajopt, "term by term; its Python planner cannot do position-only"),
}


def passed(batch: Batch, arm: MujocoArm, wall: Wall, found: list[np.ndarray]) -> int:
    """Return the number of targets that pass MuJoCo's check, counted in each scenario up to the first that fails."""
    total = 0
    for point, x in zip(batch.points, found, strict=True):
        config, part = point.config, point.config.workpiece
        pose = of_job(config)
        rotate, translate = part_pose(part, pose)
        inlet = None if batch.workpiece.inlet is None else rotate @ batch.workpiece.inlet + translate
        start_tcp = arm.arm_poses(pose.start[None]).tcp[0]
        targets = targets_of(config, start_tcp, inlet, batch.workpiece.path @ rotate.T + translate)
        if len(x):
            at = CheckedScene(arm, wall, rotate, translate, part.interior_depth_m).at(x)
            error = np.linalg.norm(at.arm_poses.tcp - targets[: len(x)], axis=1)
            inside = ((x >= arm.lower - ROUNDING_M) & (x <= arm.upper + ROUNDING_M)).all(axis=1)
            good = (error <= config.settings.tolerance_m + ROUNDING_M) & (at.clearance > 0) & inside
            total += len(x) if good.all() else int(good.argmin())
    return total


def chosen_scenarios(count: int, real: list[str] | None) -> Batch:
    """Select `count` poses spread over the sweep; a smaller count is a prefix of a larger one."""
    changes = {}
    if real:
        cloud, path, *inlet = real
        changes = {"workpiece.cloud": cloud, "workpiece.path": path, "workpiece.inlet_m": [float(v) for v in inlet]}
        changes["workpiece.inlet_direction"] = "world-x"  # as for the generated duct
    where_the_duct_is = SWEEP.parents[1] / "configs" / "duct.yaml"
    batch = load_sweep(SWEEP, where_the_duct_is, changes).batch()
    numbers = [(24 + 19 * k) % POSES for k in range(count)]
    scenarios = jax.tree.map(lambda leaf: leaf[numbers], batch.scenarios)
    points = tuple(batch.points[k] for k in numbers)
    return batch._replace(cell=batch.cell[numbers], scenarios=scenarios, points=points)


def main() -> None:
    """Run every planner and print its row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", type=int, default=9, choices=range(1, POSES + 1), metavar="N", help="poses")
    parser.add_argument("--real", nargs=5, metavar=("CLOUD", "PATH", "X", "Y", "Z"), help="files; the inlet's centre")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write CPU times and counts as JSON; not with --motions"
    )
    parser.add_argument("--motions", action="store_true", help="by executable targets")
    parser.add_argument("--planners", default=",".join(peer_motions.NAMES), help="of --motions; by default all of them")
    parser.add_argument("--limit-s", type=float, default=30.0, help="of OMPL's processor time for a pose")
    requested = parser.parse_args()
    planners = requested.planners.split(",")
    if unknown := set(planners) - set(peer_motions.NAMES):
        parser.error(f"{', '.join(sorted(unknown))}: no planner of --motions; valid: {', '.join(peer_motions.NAMES)}")
    batch = chosen_scenarios(requested.scenarios, requested.real)
    targets = int(batch.scenarios.count.sum())
    packages = MOTION_PACKAGES if requested.motions else PACKAGES
    print(f"{hardware.line()}, {', '.join(map(hardware.version, packages))}")
    points = f"{len(batch.workpiece.cloud):,} points"
    print(f"{batch.workpiece.name}, {points}; {requested.scenarios} of {POSES} poses, {targets:,} targets")
    if requested.motions:
        cache_folder.enable()
        parts = [point.config.workpiece for point in batch.points]
        print("turned about y, z [rad]:", ", ".join(f"{p.rotation_y_rad:g} {p.rotation_z_rad:g}" for p in parts))
        for row in peer_motions.rows(batch, planners, requested.limit_s):
            print(row, flush=True)
        return
    part, arm = batch.points[0].config.workpiece, MujocoArm(GP50, limits=batch.points[0].config.robot.limits)
    wall, tree = Wall(batch.workpiece.cloud, part.interior), cKDTree(batch.workpiece.cloud)
    print(ROW.format("planner", "passed", "%", "attempted", "ms a step", "cpu ms", "setup s", "notes"), flush=True)
    rows = []
    for name, run in PLANNERS.items():
        if sys.stderr.isatty():
            print(f"{name} ...", end="\r", file=sys.stderr, flush=True)
        try:
            outcome = run(batch, [Task(batch, tree, k) for k in range(requested.scenarios)])
        except ModuleNotFoundError as error:
            lacking = error.name.partition(".")[0]
            print(ROW.format(name, *"------", f"{lacking} is missing: pip install -e '.[peers]'"), flush=True)
            continue
        good, claimed = passed(batch, arm, wall, outcome.found), sum(map(len, outcome.found))
        note = outcome.note if good == claimed else f"{outcome.note}; {claimed - good} more claimed, refuted"
        times = (f"{1e3 * spent / outcome.attempted:.2f}" for spent in (outcome.run_s, outcome.cpu_s))
        share, setup = f"{100 * good / targets:.1f}", f"{outcome.setup_s:.1f}"
        print(ROW.format(name, good, share, outcome.attempted, *times, setup, note), flush=True)
        rows.append(Figure(f"{name}, CPU a step", 1e3 * outcome.cpu_s / outcome.attempted, "ms", good))
    save(requested.json, rows)


if __name__ == "__main__":
    main()
