"""`htcp tool`: a torch's mesh becomes a tool that a job mounts; compared with the mesh, and with a tool by hand."""

import json

import numpy as np
import pytest
import trimesh

from htcp_jax.cli.main import main
from htcp_jax.io.robots import load_robot
from htcp_jax.spec import tool as tools
from htcp_jax.spec.model_source import ComposedModel, PlacedModel

ARM = """<mujoco model="arm"><worldbody>
  <body name="a"><joint name="j1" axis="0 0 1" range="-2 2"/>
    <body name="b" pos="0 0 0.5"><joint name="j2" axis="0 1 0" range="-2 2"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0.3 0 0" size="0.05"/>
      <body name="c" pos="0.4 0 0"><joint name="j3" axis="0 1 0" range="-2 2"/>
        <site name="tool0" pos="0.15 0 0" euler="0 90 0"/>
      </body></body></body>
</worldbody></mujoco>"""
TIP_MM = "128,0,328"  # 21.2 mm beyond the nozzle


@pytest.fixture(scope="module")
def torch(tmp_path_factory):
    """Folder with a torch's mesh in millimetres: a handle along z, and a nozzle bent by 45 degrees."""
    folder = tmp_path_factory.mktemp("torch")
    handle = trimesh.creation.cylinder(radius=25, segment=[[0, 0, 0], [0, 0, 150]], sections=16)
    neck = trimesh.creation.cylinder(radius=10, segment=[[0, 0, 150], [0, 0, 200]], sections=16)
    nozzle = trimesh.creation.cylinder(radius=8, segment=[[0, 0, 200], [113, 0, 313]], sections=16)
    trimesh.util.concatenate([handle, neck, nozzle]).export(folder / "torch.stl")
    (folder / "arm.xml").write_text(ARM)
    return folder


def made(torch, name: str, *options: str) -> int:
    return main(["tool", str(torch / "torch.stl"), "--out", str(torch / name), "--replace", *options])


def mounted(torch, name: str):
    models = PlacedModel("robot", torch / "arm.xml", "world", tools.ZERO, tools.ZERO)
    own = PlacedModel("tool", torch / name, "robot.tool0", tools.ZERO, tools.ZERO)
    return load_robot(ComposedModel((models, own), None), tcp_site="tool.tcp")


def test_a_torch_in_millimetres_is_mounted_with_its_tip_and_encloses_its_mesh(torch, capsys):
    assert made(torch, "torch.xml", "--unit", "mm", "--tip", TIP_MM, "--direction", "1,0,1") == 0
    printed = capsys.readouterr().out
    assert "bare tip            21.2 mm" in printed
    assert "TCP (128.0, 0.0, 328.0) mm" in printed and (torch / "torch.png").exists()
    found = mounted(torch, "torch.xml")
    by_hand = tools.Tool((0.128, 0.0, 0.328), (0.0, np.pi / 4, 0.0))
    expected = load_robot(torch / "arm.xml", tcp_site="tool0", tool=by_hand)
    np.testing.assert_allclose(found.T_link_tcp, expected.T_link_tcp, atol=1e-12)
    T_link_flange = np.asarray(load_robot(torch / "arm.xml", tcp_site="tool0").T_link_tcp)
    mesh = 1e-3 * trimesh.load(torch / "torch.stl").sample(500, seed=0)
    points = mesh @ T_link_flange[:3, :3].T + T_link_flange[:3, 3]
    own = [k for k, name in enumerate(found.capsule_names) if name.startswith("tool.")]
    p, q, radius = (np.asarray(each)[own] for each in (found.capsule_p, found.capsule_q, found.capsule_radius))
    share = np.clip(((points[:, None] - p) * (q - p)).sum(-1) / ((q - p) ** 2).sum(-1), 0, 1)[..., None]
    assert (np.linalg.norm(points[:, None] - p - share * (q - p), axis=-1) - radius).min(axis=1).max() < 1e-9
    assert found.pieces is not None


@pytest.mark.parametrize(
    "options",
    [("--rpy", "0,45,0deg"), ("--rpy", "0,0.785398163397448,0"), ("--quaternion", "0.923879533,0,0.382683432,0")],
)
def test_direction_angles_and_quaternion_state_the_same_tcp(torch, options, capsys):
    assert made(torch, "one.xml", "--unit", "mm", "--tip", TIP_MM, "--direction", "1,0,1") == 0
    assert made(torch, "other.xml", "--unit", "mm", "--tip", "0.128,0,0.328m", *options) == 0
    one, other = (np.asarray(mounted(torch, name).T_link_tcp) for name in ("one.xml", "other.xml"))
    np.testing.assert_allclose(one, other, atol=1e-9)


def test_a_stickout_moves_the_tcp_out_of_the_nozzle_and_no_body(torch, capsys):
    assert made(torch, "short.xml", "--unit", "mm", "--tip", "113,0,313", "--direction", "1,0,1") == 0
    assert "bare tip            none: the TCP is in a piece of the tool" in capsys.readouterr().out
    options = "--unit", "mm", "--tip", "113,0,313", "--direction", "1,0,1", "--stickout", "12mm", "--json"
    assert made(torch, "long.xml", *options) == 0
    record = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(record["tcp_m"], np.array([113, 0, 313]) / 1e3 + 0.012 * np.array([0.5, 0, 0.5]) ** 0.5)
    assert record["bare_m"] == pytest.approx(0.012, abs=1e-4)
    short, long = mounted(torch, "short.xml"), mounted(torch, "long.xml")
    np.testing.assert_array_equal(short.capsule_p, long.capsule_p)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--tip", TIP_MM), "extends over 319 m, but a tool over 0.01 to 3 m; it seems to be in mm; pass --unit mm"),
        (("--unit", "mm", "--tip", "1,2"), "--tip 1,2: it must be 3 numbers with commas"),
        (("--unit", "mm", "--tip", "0.13,0,0.33m,"), "it must be 3 numbers with commas, such as 92,0,352"),
        (("--unit", "ft", "--tip", TIP_MM), "--unit ft: valid are m, mm, cm, in"),
        (("--unit", "mm", "--tip", "128,0,328m"), "both must be in the same frame and unit"),
        (("--unit", "mm", "--tip", TIP_MM, "--direction", "0,0,0"), "--direction 0,0,0: its length is 0"),
        (("--unit", "mm", "--tip", TIP_MM, "--direction", "0,0,1", "--rpy", "0,0,0"), "both state the orientation"),
    ],
)
def test_a_wrong_unit_or_tip_is_refused_in_one_line_and_nothing_is_written(torch, options, words, capsys):
    assert main(["tool", str(torch / "torch.stl"), "--out", str(torch / "wrong.xml"), *options]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not (torch / "wrong.xml").exists() and not (torch / "wrong.png").exists()


def test_a_file_that_exists_is_kept(torch, capsys):
    assert made(torch, "kept.xml", "--unit", "mm", "--tip", TIP_MM) == 0
    before = (torch / "kept.xml").read_bytes()
    assert main(["tool", str(torch / "torch.stl"), "--tip", "0,0,1m", "--out", str(torch / "kept.xml")]) == 2
    assert "pass --replace" in capsys.readouterr().err and (torch / "kept.xml").read_bytes() == before
