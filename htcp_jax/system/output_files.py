"""Writing of output files: whole or not at all, with one line on failure."""

import contextlib
import dataclasses
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.system import files
from htcp_jax.system.unfinished import temporary_folder


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[bool]:
    """Create a folder and its parents for a block, and yield True if the folder is new.

    New folders that are empty at the end of the block are removed.

    Raises:
        InputError: If the folder cannot be created.
    """
    try:
        missing = [each for each in (folder, *folder.parents) if not each.exists()]  # raises if a name is too long
    except OSError as error:
        raise _unwritable(folder, error) from None
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(folder, error) from None
        yield bool(missing)
    finally:
        for each in missing:
            with contextlib.suppress(OSError):  # the folder is not empty
                each.rmdir()


@contextlib.contextmanager
def written_whole(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder. At the end of the block its files are moved into `folder`; after an error, deleted.

    Raises:
        InputError: At once if `folder` cannot be created or written to; at the end if the files cannot be moved.
    """
    with made_folder(folder):
        try:
            with temporary_folder(folder) as scratch:
                yield scratch
                for file in sorted(scratch.iterdir()):
                    os.replace(file, folder / file.name)
        except OSError as error:
            raise _unwritable(folder, error) from None


def _unwritable(folder: Path, error: OSError) -> InputError:
    return InputError(f"cannot write to {folder}: {error.strerror}")


def write_json(file: Path, record: dict) -> None:
    """Write a mapping as a JSON file; NaN and infinities become null.

    Raises:
        InputError: If the file cannot be written.
    """
    write_text(file, json_text(record) + "\n")


def json_text(record: Any) -> str:
    """Return `record` as JSON text; NaN and infinities become null."""
    return json.dumps(_json_value(record), indent=2, allow_nan=False)


@contextlib.contextmanager
def writable_file(file: Path) -> Iterator[None]:
    """Create the folder of a file that the block will write, and check that the file can be written.

    The folder is removed at the end of the block if it is new and empty.

    Raises:
        InputError: Before the block, without side effects, if the file cannot be written.
    """
    with made_folder(file.parent):
        try:
            there = os.path.lexists(file)
            if file.exists() and not (file.is_file() or file.is_dir()):
                raise InputError(f"cannot write to {file}: not a regular file")
            file.open("ab").close()
            if not there:
                file.unlink()
        except OSError as error:
            raise _unwritable(file, error) from None
        yield


def append_text(file: Path, text: str) -> None:
    """Append text to a file in UTF-8; if the file is not empty, a line break is written first.

    Raises:
        InputError: If the file cannot be written. It is then unchanged.
    """
    before = 0
    try:
        before = file.stat().st_size if file.exists() else None
        with file.open("ab") as stream:
            stream.write(f"{chr(10) if before else ''}{text}".encode())
    except OSError as error:
        with contextlib.suppress(OSError):
            file.unlink() if before is None else os.truncate(file, before)
        raise _unwritable(file, error) from None


def write_text(file: Path, text: str) -> None:
    """Write text to a file in UTF-8, atomically.

    Raises:
        InputError: If the file cannot be written. An existing file is then unchanged.
    """
    files.write_atomically(file.parent, file.name, text.encode())


def _json_value(value: Any) -> Any:
    """Return a value converted to JSON's types; NaN and infinities become None."""
    if dataclasses.is_dataclass(value):
        value = dataclasses.asdict(value)
    if isinstance(value, dict):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
