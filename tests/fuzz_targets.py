"""Fuzz targets: every reader of files, the configurations, and the QP solver.

A target is a strategy for inputs and a check of one input. The check writes the input into a folder, reads it, and
returns whether it was accepted; a refusal must be an InputError of one line. Accepted input is compared with an
independent reading of the same bytes, so that no wrong result passes unnoticed.
"""

import copy
import hashlib
import io
import json
import math
import re
import shutil
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pyarrow as pa
import trimesh
import yaml
from collada_box import DAE
from hypothesis import strategies as st
from made_once import load_cloud
from sweep_process import make_sweep

from htcp_jax.errors import InputError
from htcp_jax.io.parts import load_geometry
from htcp_jax.io.parts.columns import PER_METRE
from htcp_jax.io.parts.workpiece_source import read_path
from htcp_jax.io.robots import read_joint_limits
from htcp_jax.io.robots.collada_mesh import read_triangles
from htcp_jax.io.robots.joint_limits import RATES
from htcp_jax.io.robots.loading import gp50
from htcp_jax.io.robots.model_file import RobotFields, read_robot_file
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scenario_of
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import Workpiece
from htcp_jax.model.mesh_points import cover_mesh
from htcp_jax.runs import open_run
from htcp_jax.runs.sweep import sweep
from htcp_jax.solvers import ClarabelSolver
from htcp_jax.solvers.step_qp import QPStatus, StepQP
from htcp_jax.spec.config import PlanConfig
from htcp_jax.validation.records import read_results

HERE = Path(__file__).parent
CONFIGS, SWEEPS = HERE.parent / "configs", HERE.parent / "sweeps"


class Target(NamedTuple):
    """Share of all inputs, strategy, check(folder, input) -> accepted, and prepare(folder), which runs once."""

    share: int
    inputs: st.SearchStrategy
    check: Callable[[Path, object], bool]
    prepare: Callable[[Path], object] = lambda folder: None


def refusal(act: Callable):
    """Result of `act`, or None if it refuses its input by one line. Warnings other than ours are errors."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", UserWarning)
            return act()
    except InputError as error:
        assert str(error).strip() and "\n" not in str(error), f"not one line: {error}"
        assert len(str(error)) < 2000, f"not short: {error}"
        return None


# Inputs: good files with random changes

SPOT = st.integers(0, 2**16 - 1)  # a position in a file, in 65,536ths of its length
NUMBERS = ["0", "-1", "1e999", "nan", "inf", "-0.0", "1e-300", "99999999999999999999", "1_0", "0x10", ".5", "1e3", ""]


def damaged(seeds: list[bytes], words: list[str]) -> st.SearchStrategy[bytes]:
    """One of the seeds with up to five changes: truncated, a part removed, doubled or replaced, a byte changed."""
    token = st.one_of(st.sampled_from([word.encode() for word in [*words, *NUMBERS]]), st.binary(max_size=8))
    change = st.tuples(st.integers(0, 5), SPOT, SPOT, token)
    return st.builds(_changed, st.sampled_from(seeds), st.lists(change, max_size=5))


def _changed(data: bytes, changes: list[tuple]) -> bytes:
    for kind, a, b, token in changes:
        i, span = a * (len(data) + 1) >> 16, b * 64 >> 16
        if kind == 0 and b < 2**13:
            data = data[:i]
        elif kind == 1:
            data = data[:i] + data[i + span :]
        elif kind == 2:
            data = data[: i + span] + data[i:]
        elif kind == 3:
            data = data[:i] + token + data[i + len(token) :]
        elif kind == 4:
            data = data[:i] + token + data[i:]
        elif i < len(data):
            data = data[:i] + bytes([b & 255]) + data[i + 1 :]
    return data


ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.integers(-3, 3), st.floats(), st.text(max_size=5),
    st.sampled_from([1e308, -1e308, 5e-324, "", [], {}, [1, 2, 3], [0.0] * 6, "duct", "weld", "none", "../x"]),
)  # fmt: skip


def altered(seeds: list) -> st.SearchStrategy:
    """One of the seeds, plain data, with up to four of its values replaced, doubled or removed."""
    change = st.tuples(SPOT, st.integers(0, 3), ODD)
    return st.builds(_altered, st.sampled_from([json.dumps(seed) for seed in seeds]), st.lists(change, max_size=4))


def _altered(text: str, changes: list[tuple]):
    data = json.loads(text)
    for spot, kind, value in changes:
        places = list(_places(data))
        if not places:
            break
        owner, key = places[spot * len(places) >> 16]
        if kind == 0 and isinstance(owner, dict):
            del owner[key]
        elif kind == 1 and isinstance(owner, list):
            owner.insert(key, copy.deepcopy(owner[key]))
        elif kind == 2 and isinstance(owner[key], int | float) and isinstance(value, int | float):
            owner[key] += value if abs(value) < 10 else 1
        else:
            owner[key] = copy.deepcopy(value)
    return data


def _places(data):
    for key in list(data) if isinstance(data, dict) else range(len(data)):
        yield data, key
        if isinstance(data[key], dict | list):
            yield from _places(data[key])


def written(folder: Path, name: str, data: bytes) -> Path:
    file = folder / name
    file.write_bytes(data)
    return file


# Configurations and sweeps

KEYS = ["robot:", "workpiece:", "start_rad:", "settings:", "margin_m:", "seed:", "config:", "grid:", "groups:"]
YAML_WORDS = [*KEYS, "{", "}", "[", "]", "- ", "&a ", "*a", "!!python/name:os.system ", "? ", "|\n", "<<:", "\n", "\t",
              "offsets: ", "values: ", "start_rad.3: ", "margin_m: ", "'", '"', "%", "---\n", "\x00"]  # fmt: skip


@cache
def box() -> Workpiece:
    corners = np.stack(np.meshgrid([0, 1.3], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    return Workpiece("box", corners, np.array([[0.19, -0.17, 0.17]]))


def check_yaml(folder: Path, data: bytes) -> bool:
    config = refusal(lambda: load_config(written(folder, "job.yaml", data)))
    if config is not None:
        text = yaml.safe_dump(config.model_dump(mode="json"))
        assert load_config(written(folder, "again.yaml", text.encode())) == config, "does not read back the same"
    return config is not None


def check_limits(folder: Path, data: bytes) -> bool:
    """Check a file with joint limits: ranges ascend and other limits are positive, or it is refused."""
    file, names = written(folder, "joint_limits.yaml", data), ("a1", "a2", "a3")
    stated = refusal(lambda: read_joint_limits(file, names, "arm"))
    found = stated and refusal(lambda: stated.ranges((False, False, True), np.full(3, -3.0), np.full(3, 3.0)))
    if found is None:
        return False
    assert (found[0] < found[1]).all()
    for kind in RATES:
        rates = stated.rates(kind)
        assert (np.isnan(rates) | ((rates > 0) & np.isfinite(rates))).all()
    assert "\n" not in (stated.note(found, rates) or "")
    return True


def check_config(folder: Path, raw: dict) -> bool:
    """Check a configuration with values of every kind: if accepted, it makes a scenario or is refused there."""
    if not isinstance(raw, dict):
        return False
    text = json.dumps(raw)
    config: PlanConfig | None = refusal(lambda: load_config(written(folder, "job.yaml", text.encode())))
    if config is None:
        return False
    assert _leaves(config.model_dump()) >= _leaves(raw), "a value was changed or dropped in silence"
    made = refusal(lambda: scenario_of(config, gp50(), box()))
    if made is not None:
        assert np.isfinite(made.targets).all() and np.isfinite(made.interior_plane[:3]).all()
    return made is not None


def _leaves(data, prefix="") -> set:
    """Finite numbers in a configuration, as (key, value); null, empty and text values are excluded."""
    if isinstance(data, dict):
        return set().union(*(_leaves(value, f"{prefix}.{key}") for key, value in data.items()))
    if isinstance(data, list | tuple):
        return set().union(*(_leaves(value, f"{prefix}.{key}") for key, value in enumerate(data)))
    # JSON writes infinity as a word, which in YAML is a text like any other: the name of a file, say.
    return set() if data is None or isinstance(data, str) or not np.isfinite(float(data)) else {(prefix, float(data))}


def check_sweep(folder: Path, data: bytes) -> bool:
    grid = refusal(lambda: load_sweep(written(folder, "grid.yaml", data)))
    if grid is None:
        return False
    points = refusal(lambda: grid.points(3))
    assert points is None or len(points) == min(3, len(grid))
    return points is not None


# Clouds and paths

ROWS = np.random.default_rng(0).uniform(-1, 1, (12, 3))
BOX = trimesh.creation.box(extents=(1.0, 2.0, 3.0))


def table(separator: str, rows: np.ndarray = ROWS) -> bytes:
    return "\n".join(separator.join(f"{value:.6g}" for value in row) for row in rows).encode()


def npy(array: np.ndarray, **options) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


WIDE = np.hstack([ROWS, ROWS / np.linalg.norm(ROWS, axis=1, keepdims=True)])
TABLES = [table(" "), table(","), table("; "), b"x,y,z\n" + table(","), b"\xef\xbb\xbf# by hand\n" + table("\t"),
          table(" ", WIDE), b"//X Y Z R G B\n" + table(" ", WIDE), b"nx;ny;nz;x [m];y;z\n" + table(";", WIDE),
          b"x,y,z\n" + table(",", WIDE), table(";").replace(b".", b",")]  # fmt: skip
ARRAYS = [npy(ROWS), npy(ROWS.astype("f4")), npy(np.asfortranarray(ROWS)), npy((ROWS * 9).astype(">i2")), npy(WIDE)]
POINTS = trimesh.PointCloud(ROWS)
MESHES = {
    ".stl": [BOX.export(file_type="stl"), BOX.export(file_type="stl_ascii").encode()],
    ".obj": [BOX.export(file_type="obj").encode(), b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1/1 2//2 3\nf 1 2 3 4\n"],
    ".ply": [
        BOX.export(file_type="ply"), BOX.export(file_type="ply", encoding="ascii"),
        POINTS.export(file_type="ply"), POINTS.export(file_type="ply", encoding="ascii"),
    ],
}  # fmt: skip
MESH_WORDS = ["element vertex 9", "element face", "property list uchar int vertex_indices", "property float x", "ply",
              "format ascii 1.0", "end_header\n", "solid", "facet", "vertex", "endsolid", "v ", "f ", "f -1 -2 -3",
              "vn ", "mtllib ../../secret.mtl\n", "usemtl x\n", "o a\n", "g b\n", "\\\n", "/", "//"]  # fmt: skip


def check_table(folder: Path, case: tuple[str, bytes]) -> bool:
    ending, data = case
    file = written(folder, f"cloud{ending}", data)
    points = refusal(lambda: load_cloud(file))
    path = refusal(lambda: read_path(file))
    if points is None:
        return path is not None
    text = data.decode("utf-8-sig")
    if path is None:
        assert re.search(r"(\r\n|\r|\n)[\s,;]*(\r\n|\r|\n)", text), "the same table is a cloud, and no path"
        return True
    assert np.array_equal(points, path), "the same table is one cloud and another path"
    lines = [line.partition("#")[0].strip() for line in re.split(r"\r\n|\r|\n", text)]
    lines = [line for line in lines if line.strip(",; \t") and not line.startswith(("//", "%"))]
    lines = [re.split(r"[;,\s]\s*", line) for line in lines]
    assert len(lines) - len(points) in (0, 1), "lines were dropped"
    named = set("xyz") <= set(re.split(r"[^a-z]+", text.lower()))  # then x, y and z may stand in any column
    for row, cells in zip(points[::-1].tolist(), lines[::-1], strict=False):
        said = [number for number in map(_number, cells) if number is not None]
        scaled = [set(row) <= {number / per for number in said} for per in PER_METRE.values()]  # by the header's unit
        assert row == said[:3] or (named and any(scaled)), "a line was read as another"
    return True


def _number(cell: str) -> float | None:
    try:
        return float(cell.strip("\"'"))
    except ValueError:
        return None


def check_npy(folder: Path, data: bytes) -> bool:
    points = refusal(lambda: load_cloud(written(folder, "cloud.npy", data)))
    if points is not None:
        assert np.array_equal(np.load(io.BytesIO(data), allow_pickle=False)[:, :3], points)
    return points is not None


def check_mesh(folder: Path, case: tuple[str, bytes]) -> bool:
    ending, data = case
    found = refusal(lambda: load_geometry(written(folder, f"mesh{ending}", data)))
    if found is None:
        return False
    points, triangles = found
    if len(triangles):
        refusal(lambda: cover_mesh(triangles, "mesh", spacing=max(float(np.ptp(points, axis=0).max()) / 10, 1e-3)))
    assert np.isfinite(points).all()
    said = re.findall(rb"^element vertex (\d+)\r?$", data, re.MULTILINE)
    if ending == ".ply" and len(said) == 1 and data.count(b"element") == 1:
        assert len(points) == int(said[0]), "not as many points as the file says"
    return True


COLLADA_WORDS = ["nan", "-1", "1e999", "9" * 12, "#box", "#s", '<instance_geometry url="#box"/>', "<!DOCTYPE a>", "&a;",
                 '<instance_node url="#n"/>', "<matrix>1 2</matrix>", "</node>", "<p>", "triangles"]  # fmt: skip


def check_collada(folder: Path, data: bytes) -> bool:
    """Check that an accepted mesh has as many triangles as trimesh finds, where trimesh reads the file."""
    found = refusal(lambda: read_triangles(written(folder, "mesh.dae", data)))
    if found is None:
        return False
    assert np.isfinite(found).all()
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type="dae", process=False)
    except Exception:  # of a material, for example
        return True
    nodes = [scene.graph[name][1] for name in scene.graph.nodes_geometry]
    assert len(found) == sum(len(scene.geometry[name].faces) for name in nodes), "triangles were dropped"
    return True


# Robots

ARM = (HERE.parent / "htcp_jax" / "model" / "robots" / "gp50.xml").read_bytes()
SMALL = b"""<mujoco model="arm"><compiler angle="radian"/><default><geom rgba="1 0 0 1"/><default class="c">
<joint axis="0 1 0" range="-2 2"/></default></default><asset><mesh name="m" file="../m.stl"/></asset><worldbody>
<body name="a" pos="0 0 .3"><joint name="j1"/><geom type="capsule" size=".05" fromto="0 0 0 0 0 .3"/>
<body name="b" pos="0 0 .3" euler=".1 0 0"><joint name="j2" class="c"/><geom type="capsule" size=".04 .1"/>
<geom type="mesh" mesh="m"/><body name="c" pos=".1 0 .3" quat="1 .1 0 0"><joint name="j3" type="slide" range="0 .5"/>
<geom type="sphere" size=".04"/><site name="tcp" pos="0 0 .1"/></body></body></body></worldbody></mujoco>"""
URDF = b"""<robot name="arm"><link name="base"/><link name="a"><collision><geometry><sphere radius=".1"/></geometry>
</collision></link><link name="b"><collision><origin xyz="0 0 .1"/><geometry><sphere radius=".05"/></geometry>
</collision><visual><geometry><mesh filename="package://x/y.stl"/></geometry></visual></link><link name="tool"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
<joint name="j2" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0 0 .3" rpy="0 .2 0"/></joint>
<joint name="j3" type="prismatic"><parent link="b"/><child link="tool"/><limit lower="0" upper=".4"/></joint></robot>"""
XML_WORDS = ["<body>", "</body>", '<geom size="0.1"/>', '<joint type="ball"/>', '<include file="../x.xml"/>',
             "<!DOCTYPE a>", '<include file="job.xml"/>', "&a;", "<![CDATA[", "<!--", "-->", 'range="1 -1"', 'size="0"',
             'type="box"', '<site name="tcp"/>', 'name="j1"', "<freejoint/>", "<frame>", "</frame>", 'axis="0 0 0"',
             '<replicate count="99999999">', 'class="c"', 'pos="nan 0 0"', 'quat="0 0 0 0"', "<default>", "/>", ">",
             "<"]  # fmt: skip


def check_robot(folder: Path, case: tuple[str, bytes]) -> bool:
    """Check that an accepted arm has MuJoCo's own kinematics, where MuJoCo reads the unmodified file."""
    ending, data = case
    fields = refusal(lambda: read_robot_file(written(folder, f"arm{ending}", data), "tcp", "model", np.eye(4), None))
    if fields is None:
        return False
    fields.pieces()
    arrays = fields.arrays
    assert (arrays["lower"] < arrays["upper"]).all() and (arrays["capsule_radius"] > 0).all()
    try:
        model = mujoco.MjModel.from_xml_string(data.decode())
    except (ValueError, mujoco.FatalError):
        return True  # a missing mesh, for example
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "tcp")
    if site >= 0:
        state = mujoco.MjData(model)
        state.qpos[:] = np.linspace(-0.4, 0.7, model.nq)
        mujoco.mj_kinematics(model, state)
        np.testing.assert_allclose(tcp_of(fields, state.qpos), state.site_xpos[site], atol=1e-9 * _size(arrays))
    return True


def _size(arrays: dict) -> float:
    return max(1.0, float(np.abs(arrays["T_parent_joint"]).max()), float(np.abs(arrays["T_link_tcp"]).max()))


def tcp_of(fields: RobotFields, q: np.ndarray) -> np.ndarray:
    """TCP position in plain numpy, by Rodrigues' formula."""
    T = np.eye(4)
    arrays = zip(fields.arrays["T_parent_joint"], fields.arrays["axis"], fields.facts["slides"], q, strict=True)
    for T_parent_joint, axis, slides, value in arrays:
        motion, K = np.eye(4), np.cross(np.eye(3), axis)
        if slides:
            motion[:3, 3] = value * axis
        else:
            motion[:3, :3] += math.sin(value) * K + (1 - math.cos(value)) * K @ K
        T = T @ T_parent_joint @ motion
    return (T @ fields.arrays["T_link_tcp"])[:3, 3]


# Results


@cache
def finished(folder: Path) -> tuple[dict, dict[str, bytes], dict]:
    """Manifest, row files and both tables of a finished run, made once."""
    make_sweep(folder)
    shutil.rmtree(folder / "run", ignore_errors=True)
    run = sweep(folder / "grid.yaml", "baseline", folder / "run", shard_scenarios=4)
    manifest = json.loads((run.folder / "manifest.json").read_text())
    files = {str(file.relative_to(run.folder)): file.read_bytes() for file in run.folder.glob("*/*.parquet")}
    return manifest, files, {name: as_set(getattr(run, name)()) for name in ("targets", "scenarios")}


def as_set(table: pa.Table) -> set[tuple]:
    """Rows of a table as a set."""
    return set(zip(*(column.to_pylist() for column in table.columns), strict=True))


def lay_out(folder: Path) -> tuple[Path, dict]:
    """Restore the run folder of `finished`; return it and its tables."""
    manifest, files, tables = finished(folder)
    run = folder / "run"
    (run / "manifest.json").write_text(json.dumps(manifest))
    for name, data in files.items():
        (run / name).write_bytes(data)
    return run, tables


def check_manifest(folder: Path, change: tuple) -> bool:
    """Check a changed manifest: the rows read are the rows written, or the run is refused."""
    folder_run, tables = lay_out(folder)
    kind, value = change
    text = json.dumps(finished(folder)[0])
    data = _changed(text.encode(), value) if kind == "bytes" else json.dumps(_altered(text, value)).encode()
    written(folder_run, "manifest.json", data)
    return _reads_what_was_written(folder_run, tables)


def check_parquet(folder: Path, change: tuple) -> bool:
    """Check a damaged or foreign row file: refused, or read unchanged. With `forged` the manifest agrees with it."""
    folder_run, tables = lay_out(folder)
    which, changes, forged = change
    name = sorted(finished(folder)[1])[which]
    data = _changed(finished(folder)[1][name], changes)
    written(folder_run, name, data)
    if forged:
        vouch(folder_run, name, data)
        return refusal(lambda: open_run(folder_run).plans("baseline")) is not None
    return _reads_what_was_written(folder_run, tables)


def vouch(run: Path, name: str, data: bytes) -> None:
    """Write the size and the hash of a file into the manifest."""
    manifest = json.loads((run / "manifest.json").read_text())
    table, _, file = name.partition("/")
    for shard in manifest["shards"]:
        if f"{shard['first']:06d}" in file:
            shard[table] |= {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    (run / "manifest.json").write_text(json.dumps(manifest))


def _reads_what_was_written(folder: Path, tables: dict) -> bool:
    def read():
        run = open_run(folder)
        found = {name: as_set(getattr(run, name)()) for name in tables}
        run.plans("baseline"), run.config
        return found

    found = refusal(read)
    if found is not None:
        for name, rows in tables.items():
            assert found[name] <= rows, f"{name}: rows that were never written"
    return found is not None


def check_plan(folder: Path, change: tuple) -> bool:
    """Check changed summary.json and trajectory.npz of htcp plan, read back by htcp validate."""
    plan = folder / "plan"
    plan.mkdir(exist_ok=True)
    (plan / "trajectory.npz").write_bytes(_changed(trajectory(), change[1]))
    written(plan, "summary.json", json.dumps(_altered(json.dumps(SUMMARY), change[0])).encode())
    found = refusal(lambda: list(read_results(plan).tracks))
    return found is not None


SUMMARY = {"method": "baseline", "config": PlanConfig().model_dump(mode="json"), "files": {}}


@cache
def trajectory() -> bytes:
    stream, shapes = io.BytesIO(), {"x": (3, 6), "tcp": (3, 3), "target": (3, 3)}
    kinds = {"status": np.int8, "path_clear": np.int8}
    names = ("status", "path_clear", "x", "tcp", "target", "clearance")
    np.savez_compressed(stream, **{name: np.zeros(shapes.get(name, 3), kinds.get(name, float)) for name in names})
    return stream.getvalue()


# QPs

QP_NUMBER = st.one_of(
    st.floats(-2, 2), st.sampled_from([0.0, 1e-12, 1e6, 1e12, 1e300, math.nan, math.inf, -math.inf])
)  # fmt: skip


def check_qp(_folder: Path, case: tuple) -> bool:
    """Check that a solution is feasible and no worse than a random feasible point near it; never NaN or infinite."""
    seed, odd = case
    draw = np.random.default_rng(seed)
    qp = {
        "P": solver()[1], "q": draw.normal(size=6), "A": draw.normal(size=(3, 6)),
        "b": draw.normal(size=3) * draw.choice([1e-3, 0.1, 1.0]), "G": draw.normal(size=(8, 6)),
        "h": draw.uniform(-0.05, 0.5, 8), "lb": -draw.uniform(0, 1, 6), "ub": draw.uniform(0, 1, 6),
    }  # fmt: skip
    for name, spot, value in odd:
        qp[name].flat[spot % qp[name].size] = value
    batch = StepQP(**{name: value[None] for name, value in qp.items()})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (y,), (status,) = solver()[0].solve(batch)
    if status != QPStatus.SOLVED:
        assert not y.any(), "a step without an answer"
        return False
    rows = [qp["A"] @ y - qp["b"], qp["b"] - qp["A"] @ y, qp["G"] @ y - qp["h"], qp["lb"] - y, y - qp["ub"]]
    worst = max(row.max() for row in rows)
    scale = 1 + max(np.abs(value[np.isfinite(value)]).max(initial=0) for value in qp.values())
    assert worst <= 1e-5 * scale, f"not feasible by {worst}"
    if not odd:
        cost = lambda y: 0.5 * y @ (qp["P"] * y) + qp["q"] @ y  # noqa: E731
        null = np.linalg.svd(qp["A"])[2][3:]
        near = y + (draw.normal(size=(20, 3)) * 0.05) @ null
        G, h = np.vstack([qp["G"], np.eye(6), -np.eye(6)]), np.concatenate([qp["h"], qp["ub"], -qp["lb"]])
        inside = (near @ G.T <= h).all(axis=1)
        assert all(cost(other) >= cost(y) - 1e-6 for other in near[inside]), "a better answer lies near"
    return True


@cache
def solver() -> tuple[ClarabelSolver, np.ndarray]:
    weights = 2 * np.array([5.0, 5.0, 2.0, 1.0, 5.0, 10.0])
    return ClarabelSolver(weights, 8), weights


FIELDS = st.sampled_from(["q", "A", "b", "G", "h", "lb", "ub"])
CHANGE = st.tuples(st.integers(0, 5), SPOT, SPOT, st.binary(max_size=6))
ALTERATION = st.tuples(SPOT, st.integers(0, 3), ODD)
MANIFESTS = st.one_of(
    st.tuples(st.just("bytes"), st.lists(CHANGE, min_size=1, max_size=4)),
    st.tuples(st.just("values"), st.lists(ALTERATION, min_size=1, max_size=4)),
)
ROW_FILES = st.tuples(st.integers(0, 3), st.lists(CHANGE, min_size=1, max_size=4), st.booleans())
PLANS = st.tuples(st.lists(ALTERATION, max_size=2), st.lists(CHANGE, max_size=2))
QPS = st.tuples(st.integers(0, 2**32), st.lists(st.tuples(FIELDS, SPOT, QP_NUMBER), max_size=3))
YAMLS = [file.read_bytes() for file in sorted(CONFIGS.glob("*.yaml"))] + [b"margin_m: 1e-3\nstart_rad: [0, -2.3]\n"]
LIMITS = [
    b"joint_limits:\n  a1: {has_position_limits: true, min_position: -1, max_position: !degrees 90, max_jerk: 9}\n",
    b"/**:\n  ros__parameters:\n    joint_limits:\n      a2:\n        has_jerk_limits: true\n        max_jerk: 40.0\n"
    b"      a3:\n        has_position_limits: false\n        min_position: deg(3)\n        max_acceleration: 5\n",
]
LIMIT_WORDS = [
    "deg(",
    "rad(1)",
    "!degrees ",
    "!radians x",
    ".nan",
    ".inf",
    "true",
    "null",
    "a1",
    "joint_limits",
    "has_",
]
GRIDS = [re.sub(rb"config: .*", b"", file.read_bytes()) for file in sorted(SWEEPS.glob("*.yaml"))]
TEXTS = [(ending, TABLES) for ending in (".xyz", ".csv", ".txt")]
TEXT_WORDS = ["#", ";", ",", "\n", "\r", "x", "//", "nx", " 1,5 "]
ARRAY_WORDS = ["descr", "(", ")", "|O", "<f8", "True", "L", "{", "}"]
MODELS = [(".xml", [ARM, SMALL]), (".urdf", [URDF])]


def with_endings(choices, words: list[str]) -> st.SearchStrategy:
    """Strategy for pairs of a file extension and damaged contents of such a file."""
    return st.one_of([st.tuples(st.just(ending), damaged(seeds, words)) for ending, seeds in choices])


TARGETS = {
    "configuration, text": Target(8, damaged(YAMLS, YAML_WORDS), check_yaml),
    "configuration, values": Target(12, altered([PlanConfig().model_dump(mode="json")]), check_config),
    "joint limits": Target(6, damaged(LIMITS, [*YAML_WORDS, *LIMIT_WORDS]), check_limits),
    "sweep": Target(8, damaged(GRIDS, YAML_WORDS), check_sweep),
    "table of points": Target(17, with_endings(TEXTS, TEXT_WORDS), check_table),
    "array of points": Target(10, damaged(ARRAYS, ARRAY_WORDS), check_npy),
    "mesh": Target(15, with_endings(MESHES.items(), MESH_WORDS), check_mesh),
    "Collada mesh": Target(6, damaged([DAE.encode()], COLLADA_WORDS), check_collada),
    "robot": Target(12, with_endings(MODELS, XML_WORDS), check_robot),
    "manifest": Target(6, MANIFESTS, check_manifest, finished),
    "row file": Target(4, ROW_FILES, check_parquet, finished),
    "plan": Target(2, PLANS, check_plan),
    "step QP": Target(6, QPS, check_qp),
}
