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
    """Size of the tables that a function is compiled for."""

    capacity: int  # number of rows
    width: int  # number of lanes computed side by side
    # True: a finished lane's slot takes the next lane, see `LaneFunction.refill`; few lanes get a short table
    refills: bool = False

    def length(self, lanes: int) -> int:
        """Return the number of rows of the tables for a call with the given number of lanes."""
        return self.width if self.refills and lanes <= self.width else self.capacity

    def halved(self) -> "BatchSize":
        """Return half of the size; at least one row."""
        return self._replace(capacity=max(1, self.capacity // 2), width=max(1, self.width // 2))


class DeviceSizes(NamedTuple):
    """Table sizes of a class of lane functions: one size per platform, for any number of lanes.

    Results in tables of other sizes would be rounded differently. A CPU is not faster with several lanes side by side.
    A GPU is faster with thousands of lanes, or with hundreds if each lane has hundreds of samples.
    """

    cpu: BatchSize
    gpu: BatchSize

    def on(self, device: jax.Device) -> BatchSize:
        """Return the table size for a device."""
        return self.cpu if device.platform == "cpu" else self.gpu

    def halved(self) -> "DeviceSizes":
        """Return half of the sizes."""
        return DeviceSizes(self.cpu.halved(), self.gpu.halved())


ALONE = BatchSize(128, 1)
STEP = DeviceSizes(cpu=ALONE, gpu=BatchSize(4096, 4096))
# for loops of some steps, in the longest calls
TRACKED = DeviceSizes(cpu=ALONE, gpu=BatchSize(PORTION, 4096, refills=True))
DEEP_LOOP = DeviceSizes(cpu=ALONE, gpu=BatchSize(2048, 512, refills=True))  # for loops that are vectorised inside
SAMPLED_LOOP = DeviceSizes(cpu=ALONE, gpu=BatchSize(2048, 256, refills=True))  # with hundreds of samples per iteration
SAMPLED = DeviceSizes(cpu=ALONE, gpu=BatchSize(512, 256))  # for functions with hundreds of configurations per lane


@dataclass(frozen=True)
class LaneFunction:
    """A function of one lane, function(*parts, settings, scene, lane, ...), and how it is compiled.

    The robot in the scene has the lane's own tool, and no labels: names are empty, and frames are missing. If the
    function returns a `Loop`, the loop's step is step(scene, state), with a scene that is computed inside the loop. A
    robot from outside the loop would be compiled to other instructions, which round differently.

    Executables depend only on the values of the settings that the function reads: a new seed, for example, needs no
    compilation. Reading a setting that is not in `settings` raises AttributeError during compilation.

    Attributes:
        name: Name of the function, in progress and cache.
        function: The function of one lane; it returns any tree of arrays, or a `Loop`.
        sizes: Number of lanes per call, by device, such as `STEP`.
        settings: Names of the settings that the function reads.
        parts: First arguments of the function: hashable values that are compiled into it, such as other functions.
        refill: For sizes with `refills`: how waiting lanes replace finished ones in a loop, by default `refilled`.
        remembers: True if the function returns a `Loop` that passes on a memory from lane to lane.
        any_cone: True if one executable serves axes with and without a cone, see `Task.for_either`.
        compiles_quickly: True for a function of few lanes: on a CPU it is compiled in half the time, and runs nine
            times as long.
    """

    name: str
    function: Callable
    sizes: DeviceSizes
    settings: tuple[str, ...] = ()
    parts: tuple = ()
    refill: Callable = refilled
    remembers: bool = False
    any_cone: bool = False
    compiles_quickly: bool = False

    def values(self, settings: Settings) -> tuple:
        """Return the values of the settings that the function reads."""
        return tuple(getattr(settings, name) for name in self.settings)

    def of(self, settings: Settings) -> Callable:
        """Return the function with its parts and settings bound, as a function of (scene, lane, ...)."""
        function = partial(self.function, *self.parts, _NamedSettings.of(settings, self))

        def bound(scene, lane, *more):
            found = function(own_scene(scene, lane.tool_extension_m), lane, *more)
            if not isinstance(found, Loop):
                return found
            own = lambda: own_scene(scene, lane.tool_extension_m)  # noqa: E731
            if remembering := found.remembering:
                remembering = remembering._replace(step=lambda *now: found.remembering.step(own(), *now))
            return found._replace(step=lambda state: found.step(own(), state), remembering=remembering)

        return bound

    def jitted(self, settings: Settings, device: jax.Device) -> jax.stages.Wrapped:
        """Return the function to compile for a device, with the arguments (scene, number of lanes, *tables)."""
        table = self.sizes.on(device)
        if table.refills:
            return self.refill(self.of(settings), table.width)
        return chunked(self.of(settings), table.width, self.remembers)


class _NamedSettings(Settings):
    """Settings of which only those in `LaneFunction.settings` can be read."""

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
                f"lane function {self.lane_function!r} reads the setting {name}, but does not declare it; "
                "add it to LaneFunction.settings"
            )
        return super().__getattribute__(name)
