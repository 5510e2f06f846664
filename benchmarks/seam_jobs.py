"""Public problems with many seams as jobs.

    python -m benchmarks.seam_jobs kingpin DATA FOLDER      14 welds on a frame, by a KUKA KR 5 arc
    python -m benchmarks.seam_jobs coverage DATA FOLDER     poses on a surface, in any order
    python -m benchmarks.seam_jobs assembly DATA FOLDER     bars of a lattice, printed one after another

A job and its files are written into FOLDER, which must not exist. DATA is a folder with the published files:

kingpin: `kingpin2.csv` of JeroenDM/ocpl (ocpl_ros/data), the packages setup_1_support and setup_1_moveit_config of
JeroenDM/benchmark_planning_setups, and the package kuka_kr5_support of ros-industrial/kuka_experimental. A row of
kingpin2.csv has position, z axis and x axis of the tool, and bounds of the deviation: the tool may lean by 15 degrees,
and rotate about its axis. Blank lines divide the seams.
A link `torch` is part of the arm. Bodies of the frame become the job's cell.
coverage: the files of uwgraphics/arm_coverage.
assembly: the files of yijiangh/assembly_instances.
"""

import argparse
import json
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import yaml
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from benchmarks import path_problems
from htcp_jax.cli.main import main as htcp

KINGPIN_URDFS = "setup_1.urdf", "work/kingpin.urdf"
HOME_RAD = [0.0, -1.5708, 1.5708, 0.0, 0.0, 0.0]  # `home` of setup_1.srdf


def kingpin(data: Path, folder: Path) -> dict:
    """Write the job of 14 welds and its files, and return the job."""
    folder.mkdir(parents=True)
    arm, frame = (ElementTree.parse(data / f"setup_1_support/urdf/{each}").getroot() for each in KINGPIN_URDFS)
    names = {link.get("name") for link in frame.iter("link")} - {"world"}
    for element in list(arm):
        child = element.find("child")
        is_frame = element.get("name") in names or (child is not None and child.get("link") in names)
        if is_frame or (element.tag == "link" and element.get("name") == "world"):
            arm.remove(element)
    arm.insert(0, Element("link", name="world"))  # it is there twice
    for mesh in arm.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").replace("package://", f"{data.resolve()}/"))
    urdf = folder / "arm.urdf"
    urdf.write_text(ElementTree.tostring(arm, encoding="unicode"), encoding="utf-8")
    srdf = data / "setup_1_moveit_config/config/setup_1.srdf"
    words = ["robot", str(urdf), "--tcp", "tool_tip", "--srdf", str(srdf), "--fit-tolerance", "3mm"]
    if htcp([*words, "--out", str(folder / "kr5.xml")]):
        raise SystemExit("the arm was not imported")
    _write_cell(folder / "cell.xml", _boxes(frame))
    seams = []
    blocks = (data / "kingpin2.csv").read_text(encoding="utf-8").strip().split("\n\n")
    for number, block in enumerate(blocks, 1):
        rows = np.array([[float(value) for value in line.split(",")] for line in block.splitlines()])
        name = f"seam_{number}"
        _write_path(folder / f"{name}.csv", "x,y,z,nx,ny,nz", np.hstack([rows[:, :3], -rows[:, 3:6]]))
        seams.append({"name": name, "path": f"{name}.csv", "direction": "either"})
    return _written(folder, {
        "robot": {"model": "kr5.xml"},
        "workpiece": {"cloud": "none"},
        "cell": {"model": "cell.xml"},
        "task": [
            {"point": "tcp", "on": "path"},
            {"axis": "tcp.z", "towards": "-path.normal", "cone_deg": 15},
        ],
        "home_rad": HOME_RAD,
        "start_rad": "auto",
        "seams": seams,
    })  # fmt: skip


def _boxes(model: Element) -> Iterable[tuple[str, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
    """Name, centre and full sizes of each box of a model whose joints are fixed to the world and do not rotate [m]."""
    at = {}
    for joint in model.iter("joint"):
        origin = joint.find("origin")
        assert origin is not None and not np.any(_numbers(origin.get("rpy")))
        at[joint.find("child").get("link")] = _numbers(origin.get("xyz"))  # type: ignore[union-attr]
    for link in model.iter("link"):
        for collision in link.iter("collision"):
            box = collision.find("geometry/box")
            shift = _numbers(collision.find("origin").get("xyz"))  # type: ignore[union-attr]
            yield str(link.get("name")), at[link.get("name")] + shift, _numbers(box.get("size"))  # type: ignore[union-attr]


def _numbers(text: str | None) -> Float[np.ndarray, "3"]:
    return np.array([float(each) for each in (text or "0 0 0").split()])


def _write_cell(file: Path, boxes: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> None:
    cell = Element("mujoco")
    world = SubElement(cell, "worldbody")
    for name, centre, size in boxes:
        pos, half = (" ".join(f"{value:.9g}" for value in each) for each in (centre, size / 2))
        SubElement(world, "geom", name=name, type="box", pos=pos, size=half)
    ElementTree.indent(cell)
    file.write_text(ElementTree.tostring(cell, encoding="unicode") + "\n", encoding="utf-8")


def _write_path(file: Path, header: str, rows: Float[np.ndarray, "T c"]) -> None:
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows + 0.0]
    file.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def _written(folder: Path, job: dict) -> dict:
    """Write a job, and return it."""
    (folder / "job.yaml").write_text(yaml.safe_dump(job, sort_keys=False, default_flow_style=None), encoding="utf-8")
    return job


COVERAGE = {  # arm -> its file of poses, base, tip
    "panda": ("panda_20240825_154124_floor.csv", "world", "panda_hand"),
    "ur5": ("ur5_20240819_164816_wok.csv", "base_link", "tool_tip"),
}


def coverage(data: Path, folder: Path, arm: str = "ur5", spin_is_free: bool = False) -> dict:
    """Write the job of the poses of one surface, each a seam of one target, and return the job.

    Links are capsules of the published radius about the lines between the joints. With `spin_is_free` the tool may
    rotate about its axis.
    """
    poses, base, tip = COVERAGE[arm]
    given = yaml.safe_load((data / f"settings_{arm}.yaml").read_text(encoding="utf-8").partition("obstacles")[0])
    chain = path_problems.read_chain(data / f"{arm}.urdf", base, tip, ())
    ends = {joint.parent: joint.T[:3, 3] for joint in chain.joints if np.linalg.norm(joint.T[:3, 3]) > 0.03}
    capsules = {link: np.array([0, 0, 0, *end, given["link_radius"]]) for link, end in ends.items()}
    capsules.pop(base, None)  # in the pedestal
    order = list(capsules)
    near = [frozenset(order[k : k + gap + 1 : gap]) for gap in (1, 2) for k in range(len(order) - gap)]
    limits = np.array([[joint.lower, joint.upper] for joint in chain.moving]).T
    home = np.clip(given["starting_config"], *limits)  # the published one of the UR5 is outside the limits
    folder.mkdir(parents=True)
    xml = path_problems.arm_xml(arm, chain._replace(capsules=capsules, ignored=frozenset(near)))
    (folder / "arm.xml").write_text(xml, encoding="utf-8")
    table = np.genfromtxt(data / poses, delimiter=",", skip_header=1)
    _write_path(folder / "poses.csv", "x,y,z,qw,qx,qy,qz,nx,ny,nz", np.column_stack([
        table[:, 1:4], table[:, [7, 4, 5, 6]], -Rotation.from_quat(table[:, 4:8]).as_matrix()[:, :, 2],
    ]))  # fmt: skip
    held = {"axis": "tcp.z", "towards": "-path.normal"} if spin_is_free else {"orientation": "path"}
    return _written(folder, {
        "robot": {"model": "arm.xml"},
        "workpiece": {"cloud": "none"},
        "task": [{"point": "tcp", "on": "path"}, held],
        "margin_m": 0.0,
        "home_rad": home.tolist(),
        "start_rad": "auto",
        "seams": [{"name": "pose", "path": "poses.csv", "points": True}],
    })  # fmt: skip


BAR_RADIUS_M = 0.0015  # material_properties: "round_shape, radius 0.15 cm"
STEP_M = 0.005  # distance of targets on a bar
GAP_M = 0.006  # bars end before their nodes, where the nozzle is while it prints another bar
FAR_M = -20.0  # height of bars that pad a cell
NOZZLE = {  # TCP of conrob_pybullet in the frame tool0; the bodies are our own
    "tip_m": [0.136569, 0.008654, 0.109056],
    "tip_rpy_rad": [0.0, 1.570796326794897, 0.0],
    "bodies": [
        {"name": "mount", "p_m": [0, 0.008654, 0.03], "q_m": [0, 0.008654, 0.109056], "radius_m": 0.025},
        {"name": "hot_end", "p_m": [0, 0.008654, 0.109056], "q_m": [0.105, 0.008654, 0.109056], "radius_m": 0.012},
        {"name": "nozzle", "p_m": [0.105, 0.008654, 0.109056], "q_m": [0.1325, 0.008654, 0.109056], "radius_m": 0.002},
    ],
}  # fmt: skip


def assembly(data: Path, folder: Path, model: str, arm: str, number: int = 0) -> dict:
    """Write the job of all bars of a lattice, and one job per bar with the bars before it as obstacles.

    A bar is before another one if its layer is lower; within a layer, the order of the jobs per bar is that of the
    bars' heights. The cells of all jobs per bar have the same number of bodies: bars that are not printed yet are far
    below.

    Args:
        data: Folder with the published files.
        folder: Folder to write.
        model: Name of a file without its ending.
        arm: File of the arm, with a frame tool0, as `htcp robot` writes it: a KUKA KR 6 R900 in the papers.
        number: Number of bars of a cell, if it is more than the model has: models with the same number share programs.
    """
    given = json.loads((data / f"{model}.json").read_text(encoding="utf-8"))
    assert given["unit"] == "millimeter"
    frame = given["base_frame_in_rob_base"]
    origin, x, y, z = (_vector(frame[key]) for key in ("Origin", "XAxis", "YAxis", "ZAxis"))
    nodes = np.array([_vector(node["point"]) for node in given["node_list"]])
    nodes = 1e-3 * (origin + nodes @ np.array([x, y, z]))
    bars = sorted(given["element_list"], key=lambda bar: (bar["layer_id"], nodes[bar["end_node_ids"], 2].mean()))
    folder.mkdir(parents=True)
    plate = nodes[:, 2].min() - 0.005
    seams: list[dict] = []
    layers: dict[int, list[str]] = {}
    for bar in bars:
        name = f"bar_{bar['element_id']}"
        ends = nodes[bar["end_node_ids"]]
        count = max(2, 1 + round(float(np.linalg.norm(ends[1] - ends[0])) / STEP_M))
        _write_path(folder / f"{name}.csv", "x,y,z", np.linspace(*ends, count))
        lower = [layer for layer in layers if layer < bar["layer_id"]]
        after = layers[max(lower)] if lower else []
        seams.append(
            {"name": name, "path": f"{name}.csv", "direction": "either", **({"after": after} if after else {})}
        )
        layers.setdefault(bar["layer_id"], []).append(name)
    job = {
        "robot": {"model": arm, "tcp": "tool0", "tool": NOZZLE},
        "workpiece": {"cloud": "none"},
        "task": [
            {"point": "tcp", "on": "path"},
            {"axis": "tcp.z", "towards": [0, 0, -1], "cone_deg": 90},
        ],
        "start_rad": "auto",
    }
    for printed, bar in enumerate(bars):
        name = f"bar_{bar['element_id']}"
        _write_bars(folder / f"cell_{name}.xml", nodes, bars, printed, number, float(plate))
        single = {**job, "cell": {"model": f"cell_{name}.xml"}}
        single["workpiece"] = {"cloud": "none", "path": f"{name}.csv"}
        text = yaml.safe_dump(single, sort_keys=False, default_flow_style=None)
        (folder / f"job_{name}.yaml").write_text(text, encoding="utf-8")
    _write_bars(folder / "cell.xml", nodes, bars, 0, number, float(plate))
    return _written(folder, {**job, "cell": {"model": "cell.xml"}, "seams": seams})


def _vector(point: dict) -> Float[np.ndarray, "3"]:
    return np.array([point[key] for key in "XYZ"], float)


def _write_bars(file: Path, nodes: np.ndarray, bars: list[dict], printed: int, number: int, plate: float) -> None:
    """Write a cell with the plate below a lattice and its first bars; the others are far below."""
    cell = Element("mujoco")
    world = SubElement(cell, "worldbody")
    centre = nodes[:, :2].mean(axis=0)
    half = 0.5 * np.ptp(nodes[:, :2], axis=0).max() + 0.05
    pos, size = f"{centre[0]:.6g} {centre[1]:.6g} {plate - 0.01:.6g}", f"{half:.6g} {half:.6g} 0.01"
    SubElement(world, "geom", name="plate", type="box", pos=pos, size=size)
    for at in range(max(number, len(bars))):
        bar = bars[min(at, len(bars) - 1)]
        ends = nodes[bar["end_node_ids"]]
        length = float(np.linalg.norm(ends[1] - ends[0]))
        short = GAP_M * (ends[1] - ends[0]) / length if length > 3 * GAP_M else np.zeros(3)
        ends = np.array([ends[0] + short, ends[1] - short])
        if at >= printed:
            ends[:, 2] += FAR_M
        line = " ".join(f"{value:.9g}" for value in ends.ravel())
        name = f"bar_{bar['element_id']}" if at < len(bars) else f"none_{at}"
        SubElement(world, "geom", name=name, type="cylinder", fromto=line, size=f"{BAR_RADIUS_M}")
    ElementTree.indent(cell)
    file.write_text(ElementTree.tostring(cell, encoding="unicode") + "\n", encoding="utf-8")


def main() -> None:
    """Write the jobs that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("problem", choices=("kingpin", "coverage", "assembly"))
    parser.add_argument("data", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robot", default="ur5", help="coverage: panda or ur5; assembly: file of the arm")
    parser.add_argument("--model", default="simple_frame", help="of assembly")
    parser.add_argument("--bars", type=int, default=0, help="assembly: number of bars of each cell, at least")
    parser.add_argument("--free-spin", action="store_true", help="coverage: the tool may rotate about its axis")
    given = parser.parse_args()
    if given.problem == "kingpin":
        job = kingpin(given.data, given.folder)
    elif given.problem == "coverage":
        job = coverage(given.data, given.folder, given.robot, given.free_spin)
    else:
        job = assembly(given.data, given.folder, given.model, str(Path(given.robot).resolve()), given.bars)
    print(f"{given.folder / 'job.yaml'}: {len(job['seams'])} entries of seams")


if __name__ == "__main__":
    main()
