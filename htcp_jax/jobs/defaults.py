"""Defaults of a job's keys that depend on its robot or its workpiece."""

import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.spec import (
    AUTO,
    BUILT_IN_ARM,
    DEPENDENT,
    FILES,
    NO_CLOUD,
    WORLD,
    PlanConfig,
    model_source,
    put_key,
    strict_model,
)

TIP_CONTACT_M = 0.01  # default of workpiece.tip_contact_m for a user-supplied part

_DEFAULTS = PlanConfig().model_dump()


def own_defaults(raw: dict, stated: Collection[str]) -> dict[str, Any]:
    """Return the defaults of the keys in `DEPENDENT`, by dotted key.

    For a robot other than the GP50: the model's joint limits, weights of 1, and self-collision checks. For a workpiece
    other than the duct: no rotation or translation, a pivot at its origin, the inlet direction of its convex hull, and
    contact of the tool's tip only within TIP_CONTACT_M of the TCP (for the duct, all of the tip may touch). For a job
    without a cloud: no walls, and self-collision checks for every arm.

    Args:
        raw: The configuration as plain values; it names the robot and the workpiece.
        stated: The dotted keys that the configuration contains.
    """
    found = {key: value_at(_DEFAULTS, key) for key in DEPENDENT}
    if is_other_arm(raw):
        known = (value_at(raw, key) for key in ("start_rad", "home_rad"))
        joints = next((len(x) for x in known if isinstance(x, list | tuple)), 0)
        joints = joints or (len(_joint_names(raw)) if value_at(raw, "start_rad") == AUTO else 0)
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
    """Set the missing keys of a configuration to `own_defaults`.

    Args:
        raw: The configuration as plain values; it is modified.
        stated: The dotted keys that the configuration contains.
        source: Name of the configuration, for messages.

    Raises:
        InputError: If the robot is not the GP50 and start_rad is missing.
    """
    if is_other_arm(raw) and "start_rad" not in stated:
        raise InputError(_no_start(raw, source))
    sections = {key: raw.get(key, {}) for key in ("robot", "workpiece", "cell", "settings")}
    for key, default in own_defaults(raw, stated).items():
        if key not in stated and isinstance(sections[key.partition(".")[0]], dict):
            put_key(raw, key, default)


def keys_of(raw: dict, prefix: str = "") -> set[str]:
    """Return all dotted keys in a configuration, including the sections."""
    found = set()
    for key, value in raw.items():
        found |= {f"{prefix}{key}"} | (keys_of(value, f"{prefix}{key}.") if isinstance(value, dict) else set())
    return found


def value_at(raw: dict, dotted: str) -> Any:
    """Return the value of a dotted key; None if the key is missing."""
    for key in dotted.split("."):
        if isinstance(raw, list | tuple):
            raw = dict(zip(map(str, range(1, len(raw) + 1)), raw, strict=True))
        if not isinstance(raw, dict) or key not in raw:
            return None
        raw = raw[key]
    return raw


def is_other(raw: dict, key: str) -> bool:
    """Return True if `key` has a value other than its first built-in name, such as "duct" for workpiece.cloud."""
    name = value_at(raw, key)
    return isinstance(name, str) and name != FILES[tuple(key.split("."))][0]


def is_other_arm(raw: dict) -> bool:
    """Return False if the robot is the GP50 without a positioner, rail or tool model; otherwise True."""
    models = [value_at(raw, f"{key}.model") for key in model_source.KEYS[1:]]
    parents = value_at(raw, "robot.parent") not in (None, WORLD), value_at(raw, "workpiece.parent") is not None
    return is_other(raw, "robot.model") or any(model is not None for model in models) or any(parents)


def _is_point(value: Any) -> bool:
    numbers = value if isinstance(value, list | tuple) else ()
    return len(numbers) == 3 and all(type(n) in (int, float) and math.isfinite(n) for n in numbers)


def _no_start(raw: dict, source: str) -> str:
    names = _joint_names(raw)
    model = value_at(raw, "robot.model")
    return (
        f"{source}: robot.model is {BUILT_IN_ARM if model is None else Path(model).name}, so start_rad must be given: "
        f"{len(names)} joint positions ({', '.join(names)}), or auto"
    )


def _joint_names(raw: dict) -> tuple[str, ...]:
    from htcp_jax.io.robots import model_file  # here, as it imports MuJoCo

    robot = {key: value for key in ("model", "parent") if (value := value_at(raw, f"robot.{key}")) is not None}
    others = {key: raw[key] for key in model_source.KEYS[1:] if isinstance(raw.get(key), dict)}
    part = {"parent": value_at(raw, "workpiece.parent")}
    job = strict_model.validate_model({"robot": robot, "workpiece": part, **others}, PlanConfig, "the configuration")
    source = job.tree or job.robot.file
    tcp, locked = value_at(raw, "robot.tcp"), value_at(raw, "robot.locked")
    site = tcp.removeprefix("robot.") if isinstance(tcp, str) else model_source.default_tcp(source)
    arm = model_file.read_robot_file(source, site, "model", np.eye(4), None, locked if isinstance(locked, dict) else {})
    return arm.facts["joint_names"]
