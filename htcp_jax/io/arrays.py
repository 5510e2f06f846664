"""Safe reading of arrays and tables in .npy, .npz and Parquet files, which may be untrusted; writing of Parquet files.

Decompressed data may have LARGEST bytes, or GROWTH times the file's size if that is more.
"""

import io
import math
import os
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.system import LARGEST, one_line, quiet, read_inside

if TYPE_CHECKING:
    import pyarrow as pa

GROWTH = 50  # decompressed data may have this many times the file's size, even if that is more than LARGEST
MOST_ARRAYS = 100  # maximum number of arrays in an archive
NPY_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_arrays(file: Path, folder: Path, leave: Collection[str] = ()) -> dict[str, np.ndarray]:
    """Return the arrays in an .npz file of a folder, by name; pickles are refused.

    Args:
        file: The file.
        folder: The folder of the file; links must not lead out of it.
        leave: Names of arrays to skip.

    Raises:
        InputError: See `opened`; also if the file is damaged, too large when decompressed, or has an array that does
            not contain numbers.
        OSError: See `opened`.
    """
    return read_archive(read_inside(file, folder), file, leave)


def read_archive(data: bytes, file: Path, leave: Collection[str] = (), texts: bool = False) -> dict[str, np.ndarray]:
    """Return the arrays in the bytes of an .npz file, by name; pickles are refused.

    Args:
        data: Content of the file.
        file: Name of the file, for messages.
        leave: Names of arrays to skip.
        texts: True to read also arrays of texts.

    Raises:
        InputError: If the file is damaged, too large when decompressed, or has an array that does not contain numbers.
    """
    found: dict[str, np.ndarray] = {}
    if data.count(b"PK\x01\x02") > MOST_ARRAYS:
        raise InputError(f"{file}: more than {MOST_ARRAYS} arrays")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            _check_growth(file, sum(entry.file_size for entry in entries), len(data))
            for entry in entries:
                if (name := entry.filename.removesuffix(".npy")) in leave:
                    continue
                if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise InputError(f"{file}: {name} has an unsupported compression; valid: stored, deflated")
                with archive.open(entry) as stream:
                    found[name] = read_array(stream.read(entry.file_size), f"{file}: {name}", texts)
    except InputError:
        raise
    except Exception as error:  # a third-party parser may raise any exception on untrusted bytes
        raise InputError(f"{file} is damaged ({one_line(error)})") from None
    return found


def read_array(data: bytes, source: str, texts: bool = False) -> np.ndarray:
    """Return the array in the bytes of an .npy file.

    Args:
        data: Content of the file.
        source: Name of the file, for messages.
        texts: True to read also an array of texts.

    Raises:
        InputError: If the data are damaged, or if the array does not contain numbers.
    """
    # numpy's reader allocates memory for the shape in the header before it reads the data. So only the header is read
    # by numpy, and the array is made from the bytes that exist. Object arrays (pickles) are refused.
    try:
        with quiet():
            stream = io.BytesIO(data)
            shape, by_column, dtype = NPY_HEADERS[np.lib.format.read_magic(stream)](stream)
    except Exception as error:  # as above
        raise InputError(f"{source}: not a .npy array ({one_line(error)})") from None
    if dtype.kind not in ("fiubU" if texts else "fiub"):
        raise InputError(f"{source}: an array of {dtype.name}; it must be an array of numbers")
    if min(shape, default=0) < 0 or len(data) - stream.tell() != math.prod(shape) * dtype.itemsize:
        raise InputError(f"{source}: damaged: its length does not match the shape {shape} in its header")
    return np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape, order="F" if by_column else "C")


def read_parquet(
    stream: io.BufferedReader, file: Path, most_rows: int | None = None, exact: bool = False
) -> "pa.Table":
    """Return the table in an open Parquet file.

    Args:
        stream: The open file.
        file: Path of the file, for messages.
        most_rows: Maximum number of rows; None: unlimited.
        exact: True requires exactly `most_rows` rows.

    Raises:
        InputError: If the file is damaged, too large when decompressed, has an invalid number of rows, or has a column
            that does not contain numbers, strings or lists of numbers.
    """
    import pyarrow as pa  # here, as most commands read no Parquet files
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    try:
        size, schema = os.fstat(stream.fileno()).st_size, pq.read_schema(stream)
        if bad := [field.name for field in schema if not _is_plain(field.type)]:
            raise InputError(f"{file}: column {bad[0]!r} must contain numbers or strings")
        words = [field.name for field in schema if pa.types.is_string(field.type)]
        # A repeated string is stored once (dictionary-encoded). It is decoded only after a check of the column's size.
        found = pq.ParquetFile(stream, read_dictionary=words, page_checksum_verification=True)
        about = found.metadata
        if most_rows is not None and (about.num_rows > most_rows or (exact and about.num_rows != most_rows)):
            raise InputError(f"{file} has {about.num_rows:,} rows instead of {most_rows:,}")
        groups = [about.row_group(k) for k in range(about.num_row_groups)]
        chunks = [group.column(k) for group in groups for k in range(group.num_columns)]
        _check_growth(file, sum(max(8 * one.num_values, one.total_uncompressed_size) for one in chunks), size)
        table = found.read(use_threads=False)
        for name in words:
            lengths = [(pc.max(pc.binary_length(c.dictionary)).as_py() or 0) * len(c) for c in table[name].chunks]
            _check_growth(file, sum(lengths), size)
            place = table.schema.get_field_index(name)
            table = table.set_column(place, schema.field(name), table[name].cast(pa.string()))
        return table
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        raise InputError(f"{file} is not a Parquet file: {one_line(error)}") from None


def _is_plain(kind: "pa.DataType") -> bool:
    import pyarrow as pa

    if pa.types.is_list(kind):
        return pa.types.is_primitive(kind.value_type)
    return pa.types.is_primitive(kind) or pa.types.is_string(kind) or pa.types.is_null(kind)


def parquet_bytes(rows: "pa.Table", **how: Any) -> bytes:
    """Return the bytes of a Parquet file with a table. `how` is passed on to `pyarrow.parquet.write_table`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    pq.write_table(rows, sink, compression="zstd", **how)
    return sink.getvalue().to_pybytes()


def _check_growth(file: Path, decoded: int, size: int) -> None:
    if decoded > max(LARGEST, GROWTH * size):
        raise InputError(f"{file}: {size:,} bytes decompress to {decoded:,}; maximum: {max(LARGEST, GROWTH * size):,}")
