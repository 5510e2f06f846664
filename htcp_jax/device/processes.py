"""Work shared out among processes of this machine. Engines in one process take turns, as Python runs one thread at a
time; engines in processes of their own do not.

The workers are loky's. They are started once and kept for the next call; they import this package and never the main
module of their caller, which may be a notebook or a script without a guard; and when one of them dies nobody waits for
what it had. The standard library's do neither, and Ray brings a server with it.
"""

import importlib
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

LOOK_S = 0.1  # how often the one that waits looks how far the work has come
IDLE_S = 300  # after which workers without work end
START_PAYS = 10_000  # targets to be planned; a start takes as long as some thousands of them
EACH_PAYS = 8  # scenarios for every worker that is there already
MOST_TOGETHER = 64  # scenarios of a part: of fewer every call has fewer lanes, of more the last part takes longer

_workers: list[Any] = []  # the executor, once it was needed
_asked: list[int] = []  # targets, in calls large enough


def that_pay(cores: int, scenarios: int, targets: int) -> int:
    """How many processes to plan so many scenarios with, of so many targets in all. Workers are started when what was
    asked for so far would have paid for it: whoever asks for much in one call, or again and again, has them."""
    if (most := min(cores, scenarios // EACH_PAYS)) < 2:
        return 1
    _asked.append(targets)
    return most if _workers or sum(_asked) >= START_PAYS else 1


def shares(count: int, processes: int) -> list[Int[np.ndarray, "_"]]:
    """The places of so many scenarios, in parts to be planned one after the other by whoever is free. Neighbours in a
    grid are alike: dealt out in turn, every part has its share of the hard ones."""
    parts = min(count, max(processes, -(-count // MOST_TOGETHER)))
    return [np.arange(first, count, parts) for first in range(parts)]


def portable(*things: Any) -> bytes | None:
    """What a process can make the things of that knows this package and all that can be imported, and nothing of the
    caller's main module; None where there is no such thing."""
    try:
        data = pickle.dumps(things)
    except Exception:  # of many kinds
        return None
    return None if b"__main__" in data else data


class Spread(NamedTuple):
    """What the parts came to, in their order, and the seconds until the workers were ready."""

    results: list
    start_s: float


def spread(
    processes: int, call: Callable, shared: bytes, parts: Sequence, report: Callable[[np.ndarray], None] | None
) -> Spread:
    """call(tell, *shared, part) of every part. shared: see `portable`; it goes to each worker once, and is kept there
    for the next call. tell(a, b): two numbers, how far a part has come, for report: it is given those of all parts (P,
    2) again and again, and what it raises ends the work.

    Raises what the first part to break raises, and Lost when a worker is gone.
    """
    with temporary_folder() as folder:
        file = folder / sha256(shared).hexdigest()
        file.write_bytes(shared)
        board = np.memmap(folder / BOARD, np.int64, "w+", shape=(len(parts), 2))
        with signals_blocked():
            workers, began = _executor(processes), time.perf_counter()
            ready = [workers.submit(_ready) for _ in range(processes)]
        try:
            _watched(ready, lambda: None)
            start_s = time.perf_counter() - began
            asked = [workers.submit(_work, file, k, call, part) for k, part in enumerate(parts)]
            _watched(asked, lambda: report and report(np.array(board)))
            return Spread([each.result() for each in asked], start_s)
        except BaseException as error:
            workers.shutdown(kill_workers=True)
            _workers.clear()
            if isinstance(error, BrokenProcessPool):
                raise Lost("a worker process is gone; it may have run out of memory") from None
            raise


def _watched(asked: Sequence[Future], look: Callable[[], Any]) -> None:
    """Wait for all, and look now and then. Raises what the first of them raises."""
    left = set(asked)
    while left:
        done, left = wait(left, LOOK_S, FIRST_EXCEPTION)
        for each in done:
            each.result()
        look()


def _executor(processes: int) -> Any:
    from loky import get_reusable_executor  # here, because a plan of one scenario needs none of it

    given = jax.config.jax_compilation_cache_dir, jax.config.jax_persistent_cache_min_compile_time_secs
    how = {"timeout": IDLE_S, "initializer": _begin, "initargs": given, "env": ENVIRONMENT}
    _workers[:] = [get_reusable_executor(processes, **how)]
    return _workers[0]


# What follows happens in a worker

BOARD = "board"
# The calling process keeps the GPUs. Where psutil is installed, loky takes a worker that grows by 300 MB to leak and
# replaces it; these keep executables.
ENVIRONMENT = {"JAX_PLATFORMS": "cpu", "LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
_kept: dict[str, tuple] = {}  # what was shared last, by its digest


def _begin(cache: str | None, least_s: float) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that has started this one heeds it
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", least_s)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent: int) -> None:
    """A process that is killed tells its workers nothing; on Windows they end when they have waited `IDLE_S`."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _ready() -> None:
    importlib.import_module("htcp_jax.planning.methods")  # takes a second, which is none of the first part's


def _work(file: Path, number: int, call: Callable, part: Any) -> Any:
    if file.name not in _kept:
        _kept.clear()
        _kept[file.name] = pickle.loads(file.read_bytes())
    board = np.memmap(file.with_name(BOARD), np.int64, "r+").reshape(-1, 2)

    def tell(*numbers: int) -> None:
        board[number] = numbers

    return call(tell, *_kept[file.name], part)
