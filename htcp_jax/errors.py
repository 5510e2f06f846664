"""Exceptions and warnings that a user can cause."""

import reprlib
from typing import Any


class InputError(ValueError):
    """Bad input.

    The message is one line that names the offender and the valid choices; the command line prints it and exits with 2.
    """


class Note(UserWarning):
    """An assumption that the user may want to know. The command line prints it in one line."""


class Interrupted(Exception):
    """A signal ended the work. The message names the results that were kept; `code` is the command's exit code."""

    def __init__(self, message: str, signal: int):
        super().__init__(message)
        self.code = 128 + signal


class Lost(Exception):
    """The machines that did the work are gone. The message names the results that were kept."""


def described(error: dict[str, Any]) -> str:
    """Return one of pydantic's errors as a line that names the key, its value and what is needed."""
    rows = error["loc"][:1] == ("task",) or error["loc"][:2] == ("cell", "obstacles")  # counted from 1, as in --set
    where = ".".join(str(part + 1 if rows and isinstance(part, int) else part) for part in error["loc"])
    known = error.get("ctx", {})
    if isinstance(known.get("error"), InputError):
        return f"{where}: {known['error']}"
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # a list is too short
        key = ".".join(str(part) for part in error["loc"][:-1])
        return f"{key} is {reprlib.repr(error['input'])}: {error['loc'][-1] + 1} values or more are needed"
    needed = _NEEDED.get(error["type"], "").format_map(known) or error["msg"][0].lower() + error["msg"][1:]
    return f"{where} is {reprlib.repr(error['input'])}: {needed}"


_LIST, _SECTION = "a list is needed", "a section is needed, keys with their values"
_NEEDED = {  # for errors that pydantic describes in terms of Python's types
    "tuple_type": _LIST, "list_type": _LIST, "dict_type": _SECTION, "dataclass_type": _SECTION,
    "model_type": _SECTION, "model_attributes_type": _SECTION,
    "greater_than": "more than {gt:g} is needed", "greater_than_equal": "at least {ge:g} is needed",
    "less_than": "less than {lt:g} is needed", "less_than_equal": "at most {le:g} is allowed",
}  # fmt: skip
