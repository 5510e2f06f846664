"""Jobs, sweeps and placements that ship with the package, by name."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from htcp_jax.io import strict_yaml

_PACKAGE = Path(__file__).parents[1]
ROOT = _PACKAGE / "examples" if (_PACKAGE / "examples").is_dir() else _PACKAGE.parent  # of a wheel, or of a checkout


def examples() -> dict[str, Path]:
    """Return the YAML file of every example: `cone`, `pipe`, `place/duct`, `sweeps/robot`, ..."""
    files = *(ROOT / "configs").rglob("*.yaml"), *(ROOT / "sweeps").glob("*.yaml")
    names = (file.relative_to(ROOT).with_suffix("").as_posix() for file in files)
    short = (name.removeprefix("configs/").removesuffix("/job") for name in names)
    return dict(sorted(zip(short, files, strict=True)))


def command(name: str) -> str:
    """Return the command that runs the example."""
    return {"place": "htcp place", "sweeps": "htcp sweep"}.get(name.partition("/")[0], "htcp plan")


def example_or_path(path: str | Path) -> Path:
    """Return the file of the example that `path` names, or `path` if it exists or names none."""
    return Path(path) if os.path.exists(path) else examples().get(str(path), Path(path))


def read_mapping(spec: str | Path | Mapping[str, Any], name: str) -> tuple[Path, dict[str, Any]]:
    """Return the path and the content of a YAML file or an example, or of a mapping in place of a file.

    The path of a mapping is `name`, in the working folder.

    Raises:
        InputError: For a file that cannot be read.
    """
    if isinstance(spec, Mapping):
        return Path(name), dict(spec)
    path = example_or_path(spec)
    return path, strict_yaml.read_yaml(path)


def description(file: Path) -> str:
    """Return the first sentence of the file's first comment."""
    comment = re.match(r"(# ?.*\n)+", file.read_text(encoding="utf-8"))[0]
    return " ".join(comment.replace("#", " ").split()).split(". ")[0].rstrip(".")


def files_with_baseline(file: Path) -> set[Path]:
    """Return the file with its baseline and all files to which it refers, recursively."""
    found = {file, *file.parent.glob(f"baselines/{file.name}")}
    for name in re.findall(r"[\w./-]+\.\w+", re.sub("#.*", "", file.read_text(encoding="utf-8"))):
        if (other := Path(os.path.normpath(file.parent / name))).is_file():
            found |= files_with_baseline(other)
    return found
