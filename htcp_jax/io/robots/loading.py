"""Loading of a Robot from a model file, MJCF or URDF, and the built-in GP50."""

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import jax

from htcp_jax.io.robots.link_meshes import MeshesInFile
from htcp_jax.io.robots.model_file import NONE_LOCKED, PART, no_log, read_robot_file
from htcp_jax.io.robots.safe_xml import read_spec
from htcp_jax.model import Robot, Tool, robot
from htcp_jax.model import tool as tools
from htcp_jax.types import Triple


def load_robot(
    path: str | Path = robot.GP50,
    *,
    tcp_site: str = "tcp",
    limits: str = "model",
    base_m: Triple = tools.ZERO,
    base_rpy_rad: Triple = tools.ZERO,
    tool: Tool | None = None,
    locked: Mapping[str, float] = NONE_LOCKED,
) -> Robot:
    """Read the serial chain to the TCP out of an MJCF or URDF file, through MuJoCo.

    It begins at the world, or at the link that the file names as the part's, see `model_file`.

    Args:
        path: The file. Its capsule and sphere geoms become capsules, on any body; all others are listed in
            `ignored_geoms`. Mesh files are never opened.
        tcp_site: The site, or else the body, whose frame is the TCP. By default "tcp"; without one, the only site of
            the model, or the outermost link of a URDF, which has no sites.
        limits: "model" (the joint ranges of the file, infinite if it has none), "simulation" (+-pi on hinges, slides as
            in the file) or "datasheet" (the <numeric> entries "datasheet_lower" and "datasheet_upper" of the file, one
            value per joint). Joint speeds and accelerations are its <numeric> "speed" and "acceleration", in a URDF its
            joints' <limit>; efforts are the joints' actuatorfrcrange, or `effort`.
        base_m: Position of the model's own frame in the world.
        base_rpy_rad: Its orientation: rotated about world x, then y, then z.
        tool: Mounted on the frame `tcp_site`, which is then the flange.
        locked: Values of joints that do not move, by their names [rad or m]; they are no joints of the robot.

    Raises:
        InputError: For a file that cannot be read, an unknown joint or a value beyond its limits in `locked`, fewer
            than three joints, ball or free joints, joints off the chain, no TCP, no capsules, a radius that is not
            positive, a number that is not finite, a profile that the model does not have, a body of the tool with the
            name of a body in the model, and, if the part moves, for more than nine joints and a base that is moved.
    """
    fields = read_robot_file(Path(path), tcp_site, limits, tools.pose(base_m, base_rpy_rad), tool, locked)
    meshes = MeshesInFile(Path(path).resolve(), tuple(locked.items())) if fields.facts["listed"] else None
    return Robot(**jax.device_put(fields.arrays), **fields.facts, pieces=jax.device_put(fields.pieces()), meshes=meshes)


def part_moves(path: Path) -> bool:
    """Return True if the part moves: the model file names a link other than the world as the part's.

    Raises:
        InputError: For a file that cannot be read.
    """
    try:
        found = os.stat(path)
    except OSError:
        return False  # `load_robot` reports it
    return _part_moves(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=64)
def _part_moves(path: Path, *_: int) -> bool:
    with no_log():
        return any(text.name == PART and text.data != robot.WORLD.name for text in read_spec(path, contacts=True).texts)


def gp50(limits: str = "simulation") -> Robot:
    """Load the Yaskawa Motoman GP50 with its grinding tool: N = 6, K = 8, from robots/gp50.xml.

    Args:
        limits: "simulation" (+-pi on every joint, as in the paper) or "datasheet".

    Raises:
        InputError: For other limits.
    """
    return load_robot(robot.GP50, limits=limits)
