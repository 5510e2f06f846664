"""Registries of what other packages may add: planning methods, kinds of obstacles, kinds of task rows.

A package provides one by an entry point, whose name is the one that jobs and commands use:

    [project.entry-points."htcp_jax.obstacles"]
    ball = "my_package:Ball"

It is then available to every command, to job files and to Ray's workers. `htcp_jax.register` adds one to this process
only. Nothing is imported before a name is looked up or listed.
"""

import re
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from htcp_jax.errors import InputError

NAME = re.compile(r"[a-z0-9-]+")  # used in names of files and folders


class Registry:
    """Objects by name: built-in ones, those of installed packages, and those of this process.

    Args:
        group: The entry points' group.
        noun: The word for one of them in messages.
        fault: Returns the reason why an object is none of them; "" if it is one.
        built_in: Returns those that ship, by name.
    """

    def __init__(
        self,
        group: str,
        noun: str,
        fault: Callable[[Any], str],
        built_in: Callable[[], Mapping[str, Any]] = dict,
    ):
        self.group, self._noun, self._fault, self._load_built_in = group, noun, fault, built_in
        self._own: dict[str, Any] = {}  # of this process
        self._loaded: dict[str, Any] = {}  # of entry points

    def register(self, value: Any) -> Any:
        """Register an object in this process: for everything but Ray's workers.

        Returns it. Raises InputError for one that is incomplete, for a name that is not valid in file names, and for a
        name that is taken.
        """
        if fault := self._why_not(value):
            raise InputError(f"cannot register {value!r}: {fault}")
        if self._own.get(value.name) is not value and value.name in self.names() and not self._replaces(value):
            raise InputError(f"cannot register {value.name!r}: there is {self._a_noun} of that name")
        self._own[value.name] = value
        return value

    def unregister(self, name: str) -> None:
        """Remove what was registered in this process. Raises InputError for any other name."""
        if name not in self._own:
            raise InputError(f"{name!r} is not registered in this process")
        del self._own[name]

    def names(self) -> tuple[str, ...]:
        """Return all names: built-in ones in their order, then those of packages, then those of this process."""
        return tuple(dict.fromkeys((*self._built_in, *self._entry_points, *self._own)))

    def find(self, name: str) -> Any:
        """Return the object with that name.

        Raises InputError for an unknown name, and for an object that cannot be imported, naming its entry point and
        package.
        """
        if name in self._built_in:
            return self._built_in[name]
        if name in self._own:
            return self._own[name]
        self.refuse_unknown(name)
        if name not in self._loaded:
            self._loaded[name] = self._load(self._entry_points[name])
        return self._loaded[name]

    def refuse_unknown(self, name: str) -> None:
        """Raise InputError for an unknown name. Nothing is imported."""
        if name not in self.names():
            raise InputError(f"{name!r} is not {self._a_noun}; valid: {', '.join(self.names()) or 'none is installed'}")

    def all(self, without: Collection[str] = ()) -> dict[str, Any]:
        """Return everything by its name. What cannot be imported is excluded, with a UserWarning.

        Args:
            without: Names that are not looked up.
        """
        found = {}
        for name in (name for name in self.names() if name not in without):
            try:
                found[name] = self.find(name)
            except InputError as error:
                warnings.warn(str(error), UserWarning, stacklevel=2)
        return found

    def is_own(self, name: str) -> bool:
        """True if it is registered in this process only, so that other processes cannot find it."""
        return name in self._own

    def is_shared(self, value: Any) -> bool:
        """True if other processes find this very object by its name."""
        return value.name in self.names() and not self.is_own(value.name) and self.find(value.name) is value

    def refuse_own(self, chosen: Iterable[str]) -> None:
        """Raise InputError for a name that other processes cannot find."""
        for name in chosen:
            if self.is_own(name):
                raise InputError(
                    f"{self._noun} {name!r} is registered in this process alone; workers elsewhere know those of "
                    f"installed packages, by the entry point group {self.group}"
                )

    @cached_property
    def _built_in(self) -> Mapping[str, Any]:
        return self._load_built_in()

    @cached_property
    def _entry_points(self) -> dict[str, EntryPoint]:
        """Entry points of installed packages, by name.

        Built-in ones take precedence, and the first of two with one name.
        """
        found: dict[str, EntryPoint] = {}
        for point in sorted(entry_points(group=self.group), key=lambda point: (point.name, _package(point))):
            first = found.get(point.name)
            if point.name in self._built_in:
                self._left_out(point, "one that ships")
            elif first is None or first.value == point.value:  # new, or the same package found twice
                found[point.name] = first or point
            else:
                self._left_out(point, f"one of {_package(first)}")
        return found

    def _left_out(self, point: EntryPoint, there: str) -> None:
        line = f"{self._called(point)} is excluded: there is {there} of that name"
        warnings.warn(line, UserWarning, stacklevel=5)

    def _load(self, point: EntryPoint) -> Any:
        try:
            value = point.load()
        except Exception as error:  # whatever the import of a package may raise
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{self._called(point)} cannot be imported: {reason}") from error
        if fault := self._why_not(value):
            raise InputError(f"{self._called(point)} is not {self._a_noun}: {fault}")
        if value.name != point.name:
            raise InputError(f"{self._called(point)} has the name {value.name!r}")
        return value

    def _replaces(self, value: Any) -> bool:
        """True for a class that replaces its former definition, as a notebook's cell does that runs again."""
        own = self._own.get(value.name)
        if not (isinstance(own, type) and isinstance(value, type)):
            return False
        return (own.__module__, own.__qualname__) == (value.__module__, value.__qualname__)

    def _why_not(self, value: Any) -> str:
        if fault := self._fault(value):
            return fault
        if not NAME.fullmatch(value.name):
            return f"the name {value.name!r} may have only small letters, digits and hyphens"
        return ""

    def _called(self, point: EntryPoint) -> str:
        return f"the {self._noun} {point.name!r} (entry point {point.value} of package {_package(point)})"

    @property
    def _a_noun(self) -> str:
        return f"{'an' if self._noun[0] in 'aeiou' else 'a'} {self._noun}"


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else "unknown"
