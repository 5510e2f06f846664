"""Reading of scans and CAD parts by other libraries: .pcd .e57 .las .laz clouds, .step .stp parts.

Each library is an optional dependency. It runs in its own process with limits on time and memory, see `parsers`.
"""

import importlib.util
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note, install_command
from htcp_jax.io.parts.columns import ColumnIndices, TablePoints
from htcp_jax.system import open_named, temporary_folder


class ScanFormat(NamedTuple):
    """Parser and libraries for one file format."""

    parser: str  # name of a function in parsers.py
    libraries: tuple[str, ...]
    extra: str  # the package's extra that installs the libraries


SCANS = {
    ".pcd": ScanFormat("pcd", ("pypcd4",), "scan"),
    ".e57": ScanFormat("e57", ("pye57",), "scan"),
    ".las": ScanFormat("las", ("laspy",), "scan"),
    ".laz": ScanFormat("las", ("laspy", "lazrs"), "scan"),
}
PARTS = {ending: ScanFormat("step", ("cascadio",), "cad") for ending in (".step", ".stp")}
OF_ONE_UNIT = (*PARTS, ".e57")  # formats that state their unit, or have one
LONGEST_S = 600
MEMORY = 4 * 2**30  # memory limit [bytes], to which 40 times the file's size is added


def read_scan(path: Path, ending: str) -> TablePoints:
    """Read the points [m] of a scan, and its normals if it has any.

    A Note reports points that the file marks as invalid or withheld, and are therefore ignored.

    Raises:
        InputError: For an invalid file.
    """
    arrays = parsed(path, SCANS[ending])
    return ColumnIndices(3, (0, 1, 2), None, named=True).points(arrays["points"], arrays.get("normals"), str(path))


def read_part(path: Path, ending: str) -> Float[np.ndarray, "F 3 3"]:
    """Read the triangles [m] of a STEP file's faces.

    Raises:
        InputError: For an invalid file.
    """
    return parsed(path, PARTS[ending])["triangles"]


def parsed(path: Path, kind: ScanFormat, longest_s: int = LONGEST_S) -> dict[str, np.ndarray]:
    """Parse a file in a separate process and return its arrays, see `parsers`. Notes contain the parser's remarks.

    Args:
        path: The file.
        kind: Its format.
        longest_s: Time limit.

    Raises:
        InputError: If the extra is not installed, for an invalid file, and if parsing takes longer than the limit.
    """
    ending = path.suffix.lower()
    if any(importlib.util.find_spec(library) is None for library in kind.libraries):
        need = f'reading {ending} needs the extra "{kind.extra}": {install_command(kind.extra)}'
        raise InputError(f"{path}: {need}")
    with open_named(path) as stream:
        size = os.fstat(stream.fileno()).st_size
    script = Path(__file__).with_name("parsers.py")
    with temporary_folder() as folder:
        memory = str(MEMORY + 40 * size)
        # -P: modules next to the script must not shadow Python's own
        command = [sys.executable, "-P", str(script), kind.parser, str(path), str(folder), memory]
        try:
            done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, timeout=longest_s)
        except subprocess.TimeoutExpired:
            raise InputError(f"{path}: not read within {longest_s // 60} minutes") from None
        if done.returncode:
            raise InputError(f"{path}: not a readable {ending} file ({_reason(done.returncode, folder)})")
        with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
            found = dict(arrays)
    for remark in found.pop("remarks", ()):
        warnings.warn(f"{path}: {remark}", Note, stacklevel=4)
    return found


def _reason(code: int, folder: Path) -> str:
    error_file = folder / "error.txt"
    if error_file.exists():
        words = "".join(letter if letter.isprintable() else " " for letter in error_file.read_text()[:120]).split()
        return " ".join(words)
    return f"its parser ended with {signal.Signals(-code).name if code < 0 else code}"
