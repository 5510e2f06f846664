"""Unfinished files and folders: locking, and removal of those that killed processes left.

Their names begin with PART, or with SCRATCH in the system's temporary folder. A process locks what it
writes. `clear` removes only files and folders that are not locked, because their process has ended.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system: nothing is locked
    fcntl = None

PART = ".part-"  # prefix of files that are being written
SCRATCH = "htcp-tmp-"
# Flags for `os.open`. READ: do not wait for a pipe, and do not attach a terminal. NO_LINK: do not follow a link
READ = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


@contextlib.contextmanager
def temporary_folder(folder: Path | None = None) -> Iterator[Path]:
    """Yield a new temporary folder, and remove it at the end of the block.

    Temporary folders of killed processes are removed first.

    Args:
        folder: The parent folder; None: the system's temporary folder.

    Raises:
        OSError: If the folder cannot be created.
    """
    place, prefix = (tempfile.gettempdir(), SCRATCH) if folder is None else (folder, PART)
    clear(Path(place), prefix)
    made = Path(tempfile.mkdtemp(prefix=prefix, dir=place))
    try:
        with _locked_folder(made):
            yield made
    finally:
        shutil.rmtree(made, ignore_errors=True)


@contextlib.contextmanager
def _locked_folder(folder: Path) -> Iterator[None]:
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        lock_file(handle)
        yield
    finally:
        os.close(handle)


def lock_file(handle: int) -> None:
    """Lock an open file, given its descriptor, without waiting. Do nothing if the file system has no locks."""
    if fcntl is not None:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def clear(folder: Path, prefix: str = PART) -> None:
    """Remove from `folder` the unfinished files and folders that this user's killed processes left.

    Their names begin with `prefix`, and no process has locked them.
    """
    with contextlib.suppress(OSError):
        for left in [each for each in os.scandir(folder) if each.name.startswith(prefix)]:
            with contextlib.suppress(OSError):
                _remove(Path(left.path))


def clear_all(folder: Path) -> None:
    """Call `clear` on a folder and on its direct subfolders; links are skipped."""
    for each in [folder, *(each for each in folder.iterdir() if each.is_dir() and not each.is_symlink())]:
        clear(each)


def _remove(left: Path) -> None:
    if left.is_symlink():
        left.unlink()
        return
    handle = os.open(left, READ | NO_LINK)
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises OSError if its process still runs
            if os.fstat(handle).st_uid != os.geteuid():
                return
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    finally:
        os.close(handle)
