"""Files with one change: what a file states is used, refused, or named in one line.

A change renames an element, moves it to where it means something else, doubles it, or doubles its value. The same seed
gives the same change. A change is lost if the reader accepts the file, returns what it returned for the unchanged file,
and warns of nothing new. It is dropped if an element has an unknown name and no warning says so, whatever is returned.
`python tests/changed_files.py [SEEDS] [KIND ...]` lists the lost and the dropped changes.
"""

import dataclasses
import random
import re
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from changed_samples import HARMLESS, MOTION_CONTROLLER, SAMPLES, SIDE_FILES
from fuzz_targets import Target, refusal, written
from hypothesis import strategies as st

from htcp_jax.io.cell import load_cell
from htcp_jax.io.motions import read_motion
from htcp_jax.io.parts import load_geometry
from htcp_jax.io.parts.path_file import read_path_points
from htcp_jax.io.robots.joint_limits import read_joint_limits
from htcp_jax.io.robots.ledger import Ledger
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.srdf import disabled_pairs
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.jobs import load_config
from htcp_jax.trajectory.limits_file import limits_overrides

FINE = "refused", "changed", "named"
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
WORD = re.compile(r"[^\s,;]+")
SRDF_LINKS = "base", "upper", "fore", "tool"


class Change(NamedTuple):
    """A changed file: its text, and a description of the change."""

    description: str
    text: str
    is_renamed: bool  # then it is unknown, and must be refused or named


# Changes of XML


def changed_xml(text: str, harmless: dict[str, str], draw: random.Random) -> Change | None:
    """Return a text with one change; None if the drawn change is impossible or changes nothing."""
    root = ElementTree.fromstring(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    places = [each for each in root.iter() if not is_harmless(each, parents, harmless)]
    element = draw.choice(places)
    act = draw.choice([_rename_element, _rename_attribute, _move_element, _double_element, _double_attribute])
    place = where(element, parents)
    said = act(element, parents, places, harmless, draw)
    changed = ElementTree.tostring(root, encoding="unicode")
    is_renamed = act in (_rename_element, _rename_attribute)
    return Change(f"{place}: {said}", changed, is_renamed) if said else None


def is_harmless(element, parents: dict, harmless: dict[str, str]) -> bool:
    """True for an element that is, or is inside, one on the list."""
    while element is not None:
        if element.tag in harmless or where(element, parents) in harmless:
            return True
        element = parents.get(element)
    return False


def where(element, parents: dict) -> str:
    name = next((f" {key}={element.get(key)!r}" for key in ("name", "link", "link1") if key in element.attrib), "")
    above = parents.get(element)
    return (f"{where(above, parents)} > " if above is not None and above in parents else "") + f"<{element.tag}{name}>"


def renamed(name: str, draw: random.Random) -> str:
    return draw.choice([f"{name}_x", name[:-1] or "x", f"x{name}"])


def _rename_element(element, parents, places, harmless, draw) -> str | None:
    tag = renamed(element.tag, draw)
    if element not in parents or tag == element.tag:
        return None
    element.tag = tag
    return f"renamed to {tag}"


def _attributes(element, parents, harmless, but: str = "") -> list[str]:
    """Names of the attributes that may be changed; `but` is the key of the list's entries for one kind of change."""
    places = {f"{but}{place}" for place in (element.tag, where(element, parents))}
    return [key for key in element.attrib if not any(f"{place}.{key}" in harmless for place in places)]


def _rename_attribute(element, parents, places, harmless, draw) -> str | None:
    if not (keys := _attributes(element, parents, harmless)):
        return None
    old = draw.choice(keys)
    if (new := renamed(old, draw)) in element.attrib:
        return None
    element.attrib = {new if key == old else key: value for key, value in element.attrib.items()}
    return f"attribute {old} renamed to {new}"


def _double_attribute(element, parents, places, harmless, draw) -> str | None:
    keys = set(_attributes(element, parents, harmless)) & set(_attributes(element, parents, harmless, "2 "))
    if not keys:
        return None
    key = draw.choice(sorted(keys))
    old = element.get(key)
    if (new := doubled_value(old)) == old:
        return None
    element.set(key, new)
    return f"{key}={old!r} doubled to {new!r}"


def _move_element(element, parents, places, harmless, draw) -> str | None:
    inside = set(element.iter())
    if element not in parents or not (others := [p for p in places if p not in inside and p is not parents[element]]):
        return None
    target = draw.choice(others)
    parents[element].remove(element)
    target.insert(draw.randint(0, len(target)), element)
    return f"moved into {where(target, parents)}"


def _double_element(element, parents, places, harmless, draw) -> str | None:
    if element not in parents or f"2 {element.tag}" in harmless:
        return None
    above = parents[element]
    copy = ElementTree.fromstring(ElementTree.tostring(element))
    above.insert(list(above).index(element) + 1, copy)
    return "doubled"


def doubled_value(text: str) -> str:
    """Numbers times two; another text twice."""
    words = text.split()
    if words and all(NUMBER.fullmatch(word) for word in words):
        return " ".join(f"{2 * float(word):g}" for word in words) if any(map(float, words)) else text
    return text + text


# Changes of lines: meshes and tables


def changed_lines(text: str, harmless: dict[str, str], draw: random.Random) -> Change | None:
    """Return a text with one change; None if the drawn change is impossible, harmless, or changes nothing."""
    lines = text.splitlines()
    k = draw.randrange(len(lines))
    line, new = lines[k], list(lines)
    if not any(essence(f"{line}\n", harmless)):
        return None
    words = list(WORD.finditer(line))
    word = draw.choice(words)
    kind = draw.choice(["rename", "move line", "move word", "double line", "double word", "double value"])
    if kind == "rename" and not NUMBER.fullmatch(word[0]):
        new[k] = line[: word.start()] + renamed(word[0], draw) + line[word.end() :]
    elif kind == "move line":
        new.insert(draw.randrange(len(lines)), new.pop(k))
    elif kind == "move word" and len(words) > 1:
        a, b = sorted(draw.sample(words, 2), key=lambda each: each.start())
        new[k] = line[: a.start()] + b[0] + line[a.end() : b.start()] + a[0] + line[b.end() :]
        kind = f"{a[0]!r} and {b[0]!r} swapped"
    elif kind == "double line":
        new.insert(k, line)
    elif kind == "double word":
        separator = line[word.end() :][:1] or line[: word.start()][-1:] or " "
        new[k] = line[: word.end()] + separator + line[word.start() :]
    elif kind == "double value" and NUMBER.fullmatch(word[0]):
        new[k] = line[: word.start()] + doubled_value(word[0]) + line[word.end() :]
    changed = "\n".join(new) + "\n"
    if essence(changed, harmless) == essence(text, harmless):
        return None
    return Change(f"line {k + 1} {line.strip()!r}, word {word[0]!r}: {kind}", changed, kind == "rename")


def essence(text: str, harmless: dict[str, str]) -> tuple[list[str], list[str]]:
    """Return the lines without what is harmless, and those whose place means nothing: the faces of an OBJ file."""
    for pattern in harmless:
        text = re.sub(pattern, lambda found: found[1] if found.re.groups and found[1] else "", text, flags=re.MULTILINE)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return [line for line in lines if not line.startswith("f ")], sorted(
        line for line in lines if line.startswith("f ")
    )


# Changes of YAML, in block style


def changed_yaml(text: str, harmless: dict[str, str], draw: random.Random) -> Change | None:
    """Return a text with one change; None if the drawn change is impossible or changes nothing."""
    lines = text.splitlines()
    keys = [k for k, line in enumerate(lines) if line.lstrip().partition(":")[0].strip("- ") not in harmless]
    k = draw.choice(keys)
    line = lines[k]
    end = next((j for j in range(k + 1, len(lines)) if indent(lines[j]) <= indent(line)), len(lines))
    block, rest = lines[k:end], lines[:k] + lines[end:]
    name, _, value = line.strip().partition(": ")
    kind = draw.choice(["rename", "move", "double", "double value"])
    if kind == "rename":
        key = renamed(name.rstrip(":"), draw)
        new = [*lines[:k], line.replace(name.rstrip(":"), key, 1), *lines[k + 1 :]]
    elif kind == "move":
        spots = [j for j in range(len(rest) + 1) if j != k]
        j = draw.choice(spots)
        depth = indent(rest[j]) if j < len(rest) else 0
        if _section(lines, k) == _section([*rest[:j], " " * depth + "x:", *rest[j:]], j):
            return None
        new = [*rest[:j], *(" " * (indent(each) - indent(line) + depth) + each.strip() for each in block), *rest[j:]]
    elif kind == "double":
        new = [*lines[:end], *block, *lines[end:]]
    else:
        changed = re.sub(NUMBER, lambda found: doubled_value(found[0]), value) if NUMBER.search(value) else value * 2
        new = [*lines[:k], line[: len(line) - len(value)] + changed if value else line, *lines[k + 1 :]]
    return (
        None
        if new == lines
        else Change(f"line {k + 1} {line.strip()!r}: {kind}", "\n".join(new) + "\n", kind == "rename")
    )


def indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def _section(lines: list[str], k: int) -> tuple[str, ...]:
    """Keys of the mappings around a line."""
    found, depth = [], indent(lines[k])
    for line in reversed(lines[:k]):
        if indent(line) < depth:
            depth = indent(line)
            found.append(line.strip())
    return tuple(found)


# Kinds of files


def comparable(value: Any) -> Any:
    """Return everything that a reader returned as values that compare by content."""
    if dataclasses.is_dataclass(value):
        return [(each.name, comparable(getattr(value, each.name))) for each in dataclasses.fields(value)]
    if isinstance(value, dict):
        return [(key, comparable(each)) for key, each in value.items()]
    if isinstance(value, list | tuple):
        return [comparable(each) for each in value]
    if isinstance(value, str | bytes | int | float | bool | None):
        return value
    array = np.asarray(value)
    return array.shape, array.dtype.str, array.tobytes()


class Kind(NamedTuple):
    """A file's name, its changes, and its reader."""

    file: str
    change: Callable[[str, dict[str, str], random.Random], Change | None]
    read: Callable[[Path], Any]


def _imported(file: Path):
    arm = import_robot(file, most=1, fixed={"g1": 0.03} if "g1" in file.read_text() else None)
    return arm_xml(arm, file.name), arm.excluded, arm.frozen


def _limits(file: Path):
    arm = load_robot(limits=str(file))
    stated = read_joint_limits(file, arm.joint_names, arm.name)
    return arm, stated, limits_overrides(stated, arm)


def _moved_cell(file: Path):
    return load_cell(file, moved="table", shift_m=(0.1, 0.0, 0.0))


def _motion(file: Path):
    found = read_motion(file, load_robot(), MOTION_CONTROLLER)
    for note in found.notes:
        warnings.warn(note, UserWarning, stacklevel=1)
    return found


KINDS = {
    "URDF, loaded": Kind("arm.urdf", changed_xml, load_robot),
    "URDF, imported": Kind("vendor.urdf", changed_xml, _imported),
    "MJCF arm": Kind("arm.xml", changed_xml, load_robot),
    "MJCF arm, imported": Kind("vendor.xml", changed_xml, _imported),
    "MJCF cell": Kind("cell.xml", changed_xml, _moved_cell),
    "SRDF": Kind(
        "arm.srdf", changed_xml, lambda file: disabled_pairs(file, "arm", ("base", "upper", "fore", "tool"), Ledger())
    ),
    "OBJ": Kind("part.obj", changed_lines, load_geometry),
    "STL": Kind("part.stl", changed_lines, load_geometry),
    "PLY": Kind("part.ply", changed_lines, load_geometry),
    "PLY cloud": Kind("scan.ply", changed_lines, load_geometry),
    "path": Kind("path.csv", changed_lines, read_path_points),
    "path with quaternions": Kind("poses.txt", changed_lines, read_path_points),
    "motion table": Kind("motion.csv", changed_lines, _motion),
    "trajectory message": Kind("trajectory.yaml", changed_yaml, _motion),
    "key frames": Kind("keys.xml", changed_xml, _motion),
    "RAPID": Kind("weld.mod", changed_lines, _motion),
    "KRL": Kind("weld.src", changed_lines, _motion),
    "LS": Kind("weld.ls", changed_lines, _motion),
    "APT": Kind("part.apt", changed_lines, read_path_points),
    "URScript": Kind("weld.script", changed_lines, _motion),
    "INFORM": Kind("weld.jbi", changed_lines, _motion),
    "joint limits": Kind("joint_limits.yaml", changed_yaml, _limits),
    "job": Kind("job.yaml", changed_yaml, lambda file: load_config(file).model_dump(mode="json")),
}


def change_of(name: str, seed: int) -> Change:
    """Return the change of a kind's sample for a seed."""
    kind, draw = KINDS[name], random.Random(f"{name} {seed}")
    while True:
        change = kind.change(SAMPLES[kind.file], HARMLESS[name], draw)
        if change is not None and change.text != SAMPLES[kind.file]:
            return change


def cuts(name: str, count: int = 200) -> list[str]:
    """Return the beginnings of a kind's sample that end at `count` places, except at the ends of lines."""
    text = SAMPLES[KINDS[name].file].rstrip()
    found = (text[: len(text) * k // count] for k in range(count))
    return [cut for cut in found if not cut.endswith("\n")]


def read_with_warnings(name: str, folder: Path, text: str) -> tuple[Any, set[str]]:
    """Return the reader's result and the texts of its warnings."""
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        value = comparable(KINDS[name].read(written(folder, KINDS[name].file, text.encode())))
    return value, {str(each.message) for each in given}


@cache
def unchanged(name: str, folder: Path) -> tuple[Any, set[str]]:
    """Return the result and the warnings for the unchanged sample."""
    for file, text in SIDE_FILES.items():
        written(folder, file, text.encode())
    return read_with_warnings(name, folder, SAMPLES[KINDS[name].file])


def outcome(name: str, folder: Path, change: Change) -> str:
    """Return refused, changed, named, lost, dropped, or the error if it is not an InputError of one line."""
    value, said = unchanged(name, folder)
    try:
        found = refusal(lambda: read_with_warnings(name, folder, change.text))
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if found is None:
        return "refused"
    if found[1] - said:
        return "named"
    return "lost" if found[0] == value else "dropped" if change.is_renamed else "changed"


def check(name: str) -> Callable[[Path, int], bool]:
    def check_one(folder: Path, seed: int) -> bool:
        change = change_of(name, seed)
        found = outcome(name, folder, change)
        assert found in FINE, f"{name}, {change.description}: {found}"
        return found != "refused"

    return check_one


SEEDS = st.integers(0, 2**32 - 1)
TARGETS = {f"changed {name}": Target(1, SEEDS, check(name)) for name in KINDS}


def main(seeds: int, names: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for name in names or KINDS:
            changes = [change_of(name, seed) for seed in range(seeds)]
            found = [outcome(name, Path(folder), change) for change in changes]
            print(f"\n{name}: {dict(Counter(each.partition(':')[0] for each in found))}", flush=True)
            lost = {
                c.description + ("" if what == "lost" else f": {what}")
                for c, what in zip(changes, found, strict=True)
                if what not in FINE
            }
            print(*(f"  {each}" for each in sorted(lost)), sep="\n", flush=True)


if __name__ == "__main__":
    main(int((sys.argv[1:] or [100])[0]), sys.argv[2:])
