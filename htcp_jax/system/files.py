"""Safe reading and writing of files: files named by jobs, and files in folders of runs, which may be untrusted.

Readers accept only regular files of limited size, no pipes or devices. In the folder of a run or a plan, they follow no
link that leads out of the folder, and read at most LARGEST bytes per file. JSON must have a limited depth and no
integers beyond 64 bits.

The writer creates a file with a random name in the same folder, follows no link, and renames the file at the end. The
file is locked while it is written, see `unfinished`.
"""

import contextlib
import errno
import io
import json
import logging
import os
import re
import secrets
import stat
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError, Note
from htcp_jax.system.unfinished import NO_LINK, PART, READ, lock_file

LARGEST_NAMED = 2 * 2**30  # maximum size of a file that a job names, and of a Parquet file [bytes]
LARGEST = 64 * 2**20  # maximum size of any other file in a folder, and of decompressed data [bytes]
TAIL = 10_000  # size of the part of a text in which its last line end is looked for [bytes]
LARGEST_NUMBER = 1e100  # numbers of this magnitude or more count as infinite: computations with them overflow
NOT_FINITE = f"numbers must be finite, with a magnitude below {LARGEST_NUMBER:g}"
MOST_VALUES, DEEPEST = 5_000_000, 100  # maximum number of values and nesting depth of JSON
NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | NO_LINK | getattr(os, "O_BINARY", 0)


def known_ending(path: Path, endings: tuple[str, ...]) -> str:
    """Return the ending of a file name in lower case, with its dot.

    Raises:
        InputError: If the ending is not among `endings`.
    """
    ending = path.suffix.lower()
    if ending not in endings:
        raise InputError(f"{path}: unknown ending {ending!r}; valid: {' '.join(endings)}")
    return ending


@contextlib.contextmanager
def opened(path: Path, folder: Path | None = None, largest: int = LARGEST_NAMED) -> Iterator[io.BufferedReader]:
    """Open a regular file for reading.

    Args:
        path: The file.
        folder: A folder; links in `path` must not lead out of it. None: links are not restricted.
        largest: Maximum size [bytes].

    Raises:
        InputError: If the file is not regular or is too large, or if a link leads out of `folder`.
        OSError: If the file is missing or cannot be read.
    """
    if "\0" in str(path):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    real = os.path.realpath(path) if folder is None else resolved_inside(path, folder)
    _check_size(os.stat(real), path, largest)
    with open(os.open(real, READ | NO_LINK), "rb") as stream:
        _check_size(os.fstat(stream.fileno()), path, largest)
        yield stream


def _check_size(found: os.stat_result, path: Path, largest: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f"{path}: not a regular file")
    if found.st_size > largest:
        raise InputError(f"{path}: {found.st_size:,} bytes; at most {largest:,} are allowed")


@contextlib.contextmanager
def open_named(path: Path) -> Iterator[io.BufferedReader]:
    """Open a file named by the user for reading.

    Raises:
        InputError: If the file is missing, cannot be read, is not regular or is too large.
    """
    try:
        with opened(path) as stream:
            yield stream
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read ({one_line(error)})") from None


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file named by the user.

    Raises:
        InputError: See `open_named`.
    """
    with open_named(path) as stream:
        return stream.read()


def read_tail(path: Path) -> bytes:
    """Return the last TAIL bytes of a file named by the user.

    Raises:
        InputError: See `open_named`.
    """
    with open_named(path) as stream:
        stream.seek(max(0, os.fstat(stream.fileno()).st_size - TAIL))
        return stream.read()


def lacks_line_end(data: bytes) -> bool:
    """Return True for the end of a text whose last line has no line end, as in a file that was cut."""
    rest = data.rstrip(b" \t\0\x1a")
    return bool(rest) and not rest.endswith((b"\n", b"\r"))


def note_missing_line_end(path: Path, data: bytes) -> None:
    """Warn by a Note of a text whose last line has no line end, see `lacks_line_end`."""
    if lacks_line_end(data):
        warnings.warn(f"{path}: its last line has no line end; check that the file is complete", Note, stacklevel=3)


def read_inside(file: Path, folder: Path) -> bytes:
    """Return the bytes of a file in a folder; the file may have at most LARGEST bytes.

    Raises:
        InputError: See `opened`.
        OSError: See `opened`.
    """
    with opened(file, folder, LARGEST) as stream:
        return stream.read()


def read_json(file: Path, folder: Path) -> Any:
    """Return the value in a JSON file of a folder; all its numbers are finite, and its integers fit into 64 bits.

    Raises:
        InputError: See `opened`; also if the file is not valid JSON, is nested deeper than DEEPEST, or has more than
            MOST_VALUES values.
        OSError: See `opened`.
    """
    data = read_inside(file, folder)
    if sum(map(data.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise InputError(f"{file}: more than {MOST_VALUES:,} values")
    try:
        found = json.loads(data, parse_float=_finite, parse_int=_positive_integer, parse_constant=_finite)
        _check_depth(found)
        return found
    except RecursionError:
        raise InputError(f"{file}: nested more than {DEEPEST} deep") from None
    except ValueError as error:
        raise InputError(f"{file} is damaged ({one_line(error)})") from None


def _finite(text: str) -> float:
    if not abs(number := float(text)) < LARGEST_NUMBER:
        raise ValueError(f"{text[:40]}: {NOT_FINITE}")
    return number


def _positive_integer(text: str) -> int:
    if len(text) > 20 or not -(2**63) <= (number := int(text)) < 2**63:
        raise ValueError(f"{text[:40]} is beyond 64 bits")
    return number


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(DEEPEST):
        inner = [each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)]
        level = [each for values in inner for each in values if isinstance(each, dict | list)]
        if not level:
            return
    raise RecursionError


def write_atomically(folder: Path, name: str, data: bytes) -> None:
    """Write a file into a folder atomically: under a temporary name, then renamed to `name`.

    Raises:
        InputError: If writing fails, if `name` exists and is not a regular file, or if a link leads out of the folder.
    """
    file = folder / name
    try:
        place = resolved_inside(file.parent, folder)
        if file.exists() and not file.is_file():
            raise InputError(f"cannot write to {file}: {'it is a folder' if file.is_dir() else 'not a regular file'}")
        part = place / f"{PART}{secrets.token_hex(8)}"
        try:
            with open(os.open(part, NEW, 0o666), "wb") as stream:
                lock_file(stream.fileno())
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, place / file.name)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}") from None


def make_folder(folder: Path, name: str) -> None:
    """Create the subfolder `name` of a folder if it does not exist.

    Raises:
        InputError: If the subfolder cannot be created, or if a link leads out of `folder`.
    """
    try:
        resolved_inside(folder / name, folder).mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror}") from None


def resolved_inside(path: Path, folder: Path) -> Path:
    """Return a path with all links resolved.

    Raises:
        InputError: If the resolved path is outside the folder.
    """
    real = Path(os.path.realpath(path))
    if not real.is_relative_to(os.path.realpath(folder)):
        raise InputError(f"{path}: the file is a link to a place outside {folder}; such links are not followed")
    return real


def one_line(error: BaseException) -> str:
    """Format an exception as one short line, without control characters from a damaged file."""
    words = "".join(letter if letter.isprintable() else " " for letter in str(error)[:120]).split()
    return " ".join([f"{type(error).__name__}:", *words]) if words else type(error).__name__


def cause(error: BaseException, file: Path) -> str:
    """Return an error's message without the file name at its beginning."""
    found = re.fullmatch(rf"{re.escape(str(file))}(?:: (.*)| is damaged \((.*)\))", str(error), re.DOTALL)
    return str(error) if found is None else found[1] or found[2]


@contextlib.contextmanager
def quiet():
    """Return a context that suppresses warnings of third-party parsers, and the tracebacks that trimesh logs."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)  # also silences its child loggers
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
