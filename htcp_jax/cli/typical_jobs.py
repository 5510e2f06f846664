"""Small jobs whose executables serve many users' jobs: what `htcp prepare` plans.

An executable depends on the number of joints and on the sizes of arrays, which are padded to few sizes, see
`Scene.for_programs`. A typical job has the sizes of a usual one: an arm from a file with meshes, with a torch; a part
from a mesh; a floor and a table; a direction of the tool. It is easy to plan, far from all obstacles.
"""

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import trimesh

from htcp_jax import jobs
from htcp_jax.api import Plan
from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import SelfCollision
from htcp_jax.device import devices
from htcp_jax.io.robots import gp50
from htcp_jax.model import Robot, Scenario, Task, Workpiece, body_pieces, kinematics, make_piece
from htcp_jax.model import robot as robots
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning import batch
from htcp_jax.reachability import obstruction
from htcp_jax.spec import PlanConfig
from htcp_jax.system import files

BODIES, PAIRS = robots.PREPARED_BODIES, {6: 100, 7: 150, 8: 150}  # numbers of bodies and of their pairs, by joints
COMPLETE = 6  # number of joints for which functions that follow dead ends and failed plans are compiled, too
AT_SEAM = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)  # configuration of the GP50 [rad]
CORNERS = 48  # at each end of a body's convex piece, which is a prism
AHEAD_M, ASIDE_M = 0.25, 5.0  # distances of the part from the TCP, and of the cell from the arm
JOB = {
    "workpiece": {"cloud": "plate.stl", "mesh_spacing_m": 0.002, "path": "seam.csv", "interior": "none"},
    "cell": {"model": "cell.xml", "self_collision": False},
    "task": [{"point": "tcp", "on": "path"}, {"axis": "tcp.z", "towards": "-path.normal"}],
    "start_rad": "auto",
}
CELL = f"""<mujoco><worldbody><geom type="plane" size="0 0 1" pos="0 0 {-ASIDE_M}"/>
<geom type="box" size="0.1 0.1 0.1" pos="{-ASIDE_M} 0 0"/></worldbody></mujoco>"""


def typical_plans(folder: Path, device: str | None) -> list[Plan]:
    """Return the plans of typical jobs, one for each number of joints in `BODIES`.

    They are made at the same time, so that no core waits for the last function of one; so is what a failed plan
    compiles to name the reason.

    Args:
        folder: An empty folder for the jobs' files.
        device: Name of the device; None: a GPU if there is one.
    """
    arms = [_arm(joints) for joints in BODIES]
    _write_scene(folder, np.asarray(kinematics.tcp_pose(arms[0], jnp.asarray(AT_SEAM))))
    workpiece = jobs.build.workpiece_of(_job(folder, arms[0]).workpiece, arms[0])
    pool = ThreadPoolExecutor(len(arms) + 1)
    try:
        typical = [(_job(folder, robot), robot, workpiece, device) for robot in arms]
        plans = [pool.submit(_plan, *own) for own in typical]
        reasons = [pool.submit(_compile_reason, *own) for own in typical if own[1].dof == COMPLETE]
        for reason in reasons:
            reason.result()
        return [plan.result() for plan in plans]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _job(folder: Path, robot: Robot) -> PlanConfig:
    """Return the job of an arm, whose weights are all 1, as those of users' arms are."""
    own, name = JOB | {"settings": {"q_weights": [1.0] * robot.dof}}, f"{robot.dof}.yaml"
    files.write_atomically(folder, name, json.dumps(own).encode())
    return jobs.resolve(jobs.load_config(folder / name), robot, name)


def _plan(job: PlanConfig, robot: Robot, workpiece: Workpiece, device: str | None) -> Plan:
    scenario, task, obstacles = _scene(job, robot, workpiece)
    execution = Execution(device, warm_up=("beam",) if robot.dof == COMPLETE else ())
    problem = Problem.of(robot, workpiece, scenario, job.settings, task, obstacles, execution)
    return Plan(job, robot, workpiece, scenario, batch.plan(problem), obstacles, device)


def _compile_reason(job: PlanConfig, robot: Robot, workpiece: Workpiece, device: str | None) -> None:
    """Compile what a failed plan needs to name the reason, also of a target out of reach."""
    scenario, task, obstacles = _scene(job, robot, workpiece)
    away = ASIDE_M * (np.arange(scenario.goals.shape[1]) < 3)
    far = dataclasses.replace(scenario, task_goals=scenario.goals + away)
    with devices.on(devices.choose(device)[0]):
        obstruction.obstruction(robot, workpiece, far, far.x_start, 0, job.settings, obstacles, task)


def _scene(job: PlanConfig, robot: Robot, workpiece: Workpiece) -> tuple[Scenario, Task, Obstacles]:
    pairs = SelfCollision(_pairs(robot)[: PAIRS[robot.dof]])
    obstacles = (*jobs.build.obstacles_of(job.cell, robot), pairs)
    return jobs.build.scenario_of(job, robot, workpiece), jobs.build.task_of_job(job, robot), obstacles


def _arm(joints: int) -> Robot:
    """Return the GP50 with 6 joints, on a rail with 7, and with a further hinge at its end with 8."""
    robot = gp50()
    if joints > 6:
        robot = _with_joint(robot, 0, (1.0, 0.0, 0.0), True)
    if joints > 7:
        robot = _with_joint(robot, joints - 1, (0.0, 0.0, 1.0), False)
    return _with_pieces(robot, BODIES[joints])


def _with_joint(robot: Robot, k: int, axis: tuple[float, float, float], slides: bool) -> Robot:
    """Return the arm with a further joint number k, by which it can move 1 m or turn 1 rad to either side."""
    more = {"T_parent_joint": np.eye(4), "axis": axis, "lower": -1.0, "upper": 1.0}
    more |= {"speed": np.inf, "acceleration": np.inf, "effort": np.inf}
    links = tuple(link + (link >= k or k == robot.dof) for link in robot.capsule_link)
    return dataclasses.replace(
        robot,
        **{name: jnp.asarray(np.insert(getattr(robot, name), k, value, axis=0)) for name, value in more.items()},
        joint_names=(*robot.joint_names[:k], "more", *robot.joint_names[k:]),
        slides=(*robot.slides[:k], slides, *robot.slides[k:]),
        capsule_link=links,
        frames=(),
    )


def _with_pieces(robot: Robot, count: int) -> Robot:
    """Return the arm with each body several times, `count` bodies in all, and with a convex piece in each."""
    which = np.arange(count) % len(robot.capsule_link)
    names = tuple(f"{robot.capsule_names[k]} {nth}" for nth, k in enumerate(which.tolist()))
    own = {name: getattr(robot, name)[which] for name in ("capsule_p", "capsule_q", "capsule_radius", "on_tool")}
    links = tuple(robot.capsule_link[k] for k in which.tolist())
    radius = np.asarray(own["capsule_radius"])
    sides = [_prism(*np.asarray([own["capsule_p"][k], own["capsule_q"][k]]), 0.9 * radius[k]) for k in range(count)]
    pieces = body_pieces([make_piece(corners) for corners in sides], radius)
    return dataclasses.replace(robot, **own, capsule_names=names, capsule_link=links, pieces=pieces)


def _prism(p: np.ndarray, q: np.ndarray, radius_m: float) -> np.ndarray:
    """Return the corners of a prism about the segment from p to q [m]."""
    along = q - p if (q != p).any() else np.array([0.0, 0.0, radius_m])
    across = np.linalg.svd(along[None])[2][1:]
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    ring = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across
    return np.concatenate([p + ring, p + along + ring])


def _pairs(robot: Robot) -> tuple[tuple[int, int], ...]:
    """Return the pairs of bodies on links that are not neighbours."""
    link, bodies = robot.capsule_link, range(len(robot.capsule_link))
    return tuple((a, b) for a in bodies for b in bodies if link[a] > link[b] + 1)


def _write_scene(folder: Path, T_world_tcp: np.ndarray) -> None:
    """Write the part, a seam of three points at the TCP, and the cell."""
    at, z = T_world_tcp[:3, 3], T_world_tcp[:3, 2]
    points = at + np.outer(range(3), [0.0, 1e-3, 0.0])
    rows = [",".join(map(str, [*point, *-z])) for point in points]
    files.write_atomically(folder, "seam.csv", "\n".join(["x,y,z,nx,ny,nz", *rows, ""]).encode())
    plate = trimesh.creation.box(extents=(0.3, 0.3, 0.001))
    plate.apply_translation(at + AHEAD_M * z).export(folder / "plate.stl")
    files.write_atomically(folder, "cell.xml", CELL.encode())
