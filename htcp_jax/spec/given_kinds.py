"""Reading and writing of obstacles and task rows: {kind: NAME, KEY: VALUE, ...}; built-in task rows have no kind."""

import dataclasses
import math
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

from pydantic import PlainSerializer, PlainValidator, TypeAdapter, ValidationError, WrapValidator

from htcp_jax.errors import InputError, described
from htcp_jax.spec import obstacle_kind, strict_model, task_list, tool_angles
from htcp_jax.spec.kinds import ExtensionKind
from htcp_jax.spec.registry import Registry
from htcp_jax.spec.task_row_kind import TaskRowKind


def kind_validator(registry: Registry, base: type[ExtensionKind]) -> Callable[[Any, Callable], Any]:
    """Return a pydantic validator for an entry that names a kind in `registry`, or is an instance of `base`.

    Any other entry is validated by the next validator.
    """

    def read(value: Any, other: Callable) -> Any:
        if isinstance(value, dict) and strict_model.KIND in value:
            return _made(registry.find(str(value[strict_model.KIND])), value)
        return _checked_kind(value) if isinstance(value, base) else other(value)

    return read


def built_in_row(value: Any) -> task_list.BuiltInRow:
    """Return the task row of an entry without the key kind.

    Raises:
        InputError: See `task_list.built_in_class`.
        ValidationError: For an invalid value.
    """
    row, keys = task_list.built_in_class(value) if isinstance(value, dict) else (task_list.PointRow, value)
    return _adapter(row).validate_python(keys)


def needs_kind(value: Any) -> Any:
    """Return an obstacle unchanged; raise InputError if it has no kind."""
    if not isinstance(value, obstacle_kind.ObstacleKind):
        valid = ", ".join(obstacle_kind.OBSTACLES.names()) or "none is installed (clouds belong in cell.clouds)"
        raise InputError(f"{value!r} is not an obstacle; it must be {{kind: NAME, ...}}; valid names: {valid}")
    return value


def record_of(value: ExtensionKind) -> dict[str, Any]:
    """Return an instance of a kind as a plain mapping for JSON and YAML."""
    first = task_list.RECORD if isinstance(value, task_list.BuiltInRow) else {strict_model.KIND: value.name}
    return {**first, **_values(value)}


def _values(value: ExtensionKind) -> dict[str, Any]:
    return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}


def _made(kind: type[ExtensionKind], raw: dict) -> ExtensionKind:
    """Return an instance of a kind from its mapping; raise InputError for an unknown key or an invalid value."""
    given = {key: value for key, value in raw.items() if key != strict_model.KIND}
    strict_model.refuse_unknown(given, kind, f"kind {kind.name}")
    try:
        return _finite_kind(_adapter(kind).validate_python(given))
    except ValidationError as error:
        raise InputError(f"kind {kind.name}: {described(error.errors()[0])}") from None


def _checked_kind(value: ExtensionKind) -> ExtensionKind:
    """Return an instance made in Python, with its values validated and converted to the types of its fields."""
    return _made(type(value), _values(value))


def _finite_kind(value: ExtensionKind) -> ExtensionKind:
    for name, numbers in _values(value).items():
        for number in numbers if isinstance(numbers, tuple) else [numbers]:
            if isinstance(number, float) and not math.isfinite(number):
                raise InputError(f"kind {value.name}: {name} is {number}; it must be finite")
    return value


@cache
def _adapter(kind: type[ExtensionKind]) -> TypeAdapter:
    return TypeAdapter(kind)


# An entry of a task. A row with the key kind has a kind from another package; one without is a built-in row.
Row = Annotated[
    task_list.PointRow | task_list.AxisRow | task_list.OrientationRow | tool_angles.ToolAxisRow,
    PlainValidator(built_in_row),
    WrapValidator(kind_validator(task_list.TASK_ROWS, TaskRowKind)),
    PlainSerializer(record_of),
]
