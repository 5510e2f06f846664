"""Unfinished files and folders: locked by their owner, and removed once its process is gone.

Their names begin with PART, or with SCRATCH in the folder for temporary files. Their owner locks each of them, so that
`clear` removes only those of killed processes.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from htcp_jax.process_exit import PART

try:
    import fcntl
except ImportError:  # no POSIX system: there, nothing is locked
    fcntl = None

SCRATCH = "htcp-tmp-"
# No device becomes the terminal, no pipe waits, and no link is followed at the end of a name
READ = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0) | getattr(os, "O_BINARY", 0)
NO_LINK = getattr(os, "O_NOFOLLOW", 0)


@contextlib.contextmanager
def temporary_folder(folder: Path | None = None) -> Iterator[Path]:
    """Yield a new folder, in `folder` or in the one for temporary files, and remove it at the end of the block.

    Leftovers of killed processes are removed first.

    Raises:
        OSError: If it cannot be made.
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
    """Lock a file that is being written, if the file system supports locks."""
    if fcntl is not None:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def clear(folder: Path, prefix: str = PART) -> None:
    """Remove the files and folders of this user's killed processes from a folder.

    Their names begin with `prefix`, and no process has locked them.
    """
    with contextlib.suppress(OSError):
        for left in [each for each in os.scandir(folder) if each.name.startswith(prefix)]:
            with contextlib.suppress(OSError):
                _remove(Path(left.path))


def clear_all(folder: Path) -> None:
    """Clear a folder and the folders inside it, except links."""
    for each in [folder, *(each for each in folder.iterdir() if each.is_dir() and not each.is_symlink())]:
        clear(each)


def _remove(left: Path) -> None:
    if left.is_symlink():
        left.unlink()
        return
    handle = os.open(left, READ | NO_LINK)
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises OSError if its owner lives
            if os.fstat(handle).st_uid != os.geteuid():
                return
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    finally:
        os.close(handle)
