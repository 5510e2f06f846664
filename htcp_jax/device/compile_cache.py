"""Persistent cache of executables: the first run compiles for seconds, later ones load from disk.

The cache folder is found without platformdirs, which would be a dependency for one path on each of three systems.
"""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import jax

try:
    import fcntl
except ImportError:  # no POSIX system: processes that start together compile the same functions
    fcntl = None


def enable() -> Path | None:
    """Keep executables in the user's cache folder, or in HTCP_CACHE; HTCP_CACHE=off disables the cache.

    A folder already set through JAX takes precedence. A folder that is not writable disables the cache: it must never
    stop a plan.

    Returns:
        The folder, or None if nothing is kept.
    """
    choice = os.environ.get("HTCP_CACHE", "")
    if choice.lower() in ("off", "0", "no"):
        return None
    if jax.config.jax_compilation_cache_dir:
        return Path(jax.config.jax_compilation_cache_dir)
    try:
        folder = Path(choice) if choice else _user_cache() / "htcp_jax"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return None
    if not os.access(folder, os.W_OK):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    return folder


@contextlib.contextmanager
def compilation_lock(program: str) -> Iterator[None]:
    """Lock the compilation of this executable among processes that share the cache folder.

    The others wait, then load it. If the lock is not available, continue without it.
    """
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            if fcntl is not None and jax.config.jax_compilation_cache_dir:
                name = Path(jax.config.jax_compilation_cache_dir, f"{program.replace(' ', '-')}.lock")
                handle = held.enter_context(open(name, "w"))
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _user_cache() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
