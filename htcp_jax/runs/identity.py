"""Identity of a run: hashes of its configuration and input files."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.io import files as io_files
from htcp_jax.io import strict_model
from htcp_jax.jobs import PlanConfig

# Keys without influence on a run's identity: it lists its methods, may be planned anywhere, and is timed later.
NO_IDENTITY = "method", "program", "ray"


def file_hash(file: str | Path) -> str:
    """Return the SHA-256 of a file's contents.

    Raises:
        InputError: For a file that cannot be read.
    """
    try:
        with io_files.opened(Path(file)) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}") from None


def refuse_changed(files: Mapping[str, str], folder: Path) -> None:
    """Check that files have not changed since the results in `folder` were planned.

    Args:
        files: Their SHA-256 then, by path.
        folder: Folder of the results, for messages.

    Raises:
        InputError: For a file that is missing or has changed.
    """
    for file, known in files.items():
        if file_hash(file) != known:
            raise InputError(f"{file} is not what it was when {folder} was planned")


def other_format(folder: Path, cause: str) -> InputError:
    """Return the error for a run's or a plan's folder in another version of the format."""
    return InputError(f"{folder} was written by another version of the format and must be planned again: {cause}")


def recorded_config(values: dict, file: Path) -> PlanConfig:
    """Return the configuration that a run's or a plan's `file` records.

    Raises:
        InputError: For values that are no configuration of this version.
    """
    try:
        return strict_model.validate_model(values, PlanConfig, file.name)
    except InputError as error:
        raise other_format(file.parent, str(error).partition(";")[0]) from None


def identity(config: dict, grid: list | tuple, dtype: str, files: dict[str, str]) -> dict:
    """Return the data that identify a run.

    Args:
        config: The configuration; file names are absolute.
        grid: The grid as recorded in a manifest.
        dtype: Float type of the results.
        files: SHA-256 of the input files, which are identified by their contents, not by their paths.
    """
    named = set()

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        if not isinstance(value, str) or value not in files:
            return value
        named.add(value)
        return f"{Path(value).name}, SHA-256 {files[value]}"

    config = {key: value for key, value in config.items() if key not in NO_IDENTITY}
    if config.get("task") == []:  # then the tolerance of angles has no effect
        del config["task"]
        config["settings"] = {key: value for key, value in config["settings"].items() if key != "tolerance_rad"}
    for section, absent in (("cell", "fixtures"), ("robot", "locked")):  # as in runs from older versions
        if section in config and not config[section].get(absent):
            config[section] = {key: value for key, value in config[section].items() if key != absent}
    same = plain({**config, "grid": json.dumps(plain(grid)), "dtype": dtype})
    parts = {}
    for file in sorted(set(files) - named, key=lambda file: (Path(file).name, files[file])):
        parts.setdefault(Path(file).name, []).append(files[file])
    if parts:
        same["parts"] = {name: f"SHA-256 {', '.join(each)}" for name, each in parts.items()}
    return same


def config_hash(same: dict) -> str:
    """Return the SHA-256 of an `identity`."""
    return hashlib.sha256(json.dumps(same, sort_keys=True).encode()).hexdigest()


def identity_differences(there: dict, here: dict) -> list[str]:
    """Describe the differences between two identities."""
    a, b = _leaves(there), _leaves(here)
    names = [name for name in a | b if a.get(name) != b.get(name)]
    return [
        "its grid differs" if name == "grid" else f"{name} is {a.get(name)} there, {b.get(name)} here" for name in names
    ]


def _leaves(tree: dict, prefix: str = "") -> dict[str, Any]:
    found = {}
    for key, value in tree.items():
        found |= _leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found
