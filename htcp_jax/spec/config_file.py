"""Merging of configuration files and overrides, before validation.

    config: base.yaml        # the keys of base.yaml, unless they are set below

Sections are merged key by key. All other values, including lists, are replaced. File names are relative to the folder
of the file that contains them.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.spec import strict_yaml
from htcp_jax.spec.choices import SEAMS
from htcp_jax.spec.examples import example_or_path

BASE = "config"  # key that names the base file
BUILT_IN_ARM, DUCT, NO_CLOUD = "gp50", "duct", "none"  # values of a job's keys that are not file names
LIMIT_PROFILES = "simulation", "datasheet", "model"  # values of robot.limits that are not file names
SEVERAL = ""  # value of workpiece.path if workpiece.seams has the paths
PART_SEAMS = "workpiece.seams"  # its short form is the key seams
# Keys that name files, by section and key, with their values that are not file names but built-in parts.
FILES = {
    ("robot", "model"): (BUILT_IN_ARM,),
    ("robot", "limits"): LIMIT_PROFILES,
    ("workpiece", "cloud"): (DUCT, NO_CLOUD),
    ("workpiece", "path"): (*SEAMS, SEVERAL),
    ("cell", "model"): (None,),
    ("positioner", "model"): (None,),
    ("rail", "model"): (None,),
    ("tool", "model"): (None,),
}


def layers(path: Path) -> list[tuple[str, dict]]:
    """Return the name and content of a YAML file and of each of its base files; a base comes before its users.

    Raises:
        InputError: If a file cannot be read, or if the base files form a cycle.
    """
    return _below(strict_yaml.read_yaml(path), str(path), path.parent, [path])


def layers_of(mapping: Mapping[str, Any], name: str) -> list[tuple[str, dict]]:
    """Return the name and content of a mapping and of each of its base files, see `layers`.

    Args:
        mapping: A configuration; keys may be dotted, and file names are relative to the working folder.
        name: Name of the mapping, for messages.
    """
    raw: dict = {}
    for dotted, value in mapping.items():
        put_key(raw, str(dotted), value)
    return _below(raw, name, Path(), [])


WHOLE = "on", "off"  # mappings that replace earlier ones: the outputs in `program.process`


def merged(raws: Iterable[dict]) -> dict:
    """Return the mapping that combines all mappings; later ones take precedence."""
    combined: dict = {}
    for raw in raws:
        _lay_over(combined, raw)
    return combined


def put_key(raw: dict, dotted: str, value: Any) -> None:
    """Set one key of a configuration. If the value and the existing value are mappings, merge them.

    Args:
        raw: The configuration; it is modified.
        dotted: The dotted key; rows of a list are numbered from 1.
        value: The value.

    Raises:
        InputError: If a row does not exist.
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
        raise InputError(f"{dotted}: no row {number}; the list has {len(rows)} rows")
    own = rows[int(number) - 1] = dict(rows[int(number) - 1])
    put_key(own, key, value)


def parse_override(override: str) -> tuple[str, Any]:
    """Return the dotted key and the value of an option "key=value".

    Raises:
        InputError: If the key or "=" is missing, or if the value is not YAML.
    """
    dotted, equals, text = override.partition("=")
    if not equals or not dotted:
        raise InputError(f"--set expects key=value, not {override!r}")
    return dotted, strict_yaml.parse_yaml(text, f"--set {override}")


def part_key(dotted: str) -> str:
    """Return a dotted key with `workpiece.seams` in place of its short form `seams`."""
    return f"workpiece.{dotted}" if dotted.split(".")[0] == "seams" else dotted


def exclude_path_or_seams(raw: dict, name: str, keys: Iterable[str]) -> None:
    """Empty `workpiece.path` if keys set `workpiece.seams`, and the seams if keys set the path.

    Args:
        raw: A configuration; it is modified.
        name: Its name, for messages.
        keys: The dotted keys that its file or override sets.

    Raises:
        InputError: If both are set.
    """
    given, part = set(keys), raw.get("workpiece")
    if not isinstance(part, dict) or not given & {PART_SEAMS, "workpiece.path"}:
        return
    if PART_SEAMS not in given:
        part["seams"] = []
    elif part["seams"]:
        if "workpiece.path" in given and part["path"] != SEVERAL:
            raise InputError(f"{name}: workpiece.path and seams are both given; write the path as one of the seams")
        part["path"] = SEVERAL


def _with_seams_of_part(raw: dict, name: str) -> None:
    """Move the key `seams`, the short form of `workpiece.seams`, into the section of the part."""
    if "seams" in raw:
        part = raw.setdefault("workpiece", {})
        if not isinstance(part, dict) or "seams" in part:
            raise InputError(f"{name}: seams and workpiece.seams are both given; they are the same key")
        part["seams"] = raw.pop("seams")
    part = raw.get("workpiece")
    exclude_path_or_seams(raw, name, (f"workpiece.{key}" for key in part) if isinstance(part, dict) else ())


def _below(raw: dict, name: str, folder: Path, parents: list[Path]) -> list[tuple[str, dict]]:
    _with_seams_of_part(raw, name)
    _anchor_files(raw, folder)
    if BASE not in raw:
        return [(name, raw)]
    base = raw.pop(BASE)
    if not isinstance(base, str):
        raise InputError(f"{name}: {BASE} is {base!r}; it must name a base file or an example")
    file = example_or_path(base, folder)
    if any(_same(file, other) for other in parents):
        raise InputError(f"{name}: the files named by {BASE} form a circle: {' -> '.join(map(str, [*parents, file]))}")
    return [*_below(strict_yaml.read_yaml(file), str(file), file.parent, [*parents, file]), (name, raw)]


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def named_files(raw: dict) -> Iterator[tuple[str, dict, str]]:
    """Yield each key that names a file: its dotted name, the mapping that contains the key, and its name there."""
    for (section, key), words in FILES.items():
        value = raw.get(section)
        if isinstance(value, dict) and isinstance(value.get(key), str) and value[key] not in words:
            yield f"{section}.{key}", value, key
    part, cell = raw.get("workpiece"), raw.get("cell")
    seams = part.get("seams") if isinstance(part, dict) else ()
    for seam in seams if isinstance(seams, list | tuple) else ():
        if isinstance(seam, dict) and isinstance(seam.get("path"), str) and seam["path"] not in SEAMS:
            yield PART_SEAMS, seam, "path"
    clouds = cell.get("clouds") if isinstance(cell, dict) else ()
    for cloud in clouds if isinstance(clouds, list | tuple) else ():
        if isinstance(cloud, dict) and isinstance(cloud.get("cloud"), str):
            yield "cell.clouds", cloud, "cloud"


def _anchor_files(raw: dict, folder: Path) -> None:
    """Prefix all file names in `raw` with `folder`; names of built-in parts are not changed."""
    for _, owner, key in named_files(raw):
        owner[key] = str(folder / owner[key])


def _lay_over(combined: dict, raw: dict) -> None:
    for key, value in raw.items():
        if key not in WHOLE and isinstance(value, dict) and isinstance(combined.get(key), dict):
            _lay_over(combined[key], value)
        else:
            combined[key] = _copy(value)


def _yaml_value(value: Any) -> Any:
    """Return a Python value converted to YAML's types: mappings to dicts with text keys, paths to text."""
    if isinstance(value, Mapping):
        return {str(key): _yaml_value(item) for key, item in value.items()}
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _copy(value: Any) -> Any:
    return {key: _copy(item) for key, item in value.items()} if isinstance(value, dict) else value
