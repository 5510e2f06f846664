"""Loading of a Robot from a model file, MJCF or URDF, and the built-in GP50."""

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import jax

from htcp_jax.io.robots.chain import FEWEST_JOINTS
from htcp_jax.io.robots.link_meshes import MeshesInFile
from htcp_jax.io.robots.model_file import NONE_LOCKED, read_robot_file
from htcp_jax.io.robots.safe_xml import PART, read_spec
from htcp_jax.model import Coupling, Robot, robot
from htcp_jax.spec import GP50, ROBOT, ComposedModel, Tool
from htcp_jax.spec import tool as tools
from htcp_jax.types import Triple


def load_robot(
    path: str | Path | ComposedModel = GP50,
    *,
    tcp_site: str = "tcp",
    limits: str = "model",
    base_m: Triple = tools.ZERO,
    base_rpy_rad: Triple = tools.ZERO,
    tool: Tool | None = None,
    locked: Mapping[str, float] = NONE_LOCKED,
    fewest_joints: int = FEWEST_JOINTS,
) -> Robot:
    """Read the serial chain to the TCP from an MJCF or URDF file, which MuJoCo compiles.

    The chain begins at the world, or at the link that the file names as the part's link, see `model_file`.

    Args:
        path: The file, or the models that form a cell. Capsule and sphere geoms on any body become capsules; all other
            geoms for contact are listed in `ignored_geoms`. Mesh files are never opened.
        tcp_site: Name of the site, or else of the body, whose frame is the TCP. If the default "tcp" does not exist,
            the TCP is the model's only site, or a URDF's outermost link.
        limits: Joint limits. "model": the file's joint ranges, infinite where an MJCF file has none. "simulation": +-pi
            for hinges, and the file's ranges for slides. "datasheet": the file's `<numeric>` "datasheet_lower" and
            "datasheet_upper", one value per joint. The name of a file such as MoveIt's joint_limits.yaml: its ranges,
            and those of "model" for joints without one, see `joint_limits.read_joint_limits`. Speeds and accelerations
            are always the model's `<numeric>` "speed" and "acceleration", or a URDF's `<limit>`; efforts are
            `actuatorfrcrange`, or a URDF's `effort`.
        base_m: Position of the model's own frame in the world.
        base_rpy_rad: Orientation of the model's own frame: rotations about world x, then y, then z.
        tool: Tool to mount on the frame `tcp_site`, which is then the flange.
        locked: Values [rad or m], by joint name, of joints that do not move; they are not joints of the robot.
        fewest_joints: Minimum number of joints. Planning requires three; use fewer to load a positioner or a rail.

    Raises:
        InputError: For a file that cannot be read, an unknown joint or a value beyond its limits in `locked`, too few
            joints, ball or free joints, couplings that are not linear, a URDF's joint without a range, joints off the
            chain, a missing TCP, a model without capsules, a radius that is not positive, a number that is not finite,
            a profile of limits that the model lacks, a file of limits that `read_joint_limits` refuses or whose ranges
            are not plausible for the arm, and a body of the tool with the name of a body in the model; if the part
            moves, also for more than nine joints and a moved base.
    """
    source = path if isinstance(path, ComposedModel) else Path(path)
    base = tools.pose(base_m, base_rpy_rad)
    fields = read_robot_file(source, tcp_site, limits, base, tool, locked, fewest_joints)
    has_list = fields.facts["listed"] or fields.facts["listed_together"]
    file = source if isinstance(source, ComposedModel) else source.resolve()
    meshes = MeshesInFile(file, tuple(locked.items())) if has_list else None
    coupling = None
    if fields.coupling is not None:
        arrays = jax.device_put({name: fields.coupling[name] for name in ("factors", "offsets")})
        coupling = Coupling(**fields.coupling | arrays)
    made = {"pieces": jax.device_put(fields.pieces()), "coupling": coupling, "meshes": meshes}
    return Robot(**jax.device_put(fields.arrays), **fields.facts, **made)


def part_moves(path: Path | ComposedModel) -> bool:
    """Return True if the part moves: the model file or the job names a link other than the world as the part's link.

    Raises:
        InputError: For a file that cannot be read.
    """
    if isinstance(path, ComposedModel):
        own = next(each.file for each in path.models if each.key == ROBOT)
        return part_moves(own) if path.part is None else path.part != robot.WORLD.name
    try:
        found = os.stat(path)
    except OSError:
        return False  # `load_robot` reports it
    return _part_moves(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=64)
def _part_moves(path: Path, *_: int) -> bool:
    return any(text.name == PART and text.data != robot.WORLD.name for text in read_spec(path, contacts=True).texts)


def gp50(limits: str = "simulation") -> Robot:
    """Load the Yaskawa Motoman GP50 with its grinding tool: N = 6, K = 8, from robots/gp50.xml.

    Args:
        limits: "simulation" (+-pi on every joint, as in the paper) or "datasheet".

    Raises:
        InputError: For other limits.
    """
    return load_robot(GP50, limits=limits)
