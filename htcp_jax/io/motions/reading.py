"""`read_motion`: the motion in a file of any format that can be read."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.motions.arranging import arranged
from htcp_jax.io.motions.csv_file import read_csv
from htcp_jax.io.motions.inform_file import read_jbi, read_jbi_pulses
from htcp_jax.io.motions.job_controller import JobController
from htcp_jax.io.motions.keyframes_file import read_keyframes
from htcp_jax.io.motions.krl_file import read_krl
from htcp_jax.io.motions.ls_file import read_ls
from htcp_jax.io.motions.motion_file import MotionFile
from htcp_jax.io.motions.numpy_file import read_npy, read_npz
from htcp_jax.io.motions.rapid_file import read_rapid
from htcp_jax.io.motions.ros_file import read_ros_json, read_ros_yaml
from htcp_jax.io.motions.source import ANGLES, Controller, Rows, Source
from htcp_jax.io.motions.urscript_file import read_urscript
from htcp_jax.model import Robot
from htcp_jax.system import read_bytes

MOTION_FORMATS: Mapping[str, Callable[[Source], Rows]] = MappingProxyType(
    {
        "csv": read_csv,
        "ros": read_ros_yaml,
        "ros-json": read_ros_json,
        "npy": read_npy,
        "npz": read_npz,
        "keyframes": read_keyframes,
        "jbi-pulses": read_jbi_pulses,
        "jbi": read_jbi,
        "rapid": read_rapid,
        "krl": read_krl,
        "ls": read_ls,
        "urscript": read_urscript,
    }
)
ENDINGS = {
    ".csv": "csv", ".tsv": "csv", ".yaml": "ros", ".yml": "ros", ".json": "ros-json", ".npy": "npy", ".npz": "npz",
    ".xml": "keyframes", ".mod": "rapid", ".modx": "rapid", ".prg": "rapid", ".script": "urscript",
    ".urscript": "urscript", ".src": "krl", ".ls": "ls",
}  # fmt: skip
OPEN_END = {"csv", "ros", "urscript"}  # formats in which a cut file may be valid
RADIANS = {"ros", "ros-json", "keyframes", "urscript"}  # formats whose language has angles in radians only
LINE_ENDS = b"\n", b"\r", b"\x1a"
BEGINNING = 100_000  # part of a text in which its format is looked for [bytes]
CONTENTS = (  # formats by their text, in this order
    ("jbi", re.compile(rb"\A\s*/JOB\b")),
    ("ls", re.compile(rb"\A\s*/PROG\b")),
    ("keyframes", re.compile(rb"\A\s*<")),
    ("rapid", re.compile(rb"^\s*(?:MODULE|PROC)\s+\w+", re.MULTILINE | re.IGNORECASE)),
    ("krl", re.compile(rb"^\s*(?:&ACCESS\b|(?:GLOBAL\s+)?DEF\s+\w+\s*\()", re.MULTILINE)),
    ("urscript", re.compile(rb"^\s*(?:def\s+\w+\s*\(\s*\)\s*:|(?:movej|servoj)\s*\()", re.MULTILINE)),
    ("ros-json", re.compile(rb"\A\s*[\[{]")),
    ("ros", re.compile(rb"^\s*-?\s*(?:joint_names|joint_trajectory|points):", re.MULTILINE)),
)
PULSES = re.compile(rb"^///PULSE\b", re.MULTILINE)
NAMED = {"csv", "ros", "ros-json", "npz"}  # formats that name the joints
NOTHING = JobController()


def read_motion(
    file: Path,
    robot: Robot,
    controller: Controller = NOTHING,
    *,
    format: str | None = None,
    unit: str | None = None,
    joints: Sequence[str] = (),
    interpolation: str | None = None,
) -> MotionFile:
    """Return the motion in a file.

    Args:
        file: The file.
        robot: The robot whose joints the file moves.
        controller: What the job says about the controller, see `controller_of`.
        format: Name of the format in MOTION_FORMATS; None: by the file's ending and content.
        unit: Unit of angles, "deg" or "rad"; None: as stated by the file or its format.
        joints: Names in the file of the robot's joints, in the order of `robot.joint_names`; empty: the robot's names.
        interpolation: "linear", "cubic" or "quintic"; None: as the format's controller interpolates.

    Raises:
        InputError: If the file cannot be read, for an unknown format, for joints that differ from the robot's, for
            invalid values or times, and for anything in the file that moves in a way that cannot be read.
    """
    if unit is not None and unit not in ANGLES:
        raise InputError(f"{unit!r} is not a unit of angles; valid: {', '.join(ANGLES)}")
    if format is not None and format not in MOTION_FORMATS:
        raise InputError(f"{format!r} is not a format of motions; valid: {', '.join(MOTION_FORMATS)}")
    file = Path(file)
    data = read_bytes(file)
    if not data.strip():
        raise InputError(f"{file} is empty")
    name = format_of_content(file, data) if format is None else format
    source = Source(file, data, robot, controller, unit, tuple(joints))
    if joints:
        source.check_joints()
        if name not in NAMED:
            raise InputError(f"{file}: --joints applies to {', '.join(sorted(NAMED))}; {name} has no names of joints")
    rows = MOTION_FORMATS[name](source)
    if name in OPEN_END and not data.endswith(LINE_ENDS):
        rows = rows._replace(notes=(*rows.notes, "The last line has no line end; check that the file is complete."))
    found = arranged(source, rows, name, interpolation)
    return found._replace(notes=(*found.notes, *_degrees(found, robot))) if name in RADIANS else found


def _degrees(motion: MotionFile, robot: Robot) -> list[str]:
    """Return a note about the first angle above a turn, as of a program that was written in degrees."""
    wide = np.argwhere((np.abs(motion.x) > 2 * np.pi) & ~np.asarray(robot.sliding, bool))
    if not len(wide):
        return []
    n, joint = wide[0].tolist()
    what = f"{robot.joint_names[joint]} is {motion.x[n, joint]:.9g} rad on {motion.counted} {motion.line[n]}"
    return [f"{what}, more than a turn; if the file is in degrees, convert it to radians."]


def format_of_content(file: Path, data: bytes) -> str:
    """Return the format of a file by its ending, or by its content if the ending is not one of a format."""
    ending = file.suffix.lower()
    begin = data[:BEGINNING].removeprefix(b"\xef\xbb\xbf")
    if begin.startswith(b"\x93NUMPY"):
        return "npy"
    if begin.startswith(b"PK\x03\x04"):
        return "npz"
    found = ENDINGS.get(ending) or next((name for name, form in CONTENTS if form.search(begin)), "csv")
    return "jbi-pulses" if found == "jbi" and PULSES.search(data) else found
