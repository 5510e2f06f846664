"""Frozen dataclasses as pytrees that JAX rebuilds without calling `__init__`.

JAX also rebuilds pytrees with leaves that are not arrays: shapes, booleans, batch axes. These would fail the checks in
`__init__` and those of type annotations, so the checks run only when user code constructs an object.
"""

import dataclasses
from typing import TypeVar

import jax

LABEL = {"static": True, "label": True}
STRUCTURE = {"structure": True}
Value = TypeVar("Value")


def register_pytree(cls: type) -> type:
    """Register a dataclass as a pytree and return it. Use it as a decorator above `@dataclass(frozen=True)`.

    Fields with metadata {"static": True} are not leaves. Fields with metadata LABEL serve messages and files only.
    Fields with metadata STRUCTURE are static if they are tuples, and leaves if they are arrays: one compiled function
    then serves all their values.
    """
    fields = dataclasses.fields(cls)
    fixed = [f.name for f in fields if f.metadata.get("static")]
    either = [f.name for f in fields if f.metadata.get("structure")]
    leaves = [f.name for f in fields if f.name not in (*fixed, *either)]

    def flatten(value):
        static = [*fixed, *(name for name in either if isinstance(getattr(value, name), tuple))]
        data = [*leaves, *(name for name in either if name not in static)]
        keyed = [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in data]
        return keyed, tuple((name, getattr(value, name)) for name in static)

    def unflatten(static, children):
        value, known = object.__new__(cls), dict(static)
        data = [*leaves, *(name for name in either if name not in known)]
        for name, content in [*zip(data, children, strict=True), *static]:
            object.__setattr__(value, name, content)
        return value

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return cls


def without_labels(value: Value) -> Value:
    """Return a copy of a dataclass whose LABEL fields are empty, also those of its fields; tuples keep their lengths.

    Compiled functions do not read labels. Without them, arms and obstacles that differ only in their labels share
    executables.
    """
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    if not any(field.metadata for field in dataclasses.fields(value)):
        return value
    found = object.__new__(type(value))
    for field in dataclasses.fields(value):
        content = getattr(value, field.name)
        own = _empty(content) if field.metadata.get("label") else without_labels(content)
        object.__setattr__(found, field.name, own)
    return found


def _empty(label):
    if type(label) is tuple:
        return ("",) * len(label) if all(isinstance(each, str) for each in label) else ()
    return type(label)() if isinstance(label, str | frozenset) else None
