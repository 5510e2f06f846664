"""Executables written to the cache folder, and loaded again without tracing.

An executable is stored under the name of its program, `executable_key.program_key`. A second, short file, named
`source_key`, says which program a lane function is, and is found without tracing. JAX's own cache keeps these programs,
too, but what it has loaded cannot be serialised again: an executable is stored by the process that compiled it.

On a CPU an executable calls functions of LAPACK by pointers that JAX sets when it lowers such a call, which a process
that only loads does not do: `_load` sets them. An executable that calls anything else outside of it is not kept.
"""

import contextlib
import functools
import pickle
import re
import threading
import zlib
from collections.abc import Callable, Iterator

import jax
import numpy as np
from jax.experimental import serialize_executable

from htcp_jax.device import compile_cache

FAST = 1  # level of compression: a fifth of the size, in 10 ms
CALLED = re.compile('custom_call_target="([^"]+)"')  # in the text of an executable
LAPACK = "lapack_"  # beginning of the names of its functions
HIT = "/jax/compilation_cache/cache_hits"  # JAX's event


def find(source: str | None, device: jax.Device, arguments: tuple) -> jax.stages.Compiled | None:
    """Return the executable that was last compiled from this source; None if there is none that loads.

    Args:
        source: Its `source_key`.
        device: The device.
        arguments: Arguments of the structure that it is compiled for.
    """
    if source is None or (program := compile_cache.read_executable(source)) is None:
        return None
    return _load(program.decode(errors="replace"), device, arguments)


def compiled(
    source: str | None, program: str, compile_: Callable[[], jax.stages.Compiled], device: jax.Device, arguments: tuple
) -> jax.stages.Compiled:
    """Return the executable of a program, loaded if another process has compiled it, else compiled and kept.

    Args:
        source: Its `source_key`; None: it is not found without tracing.
        program: Its `program_key`.
        compile_: Compiles it.
        device: The device.
        arguments: Arguments of the structure that it is compiled for.
    """
    if (found := _load(program, device, arguments)) is None:
        with _jax_hits() as hits:
            found = compile_()
        if hits or not _save(program, found, device):
            return found
    if source is not None:
        compile_cache.write_executable(source, program.encode())
    return found


def _save(program: str, executable: jax.stages.Compiled, device: jax.Device) -> bool:
    """Keep an executable; return False if that fails, as some have no form on disk."""
    try:
        called = set(CALLED.findall(executable.as_text() or ""))
        if device.platform == "cpu" and not all(name.startswith(LAPACK) for name in called):
            return False
        code, _, results = serialize_executable.serialize(executable)
        example = jax.tree.unflatten(results, range(results.num_leaves))  # a tree can be pickled, its structure cannot
        content = pickle.dumps((code, example, bool(called)))
    except Exception:  # of many kinds
        return False
    return compile_cache.write_executable(program, zlib.compress(content, FAST))


def _load(program: str, device: jax.Device, arguments: tuple) -> jax.stages.Compiled | None:
    if (content := compile_cache.read_executable(program)) is None:
        return None
    try:
        code, example, calls_lapack = pickle.loads(zlib.decompress(content))
        if calls_lapack and device.platform == "cpu":
            _set_lapack()
        structures = jax.tree.structure((arguments, {})), jax.tree.structure(example)
        return serialize_executable.deserialize_and_load(
            code, *structures, backend=device.client, execution_devices=[device]
        )
    except Exception:  # of many kinds
        return None


@functools.cache
def _set_lapack() -> None:
    """Have JAX set the pointers to LAPACK's functions, by lowering a call of one of them."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float64))


@contextlib.contextmanager
def _jax_hits() -> Iterator[list[str]]:
    """Yield a list that gets an entry for every program that this thread takes from JAX's own cache."""
    hits, thread = [], threading.get_ident()

    def note(event: str, **_) -> None:
        if event == HIT and threading.get_ident() == thread:
            hits.append(event)

    jax.monitoring.register_event_listener(note)
    try:
        yield hits
    finally:
        jax.monitoring.unregister_event_listener(note)
