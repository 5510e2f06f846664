"""Public problems of path following as jobs: an arm with their capsules, a cell with their boxes, a path of poses.

    problems(data)                  the names in a folder with cppflow/, iklink/ and robots/
    made(problem, folder)           the job; its files are written into `folder`

The rules are those of the tools that published the problems, CppFlow and IKLink. Each waypoint is shifted and rotated
by itself; the path is not rotated.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial.transform import Rotation

BOX = ("x", "y", "z", "roll", "pitch", "yaw", "size_x", "size_y", "size_z")
FETCH_LINKS = (
    "torso_lift shoulder_pan shoulder_lift upperarm_roll elbow_flex forearm_roll wrist_flex wrist_roll gripper"
)
CHECKED = {
    "fetch": ("base_link", *(f"{name}_link" for name in FETCH_LINKS.split()), "head_tilt_link"),
    "panda": (*(f"panda_link{k}" for k in range(8)), "panda_hand"),
}
TOLERANCE = (1e-4, np.deg2rad(0.1))  # of CppFlow [m, rad]
IKLINK, IKLINK_TOLERANCE = "iklink__panda", (1e-3, 0.01)
MOST_BOXES, FAR_M = 4, -50.0  # boxes are padded by distant ones, so that one compilation serves all problems of an arm
SEGMENT_M = 0.02  # tolerance of the TCP's path between two waypoints, for which there are no rules


class PathProblem(NamedTuple):
    """Public problem of path following."""

    name: str
    arm: "Arm"
    position: Float[np.ndarray, "T 3"]  # of the tip, in the base's frame [m]
    rotation: Float[np.ndarray, "T 3 3"]
    boxes: Float[np.ndarray, "B 9"]  # centre [m], roll, pitch, yaw [rad], full sizes [m]
    tolerance: tuple[float, float]  # [m, rad]

    def rest(self, first: int) -> "PathProblem":
        """The problem from one waypoint on."""
        return self._replace(position=self.position[first:], rotation=self.rotation[first:])


class Joint(NamedTuple):
    """Joint of a chain, in the frame of its parent."""

    name: str
    child: str
    parent: str
    T: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, "3"]
    slides: bool
    lower: float  # -inf if it is continuous
    upper: float
    speed: float  # [rad/s or m/s]
    moves: bool


class Arm(NamedTuple):
    """Published arm: its joints from the base outwards, and the capsules of its links."""

    joints: tuple[Joint, ...]  # to the tip, and to other links that are checked; parents first
    base: str
    tip: str
    capsules: dict[str, Float[np.ndarray, "7"]]  # by link: both ends and the radius, in its frame [m]
    ignored: frozenset[frozenset[str]]  # pairs of links that may touch

    @property
    def moving(self) -> tuple[Joint, ...]:
        """Joints that move, in order."""
        return tuple(joint for joint in self.joints if joint.moves)

    @property
    def parents(self) -> dict[str, str]:
        """Parent of every link."""
        return {joint.child: joint.parent for joint in self.joints}


def problems(data: Path) -> list[str]:
    """Names of all problems."""
    return [*sorted(file.stem for file in (data / "cppflow/problems").glob("*.yaml")), IKLINK]


def read_problem(data: Path, name: str) -> PathProblem:
    """Read a problem."""
    if name == IKLINK:
        return _iklink(data)
    given = yaml.safe_load((data / f"cppflow/problems/{name}.yaml").read_text())
    arm = read_arm(data, given["robot"])
    table = np.genfromtxt(data / f"cppflow/paths/{given['path_name']}.csv", delimiter=",", skip_header=1)
    at_zero = np.zeros(3)
    if given["path_offset_frame"] != "world":
        at_zero = poses(arm, np.zeros(len(arm.moving)))[given["path_offset_frame"]][:3, 3]
    own = Rotation.from_quat(table[:, 4:8], scalar_first=True).as_matrix()
    boxes = [[_merged(box)[key] for key in BOX] for box in given.get("obstacles", ())]
    boxes = np.array(boxes, float).reshape(-1, 9)
    boxes[:, :3] += given.get("obstacle_xyz_offset", [0, 0, 0])
    position = table[:, 1:4] + np.array(given["path_xyz_offset"], float) + at_zero
    return PathProblem(name, arm, position, own @ np.array(given["path_R_offset"], float), boxes, TOLERANCE)


def _merged(box: dict | list[dict]) -> dict:
    return box if isinstance(box, dict) else {key: value for part in box for key, value in part.items()}


def _iklink(data: Path) -> PathProblem:
    """Read IKLink's problem, in which links are capsules of one radius about the lines between the joints."""
    given = yaml.safe_load((data / "iklink/panda.yaml").read_text().partition("obstacles")[0])
    arm = read_chain(data / "robots/panda/panda_iklink.urdf", "panda_link0", given["ee_links"][0], ())
    at = {joint.parent: joint.T[:3, 3] for joint in arm.joints if np.linalg.norm(joint.T[:3, 3]) > 0.03}
    capsules = {link: np.array([0, 0, 0, *end, given["link_radius"]]) for link, end in at.items()}
    order = list(capsules)  # every second one overlaps at the wrist, in any configuration
    near = [frozenset(order[k : k + 3 : 2]) for k in range(len(order) - 2)]
    near += [frozenset(order[k : k + 2]) for k in range(len(order) - 1)]
    table = np.genfromtxt(data / "iklink/panda_767.csv", delimiter=",", skip_header=1)
    turned = Rotation.from_quat(table[:, 4:8]).as_matrix()
    arm = arm._replace(capsules=capsules, ignored=frozenset(near))
    return PathProblem(IKLINK, arm, table[:, 1:4], turned, np.zeros((0, 9)), IKLINK_TOLERANCE)


# The arm


def read_arm(data: Path, name: str) -> Arm:
    """Read an arm in robots.json, with its published capsules."""
    known = json.loads((data / "robots/robots.json").read_text())
    own = known[name]
    of = known[own.get("as", name)]
    kind = own.get("as", name)
    moving = own["joints"]
    arm = read_chain(data / "robots" / of["urdf"], of["base"], of["tip"], CHECKED[kind], moving)
    capsules = {}
    for link in CHECKED[kind]:
        file = of["capsules"].replace("<link without panda_>", link.removeprefix("panda_")).replace("<link>", link)
        capsules[link] = np.array([float(number) for number in (data / "robots" / file).read_text().split(",")])
    return arm._replace(capsules=capsules, ignored=frozenset(frozenset(pair) for pair in of["ignored_pairs"]))


def read_chain(urdf: Path, base: str, tip: str, links: tuple[str, ...], moving: list[str] | None = None) -> Arm:
    """Read the joints of a URDF from the base to the tip and to some links.

    `moving` are the names of the joints that move, None for all that can; the others are fixed at 0.
    """
    into = {found.child: found for each in ElementTree.parse(urdf).getroot().iter("joint") if (found := _joint(each))}
    chain: list[Joint] = []
    for link in (tip, *links):
        segment_status = []
        while link != base:
            segment_status.insert(0, into[link])
            link = into[link].parent
        chain += [joint for joint in segment_status if joint not in chain]
    requested = [joint.name for joint in chain if joint.moves] if moving is None else moving
    on_chain = [joint._replace(moves=joint.name in requested) for joint in chain]
    return Arm(tuple(on_chain), base, tip, {}, frozenset())


def _joint(element: Element) -> Joint | None:
    if element.find("child") is None or element.get("type") is None:
        return None
    origin, axis, limit = (element.find(tag) for tag in ("origin", "axis", "limit"))
    T = np.eye(4)
    if origin is not None:
        T[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
        T[:3, :3] = Rotation.from_euler("xyz", _numbers(origin.get("rpy", "0 0 0"))).as_matrix()
    kind = element.get("type")
    ends = [np.inf, np.inf] if limit is None or kind == "continuous" else []
    lower, upper = (-ends[0], ends[1]) if ends else (float(limit.get("lower", 0)), float(limit.get("upper", 0)))
    return Joint(
        element.get("name"), element.find("child").get("link"), element.find("parent").get("link"), T,
        np.array([1.0, 0, 0]) if axis is None else _numbers(axis.get("xyz")), kind == "prismatic", lower, upper,
        np.inf if limit is None else float(limit.get("velocity", "inf")), kind != "fixed",
    )  # fmt: skip


def _numbers(text: str) -> np.ndarray:
    return np.array([float(number) for number in text.split()])


def poses(arm: Arm, x: Float[np.ndarray, "*n N"]) -> dict[str, Float[np.ndarray, "*n 4 4"]]:
    """Poses of all links in the base's frame, at one configuration or many [rad or m]."""
    x = np.asarray(x, float)
    found, at = {arm.base: np.broadcast_to(np.eye(4), (*x.shape[:-1], 4, 4))}, 0
    for joint in arm.joints:
        T = found[joint.parent] @ joint.T
        if joint.moves:
            own = np.broadcast_to(np.eye(4), T.shape).copy()
            if joint.slides:
                own[..., :3, 3] = x[..., at, None] * joint.axis
            else:
                own[..., :3, :3] = (
                    Rotation.from_rotvec((x[..., at, None] * joint.axis).reshape(-1, 3))
                    .as_matrix()
                    .reshape(*x.shape[:-1], 3, 3)
                )
            T, at = T @ own, at + 1
        found[joint.child] = T
    return found


# The job


def made(problem: PathProblem, folder: Path) -> dict[str, Any]:
    """Write the files of a problem into `folder`, and return its job."""
    (folder / "arm.xml").write_text(arm_xml(problem.name, problem.arm))
    quaternion = Rotation.from_matrix(problem.rotation).as_quat(scalar_first=True)
    table = np.column_stack([problem.position, quaternion])
    np.savetxt(folder / "path.csv", table, delimiter=",", header="x,y,z,qw,qx,qy,qz", comments="", fmt="%.17g")
    job = {
        "robot": {"model": str(folder / "arm.xml")},
        "workpiece": {"cloud": "none", "path": str(folder / "path.csv")},
        "task": [{"point": "tcp", "on": "path"}, {"orientation": "path"}],
        "start_rad": "auto",
        "margin_m": 0.0,
        "settings": {
            "tolerance_m": problem.tolerance[0],
            "tolerance_rad": problem.tolerance[1],
            "path_tolerance_m": SEGMENT_M,
        },
    }
    if problem.name != IKLINK:
        far = np.array([[0, 0, FAR_M - k, 0, 0, 0, 0.1, 0.1, 0.1] for k in range(MOST_BOXES - len(problem.boxes))])
        (folder / "cell.xml").write_text(cell_xml(np.vstack([problem.boxes, far.reshape(-1, 9)])))
        job["cell"] = {"model": str(folder / "cell.xml")}
    return job


def arm_xml(name: str, arm: Arm) -> str:
    """Contents of an MJCF file with exactly the published capsules, and the pairs that may touch."""
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian", autolimits="true", boundmass="1e-6", boundinertia="1e-6")
    custom = SubElement(root, "custom")
    SubElement(custom, "numeric", name="speed", data=" ".join(f"{joint.speed:.17g}" for joint in arm.moving))
    bodies = {arm.base: SubElement(SubElement(root, "worldbody"), "body", name=arm.base)}
    for joint in arm.joints:
        bodies[joint.child] = _body(bodies[joint.parent], joint)
    for link, numbers in arm.capsules.items():
        ends = _text(numbers[:6])
        SubElement(bodies[link], "geom", name=link, type="capsule", fromto=ends, size=_text(numbers[6:]))
    SubElement(bodies[arm.tip], "site", name="tcp")
    contact = SubElement(root, "contact")
    for pair in sorted(sorted(pair) for pair in _may_touch(arm)):
        SubElement(contact, "exclude", body1=pair[0], body2=pair[1])
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _may_touch(arm: Arm) -> set[frozenset[str]]:
    """Pairs of links with capsules that are not checked against each other."""
    near = {frozenset((link, arm.parents[link])) for link in arm.capsules if link in arm.parents}
    return {pair for pair in arm.ignored | near if pair <= arm.capsules.keys()}


def _body(parent: Element, joint: Joint) -> Element:
    quaternion = Rotation.from_matrix(joint.T[:3, :3]).as_quat(scalar_first=True)
    body = SubElement(parent, "body", name=joint.child, pos=_text(joint.T[:3, 3]), quat=_text(quaternion))
    if joint.moves:
        limits = {"range": _text([joint.lower, joint.upper])} if np.isfinite(joint.lower) else {}
        kind = "slide" if joint.slides else "hinge"
        SubElement(body, "joint", name=joint.name, type=kind, axis=_text(joint.axis), **limits)
    return body


def cell_xml(boxes: Float[np.ndarray, "B 9"]) -> str:
    """Contents of an MJCF file with some boxes."""
    root = Element("mujoco", model="boxes")
    world = SubElement(root, "worldbody")
    for k, box in enumerate(boxes):
        quaternion = Rotation.from_euler("xyz", box[3:6]).as_quat(scalar_first=True)
        where = {"pos": _text(box[:3]), "quat": _text(quaternion), "size": _text(box[6:] / 2)}
        SubElement(world, "geom", name=f"box {k + 1}", type="box", **where)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _text(numbers: Any) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)
