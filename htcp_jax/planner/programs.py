"""The kernels of one method on one scene and device, and what is compiled for them."""

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from htcp_jax.clearance.scene import Scene
from htcp_jax.planner.kernel import STEP, Kernel, chunked
from htcp_jax.scene.task import Task
from htcp_jax.settings import Settings

# What does not change in a loop is taken out of it before equal parts are found, which look different then: the arm's
# links are computed up to seven times over. On a CPU that costs more than it saves; on a GPU every launch counts.
COMPILER = {"cpu": {"xla_disable_hlo_passes": "while-loop-invariant-code-motion"}}


class Programs:
    """Compiled programs: one for each kernel, values of the settings that it reads, device, and shapes."""

    def __init__(self):
        self._compiled: dict[tuple, jax.stages.Compiled] = {}
        self._compiling: dict[tuple, threading.Lock] = {}  # of each program: others may be compiled meanwhile
        self._tracing = threading.Lock()

    def __len__(self) -> int:
        return len(self._compiled)

    def clear(self) -> None:
        """Forget them all, and give their memory back."""
        self._compiled.clear()

    def get(
        self, kernel: Kernel, settings: Settings, device: jax.Device, arguments: tuple
    ) -> tuple[jax.stages.Compiled, float]:
        """The program for arguments of these shapes, and the seconds that it took to compile it just now. Python traces
        one at a time, and the others are compiled meanwhile."""
        leaves, structure = jax.tree.flatten(arguments)
        shapes = tuple((x.shape, x.dtype) for x in leaves)
        key = (kernel, kernel.values(settings), device, structure, shapes)
        with self._compiling.setdefault(key, threading.Lock()):
            if key in self._compiled:
                return self._compiled[key], 0.0
            began = time.perf_counter()
            with self._tracing:
                lowered = chunked(kernel.of(settings), kernel.load.on(device).width).lower(*arguments)
            self._compiled[key] = lowered.compile(COMPILER.get(device.platform))
            return self._compiled[key], time.perf_counter() - began

    def of(self, *kernels: Kernel) -> list[tuple[Kernel, jax.stages.Compiled]]:
        """The programs of some kernels."""
        return [(kernel, self._compiled[key]) for kernel in kernels for key in self._compiled if key[0] == kernel]


PROGRAMS = Programs()  # of this process


FEW = 4  # lanes, which are not worth sharing out


class Kernels:
    """Runs kernels on one scene and one device. Compiles on first use, once for any number of scenarios, and knows the
    seconds that took.

    threads: among which a call's lanes are shared out, on a CPU; each is computed by itself, so none comes out
    otherwise.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        device: jax.Device | None = None,
        programs: Programs = PROGRAMS,
        threads: int = 1,
    ):
        self.device = device or jax.local_devices()[0]
        self._scene, self._settings = jax.device_put(scene, self.device), settings
        self._programs, self._own = programs, {}
        self._pool = ThreadPoolExecutor(threads) if threads > 1 and self.pays_by_lane else None
        self._threads = threads if self._pool else 1
        self.compile_s = 0.0

    @property
    def lanes(self) -> int:
        """Lanes that an engine keeps in flight."""
        return STEP.on(self.device).capacity

    @property
    def pays_by_lane(self) -> bool:
        """Whether a call with half the lanes takes half the time, as on a CPU."""
        return self.device.platform == "cpu"

    @property
    def task(self) -> Task:
        """What the arm has to hold."""
        return self._scene.task

    @property
    def freedom(self) -> int:
        """Dimension of the task's null space."""
        return self.task.freedom(self._scene.robot)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest joint positions [rad or m]."""
        return np.asarray(self._scene.robot.lower), np.asarray(self._scene.robot.upper)

    @property
    def sizes(self) -> tuple[int, int]:
        """Values that the task looks at, and rows of the clearance."""
        return self.task.values, len(self._scene.rows.body)

    def __call__(self, kernel: Kernel, *tables) -> Any:
        """Run a kernel over tables of n >= 1 lanes; numpy tables of n lanes come back."""
        lanes = len(jax.tree.leaves(tables)[0])
        most = min(kernel.load.on(self.device).capacity, max(FEW, -(-lanes // self._threads)))
        shares = [jax.tree.map(lambda t, s=start: t[s : s + most], tables) for start in range(0, lanes, most)]
        mapped = self._pool.map if self._pool and len(shares) > 1 else map
        parts = list(mapped(lambda share: self._run(kernel, share), shares))
        return parts[0] if len(parts) == 1 else jax.tree.map(lambda *p: np.concatenate(p), *parts)

    def prepare(self, calls: Sequence[tuple]) -> None:
        """Compile side by side what would be compiled one after the other, the largest first. calls: (kernel, tables)
        as they will be made, with any numbers and of any number of lanes."""
        began, before = time.perf_counter(), self.compile_s
        with ThreadPoolExecutor(len(calls)) as pool:
            list(pool.map(lambda call: self._program(call[0], self._arguments(call[0], call[1:])), calls))
        if self.compile_s > before:
            self.compile_s = before + time.perf_counter() - began

    def _run(self, kernel: Kernel, tables):
        lanes = len(jax.tree.leaves(tables)[0])
        arguments = self._arguments(kernel, tables)
        result = self._program(kernel, arguments)(*arguments)
        # Waiting for an array holds the interpreter's lock, which other engines need; this does not.
        jax.block_until_ready(result)
        if self.device.platform != "cpu":
            result = jax.device_get(result)  # all copies at once
        return jax.tree.map(lambda r: np.asarray(r)[:lanes], result)

    def _arguments(self, kernel: Kernel, tables) -> tuple:
        """The scene, how many chunks there are to compute, and the tables, padded."""
        capacity, width = kernel.load.on(self.device)
        chunks = -(-len(jax.tree.leaves(tables)[0]) // width)
        padded = jax.tree.map(lambda t: _pad(np.asarray(t), capacity, chunks * width), tables)
        return self._scene, np.int32(chunks), *padded

    def _program(self, kernel: Kernel, arguments: tuple) -> jax.stages.Compiled:
        if kernel not in self._own:
            self._own[kernel], seconds = self._programs.get(kernel, self._settings, self.device, arguments)
            self.compile_s += seconds
        return self._own[kernel]


def _pad(table: np.ndarray, capacity: int, filled: int) -> np.ndarray:
    """The table with its first row repeated up to `filled`: real numbers, so that padding never goes astray. What lies
    beyond, up to the capacity, is never read."""
    lanes = len(table)
    if lanes == capacity:
        return table
    padded = np.empty((capacity, *table.shape[1:]), table.dtype)
    padded[:lanes] = table
    padded[lanes:filled] = table[0]
    return padded
