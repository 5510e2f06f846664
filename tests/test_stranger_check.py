"""The check of strangers' jobs notices contacts, misses and exclusions that are false."""

import csv

import numpy as np
import pytest
import yaml

from benchmarks import stranger_check, stranger_parts

ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="one"><joint name="j1" axis="0 0 1" range="-3 3"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
    <body name="two" pos=".3 0 0"><joint name="j2" axis="0 0 1" range="-3 3"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
      <body name="three" pos=".3 0 0"><joint name="j3" axis="0 0 1" range="-3 3"/>
        <geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/><site name="tip" pos=".112 0 0"/></body></body></body>
</worldbody></mujoco>"""
WALL = [{"box": {"low": [0.5, -0.1, -0.1], "high": [0.51, 0.1, 0.1]}}]
BESIDE, INSIDE = [0.45, 0.25, 0.0], [0.505, 0.0, 0.0]  # targets next to the wall and in its middle
ROWS = [[-0.6, 0.9, 0.0], [0.3, 0.9, 0.0]]  # both ends are clear; between them the arm passes the wall


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    entry = {"part": WALL, "seam": {"from": BESIDE, "to": INSIDE, "count": 2, "normal": [-1, 0, 0]}}
    job = stranger_parts.write(tmp_path, entry) | {"robot": {"model": "arm.xml"}, "workpiece": {}}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    return tmp_path


@pytest.fixture
def cell(folder):
    return stranger_check.Cell(folder, folder / "arm.xml", "tip")


@pytest.fixture
def chain(cell):
    return stranger_check.Chain(cell, ["j1", "j2", "j3"])


def attacked(cell, chain, target):
    starts = stranger_check.samples(cell, chain.names, 200, np.random.default_rng(0))
    return stranger_check.attacked(cell, chain, target, starts)


def test_an_exclusion_of_a_target_that_can_be_reached_is_refuted(cell, chain):
    found = attacked(cell, chain, 0)
    assert found["free"] > 0
    pose = cell.poses(dict(zip(chain.names, found["q"], strict=True)))["tcp"]
    assert np.linalg.norm(pose[:3, 3] - BESIDE) < 1e-6


def test_an_exclusion_of_a_target_inside_the_wall_is_not_refuted(cell, chain):
    found = attacked(cell, chain, 1)
    assert found["on_target"] > 100 and found["free"] == 0


def test_a_contact_between_two_rows_makes_a_motion_false(cell, chain, folder):
    (folder / "plan").mkdir()
    names = [f"{name}_rad" for name in chain.names]
    for file, extra in (("motion", {"kind": "TRANSFER"}), ("trajectory", {"status": "TRACKED", "clearance_m": 0.001})):
        with (folder / f"plan/{file}.csv").open("w") as out:
            table = csv.DictWriter(out, ["target", *extra, *names])
            table.writeheader()
            table.writerows([{"target": -1, **extra, **dict(zip(names, row, strict=True))} for row in ROWS])
    cell.seam = cell.seam[:0]
    found = stranger_check.checked_motion(cell, folder / "plan", chain)
    assert found["places"] == stranger_check.PLACES and found["hits"] and not found["is_true"]


def test_a_contact_in_a_configuration_that_is_called_clear_is_named(cell, folder):
    """In the second configuration the third link crosses the first."""
    (folder / "clear.csv").write_text("j1,j2,j3\n0,0.5,0\n0,2.9,1.8\n")
    found = stranger_check.checked_clear(cell, folder / "clear.csv")
    assert found == {"pairs": 1, "contacts": {"robot.one and robot.three": {"count": 1, "first": [0.0, 2.9, 1.8]}}}


def test_a_hole_is_nowhere_narrower_than_stated():
    plate = stranger_parts.plate([0, 0, 0], 0.1, 0.02, 0.003)
    middles = plate.triangles_center[:, 1:]
    assert plate.is_watertight and np.linalg.norm(middles, axis=1).min() >= 0.02 * np.cos(np.pi / 64) - 1e-9
