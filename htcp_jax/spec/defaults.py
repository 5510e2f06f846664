"""Defaults that depend on a job's arm or part; `jobs.resolve` adds those that depend on its robot."""

import math
from typing import Any

from htcp_jax.spec.config_file import FILES, NO_CLOUD
from htcp_jax.spec.model_source import KEYS, WORLD

TIP_CONTACT_M = 0.01  # default of workpiece.tip_contact_m for a user-supplied part
_ORIGIN = (0.0, 0.0, 0.0)


def own_defaults(raw: dict) -> dict[str, Any]:
    """Return the defaults of a job that are not those of the default job, by section and key.

    For a robot other than the GP50: the model's joint limits, self-collision checks, and () for the weights, which
    means 1 for each joint, and for the start, which must be given. For a workpiece other than the duct: no rotation or
    translation, a pivot at its origin, the inlet direction of its convex hull, and contact of the tool's tip only
    within TIP_CONTACT_M of the TCP (for the duct, all of the tip may touch). For a job without a cloud: no walls, and
    self-collision checks for every arm.

    Args:
        raw: The configuration as plain values; it names the robot and the workpiece.
    """
    found: dict[str, Any] = {}
    if is_other_arm(raw):
        checked = {"cell": {"self_collision": True}}
        found = {"start_rad": (), "robot": {"limits": "model"}, "settings": {"q_weights": ()}} | checked
    if is_other(raw, "workpiece.cloud"):
        has_cloud = value_at(raw, "workpiece.cloud") != NO_CLOUD
        origin = value_at(raw, "workpiece.neutral_translation_m")
        found["workpiece"] = {
            "rotation_y_rad": 0.0,
            "rotation_z_rad": 0.0,
            "neutral_translation_m": _ORIGIN,
            "pivot_m": tuple(origin) if _is_point(origin) else _ORIGIN,
            "inlet_direction": None,
            "tip_contact_m": TIP_CONTACT_M if has_cloud else None,
        }
        found |= {} if has_cloud else {"cell": {"self_collision": True}}
    return found


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
    models = (value_at(raw, f"{key}.model") for key in KEYS[1:])
    parents = value_at(raw, "robot.parent") not in (None, WORLD), value_at(raw, "workpiece.parent") is not None
    return is_other(raw, "robot.model") or any(models) or any(parents)


def _is_point(value: Any) -> bool:
    numbers = value if isinstance(value, list | tuple) else ()
    return len(numbers) == 3 and all(type(n) in (int, float) and math.isfinite(n) for n in numbers)


# Keys that determine the defaults of the keys in DEPENDENT, if they vary in a sweep.
SOURCES = "robot.model", "workpiece.cloud", "workpiece.neutral_translation_m"
_OWN = own_defaults({"robot": {"model": "own"}, "workpiece": {"cloud": "own"}})
DEPENDENT = frozenset(key for key in keys_of(_OWN) if not isinstance(value_at(_OWN, key), dict))
