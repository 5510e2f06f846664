"""One sweep at a time in one folder. The system frees the lock when its process ends, however it ends."""

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from htcp_jax.errors import InputError

try:
    import fcntl
except ImportError:  # no POSIX system: there, folders are not locked
    fcntl = None

LOCK = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock. Raises InputError when another process holds it, saying which, and when the folder
    cannot be written to."""
    try:
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}") from None
    try:
        _take(handle, folder)
        yield
    finally:
        os.close(handle)


def _take(handle: int, folder: Path) -> None:
    if fcntl is not None:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.read(handle, 200).decode(errors="replace").strip() or "another process"
            raise InputError(f"{folder} is in use by another sweep: {holder}") from None
        except OSError as error:
            raise InputError(f"cannot lock {folder}: {error.strerror}") from None
    with contextlib.suppress(OSError):  # who holds it is a courtesy; the disk may be full
        os.ftruncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
