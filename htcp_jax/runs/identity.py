"""Identity of a run: hashes of its configuration and input files."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.spec import PlanConfig, model_source, strict_model
from htcp_jax.system import files as io_files

# Keys that are not part of a run's identity: methods may be added, Ray does not affect results, timing comes later.
NO_IDENTITY = "method", "program", "ray"
# Keys that are missing in manifests from older versions, with the values that these versions used. Such manifests also
# contain no models except the robot's. The first column is the section, or None for a key outside of sections.
NEW_KEYS = (
    (None, "margin_on", "targets"),
    (None, "transfer_margin_m", 0.0),
    (None, "transfer_falloff_m", 0.05),
    ("cell", "fixtures", None),
    ("robot", "locked", None),
    ("robot", "parent", "world"),
    ("workpiece", "parent", None),
    ("workpiece", "unit", None),
)


def file_hash(file: str | Path) -> str:
    """Return the SHA-256 of a file's contents.

    Raises:
        InputError: If the file cannot be read.
    """
    try:
        with io_files.opened(Path(file)) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}") from None


def refuse_changed(files: Mapping[str, str], folder: Path) -> None:
    """Check that files have not changed since the results in `folder` were planned.

    Args:
        files: The files' SHA-256 at the time of planning, by path.
        folder: Folder of the results, for messages.

    Raises:
        InputError: If a file is missing or has changed.
    """
    for file, known in files.items():
        if file_hash(file) != known:
            raise InputError(f"{file} has changed since {folder} was planned; restore it, or plan again")


def other_format(folder: Path, cause: str) -> InputError:
    """Return the error for a run or plan folder that another version wrote, or that is damaged.

    Args:
        folder: The folder.
        cause: The difference that was found, for the message.
    """
    return InputError(f"{folder} has the format of another version; plan it again: {cause}")


def recorded_config(values: dict, file: Path) -> PlanConfig:
    """Return the configuration recorded in a file of a run or a plan.

    Args:
        values: The recorded values.
        file: The file, for messages.

    Raises:
        InputError: If the values are not a valid configuration in this version.
    """
    try:
        known = {key: absent for section, key, absent in NEW_KEYS if section is None}
        return strict_model.validate_model(known | values, PlanConfig, file.name)
    except InputError as error:
        raise other_format(file.parent, str(error).partition(";")[0]) from None


def identity(config: dict, grid: list | tuple, dtype: str, files: dict[str, str]) -> dict:
    """Return the data that identify a run. A folder is continued only by a sweep with the same data.

    Args:
        config: The configuration; file names are absolute.
        grid: The grid as recorded in a manifest.
        dtype: Float type of the results, such as "float64".
        files: SHA-256 of the input files, by path. The identity contains their names and hashes, not their paths.
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

    same = plain({**_identifying(config), "grid": json.dumps(plain(grid)), "dtype": dtype})
    parts = {}
    for file in sorted(set(files) - named, key=lambda file: (Path(file).name, files[file])):
        parts.setdefault(Path(file).name, []).append(files[file])
    if parts:
        same["parts"] = {name: f"SHA-256 {', '.join(each)}" for name, each in parts.items()}
    return same


def _identifying(config: dict) -> dict:
    """Return the keys of a configuration that identify a run, as all versions record them."""
    config = {key: value for key, value in config.items() if key not in NO_IDENTITY}
    sections = {key: own for key, own in config.items() if isinstance(own, dict)}  # a damaged file may have others
    if config.get("task") == [] and "settings" in sections:  # without a task, the tolerance of angles has no effect
        del config["task"]
        config["settings"] = {key: value for key, value in config["settings"].items() if key != "tolerance_rad"}
    for section in model_source.KEYS[1:]:
        if section in sections and sections[section].get("model") is None:
            del config[section]
    for section, key, absent in NEW_KEYS:
        own = config if section is None else config.get(section)
        if isinstance(own, dict) and (own.get(key) or None) in (None, absent):
            own = {name: value for name, value in own.items() if name != key}
            config = own if section is None else {**config, section: own}
    return config


def config_hash(same: dict) -> str:
    """Return the SHA-256 of the data from `identity`."""
    return hashlib.sha256(json.dumps(same, sort_keys=True).encode()).hexdigest()


def identity_differences(there: dict, here: dict) -> list[str]:
    """Return one text per difference between two identities: `there` of an existing run, `here` of a new one."""
    a, b = _leaves(there), _leaves(here)
    names = [name for name in a | b if a.get(name) != b.get(name)]
    return ["its grid differs" if name == "grid" else f"{name} was {a.get(name)}, now {b.get(name)}" for name in names]


def _leaves(tree: dict, prefix: str = "") -> dict[str, Any]:
    found = {}
    for key, value in tree.items():
        found |= _leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return found
