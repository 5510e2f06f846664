"""Wrong inputs, over 300: each gives exit code 2, one line on stderr that names the cause, and no new file.

Add every new one here.
"""

import os
import shlex
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.runs.plan_folder import VALIDATION
from htcp_jax.spec.config import PlanConfig
from htcp_jax.viewer import offscreen

LONG = "x" * 300
BOX = "".join(f"{x} {y} {z}\n" for x in (0, 1) for y in (-1, 1) for z in (-1, 1))
ARM = """<mujoco model="arm"><worldbody><body name="a" pos="0 0 1"><joint name="j1" axis="0 0 1" range="-90 90"/>
<geom type="capsule" size=".05" fromto="0 0 0 1 0 0"/><body name="b" pos="1 0 0"><joint name="j2" axis="0 1 0"/>
<geom type="box" size=".1 .1 .1"/><body name="c" pos="1 0 0"><joint name="j3" type="slide" axis="0 0 1"/>
<geom type="sphere" size=".05"/><site name="tcp" pos=".2 0 0"/></body></body></body></worldbody></mujoco>"""
URDF = """<robot name="lifter"><link name="l0"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="l1"/><link name="l2"/><link name="l3"/>
<joint name="j1" type="revolute"><parent link="l0"/><child link="l1"/><limit lower="-1" upper="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><limit lower="-1" upper="1" velocity="2"/></joint>
<joint name="j3" type="revolute"><parent link="l2"/><child link="l3"/><limit lower="-1" upper="1" velocity="3"/></joint>
</robot>"""
FACES = (
    "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
BASELINE = str(Path(__file__).parents[1] / "sweeps" / "baselines" / "workpiece.yaml")
GRID = {"grid.yaml": "grid: [margin_m: [0]]"}
HUGE = "grid: [" + ", ".join(f"start_rad.{k}: [" + ", ".join(["0"] * 11) + "]" for k in range(1, 7)) + "]"
WITH_OUT = "plan", "program", "robot", "cell", "sweep", "report", "render", "place", "reachability"
FILES = {"path.csv": "0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n", "box.xyz": BOX, "arm.xml": ARM, "arm.urdf": URDF}


class Wrong(NamedTuple):
    """Command line, expected message, additional files, and the name the message must contain."""

    words: list[str]
    says: str
    files: dict[str, str | bytes] = {}  # noqa: RUF012 - never changed
    name: str = ""


def keys(model=PlanConfig, prefix: str = "") -> list[str]:
    """Every key of a configuration, dotted."""
    found = []
    for name, field in model.model_fields.items():
        inner = field.annotation
        if hasattr(inner, "model_fields"):
            found += keys(inner, f"{prefix}{name}.")
        elif hasattr(inner, "__dataclass_fields__"):
            found += [f"{prefix}{name}.{key}" for key in inner.__dataclass_fields__]
        else:
            found.append(prefix + name)
    return found


def setting(override: str, says: str) -> Wrong:
    return Wrong(["plan", "--set", override], says)


def job(text: str | bytes, says: str) -> Wrong:
    return Wrong(["plan", "job.yaml"], says, {"job.yaml": text})


def grid(text: str | bytes, says: str, command: str = "sweep") -> Wrong:
    return Wrong([command, "grid.yaml"], says, {"grid.yaml": text})


def cloud(name: str, data: str | bytes, says: str) -> Wrong:
    words = ["plan", "--set", f"workpiece.cloud={name}", "--set", "workpiece.path=path.csv"]
    return Wrong(words, says, {name: data}, name)


def path(name: str, data: str | bytes, says: str) -> Wrong:
    return Wrong(["plan", "--set", f"workpiece.path={name}"], says, {name: data}, name)


def model(name: str, text: str, says: str) -> Wrong:
    start = "start_rad=[0, 0, 0]"
    words = ["plan", "--set", f"robot.model={name}", "--set", "robot.limits=model", "--set", start]
    return Wrong(words, says, {name: text}, name)


def arm(old: str, new: str, says: str) -> Wrong:
    assert old in ARM
    return model("bad.xml", ARM.replace(old, new, 1), says)


def urdf(old: str, new: str, says: str) -> Wrong:
    assert old in URDF
    return model("bad.urdf", URDF.replace(old, new, 1), says)


def folder(command: str, says: str, **files: str | bytes) -> Wrong:
    """A `command` on the folder run, which holds the files; "_" stands for a full stop."""
    more = ["--baseline", BASELINE] if command == "gate" else []
    return Wrong([command, "run", *more], says, {f"run/{name.replace('_', '.')}": data for name, data in files.items()})


def task(rows: str, says: str, **files: str) -> Wrong:
    """A job with these rows, whose path is the file path.csv if given."""
    named = {f"{name}.csv": text for name, text in files.items()}
    path = ", workpiece: {path: path.csv}" if named else ""
    return Wrong(["plan", "job.yaml"], says, {"job.yaml": f"{{task: [{rows}]{path}}}", **named})


MISSPELT = [setting(f"{key}q=1", f"unknown key {key}q") for key in keys()]
NOT_A_NUMBER = [setting(f"{key}=.nan", key) for key in keys()]
NO_MAPPING = [setting(f"{key}={{a: 1}}", key) for key in keys()]

RANGES = [
    setting("settings.tolerance_m=1e3", "settings.tolerance_m is 1000.0: at most 0.1 is allowed"),
    setting("settings.tolerance_m=0.11", "settings.tolerance_m is 0.11: at most 0.1 is allowed"),
    setting("settings.tolerance_m=0", "settings.tolerance_m is 0: at least 1e-15 is needed"),
    setting("settings.tolerance_m=-1e-3", "settings.tolerance_m is -0.001: at least 1e-15 is needed"),
    setting("settings.qp_tolerance=1", "settings.qp_tolerance is 1: at most 0.01 is allowed"),
    setting("settings.alpha_rad=10", "settings.alpha_rad is 10: at most 3 is allowed"),
    setting("settings.alpha_rad=0", "settings.alpha_rad is 0: at least 1e-15 is needed"),
    setting("settings.sample_step_rad=30", "settings.sample_step_rad is 30: at most 3 is allowed"),
    setting("settings.max_sample_distance_rad=1e9", "settings.max_sample_distance_rad is 1000000000.0: at most 1000"),
    setting("settings.keep_clear_m=20", "settings.keep_clear_m is 20: at most 1 is allowed"),
    setting("settings.keep_clear_m=-1", "settings.keep_clear_m is -1: at least 0 is needed"),
    setting("settings.j1_weight=1e9", "settings.j1_weight is 1000000000.0: at most 1e+06 is allowed"),
    setting("settings.q_weights=[1, 1, 1, 1, 1, 1e16]", "settings.q_weights.5 is 1e+16: at most 1e+15"),
    setting("settings.q_weights=[1, 1, 1, 1, 1, 0]", "settings.q_weights.5 is 0: at least 1e-15 is needed"),
    setting("settings.q_weights=[1e-320, 1, 1, 1, 1, 1]", "settings.q_weights.0 is 1e-320: at least 1e-15 is needed"),
    setting("workpiece.mesh_spacing_m=1e-12", "workpiece.mesh_spacing_m is 1e-12: at least 1e-05 is needed"),
    setting("settings.q_weights=[]", "q_weights has 0 values, but the robot gp50 has 6 joints"),
    setting("settings.q_weights=[1, 1]", "q_weights has 2 values, but the robot gp50 has 6 joints"),
    setting("settings.path_weights=[1, 1]", "path_weights has 2 values, but the robot gp50 has 6 joints"),
    setting("settings.path_weights=[1, 1, 1, 1, 1, 0]", "settings.path_weights.5 is 0: at least 1e-15 is needed"),
    setting("settings.smooth=perhaps", "settings.smooth is 'perhaps'"),
    setting("settings.path_steps=1000000", "settings.path_steps is 1000000: at most 10000 is allowed"),
    setting("settings.path_steps=0", "settings.path_steps is 0: more than 0 is needed"),
    setting("settings.path_steps=2.5", "settings.path_steps is 2.5"),
    setting("settings.max_step_qps=1000000", "settings.max_step_qps is 1000000: at most 10000 is allowed"),
    setting("settings.max_null_space_steps=1000000", "settings.max_null_space_steps is 1000000: at most 10000"),
    setting("settings.samples=1000000", "settings.samples is 1000000: at most 100000 is allowed"),
    setting("settings.samples=-1", "settings.samples is -1: more than 0 is needed"),
    setting("settings.population=0", "settings.population is 0: more than 0 is needed"),
    setting("settings.generations=1e9", "settings.generations"),
    setting("settings.restart_rounds=-2", "settings.restart_rounds is -2: at least 0 is needed"),
    setting("settings.seed=-1", "settings.seed is -1: at least 0 is needed"),
    setting("settings.seed=99999999999999999999", "settings.seed"),
    setting("settings.qp=gurobi", "settings.qp: 'gurobi' is not a QP solver; valid: auto, clarabel, device, "),
    setting("settings.qp=qpsolvers:nothing", "nothing"),
    setting("settings.clearance_rows=all", "settings.clearance_rows is 'all'"),
    setting("settings.cost_about=now", "settings.cost_about is 'now'"),
    setting("settings.after_recovery=maybe", "settings.after_recovery is 'maybe'"),
    setting("settings.path_check=some", "settings.path_check is 'some'"),
    setting("settings.include_proximal_bodies=perhaps", "settings.include_proximal_bodies is 'perhaps'"),
    setting("margin_m=-0.001", "margin_m is -0.001"),
    setting("margin_m=10", "margin_m is 10"),
    setting("margin_m=1mm", "margin_m is '1mm'"),
    setting("margin_m=0,001", "margin_m is '0,001'"),
    setting("margin_m=.inf", "margin_m is inf"),
    setting("method=rrt", "'rrt' is not a method; valid: baseline"),
    setting("method=", "method"),
    setting("method=../outside", "'../outside' is not a method"),
    setting("ray.num_cpus=0", "ray.num_cpus is 0"),
    setting("ray.num_gpus=-1", "ray.num_gpus is -1"),
    setting("ray.retries=-1", "ray.retries is -1"),
    setting("robot.limits=paper", "robot.limits: 'paper' is not a source"),
    setting("robot.model=", "robot.model"),
    setting("robot.model=gp5O", "gp5O"),
    setting("robot.tool_extension_m=1e300", "robot.tool_extension_m is 1e+300"),
    setting("workpiece.interior=box", "workpiece.interior is 'box'"),
    setting("workpiece.interior_depth_m=-1", "workpiece.interior_depth_m is -1"),
    setting("workpiece.approach_to_path=-1", "workpiece.approach_to_path is -1"),
    setting("workpiece.approach_to_inlet=100000", "workpiece.approach_to_inlet is 100000"),
    setting("workpiece.pivot_m=[0, 0]", "workpiece.pivot_m"),
    setting("workpiece.shift_m=[9, 0, 0]", "target 1 is "),
    setting("workpiece.shift_m=[0, 0, 1e9]", "workpiece.shift_m"),
    setting("workpiece.inlet_m=[0, 0, far]", "workpiece.inlet_m"),
    setting("start_rad=[]", "start has 0 joint positions, the robot gp50 has 6 joints"),
    setting("start_rad=[0, 0]", "start has 2 joint positions, the robot gp50 has 6 joints"),
    setting("start_rad=[0, -2.3, 0.5, 0, 0.5, -2, 0]", "start has 7 joint positions"),
    setting("start_rad=[9, -2.3, 0.5, 0, 0.5, -2]", "outside its limits"),
    setting("start_rad=[a, -2.3, 0.5, 0, 0.5, -2]", "start_rad.0 is 'a'"),
    setting("start_rad=[0, -1.2, -0.5, 0, 0.5, -2]", "start is in collision: "),
    setting(
        "start_rad=atuo", "start_rad: 'atuo' is not a start configuration; valid: auto, or a list of joint positions"
    ),
    setting("home_rad=[]", "home has 0 joint positions, the robot gp50 has 6 joints"),
    setting("home_rad=[0, 0]", "home has 2 joint positions, the robot gp50 has 6 joints"),
    setting("home_rad=[9, -2.3, 0.5, 0, 0.5, -2]", "home: joint1 at 9 is outside its limits"),
    setting(
        "home_rad=[0, -1.2, -0.5, 0, 0.5, -2]", "is 298.136 mm inside the keep-out zone around the workpiece's hull"
    ),
    setting("home_rad=auto", "home_rad is 'auto'"),
    setting("settings.transfers=perhaps", "settings.transfers is 'perhaps'"),
    setting("settings.path_tolerance_m=0", "settings.path_tolerance_m is 0: at least 1e-15 is needed"),
    setting("settings.path_tolerance_m=-1e-3", "settings.path_tolerance_m is -0.001: at least 1e-15 is needed"),
    setting("start_deg=[0]", "unknown key start_deg; did you mean start_rad?"),
]
YAML = [
    job("- margin_m\n", "job.yaml: must be a mapping"),
    job("just a word", "job.yaml: must be a mapping"),
    job("3", "job.yaml: must be a mapping"),
    job("margin_m: 1\nmargin_m: 2\n", "job.yaml, line 2: key 'margin_m' is repeated"),
    job("robot:\n  model: a\n  model: b\n", "job.yaml, line 3: key 'model' is repeated"),
    job("margin_m: [1\n", "job.yaml, line 2"),
    job("margin_m: 'open\n", "job.yaml, line"),
    job("\tmargin_m: 1\n", "job.yaml, line 1"),
    job("a: 1: 2\n", "job.yaml, line 1"),
    job("margin_m: !!python/object/apply:os.system ['touch hacked']", "is not allowed; use a plain value"),
    job("margin_m: !!float 1", "is not allowed; use a plain value"),
    job("a: &a [x,x]\nb: *a\n", "line 2: alias *a is not allowed; write its value out"),
    job("start_rad: " + "[" * 5_000, "nested too deeply"),
    job("{" * 5_000, "nested too deeply"),
    job("? [1, 2]\n: 3\n", "job.yaml, line 1: a key is not a plain word"),
    job("margin_m: " + "9" * 10_000, "margin_m is"),
    job("# " + "x" * 3_000_000, "job.yaml: 3,000,002 bytes"),
    job(b"\xff\xfe\x00", "cannot read job.yaml: it is not UTF-8 text"),
    job(b"\x00\x00", "job.yaml"),
    job(b"\x89PNG\r\n\x1a\n", "cannot read job.yaml"),
    job("--- \nmargin_m: 0\n---\nmargin_m: 1\n", "job.yaml"),
    job("%YAML 3.0\n---\na: 1\n", "job.yaml"),
    job("robot: gp50\n", "robot is 'gp50'"),
    job("robot: [model, gp50]\n", "robot"),
    job("workpiece: duct\n", "workpiece is 'duct'"),
    job("settings: 5\n", "settings is 5"),
    job("settings: [alpha_rad]\n", "settings"),
    job("start_rad: 0\n", "start_rad is 0"),
    job("start_rad: {joint1: 0}\n", "start_rad"),
    job("margin_m: true\n", "margin_m is True"),
    job("margin_m: 1:30\n", "margin_m is '1:30'"),
    job("margin_m: 0x10q\n", "margin_m is '0x10q'"),
    job("margin_m: 2020-13-45\n", "margin_m is '2020-13-45'"),
    job("margin_m: null\n", "margin_m is None"),
    job("margin: 0.001\n", "unknown key margin; did you mean margin_m?"),
    job("1: 2\n", "unknown key 1"),
    job("workpiece: {cloud: box.xyz}\n", "box.xyz: workpiece.path is missing"),
    job("workpiece: {cloud: box.xyz, path: crown}\n", "box.xyz: workpiece.path is missing"),
    job("workpiece: {cloud: none.xyz, path: path.csv}\n", "none.xyz: no such file"),
    job("workpiece: {cloud: [box.xyz], path: path.csv}\n", "workpiece.cloud is ['box.xyz']"),
    job("workpiece: {cloud: ., path: path.csv}\n", "unknown ending ''"),
    job('workpiece: {cloud: "a\\0b.xyz", path: path.csv}\n', "b.xyz: no such file"),
    job('workpiece: {path: "a\\0b.csv"}\n', "b.csv: no such file"),
    job('robot: {model: "a\\0b.xml"}\nstart_rad: [0]\n', "b.xml: "),
    job(f"workpiece: {{path: {LONG}.csv}}\n", "File name too long"),
    job(f"workpiece: {{cloud: {LONG}.xyz, path: path.csv}}\n", "File name too long"),
    job(f"robot: {{model: {LONG}.xml}}\nstart_rad: [0]\n", "File name too long"),
]
COMMANDS = [
    Wrong(["plam"], "No such command 'plam'"),
    Wrong(["plan", "--fast"], "No such option: --fast"),
    Wrong(["plan", "a.yaml", "b.yaml"], "b.yaml"),
    Wrong(["plan", "nowhere.yaml"], "cannot read nowhere.yaml: No such file"),
    Wrong(["plan", "."], "cannot read .: not a regular file"),
    Wrong(["plan", "/dev/zero"], "cannot read /dev/zero: not a regular file"),
    Wrong(["plan", "box.xyz"], "box.xyz"),
    Wrong(["plan", LONG], "File name too long"),
    Wrong(["plan", "--out", LONG], "File name too long"),
    Wrong(["plan", "--out", f"new/{LONG}"], "File name too long"),
    Wrong(["plan", "--out", "path.csv"], "cannot write to path.csv"),
    Wrong(["plan", "--out", "path.csv/under"], "cannot write to path.csv/under: Not a directory"),
    Wrong(["plan", "--out", "/proc/none"], "cannot write to /proc/none"),
    Wrong(["plan", "--out", "a\0b"], "NUL byte"),
    Wrong(["plan", "a\0b"], "NUL byte"),
    Wrong(["plan", "--set"], "--set"),
    Wrong(["plan", "--set", "margin_m"], "--set expects key=value, not 'margin_m'"),
    Wrong(["plan", "--set", "=1"], "--set expects key=value, not '=1'"),
    Wrong(["plan", "--set", "margin_m=["], "--set margin_m=["),
    Wrong(["plan", "--set", "margin_m=*a"], "alias *a"),
    Wrong(["plan", "--set", "settings..seed=1"], "unknown key settings."),
    Wrong(["plan", "--method", "rrt"], "'rrt' is not a method; valid: baseline"),
    Wrong(["plan", "--method", ""], "--method is empty"),
    *(Wrong([command, "x", "--out", ""], "--out is empty; give a value, or omit it") for command in WITH_OUT),
    Wrong(["plan", "--out="], "--out is empty; give a value, or omit it"),
    Wrong(["view", " "], "an argument is empty; give a value, or omit it"),
    Wrong(["plan", "--device", "tpu"], "device is 'tpu'"),
    Wrong(["plan", "--device", "gpu:x"], "device is 'gpu:x'"),
    Wrong(["sweep"], "SWEEP.yaml"),
    Wrong(["sweep", "nowhere.yaml"], "cannot read nowhere.yaml"),
    Wrong(["sweep", "."], "cannot read .: not a regular file"),
    Wrong(["sweep", LONG], "File name too long"),
    Wrong(["sweep", "grid.yaml", "--limit", "0"], "'--limit': Input should be greater than or equal to 1", GRID),
    Wrong(["sweep", "grid.yaml", "--limit", "x"], "--limit", GRID),
    Wrong(["sweep", "grid.yaml", "--shard", "-3"], "'--shard': Input should be greater than or equal to 1", GRID),
    Wrong(["sweep", "grid.yaml", "--seed", "-1"], "settings.seed", GRID),
    Wrong(["sweep", "grid.yaml", "--on", "mars"], "on is 'mars'", GRID),
    Wrong(["sweep", "grid.yaml", "--methods", ""], "--methods is empty", GRID),
    Wrong(["sweep", "grid.yaml", "--methods", ","], "no methods; valid: all", GRID),
    Wrong(["sweep", "grid.yaml", "--methods", "baseline,rrt"], "'rrt'", GRID),
    Wrong(["sweep", "grid.yaml", "--methods", "hybrid,hybrid"], "method hybrid is given twice", GRID),
    Wrong(["sweep", "grid.yaml", "--config", "no.yaml"], "cannot read no.yaml", GRID),
    Wrong(["sweep", "grid.yaml", "--config", LONG], "File name too long", GRID),
    Wrong(["sweep", "grid.yaml", "--out", "p"], "p contains a plan of htcp plan", GRID | {"p/summary.json": "{}"}),
    Wrong(["plan", "--out", "r"], "r contains a run of htcp sweep (manifest.json)", {"r/manifest.json": "{}"}),
    Wrong(["sweep", "grid.yaml", "--out", LONG], "File name too long", GRID),
    Wrong(["sweep", "grid.yaml", "--out", f"new/{LONG}"], "File name too", GRID),
    Wrong(["sweep", "grid.yaml", "--out", "path.csv"], "write to path.csv", GRID),
    Wrong(["sweep", "grid.yaml", "--out", "/proc/none"], "/proc/none", GRID),
    Wrong(["reachability", "nowhere.yaml"], "cannot read nowhere.yaml"),
    Wrong(["reachability", "grid.yaml", "--resolution", "0"], "--resolution", GRID),
    Wrong(["reachability", "grid.yaml", "--out", LONG], "File name too long", GRID),
    Wrong(["reachability", "grid.yaml", "--out", f"new/{LONG}"], "File name too", GRID),
    Wrong(["reachability", "grid.yaml", "--out", "path.csv"], "write to path.csv", GRID),
    Wrong(["validate"], "RUN"),
    Wrong(["validate", "nowhere"], "nowhere contains neither a run of htcp sweep"),
    Wrong(["validate", "path.csv"], "path.csv contains neither a run of htcp sweep"),
    Wrong(["validate", LONG], "File name too long"),
    Wrong(["validate", ".", "--between", "-1"], "between is -1"),
    Wrong(["validate", ".", "--between", "many"], "--between"),
    Wrong(["validate", ".", "--feed-mm-s", "0"], "the feed rate is 0 mm/s"),
    Wrong(["validate", ".", "--feed-mm-s", "nan"], "the feed rate is nan mm/s"),
    Wrong(["validate", ".", "--feed-mm-s", "inf"], "the feed rate is inf mm/s"),
    Wrong(["report"], "RUN"),
    Wrong(["report", "nowhere"], "nowhere contains no run: cannot read manifest.json"),
    Wrong(["report", "path.csv"], "path.csv contains no run"),
    Wrong(["report", LONG], "File name too long"),
    Wrong(["view", "nowhere"], "nowhere: no such run folder or job"),
    Wrong(["view", LONG], "File name too long"),
    Wrong(["view", "--port", "99999", "."], "--port"),
    Wrong(["view", "--port", "http", "."], "--port"),
    Wrong(["view", "--set", "margin_m=1e-3", "."], "--set and --seed change a job"),
    Wrong(["view", "--method", "rrt"], "'rrt' is not a method"),
    Wrong(["view", "."], ". contains neither a run of htcp sweep"),
    Wrong(["render"], "RUN"),
    Wrong(["render", ".", "--width", "1"], "--width is 1; valid: 160 to 3840"),
    Wrong(["render", ".", "--width", "100000"], "--width is 100000"),
    Wrong(["render", ".", "--movie", "avi"], "avi"),
    Wrong(["render", ".", "--scenario", "one"], "--scenario"),
    Wrong(["render", "nowhere"], "nowhere contains neither a run of htcp sweep"),
    Wrong(["render", LONG], "File name too long"),
    Wrong(["program"], "RUN"),
    Wrong(["program", "nowhere", "--out", "a.csv"], "nowhere contains neither a run of htcp sweep"),
    Wrong(["program", "nowhere", "--feed", "20mm/s"], "--out"),
    Wrong(["program", "nowhere", "--feed", "20mm/s", "--out", "a.csv"], "nowhere contains neither a run of htcp sweep"),
    Wrong(["program", "nowhere", "--feed", "0mm/s", "--out", "a.csv"], "feed '0mm/s' is not a speed above 0"),
    Wrong(
        ["program", "nowhere", "--feed", "20", "--out", "a.csv"],
        "feed '20' is not a speed above 0 with a unit, such as 20",
    ),
    Wrong(["program", "nowhere", "--feed", "infm/s", "--out", "a.csv"], "units: mm/s, m/s, mm/min, m/min"),
    Wrong(
        ["program", "nowhere", "--feed", "1e308m/s", "--out", "a.csv"], "feed '1e308m/s' is 1e+308 m/s; valid: 1e-09"
    ),
    Wrong(["sweep", "grid.yaml", "--limit", "9" * 20], "limit is 99999999999999999999; valid: 1 to", GRID),
    Wrong(["reachability", "grid.yaml", "--limit", "9" * 20], "limit is 99999999999999999999; valid: 1 to 1,000", GRID),
    Wrong(
        ["plan", "job.yaml", "--method", "baseline"],
        "job.yaml: method is '../../etc/passwd'; names consist of lower-case letters, digits and hyphens",
        {"job.yaml": "method: ../../etc/passwd"},
    ),
    Wrong(
        ["place", "place.yaml", "--out", "out"],
        "place: workpiece.shift_m.x: the range is [0, 1e+308]; valid: -1e+06 to 1e+06",
        {"place.yaml": "place: {workpiece.shift_m.x: [0, 1e308]}"},
    ),
    Wrong(
        ["plan", "--set", "robot.model=far.xml", "--set", "start_rad=[0, 0, 0]"],
        "far.xml: the pose of a joint is 1e+308 m; at most 1e+09 m",
        {"far.xml": ARM.replace('pos="1 0 0"', 'pos="1e308 0 0"')},
    ),
    Wrong(
        ["program", "nowhere", "--feed", "20mm/s", "--out", "a.out", "--format", "gcode"],
        "'gcode' is not a program format; valid: csv, ros, ros-json, jbi, jbi-pulses, rapid, krl, ls, urscript, key",
    ),
    Wrong(["program", LONG, "--feed", "20mm/s", "--out", "a.csv"], "File name too long"),
    Wrong(["gate", "run"], "--baseline"),
    Wrong(["gate", "run", "--baseline", "no.yaml"], "cannot read no.yaml"),
    Wrong(["gate", "run", "--baseline", "."], "cannot read .: not a regular file"),
    Wrong(["gate", "run", "--baseline", LONG], "File name too long"),
    Wrong(["gate", "run", "--baseline", "path.csv"], "path.csv"),
    Wrong(["gate", "run", "--baseline", "b.yaml"], "b.yaml", {"b.yaml": "{}"}),
    Wrong(["gate", "run", "--baseline", "b.yaml"], "unknown key metods", {"b.yaml": "metods: {}"}),
    Wrong(["gate", "nowhere", "--update", "--baseline", "b.yaml"], "nowhere contains no run"),
    Wrong(["gate", LONG, "--update", "--baseline", "b.yaml"], "File name too long"),
    Wrong(["prepare", "job.yaml"], "job.yaml"),
    Wrong(["doctor", "--deep"], "No such option: --deep"),
    Wrong(["doctor", "now"], "now"),
    Wrong(["methods", "all"], "all"),
]
SWEEPS = [
    grid("{}", "a sweep must have either `grid`"),
    grid("grid: []", "grid is empty"),
    grid("groups: {}", "groups is empty"),
    grid("groups: {a: []}", "groups.a is empty"),
    grid("grid: [{}]", "axis 1 is empty"),
    grid("grid: 3", "grid is 3"),
    grid("grid: [3]", "grid.0 is 3"),
    grid("gird: []", "unknown key gird; did you mean grid?"),
    grid("grid: [margin_m: []]", "margin_m has no values"),
    grid("grid: [margin_m: 1]", "margin_m needs a list of values"),
    grid("grid: [margin_m: {offset: [1]}]", "margin_m needs a list of values"),
    grid("grid: [margin_m: [true]]", "margin_m takes finite numbers, not True"),
    grid("grid: [margin_m: [.nan]]", "margin_m takes finite numbers, not nan"),
    grid("grid: [margin_m: [-1]]", "scenario 0: margin_m is -1"),
    grid("grid: [margin_m: [0, 1.0e+300]]", "scenario 1: margin_m is 1e+300"),
    grid("grid: [margin: [1]]", "unknown parameter margin; did you mean margin_m or margin_on?"),
    grid("grid: [start_rad.7: [1]]", "unknown parameter start_rad.7"),
    grid("grid: [start_rad: [0]]", "start_rad takes lists of numbers, not 0"),
    grid("grid: [start_rad: [[0, 0]]]", "scenario 0: start has 2 joint positions"),
    grid("grid: [start_rad: [auto]]", "start_rad takes lists of numbers, not 'auto'"),
    Wrong(
        ["sweep", "grid.yaml", "--set", "start_rad=auto", "--set", "home_rad=[0, -2.3, 0.5, 0, 0.5, -2]"],
        "start_rad.joint1: start_rad is auto, which has no joint positions to vary",
        {"grid.yaml": "grid: [start_rad.1: [0]]"},
    ),
    grid("grid: [home_rad: [[0, 0]]]", "scenario 0: home has 2 joint positions"),
    grid("grid: [start_rad.1: [0, 9]]", "scenario 1: start: joint1 at 9 is outside its limits"),
    grid("grid: [{margin_m: [0, 1], start_rad.1: [0]}]", "margin_m has 2 values, start_rad.joint1 has 1 values"),
    grid("grid: [{start_rad.3: [0]}, {start_rad.joint3: [0]}]", "start_rad.joint3 is repeated"),
    grid("grid: [workpiece.path: {offsets: [a]}]", "workpiece.path takes names of files"),
    grid("grid: [workpiece.path: [none.csv]]", "none.csv: no such file"),
    grid("grid: [workpiece.path: [crown, ceiling]]", "a seam of the duct (weld, left, right, crown, invert"),
    grid("grid: [margin_m: [0]]\ngroups: {a: [margin_m: [0]]}", "a sweep must have either `grid`"),
    grid("config: none.yaml\ngrid: [margin_m: [0]]", "cannot read none.yaml"),
    grid('config: "a\\0b"\ngrid: [margin_m: [0]]', "cannot read a"),
    grid(f"config: {LONG}\ngrid: [margin_m: [0]]", "File name too long"),
    grid("config: grid.yaml\ngrid: [margin_m: [0]]", "grid.yaml"),
    grid("config: 5\ngrid: [margin_m: [0]]", "config is 5"),
    grid(HUGE, "the grid has 1,771,561 scenarios; at most 1,000,000"),
    grid("grid: [margin_m: [x]]", "margin_m takes finite numbers, not 'x'", "reachability"),
    grid("grid: []", "grid is empty", "reachability"),
]
CLOUDS = [
    cloud("a.xyz", "", "0 points, at least 4"),
    cloud("a.xyz", "0 0 0\n1 0 0\n0 1 0\n", "3 points, at least 4"),
    cloud("a.xyz", "0 0\n1 0\n0 1\n1 1\n", "line 1 has 2 columns"),
    cloud("a.csv", "1,2,3\n1,2\n4,5,6\n", "line 2 has 2 columns"),
    cloud("a.csv", "x,y,z\nx,y,z\n", "line 2: 'x' is not a number"),
    cloud("a.csv", "1,2,3\n1,,2\n", "line 2: '' is not a number"),
    cloud("a.csv", "1,2,3\n1_0,2,3\n", "line 2: '1_0' is not a number"),
    cloud("a.csv", "1,2,3\n0x1,2,3\n", "line 2: '0x1' is not a number"),
    cloud("a.xyz", "0 0 0\n0 nan 0\n1 1 1\n0 0 1\n", "3 points, at least 4 are needed; 1 of 4 are NaN"),
    cloud("a.xyz", "0 0 0\n0 inf 0\n1 1 1\n0 0 1\n", "line 2"),
    cloud("a.xyz", "0 0 0\n0 1e999 0\n1 1 1\n0 0 1\n", "line 2"),
    cloud("a.xyz", "0 0 0\n0 1e12 0\n1 1 1\n0 0 1\n", "a coordinate is 1e+12 m, which is too large; give metres"),
    cloud("a.xyz", b"\xff\xfe\x00\x01", "not a text file of points"),
    cloud("a.npy", b"", ""),
    cloud("a.npy", b"\x93NUMPY", ""),
    cloud("a.npy", b"no array at all", ""),
    cloud("a.ply", b"", ""),
    cloud(
        "a.ply",
        FACES.format("ascii") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n255 0 1 2\n",
        "damaged: face 2 of 2 is not complete",
    ),
    cloud(
        "a.ply",
        FACES.format("binary_little_endian").encode()
        + struct.pack("<9fB3iB3i", 0, 0, 0, 1, 0, 0, 0, 1, 0, 3, 0, 1, 2, 255, 0, 1, 2),
        "damaged: face 2 of 2 is not complete",
    ),
    cloud("a.ply", b"ply\nformat ascii 1.0\nend_header\n", ""),
    cloud("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\n", ""),
    cloud("a.stl", b"", ""),
    cloud("a.stl", b"solid nothing\nendsolid\n", ""),
    cloud("a.stl", b"\x00" * 84, ""),
    cloud("a.obj", "", ""),
    cloud("a.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "the mesh has no area"),
    cloud("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "damaged: face 1 has vertex 9; the file has 3 vertices"),
    cloud("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", "there is no vertex -4; the first vertex is 1"),
    cloud("a.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", ""),
    cloud("a.dxf", "", "unknown ending '.dxf'; valid: .xyz"),
    cloud("a", "", "unknown ending ''"),
]  # fmt: skip
PATHS = [
    path("p.csv", "", "the tool path is empty"),
    path("p.csv", "# nothing\n", "the tool path is empty"),
    path("p.csv", "x,y,z\n", "the tool path is empty"),
    path("p.csv", "1,2\n", "line 1 has 2 columns"),
    path("p.csv", "x,y,z\n0.1,0.2,0.3\n0.1,a,0.3\n", "line 3: 'a' is not a number"),
    path("p.csv", "0.1,0.2,0.3\n0.1,nan,0.3\n", "line 2"),
    path("p.csv", "0.1,0.2,0.3\n0.1,inf,0.3\n", "line 2"),
    path("p.csv", "0.1,0.2,0.3\n\n0.1\n", "line 3 has 1 columns"),
    path("p.csv", "0.1,0.2,1e12\n", "which is too large; give metres"),
    path("p.csv", "x,y,z,pass\n0.1,0,0,1\n0.2,0,0,1\n0.1,0.1,0,2\n0.2,0.1,0,2\n", "2 seams (rows 1 to 2, rows 3 to 4)"),
    path(
        "p.csv",
        "time,lat,lon,alt\n0.5,0.1,0,0\n",
        "p.csv: the header names none of x, y, z: time, lat, lon, alt; name x,",
    ),
    path("p.csv", b"\xff\xfe0\x00", "not a text file of points"),
    path("p.npy", b"", "unknown ending '.npy'"),
    path("p.obj", "v 0 0 0\n", "unknown ending '.obj'"),
    path("p", "0 0 0\n", "valid: a seam of the duct"),
    Wrong(["plan", "--set", "workpiece.path=p.csv"], "half of the path", {"p.csv": "9,0,0\n"}),
    setting("workpiece.path=none.csv", "none.csv: no such file"),
    setting("workpiece.path=.", "valid: a seam of the duct"),
    setting("workpiece.path=/dev/zero", "or a table of x,y,z (.xyz .csv .txt)"),
    setting(
        "workpiece.path=ceiling",
        "workpiece.path is ceiling; valid: a seam of the duct (weld, left,",
    ),
]
ARMS = [
    model("bad.xml", "", "not a model that MuJoCo can read"),
    model("bad.xml", "<mujoco", "not a model that MuJoCo can read"),
    model("bad.xml", "<html/>", "not a model that MuJoCo can read"),
    model("bad.xml", "<mujoco/>", ""),
    model("bad.xml", "\x00\x01", "not a model that MuJoCo can read"),
    model("bad.xml", "<!DOCTYPE x><mujoco/>", "a document type"),
    arm('<site name="tcp" pos=".2 0 0"/>', "", "no site or body 'tcp'"),
    arm('size=".05" fromto', 'size="0" fromto', "has radius 0 m; it must be positive"),
    arm('size=".05" fromto', 'size="-1" fromto', "it must be positive"),
    arm('range="-90 90"', 'range="90 -90"', "joint 'j1' has range 90 to -90; the lower limit must come first"),
    arm('axis="0 1 0"', 'axis="0 0 0"', "not a model that MuJoCo can read"),
    arm('axis="0 1 0"', 'axis="0 1"', "not a model that MuJoCo can read"),
    arm('<joint name="j2" axis="0 1 0"/>', "<freejoint/>", "not a model"),
    arm('<joint name="j2" axis="0 1 0"/>', '<joint name="j2" type="ball"/>', "ball or free joints (j2)"),
    arm('<joint name="j2" axis="0 1 0"/>', "", "2 joints from the world to the TCP; at least 3"),
    arm("</worldbody>", '<body name="d"><joint name="j4"/><geom type="sphere" size="1"/></body></worldbody>',
        "joints off the chain from the world to the TCP: j4"),
    arm("<worldbody>", '<worldbody><replicate count="9"><geom size="1"/></replicate>', "<replicate> is not supported"),
    arm("<worldbody>", '<include file="../other.xml"/><worldbody>', "it is outside the model's folder"),
    arm("<worldbody>", '<include file=""/><worldbody>', "cannot include ''"),
    arm("<worldbody>", '<custom><numeric name="speed" data="1 1"/></custom><worldbody>', "'speed' has 2 values"),
    arm("<worldbody>", '<custom><numeric name="speed" data="1 0 1"/></custom><worldbody>', "'speed' must be positive"),
    arm('pos="0 0 1"', 'pos="0 0 nan"', ""),
    urdf('type="revolute"', 'type="floating"', "joint 'j1' between base and TCP has type floating"),
    urdf('velocity="2"', 'velocity="fast"', "joint 'j2': <limit velocity='fast'> is not a number"),
    urdf('<sphere radius="0.1"/>', '<box size="1 1 1"/>', "no capsule or sphere geoms"),
    urdf('<child link="l3"/>', '<child link="l9"/>', "joint 'j3': no link 'l9', its child"),
    urdf('lower="-1" upper="1" velocity="1"', 'lower="2" upper="1" velocity="1"', "joint 'j1' has range 2 to 1"),
    setting("robot.model=none.urdf", "none.urdf: cannot read the model: No such file"),
    setting("robot.model=.", ".: not a regular file"),
]  # fmt: skip
ON_PATH, CONE = "{point: tcp, on: path}", "{axis: tcp.z, towards: -path.normal, cone_deg: 60}"
POINTS = "0.1857,-0.1737,0.1708", "0.19,-0.1738,0.1705"
TASKS = [
    task("{point: flange, on: path}", "task.1: no point 'flange' on gp50; valid: link1, "),
    task(f"{ON_PATH}, {{axis: flange.z, towards: [0, 0, 1]}}", "task.2: no axis 'flange' on gp50; valid: link1, "),
    task(f"{ON_PATH}, {{orientation: [1, 0, 0, 0], of: hand}}", "task.2: no frame 'hand' on gp50; valid: link1, "),
    task("{point: tcp, on: path, frame: tool}", "task.1: frame is 'tool'; valid: world, workpiece, path"),
    task("{axis: tcp.w, towards: [0, 0, 1]}", "task.1: axis is 'tcp.w'; it must be like tcp.z"),
    task(f"{ON_PATH}, {CONE.replace('60', '-1')}", "task.2: cone_deg is -1; it must be 0 to 180"),
    task(f"{ON_PATH}, {CONE.replace('60', '180.5')}", "task.2: cone_deg is 180.5; it must be 0 to 180"),
    task(f"{ON_PATH}, {CONE.replace('60', '.nan')}", "task.2.cone_deg"),
    task(CONE.replace("-path.normal", "[0, 0, 0]"), "task.1: towards is zero; it must have a direction"),
    task("{point: tcp, on: plane, through_m: [1, 0, 1], normal: [0, 0, 0]}", "task.1: normal is zero"),
    task("{point: tcp, on: line, through_m: [1, 0, 1], direction: [0, 0, 0]}", "task.1: direction is zero"),
    task(f"{ON_PATH}, {{orientation: [0, 0, 0, 0]}}", "task.2: orientation is a quaternion of length 0"),
    task("{orientation: path}", "task.1 (orientation tcp): the path has no orientations; add columns qw,"),
    task(CONE, "path.csv: the normal at point 2 has the length 0.5; it must be 1",
         path=f"x,y,z,nx,ny,nz\n{POINTS[0]},0,0,1\n{POINTS[1]},0,0,0.5\n"),
    task(CONE, "path.csv: the normal at point 1 has the length 0; it must be 1",
         path=f"x,y,z,nx,ny,nz\n{POINTS[0]},0,0,0\n{POINTS[1]},0,0,1\n"),
    task("{orientation: path}", "path.csv: the quaternion at point 1 has the length 0",
         path=f"x,y,z,qw,qx,qy,qz\n{POINTS[0]},0,0,0,0\n{POINTS[1]},1,0,0,0\n"),
    task("{axis: tcp.x, towards: path.tangent}", "the path has no tangent, because all of its points coincide",
         path=f"{POINTS[0]}\n{POINTS[0]}\n"),
    task(f"{ON_PATH}, {{point: tcp, on: [1, 0, 1]}}", "task.2 (point tcp) repeats or contradicts an earlier row"),
    task(f"{CONE}, {CONE.replace('tcp.z', '-tcp.z')}", "task.1 (axis tcp.z) and task.2 (axis -tcp.z) contradict each"),
    task(f"{ON_PATH}, {{orientation: [1, 0, 0, 0]}}, {{point: link4, on: [1, 0, 1]}}", "the task has 9"),
    Wrong(["plan", "--set", "task.1.cone_deg=5"], "task.1.cone_deg: no row 1; the list has 0"),
]  # fmt: skip
PLAN = {"summary_json": '{"method": "baseline", "config": {}, "files": {}}', "trajectory_npz": b"PK"}
FOLDERS = [
    folder("report", "run/trajectory.npz is damaged", **PLAN),
    folder("gate", "run contains a plan of htcp plan, not a run; open it with htcp view, htcp render", **PLAN),
    folder("validate", "run/trajectory.npz is damaged", **PLAN),
    folder("view", "run/trajectory.npz is damaged", **PLAN),
    folder("validate", "trajectory.npz", summary_json=PLAN["summary_json"]),
    folder("validate", "summary.json", summary_json="{"),
    folder("validate", "summary.json", summary_json=b"\xff"),
    folder("view", "summary.json", summary_json="[]"),
    folder("report", "manifest.json is damaged", manifest_json="{}"),
    folder("report", "manifest.json is damaged", manifest_json=b""),
    folder("validate", "manifest.json is damaged", manifest_json="null"),
    folder("view", "run has the format of another version", manifest_json='{"format": 2}'),
    folder("report", "run contains neither a run (manifest.json) nor a plan (summary.json)", other="x"),
    folder("gate", "run contains no run: cannot read manifest.json", other="x"),
    folder("validate", "run contains neither a run", other="x"),
    folder("view", "run contains neither a run", other="x"),
]
JOBS = [
    job("config: job.yaml\n", "job.yaml"),
    job("config: none.yaml\n", "none.yaml"),
    job("config: [a, b]\n", "config"),
    job("robot: {tcpp: tool0}\n", "did you mean robot.tcp?"),
    job("robot: {tcp: 5}\n", "robot.tcp"),
    job("robot: {model: arm.xml, tcp: tool9}\nstart_rad: [0, 0, 0]\n", "'tool9'"),
    job("robot: {base_m: [0, 0]}\n", "robot.base_m"),
    job("robot: {base_rpy_rad: [0, 0, 0, 0]}\n", "robot.base_rpy_rad"),
    job("robot: {tool: 5}\n", "robot.tool"),
    job("workpiece: {rotation_x_rad: right}\n", "workpiece.rotation_x_rad"),
    job("workpiece: {mesh_spacing_m: 0}\n", "workpiece.mesh_spacing_m"),
    Wrong(["plan", "--set", "robot.model=arm.xml"], "start_rad"),
    Wrong(["plan", "--set", "robot.model=arm.urdf"], "start_rad"),
    job("robot: {model: arm.xml}\nsettings: {transfers: true}\n", "must be given: 3 joint positions (j1, j2, j3)"),
    job("robot: {model: arm.xml}\nstart_rad: auto\nhome_rad: [0, 0]\n", "home has 2 joint positions, the robot arm"),
    cloud("a.csv", "1,5;2,5;3,5\n2,5;3,5;4,5\n", "decimal comma"),
    cloud("a.xyz", "1,5 2,5 3,5\n2,5 3,5 4,5\n", "decimal comma"),
    path("p.csv", "0,1;0,2;0,3\n0,2;0,2;0,3\n", "decimal comma"),
    cloud("a.xyz", "0 0 0 1 1\n1 0 0 1\n0 1 0 1 1\n0 0 1 1 1\n", "line 2"),
    path("p.csv", "0.1,0.2,0.3,0,0\n0.1,0.2,0.3,0\n", "line 2"),
    Wrong(["plan", "--set", "workpiece.path=p.csv"], "both must be in metres", {"p.csv": "185.7,-173.7,170.8\n"}),
]
WRONG = [
    *MISSPELT,
    *NOT_A_NUMBER,
    *NO_MAPPING,
    *RANGES,
    *YAML,
    *COMMANDS,
    *SWEEPS,
    *CLOUDS,
    *PATHS,
    *ARMS,
    *TASKS,
    *FOLDERS,
    *JOBS,
]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def lay_out(folder: Path, files: dict[str, str | bytes]) -> None:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data if isinstance(data, bytes) else data.encode())


def contents(folder: Path) -> dict[Path, bytes | None]:
    return {file: file.read_bytes() if file.is_file() else None for file in folder.rglob("*")}


def named(wrong: Wrong) -> str:
    """Name of a failing test."""
    return " ".join([*wrong.words, *map(repr, wrong.files.values())]).replace("\0", "NUL")[:60]


@pytest.mark.parametrize("wrong", WRONG, ids=named)
def test_a_wrong_input_is_one_line_that_names_the_offender_exit_2_and_no_file(here, capsys, wrong):
    if wrong.words[0] == "render" and "--" not in " ".join(wrong.words):
        can_draw()
    lay_out(here, FILES | wrong.files)
    before = contents(here)
    code = main(wrong.words)
    output = capsys.readouterr()
    assert output.err.count("\n") == 1 and output.err.startswith("htcp: ") and wrong.says in output.err
    assert wrong.name in output.err
    assert (code, output.out) == (2, "") and contents(here) == before


@pytest.mark.parametrize("platform", ["cuda", "nonsense"])
def test_a_platform_that_the_machine_lacks_is_one_line_and_exit_2(here, platform):
    done = command("plan", subprocess.DEVNULL, JAX_PLATFORMS=platform)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and not list(here.iterdir())
    assert f"JAX_PLATFORMS={platform}: JAX finds no such device on this machine; valid: cpu" in done.stderr


def test_there_are_300_different_ones():
    assert len({(tuple(wrong.words), *wrong.files.items()) for wrong in WRONG}) == len(WRONG) >= 300


def can_draw() -> None:
    try:
        offscreen.platform()
    except InputError as lacks:
        pytest.skip(str(lacks))


# System errors on the command's own output


def command(words: str, out: int, **environs: str) -> subprocess.CompletedProcess:
    code = "from htcp_jax.cli.main import main; raise SystemExit(main())"
    known = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])} | environs
    line = [sys.executable, "-c", code, *shlex.split(words)]
    return subprocess.run(line, stdout=out, stderr=subprocess.PIPE, text=True, env=known)


FULL = Path("/dev/full")


@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
@pytest.mark.parametrize(("words", "unbuffered"), [("methods", ""), ("methods", "1"), ("plan --help", "")])
def test_output_without_room_is_one_line_and_exit_2(here, words, unbuffered):
    """Output to a full device: one line and exit code 2 (regression).

    Not 1, which is the result of a failed validate or gate.
    """
    with FULL.open("wb") as full:
        done = command(words, full, PYTHONUNBUFFERED=unbuffered)
    assert (done.returncode, done.stderr) == (2, "htcp: cannot write the output: No space left on device\n")


@pytest.mark.slow
@pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full")
def test_every_command_whose_output_has_no_room_says_so_and_has_done_its_work(here, planned):
    lay_out(here, FILES | GRID)
    run, short = here / "planned", "--set workpiece.path=path.csv"
    shutil.copytree(planned / "run", run)  # without other tests' validation
    (run / VALIDATION).unlink(missing_ok=True)
    words = [
        f"plan {short}",
        f"plan {short} --json",
        f"sweep grid.yaml --methods baseline {short}",
        f"reachability grid.yaml {short} --out reachability",
        f"report {run}",
        f"report {run} --json",
        f"validate {run} --between 0",
        f"gate {run} --update --baseline new.yaml",
        f"gate {run} --baseline new.yaml",
        "render out/plan --movie none",
        "doctor",
        "doctor --json",
    ]
    with FULL.open("wb") as full:
        for line in words:
            done = command(line, full)
            assert (done.returncode, done.stderr.count("\n")) == (2, 1), line
            assert done.stderr.startswith("htcp: cannot write the output: No space left on device"), line
    assert {file.name for file in (here / "out").iterdir()} == {"plan", "grid", "report", "render"}


def test_a_pipe_that_nobody_reads_any_more_is_quiet(here):
    read, write = os.pipe()
    os.close(read)
    done = command("methods", write)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that nobody can make one in")
def test_without_a_home_folder_nothing_is_said(here):
    """No home folder: no output (regression: matplotlib wrote two lines to stderr)."""
    nowhere = {"HOME": "/proc/none", "XDG_CONFIG_HOME": "", "XDG_CACHE_HOME": "", "MPLCONFIGDIR": ""}
    done = command("methods", subprocess.DEVNULL, **nowhere)
    assert (done.returncode, done.stderr) == (0, "")
