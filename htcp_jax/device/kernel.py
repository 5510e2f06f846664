"""What a kernel is: a function of one lane, the table that it is compiled for, and the settings that it reads."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax

from htcp_jax.device.batching import chunked, refilled
from htcp_jax.device.tables import PORTION
from htcp_jax.settings import Settings

_SETTINGS = frozenset(field.name for field in fields(Settings))


class Table(NamedTuple):
    """Size of the table that a program is compiled for, and how many of its lanes it computes side by side. One that
    refills lets others in where lanes are through, see `Kernel.refill`; calls of few lanes get a short one then."""

    capacity: int
    width: int
    refills: bool = False

    def length(self, lanes: int) -> int:
        """Of the table for a call of so many lanes."""
        return self.width if self.refills and lanes <= self.width else self.capacity


class Load(NamedTuple):
    """The tables of a kind of kernels, one for any number of lanes: another one would round in its own way. A CPU gains
    nothing from lanes side by side; a GPU from thousands, fewer where each lane has hundreds of samples."""

    cpu: Table
    gpu: Table

    def on(self, device: jax.Device) -> Table:
        """The table on that device."""
        return self.cpu if device.platform == "cpu" else self.gpu


ALONE = Table(128, 1)
STEP = Load(cpu=ALONE, gpu=Table(4096, 4096))  # what every lane needs all the time
DEEP = Load(cpu=ALONE, gpu=Table(2048, 512))  # what few lanes need, or what has loops of its own to vectorise
TRACKED = Load(cpu=ALONE, gpu=Table(PORTION, 4096, refills=True))  # loops of some steps, in the longest calls of all
WALKED = Load(cpu=ALONE, gpu=Table(2048, 512, refills=True))  # the same of what is DEEP
SAMPLED = Load(cpu=ALONE, gpu=Table(256, 128))  # with hundreds of configurations a lane


@dataclass(frozen=True)
class Kernel:
    """A function of one lane, function(*parts, settings, scene, lane, ...), and what is compiled for it.

    settings: names of those that it reads. Programs are compiled for their values alone, so that another seed, say,
    compiles nothing. A setting that is read and not named is an AttributeError when the kernel is compiled.
    """

    name: str
    function: Callable
    load: Load
    settings: tuple[str, ...] = ()
    parts: tuple = ()  # hashable; what tells this kernel from others of the same function
    refill: Callable = refilled  # how others are let into slots, where the table refills

    def values(self, settings: Settings) -> tuple:
        """Of the settings that it reads."""
        return tuple(getattr(settings, name) for name in self.settings)

    def of(self, settings: Settings) -> Callable:
        """The function with its parts and settings: of (scene, lane, ...)."""
        return partial(self.function, *self.parts, _NamedSettings.of(settings, self))

    def program(self, settings: Settings, device: jax.Device) -> Callable:
        """What is compiled for that device: of (scene, count of lanes, tables...)."""
        table = self.load.on(device)
        return (self.refill if table.refills else chunked)(self.of(settings), table.width)


class _NamedSettings(Settings):
    """The settings that a kernel names, and no others."""

    @classmethod
    def of(cls, settings: Settings, kernel: Kernel) -> "_NamedSettings":
        own = object.__new__(cls)  # the values were checked when the settings were made
        vars(own).update({name: getattr(settings, name) for name in kernel.settings}, kernel=kernel.name)
        return own

    def __getattribute__(self, name: str) -> Any:
        if name in _SETTINGS and name not in object.__getattribute__(self, "__dict__"):
            raise AttributeError(f"kernel {self.kernel!r} reads the setting {name}, which it does not name")
        return super().__getattribute__(name)
