"""Ranges of the job parameters that a search varies.

    workpiece.rotation_y_rad: [0.0, 1.0]                          # a number
    workpiece.shift_m: [[-0.2, 0.2], [-0.2, 0.2], 0.0]            # a vector, element by element; a number stays

A mounting is a point of the unit cube, an axis a number that varies; `Ranges.columns` turns points into the axis of a
grid, see `jobs.grid`.
"""

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.jobs import config, grid_axes

PLANNERS_OWN = ("settings.", "margin_m", "workpiece.interior", "workpiece.mesh", "workpiece.tip_contact_m",
                "workpiece.inlet", "workpiece.approach")  # fmt: skip
UNITS = {"_m": ("mm", 1e3), "_rad": ("°", 180 / math.pi), "_deg": ("°", 1.0)}


class Range(NamedTuple):
    """A number that varies: the value of a key, or one element of it."""

    key: str
    element: int | None
    low: float
    high: float

    @property
    def name(self) -> str:
        """Name of the parameter, such as workpiece.shift_m.x."""
        return self.key if self.element is None else f"{self.key}.{_element_name(self.key, self.element)}"

    @property
    def unit(self) -> tuple[str, float]:
        """Unit for display, and the factor that converts to it."""
        return next((unit for ending, unit in UNITS.items() if self.key.endswith(ending)), ("", 1.0))

    @property
    def is_angle(self) -> bool:
        """True if it is an angle, in any unit."""
        return self.unit[0] == "°"

    def perturbed(self, off_m: float, off_deg: float) -> float:
        """Half the width of the box of perturbations, in the parameter's own unit.

        It is off_m for a length, off_deg for an angle, and 0 for parameters of the task, which are never perturbed.
        """
        if self.key.startswith("task."):
            return 0.0
        return off_deg / self.unit[1] if self.is_angle else off_m


class Ranges(NamedTuple):
    """d numbers that vary, and the fixed elements of their vectors."""

    axes: tuple[Range, ...]
    fixed: dict[str, tuple[float | None, ...]]  # of a key with elements: values of the fixed ones

    @property
    def low(self) -> Float[np.ndarray, "d"]:
        """Smallest values, in the job's own units."""
        return np.array([axis.low for axis in self.axes])

    @property
    def width(self) -> Float[np.ndarray, "d"]:
        """Largest minus smallest values."""
        return np.array([axis.high - axis.low for axis in self.axes])

    def values(self, u: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Mountings in the job's own units."""
        return np.clip(self.low + u * self.width, self.low, [axis.high for axis in self.axes])  # rounding stays inside

    def columns(self, values: Float[np.ndarray, "n d"]) -> dict[str, list]:
        """Values of every key, mounting by mounting: one axis of a grid."""
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
        raw: Key -> range.
        joints: Names of the arm's joints.
        base: The job that the ranges vary, as a mapping.

    Raises:
        InputError: If there is no range, for an unknown key, one that cannot vary, and a range that is empty or
            reversed.
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
                raise InputError(f"{where}: {name} has {len(default)} elements; each is a range or a number")
            fixed[key] = tuple(float(item) if _is_finite_number(item) else None for item in value)
            axes += [_read_range(where, key, k, item) for k, item in enumerate(value) if not _is_finite_number(item)]
        elif element is None:
            axes.append(_read_range(where, key, None, value))
        else:
            old = _of(base, key)
            if old is None or isinstance(old, str) or element >= len(old):
                raise InputError(f"{where}: {name}: {key} of the job has no such element")
            fixed.setdefault(key, tuple(old))
            axes.append(_read_range(where, key, element, value))
    if len({axis.name for axis in axes}) < len(axes):
        raise InputError(f"{where}: a parameter is repeated")
    if not axes:
        raise InputError(f"{where} has no range, only numbers")
    return Ranges(tuple(axes), fixed)


def _refuse_key(where: str, name: str, known: Mapping[str, Any], base: Mapping[str, Any]) -> None:
    """Raise InputError for a key that is unknown or cannot vary."""
    if name.partition(".")[0] in grid_axes.NO_AXIS or name.startswith(PLANNERS_OWN):
        kinds = "the workpiece's pose, the arm's, its tool, the start, the task and the cell can"
        raise InputError(f"{where}: {name} cannot vary in a search; {kinds}")
    if name not in known:
        close = difflib.get_close_matches(name, known, n=2, cutoff=0.6)
        hint = (
            f"did you mean {' or '.join(close)}?" if close else "valid: keys of the job, workpiece.shift_m for example"
        )
        raise InputError(f"{where}: unknown parameter {name}; {hint}")
    default = _default(known[name].key, base)
    is_vector = isinstance(default, tuple) and all(map(_is_finite_number, default))
    if not (isinstance(default, float) or is_vector) or (name == "start_rad" and known[name].element is None):
        raise InputError(
            f"{where}: {name} cannot vary in a search: it is not a number that could lie between two others"
        )


def _read_range(where: str, key: str, element: int | None, value: Any) -> Range:
    name = Range(key, element, 0.0, 0.0).name
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(_is_finite_number, value)):
        raise InputError(f"{where}: {name} is {value!r}; a range is [smallest, largest]")
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
    """Return the default of a key; of a kind of another package the job's own value, None if it has none."""
    if key in grid_axes.KEYS:
        return grid_axes.KEYS[key]
    try:
        return _of(base, key)
    except LookupError:
        return None


def _element_name(key: str, element: int) -> str:
    return str(element + 1) if key == "start_rad" else grid_axes.XYZ[element]
