"""Execution of a method's lane functions on one scene and device, and the cache of their executables."""

import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import jax
import numpy as np

from htcp_jax.backend import Backend, compiled_for, default_device
from htcp_jax.caching import cache_folder, preparation_key, program_key, source_key
from htcp_jax.clearance import Scene
from htcp_jax.clearance.obstacles import with_interior
from htcp_jax.device import kept_executables
from htcp_jax.device.compilations import COMPILATIONS
from htcp_jax.device.devices import cores
from htcp_jax.device.lane_function import TRACKED, LaneFunction
from htcp_jax.device.tables import concatenate, gather, pad
from htcp_jax.model import Task, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.settings import Settings
from htcp_jax.types import Int

# XLA hoists loop invariants before it merges common subexpressions, which then no longer match: the arm's links are
# computed up to seven times. On a CPU hoisting costs more than it saves; on a GPU it saves launches. On a GPU,
# autotuning is off: the variant that it selects changes from one compilation to the next, and rounds differently.
COMPILER = {
    "cpu": {"xla_disable_hlo_passes": "while-loop-invariant-code-motion"},
    "gpu": {"xla_gpu_autotune_level": 0},
}
QUICK = {"cpu": {"xla_backend_optimization_level": 0}}  # in addition, for functions with `compiles_quickly`


NO_MEMORY = "RESOURCE_EXHAUSTED"  # in the message of JAX's error if a device runs out of memory
NO_STOPWATCH = nullcontext()  # used if the waiting time is not measured


class ExecutableCache:
    """Cache of executables, one per lane function, values of the settings that it reads, device, and argument shapes.

    Args:
        most: Maximum number of executables; if it is exceeded, the least recently used one is dropped.
        on_disk: True to also store executables in the folder of `cache_folder`, for other processes.
    """

    def __init__(self, most: int = 256, on_disk: bool = False):
        self._most, self._on_disk = most, on_disk
        self._compiled: dict[tuple, jax.stages.Compiled] = {}  # in the order of their last use
        self._compiling: dict[tuple, threading.Lock] = {}  # one lock per executable: others can be compiled
        self._tracing, self._sorting = threading.Lock(), threading.Lock()
        self._smaller: dict[LaneFunction, LaneFunction] = {}  # functions whose tables were too large, with smaller ones

    def __len__(self) -> int:
        return len(self._compiled)

    def fitting(self, lane_function: LaneFunction) -> LaneFunction:
        """Return the function with tables that fit into the memory of the device, as far as known."""
        return self._smaller.get(lane_function, lane_function)

    def shrink(self, lane_function: LaneFunction, failed: LaneFunction, device: jax.Device) -> bool:
        """Halve a function's tables after a call ran out of memory; return False if they have one row.

        The first time, a warning says so. They stay halved until the process ends: larger tables would run out of
        memory again, and round differently, so that results would depend on when they fit.

        Args:
            lane_function: The function.
            failed: What `fitting` returned for the call.
            device: The device.
        """
        with self._sorting:
            if self.fitting(lane_function) != failed:
                return True  # another thread has halved them
            if failed.sizes.on(device).capacity == 1:
                return False
            first = not self._smaller
            self._smaller[lane_function] = replace(failed, sizes=failed.sizes.halved())
        if first:
            words = f"{device.device_kind} has too little memory for {failed.name}; its tables are halved"
            warnings.warn(f"{words}; planning takes longer, and results may be rounded differently", stacklevel=2)
        return True

    def clear(self) -> None:
        """Drop all executables and free their memory."""
        self._compiled.clear()

    def get(
        self,
        lane_function: LaneFunction,
        settings: Settings,
        device: jax.Device,
        arguments: tuple,
        waiting: AbstractContextManager = NO_STOPWATCH,
    ) -> jax.stages.Compiled:
        """Return the executable for arguments of the given shapes; compile it if it is not in the cache.

        Only one function is traced at a time; compilations run in parallel.

        Args:
            lane_function: The function and how it is compiled.
            settings: Settings of the planner.
            device: The device to compile for.
            arguments: Scene, number of lanes, and tables.
            waiting: Context that is open while the executable is loaded or compiled.
        """
        leaves, structure = jax.tree.flatten(arguments)
        shapes = tuple((x.shape, x.dtype) for x in leaves)
        key = (lane_function, lane_function.values(settings), device, structure, shapes)
        if (found := self._kept(key)) is None:
            with waiting, LOADING, self._compiling.setdefault(key, threading.Lock()):
                if (found := self._kept(key)) is None:
                    found = self._found(key, settings, arguments)
                    self._keep(key, found)
        return found

    def _found(self, key: tuple, settings: Settings, arguments: tuple) -> jax.stages.Compiled:
        """Load an executable from disk, or trace and compile it."""
        lane_function, values, device, *about = key
        options, keeps = COMPILER.get(device.platform, {}), self._on_disk and cache_folder.folder() is not None
        if lane_function.compiles_quickly:
            options = options | QUICK.get(device.platform, {})
        source = source_key(lane_function, values, device, options, *about) if keeps else None
        if found := kept_executables.find(source, device, arguments):
            return found
        scene = arguments[0]
        if keeps and isinstance(scene, Scene) and scene.robot.pieces is not None:
            warn_if_unprepared(scene.robot.dof, len(scene.robot.capsule_link), device)
        with COMPILATIONS.compiling():
            with self._tracing, compiled_for(Backend.of(device.platform)):
                lowered = lane_function.jitted(settings, device).lower(*arguments)
            if not keeps:
                return lowered.compile(options)
            program = program_key(lane_function.name, lowered, device, options)
            with cache_folder.compilation_lock(program):
                return kept_executables.compiled(source, program, lambda: lowered.compile(options), device, arguments)

    def _kept(self, key: tuple) -> jax.stages.Compiled | None:
        with self._sorting:
            if (found := self._compiled.pop(key, None)) is not None:
                self._compiled[key] = found
            return found

    def _keep(self, key: tuple, compiled: jax.stages.Compiled) -> None:
        with self._sorting:
            self._compiled[key] = compiled
            for oldest in list(self._compiled)[: -self._most]:
                del self._compiled[oldest]
                self._compiling.pop(oldest, None)


@cache
def warn_if_unprepared(joints: int, bodies: int, device: jax.Device) -> None:
    """Warn once of an arm that compiles its own programs, as it has more bodies than `htcp prepare` compiles for.

    Without a note of `htcp prepare` for the device there is no warning.

    Args:
        joints: Number of the arm's joints.
        bodies: Number of its bodies, with padding.
        device: The device.
    """
    most = robots.PREPARED_BODIES.get(joints, bodies)
    key = preparation_key(device) if bodies > most else None
    if key is not None and cache_folder.read(key) is not None:
        warnings.warn(
            f"this arm compiles programs of its own: with {joints} joints, htcp prepare covers at most {most} bodies, "
            "tool included; htcp robot --most 2 makes fewer",
            stacklevel=2,
        )


EXECUTABLES = ExecutableCache(on_disk=True)  # executables of this process, shared by all plans


FEW = 4  # calls with at most FEW lanes are not shared among threads


class Stopwatch:
    """Stopwatch that runs while any thread is inside its context."""

    def __init__(self):
        self._seconds, self._inside, self._began, self._lock = 0.0, 0, 0.0, threading.Lock()

    @property
    def seconds(self) -> float:
        """Time for which it has run [s]."""
        with self._lock:
            return self._seconds + (time.perf_counter() - self._began if self._inside else 0.0)

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._began = time.perf_counter()
            self._inside += 1

    def __exit__(self, *_) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._seconds += time.perf_counter() - self._began


LOADING = Stopwatch()  # runs while this process loads or compiles executables, or starts other processes


class Executor:
    """Executor of lane functions on one scene and one device.

    Each function is compiled on first use, once for any number of scenarios. `compile_s` is the time spent waiting for
    compilations.

    Args:
        scene: The scene.
        settings: Settings of the planner.
        device: The device; None: the default one.
        executables: The cache of executables.
        threads: Number of threads that share a call's lanes on a CPU. Results do not depend on this number, as lanes
            are independent.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        device: jax.Device | None = None,
        executables: ExecutableCache = EXECUTABLES,
        threads: int = 1,
    ):
        self.device = device or default_device()
        self._given, self._settings = scene, settings
        # On a GPU a rule that is never broken would cost further launches.
        known = scene._replace(obstacles=with_interior(scene.obstacles)) if self.pays_by_lane else scene
        self._scene = jax.device_put(known.for_programs(closely=not self.pays_by_lane), self.device)
        self._for_either = self._scene._replace(task=self._scene.task.for_either)
        self._executables, self._own = executables, {}
        self._pool = ThreadPoolExecutor(threads) if threads > 1 and self.pays_by_lane else None
        self._threads = threads if self._pool else 1
        self._waiting = Stopwatch()

    @property
    def compile_s(self) -> float:
        """Wall time spent waiting for executables [s]."""
        return self._waiting.seconds

    @property
    def lanes(self) -> int:
        """Number of lanes that an engine advances together."""
        return TRACKED.on(self.device).capacity

    @property
    def pays_by_lane(self) -> bool:
        """True if the time of a call is proportional to the number of lanes, as on a CPU."""
        return self.device.platform == "cpu"

    @property
    def task(self) -> Task:
        """The task: the constraints at every target."""
        return self._scene.task

    @property
    def freedom(self) -> int:
        """Dimension of the task's null space."""
        return self.task.freedom(self._given.robot)

    @cached_property
    def rows(self) -> Int[np.ndarray, "R"]:
        """Indices of the scene's rows of clearance in the tables of lane functions, which have padding between them."""
        return self._given.rows_within(self._scene)

    @property
    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper joint limits [rad or m]."""
        return np.asarray(self._given.robot.lower), np.asarray(self._given.robot.upper)

    @property
    def tip_bounds(self) -> kinematics.TipBounds:
        """Bounds on the motion of the arm's bare tip."""
        return kinematics.tip_bounds(self._given.robot)

    @property
    def sizes(self) -> tuple[int, int]:
        """Number of values of the task, and number of clearance rows per lane."""
        return self.task.values, 1 if self._settings.clearance_rows == "smallest" else len(self._scene.rows.body)

    def __call__(self, lane_function: LaneFunction, *tables) -> Any:
        """Run a lane function over tables of n >= 1 lanes; return numpy tables of n lanes.

        If the device runs out of memory, the function's tables are halved until a call fits.
        """
        return self._fitted(lane_function, lambda fitting: self._call(fitting, tables))

    def _fitted(self, lane_function: LaneFunction, call: Callable[[LaneFunction], Any]) -> Any:
        while True:
            fitting = self._executables.fitting(lane_function)
            try:
                return call(fitting)
            except jax.errors.JaxRuntimeError as error:
                is_full = NO_MEMORY in str(error)
                if not (is_full and self._executables.shrink(lane_function, fitting, self.device)):
                    raise

    def _call(self, lane_function: LaneFunction, tables) -> Any:
        lanes = len(jax.tree.leaves(tables)[0])
        most = min(lane_function.sizes.on(self.device).capacity, max(FEW, -(-lanes // self._threads)))
        if lanes <= most:
            return self._run(lane_function, tables)
        shares = [gather(tables, slice(start, start + most)) for start in range(0, lanes, most)]
        mapped = self._pool.map if self._pool else map
        return concatenate(list(mapped(lambda share: self._run(lane_function, share), shares)))

    @contextmanager
    def preparing(self, calls: Sequence[tuple]) -> Iterator[list[Future]]:
        """Compile the executables of the given calls in the background, in this order, on all cores.

        The caller continues inside the context, and waits only for executables that it uses there. It may cancel
        compilations, which are the context's value.

        Args:
            calls: Tuples (lane function, *tables) like those of later calls. The tables' values and the number of lanes
                may differ from those of the later calls.
        """
        with COMPILATIONS.requested(len(calls)) as begin, ThreadPoolExecutor(cores()) as pool:
            begun = [pool.submit(self._ready, begin, lane_function, tables) for lane_function, *tables in calls]
            try:
                yield begun
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
            for each in (each for each in begun if not each.cancelled()):
                with NO_STOPWATCH if each.done() else self._waiting:
                    each.result()

    def _ready(self, begin: Callable[[], None], lane_function: LaneFunction, tables) -> None:
        begin()

        def ready(fitting: LaneFunction) -> None:
            self._executables.get(fitting, self._settings, self.device, self._arguments(fitting, tables))

        self._fitted(lane_function, ready)

    def _run(self, lane_function: LaneFunction, tables):
        lanes = len(jax.tree.leaves(tables)[0])
        arguments = self._arguments(lane_function, tables)
        result = self._executable(lane_function, arguments)(*arguments)
        # Unlike waiting for an array, this releases the interpreter's lock, which other engines need.
        jax.block_until_ready(result)
        if self.device.platform != "cpu":
            result = jax.device_get(result)  # all copies at once
        return jax.tree.map(lambda r: np.asarray(r)[:lanes], result)

    def _arguments(self, lane_function: LaneFunction, tables) -> tuple:
        """Return the scene, the number of lanes to compute, and the padded tables."""
        table, lanes = lane_function.sizes.on(self.device), len(jax.tree.leaves(tables)[0])
        filled = -(-lanes // table.width) * table.width
        padded = jax.tree.map(lambda t: pad(np.asarray(t), table.length(lanes), filled), tables)
        return self._for_either if lane_function.any_cone else self._scene, np.int32(lanes), *padded

    def _executable(self, lane_function: LaneFunction, arguments: tuple) -> jax.stages.Compiled:
        leaves, structure = jax.tree.flatten(arguments[2:])
        key = lane_function, structure, len(leaves[-1])  # the tables' length: a table may be short
        if key not in self._own:
            self._own[key] = self._executables.get(lane_function, self._settings, self.device, arguments, self._waiting)
        return self._own[key]
