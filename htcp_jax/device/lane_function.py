"""`LaneFunction`: a function of one lane, the table that it is compiled for, and the settings that it reads."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax

from htcp_jax.clearance import own_scene
from htcp_jax.device.batching import Loop, chunked, refilled
from htcp_jax.device.tables import PORTION
from htcp_jax.settings import Settings

_SETTINGS = frozenset(field.name for field in fields(Settings))


class BatchSize(NamedTuple):
    """Number of rows that a function is compiled for, and how many lanes it computes side by side.

    A table that refills gives a finished lane's slot to the next lane, see `LaneFunction.refill`; calls with few lanes
    then get a short table.
    """

    capacity: int
    width: int
    refills: bool = False

    def length(self, lanes: int) -> int:
        """Return the number of rows of the table for a call with so many lanes."""
        return self.width if self.refills and lanes <= self.width else self.capacity


class DeviceSizes(NamedTuple):
    """Tables of a class of lane functions, one per platform for any number of lanes.

    A table of another size would round differently. A CPU gains nothing from lanes side by side; a GPU from thousands,
    fewer if each lane has hundreds of samples.
    """

    cpu: BatchSize
    gpu: BatchSize

    def on(self, device: jax.Device) -> BatchSize:
        """Return the table for that device."""
        return self.cpu if device.platform == "cpu" else self.gpu


ALONE = BatchSize(128, 1)
STEP = DeviceSizes(cpu=ALONE, gpu=BatchSize(4096, 4096))  # for every lane, in every round
DEEP = DeviceSizes(cpu=ALONE, gpu=BatchSize(2048, 512))  # for few lanes, or with vectorised inner loops
# loops of some steps, in the longest calls
TRACKED = DeviceSizes(cpu=ALONE, gpu=BatchSize(PORTION, 4096, refills=True))
DEEP_LOOP = DeviceSizes(cpu=ALONE, gpu=BatchSize(2048, 512, refills=True))  # DEEP, for functions that return a `Loop`
SAMPLED = DeviceSizes(cpu=ALONE, gpu=BatchSize(256, 128))  # with hundreds of configurations per lane


@dataclass(frozen=True)
class LaneFunction:
    """A function of one lane, function(*parts, settings, scene, lane, ...), and how it is compiled.

    The robot of its scene has the lane's own tool, and no labels: names are empty, and frames are missing. If it
    returns a `Loop`, its step is step(scene, state), with a scene computed inside the loop: a robot that is carried
    into it is compiled to other instructions, which round differently.

    settings: names of those that it reads. Executables are compiled for these values only, so a new seed, for example,
    compiles nothing. Reading a setting that is not named raises AttributeError when the lane function is compiled.
    """

    name: str
    function: Callable
    sizes: DeviceSizes
    settings: tuple[str, ...] = ()  # names of those that the function reads
    parts: tuple = ()  # hashable; distinguishes instances that share a function
    refill: Callable = refilled  # `refilled` or a replacement, if the table refills

    def values(self, settings: Settings) -> tuple:
        """Return the values of the settings that it reads."""
        return tuple(getattr(settings, name) for name in self.settings)

    def of(self, settings: Settings) -> Callable:
        """Return the function with its parts and settings bound, as a function of (scene, lane, ...)."""
        function = partial(self.function, *self.parts, _NamedSettings.of(settings, self))

        def bound(scene, lane, *more):
            found = function(own_scene(scene, lane.tool_extension_m), lane, *more)
            if not isinstance(found, Loop):
                return found
            return found._replace(step=lambda state: found.step(own_scene(scene, lane.tool_extension_m), state))

        return bound

    def jitted(self, settings: Settings, device: jax.Device) -> jax.stages.Wrapped:
        """Return the function to compile for that device: of (scene, number of lanes, tables...)."""
        table = self.sizes.on(device)
        return (self.refill if table.refills else chunked)(self.of(settings), table.width)


class _NamedSettings(Settings):
    """Settings restricted to those that a `LaneFunction` names."""

    @classmethod
    def of(cls, settings: Settings, lane_function: LaneFunction) -> "_NamedSettings":
        own = object.__new__(cls)  # the values were checked when the settings were made
        vars(own).update(
            {name: getattr(settings, name) for name in lane_function.settings}, lane_function=lane_function.name
        )
        return own

    def __getattribute__(self, name: str) -> Any:
        if name in _SETTINGS and name not in object.__getattribute__(self, "__dict__"):
            raise AttributeError(
                f"lane function {self.lane_function!r} reads the setting {name}, which it does not name"
            )
        return super().__getattribute__(name)
