"""Defaults that depend on the robot and on the cloud."""

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.jobs.config import AUTO, DEPENDENT, PlanConfig
from htcp_jax.jobs.config_file import FILES, NO_CLOUD, put_key

TIP_CONTACT_M = 0.01  # for a user-supplied part

_DEFAULTS = PlanConfig().model_dump()


def own_defaults(raw: dict, stated: Collection[str]) -> dict[str, Any]:
    """Return the `DEPENDENT` keys with their defaults.

    A robot other than the GP50 has its model's own limits, weights of 1, and self-collision checks. A cloud other than
    the duct is not rotated and not translated; its pivot is its own origin at `neutral_translation_m`, its inlet
    direction is its hull's, and the tool's tip is collision-checked, which the paper's duct excludes. Without a cloud
    there is no wall, and self-collision is checked for every arm.

    Args:
        raw: A plain configuration, which names the robot and the cloud.
        stated: The dotted keys that the configuration states.
    """
    found = {key: value_at(_DEFAULTS, key) for key in DEPENDENT}
    if is_other(raw, "robot.model"):
        known = (value_at(raw, key) for key in ("start_rad", "home_rad"))
        joints = next((len(x) for x in known if isinstance(x, list | tuple)), 0)
        joints = joints or (len(_joint_names(raw["robot"])) if value_at(raw, "start_rad") == AUTO else 0)
        found["robot.limits"], found["cell.self_collision"] = "model", True
        found["settings.q_weights"] = (1.0,) * joints
    if is_other(raw, "workpiece.cloud"):
        origin = value_at(raw, "workpiece.neutral_translation_m")
        known = "workpiece.neutral_translation_m" in stated and _is_point(origin)
        found["workpiece.rotation_y_rad"] = found["workpiece.rotation_z_rad"] = 0.0
        found["workpiece.neutral_translation_m"] = (0.0, 0.0, 0.0)
        found["workpiece.pivot_m"] = tuple(origin) if known else (0.0, 0.0, 0.0)
        found["workpiece.inlet_direction"], found["workpiece.tip_contact_m"] = None, TIP_CONTACT_M
    if value_at(raw, "workpiece.cloud") == NO_CLOUD:
        found["cell.self_collision"], found["workpiece.tip_contact_m"] = True, None
    return found


def fill_in(raw: dict, stated: Collection[str], source: str) -> None:
    """Fill keys that are not stated with `own_defaults`.

    Args:
        raw: A plain configuration, which is changed.
        stated: Its dotted keys.
        source: Its name, for messages.

    Raises:
        InputError: For a robot other than the GP50 without a start.
    """
    if is_other(raw, "robot.model") and "start_rad" not in stated:
        raise InputError(_no_start(raw["robot"], source))
    sections = {key: raw.get(key, {}) for key in ("robot", "workpiece", "cell", "settings")}
    for key, default in own_defaults(raw, stated).items():
        if key not in stated and isinstance(sections[key.partition(".")[0]], dict):
            put_key(raw, key, default)


def keys_of(raw: dict, prefix: str = "") -> set[str]:
    """Return the dotted keys in `raw`."""
    found = set()
    for key, value in raw.items():
        found |= {f"{prefix}{key}"} | (keys_of(value, f"{prefix}{key}.") if isinstance(value, dict) else set())
    return found


def value_at(raw: dict, dotted: str) -> Any:
    """Return the value of a dotted key; None if it is missing."""
    for key in dotted.split("."):
        if isinstance(raw, list | tuple):
            raw = dict(zip(map(str, range(1, len(raw) + 1)), raw, strict=True))
        if not isinstance(raw, dict) or key not in raw:
            return None
        raw = raw[key]
    return raw


def is_other(raw: dict, key: str) -> bool:
    """Return True if `key` names a part other than the built-in one, the first of its names."""
    name = value_at(raw, key)
    return isinstance(name, str) and name != FILES[tuple(key.split("."))][0]


def _is_point(value: Any) -> bool:
    numbers = value if isinstance(value, list | tuple) else ()
    return len(numbers) == 3 and all(type(n) in (int, float) and math.isfinite(n) for n in numbers)


def _no_start(robot: dict, source: str) -> str:
    names = _joint_names(robot)
    return (
        f"{source}: robot.model is {Path(robot['model']).name}, so start_rad must be given: "
        f"{len(names)} joint positions ({', '.join(names)}), or auto"
    )


def _joint_names(robot: dict) -> tuple[str, ...]:
    tcp = robot.get("tcp")
    site = tcp if isinstance(tcp, str) else "tcp"
    from htcp_jax.io.robots import model_file  # here, as MuJoCo is imported for an arm's file only

    locked = robot.get("locked") if isinstance(robot.get("locked"), dict) else {}
    arm = model_file.read_robot_file(Path(robot["model"]), site, "model", np.eye(4), None, locked)
    return arm.facts["joint_names"]
