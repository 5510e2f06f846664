"""Choices and defaults of a job's keys that the readers of files and the model share."""

from pathlib import Path
from typing import Literal

GP50 = Path(__file__).parents[1] / "model" / "robots" / "gp50.xml"  # the built-in arm
LIMITS_ENDINGS = ".yaml", ".yml", ".json"  # of a file with joint limits
LIMITS_FILE = f"a YAML file such as MoveIt's joint_limits.yaml, with the ending {', '.join(LIMITS_ENDINGS)}"

SEAMS = "weld", "left", "right", "crown", "invert", "girth-shallow", "girth-deep", "helix"  # of the generated duct
# The duct's place in the paper's scene, see `Workpiece.T_world`, and the depth at which its interior begins.
PIVOT = (1.73205679, -0.0037799, 0.57539635)  # [m] world
NEUTRAL_TRANSLATION = (1.24549547, -0.0037799, 0.87525497)  # [m] workpiece origin at wy = wz = 0
INTERIOR_DEPTH_M = 0.2

LengthUnit = Literal["m", "mm", "cm", "in"]
Maker = Literal[  # whose order the angles of a path have
    "abb", "comau", "denso", "doosan", "fanuc", "kawasaki", "kuka", "mitsubishi", "ros", "staubli", "ur", "yaskawa"
]
CHOSEN_ANGLES = ("angle_1", "angle_2", "angle_3")  # roles in `workpiece.path_columns`


def is_limits_file(name: str | Path) -> bool:
    """Return True if a name has the ending of a file with joint limits, instead of being a profile of limits."""
    return Path(name).suffix.lower() in LIMITS_ENDINGS
