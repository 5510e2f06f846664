"""Sources of a robot's or a cell's tree of links: one model file, or several models that a job combines."""

from pathlib import Path
from typing import NamedTuple

from htcp_jax.types import Triple

WORLD = "world"
ROBOT, TOOL = "robot", "tool"
KEYS = (ROBOT, "positioner", "rail", TOOL)  # sections of a job that contain a model


class PlacedModel(NamedTuple):
    """A model and its pose in the cell."""

    key: str  # one of KEYS
    file: Path
    parent: str  # world, or KEY.LINK: a link or site of another model
    base_m: Triple  # position of the model's own frame in its parent's
    base_rpy_rad: Triple  # its rotation about the parent's x, then y, then z
    indexed: bool = False  # True: all its joints stand still within each seam


class ComposedModel(NamedTuple):
    """Models that form one tree, including the robot's model, and the link or site that carries the part."""

    models: tuple[PlacedModel, ...]
    part: str | None  # None: the link that the robot's own file names, or the world

    @property
    def label(self) -> Path:
        """Name for messages, in place of a file's path."""
        return Path(" + ".join(each.file.name for each in self.models))


ModelSource = Path | ComposedModel


def default_tcp(source: ModelSource) -> str:
    """Return the default name of the TCP's site: tool.tcp if the cell has a tool's model, else tcp."""
    has_tool = isinstance(source, ComposedModel) and any(each.key == TOOL for each in source.models)
    return f"{TOOL}.tcp" if has_tool else "tcp"


def label_of(source: ModelSource) -> Path:
    """Return the name of a model for messages: its file, or the files of all models."""
    return source.label if isinstance(source, ComposedModel) else source


def split_name(name: str) -> tuple[str, str]:
    """Split KEY.LINK into key and link. The key of a name without one is robot; the key of world is world."""
    if name == WORLD:
        return WORLD, WORLD
    key, _, link = name.partition(".")
    return (key, link) if link and key in KEYS else (ROBOT, name)
