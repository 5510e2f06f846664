"""Errors of a job or a file as numbers for the proof, and their largest proven scale as a sentence."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.clearance.proof import error_bound
from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.model import robot as robots
from htcp_jax.motion import Problem
from htcp_jax.proving.scaled_errors import EMPTY, ErrorScale
from htcp_jax.spec import ErrorsConfig, PlanConfig, examples, strict_model, tool

DIGITS = 3  # of lengths, angles and scales in sentences, which are rounded down

Errors = ErrorsConfig | str | Path | Mapping[str, Any]


def read_errors(errors: Errors) -> ErrorsConfig:
    """Return half-widths of errors from a YAML file, or from a mapping with its keys.

    Raises:
        InputError: If the file cannot be read, or if a key or a value is invalid.
    """
    if isinstance(errors, ErrorsConfig):
        return errors
    path, raw = examples.read_mapping(errors, "errors")
    return strict_model.validate_model(raw, ErrorsConfig, str(path))


def error_set(problem: Problem, job: PlanConfig | None, errors: ErrorsConfig) -> error_bound.ErrorSet:
    """Return errors as numbers in a problem's first scenario.

    Args:
        problem: The problem, see `scene_of`.
        job: Its job; None: a robot without a job.
        errors: The half-widths.

    Raises:
        InputError: For errors of a part, a cloud, a path or a tool that the problem does not have, and for another
            number of joints.
    """
    scenario, nothing = problem.scenarios, np.zeros(3)
    robot = robots.lengthen_tool(problem.robot, float(scenario.tool_extension_m[0]))
    has_part = len(problem.workpiece.cloud) > 0
    part, own = errors.part, errors.tool
    if (part is not None or errors.cloud_m) and not has_part:
        key = "cloud_m" if part is None else "part"
        raise InputError(f"errors.{key} is set, but the job has no part with a cloud or a mesh; remove the key")
    is_tool = _tool_bodies(robot)
    if own is not None and not is_tool.any():
        raise InputError(f"errors.tool is set, but no body of {robot.name} is on the link of the TCP; remove the key")
    return error_bound.ErrorSet(
        nothing if part is None else np.array(part.shift_m),
        nothing if part is None else np.array(part.turn_rad),
        nothing if part is None else _centre(problem, part.about),
        nothing if own is None else np.array(own.shift_m),
        nothing if own is None else np.array(own.turn_rad),
        _flange(robot, job),
        is_tool & (own is not None),
        _joint_errors(robot, errors.joints_rad),
        errors.cloud_m,
    )


def _joint_errors(robot: Robot, joints: tuple[float, ...] | None) -> Float[np.ndarray, "N"]:
    if joints is None:
        return np.zeros(robot.dof)
    names = ", ".join(robot.joint_names)
    if len(joints) == 1 and robot.dof > 1 and any(robot.sliding):
        raise InputError(
            f"errors.joints_rad is one number, but {robot.name} has sliding joints; pass one per joint: {names}"
        )
    if len(joints) not in (1, robot.dof):
        raise InputError(f"errors.joints_rad has {len(joints)} numbers; valid: one, or one per joint: {names}")
    return np.broadcast_to(np.array(joints, float), robot.dof).copy()


def _tool_bodies(robot: Robot) -> Bool[np.ndarray, "K"]:
    """Return True for bodies of the job's tool; without one, for bodies of the link that carries the TCP."""
    count, attached = len(robot.capsule_link), np.zeros(len(robot.capsule_link), bool)
    attached[list(robot.attached)] = True
    mounted = np.zeros(count, bool)
    mounted[list(robot.mounted)] = True
    mounted &= ~attached
    return mounted if mounted.any() else (np.array(robot.capsule_link) == robot.tcp_link) & ~attached


def _flange(robot: Robot, job: PlanConfig | None) -> Float[np.ndarray, "4 4"]:
    """Return the flange in the link of the TCP [m]; without a tool in the job, the link's own frame."""
    if job is None or job.robot.tool is None:
        return np.eye(4)
    own = job.robot.tool
    tip = tool.pose(own.tip_m, own.tip_rpy_rad)
    tip[:3, 3] += job.robot.tool_extension_m * tip[:3, 2]
    return np.asarray(robot.T_link_tcp) @ np.linalg.inv(tip)


def _centre(problem: Problem, about: str | tuple[float, float, float]) -> Float[np.ndarray, "3"]:
    """Return the point about which the part turns [m]."""
    scenario = problem.scenarios
    if not isinstance(about, str):
        return np.array(about, float)
    if about == "part":
        return np.asarray(scenario.T_world_workpiece[0])[:3, 3].copy()
    rows = slice(int(scenario.on_path[0]), int(scenario.count[0]))
    return np.asarray(scenario.targets[0][rows, :3], float).mean(axis=0)


def scale_text(errors: ErrorsConfig, found: ErrorScale | None) -> str:
    """Return the largest proven scale of errors as a sentence.

    Args:
        errors: The errors as stated.
        found: Their scale; None: the motion itself is not proven.
    """
    if found is None:
        return "not proven with any error, as the motion itself is not proven"
    if found.scale <= EMPTY:
        return "not proven with any error of this kind"
    scale = _rounded_down(found.scale)
    parts = [
        *_displacement("the part", None if errors.part is None else (errors.part.shift_m, errors.part.turn_rad), scale),
        *_displacement("the tool", None if errors.tool is None else (errors.tool.shift_m, errors.tool.turn_rad), scale),
    ]
    if any(errors.joints_rad or ()):
        unit = (1.0, "rad, slides in m") if found.slides else (math.degrees(1), "degrees")
        parts.append(f"each joint off by up to {_sizes(errors.joints_rad, scale, *unit)}")
    if errors.cloud_m:
        parts.append(f"each point of the part off by up to {_sizes((errors.cloud_m,), scale, 1e3, 'mm')}")
    times = f"{'at least ' if found.is_more else ''}{scale:g} times the errors stated"
    begin = "proven" if found.scale >= 1 else "not proven for the errors stated; proven"
    return f"{begin} with {'; '.join(parts)} ({times})"


def errors_record(errors: ErrorsConfig, found: ErrorScale | None) -> dict[str, Any]:
    """Return errors and their largest proven scale as values for JSON, see `scale_text`."""
    known = {"scale": None, "is_more": False, "segment": None, "place_share": None}
    if found is not None:
        known = {"scale": found.scale, "is_more": found.is_more, "segment": found.segment}
        known["place_share"] = None if found.segment is None else found.place
    return {"stated": errors.model_dump(exclude_defaults=True), **known, "text": scale_text(errors, found)}


def _displacement(name: str, sizes: tuple | None, scale: float) -> list[str]:
    if sizes is None or not any((*sizes[0], *sizes[1])):
        return []
    texts = []
    if any(sizes[0]):
        texts.append(f"displaced by up to {_sizes(sizes[0], scale, 1e3, 'mm')} along each axis")
    if any(sizes[1]):
        texts.append(f"turned by up to {_sizes(sizes[1], scale, math.degrees(1), 'degrees')} about each axis")
    return [f"{name} {' and '.join(texts)}"]


def _sizes(values: tuple[float, ...], scale: float, factor: float, unit: str) -> str:
    texts = [f"{_rounded_down(factor * scale * value):g}" for value in values]
    return f"{texts[0] if len(set(texts)) == 1 else ', '.join(texts)} {unit}"


def _rounded_down(value: float) -> float:
    """Return a positive number with DIGITS digits that is not larger."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return math.floor(value / unit * (1 + 1e-12)) * unit
