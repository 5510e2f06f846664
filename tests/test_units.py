"""Parts and paths in units other than metres: refused or warned of before planning."""

import dataclasses
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
import trimesh

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.parts import load_geometry, units
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece, read_source
from htcp_jax.io.robots.loading import gp50
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import drawn_of, obstacles_of, robot_of, scene, workpiece_of
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import max_reach, tcp_position
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.runs.identity import config_hash, identity

UNITS = {"millimetres": 1e3, "inches": 1 / 0.0254, "centimetres": 1e2, "kilometres": 1e-3}
SEAM = np.linspace((0.02, 0.01, 0.015), (0.38, 0.015, 0.01), 41)


def box(part=1.0, path=1.0, at=(0.0, 0.0, 0.0)) -> Workpiece:
    """An open box of 0.40 x 0.36 x 0.36 m with a seam in a corner, each scaled by a factor."""
    u, v = np.meshgrid(np.linspace(0, 0.36, 20), np.linspace(0, 0.40, 20))
    u, v, o = u.ravel(), v.ravel(), np.zeros(u.size)
    sides = [(v, u, o), (v, u, o + 0.36), (v, o, u), (v, o + 0.36, u), (o + 0.4, 0.9 * u, 0.9 * v)]
    cloud = np.concatenate([np.stack(side, axis=-1) for side in sides])
    return Workpiece("box", part * (cloud + at), path * (SEAM + at))


def check(part: Workpiece) -> None:
    units.check_extent(gp50(), part.cloud, part.path, part.name)
    units.check_path_unit(part.cloud, part.path, part.name)


def refusal(part: Workpiece) -> str:
    with pytest.raises(InputError) as caught:
        check(part)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (1.0, -0.3, 0.5)])
@pytest.mark.parametrize("unit, factor", [("millimetres", "0.001"), ("inches", "0.0254")])
def test_a_part_far_larger_than_the_arm_is_refused_with_its_unit(unit, factor, at):
    """Part far larger than the arm: refused with its probable unit (regression).

    For a part in centimetres the size alone may also mean inches.
    """
    said = refusal(box(UNITS[unit], UNITS[unit], at))
    assert f"box extends over {0.4 * UNITS[unit]:.3g} m, gp50 reaches 3.07 m; it and its path seem" in said
    assert said.endswith(f"in {unit}; convert to metres (factor {factor})")


@pytest.mark.parametrize("unit", ["millimetres", "inches", "centimetres"])
def test_a_path_in_metres_is_not_called_wrong_with_its_part(unit):
    """Path in metres with a part in another unit: only the part is named."""
    assert f"; it seems to be in {unit}" in refusal(box(UNITS[unit], 1.0))


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (1.0, -0.3, 0.5)])
@pytest.mark.parametrize("unit, factor", [("millimetres", "0.001"), ("inches", "0.0254"), ("centimetres", "0.01")])
def test_a_path_that_stays_far_from_its_part_is_refused_with_its_unit(unit, factor, at):
    """Path far from its part: refused with its probable unit."""
    said = refusal(box(1.0, UNITS[unit], at))
    assert said.startswith("half of the path is ")
    key = {"millimetres": "mm", "inches": "in", "centimetres": "cm"}[unit]
    hint = f"convert it to metres (factor {factor}), or set workpiece.path_unit: {key}"
    assert said.endswith(f"; the path seems to be in {unit}; {hint}")


def test_a_path_in_another_frame_is_refused_without_a_guess():
    """Path in another frame: refused without a guess."""
    part = box()
    said = refusal(Workpiece("box", part.cloud, part.path + np.array([7.0, 7.0, 7.0])))
    assert said.endswith("from box; both must be in metres and in the same frame")


def test_a_part_far_smaller_than_the_thinnest_body_is_refused():
    """Part far smaller than the thinnest body: refused."""
    said = refusal(box(1e-3, 1e-3))
    assert "box extends over 0.0004 m, the thinnest body of gp50 over 0.06 m" in said
    assert "in kilometres; convert to metres (factor 1000)" in said


@pytest.mark.parametrize("scale, words", [(0.1, "the thinnest body"), (20.0, "gp50 reaches")])
def test_a_size_that_is_possible_but_odd_is_warned_of(scale, words):
    """Part of an unusual, but possible size: a warning."""
    with pytest.warns(UserWarning, match=f"box extends over .*{words}"):
        check(box(scale, scale))


@pytest.mark.parametrize("part", [
    load_workpiece(GeneratedDuct(points=1000)), box(), box(0.3, 0.3), box(10.0, 10.0), box(at=(1.0, 2.0, -3.0)),
    Workpiece("box", box().cloud, SEAM + np.array([0.0, -0.3, 0.0])),  # a stand-off, as for a spray gun
])  # fmt: skip
def test_ordinary_parts_pass_in_silence(part):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(part)


def test_the_command_refuses_a_part_in_millimetres(tmp_path, capsys, monkeypatch):
    """Part in millimetres on the command line: refused (regression: exit code 0)."""
    monkeypatch.chdir(tmp_path)
    np.savetxt("box.xyz", box(1e3).cloud)
    np.savetxt("seam.csv", SEAM, delimiter=",")
    files = ["--set", "workpiece.cloud=box.xyz", "--set", "workpiece.path=seam.csv"]
    assert main(["plan", *files, "--out", "out"]) == 2
    assert capsys.readouterr().err == (
        "htcp: box extends over 400 m, gp50 reaches 3.07 m; it seems to be in millimetres; set workpiece.unit: mm\n"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("ending", [".stl", ".ply"])
def test_a_mesh_in_millimetres_is_named_before_points_are_laid_on_it(tmp_path, ending):
    """Mesh in millimetres: refused before it is sampled.

    At the spacing that the arm's bodies need it would take millions of points.
    """
    part = trimesh.creation.box(extents=(400.0, 360.0, 360.0))
    (tmp_path / f"box{ending}").write_bytes(part.export(file_type=ending[1:]))
    np.savetxt(tmp_path / "seam.csv", 1e3 * SEAM, delimiter=",")
    with pytest.raises(InputError, match=r"box extends over 400 m.*it and its path seem to be in millimetres"):
        load_workpiece(tmp_path / f"box{ending}", tmp_path / "seam.csv", robot=gp50())


BOX = trimesh.creation.box(extents=(400.0, 360.0, 360.0))  # [mm]


def write_box(folder, ending):
    """Write the box in millimetres, as a mesh or a cloud, and the seam in metres."""
    if ending in (".stl", ".ply", ".obj"):
        data = BOX.export(file_type=ending[1:])
        (folder / f"box{ending}").write_bytes(data if isinstance(data, bytes) else f"{data}\n".encode())
    elif ending == ".npy":
        np.save(folder / "box.npy", 1e3 * box().cloud)
    else:
        np.savetxt(folder / f"box{ending}", 1e3 * box().cloud)
    np.savetxt(folder / "seam.csv", SEAM, delimiter=",")
    return folder / f"box{ending}"


@pytest.mark.parametrize("ending", [".stl", ".ply", ".obj", ".npy", ".xyz"])
def test_a_part_in_millimetres_with_its_unit_is_the_part_in_metres(tmp_path, ending):
    file = write_box(tmp_path, ending)
    plain, scaled = load_geometry(file), load_geometry(file, "mm")
    for numbers, metres in zip(plain, scaled, strict=True):
        np.testing.assert_array_equal(numbers / 1000.0, metres)
    part = load_workpiece(file, tmp_path / "seam.csv", unit="mm", robot=gp50())
    assert np.ptp(part.cloud, axis=0).max() == pytest.approx(0.4, abs=1e-3)
    assert read_source(file, unit="in").points == pytest.approx(0.0254 * read_source(file).points)


def test_the_refusal_of_a_size_names_the_key_of_the_unit(tmp_path):
    file = write_box(tmp_path, ".stl")
    with pytest.raises(InputError, match=r"it seems to be in millimetres; set workpiece\.unit: mm$"):
        load_workpiece(file, tmp_path / "seam.csv", robot=gp50())
    BOX.copy().apply_scale(1e-3).export(file)
    with pytest.raises(
        InputError, match=r"box extends over 0\.0004 m.* seems to be in metres; set workpiece\.unit: m$"
    ):
        load_workpiece(file, tmp_path / "seam.csv", unit="mm", robot=gp50())


def test_a_job_has_a_unit_for_its_part_and_for_each_cloud_of_its_cell(tmp_path):
    file = write_box(tmp_path, ".stl")
    part = {"cloud": str(file), "unit": "mm", "path": str(tmp_path / "seam.csv"), "interior": "none"}
    clouds = [{"cloud": str(file), "base_m": [0.0, 5.0, 0.0], "unit": "cm"}]
    job = load_config(None, {"workpiece": part, "cell": {"clouds": clouds}, "start_rad": "auto"})
    robot = robot_of(job.robot, job.cell)
    workpiece = workpiece_of(job.workpiece, robot)
    drawn = drawn_of(job.cell, robot).triangles
    assert np.ptp(workpiece.cloud, axis=0) == pytest.approx([0.4, 0.36, 0.36], abs=1e-3)
    assert np.ptp(drawn, axis=(0, 1)) == pytest.approx([4.0, 3.6, 3.6])


@pytest.mark.parametrize("changes, words", [
    ({"workpiece.unit": "mm"}, "workpiece.unit is 'mm', but workpiece.cloud is duct, not a file; omit the key"),
    ({"workpiece.unit": "furlong"}, "workpiece.unit is 'furlong': input should be 'm', 'mm', 'cm' or 'in'"),
])  # fmt: skip
def test_a_unit_that_does_not_apply_is_refused(changes, words):
    with pytest.raises(InputError, match=re.escape(words)):
        scene(load_config(None, changes))


def test_a_unit_next_to_one_in_the_file_is_refused(tmp_path):
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    with pytest.raises(InputError, match=r"the unit is mm, but a .step file states its own unit; omit the key"):
        load_geometry(tmp_path / "part.step", "mm")
    file = tmp_path / "part.csv"
    np.savetxt(file, 100 * box().cloud, delimiter=",", header="x_cm,y_cm,z_cm", comments="")
    with pytest.raises(InputError, match="the unit is mm, but cm in the header; omit the key"):
        load_geometry(file, "mm")
    with pytest.raises(InputError, match="the unit is 'ft'; valid: m, mm, cm, in"):
        load_geometry(file, "ft")
    np.testing.assert_array_equal(load_geometry(file, "cm").points, load_geometry(file).points)


def test_a_cloud_of_the_cell_that_is_larger_than_a_workshop_is_named(tmp_path):
    file = write_box(tmp_path, ".xyz")
    cell = load_config(None, {"cell": {"clouds": [{"cloud": str(file)}]}}).cell
    with pytest.warns(
        UserWarning, match="box extends over 400 m, gp50 reaches 3.07 m; check its unit: cell.clouds has"
    ):
        obstacles_of(cell, gp50())


def test_a_job_without_units_keeps_its_identity():
    config = load_config(None, {"cell": {"clouds": [{"cloud": "a.xyz"}]}}).model_dump(mode="json")
    assert "unit" not in config["cell"]["clouds"][0]
    before = {**config, "workpiece": {key: value for key, value in config["workpiece"].items() if key != "unit"}}
    assert config_hash(identity(config, [], "float64", {})) == config_hash(identity(before, [], "float64", {}))


def test_a_sweep_refuses_a_part_in_inches(tmp_path):
    """Sweep of a part in inches: refused, whereas poses out of reach are results of a sweep."""
    np.savetxt(tmp_path / "box.xyz", box(UNITS["inches"]).cloud)
    np.savetxt(tmp_path / "seam.csv", UNITS["inches"] * SEAM, delimiter=",")
    (tmp_path / "job.yaml").write_text("workpiece: {cloud: box.xyz, path: seam.csv}\n")
    (tmp_path / "grid.yaml").write_text("config: job.yaml\ngrid:\n  - workpiece.rotation_y_rad: [0.0, 0.1]\n")
    keys = "set workpiece.unit: in and workpiece.path_unit: in"
    with pytest.raises(InputError, match=f"it and its path seem to be in inches; {keys}"):
        load_sweep(tmp_path / "grid.yaml").batch()


def sliding():
    """The GP50 with a first joint that slides along a rail of 4 m."""
    arm = gp50()
    return dataclasses.replace(
        arm, slides=(True, *arm.slides[1:]), lower=arm.lower.at[0].set(-1.0), upper=arm.upper.at[0].set(3.0)
    )


@pytest.mark.parametrize("robot", [gp50(), gp50("datasheet"), sliding()])
def test_no_configuration_reaches_beyond_the_reach(robot):
    x = np.random.default_rng(0).uniform(robot.lower, robot.upper, (2000, 6))
    tcp = jax.vmap(tcp_position, in_axes=(None, 0))(robot, jnp.asarray(x))
    far = np.linalg.norm(np.asarray(tcp) - np.asarray(robot.T_parent_joint)[0, :3, 3], axis=1)
    assert 0.8 * max_reach(robot) < far.max() <= max_reach(robot)


def test_a_rail_adds_its_travel_to_the_reach_of_the_targets():
    arm, part = sliding(), box(at=(40.0, 0.0, 0.0))
    assert max_reach(arm) == pytest.approx(max_reach(gp50()) + 3.0)
    with pytest.raises(InputError, match=f"but .* reaches at most {max_reach(arm):.3f} m"):
        make_scenario(arm, part, np.zeros(6))
    endless = dataclasses.replace(arm, upper=arm.upper.at[0].set(np.inf))
    assert make_scenario(endless, part, np.zeros(6)).count == 52


@pytest.mark.parametrize(
    "change, reported",
    [
        ({"robot.tool_extension_m": 60}, "m, but the TCP is 60.6 m from"),
        ({"robot.tool": {"tip_m": [0, 30, 270], "bodies": []}}, "but the TCP is 2"),
        ({"robot.base_rpy_rad": [0, 0, 90]}, "robot.base_rpy_rad.2 is 90"),
        ({"robot.base_m": [0.1, 0.2]}, "robot.base_m is [0.1, 0.2]: at least 3 values are needed"),
    ],
)
def test_a_tool_in_millimetres_and_a_base_in_degrees_are_refused(change, reported):
    """Tool in millimetres, base in degrees: refused (regression: planned with a TCP 270 m from the flange)."""
    with pytest.raises(InputError, match=re.escape(reported)):
        scene(load_config(None, change))


def test_a_tool_that_is_nearly_as_long_as_the_arm_is_accepted_and_a_longer_one_is_warned_of():
    """A torch of 0.8 m on an arm of 0.8 m (regression: refused, as if its length were not in metres)."""
    links = max_reach(toy.robot()) - 0.2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        units.check_tool(toy.robot(), 1.2 * links)
    with pytest.warns(UserWarning, match=r"the TCP is .* m from the last joint; check that lengths are in metres"):
        units.check_tool(toy.robot(), 3 * links)
