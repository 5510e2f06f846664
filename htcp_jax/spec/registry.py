"""Registries of extensions: planning methods, kinds of obstacles, kinds of task rows.

A package provides an extension by an entry point. The entry point's name is used in jobs and commands:

    [project.entry-points."htcp_jax.obstacles"]
    ball = "my_package:Ball"

The extension is then available to every command, to job files and to Ray's workers. `htcp_jax.register` adds an
extension to this process only. An extension is imported when its name is looked up, or when all are listed.
"""

import re
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from htcp_jax.errors import InputError, did_you_mean

NAME = re.compile(r"[a-z0-9-]+")  # valid names; they are used in names of files and folders


class Registry:
    """Extensions of one type (such as planning methods), by name.

    They are built in, from installed packages, or registered in this process.

    Args:
        group: Name of the entry point group.
        noun: Singular noun for an extension of this type, for messages.
        fault: Function that returns the reason why an object is invalid; "" if it is valid.
        built_in: Built-in extensions by name, or only their names, if they are not looked up in the registry.
    """

    def __init__(
        self,
        group: str,
        noun: str,
        fault: Callable[[Any], str],
        built_in: Mapping[str, Any] | Collection[str] = (),
    ):
        self.group, self.noun, self._fault, self._built_in = group, noun, fault, built_in
        self._own: dict[str, Any] = {}  # registered in this process
        # built in, or loaded from entry points
        self._loaded: dict[str, Any] = dict(built_in) if isinstance(built_in, Mapping) else {}

    def register(self, value: Any) -> Any:
        """Register an extension in this process, and return it. Ray's workers do not find it.

        Raises:
            InputError: If the extension is incomplete, or if its name is in use or has an invalid character.
        """
        if fault := self._why_not(value):
            raise InputError(f"cannot register {value!r}: {fault}")
        if self._own.get(value.name) is not value and value.name in self.names() and not self._replaces(value):
            raise InputError(
                f"cannot register {value.name!r}: {self._a_noun} with this name exists: {self._origin(value.name)}"
            )
        self._own[value.name] = value
        return value

    def names(self) -> tuple[str, ...]:
        """Return the names of all extensions: built-in ones, then those of packages, then those of this process."""
        return tuple(dict.fromkeys((*self._built_in, *self._entry_points, *self._own)))

    def find(self, name: str) -> Any:
        """Return the extension with this name; import it if necessary.

        Raises:
            InputError: If the name is unknown, or if the extension cannot be imported or is invalid.
        """
        if name in self._own:
            return self._own[name]
        if name not in self._loaded:
            self.refuse_unknown(name)
            self._loaded[name] = self._load(self._entry_points[name])
        return self._loaded[name]

    def refuse_unknown(self, name: str) -> None:
        """Raise InputError if no extension has this name. Nothing is imported."""
        if name not in (known := self.names()):
            what = f"{name!r} is not {self._a_noun}; {did_you_mean(name, known)}"
            raise InputError(f"{what}valid: {', '.join(known) or 'none is installed'}")

    def added(self) -> dict[str, Any]:
        """Return all added extensions by name. Those that cannot be imported are excluded, with a UserWarning."""
        found = {}
        for name in filter(self.is_added, self.names()):
            try:
                found[name] = self.find(name)
            except InputError as error:
                warnings.warn(str(error), UserWarning, stacklevel=2)
        return found

    def is_own(self, name: str) -> bool:
        """True if the name is registered in this process only; Ray's workers and other processes cannot find it."""
        return name in self._own

    def is_shared(self, value: Any) -> bool:
        """True if other processes find the same added extension by its name."""
        return value.name in self._entry_points and not self.is_own(value.name) and self.find(value.name) is value

    def refuse_own(self, chosen: Iterable[str]) -> None:
        """Raise InputError if one of the chosen names is registered in this process only."""
        for name in chosen:
            if self.is_own(name):
                raise InputError(
                    f"{self.noun} {name!r} is registered only in this process; for remote workers, install a package "
                    f"with an entry point in the group {self.group}"
                )

    def is_added(self, name: str) -> bool:
        """True if the extension is not built in: it is from an installed package or registered in this process."""
        return name not in self._built_in and (name in self._own or name in self._entry_points)

    def distribution(self, name: str) -> str | None:
        """Return the distribution with its version that provides an extension, such as "my-package 1.2.0".

        None for extensions that are built in or registered in this process.
        """
        if self.is_own(name) or name not in self._entry_points:
            return None
        point = self._entry_points[name]
        return _package(point) if point.dist is None else f"{point.dist.name} {point.dist.version}"

    @cached_property
    def _entry_points(self) -> dict[str, EntryPoint]:
        """Entry points of installed packages, by name.

        Built-in names take precedence. If two packages use one name, the first package in alphabetical order wins.
        """
        found: dict[str, EntryPoint] = {}
        for point in sorted(entry_points(group=self.group), key=lambda point: (point.name, _package(point))):
            first = found.get(point.name)
            if point.name in self._built_in:
                self._left_out(point, "a built-in one")
            elif first is None or first.value == point.value:  # new, or the same package found twice
                found[point.name] = first or point
            else:
                self._left_out(point, f"one of {_package(first)}")
        return found

    def _origin(self, name: str) -> str:
        """Return where an extension comes from, for messages."""
        if name in self._own:
            return f"{self._own[name]!r}, registered in this process"
        if name not in self._entry_points:
            return "it is built in"
        point = self._entry_points[name]
        return f"the entry point {point.value} of the installed package {self.distribution(name)}"

    def _left_out(self, point: EntryPoint, there: str) -> None:
        line = f"{self._called(point)} is ignored, because {there} has the same name"
        warnings.warn(line, UserWarning, stacklevel=5)

    def _load(self, point: EntryPoint) -> Any:
        try:
            value = point.load()
        except Exception as error:  # importing a package may raise anything
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{self._called(point)} cannot be imported: {reason}") from error
        if fault := self._why_not(value):
            raise InputError(f"{self._called(point)} is not {self._a_noun}: {fault}")
        if value.name != point.name:
            raise InputError(f"{self._called(point)} has the name {value.name!r}; both names must be equal")
        return value

    def _replaces(self, value: Any) -> bool:
        """True if a class redefines a registered one of equal module and name, as when a notebook cell runs again."""
        own = self._own.get(value.name)
        if not (isinstance(own, type) and isinstance(value, type)):
            return False
        return (own.__module__, own.__qualname__) == (value.__module__, value.__qualname__)

    def _why_not(self, value: Any) -> str:
        if fault := self._fault(value):
            return fault
        if not NAME.fullmatch(value.name):
            return f"the name {value.name!r} must consist of lower-case letters, digits and hyphens"
        return ""

    def _called(self, point: EntryPoint) -> str:
        return f"the {self.noun} {point.name!r} (entry point {point.value} of package {_package(point)})"

    @property
    def _a_noun(self) -> str:
        return f"{'an' if self.noun[0] in 'aeiou' else 'a'} {self.noun}"


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "unknown"
