"""The kernels of one method on one scene and device, and what is compiled for them."""

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import jax
import numpy as np

from htcp_jax.clearance.obstacles.scene import Scene
from htcp_jax.device import compile_cache
from htcp_jax.device.devices import cores
from htcp_jax.device.kernel import TRACKED, Kernel
from htcp_jax.device.tables import concatenate, gather, pad
from htcp_jax.model.task import Task
from htcp_jax.settings import Settings

# What does not change in a loop is taken out of it before equal parts are found, which look different then: the arm's
# links are computed up to seven times over. On a CPU that costs more than it saves; on a GPU every launch counts.
# There, XLA is not to try out which of several programs is the fastest: which one wins is another one whenever it
# compiles, and rounds in another way.
COMPILER = {
    "cpu": {"xla_disable_hlo_passes": "while-loop-invariant-code-motion"},
    "gpu": {"xla_gpu_autotune_level": 0},
}


NOBODY = nullcontext()  # waits


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
        self,
        kernel: Kernel,
        settings: Settings,
        device: jax.Device,
        arguments: tuple,
        waiting: AbstractContextManager = NOBODY,
    ) -> jax.stages.Compiled:
        """The program for arguments of these shapes, compiled if there is none; `waiting` goes on meanwhile. Python
        traces one at a time, and the others are compiled meanwhile."""
        leaves, structure = jax.tree.flatten(arguments)
        shapes = tuple((x.shape, x.dtype) for x in leaves)
        key = (kernel, kernel.values(settings), device, structure, shapes)
        if key not in self._compiled:
            with waiting, self._compiling.setdefault(key, threading.Lock()):
                if key not in self._compiled:
                    with self._tracing:
                        lowered = kernel.program(settings, device).lower(*arguments)
                    with compile_cache.alone(kernel.name):
                        self._compiled[key] = lowered.compile(COMPILER.get(device.platform))
        return self._compiled[key]

    def of(self, *kernels: Kernel) -> list[tuple[Kernel, jax.stages.Compiled]]:
        """The programs of some kernels."""
        return [(kernel, self._compiled[key]) for kernel in kernels for key in self._compiled if key[0] == kernel]


PROGRAMS = Programs()  # of this process


FEW = 4  # lanes, which are not worth sharing out


class Stopwatch:
    """A clock that goes while any thread is in it."""

    def __init__(self):
        self.seconds = 0.0
        self._inside, self._began, self._lock = 0, 0.0, threading.Lock()

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._began = time.perf_counter()
            self._inside += 1

    def __exit__(self, *_) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self.seconds += time.perf_counter() - self._began


class Kernels:
    """Runs kernels on one scene and one device. Compiles on first use, once for any number of scenarios, and knows for
    how long somebody waited for that.

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
        self._waiting = Stopwatch()

    @property
    def compile_s(self) -> float:
        """Wall time in which programs were waited for [s]."""
        return self._waiting.seconds

    @property
    def lanes(self) -> int:
        """Lanes that an engine keeps in flight."""
        return TRACKED.on(self.device).capacity

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
        """Values that the task looks at, and rows of the clearance that a lane brings along."""
        return self.task.values, 1 if self._settings.clearance_rows == "smallest" else len(self._scene.rows.body)

    def __call__(self, kernel: Kernel, *tables) -> Any:
        """Run a kernel over tables of n >= 1 lanes; numpy tables of n lanes come back."""
        lanes = len(jax.tree.leaves(tables)[0])
        most = min(kernel.load.on(self.device).capacity, max(FEW, -(-lanes // self._threads)))
        if lanes <= most:
            return self._run(kernel, tables)
        shares = [gather(tables, slice(start, start + most)) for start in range(0, lanes, most)]
        mapped = self._pool.map if self._pool else map
        return concatenate(list(mapped(lambda share: self._run(kernel, share), shares)))

    @contextmanager
    def preparing(self, calls: Sequence[tuple]) -> Iterator[None]:
        """Compile on all cores what will be called, in this order, while whoever calls goes on, and waits for no more
        than he needs. calls: (kernel, tables) as they will be made, with any numbers and of any number of lanes."""
        with ThreadPoolExecutor(cores()) as pool:
            begun = [pool.submit(self._ready, kernel, tables) for kernel, *tables in calls]
            try:
                yield
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            for each in begun:
                with NOBODY if each.done() else self._waiting:
                    each.result()

    def _ready(self, kernel: Kernel, tables) -> None:
        self._programs.get(kernel, self._settings, self.device, self._arguments(kernel, tables))

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
        """The scene, how many lanes there are to compute, and the tables, padded."""
        table, lanes = kernel.load.on(self.device), len(jax.tree.leaves(tables)[0])
        filled = -(-lanes // table.width) * table.width
        padded = jax.tree.map(lambda t: pad(np.asarray(t), table.length(lanes), filled), tables)
        return self._scene, np.int32(lanes), *padded

    def _program(self, kernel: Kernel, arguments: tuple) -> jax.stages.Compiled:
        key = kernel, len(jax.tree.leaves(arguments)[-1])  # of the tables: some kernels have a short one, too
        if key not in self._own:
            self._own[key] = self._programs.get(kernel, self._settings, self.device, arguments, self._waiting)
        return self._own[key]
