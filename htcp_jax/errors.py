"""Exceptions and warnings that users see, the wording of pydantic's errors, and parts of messages."""

import difflib
import reprlib
import shlex
import sys
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any


class InputError(ValueError):
    """Invalid input.

    The message is one line that names the invalid value and the valid choices. The command line prints it and exits
    with code 2.
    """


class Note(UserWarning):
    """Warning about an assumption that the user may want to check. The command line prints it on one line."""


class Interrupted(Exception):
    """Raised when a signal interrupts a command. The message names the saved results; `code` is the exit code."""

    def __init__(self, message: str, signal: int):
        super().__init__(message)
        self.code = 128 + signal


class Lost(Exception):
    """Raised when the worker processes or machines of a sweep are lost. The message names the saved results."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the question for a similar known name, such as "did you mean beam? "; "" if no name is similar."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"did you mean {close[0]}? " if close else ""


def install_command(extra: str) -> str:
    """Return a command that installs the libraries of an extra into this environment.

    It names them as the package's metadata does, since no package index has htcp_jax.
    """
    try:
        required = [each.split(";")[0].strip() for each in metadata.requires("htcp_jax") or () if f"'{extra}'" in each]
    except metadata.PackageNotFoundError:  # run from its source folder, without an installation
        required = ["-e", f"{Path(__file__).parents[1]}[{extra}]"]
    return shlex.join([sys.executable, "-m", "pip", "install", *required])


def mm_text(length_m: float) -> str:
    """Return a length [m] as text in millimetres."""
    return f"{1e3 * length_m:.3g} mm"


def described(error: dict[str, Any]) -> str:
    """Return the message for a pydantic error: one line with the key, its value and the valid values."""
    rows = error["loc"][:1] == ("task",) or error["loc"][:2] in _COUNTED  # their rows are counted from 1
    where = ".".join(str(part + 1 if rows and isinstance(part, int) else part) for part in error["loc"])
    known = error.get("ctx", {})
    if isinstance(known.get("error"), InputError):
        return f"{where}: {known['error']}"
    if error["type"] == "missing" and isinstance(error["loc"][-1], int):  # a list is too short
        key = ".".join(str(part) for part in error["loc"][:-1])
        return f"{key} is {reprlib.repr(error['input'])}: at least {error['loc'][-1] + 1} values are needed"
    needed = _NEEDED.get(error["type"], "").format_map(known) or error["msg"][0].lower() + error["msg"][1:]
    if error["type"] in _OF_NUMBERS:
        needed += next((f", in {unit}" for ending, unit in _UNITS.items() if where.endswith(ending)), "")
    return f"{where} is {reprlib.repr(error['input'])}: {needed}"


_COUNTED = ("cell", "obstacles"), ("workpiece", "seams")
_LIST, _SECTION = "a list is needed", "a mapping of keys to values is needed"
_NEEDED = {  # text of the valid values, by the type of pydantic's error
    "tuple_type": _LIST, "list_type": _LIST, "dict_type": _SECTION, "dataclass_type": _SECTION,
    "model_type": _SECTION, "model_attributes_type": _SECTION,
    "greater_than": "more than {gt:g} is needed", "greater_than_equal": "at least {ge:g} is needed",
    "less_than": "less than {lt:g} is needed", "less_than_equal": "at most {le:g} is allowed",
    "float_parsing": "a number is needed",
}  # fmt: skip
_OF_NUMBERS = "greater_than", "greater_than_equal", "less_than", "less_than_equal", "float_parsing"
_UNITS = {"_m_s": "m/s", "_rad_s": "rad/s", "_m": "metres", "_rad": "radians", "_deg": "degrees", "_s": "seconds"}
