"""The folder of compiled programs: the first run compiles for seconds, later ones load from disk.

It holds two kinds of files. Those in EXECUTABLES are lane functions: `kept_executables` finds and loads them without
tracing. All other functions are in JAX's own cache, which finds a program by its text, after it was traced and lowered.

Both are native code, and the executables are pickles, too: whoever can write here can run code as this user. So the
folder must not be writable by others, and executables are read only from a folder of mode 700 that the user owns.

The folder is found without platformdirs, which would be a dependency for one path on each of three systems.
"""

import contextlib
import hashlib
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.process_exit import PART
from htcp_jax.unfinished import NO_LINK, READ, clear, lock_file

try:
    import fcntl
except ImportError:  # no POSIX system: processes that start together compile the same functions
    fcntl = None

OF_JAX = "-cache", "-atime"  # ends of the names of JAX's files
EXECUTABLES = "executables"  # the folder of executables, in the cache folder
MOST_BYTES = 2**30  # of both kinds of files; beyond, those are removed that were not used for the longest time
OTHERS_WRITE, OTHERS_ANY = 0o022, 0o077  # permissions of group and others
DIGEST = 32  # bytes at the beginning of a file of an executable


def enable() -> Path | None:
    """Keep executables in the user's cache folder, or in HTCP_CACHE; HTCP_CACHE=off disables the cache.

    A folder already set through JAX takes precedence. A folder of another user, or one that cannot be written, disables
    the cache with a warning: it must not stop a plan.

    Returns:
        The folder, or None if nothing is kept.

    Raises:
        InputError: If users other than this one can write into the folder.
    """
    choice = os.environ.get("HTCP_CACHE", "")
    if choice.lower() in ("off", "0", "no"):
        return None
    import jax  # here, as the command prints its help before it is imported

    if there := folder():
        return there
    try:
        found = Path(choice) if choice else _user_cache() / "htcp_jax" / "programs"
        found.mkdir(mode=0o700, parents=True, exist_ok=True)
        exposed, own, writable = not _is_closed(found, OTHERS_WRITE), _is_own(found), os.access(found, os.W_OK)
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        _warn_unwritable(choice or "the user's cache folder", getattr(error, "strerror", None) or str(error))
        return None
    if exposed:
        raise InputError(
            f"{found} can be written by other users, and compiled programs in it would run as this one: "
            f"chmod 700 {found}, or set HTCP_CACHE to another folder, or to off"
        )
    if not own or not writable:
        _warn_unwritable(found, "permission denied" if own else "it belongs to another user")
        return None
    jax.config.update("jax_compilation_cache_dir", str(found))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    return found


def folder() -> Path | None:
    """Return the folder that this process keeps programs in; None if there is none."""
    import jax

    found = jax.config.jax_compilation_cache_dir
    return Path(found) if found else None


def _warn_unwritable(where: str | Path, why: str) -> None:
    line = f"{where} cannot be used ({why}): compiled programs are not kept; HTCP_CACHE names another folder"
    warnings.warn(line, UserWarning, stacklevel=3)


def _is_own(path: Path) -> bool:
    """True if the user owns a folder."""
    return not hasattr(os, "geteuid") or os.stat(path).st_uid == os.geteuid()


def _is_closed(path: Path, mode: int) -> bool:
    """True if nobody but the owner has one of these permissions."""
    return not hasattr(os, "geteuid") or not stat.S_IMODE(os.stat(path).st_mode) & mode


def read_executable(key: str) -> bytes | None:
    """Return the contents that `write_executable` wrote under this key; None if there are none, or others."""
    try:
        file = _executables() / key
        handle = os.open(file, READ | NO_LINK)
        with open(handle, "rb") as stream:
            if hasattr(os, "geteuid") and os.fstat(handle).st_uid != os.geteuid():
                return None
            data = stream.read()
            with contextlib.suppress(OSError):
                os.utime(file)  # used now, see `_remove_oldest`
    except OSError:
        return None
    return data[DIGEST:] if data[:DIGEST] == _digest(key, data[DIGEST:]) else None


def write_executable(key: str, content: bytes) -> bool:
    """Keep an executable under this key: written aside and moved into place. Return False where that fails."""
    try:
        place = _executables()
        clear(place)
        handle, name = tempfile.mkstemp(prefix=PART, dir=place)  # readable by the user alone
        with open(handle, "wb") as stream:
            lock_file(handle)
            stream.write(_digest(key, content) + content)
            stream.flush()
            os.replace(name, place / key)
        _remove_oldest(place.parent)
    except OSError:
        return False
    return True


def _executables() -> Path:
    """Return the folder of executables, made if needed. Raises OSError if there is none to be trusted."""
    if (there := folder()) is None or not there.is_dir():
        raise NotADirectoryError
    place = there / EXECUTABLES
    place.mkdir(mode=0o700, exist_ok=True)
    if place.is_symlink() or not _is_own(place) or not _is_closed(place, OTHERS_ANY):
        raise PermissionError
    return place


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST, key=key.encode()[:64]).digest()


def _remove_oldest(place: Path) -> None:
    """Limit the files of JAX and of this package in the cache folder to MOST_BYTES; others are left alone."""
    found, of_jax = [], [each for each in os.scandir(place) if each.name.endswith(OF_JAX)]
    for each in [*of_jax, *os.scandir(place / EXECUTABLES)]:
        with contextlib.suppress(OSError):  # removed by another process
            if each.is_file(follow_symlinks=False):
                known = each.stat(follow_symlinks=False)
                found.append((max(known.st_atime, known.st_mtime), known.st_size, each.path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= MOST_BYTES:
            return
        with contextlib.suppress(OSError):
            os.unlink(path)
        total -= size


@contextlib.contextmanager
def compilation_lock(program: str) -> Iterator[None]:
    """Lock the compilation of this executable among processes that share the cache folder.

    The others wait, then load it. If the lock is not available, continue without it.
    """
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            if fcntl is not None and (there := folder()):
                handle = held.enter_context(open(there / f"{program.replace(' ', '-')}.lock", "w"))
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _user_cache() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
