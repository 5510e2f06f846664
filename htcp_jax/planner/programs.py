"""The kernels of one method on one scene and device, and what is compiled for them."""

import threading
import time
from collections.abc import Callable
from functools import partial

import jax
import numpy as np

from htcp_jax.clearance.scene import Scene
from htcp_jax.planner.chunks import chunked, table_on
from htcp_jax.planner.kernels import (
    advance,
    ascend,
    check_path,
    draw,
    enter_null_space,
    prepare,
    propose,
    push,
    tip,
    track,
    walk_null_space,
)
from htcp_jax.planner.methods import Method
from htcp_jax.scene.task import Task
from htcp_jax.settings import Settings

_PROGRAMS: dict = {}  # compiled for (kernel, settings, width, shapes); for the life of the process
_COMPILING = threading.Lock()


class Kernels:
    """The kernels of one method on one scene and one device. Compiles on first use, once for any number of scenarios,
    and knows the seconds that took."""

    def __init__(self, scene: Scene, method: Method, settings: Settings, device: jax.Device | None = None):
        self.device = device or jax.local_devices()[0]
        self._scene, self._settings = jax.device_put(scene, self.device), settings
        self._programs: dict[str, Callable] = {}
        self.compile_s = 0.0
        self._kernels = {
            "prepare": prepare,
            "advance": advance,
            "track": track,
            "enter": enter_null_space,
            "ascend": ascend,
            "push": push,
            "draw": draw,
            "check_path": check_path,
            "tip": tip,
        }
        self._stages = method.stages

    @property
    def lanes(self) -> int:
        """Lanes that an engine keeps in flight."""
        return table_on(self.device, "advance").capacity

    @property
    def pays_by_lane(self) -> bool:
        """Whether a call with half the lanes takes half the time, as on a CPU."""
        return self.device.platform == "cpu"

    @property
    def task(self) -> Task:
        """What the arm has to hold."""
        return self._scene.task

    @property
    def sizes(self) -> tuple[int, int]:
        """Rows of the task, and of the clearance."""
        return self.task.rows, len(self._scene.rows.body)

    def __call__(self, name: str, *tables):
        """Run kernel `name`, "walk k" or "sample k" for stage k of the method, over tables of n >= 1 lanes; numpy
        tables of n lanes come back."""
        lanes = len(jax.tree.leaves(tables)[0])
        most = table_on(self.device, name).capacity
        parts = [
            self._run(name, jax.tree.map(lambda t, s=start: t[s : s + most], tables)) for start in range(0, lanes, most)
        ]
        return parts[0] if len(parts) == 1 else jax.tree.map(lambda *p: np.concatenate(p), *parts)

    def _run(self, name: str, tables):
        lanes = len(jax.tree.leaves(tables)[0])
        capacity, width = table_on(self.device, name)
        padded = jax.tree.map(lambda t: _pad(np.asarray(t), capacity), tables)
        chunks = np.int32(-(-lanes // width))
        result = self._program(name, width, chunks, padded)(self._scene, chunks, *padded)
        # Waiting for an array holds the interpreter's lock, which other engines need; this does not.
        jax.block_until_ready(result)
        if self.device.platform != "cpu":
            result = jax.device_get(result)  # all copies at once
        return jax.tree.map(lambda r: np.asarray(r)[:lanes], result)

    def _program(self, name: str, width: int, chunks, tables) -> Callable:
        if name in self._programs:
            return self._programs[name]
        with _COMPILING:
            arguments = (self._scene, chunks, *tables)
            leaves, structure = jax.tree.flatten(arguments)
            work = self._work(name)
            shapes = tuple((x.shape, x.dtype) for x in leaves)
            key = (work.func, work.args, width, self.device, structure, shapes)
            if key not in _PROGRAMS:
                began = time.perf_counter()
                _PROGRAMS[key] = chunked(work, width).lower(*arguments).compile()
                self.compile_s += time.perf_counter() - began
            self._programs[name] = _PROGRAMS[key]
        return self._programs[name]

    def _work(self, name: str) -> partial:
        if name in self._kernels:
            return partial(self._kernels[name], self._settings)
        kind, index = name.split()
        kernel = propose if kind == "sample" else walk_null_space
        return partial(kernel, self._stages[int(index)], int(index), self._settings)


def _pad(table: np.ndarray, capacity: int) -> np.ndarray:
    """The table with its first row repeated up to the capacity: real numbers, so that padding never goes astray."""
    return np.concatenate([table, np.repeat(table[:1], capacity - len(table), axis=0)])
