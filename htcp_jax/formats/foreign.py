"""Files that others wrote: regular ones of at most 2 GB, and one line for whatever is wrong with them."""

import contextlib
import logging
import warnings
from pathlib import Path

from htcp_jax.errors import InputError

LARGEST_FILE = 2 * 2**30


def known_ending(path: Path, endings: tuple[str, ...]) -> str:
    """The file's ending in lower case; InputError when it is not among `endings`."""
    ending = path.suffix.lower()
    if ending not in endings:
        raise InputError(f"{path}: unknown ending {ending!r}; valid are {' '.join(endings)}")
    return ending


def check_file(path: Path) -> None:
    """Raise InputError unless this is a regular file. A pipe or a device would never end."""
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_file():
            raise InputError(f"{path}: not a regular file")
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: {path.stat().st_size} bytes; the largest file read is 2 GB")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from None


def read_bytes(path: Path) -> bytes:
    """The bytes of a regular file. Raises InputError for any other."""
    check_file(path)
    try:
        return path.read_bytes()
    except (OSError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from None


def one_line(error: BaseException) -> str:
    """An exception in one short line, without the control characters that a damaged file brings into it."""
    words = "".join(letter if letter.isprintable() else " " for letter in str(error)[:120]).split()
    return " ".join([f"{type(error).__name__}:", *words]) if words else type(error).__name__


@contextlib.contextmanager
def quiet():
    """Silence a foreign parser: its warnings, and trimesh's logger, which prints whole tracebacks."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)  # of the loggers below it too
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
