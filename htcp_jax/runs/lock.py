"""Lock of a run folder, and deferred signals, which keep a run consistent while it is written.

Only one sweep at a time may write to a folder: the system frees the lock when its process ends, for any reason. SIGINT
and SIGTERM are recorded, and handled where the work can be stopped cleanly.

The lock is not filelock's, because its file names the process that owns it, and because the folder may be untrusted: a
symbolic link or a hard link to another file is refused before anything is written.
"""

import contextlib
import os
import signal
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.process_exit import is_watched
from htcp_jax.unfinished import NO_LINK, clear_all

try:
    import fcntl
except ImportError:  # no POSIX system: there, folders are not locked
    fcntl = None

LOCK = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder during a block; files left by killed processes are removed first.

    Raises:
        InputError: If another process, which is named, has locked it, and if the folder cannot be written to.
    """
    file = folder / LOCK
    try:
        handle = os.open(file, os.O_RDWR | os.O_CREAT | NO_LINK, 0o644)
    except OSError as error:
        reason = f"{file} is a link" if file.is_symlink() else error.strerror
        raise InputError(f"cannot write to {folder}: {reason}") from None
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
            raise InputError(f"cannot write to {folder}: {file} is not a regular file, or has another name, too")
        _take(handle, folder)
        clear_all(folder)
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
    with contextlib.suppress(OSError):  # the name of the holder is optional; the disk may be full
        os.ftruncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())


class SignalReceived(Exception):
    """Raised after a signal where the work can stop."""


@contextlib.contextmanager
def signals() -> Iterator[list[int]]:
    """Yield a list to which the first SIGINT or SIGTERM is appended; a second one is not caught."""
    came, handlers = [], {}

    def remember(number: int, _) -> None:
        came.append(number)
        for each, handler in () if is_watched() else handlers.items():
            signal.signal(each, handler)

    if threading.current_thread() is threading.main_thread():  # others must not set handlers
        handlers |= {each: signal.signal(each, remember) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield came
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
