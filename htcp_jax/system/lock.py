"""Lock of a run folder, and deferred signals. Both keep a run consistent while it is written.

Only one command at a time may write to a folder. The system releases the lock when the process ends for any reason.
SIGINT and SIGTERM are recorded first, and handled later, where the work can stop cleanly.

The package filelock is not used, for two reasons. The lock file must name the process that has locked it. And the
folder may be untrusted: a lock file that is a symbolic or hard link is refused before anything is written.
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
from htcp_jax.system.process_exit import is_watched
from htcp_jax.system.unfinished import NO_LINK, clear_all

try:
    import fcntl
except ImportError:  # not a POSIX system: folders are not locked
    fcntl = None

LOCK = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder during a block. Unfinished files that killed processes left in it are removed first.

    Raises:
        InputError: If another process has locked the folder (the message names it), or if the folder is not writable.
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
            raise InputError(f"cannot write to {folder}: {file} is not a regular file, or has hard links")
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
            raise InputError(f"{folder} is in use by another command: {holder}") from None
        except OSError as error:
            raise InputError(f"cannot lock {folder}: {error.strerror}") from None
    with contextlib.suppress(OSError):  # ignored, e.g. if the disk is full: the process name is only for messages
        os.ftruncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())


class SignalReceived(Exception):
    """Raised at a point where the work can stop cleanly, after a signal was recorded."""


@contextlib.contextmanager
def signals() -> Iterator[list[int]]:
    """Record SIGINT and SIGTERM during a block: yield a list to which the first one is appended.

    A second signal has its usual effect.
    """
    came, handlers = [], {}

    def remember(number: int, _) -> None:
        came.append(number)
        for each, handler in () if is_watched() else handlers.items():
            signal.signal(each, handler)

    if threading.current_thread() is threading.main_thread():  # other threads cannot set handlers
        handlers |= {each: signal.signal(each, remember) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield came
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
