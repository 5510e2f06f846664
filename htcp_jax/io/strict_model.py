"""Validation of mappings as pydantic models; an unknown key is an error that names the nearest valid key."""

import copy
import difflib
import reprlib
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from htcp_jax.errors import InputError, described

KIND = "kind"  # key of what another package reads, see `jobs.given_kinds`


class FileSection(BaseModel):
    """A mapping in a file. Values are immutable; numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def validate_model(raw: dict, model: type[BaseModel], source: str) -> Any:
    """Return `raw` as a `model`; `source` is its name for messages.

    Raises:
        InputError: Names the first error and the number of further ones.
    """
    raw = copy.deepcopy(raw)  # which stays as it is
    refuse_unknown(raw, model, source)
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first, *more = error.errors()
        others = f" (and {len(more)} more)" if more else ""
        raise InputError(f"{source}: {described(first)}{others}") from None


def refuse_unknown(raw: dict, model: type, source: str, prefix: str = "") -> None:
    """Refuse keys of `raw` that `model` lacks; remove sections without content.

    Args:
        raw: A mapping.
        model: A pydantic model or a dataclass.
        source: Name of the mapping, for messages.
        prefix: Dotted key of the section, with a dot.

    Raises:
        InputError: For the first unknown key, and for true and false in place of numbers.
    """
    keys = _keys_of(model)
    for name, value in list(raw.items()):
        key = keys.get(name)
        if key is None:
            close = difflib.get_close_matches(str(name), keys, n=1, cutoff=0.5)
            hint = f"did you mean {prefix}{close[0]}?" if close else f"valid: {', '.join(keys)}"
            raise InputError(f"{source}: unknown key {prefix}{name}; {hint}")
        if value is None and key.is_section:
            del raw[name]  # a section whose lines are all commented out
            continue
        for section in key.sections:
            items = enumerate(value, int(name == "task")) if isinstance(value, list) else [(None, value)]
            if key.is_mapping and isinstance(value, dict):
                items = value.items()
            for k, item in items:
                if isinstance(item, dict) and KIND not in item:
                    refuse_unknown(item, section, source, f"{prefix}{name}." + ("" if k is None else f"{k}."))
        if not key.sections and not key.is_truth and any(isinstance(item, bool) for item in _items(value)):
            raise InputError(f"{source}: {prefix}{name} is {reprlib.repr(value)}: true and false are not numbers")


class _Key(NamedTuple):
    """Type information of a model's key."""

    is_section: bool
    sections: tuple[type, ...]  # possible types of its values, or of their items
    is_mapping: bool  # to such items
    is_truth: bool  # True if it takes true and false


@cache
def _keys_of(model: type[Any]) -> dict[str, _Key]:
    kinds = (
        {field.name: field.type for field in fields(model)}
        if is_dataclass(model)
        else {name: field.annotation for name, field in model.model_fields.items()}
    )
    return {name: _key(kind) for name, kind in kinds.items()}


def _key(kind: Any) -> _Key:
    items = get_args(kind)
    parts = kind, *(part.__origin__ if hasattr(part, "__metadata__") else part for part in items)  # of Annotated
    sections = tuple(part for part in parts if _is_section(part))
    return _Key(_is_section(kind), sections, get_origin(kind) is dict, bool in parts)


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and (is_dataclass(kind) or hasattr(kind, "model_fields"))


def _items(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else [value]
