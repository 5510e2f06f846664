"""Frozen dataclasses as pytrees, rebuilt without a call of `__init__`.

JAX rebuilds pytrees with leaves that are not arrays: shapes, booleans, batch axes. The checks of `__init__` and of the
type annotations apply when a robot or a scenario is constructed, not in these passes.
"""

import dataclasses
from typing import TypeVar

import jax

LABEL = {"static": True, "label": True}
Value = TypeVar("Value")


def register_pytree(cls: type) -> type:
    """Register a dataclass as a pytree: a class decorator above `@dataclass(frozen=True)`.

    Fields with metadata {"static": True} are not leaves; those with LABEL serve messages and files only.
    """
    fields = dataclasses.fields(cls)
    leaves = [f.name for f in fields if not f.metadata.get("static")]
    static = [f.name for f in fields if f.metadata.get("static")]

    def flatten(value):
        keyed = [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in leaves]
        return keyed, tuple(getattr(value, name) for name in static)

    def unflatten(fixed, children):
        value = object.__new__(cls)
        for name, content in zip([*leaves, *static], [*children, *fixed], strict=True):
            object.__setattr__(value, name, content)
        return value

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return cls


def without_labels(value: Value) -> Value:
    """Return a dataclass whose labels are empty: as many names as before, but empty ones, and nothing else.

    Compiled functions do not read labels; without them, arms and obstacles that differ in labels only share
    executables.
    """
    if not dataclasses.is_dataclass(value):
        return value
    found = object.__new__(type(value))
    for field in dataclasses.fields(value):
        content = getattr(value, field.name)
        object.__setattr__(found, field.name, _empty(content) if field.metadata.get("label") else content)
    return found


def _empty(label):
    if type(label) is tuple:
        return ("",) * len(label) if all(isinstance(each, str) for each in label) else ()
    return "" if isinstance(label, str) else None
