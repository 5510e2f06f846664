"""Work shared among processes of this machine.

Python runs one thread at a time, so engines in one process hardly run in parallel; engines in separate processes do.

The library loky manages the workers. Workers remain for the next call, and end after `IDLE_S` without work. Each worker
keeps the shared objects of one call. Workers import this package and never the caller's main module, which may be a
notebook or a script without a guard. If a worker dies, an error is raised, and the other workers are not blocked. The
standard library's pools do neither, and Ray needs a server.
"""

import contextlib
import itertools
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, wait
from concurrent.futures.process import BrokenProcessPool
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from htcp_jax.device.executor import LOADING
from htcp_jax.errors import Lost
from htcp_jax.system import temporary_folder

POLL_S = 0.1  # interval at which progress is polled
IDLE_S = 300  # idle time after which workers end
START_PAYS = 10_000  # minimum number of targets for which starting workers saves time
EACH_PAYS = 8  # minimum number of scenarios per worker
START_PAYS_ON_GPU = 300_000  # as START_PAYS, for one worker per GPU: each loads its executables
MOST_TOGETHER = 64  # maximum number of scenarios per part, which limits the time of the last part


# If psutil is installed, loky replaces a worker whose memory grows by 300 MB, as a leak; the large limit prevents this,
# as workers keep executables.
KEEP = {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
ON_CPU = {"JAX_PLATFORMS": "cpu"} | KEEP


def on_gpu(device: jax.Device) -> dict[str, str]:
    """Return the environment variables of a worker that sees one of this process's NVIDIA GPUs.

    The worker reserves no memory, as this process has reserved most of it.
    """
    seen, number = os.environ.get("CUDA_VISIBLE_DEVICES"), device.local_hardware_id
    name = seen.split(",")[number] if seen else str(number)
    return {"CUDA_VISIBLE_DEVICES": name, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"} | KEEP


def profitable_count(cores: int, scenarios: int, targets: int) -> int:
    """Return the number of processes to use for a call.

    The number does not depend on earlier calls.

    Args:
        cores: Number of cores.
        scenarios: Number of scenarios of this call.
        targets: Number of targets of all calls that belong together, such as the shards of a sweep.
    """
    return max(1, min(cores, scenarios // EACH_PAYS)) if targets >= START_PAYS else 1


def shares(count: int, processes: int, most: int = MOST_TOGETHER) -> list[Int[np.ndarray, "_"]]:
    """Return the indices of the scenarios in each part of `count` scenarios, at most `most` in each.

    Neighbouring scenarios of a grid are similar, so scenarios are assigned to parts in turn: each part gets its share
    of hard ones.
    """
    parts = min(count, max(processes, -(-count // most)))
    return [np.arange(first, count, parts) for first in range(parts)]


def portable(*things: Any) -> bytes | None:
    """Return pickled objects for another process; None if they cannot be pickled or need the caller's main module."""
    try:
        data = pickle.dumps(things)
    except Exception:  # pickling raises exceptions of many types
        return None
    return None if b"__main__" in data else data


class Spread(NamedTuple):
    """Result of `spread`: the results of the parts in order, and the time until the workers were ready [s]."""

    results: list
    start_s: float


def spread(
    environments: Sequence[dict[str, str]],
    call: Callable,
    shared: bytes,
    parts: Sequence,
    report: Callable[[np.ndarray], None] | None,
    ready: Callable[[], Any] = tuple,
) -> Spread:
    """Call call(set_counts, *shared, part) in worker processes, once for every part; return the results.

    The argument set_counts(a, b, c) is a function that sets the three counts of the part's progress.

    Args:
        environments: Environment variables of each worker, such as `ON_CPU`. If they are equal, the next free worker
            takes the next part; if they differ, parts are assigned to the workers in turn.
        call: The function to call.
        shared: Pickled objects for all parts, from `portable`. They are sent to each worker once, and kept for the next
            call.
        parts: The last argument of each call.
        report: Function that is called repeatedly with the counts of all P parts (P, 3); an exception in it ends the
            work.
        ready: Function that is called in each worker before the first part, for imports that take time.

    Raises:
        Exception: The exception of the first part that fails.
        Lost: If a worker dies.
    """
    with temporary_folder() as folder:
        file = folder / sha256(shared).hexdigest()
        file.write_bytes(shared)
        board = np.memmap(folder / BOARD, np.int64, "w+", shape=(len(parts), COUNTS))
        with _signals_blocked():
            workers, began = _executors(environments), time.perf_counter()
            started = [each.submit(ready) for each in workers for _ in range(len(environments) // len(workers))]
        try:
            with LOADING:
                _watched(started, lambda: None)
            start_s = time.perf_counter() - began
            chosen = itertools.cycle(workers)
            requested = [next(chosen).submit(_work, file, k, call, part) for k, part in enumerate(parts)]
            _watched(requested, lambda: report and report(np.array(board)))
            return Spread([each.result() for each in requested], start_s)
        except BaseException as error:
            for each in workers:
                each.shutdown(kill_workers=True)
            for name in [name for name, each in _alone.items() if each in workers]:
                del _alone[name]
            if isinstance(error, BrokenProcessPool):
                raise Lost("a worker process was killed; it may have run out of memory") from None
            raise


@contextlib.contextmanager
def _signals_blocked() -> Iterator[None]:
    """Return a context in which this thread, and processes that it starts, block SIGINT and SIGTERM.

    A terminal and `timeout` send these signals to all processes of a group. Only another thread of the parent process
    then handles them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _watched(requested: Sequence[Future], look: Callable[[], Any]) -> None:
    """Wait for all futures, calling `look` at intervals; raise the first exception of a future."""
    left = set(requested)
    while left:
        done, left = wait(left, POLL_S, FIRST_EXCEPTION)
        for each in done:
            each.result()
        look()


def _executors(environments: Sequence[dict[str, str]]) -> list:
    """Return one executor for all workers if their variables are equal, else one for each worker."""
    from loky import ProcessPoolExecutor, get_reusable_executor  # here, as a plan of one scenario does not need them

    given = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
    how = {"timeout": IDLE_S, "initializer": _begin_worker, "initargs": given}
    if all(each == environments[0] for each in environments):
        return [get_reusable_executor(len(environments), env=environments[0], **how)]
    names = [repr((given, sorted(each.items()))) for each in environments]
    for name, each in zip(names, environments, strict=True):
        if name not in _alone:
            _alone[name] = ProcessPoolExecutor(1, env=each, **how)
    return [_alone[name] for name in names]


_alone: dict[str, Any] = {}  # executors of one worker, by its initial arguments and variables


# Code that runs in a worker

BOARD, COUNTS = "board", 3  # file with the counts of all parts; number of counts of a part
_kept: dict[str, tuple] = {}  # digest -> shared objects of the last call; at most one entry


def _begin_worker(cache: str | None, least_s: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles this signal
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least_s)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent ends.

    A killed process sends no signal to its workers. On Windows they end after `IDLE_S` without work.
    """
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _work(file: Path, number: int, call: Callable, part: Any) -> Any:
    if file.name not in _kept:
        _kept.clear()
        _kept[file.name] = pickle.loads(file.read_bytes())
    board = np.memmap(file.with_name(BOARD), np.int64, "r+").reshape(-1, COUNTS)

    def notify(*numbers: int) -> None:
        board[number] = numbers

    return call(notify, *_kept[file.name], part)
