"""Mappings as values of pydantic models. Unknown keys are errors that name the nearest valid key."""

import copy
import difflib
import reprlib
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from htcp_jax.errors import InputError


class Section(BaseModel):
    """A mapping in the file. Values are immutable; numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def validate(raw: dict, model: type[BaseModel], source: str) -> Any:
    """`raw` as a `model`. Raises InputError that names the first offender and how many more there are."""
    raw = copy.deepcopy(raw)  # which stays as it is
    refuse_unknown(raw, model, source)
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first, *more = error.errors()
        others = f" (and {len(more)} more)" if more else ""
        raise InputError(f"{source}: {_message(first)}{others}") from None


def refuse_unknown(raw: dict, model: type, source: str, prefix: str = "") -> None:
    """Raise InputError for the first key of `raw` that `model`, a pydantic model or a dataclass, lacks.

    A model may have a static method `with_new_names(mapping, source)`, for keys that have been renamed."""
    kinds = (
        {field.name: field.type for field in fields(model)}
        if is_dataclass(model)
        else {name: field.annotation for name, field in model.model_fields.items()}
    )
    if (with_new_names := getattr(model, "with_new_names", None)) is not None:
        new = with_new_names(raw, source)
        raw.clear()
        raw.update(new)
    for key, value in list(raw.items()):
        if key not in kinds:
            close = difflib.get_close_matches(str(key), kinds, n=1, cutoff=0.5)
            hint = f"did you mean {prefix}{close[0]}?" if close else f"valid: {', '.join(kinds)}"
            raise InputError(f"{source}: unknown key {prefix}{key}; {hint}")
        if value is None and _is_section(kinds[key]):
            del raw[key]  # a section whose lines are all commented out
            continue
        sections = [kind for kind in (kinds[key], *get_args(kinds[key])) if _is_section(kind)]
        for section in sections:
            items = enumerate(value, int(key == "task")) if isinstance(value, list) else [(None, value)]
            if get_origin(kinds[key]) is dict and isinstance(value, dict):
                items = value.items()
            for k, item in items:
                if isinstance(item, dict):
                    refuse_unknown(item, section, source, f"{prefix}{key}." + ("" if k is None else f"{k}."))
        is_bool = bool in (kinds[key], *get_args(kinds[key]))
        if not sections and not is_bool and any(isinstance(item, bool) for item in _items(value)):
            raise InputError(f"{source}: {prefix}{key} is {reprlib.repr(value)}: true and false are no numbers")


def _is_section(kind: Any) -> bool:
    return is_dataclass(kind) or hasattr(kind, "model_fields")


def _items(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else [value]


def _message(error: dict) -> str:
    """One pydantic error in our words."""
    rows = error["loc"][:1] == ("task",)  # which are counted from 1, as in --set
    where = ".".join(str(part + 1 if rows and isinstance(part, int) else part) for part in error["loc"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return f"{where}.{cause}" if where == "settings" else f"{where}: {cause}"
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # of a list, which is too short
        key = ".".join(str(part) for part in error["loc"][:-1])
        return f"{key} is {reprlib.repr(error['input'])}: {error['loc'][-1] + 1} values or more are needed"
    return f"{where} is {reprlib.repr(error['input'])}: {error['msg'][0].lower()}{error['msg'][1:]}"
