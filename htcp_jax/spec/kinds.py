"""Kinds of obstacles and of task rows: frozen dataclasses whose fields are the keys in a job file.

Numeric fields (floats, tuples of floats) are data of the scenario; all other fields are static. A compiled function
gets a static `Template` and the scenario's numbers, and rebuilds the instance from them. Scenarios that differ only in
numbers therefore share one compiled function.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.types import Anywhere


class ExtensionKind:
    """Base class of `ObstacleKind` and `TaskRowKind`, of which other packages may define subclasses.

    `name` is the kind's name in job files: lowercase letters, digits and hyphens. The numeric fields contain arrays
    when a method is called.
    """

    name: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field]]  # every kind is a dataclass

    def __str__(self) -> str:
        return self.name


class Slot(NamedTuple):
    """Placeholder for a numeric field in a `Template`, with the shape of its value."""

    shape: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Template:
    """An instance of a kind without its numbers: static fields, and a `Slot` in place of each numeric field."""

    kind: type[Any]  # a subclass of ExtensionKind
    fields: tuple[tuple[str, Any], ...]

    @property
    def size(self) -> int:
        """Total number of scalars in the numeric fields."""
        return sum(int(np.prod(value.shape)) for _, value in self.fields if isinstance(value, Slot))

    def with_numbers(self, numbers: Float[Anywhere, "n"]) -> Any:
        """Return an instance of the kind whose numeric fields are arrays filled from `numbers`."""
        found, first = object.__new__(self.kind), 0
        for name, value in self.fields:
            if isinstance(value, Slot):
                size = int(np.prod(value.shape))
                value, first = numbers[first : first + size].reshape(value.shape), first + size
            object.__setattr__(found, name, value)
        return found


def template_of(value: ExtensionKind) -> Template:
    """Return the template of an instance: its static fields, and the shapes of its numeric fields."""
    given = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    return Template(type(value), tuple((name, Slot(np.shape(v)) if _is_numbers(v) else v) for name, v in given))


def numbers_of(values: Sequence[ExtensionKind]) -> Float[np.ndarray, "n"]:
    """Return the numbers of several instances in one array, in the order of their fields."""
    each = [getattr(value, field.name) for value in values for field in dataclasses.fields(value)]
    return np.concatenate([np.zeros(0), *(np.ravel(np.asarray(v, float)) for v in each if _is_numbers(v))])


def with_arrays(value: ExtensionKind) -> Any:
    """Return a copy of an instance whose numeric fields are arrays, as the methods of a kind require."""
    return template_of(value).with_numbers(numbers_of([value]))


def kind_fault(kind: Any, base: type[ExtensionKind], needed: Sequence[str]) -> str:
    """Return the reason why a class is not a valid kind; "" if it is valid.

    Args:
        kind: The class to check; any object is allowed.
        base: The required base class.
        needed: Names of methods; the class must define at least one of them.
    """
    if not (isinstance(kind, type) and issubclass(kind, base)):
        return f"it is not a class that derives from htcp_jax.{base.__name__}"
    if not (isinstance(getattr(kind, "name", None), str) and kind.name):
        return "it has no name; set its class attribute `name`"
    if "__dataclass_fields__" not in vars(kind) or not vars(kind)["__dataclass_params__"].frozen:
        return "it is not a dataclass; decorate it with @dataclass(frozen=True)"
    if all(getattr(kind, name) is getattr(base, name) for name in needed):
        return f"it does not define {' or '.join(needed)}"
    return ""


def _is_numbers(value: Any) -> bool:
    """True for a float and for a non-empty tuple of floats; tuples may be nested."""
    return isinstance(value, float | np.floating) or (
        isinstance(value, tuple) and len(value) > 0 and all(map(_is_numbers, value))
    )
