"""Malformed and malicious input: a few hundred inputs of `make fuzz`, and attacks that random changes do not find.

No file executes code, opens a file outside its folder, or takes a disproportionate amount of time or memory.
"""

import ctypes
import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fuzz import fuzz
from fuzz_targets import ARM, SMALL, TARGETS, URDF
from made_once import load_cloud

from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.jobs import load_config
from htcp_jax.spec.config import PlanConfig
from htcp_jax.validation.records import read_results

INPUTS = 40


@pytest.mark.parametrize("name", [name for name in TARGETS if name not in ("plan", "manifest", "row file")])
def test_no_input_brings_about_more_than_a_result_or_a_line(name, tmp_path):
    assert sum(fuzz(name, INPUTS, 0, tmp_path)) >= INPUTS


def test_no_results_bring_about_more_than_a_result_or_a_line(tmp_path):
    """Fuzz all readers of results in one folder, so that the run is planned once."""
    for name in ("manifest", "row file", "plan"):
        assert sum(fuzz(name, INPUTS // 2, 0, tmp_path)) >= INPUTS // 2


def refused(words: str, read, *arguments) -> None:
    with pytest.raises(InputError) as caught:
        read(*arguments)
    assert words in str(caught.value) and "\n" not in str(caught.value)


# YAML


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("margin_m: !!python/object/apply:os.system ['touch hacked']", "tag tag:yaml.org,2002:python/object/apply"),
        ("margin_m: !!python/name:os.system", "is not allowed; use a plain value"),
        ("a: &a [x,x]\nb: &b [*a,*a]\nc: [*b,*b]", "line 2: alias *a is not allowed; write its value out"),
        ("a: &a {x: 1}\nb: {<<: *a}", "alias *a"),
        ("start_rad: " + "[" * 10_000, "nested too deeply"),
        ("{" * 10_000, "nested too deeply"),
        ("margin_m: 1" + ":59" * 100_000, "margin_m is "),
        ("margin_m: " + "9" * 100_000, "margin_m is inf"),
        ("# " + "x" * 3_000_000, "bytes; at most 2,097,152 are allowed"),
    ],
)
def test_a_yaml_file_executes_nothing_and_does_not_grow(tmp_path, monkeypatch, text, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.yaml").write_text(text)
    refused(words, load_config, "job.yaml")
    assert os.listdir() == ["job.yaml"]


def test_numbers_and_words_are_those_of_yaml_1_2(tmp_path):
    (tmp_path / "job.yaml").write_text("margin_m: 1e-3\nworkpiece: {cloud: on, path: 1:30}")
    config = load_config(tmp_path / "job.yaml")
    assert config.margin_m == 1e-3
    assert [Path(name).name for name in (config.workpiece.cloud, config.workpiece.path)] == ["on", "1:30"]


# Robot models


class Watch:
    """Detector of opened files in a folder, by inotify, as MuJoCo opens files without Python."""

    OPENED = 0x20

    def __init__(self, folder: Path):
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._handle = self._libc.inotify_init1(os.O_NONBLOCK)
        assert self._libc.inotify_add_watch(self._handle, str(folder).encode(), self.OPENED) >= 0

    def opened(self) -> bool:
        try:
            return bool(os.read(self._handle, 4096))
        except BlockingIOError:
            return False


@pytest.fixture
def outside(tmp_path):
    """Watched folder next to the model's, with readable files."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "part.xml").write_text("<mujoco><worldbody><body name='stranger'/></worldbody></mujoco>")
    (folder / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
    (folder / "t.png").write_bytes(b"\x89PNG\r\n")
    watch = Watch(folder)
    assert not watch.opened() and (folder / "t.png").read_bytes() and watch.opened()
    return folder, watch


def model(tmp_path: Path, text: str, name: str = "arm.xml") -> Path:
    folder = tmp_path / "model"
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


WAYS_OUT = ["../outside/", "{outside}/", "link/", "./x/../../outside/", "file://{outside}/", "package://../outside/"]


@pytest.mark.parametrize("segment_status", WAYS_OUT)
def test_an_include_cannot_leave_the_models_folder(tmp_path, outside, segment_status):
    folder, watch = outside
    name = segment_status.format(outside=folder) + "part.xml"
    arm = model(tmp_path, SMALL.decode().replace("<worldbody>", f'<include file="{name}"/><worldbody>', 1))
    (arm.parent / "link").symlink_to(folder)
    refused(str(arm.parent), load_robot, arm)
    assert not watch.opened()


@pytest.mark.parametrize("segment_status", WAYS_OUT)
def test_no_file_that_a_model_names_is_opened(tmp_path, outside, segment_status):
    """Meshes, textures and height fields are ignored, even if the files exist."""
    folder, watch = outside
    at = segment_status.format(outside=folder)
    assets = f'<mesh name="m" file="{at}m.obj"/><texture name="t" type="2d" file="{at}t.png"/>'
    assets += f'<material name="x" texture="t"/><hfield name="h" file="{at}t.png" size="1 1 1 1"/>'
    shapes = '<geom type="hfield" hfield="h"/><geom type="sphere" size=".1" material="x"/><site name="tcp"'
    text = SMALL.decode().replace('<mesh name="m" file="../m.stl"/>', assets).replace('<site name="tcp"', shapes)
    arm = load_robot(model(tmp_path, text))
    assert len(arm.ignored_geoms) == 2 and len(arm.capsule_radius) == 4
    urdf = URDF.decode().replace("visual>", "collision>")
    arm = load_robot(model(tmp_path, urdf.replace("package://x/y.stl", f"{at}m.obj"), "arm.urdf"))
    assert len(arm.ignored_geoms) == 1
    assert not watch.opened()


def test_includes_within_the_folder_are_read_once_each(tmp_path):
    links, tool = SMALL.decode().split('<body name="c"')
    body, rest = tool.split("</body>", 1)
    arm = model(tmp_path, f'{links}<include file="parts/tool.xml"/>{rest}')
    (arm.parent / "parts").mkdir()
    (arm.parent / "parts" / "tool.xml").write_text(f'<mujocoinclude><body name="c"{body}</body></mujocoinclude>')
    whole = load_robot(model(tmp_path, SMALL.decode(), "whole.xml"))
    apart = load_robot(arm)
    assert apart.joint_names == whole.joint_names
    np.testing.assert_array_equal(apart.T_parent_joint, whole.T_parent_joint)
    twice = model(tmp_path, '<mujoco><include file="itself.xml"/></mujoco>', "itself.xml")
    refused("itself.xml is included twice", load_robot, twice)


def test_a_nested_include_is_searched_in_the_main_files_folder_and_then_next_to_the_including_file(tmp_path):
    links, rest = SMALL.decode().split("</worldbody>")
    arm = model(tmp_path, f'{links}<include file="parts/one.xml"/></worldbody>{rest}')
    part, site = "<mujocoinclude>{}</mujocoinclude>", '<site name="mark" pos="0 0 {}"/>'
    (arm.parent / "parts").mkdir()
    (arm.parent / "parts" / "one.xml").write_text(part.format('<include file="two.xml"/>'))
    for height, folder in ((1, "parts"), (2, ".")):
        (arm.parent / folder / "two.xml").write_text(part.format(site.format(height)))
        (mark,) = (each for each in load_robot(arm).base_frames if each.name == "mark")
        assert mark.origin_m[2] == height


@pytest.mark.parametrize("name", ["../../part.xml", "{outside}/part.xml"])
def test_a_nested_include_cannot_leave_the_main_files_folder(tmp_path, outside, name):
    folder, watch = outside
    arm = model(tmp_path, SMALL.decode().replace("<worldbody>", '<include file="parts/one.xml"/><worldbody>', 1))
    (arm.parent / "parts").mkdir()
    inner = f'<mujocoinclude><include file="{name.format(outside=folder)}"/></mujocoinclude>'
    (arm.parent / "parts" / "one.xml").write_text(inner)
    refused("it is outside the model's folder", load_robot, arm)
    assert not watch.opened()


LAUGHS = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))


@pytest.mark.parametrize("name", ["arm.xml", "arm.urdf"])
@pytest.mark.parametrize(
    "doctype",
    [
        f'<!DOCTYPE x [<!ENTITY l0 "ha">{LAUGHS}]>',
        '<!DOCTYPE x [<!ENTITY e SYSTEM "../outside/part.xml">]>',
        '<!DOCTYPE x SYSTEM "../outside/part.xml">',
    ],
)
def test_a_model_has_no_document_type_and_so_no_entities(tmp_path, outside, name, doctype):
    text = (SMALL if name == "arm.xml" else URDF).decode()
    text = doctype + text.replace('name="a"', 'name="&l9;&e;"', 1)
    refused("<!DOCTYPE", load_robot, model(tmp_path, text, name))
    assert not outside[1].opened()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<worldbody>", '<worldbody><replicate count="100000000"><geom size="1"/></replicate>', "<replicate> is not"),
        ("<worldbody>", '<worldbody><composite type="grid" count="9999 9999 1"/>', "<composite> is not supported"),
        ("<worldbody>", '<worldbody><attach model="m" body="b"/>', "<attach> is not supported"),
        (
            "<worldbody>",
            '<custom><numeric name="n" size="2000000000"/></custom><worldbody>',
            "must have a size of at most 1,000",
        ),
        ("<worldbody>", "<worldbody>" + "<body/>" * 50_000, "more than 50,000 elements"),
        ("<worldbody>", "<worldbody>" + "<body>" * 2_000 + "</body>" * 2_000, "nested more than 200 deep"),
        ("<worldbody>", f"<!--{'x' * 11_000_000}--><worldbody>", "bytes; at most 10,485,760 are allowed"),
        ("<worldbody>", '<extension><plugin plugin="../evil.so"/></extension><worldbdy>', "mismatched tag"),
    ],
)
def test_a_model_cannot_ask_for_more_than_it_is_worth(tmp_path, old, new, words):
    refused(words, load_robot, model(tmp_path, SMALL.decode().replace(old, new, 1)))


def test_plugins_are_left_out(tmp_path):
    text = ARM.decode().replace("<worldbody>", '<extension><plugin plugin="../evil.so"/></extension><worldbody>')
    assert load_robot(model(tmp_path, text)).joint_names == load_robot().joint_names


# Arrays


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was run",))


def plan_folder(tmp_path: Path, **arrays) -> Path:
    (tmp_path / "summary.json").write_text(
        json.dumps({"method": "baseline", "config": PlanConfig().model_dump(mode="json"), "files": {}})
    )
    names = {"status": (3,), "path_clear": (3,), "x": (3, 6), "tcp": (3, 3), "target": (3, 3), "clearance": (3,)}
    with zipfile.ZipFile(tmp_path / "trajectory.npz", "w", zipfile.ZIP_DEFLATED) as file:
        for name, shape in names.items():
            stream = io.BytesIO()
            np.save(stream, arrays.get(name, np.zeros(shape)), allow_pickle=True)
            file.writestr(f"{name}.npy", stream.getvalue())
    return tmp_path


def test_a_pickle_among_a_plans_arrays_is_never_run(tmp_path):
    folder = plan_folder(tmp_path, clearance=np.full(3, Bomb(), object))
    refused("it must be an array of numbers", read_results, folder)


def test_a_mesh_that_names_a_file_outside_does_not_open_it(tmp_path, outside):
    folder, watch = outside
    (tmp_path / "a.obj").write_text("mtllib ../outside/m.obj\n" + (folder / "m.obj").read_text())
    assert watch.opened()  # opened by this test
    load_cloud(tmp_path / "a.obj", spacing=1.0)
    assert not watch.opened()
