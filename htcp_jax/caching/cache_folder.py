"""The cache folder: the first run compiles for some seconds, later runs load programs and results from this folder.

The folder contains two kinds of files. The subfolder STORED has compiled lane functions, which `kept_executables` finds
and loads without tracing, and results of functions, see `caching.cached_by_values`. All other compiled functions are in
JAX's own cache, which finds a program by its text, after tracing and lowering.

Compiled functions contain native code, and files in STORED are pickles: whoever can write into the folder can run code
as this user. The folder must therefore not be writable by others. STORED is only read if it has mode 700 and the user
owns it.

platformdirs is not used, as it would be a dependency for a single path per operating system.
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
from htcp_jax.system import NO_LINK, PART, READ, clear, lock_file

try:
    import fcntl
except ImportError:  # not a POSIX system: without a lock, processes that start together compile the same functions
    fcntl = None

OF_JAX = "-cache", "-atime"  # suffixes of the names of JAX's files
UNLOCKED = 46  # digits of a program's name that its lock file omits
STORED = "executables"  # subfolder of the cache folder with executables and results
MOST_BYTES = 2**30  # maximum size of all files; if it is exceeded, the files unused for the longest time are removed
UNSEEN = 16  # the size is measured at a process's first write, and again when it has written this part of MOST_BYTES
OTHERS_WRITE, OTHERS_ANY = 0o022, 0o077  # permissions of group and others
DIGEST = 32  # bytes of the digest at the beginning of a stored file
UNREADABLE = "Error reading persistent compilation cache entry"  # how JAX's warning about a damaged file begins


def enable() -> Path | None:
    """Enable the cache on disk, and return its folder.

    The folder is HTCP_CACHE or, if this variable is not set, the user's cache folder. A folder already set through JAX
    takes precedence. HTCP_CACHE=off disables the cache. If the folder belongs to another user or cannot be written, the
    cache is disabled with a warning, and planning continues.

    Returns:
        The folder, or None if the cache is disabled.

    Raises:
        InputError: If users other than this one can write into the folder.
    """
    choice = os.environ.get("HTCP_CACHE", "")
    if choice.lower() in ("off", "0", "no"):
        return None
    import jax  # here, as the command prints its help without JAX

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
            f"{found} is writable by other users, whose programs in it would run with your permissions: "
            f"run chmod 700 {found}, or set HTCP_CACHE to another folder, or to off"
        )
    if not own or not writable:
        _warn_unwritable(found, "permission denied" if own else "it belongs to another user")
        return None
    jax.config.update("jax_compilation_cache_dir", str(found))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    return found


def folder() -> Path | None:
    """Return the cache folder of this process; None if the cache is disabled."""
    import jax

    found = jax.config.jax_compilation_cache_dir
    return Path(found) if found else None


def _warn_unwritable(where: str | Path, why: str) -> None:
    line = f"{where} cannot be used ({why}): compiled programs are not cached; set HTCP_CACHE to another folder"
    warnings.warn(line, UserWarning, stacklevel=3)


def _is_own(path: Path) -> bool:
    """Return True if the user owns the folder."""
    return not hasattr(os, "geteuid") or os.stat(path).st_uid == os.geteuid()


def _is_closed(path: Path, mode: int) -> bool:
    """Return True if group and others have none of the permissions in `mode`."""
    return not hasattr(os, "geteuid") or not stat.S_IMODE(os.stat(path).st_mode) & mode


_unseen_bytes: dict[Path, int] = {}  # written by this process since the size of a folder was measured


def read(key: str) -> bytes | None:
    """Return the content stored under a key; None if its file is missing or damaged."""
    try:
        file = _stored() / key
        handle = os.open(file, READ | NO_LINK)
        with open(handle, "rb") as stream:
            if hasattr(os, "geteuid") and os.fstat(handle).st_uid != os.geteuid():
                return None
            data = stream.read()
            with contextlib.suppress(OSError):
                os.utime(file)  # the time of the last use, see `_remove_oldest`
    except OSError:
        return None
    if data[:DIGEST] == _digest(key, data[DIGEST:]):
        return data[DIGEST:]
    warnings.warn(damaged(), UserWarning, stacklevel=2)
    return None


def damaged() -> str:
    """Return the message about damaged files in the cache folder."""
    return f"{folder()} has damaged files: what they contained is compiled anew; if this is repeated, remove the folder"


def write(key: str, content: bytes) -> bool:
    """Store content under a key, atomically; return False if this fails."""
    try:
        place = _stored()
        clear(place)
        handle, name = tempfile.mkstemp(prefix=PART, dir=place)  # readable only by the user
        with open(handle, "wb") as stream:
            lock_file(handle)
            stream.write(_digest(key, content) + content)
            stream.flush()
            os.replace(name, place / key)
        _unseen_bytes[place] = _unseen_bytes.get(place, MOST_BYTES) + DIGEST + len(content)
        if _unseen_bytes[place] > MOST_BYTES // UNSEEN:
            _remove_oldest(place.parent)
            _unseen_bytes[place] = 0
    except OSError:
        return False
    return True


def _stored() -> Path:
    """Return the folder of stored files, created if needed.

    Raises:
        OSError: If the folder cannot be created, or if other users can access it.
    """
    if (there := folder()) is None or not there.is_dir():
        raise NotADirectoryError
    place = there / STORED
    place.mkdir(mode=0o700, exist_ok=True)
    if place.is_symlink() or not _is_own(place) or not _is_closed(place, OTHERS_ANY):
        raise PermissionError
    return place


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST, key=key.encode()[:64]).digest()


def _remove_oldest(place: Path) -> None:
    """Remove files of JAX and of this package until MOST_BYTES suffice for them and for what is written unseen.

    Files that were unused for the longest time are removed first. Other files are kept.
    """
    found, of_jax = [], [each for each in os.scandir(place) if each.name.endswith(OF_JAX)]
    for each in [*of_jax, *os.scandir(place / STORED)]:
        with contextlib.suppress(OSError):  # removed by another process
            if each.is_file(follow_symlinks=False):
                known = each.stat(follow_symlinks=False)
                found.append((max(known.st_atime, known.st_mtime), known.st_size, each.path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= MOST_BYTES - MOST_BYTES // UNSEEN:
            return
        with contextlib.suppress(OSError):
            os.unlink(path)
        total -= size


@contextlib.contextmanager
def compilation_lock(program: str) -> Iterator[None]:
    """Lock the compilation of a program among processes that share the cache folder.

    Other processes wait, and then load the program. If the lock cannot be created, each process compiles the program.

    Args:
        program: Name of the program, see `program_key`. Programs whose names differ only in the last UNLOCKED digits
            share a lock, which bounds the number of lock files.
    """
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            if fcntl is not None and (there := folder()):
                handle = held.enter_context(open(there / f"{program[:-UNLOCKED]}.lock", "w"))
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _user_cache() -> Path:
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
