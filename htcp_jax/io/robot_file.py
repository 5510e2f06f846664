"""A Robot from a model file, MJCF or URDF, and the built-in GP50."""

from pathlib import Path

import jax

from htcp_jax.io.link_meshes import MeshesInFile
from htcp_jax.io.robot_model import read_robot_file
from htcp_jax.model.robot import GP50, Robot
from htcp_jax.model.tool import ZERO, Tool, pose
from htcp_jax.types import Triple


def load_robot(
    path: str | Path = GP50,
    *,
    tcp_site: str = "tcp",
    limits: str = "model",
    base_m: Triple = ZERO,
    base_rpy_rad: Triple = ZERO,
    tool: Tool | None = None,
) -> Robot:
    """Read the serial chain from the world to the TCP out of an MJCF or URDF file, through MuJoCo.

    path: the file. Its capsule and sphere geoms become capsules, wherever they are fixed; all others are
        listed in `ignored_geoms`. Mesh files are never opened.
    tcp_site: the site, or else the body, whose frame is the TCP. By default "tcp"; where there is none, the
        only site of the model, or the outermost link of a URDF, which has no sites.
    limits: "model" (the joint ranges of the file, infinite where there is none), "simulation" (+-pi on
        hinges, slides as in the file) or "datasheet" (the <numeric> entries "datasheet_lower" and
        "datasheet_upper" of the file, a value a joint). Joint speeds and accelerations are its <numeric> "speed" and
        "acceleration", of a URDF what its joints' <limit> says; efforts are the joints' actuatorfrcrange, or `effort`.
    base_m, base_rpy_rad: pose of the model's own frame, and so of all that it holds, in the world: turned about world
        x, then y, then z.
    tool: mounted on the frame that `tcp_site` means, which is then the flange.

    Raises InputError for a file that cannot be read, fewer than three joints, ball or free joints, joints off
    the chain, no TCP, no capsules, a radius that is not positive, a number that is not finite, a profile
    that the model does not have, and a body of the tool that is called as one of the model.
    """
    fields = read_robot_file(Path(path), tcp_site, limits, pose(base_m, base_rpy_rad), tool)
    meshes = MeshesInFile(Path(path).resolve()) if fields.facts["listed"] else None
    return Robot(**jax.device_put(fields.arrays), **fields.facts, meshes=meshes)


def gp50(limits: str = "simulation") -> Robot:
    """The Yaskawa Motoman GP50 with its grinding tool: N = 6, K = 8, from robots/gp50.xml.

    limits: "simulation" (+-pi on every joint, as in the paper) or "datasheet"; InputError for another.
    """
    return load_robot(GP50, limits=limits)
