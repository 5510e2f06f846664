"""Jobs, sweeps and placements that ship with the package, by name."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from htcp_jax.spec import strict_yaml

_PACKAGE = Path(__file__).parents[1]
ROOT = _PACKAGE / "examples" if (_PACKAGE / "examples").is_dir() else _PACKAGE.parent  # in a wheel, or a checkout


def examples() -> dict[str, Path]:
    """Return the YAML files of all examples by name, such as `pipe`, `place/duct` or `sweeps/robot`."""
    files = *(ROOT / "configs").rglob("*.yaml"), *(ROOT / "sweeps").glob("*.yaml")
    names = (file.relative_to(ROOT).with_suffix("").as_posix() for file in files)
    short = (name.removeprefix("configs/").removesuffix("/job") for name in names)
    return dict(sorted(zip(short, files, strict=True)))


def command(name: str) -> str:
    """Return the command that runs an example, such as "htcp sweep"."""
    return {"place": "htcp place", "sweeps": "htcp sweep"}.get(name.partition("/")[0], "htcp plan")


def example_or_path(path: str | Path, folder: Path = Path()) -> Path:
    """Return the path of a file in `folder`; if there is no such file, that of the example with this name."""
    file = folder / path
    return file if file.exists() and not file.is_dir() else examples().get(str(path), file)


def read_mapping(spec: str | Path | Mapping[str, Any], name: str) -> tuple[Path, dict[str, Any]]:
    """Return the path and the content of a YAML file, of an example, or of a mapping in place of a file.

    Args:
        spec: Path of a file, name of an example, or a mapping.
        name: Path that is returned for a mapping.

    Raises:
        InputError: If the file cannot be read.
    """
    if isinstance(spec, Mapping):
        return Path(name), dict(spec)
    path = example_or_path(spec)
    return path, strict_yaml.read_yaml(path)


def description(file: Path) -> str:
    """Return the first sentence of an example's first comment, without its full stop."""
    comment = re.match(r"(# ?.*\n)+", file.read_text(encoding="utf-8"))[0]
    return " ".join(comment.replace("#", " ").split()).split(". ")[0].rstrip(".")


def files_with_baseline(file: Path) -> set[Path]:
    """Return an example's file, its baseline, and all files that these name, directly or indirectly."""
    found = {file, *file.parent.glob(f"baselines/{file.name}")}
    for name in re.findall(r"[\w./-]+\.\w+", re.sub("#.*", "", file.read_text(encoding="utf-8"))):
        if (other := Path(os.path.normpath(file.parent / name))).is_file():
            found |= files_with_baseline(other)
    return found
