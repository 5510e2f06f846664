"""Expansion of xacro files by the library xacrodoc, which needs no ROS, with the extra `xacro`.

xacro evaluates Python expressions in a file, without Python's built-in functions, and opens the files that it includes.
"""

import contextlib
import importlib.util
import io
import shlex
from pathlib import Path
from typing import NamedTuple

from htcp_jax.errors import InputError, install_command


class Expanded(NamedTuple):
    """An expanded file."""

    text: str
    included: frozenset[Path]  # absolute paths of the included files


def expand(path: Path, ending: str = ".urdf") -> Expanded:
    """Expand a xacro file; `$(find PACKAGE)` is a folder of this name next to the file's folder or one above it.

    Args:
        path: The file.
        ending: Ending of the expanded file, for messages.

    Raises:
        InputError: If the extra `xacro` is not installed, and for a file that xacro cannot expand.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        made = next(f"{stem}{ending}" for stem in ("arm", "expanded") if path.name != f"{stem}{ending}")
        install = f'reading it needs the extra "xacro": {install_command("xacro")}'
        by_hand = f"xacro {shlex.quote(str(path))} > {made}"
        raise InputError(f"{path}: a xacro file; {install}; or expand it first: {by_hand}")
    import xacro  # an extra
    from xacrodoc import XacroDoc, packages

    known: dict[str, Path] = {}
    while True:
        packages.reset()
        packages.update_package_cache(known)
        xacro.all_includes.clear()
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                text = XacroDoc.from_file(path, resolve_packages=False).to_urdf_string()
            return Expanded(text, frozenset(Path(name).resolve() for name in xacro.all_includes))
        except Exception as error:  # of xacro, of its YAML and XML parsers, and of Python expressions
            cause = getattr(error, "exc", error)
            if not isinstance(cause, packages.PackageNotFoundError) or cause.args[0] in known:
                raise InputError(f"{path}: xacro cannot expand it: {' '.join(str(error).split())}") from None
            known[cause.args[0]] = _package(path, cause.args[0])


def _package(path: Path, name: str) -> Path:
    home = path.resolve().parent
    for folder in (home, *home.parents):
        if folder.name == name or (folder / name).is_dir():
            return folder if folder.name == name else folder / name
    raise InputError(f"{path}: no package {name!r} in {home} or above it; put it into one of these folders")
