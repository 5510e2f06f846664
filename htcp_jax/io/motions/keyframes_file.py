"""MuJoCo key frames: `<keyframe><key time= qpos= qvel=/></keyframe>`, in a file of their own or in a model.

MuJoCo stores key frames as states and does not interpolate between them (MJCF reference, keyframe/key).
"""

import re
from xml.parsers import expat

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.motions.source import Rows, Source, listed
from htcp_jax.status import Kind

USED = {"name", "time", "qpos", "qvel"}
KIND = re.compile(rf"\d+_({'|'.join(kind.words for kind in Kind)})")  # names of keys that this package writes
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class _Keys:
    """Collects the keys of a file."""

    def __init__(self, source: Source):
        self.source, self.parser = source, expat.ParserCreate()
        self.keys: list[tuple[int, dict[str, str]]] = []
        self.path: list[str] = []
        self.others: set[str] = set()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = lambda tag: self.path.pop()
        self.parser.StartDoctypeDeclHandler = lambda *_: self.fail("a document type (<!DOCTYPE) is not allowed")

    def fail(self, message: str) -> None:
        self.source.fail(self.parser.CurrentLineNumber, message)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.path.append(tag)
        if len(self.path) == 1 and tag not in ("mujoco", "keyframe"):
            self.fail(f"<{tag}> is not a MuJoCo file; valid: <mujoco>")
        if tag == "key":
            if self.path[-2:] != ["keyframe", "key"]:
                self.fail("<key> must be in <keyframe>")
            self.keys.append((self.parser.CurrentLineNumber, attributes))
        elif self.path[-2:-1] == ["keyframe"]:
            self.fail(f"<{tag}> is not known in <keyframe>; valid: <key>")
        elif tag != "keyframe" and len(self.path) == 2:
            self.others.add(tag)


def read_keyframes(source: Source) -> Rows:
    """Return the key frames of a file; `qpos` has the joints of the robot's model file, in its order.

    Raises:
        InputError: For invalid XML, keys without qpos, and a wrong number of values.
    """
    source.check_unit("MuJoCo's qpos", "rad")
    found = _Keys(source)
    try:
        found.parser.Parse(source.data, True)
    except expat.ExpatError as error:
        raise InputError(f"{source.file}, line {error.lineno}: not XML ({expat.ErrorString(error.code)})") from None
    names = _names(source)
    lines = np.array([line for line, _ in found.keys], int)
    states = {}
    for name in ("qpos", "qvel"):
        having = [name in attributes for _, attributes in found.keys]
        if any(having) or (name == "qpos" and having):
            if not all(having):
                line = int(lines[having.index(False)])
                source.fail(line, f"the key has no {name}" + (", which other keys have" if any(having) else ""))
            states[name] = np.array([_numbers(source, line, name, each[name], names) for line, each in found.keys])
    with_time = ["time" in attributes for _, attributes in found.keys]
    time_s = None
    if any(with_time):  # MuJoCo's default is 0
        time_s = np.array([_number(source, line, "time", each.get("time", "0")) for line, each in found.keys])
    notes = ["MuJoCo does not interpolate between key frames: linear between configurations."]
    if unused := sorted({key for _, attributes in found.keys for key in attributes} - USED):
        notes.append(f"Attributes of keys that are not used: {listed(unused)}.")
    if found.others:
        notes.append(f"Elements of the model that are not read: {listed(sorted(found.others))}.")
    kinds = [KIND.fullmatch(attributes.get("name", "")) for _, attributes in found.keys]
    if found.keys and not all(kinds) and any("name" in attributes for _, attributes in found.keys):
        notes.append("The keys' names are not used.")
    return Rows(
        names,
        states.get("qpos", np.zeros((0, len(names)))),
        lines,
        time_s=time_s,
        velocity=states.get("qvel"),
        kind=tuple(each[1].upper() for each in kinds if each) if kinds and all(kinds) else None,
        notes=tuple(notes),
    )


def _names(source: Source) -> tuple[str, ...]:
    robot, controller = source.robot, source.controller
    names = [*robot.joint_names, *(robot.all_joint_names[j] for j in robot.followers), *controller.locked]
    order = controller.in_file
    return tuple(names if order is None else [names[k] for k in order])


def _numbers(source: Source, line: int, what: str, text: str, names: tuple[str, ...]) -> list[float]:
    cells = text.split()
    if len(cells) != len(names):
        source.fail(line, f"{what} has {len(cells)} values; the robot's model has {len(names)} joints: {listed(names)}")
    return [_number(source, line, what, cell) for cell in cells]


def _number(source: Source, line: int, what: str, text: str) -> float:
    if NUMBER.fullmatch(text.strip()) is None:
        source.fail(line, f"{what} holds {text.strip()[:40]!r}, which is not a finite number")
    return float(text)
