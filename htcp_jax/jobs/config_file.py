"""Configuration files before validation: inheritance between files, and overrides of keys.

    config: base.yaml        # everything in base.yaml, except the keys below

Sections are merged key by key; other values are replaced, lists as a unit. File names are relative to the folder of the
file that contains them.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.io import parts, strict_yaml

BASE = "config"  # the key for the base file
BUILT_IN_ARM, DUCT, NO_CLOUD = "gp50", "duct", "none"  # words of a job, which `config` resolves
# Keys that name files, each with the names of the built-in parts.
FILES = {
    ("robot", "model"): (BUILT_IN_ARM,),
    ("workpiece", "cloud"): (DUCT, NO_CLOUD),
    ("workpiece", "path"): parts.SEAMS,
    ("cell", "model"): (None,),
}


def layers(path: Path) -> list[tuple[str, dict]]:
    """Return the names and contents of a YAML file and its chain of base files, the base first.

    Raises:
        InputError: For a file that cannot be read, and for a cycle of base files.
    """
    return _below(strict_yaml.read_yaml(path), str(path), path.parent, [path])


def layers_of(mapping: Mapping[str, Any], name: str) -> list[tuple[str, dict]]:
    """Return the `layers` of a mapping in place of a file, named `name`.

    Its keys may be dotted, its files are relative to the working folder.
    """
    raw: dict = {}
    for dotted, value in mapping.items():
        put_key(raw, str(dotted), value)
    return _below(raw, name, Path(), [])


def merged(raws: Iterable[dict]) -> dict:
    """Merge mappings; later ones take precedence."""
    combined: dict = {}
    for raw in raws:
        _lay_over(combined, raw)
    return combined


def put_key(raw: dict, dotted: str, value: Any) -> None:
    """Set one key, or merge a mapping into an existing section.

    Args:
        raw: The configuration, which is changed.
        dotted: The key; rows of a list are numbered from 1.
        value: The value.

    Raises:
        InputError: For a row that does not exist.
    """
    *sections, key = dotted.split(".")
    for k, section in enumerate(sections):
        known, more = raw.get(section), sections[k + 1 :]
        if more and (isinstance(known, list) or (known is None and more[0].isdecimal())):
            rows = raw[section] = list(known or [])
            return _put_in_row(rows, sections[k + 1], ".".join([*sections[k + 2 :], key]), dotted, value)
        if not isinstance(raw.get(section), dict):
            raw[section] = {}
        raw = raw[section]
    _lay_over(raw, {key: _yaml_value(value)})


def _put_in_row(rows: list, number: str, key: str, dotted: str, value: Any) -> None:
    """Set a key of one row in a list; rows are numbered from 1."""
    if not number.isdecimal() or not 1 <= int(number) <= len(rows) or not isinstance(rows[int(number) - 1], dict):
        raise InputError(f"{dotted}: there is no row {number}; there are {len(rows)}")
    own = rows[int(number) - 1] = dict(rows[int(number) - 1])
    put_key(own, key, value)


def parse_override(override: str) -> tuple[str, Any]:
    """Split "key=value" from a command line into key and value.

    Raises:
        InputError: Without a key or "=", and for a value that is not YAML.
    """
    dotted, equals, text = override.partition("=")
    if not equals or not dotted:
        raise InputError(f"--set expects key=value, not {override!r}")
    return dotted, strict_yaml.parse_yaml(text, f"--set {override}")


def _below(raw: dict, name: str, folder: Path, parents: list[Path]) -> list[tuple[str, dict]]:
    _anchor_files(raw, folder)
    if BASE not in raw:
        return [(name, raw)]
    base = raw.pop(BASE)
    if not isinstance(base, str):
        raise InputError(f"{name}: {BASE} is {base!r}; it names the file that this one builds on")
    file = folder / base
    if any(_same(file, other) for other in parents):
        raise InputError(f"{name}: configurations in a circle: {' -> '.join(map(str, [*parents, file]))}")
    return [*_below(strict_yaml.read_yaml(file), str(file), file.parent, [*parents, file]), (name, raw)]


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def named_files(raw: dict) -> Iterator[tuple[str, dict, str]]:
    """Yield the keys that name files in a plain configuration: the dotted key, and the mapping with its key."""
    for (section, key), words in FILES.items():
        value = raw.get(section)
        if isinstance(value, dict) and isinstance(value.get(key), str) and value[key] not in words:
            yield f"{section}.{key}", value, key
    cell = raw.get("cell")
    clouds = cell.get("clouds") if isinstance(cell, dict) else ()
    for cloud in clouds if isinstance(clouds, list | tuple) else ():
        if isinstance(cloud, dict) and isinstance(cloud.get("cloud"), str):
            yield "cell.clouds", cloud, "cloud"


def _anchor_files(raw: dict, folder: Path) -> None:
    """Make file names in `raw` relative to `folder`, except the names of built-in parts."""
    for _, owner, key in named_files(raw):
        owner[key] = str(folder / owner[key])


def _lay_over(combined: dict, raw: dict) -> None:
    for key, value in raw.items():
        if isinstance(value, dict) and isinstance(combined.get(key), dict):
            _lay_over(combined[key], value)
        else:
            combined[key] = _copy(value)


def _yaml_value(value: Any) -> Any:
    """Convert a Python value to YAML's types."""
    if isinstance(value, Mapping):
        return {str(key): _yaml_value(item) for key, item in value.items()}
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _copy(value: Any) -> Any:
    return {key: _copy(item) for key, item in value.items()} if isinstance(value, dict) else value
