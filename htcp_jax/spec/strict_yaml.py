"""Strict YAML for configurations: mappings of plain values, without repeated keys, aliases and tags.

Plain values are those of YAML 1.2's core schema. PyYAML by itself reads YAML 1.1, where `1:30` is 90, `on` is true and
`1e-3` is a string. Aliases are refused, because nested aliases can expand a few lines to more values than fit into
memory.
"""

import math
import re
import reprlib
from pathlib import Path
from typing import Any, ClassVar

import yaml

from htcp_jax.errors import InputError
from htcp_jax.system import opened

LARGEST_FILE = 2 * 2**20  # [bytes]; PyYAML reads about 150 kB per second
DEEPEST = 50
UNITS = {"!degrees": math.pi / 180, "!radians": 1.0, "!meters": 1.0, "!millimeters": 1e-3}  # as in xacro, by tag
OF_ANGLES = "!degrees", "!radians"


class Quantity(float):
    """A number that was written with a unit, in rad or m, or per s, s2 or s3."""

    is_angle: bool

    @classmethod
    def of(cls, tag: str, number: float) -> "Quantity":
        """Return the quantity of a number with a tag in `UNITS`."""
        found = cls(UNITS[tag] * number)
        found.is_angle = tag in OF_ANGLES
        return found


def read_yaml(path: str | Path) -> dict:
    """Return the mapping in a YAML file; {} if the file is empty.

    Raises:
        InputError: If the file cannot be read, is not strict YAML, or does not contain a mapping.
    """
    return parse_mapping(yaml_text(path), str(path))


def yaml_text(path: str | Path) -> str:
    """Return the text of a YAML file.

    Raises:
        InputError: If the file cannot be read.
    """
    try:
        with opened(Path(path), largest=LARGEST_FILE) as stream:
            return stream.read().decode()
    except InputError as error:
        raise InputError(f"cannot read {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise InputError(f"cannot read {path}: {reason}") from None


def parse_mapping(text: str, source: str, units: bool = False) -> dict:
    """Return the mapping that a YAML text describes; {} if the text is empty.

    Args:
        text: The text.
        source: Name of the text, for messages.
        units: True to allow the tags in `UNITS`.

    Raises:
        InputError: If the text is not strict YAML, or does not describe a mapping.
    """
    raw = parse_yaml(text, source, units)
    if raw is None:
        return {}
    if not isinstance(raw, dict):
        raise InputError(f"{source}: must be a mapping of keys to values, but is {reprlib.repr(raw)}")
    return raw


class _Loader(yaml.SafeLoader):
    """Safe YAML loader that refuses repeated keys, aliases, tags and deep nesting."""

    yaml_implicit_resolvers: ClassVar[dict] = {}
    tags: ClassVar[tuple[str, ...]] = ()  # allowed tags
    depth = 0

    def compose_node(self, parent, index):
        event = self.peek_event()
        self.depth += 1
        if problem := self._problem(event):
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def _problem(self, event: yaml.Event) -> str | None:
        if isinstance(event, yaml.AliasEvent):
            return f"alias *{event.anchor} is not allowed; write its value out"
        if event.tag is not None and event.tag not in self.tags:
            return f"tag {event.tag} is not allowed; use a plain value"
        return "nested too deeply" if self.depth > DEEPEST else None

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a key is not a plain word", problem_mark=key.start_mark)
            if key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"key {key.value!r} is repeated", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_number(self, node):
        text = node.value.lower()
        if node.tag == FLOAT:
            return float(text.replace(".inf", "inf").replace(".nan", "nan"))
        return int(text, 0 if text.startswith(("0o", "0x")) else 10)


NULL, BOOL, INT, FLOAT = (f"tag:yaml.org,2002:{kind}" for kind in ("null", "bool", "int", "float"))
for tag, pattern, first in (
    (NULL, r"(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    (BOOL, r"(?:true|True|TRUE|false|False|FALSE)$", list("tTfF")),
    (INT, r"(?:[-+]?[0-9]{1,300}|0o[0-7]{1,300}|0x[0-9a-fA-F]{1,300})$", list("-+0123456789")),
    (FLOAT, r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", list("-+.0123456789")),
    (FLOAT, r"(?:[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$", list("-+.")),
):
    _Loader.add_implicit_resolver(tag, re.compile(pattern), first)
for tag in (INT, FLOAT):
    _Loader.add_constructor(tag, _Loader.construct_number)


class _UnitLoader(_Loader):
    """Loader that also reads numbers with a unit, as xacro and MoveIt do: `!degrees 180`."""

    tags = tuple(UNITS)

    def construct_quantity(self, node):
        try:
            number = float(self.construct_scalar(node).replace("_", "x"))  # Python reads 1_0 as ten
            return Quantity.of(node.tag, number)
        except ValueError:
            problem = f"{node.tag} {node.value} is not a number"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark) from None


for tag in UNITS:
    _UnitLoader.add_constructor(tag, _UnitLoader.construct_quantity)


def parse_yaml(text: str, source: str, units: bool = False) -> Any:
    """Return the value that a YAML text describes.

    Args:
        text: The text.
        source: Name of the text, for messages.
        units: True to allow the tags in `UNITS`.

    Raises:
        InputError: If the text is not strict YAML.
    """
    try:
        return yaml.load(text, _UnitLoader if units else _Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f", line {mark.line + 1}" if mark else ""
        raise InputError(f"{source}{where}: {error.problem}") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{source}: not YAML: {' '.join(str(error).split())}") from None
