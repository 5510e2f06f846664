"""Executables written to the cache folder, and loaded again without tracing.

An executable is stored under the name of its program, `cache_key.program_key`. A second, short file, named by
`source_key`, contains this name, so that the executable is found without tracing. Only the process that compiled an
executable stores it, as an executable loaded from JAX's own cache cannot be serialised again.

On a CPU an executable calls functions of LAPACK by pointers. JAX sets the pointers when it lowers such a call. A
process that only loads executables lowers none, so `_read` sets the pointers. An executable that calls other external
functions is not stored.

A command may `preload` the programs that it used last time. Nearly all of the time for loading is spent before JAX asks
for the structure of the arguments, so that loading can begin before the scene is known.
"""

import contextlib
import functools
import pickle
import re
import threading
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import jax
import numpy as np
from jax.experimental import serialize_executable

from htcp_jax.caching import cache_folder

FAST = 1  # compression level: a fifth of the size in 10 ms
CALLED = re.compile('custom_call_target="([^"]+)"')  # external calls in the text of an executable
LAPACK = "lapack_"  # prefix of the names of LAPACK's functions
HIT = "/jax/compilation_cache/cache_hits"  # JAX's event for a hit in its own cache

_turn = threading.Lock()
_begun: dict[str, "_Begun"] = {}  # programs whose loading has begun, by name
_used: dict[str, None] = {}  # names of the programs that this process has used, in order


def find(source: str | None, device: jax.Device, arguments: tuple) -> jax.stages.Compiled | None:
    """Return the executable that was last compiled from a source; None if it does not exist or cannot be loaded.

    Args:
        source: `source_key` of the lane function; None: the result is None.
        device: The device.
        arguments: Arguments with the structure that the executable is compiled for.
    """
    if source is None or (program := cache_folder.read(source)) is None:
        return None
    return _load(program.decode(errors="replace"), device, arguments)


def compiled(
    source: str | None, program: str, compile_: Callable[[], jax.stages.Compiled], device: jax.Device, arguments: tuple
) -> jax.stages.Compiled:
    """Return the executable of a program: loaded if it is stored, else compiled and stored.

    Args:
        source: `source_key` of the lane function; None if it has none.
        program: `program_key` of the program.
        compile_: Function that compiles the program.
        device: The device.
        arguments: Arguments with the structure that the program is compiled for.
    """
    if (found := _load(program, device, arguments)) is None:
        with _jax_hits() as hits:
            found = compile_()
        if hits or not _save(program, found, device):
            return found
    if source is not None:
        cache_folder.write(source, program.encode())
    return found


def _save(program: str, executable: jax.stages.Compiled, device: jax.Device) -> bool:
    """Store an executable; return False if this fails: some executables cannot be serialised."""
    try:
        called = set(CALLED.findall(executable.as_text() or ""))
        if device.platform == "cpu" and not all(name.startswith(LAPACK) for name in called):
            return False
        code, _, results = serialize_executable.serialize(executable)
        example = jax.tree.unflatten(results, range(results.num_leaves))  # a tree can be pickled, its structure cannot
        content = pickle.dumps((code, example, bool(called)))
    except Exception:  # serialisation raises exceptions of many types
        return False
    return cache_folder.write(program, zlib.compress(content, FAST))


class _Begun:
    """A program that is loaded in a thread before it is called. JAX asks for the structure of its arguments last."""

    def __init__(self) -> None:
        self.structure: Future = Future()  # of the arguments
        self.executable: Future = Future()
        self._has_turn = False

    def read(self, program: str, device: jax.Device) -> None:
        """Load the program; only one is loaded at a time."""
        _turn.acquire()
        self._has_turn = True
        try:
            self.executable.set_result(_read(program, device, self))
        finally:
            self._end_turn()

    def unflatten(self, leaves: list) -> Any:
        """Return the arguments with these leaves, as soon as their structure is known. JAX calls it after loading."""
        self._end_turn()
        return self.structure.result().unflatten(leaves)

    def _end_turn(self) -> None:
        if self._has_turn:
            self._has_turn = False
            _turn.release()


def preload(name: str, device: jax.Device) -> None:
    """Begin to load the programs that were last used under a name, in threads.

    Args:
        name: The name, see `remember`.
        device: The device.
    """
    for program in (cache_folder.read(f"used-{name}") or b"").decode().split():
        _begun[program] = begun = _Begun()
        threading.Thread(target=begun.read, args=(program, device), daemon=True).start()


def remember(name: str) -> None:
    """Store the names of the programs that this process has used, for `preload`."""
    if (used := " ".join(_used).encode()) != cache_folder.read(f"used-{name}"):
        cache_folder.write(f"used-{name}", used)


def _load(program: str, device: jax.Device, arguments: tuple) -> jax.stages.Compiled | None:
    structure = jax.tree.structure((arguments, {}))
    _used.setdefault(program)
    if (begun := _begun.pop(program, None)) is None:
        return _read(program, device, structure)
    begun.structure.set_result(structure)
    return begun.executable.result()


def _read(program: str, device: jax.Device, structure: Any) -> jax.stages.Compiled | None:
    if (content := cache_folder.read(program)) is None:
        return None
    try:
        code, example, calls_lapack = pickle.loads(zlib.decompress(content))
        if calls_lapack and device.platform == "cpu":
            _set_lapack()
        return serialize_executable.deserialize_and_load(
            code, structure, jax.tree.structure(example), backend=device.client, execution_devices=[device]
        )
    except Exception:  # serialisation raises exceptions of many types
        return None


@functools.cache
def _set_lapack() -> None:
    """Set the pointers to LAPACK's functions, by lowering a call of one of them with JAX."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float64))


@contextlib.contextmanager
def _jax_hits() -> Iterator[list[str]]:
    """Yield a list to which an entry is added for every program that this thread loads from JAX's own cache."""
    hits, thread = [], threading.get_ident()

    def note(event: str, **_) -> None:
        if event == HIT and threading.get_ident() == thread:
            hits.append(event)

    jax.monitoring.register_event_listener(note)
    try:
        yield hits
    finally:
        jax.monitoring.unregister_event_listener(note)
