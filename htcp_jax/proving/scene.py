"""The scene in which motions are proven: a job's robot, part, cell and task, as a `Problem` of one scenario."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from htcp_jax import jobs
from htcp_jax.clearance import Obstacle
from htcp_jax.device import devices
from htcp_jax.errors import InputError
from htcp_jax.io.parts import NoCloud, load_workpiece
from htcp_jax.jobs import load_config, source_of, with_kinds
from htcp_jax.model import Robot, kinematics, make_scenario
from htcp_jax.model import robot as robots
from htcp_jax.model import scenario as scenarios
from htcp_jax.motion import Execution, Problem
from htcp_jax.proving.path_deviation import PathTask
from htcp_jax.spec import ObstacleKind, PlanConfig, TaskRowKind, numbers_of
from htcp_jax.status import Status

Cell = Robot | PlanConfig | str | Path | Mapping[str, Any] | None


class ProofInputs(NamedTuple):
    """The robot, the job and the obstacles of a scene that is not built yet."""

    robot: Robot
    job: PlanConfig | None  # the job, resolved; None: the scene is made from a robot
    others: tuple[Obstacle | ObstacleKind, ...]  # obstacles in addition to the part's and the job's
    has_part: bool  # False: no workpiece, and no path


class ProofScene(NamedTuple):
    """Scene of proofs."""

    problem: Problem  # one scenario, with the task of the first seam
    job: PlanConfig | None  # the job, resolved; None: the scene was made from a robot
    has_part: bool  # False: no workpiece, and no path
    tasks: tuple[PathTask, ...] = ()  # tasks along the path

    @property
    def checked(self) -> dict[str, str]:
        """Text by label: what a motion is proven against, and what is not checked."""
        part = self.problem.workpiece.name if self.has_part else "none"
        is_tree = self.job is not None and self.job.tree is not None
        facts = jobs.build.checked_facts(self.problem.robot, self.problem.other_obstacles, is_tree=is_tree)
        return {"part": part} | {"self-collision": "not checked", "fixtures": "none"} | facts


def scene_of(
    cell: Cell = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    *,
    obstacles: Sequence[Obstacle | ObstacleKind | Mapping[str, Any]] = (),
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None = None,
    device: str | None = None,
) -> ProofScene:
    """Return the scene of a job, or of a robot and obstacles.

    A job that states its robot or cell, but no section `workpiece`, has no part, as has one with `cloud: none` and no
    path. A start is not needed. A UserWarning names bodies that are not checked.

    Args:
        cell: A robot, or a job: a YAML file, the name of an example, a mapping of a file's keys, or a loaded job, which
            has a part. None: the default job.
        overrides: Changes to the job, see `htcp_jax.plan`.
        obstacles: Obstacles in addition to the job's.
        task: Task rows that replace the job's.
        device: The device, see `device.devices`. None: a GPU if there is one.

    Raises:
        InputError: If the input is invalid.
    """
    return build_scene(inputs_of(cell, overrides, obstacles=obstacles, task=task, device=device), device)


def inputs_of(
    cell: Cell = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    *,
    obstacles: Sequence[Obstacle | ObstacleKind | Mapping[str, Any]] = (),
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None = None,
    device: str | None = None,
) -> ProofInputs:
    """Return the robot and the job of a scene, without the part and the cell, which take longest; see `scene_of`.

    Raises:
        InputError: If the job or its robot is invalid.
    """
    if isinstance(cell, Robot):
        if overrides or task is not None:
            raise InputError("overrides and task rows change a job; pass a job in place of the robot")
        return ProofInputs(cell, None, tuple(obstacles), False)
    built = tuple(each for each in obstacles if isinstance(each, Obstacle))
    kinds = [each for each in obstacles if not isinstance(each, Obstacle)]
    is_loaded = isinstance(cell, PlanConfig)
    job = with_kinds(cell if is_loaded else load_config(cell, overrides), kinds, task)
    source = "the job" if is_loaded else source_of(cell)
    job = job.model_copy(update={"settings": job.settings.on(devices.choose(device)[0].platform)})
    if job.start_rad == ():
        job = job.model_copy(update={"start_rad": "auto"})
    with devices.on(devices.choose(device)[0]):
        job, robot = jobs.build.with_robot(job, source)
    stated = job.model_fields_set
    has_path = job.workpiece.has_cloud or "path" in job.workpiece.model_fields_set
    has_part = has_path and (is_loaded or "workpiece" in stated or not stated & {"robot", "cell"})
    return ProofInputs(robot, job, built, has_part)


def build_scene(inputs: ProofInputs, device: str | None = None) -> ProofScene:
    """Return the scene of a robot and a job, see `scene_of`.

    Args:
        inputs: The robot, the job and the obstacles.
        device: The device, see `device.devices`. None: a GPU if there is one.

    Raises:
        InputError: If the part is invalid.
    """
    with devices.on(devices.choose(device)[0]):
        found = _scene(inputs, device)
    if found.has_part and found.problem.scenarios.refused[0] == Status.OUT_OF_REACH:
        what = "a target of the part's path is farther away than the arm is long"
        warnings.warn(f"{what}; lengths in a job are in metres", stacklevel=1)
    if "not checked" in found.checked:
        warnings.warn(f"not checked: {found.checked['not checked']}", stacklevel=1)
    return found


def _scene(inputs: ProofInputs, device: str | None) -> ProofScene:
    """Return the scene, see `build_scene`."""
    robot, job, others, has_part = inputs
    if job is None:
        return ProofScene(_without_part(robot, others, None, device), None, False)
    others = (*jobs.build.obstacles_of(job.cell, robot), *others)
    if has_part:
        workpiece = jobs.build.workpiece_of(job.workpiece, robot)
        there = jobs.build.scenario_of(job, robot, workpiece, beyond_reach="record")
        own_task, execution = jobs.build.task_of_job(job, robot), Execution(device)
        goals = np.asarray(there.goals)[int(there.on_path) :]
        there = scenarios.with_goals_of(there, own_task.numbers)
        found = Problem.of(robot, workpiece, there, job.settings, own_task, others, execution, check_paths=False)
        tasks = [
            PathTask(each.task, tuple(map(str, each.rows)), each.here, goals[:, : each.task.numbers])
            for each in jobs.tasks_of_targets(job, robot, jobs.seam_of_rows(workpiece))
        ]
        return ProofScene(found, job, True, tuple(tasks))
    longer = robots.lengthen_tool(robot, job.robot.tool_extension_m)
    return ProofScene(_without_part(longer, others, job, device), job, False)


def _without_part(
    robot: Robot, obstacles: Sequence[Obstacle | ObstacleKind], job: PlanConfig | None, device: str | None
) -> Problem:
    """Return a problem with a part of no walls; its path is one point, at the TCP in the middle of the joint limits."""
    middle = np.clip(0.5 * (np.maximum(robot.lower, -10.0) + np.minimum(robot.upper, 10.0)), robot.lower, robot.upper)
    tcp = np.asarray(kinematics.tcp_position(robot, jnp.asarray(middle)))
    workpiece = load_workpiece(
        NoCloud(), tcp[None], pivot=np.zeros(3), neutral_translation=np.zeros(3), origin=(0.0, 0.0, 0.0)
    )
    there = make_scenario(robot, workpiece, middle, rotation=(0.0, 0.0), approach=(0, 0), beyond_reach="record")
    if job is not None and job.cell.obstacles:
        there = replace(there, obstacle_numbers=numbers_of(job.cell.obstacles))
    settings = None if job is None else job.settings
    return Problem.of(robot, workpiece, there, settings, None, obstacles, Execution(device), check_paths=False)
