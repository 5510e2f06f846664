"""The defaults that hang on the robot and on the cloud."""

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robot_model import read_robot_file
from htcp_jax.jobs.config import AUTO, DEPENDENT, PlanConfig
from htcp_jax.jobs.config_file import FILES, put

TIP_CONTACT_M = 0.01  # of a part of one's own

_DEFAULTS = PlanConfig().model_dump()


def own_defaults(raw: dict, stated: Collection[str]) -> dict[str, Any]:
    """The `DEPENDENT` keys with their defaults, given the parts that `raw` names and what is stated of it.

    A robot other than the GP50 has its model's own limits and weights of 1, and keeps clear of itself; a cloud other
    than the duct is not turned and not moved, and turns about its own origin, wherever `neutral_translation_m` puts it;
    its inlet faces where its hull does, and the tip of the tool stays out of its walls, from which the paper's duct
    exempts it. Without a cloud there is no wall, and any arm keeps clear of itself.
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
    if value_at(raw, "workpiece.cloud") == "none":
        found["cell.self_collision"], found["workpiece.tip_contact_m"] = True, None
    return found


def fill_in(raw: dict, stated: Collection[str], source: str) -> None:
    """Put `own_defaults` into `raw` wherever a key is not stated. Raises InputError for a robot other than the GP50
    whose start is not stated."""
    if is_other(raw, "robot.model") and "start_rad" not in stated:
        raise InputError(_no_start(raw["robot"], source))
    sections = {key: raw.get(key, {}) for key in ("robot", "workpiece", "cell", "settings")}
    for key, default in own_defaults(raw, stated).items():
        if key not in stated and isinstance(sections[key.partition(".")[0]], dict):
            put(raw, key, default)


def keys_of(raw: dict, prefix: str = "") -> set[str]:
    """The dotted keys in `raw`."""
    found = set()
    for key, value in raw.items():
        found |= {f"{prefix}{key}"} | (keys_of(value, f"{prefix}{key}.") if isinstance(value, dict) else set())
    return found


def value_at(raw: dict, dotted: str) -> Any:
    """The value of a key; None where it is not there."""
    for key in dotted.split("."):
        if isinstance(raw, list | tuple):
            raw = dict(zip(map(str, range(1, len(raw) + 1)), raw, strict=True))
        if not isinstance(raw, dict) or key not in raw:
            return None
        raw = raw[key]
    return raw


def is_other(raw: dict, key: str) -> bool:
    """Whether the part is another than the built-in one, which is the first of its words."""
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
    return read_robot_file(Path(robot["model"]), site, "model", np.eye(4), None).facts["joint_names"]
