"""Kinds of obstacles and of task rows as dataclasses, whose numbers are data and not structure.

A kind is a frozen dataclass; its fields are the keys that a job file gives. Numbers (floats, tuples of floats) belong
to the scenario, so scenarios that differ in them share one compiled function: this gets a `Template`, which is static,
and the scenario's numbers, and makes the kind of them again. All other fields are static.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.types import Anywhere


class ExtensionKind:
    """Base class of the kinds that other packages may add.

    name: the one that jobs use; small letters, digits and hyphens. In every method, fields of numbers are arrays.
    """

    name: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field]]  # of every kind, as each is a dataclass

    def __str__(self) -> str:
        return self.name


class Slot(NamedTuple):
    """The shape of a field of numbers."""

    shape: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Template:
    """A kind with its static fields, and a `Slot` in place of each field of numbers."""

    kind: type[Any]  # derives from ExtensionKind
    fields: tuple[tuple[str, Any], ...]

    @property
    def size(self) -> int:
        """Number of numbers."""
        return sum(int(np.prod(value.shape)) for _, value in self.fields if isinstance(value, Slot))

    def with_numbers(self, numbers: Float[Anywhere, "n"]) -> Any:
        """Return the kind with these numbers, as arrays."""
        found, first = object.__new__(self.kind), 0
        for name, value in self.fields:
            if isinstance(value, Slot):
                size = int(np.prod(value.shape))
                value, first = numbers[first : first + size].reshape(value.shape), first + size
            object.__setattr__(found, name, value)
        return found


def template_of(value: ExtensionKind) -> Template:
    """Return a kind without its numbers."""
    given = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
    return Template(type(value), tuple((name, Slot(np.shape(v)) if _is_numbers(v) else v) for name, v in given))


def numbers_of(values: Sequence[ExtensionKind]) -> Float[np.ndarray, "n"]:
    """Return the numbers of kinds, one after another."""
    each = [getattr(value, field.name) for value in values for field in dataclasses.fields(value)]
    return np.concatenate([np.zeros(0), *(np.ravel(np.asarray(v, float)) for v in each if _is_numbers(v))])


def with_arrays(value: ExtensionKind) -> Any:
    """Return a kind with its numbers as arrays, as its methods expect them."""
    return template_of(value).with_numbers(numbers_of([value]))


def kind_fault(kind: Any, base: type[ExtensionKind], needed: Sequence[str]) -> str:
    """Return the reason why an object is no kind with a base class; "" if it is one.

    needed: methods of which it defines one or more.
    """
    if not (isinstance(kind, type) and issubclass(kind, base)):
        return f"it is not a class that derives from htcp_jax.{base.__name__}"
    if not (isinstance(getattr(kind, "name", None), str) and kind.name):
        return "it has no name"
    if "__dataclass_fields__" not in vars(kind) or not vars(kind)["__dataclass_params__"].frozen:
        return "it is not a dataclass; write @dataclass(frozen=True) above the class"
    if all(getattr(kind, name) is getattr(base, name) for name in needed):
        return f"it does not define {' or '.join(needed)}"
    return ""


def _is_numbers(value: Any) -> bool:
    """True for a float, and for a non-empty tuple of floats or of such tuples."""
    return isinstance(value, float | np.floating) or (
        isinstance(value, tuple) and len(value) > 0 and all(map(_is_numbers, value))
    )
