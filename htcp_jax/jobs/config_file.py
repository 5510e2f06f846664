"""A configuration as a person writes it, before it is checked: files that build on each other, and changes of keys.

    config: base.yaml        # everything that base.yaml says, but for what follows

Sections are merged key by key; whatever else stands in both is replaced, lists as a whole. File names are relative to
the folder of the file that they stand in.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.io.duct_seams import SEAMS
from htcp_jax.io.strict_yaml import parse_yaml, read_yaml

BASE = "config"  # the key under which a file names the one that it builds on
# Keys that name files, each with the words of the built-in parts.
FILES = {
    ("robot", "model"): ("gp50",),
    ("workpiece", "cloud"): ("duct", "none"),
    ("workpiece", "path"): SEAMS,
    ("cell", "model"): (None,),
}


def layers(path: Path) -> list[tuple[str, dict]]:
    """The name and the contents of the YAML file and of those that it builds on, the innermost first.

    Raises InputError for a file that cannot be read, and for files that build on each other in a circle.
    """
    return _below(read_yaml(path), str(path), path.parent, [path])


def layers_of(mapping: Mapping[str, Any], name: str) -> list[tuple[str, dict]]:
    """The same of a mapping that spells a file; a key may be dotted. Its files are relative to the working folder."""
    raw: dict = {}
    for dotted, value in mapping.items():
        put(raw, str(dotted), value)
    return _below(raw, name, Path(), [])


def merged(raws: Iterable[dict]) -> dict:
    """Each of them laid over the ones before."""
    whole: dict = {}
    for raw in raws:
        _lay_over(whole, raw)
    return whole


def put(raw: dict, dotted: str, value: Any) -> None:
    """Set one key, or lay a mapping over the section that is there. Rows of a list have numbers, from 1. Raises
    InputError for a row that is not there."""
    *sections, key = dotted.split(".")
    for k, section in enumerate(sections):
        known, more = raw.get(section), sections[k + 1 :]
        if more and (isinstance(known, list) or (known is None and more[0].isdecimal())):
            rows = raw[section] = list(known or [])
            return _put_in_row(rows, sections[k + 1], ".".join([*sections[k + 2 :], key]), dotted, value)
        if not isinstance(raw.get(section), dict):
            raw[section] = {}
        raw = raw[section]
    _lay_over(raw, {key: _plain(value)})


def _put_in_row(rows: list, number: str, key: str, dotted: str, value: Any) -> None:
    """Set a key of one row of a list, which are counted from 1."""
    if not number.isdecimal() or not 1 <= int(number) <= len(rows) or not isinstance(rows[int(number) - 1], dict):
        raise InputError(f"{dotted}: there is no row {number}; there are {len(rows)}")
    own = rows[int(number) - 1] = dict(rows[int(number) - 1])
    put(own, key, value)


def parse_override(override: str) -> tuple[str, Any]:
    """Key and value of "key=value" on a command line. Raises InputError."""
    dotted, equals, text = override.partition("=")
    if not equals or not dotted:
        raise InputError(f"--set expects key=value, not {override!r}")
    return dotted, parse_yaml(text, f"--set {override}")


def _below(raw: dict, name: str, folder: Path, on_the_way: list[Path]) -> list[tuple[str, dict]]:
    _anchor_files(raw, folder)
    if BASE not in raw:
        return [(name, raw)]
    base = raw.pop(BASE)
    if not isinstance(base, str):
        raise InputError(f"{name}: {BASE} is {base!r}; it names the file that this one builds on")
    file = folder / base
    if any(_same(file, other) for other in on_the_way):
        raise InputError(f"{name}: configurations in a circle: {' -> '.join(map(str, [*on_the_way, file]))}")
    return [*_below(read_yaml(file), str(file), file.parent, [*on_the_way, file]), (name, raw)]


def _same(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def named_files(raw: dict) -> Iterator[tuple[str, dict, str]]:
    """Where a configuration in its plain form names a file: dotted, and as a mapping and the key in it."""
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
    """Make file names in `raw` relative to `folder`; the words of the built-in parts stay."""
    for _, owner, key in named_files(raw):
        owner[key] = str(folder / owner[key])


def _lay_over(whole: dict, raw: dict) -> None:
    for key, value in raw.items():
        if isinstance(value, dict) and isinstance(whole.get(key), dict):
            _lay_over(whole[key], value)
        else:
            whole[key] = _copy(value)


def _plain(value: Any) -> Any:
    """A value from Python as YAML has it."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def _copy(value: Any) -> Any:
    return {key: _copy(item) for key, item in value.items()} if isinstance(value, dict) else value
