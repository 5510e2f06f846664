"""Ranges of the job parameters that a search varies.

    workpiece.rotation_y_rad: [0.0, 1.0]                          # a number
    workpiece.shift_m: [[-0.2, 0.2], [-0.2, 0.2], 0.0]            # a vector: elements vary or are fixed

Each number that varies is an axis of the unit cube; a mounting is a point in the cube. `Ranges.columns` converts
mountings to an axis of a grid, see `jobs.grid`.
"""

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs import grid_axes
from htcp_jax.spec import config

PLANNERS_OWN = ("settings.", "margin_m", "workpiece.interior", "workpiece.mesh", "workpiece.tip_contact_m",
                "workpiece.inlet", "workpiece.approach")  # fmt: skip
UNITS = {"_m": ("mm", 1e3), "_rad": ("°", 180 / math.pi), "_deg": ("°", 1.0)}


class ShownParameter(NamedTuple):
    """Display name and unit of a varied parameter."""

    column: str  # name of its column in mountings.parquet
    name: str  # for display, such as "shift x"
    unit: str  # mm, °, or empty
    scale: float  # factor from the column's values to displayed values

    @property
    def label(self) -> str:
        """Label of the parameter's axis, with the unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def parameter(column: str) -> ShownParameter:
    """Return display name and unit of a column: "shift x" in mm for workpiece.shift_m.x."""
    parts, (unit, scale) = column.split("."), ("", 1.0)
    for k, part in enumerate(parts):
        for ending, reported in UNITS.items():
            if part.endswith(ending):
                parts[k], (unit, scale) = part.removesuffix(ending), reported
    parts = parts[1:] if parts[0] in ("workpiece", "robot") else parts
    return ShownParameter(column, " ".join(parts).replace("_", " "), unit, scale)


class Range(NamedTuple):
    """Range of a number that varies: the value of a job's key, or one element of a vector."""

    key: str
    element: int | None
    low: float
    high: float

    @property
    def name(self) -> str:
        """Name of the parameter, such as workpiece.shift_m.x."""
        return self.key if self.element is None else f"{self.key}.{_element_name(self.key, self.element)}"

    @property
    def shown(self) -> ShownParameter:
        """Display name and unit of the parameter."""
        return parameter(self.name)

    @property
    def is_angle(self) -> bool:
        """True if the parameter is an angle, in any unit."""
        return self.shown.unit == "°"

    def perturbed(self, off_m: float, off_deg: float) -> float:
        """Return the largest perturbation of the parameter, in its unit in the job.

        The result is `off_m` for a length, `off_deg` for an angle, and 0 for a parameter of the task.
        """
        if self.key.startswith("task."):
            return 0.0
        return off_deg / self.shown.scale if self.is_angle else off_m


class Ranges(NamedTuple):
    """Ranges of d numbers that vary, and the fixed elements of vectors."""

    axes: tuple[Range, ...]
    fixed: dict[str, tuple[float | None, ...]]  # by key: values of a vector's elements, None if varied

    @property
    def low(self) -> Float[np.ndarray, "d"]:
        """Lower ends of the ranges, in the units in the job."""
        return np.array([axis.low for axis in self.axes])

    @property
    def width(self) -> Float[np.ndarray, "d"]:
        """Widths of the ranges, in the units in the job."""
        return np.array([axis.high - axis.low for axis in self.axes])

    def values(self, u: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Return the parameters of n mountings in the job's units.

        Args:
            u: Mountings in the unit cube.
        """
        return np.clip(self.low + u * self.width, self.low, [axis.high for axis in self.axes])  # clips rounding errors

    def columns(self, values: Float[np.ndarray, "n d"]) -> dict[str, list]:
        """Return n values for each key, for use as one axis of a grid.

        Args:
            values: Parameters of n mountings, in the units in the job.
        """
        found: dict[str, list] = {key: [list(row) for _ in values] for key, row in self.fixed.items()}
        for k, axis in enumerate(self.axes):
            if axis.element is None:
                found[axis.key] = values[:, k].tolist()
                continue
            for row, value in zip(found[axis.key], values[:, k].tolist(), strict=True):
                row[axis.element] = value
        return found


def read_ranges(where: str, raw: Mapping[str, Any], joints: Sequence[str], base: Mapping[str, Any]) -> Ranges:
    """Read the ranges of a PLACE.yaml.

    Args:
        where: The file and section, for messages.
        raw: Ranges as in the file, by key.
        joints: Names of the arm's joints.
        base: The job that the ranges vary, as a mapping.

    Raises:
        InputError: If there is no range, if a key is unknown or cannot vary, or if a range is empty or reversed.
    """
    if not raw:
        raise InputError(f"{where} is empty; it needs at least one range")
    known = grid_axes.parameters(joints)
    axes: list[Range] = []
    fixed: dict[str, tuple[float | None, ...]] = {}
    for name, value in raw.items():
        if (own := grid_axes.kind_parameter(str(name))) is not None:
            known.setdefault(str(name), own)
        _refuse_key(where, str(name), known, base)
        key, element = known[name].key, known[name].element
        default = _default(key, base)
        if element is None and isinstance(default, tuple):
            if not isinstance(value, list | tuple) or len(value) != len(default):
                raise InputError(f"{where}: {name} has {len(default)} elements; each must be a range or a number")
            fixed[key] = tuple(float(item) if _is_finite_number(item) else None for item in value)
            axes += [_read_range(where, key, k, item) for k, item in enumerate(value) if not _is_finite_number(item)]
        elif element is None:
            axes.append(_read_range(where, key, None, value))
        else:
            old = _of(base, key)
            if old is None or isinstance(old, str) or element >= len(old):
                raise InputError(f"{where}: {name}: the job's {key} has no such element")
            fixed.setdefault(key, tuple(old))
            axes.append(_read_range(where, key, element, value))
    if len({axis.name for axis in axes}) < len(axes):
        raise InputError(f"{where}: a parameter is repeated")
    if not axes:
        raise InputError(f"{where} has only numbers; at least one range [smallest, largest] is needed")
    return Ranges(tuple(axes), fixed)


def _refuse_key(where: str, name: str, known: Mapping[str, Any], base: Mapping[str, Any]) -> None:
    """Raise InputError for a key that is unknown or cannot vary."""
    if name.partition(".")[0] in grid_axes.NO_AXIS or name.startswith(PLANNERS_OWN):
        kinds = "valid: keys of the workpiece's pose, the arm's pose, its tool, the start, the task and the cell"
        raise InputError(f"{where}: {name} cannot vary in a search; {kinds}")
    if name not in known:
        close = difflib.get_close_matches(name, known, n=2, cutoff=0.6)
        hint = f"did you mean {' or '.join(close)}?" if close else "valid: keys of the job, such as workpiece.shift_m"
        raise InputError(f"{where}: unknown parameter {name}; {hint}")
    default = _default(known[name].key, base)
    is_vector = isinstance(default, tuple) and all(map(_is_finite_number, default))
    if not (isinstance(default, float) or is_vector) or (name == "start_rad" and known[name].element is None):
        raise InputError(f"{where}: {name} cannot vary in a search, because it is not a number")


def _read_range(where: str, key: str, element: int | None, value: Any) -> Range:
    name = Range(key, element, 0.0, 0.0).name
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(_is_finite_number, value)):
        raise InputError(f"{where}: {name} is {value!r}; a range must be [smallest, largest]")
    low, high = map(float, value)
    if not low < high:
        kind = "empty" if low == high else "reversed"
        raise InputError(f"{where}: {name}: the range [{low:g}, {high:g}] is {kind}")
    if not max(-low, high) <= config.LARGEST:
        raise InputError(
            f"{where}: {name}: the range is [{low:g}, {high:g}]; valid: -{config.LARGEST:g} to {config.LARGEST:g}"
        )
    return Range(key, element, low, high)


def _is_finite_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _of(base: Mapping[str, Any], key: str) -> Any:
    for part in key.split("."):
        base = base[int(part) - 1] if isinstance(base, list | tuple) else base[part]
    return base


def _default(key: str, base: Mapping[str, Any]) -> Any:
    """Return the default value of a key; for a kind of another package, the value in the job or None."""
    if key in grid_axes.KEYS:
        return grid_axes.KEYS[key]
    try:
        return _of(base, key)
    except LookupError:
        return None


def _element_name(key: str, element: int) -> str:
    return str(element + 1) if key == "start_rad" else grid_axes.XYZ[element]
