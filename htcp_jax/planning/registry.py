"""Registry of methods by name: built-in ones, those of other packages, and those of this process.

A package provides a method by an entry point in the group `htcp_jax.methods`, whose name is the method's:

    [project.entry-points."htcp_jax.methods"]
    my-planner = "my_package:MY_PLANNER"

It is then available to every command, to job files and to Ray's workers. `register` adds a method to this process only.
Methods are imported when a name is looked up or listed, not before.
"""

import re
import warnings
from collections.abc import Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from htcp_jax.errors import InputError

if TYPE_CHECKING:
    from htcp_jax.motion.plans import Plans
    from htcp_jax.motion.problem import Problem

GROUP = "htcp_jax.methods"
BUILT_IN = EntryPoint("built-in", "htcp_jax.planning.methods:BUILT_IN", GROUP)
NAME = re.compile(r"[a-z0-9-]+")  # used in names of files and folders


@runtime_checkable
class Method(Protocol):
    """A planner.

    With the attribute `smooth = True` its motions are smoothed unless the settings say otherwise. An optional method
    `first_calls(problem)` returns the lane functions that it will call, see `Kernels.preparing`.
    """

    @property
    def name(self) -> str:
        """Name on the command line and in file names: lower-case letters, digits and hyphens."""

    @property
    def title(self) -> str:
        """Column heading in tables."""

    @property
    def description(self) -> str:
        """Short description of the method."""

    def plan(self, problem: "Problem") -> "Plans":
        """Plan every scenario of the problem; begin with `problem.empty_plans()`.

        A target that is not tracked ends its scenario, and its status gives the reason. Results may depend only on the
        problem, and on `problem.settings.seed` if they are random.

        Raises:
            InputError: For a problem that the method cannot plan.
        """


_own: dict[str, Method] = {}  # of this process
_loaded: dict[str, Method] = {}  # of entry points


def register(method: Any) -> Any:
    """Register a `Method` in this process, for `htcp_jax.plan`, `sweep`, `methods` and all else but Ray's workers.

    Returns:
        The method.

    Raises:
        InputError: For a method that lacks a name, a title, a description or `plan`, for a name that is not valid in
            file names, and for a name that is taken.
    """
    if fault := _fault(method):
        raise InputError(f"cannot register {method!r}: {fault}")
    if _own.get(method.name) is not method and method.name in names():
        raise InputError(f"cannot register {method.name!r}: there is a method of that name")
    _own[method.name] = method
    return method


def unregister(name: str) -> None:
    """Remove a method registered in this process.

    Raises:
        InputError: For any other name.
    """
    if name not in _own:
        raise InputError(f"{name!r} is not registered in this process")
    del _own[name]


def names() -> tuple[str, ...]:
    """Return the names of all methods: built-in ones in order, then those of packages, then those of this process."""
    return (*_built_in(), *_entry_points(), *_own)


def find(name: str) -> Method:
    """Return the method with that name.

    Raises:
        InputError: For an unknown name, and for a method that cannot be imported; names its entry point and package.
    """
    if name in _built_in():
        return _built_in()[name]
    if name in _own:
        return _own[name]
    if name not in _entry_points():
        raise InputError(f"{name!r} is no method; valid: {', '.join(names())}")
    if name not in _loaded:
        _loaded[name] = _load(_entry_points()[name])
    return _loaded[name]


def all_methods() -> dict[str, Method]:
    """Return every method by its name; one that cannot be imported is excluded, with a UserWarning."""
    found = {}
    for name in names():
        try:
            found[name] = find(name)
        except InputError as error:
            warnings.warn(str(error), UserWarning, stacklevel=2)
    return found


def is_own(name: str) -> bool:
    """Return True if the method is registered in this process only, so that other processes cannot find it."""
    return name in _own


def refuse_own(chosen: Iterable[str]) -> None:
    """Check that other processes can find the methods.

    Raises:
        InputError: For a method that is registered in this process only.
    """
    for name in chosen:
        if is_own(name):
            raise InputError(
                f"method {name!r} is registered in this process alone; workers elsewhere know those of installed "
                f"packages, by the entry point group {GROUP}"
            )


@cache
def _built_in() -> dict[str, Method]:
    return {method.name: method for method in BUILT_IN.load()}


@cache
def _entry_points() -> dict[str, EntryPoint]:
    """Return the entry points of installed packages by name; built-in ones and the first of two with one name win."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: (point.name, _package(point))):
        first = found.get(point.name, BUILT_IN if point.name in _built_in() else point)
        if first.value == point.value:  # itself, or the same package found twice
            found[point.name] = first
        else:
            there = "one that ships" if first is BUILT_IN else f"one of {_package(first)}"
            warnings.warn(f"{_called(point)} is left out: there is {there} of that name", UserWarning, stacklevel=3)
    return found


def _load(point: EntryPoint) -> Method:
    try:
        method = point.load()
    except Exception as error:  # whatever the import of a package may raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{_called(point)} cannot be imported: {reason}") from error
    if fault := _fault(method):
        raise InputError(f"{_called(point)} is no method: {fault}")
    if method.name != point.name:
        raise InputError(f"{_called(point)} calls itself {method.name!r}")
    return method


def _called(point: EntryPoint) -> str:
    return f"the method {point.name!r} (entry point {point.value} of package {_package(point)})"


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "unknown"


def _fault(method: Any) -> str:
    """Return the reason why an object is not a method; empty if it is one."""
    if isinstance(method, type):
        return "it is a class, not an instance of one"
    for key in ("name", "title", "description"):
        if not (isinstance(getattr(method, key, None), str) and getattr(method, key)):
            return f"it has no {key}"
    if not callable(getattr(method, "plan", None)):
        return "it has no plan(problem)"
    if not NAME.fullmatch(method.name):
        return f"the name {method.name!r} has more in it than small letters, digits and hyphens"
    return ""
