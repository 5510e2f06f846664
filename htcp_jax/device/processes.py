"""Work shared among processes of this machine.

Engines in one process take turns, as Python runs one thread at a time; engines in separate processes do not.

The workers are loky's, which owns them: no more than the last call used, kept for the next call, ended after `IDLE_S`
without work. Each keeps the shared objects of one call. They import this package and never their caller's main module,
which may be a notebook or a script without a guard; and a worker that dies raises an error instead of blocking the
others. The standard library's pools do neither, and Ray needs a server.
"""

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, wait
from concurrent.futures.process import BrokenProcessPool
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from htcp_jax.errors import Lost
from htcp_jax.process_exit import signals_blocked
from htcp_jax.unfinished import temporary_folder

POLL_S = 0.1  # interval at which progress is polled
IDLE_S = 300  # idle time after which workers end
START_PAYS = 10_000  # targets that outweigh starting workers, which takes as long as some thousands of them
EACH_PAYS = 8  # minimum number of scenarios per worker
MOST_TOGETHER = 64  # scenarios per part: fewer make calls with fewer lanes, more make the last part take longer


def profitable_count(cores: int, scenarios: int, targets: int) -> int:
    """Return the number of processes for a number of scenarios on a number of cores.

    It depends on this call alone, not on earlier ones.

    Args:
        cores: Number of cores.
        scenarios: Number of scenarios of this call.
        targets: Number of targets of this call and of those that belong together with it, as a sweep's shards do.
    """
    return max(1, min(cores, scenarios // EACH_PAYS)) if targets >= START_PAYS else 1


def shares(count: int, processes: int) -> list[Int[np.ndarray, "_"]]:
    """Divide so many scenarios into parts, each planned by the next free process; return their positions.

    Neighbours in a grid are alike, so scenarios are dealt out in turn and each part gets its share of the hard ones.
    """
    parts = min(count, max(processes, -(-count // MOST_TOGETHER)))
    return [np.arange(first, count, parts) for first in range(parts)]


def portable(*things: Any) -> bytes | None:
    """Pickle objects for a process that imports this package and all installed ones, but not the caller's main module.

    None if they cannot be pickled or need that module.
    """
    try:
        data = pickle.dumps(things)
    except Exception:  # of many kinds
        return None
    return None if b"__main__" in data else data


class Spread(NamedTuple):
    """Results of the parts, in their order, and the time until the workers were ready [s]."""

    results: list
    start_s: float


def spread(
    processes: int,
    call: Callable,
    shared: bytes,
    parts: Sequence,
    report: Callable[[np.ndarray], None] | None,
    ready: Callable[[], Any] = tuple,
) -> Spread:
    """Return call(set_counts, *shared, part) for every part.

    set_counts(a, b) sets the two counts of a part's progress.

    Args:
        processes: Number of workers.
        call: The function.
        shared: Objects for all parts, see `portable`; they are sent to each worker once and kept there for the next
            call.
        parts: One argument of `call` each.
        report: Called repeatedly with the counts of all parts (P, 2); an exception in it ends the work.
        ready: Called in each worker before the first part, for imports that take time.

    Raises:
        Exception: The one of the first part that fails.
        Lost: If a worker dies.
    """
    with temporary_folder() as folder:
        file = folder / sha256(shared).hexdigest()
        file.write_bytes(shared)
        board = np.memmap(folder / BOARD, np.int64, "w+", shape=(len(parts), 2))
        with signals_blocked():
            workers, began = _executor(processes), time.perf_counter()
            started = [workers.submit(ready) for _ in range(processes)]
        try:
            _watched(started, lambda: None)
            start_s = time.perf_counter() - began
            requested = [workers.submit(_work, file, k, call, part) for k, part in enumerate(parts)]
            _watched(requested, lambda: report and report(np.array(board)))
            return Spread([each.result() for each in requested], start_s)
        except BaseException as error:
            workers.shutdown(kill_workers=True)
            if isinstance(error, BrokenProcessPool):
                raise Lost("a worker process is gone; it may have run out of memory") from None
            raise


def _watched(requested: Sequence[Future], look: Callable[[], Any]) -> None:
    """Wait for all futures, calling `look` at intervals; raise the first exception among them."""
    left = set(requested)
    while left:
        done, left = wait(left, POLL_S, FIRST_EXCEPTION)
        for each in done:
            each.result()
        look()


def _executor(processes: int) -> Any:
    from loky import get_reusable_executor  # imported here, as a plan of one scenario does not need it

    given = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
    how = {"timeout": IDLE_S, "initializer": _begin_worker, "initargs": given, "env": ENVIRONMENT}
    return get_reusable_executor(processes, **how)


# Code that runs in a worker

BOARD = "board"
# The calling process keeps the GPUs. Where psutil is installed, loky takes a worker that grows by 300 MB to leak and
# replaces it; these keep executables.
ENVIRONMENT = {"JAX_PLATFORMS": "cpu", "LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
_kept: dict[str, tuple] = {}  # the last shared objects, by their digest: one entry, as long as the worker lives


def _begin_worker(cache: str | None, least_s: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles it
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least_s)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process with its parent.

    A killed process sends its workers no signal; on Windows they end after `IDLE_S` without work.
    """
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _work(file: Path, number: int, call: Callable, part: Any) -> Any:
    if file.name not in _kept:
        _kept.clear()
        _kept[file.name] = pickle.loads(file.read_bytes())
    board = np.memmap(file.with_name(BOARD), np.int64, "r+").reshape(-1, 2)

    def notify(*numbers: int) -> None:
        board[number] = numbers

    return call(notify, *_kept[file.name], part)
