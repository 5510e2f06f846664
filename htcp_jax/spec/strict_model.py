"""Validate mappings as pydantic models. The error for an unknown key names the most similar valid key."""

import copy
import difflib
import reprlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import islice
from types import UnionType
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from htcp_jax.errors import InputError, described

FROM_1 = "task", "seams"  # keys of lists whose entries messages count from 1
MOST = 5  # maximum number of errors in a message
KIND = "kind"  # key of entries whose kind another package defines, see `given_kinds`


class FileSection(BaseModel):
    """Base class of a section of a file: immutable, with finite numbers, and without unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def validate_model(raw: dict, model: type[BaseModel], source: str) -> Any:
    """Return the instance of `model` that a mapping describes.

    Args:
        raw: The mapping; it is not modified.
        model: The pydantic model.
        source: Name of the mapping, for messages.

    Raises:
        InputError: If the mapping is invalid. The message has the first error of each key, of at most MOST keys, and
            the number of further errors.
    """
    raw = copy.deepcopy(raw)  # `refuse_unknown` modifies it
    refuse_unknown(raw, model, source)
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        found, first = error.errors(), dict[tuple[int | str, ...], str]()
        for each in found:
            first.setdefault(_key_of(each["loc"], raw), described(each))
        shown = list(first.values())[:MOST]
        others = f" (and {len(found) - len(shown)} more)" if len(found) > len(shown) else ""
        raise InputError(f"{source}: {'; '.join(shown)}{others}") from None


def _key_of(where: tuple[int | str, ...], raw: dict) -> tuple[int | str, ...]:
    """Return the key at the place of an error: one in a section, an entry of a list of sections, or one of its own."""
    value = raw.get(str(where[0])) if where else None
    has_sections = isinstance(value, dict) or (
        isinstance(value, list) and any(isinstance(each, dict) for each in value)
    )
    return where[: 1 + has_sections]


def refuse_unknown(raw: dict, model: Any, source: str, prefix: str = "") -> None:
    """Raise an error for a key of `raw` that `model` does not have, and remove empty sections from `raw`.

    Args:
        raw: A mapping, which is modified.
        model: A pydantic model, a dataclass, or a union of them, with the keys of all.
        source: Name of the mapping, for messages.
        prefix: Dotted key of the section with a final dot, such as "robot."; "" for the complete mapping.

    Raises:
        InputError: If keys are unknown, or values are true or false instead of a number. The message has at most MOST.
    """
    if found := list(islice(_unknown(raw, model, prefix, () if prefix else _keys_of(model)), MOST)):
        raise InputError(f"{source}: {'; '.join(found)}")


def _unknown(raw: dict, model: Any, prefix: str, outermost: Collection[str]) -> Iterator[str]:
    """Yield what is wrong with each key, see `refuse_unknown`; `outermost` are the keys of the complete mapping."""
    keys = _keys_of(model)
    for name, value in list(raw.items()):
        key = keys.get(name)
        if key is None:
            close = _in_sections(name, keys) or difflib.get_close_matches(str(name), keys, n=1, cutoff=0.5)
            meant = name if name in outermost else f"{prefix}{close[0]}" if close else ""
            hint = f"did you mean {meant}?" if meant else f"valid: {', '.join(keys)}"
            yield f"unknown key {prefix}{name}; {hint}"
            continue
        if value is None and key.is_section:
            del raw[name]  # a section whose lines are all commented out
            continue
        for section in key.sections:
            items = enumerate(value, int(name in FROM_1)) if isinstance(value, list) else [(None, value)]
            if key.is_mapping and isinstance(value, dict):
                items = value.items()
            for k, item in items:
                if isinstance(item, dict) and KIND not in item:
                    yield from _unknown(item, section, f"{prefix}{name}." + ("" if k is None else f"{k}."), outermost)
        if not key.sections and not key.is_truth and any(isinstance(item, bool) for item in _items(value)):
            yield f"{prefix}{name} is {reprlib.repr(value)}; it must be a number, not true or false"


class _Key(NamedTuple):
    """Type information of a model's key."""

    is_section: bool  # True if the value must be a section
    sections: tuple[Any, ...]  # types of sections that the value, or its items, may have
    is_mapping: bool  # True if the value is a mapping from names to items
    is_truth: bool  # True if the value may be true or false


def _in_sections(name: Any, keys: Mapping[str, _Key]) -> list[str]:
    """Return the dotted keys of that name in sections that are keys of a model."""
    sections = ((own, key.sections) for own, key in keys.items() if key.is_section)
    return [f"{own}.{name}" for own, parts in sections if any(name in _keys_of(part) for part in parts)]


@cache
def _keys_of(model: Any) -> dict[str, _Key]:
    kinds: dict[str, Any] = {}
    for one in get_args(model) or (model,):  # get_args: of a union
        if is_dataclass(one):
            kinds |= {field.name: field.type for field in fields(one)}
        else:
            kinds |= {name: field.annotation for name, field in one.model_fields.items()}
    return {name: _key(kind) for name, kind in kinds.items()}


def _key(kind: Any) -> _Key:
    items = get_args(kind)
    parts = kind, *(part.__origin__ if hasattr(part, "__metadata__") else part for part in items)  # of Annotated
    sections = tuple(part for part in parts if _is_section(part))
    return _Key(_is_section(kind), sections, get_origin(kind) is dict, bool in parts)


def _is_section(kind: Any) -> bool:
    if isinstance(kind, UnionType):
        return all(map(_is_section, get_args(kind)))
    return isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "model_fields"))


def _items(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else [value]
