"""Seams of the generated duct: beads on its wall, available by name in any job and any sweep."""

from pathlib import Path

import numpy as np
import pytest
from made_once import section_value
from scipy.spatial import cKDTree

from htcp_jax.errors import InputError
from htcp_jax.io.parts.duct_seams import BEADS, seam
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece
from htcp_jax.io.robots.loading import gp50
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import workpiece_of
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.jobs.grid_axes import from_record, group_record
from htcp_jax.model import duct
from htcp_jax.runs.input_files import anchor_files
from htcp_jax.spec import SEAMS
from htcp_jax.spec.config import WorkpieceConfig

ROOT = Path(__file__).parents[1]
ALONG, AROUND = ("left", "right", "crown", "invert", "helix"), ("girth-shallow", "girth-deep")

beads = pytest.mark.parametrize("name", BEADS)


@beads
def test_a_bead_lies_on_the_wall(name):
    assert np.abs(section_value(seam(name))).max() < 1e-12
    near = cKDTree(duct.duct_cloud()).query(seam(name))[0]
    assert np.median(near) < 2.5e-3 and near.max() < 10e-3  # the same as the spacing of the cloud itself


@beads
def test_a_bead_has_some_hundred_points_equally_spaced(name):
    points = seam(name)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert 60 <= len(points) <= 120 and len(points) == BEADS[name].points
    assert 3e-3 < step.min() and step.max() < 12e-3
    assert step.min() > 0.97 * step.max()  # chords: shorter than the arc where the wall is bent


@beads
def test_no_point_of_a_bead_comes_twice(name):
    points = seam(name)
    step = np.linalg.norm(points[1] - points[0])
    assert not cKDTree(points).query_pairs(0.9 * step)


def test_beads_along_the_duct_begin_at_the_inlet_and_never_turn_back():
    for name in ALONG:
        x = seam(name)[:, 0]
        np.testing.assert_allclose(x[[0, -1]], (0.2, 0.9), atol=1e-12)
        assert (np.diff(x) > 0).all(), name


def test_beads_along_a_side_keep_to_it():
    """Check the sides as seen from the inlet: z up, y to the left."""
    left, right, crown, invert = map(seam, ALONG[:4])
    np.testing.assert_allclose(right, left * (1, -1, 1), atol=1e-12)
    at = duct.section(left[:, 0])
    np.testing.assert_allclose(left[:, 1:], np.stack([at.a, at.zc], axis=-1), atol=1e-12)
    for line, height in ((crown, lambda at: at.zc + at.b_above), (invert, lambda at: at.zc - at.b_below)):
        np.testing.assert_allclose(line[:, 1], 0.0, atol=1e-12)
        np.testing.assert_allclose(line[:, 2], height(duct.section(line[:, 0])), atol=1e-12)


def test_a_girth_goes_once_around_clockwise_and_ends_a_step_before_it_began():
    for name, depth in zip(AROUND, (0.3, 0.8), strict=True):
        points = seam(name)
        np.testing.assert_allclose(points[:, 0], depth, atol=1e-12)
        at = duct.section(points[:1, 0])
        np.testing.assert_allclose(points[0, 1:], (at.a[0], at.zc[0]), atol=1e-12)
        angle = np.unwrap(np.arctan2(points[:, 2] - at.zc, points[:, 1]))
        assert (np.diff(angle) > 0).all() and angle[-1] < 2 * np.pi
        last, first = (np.linalg.norm(points[i] - points[j]) for i, j in ((-1, 0), (0, 1)))
        assert last == pytest.approx(first, rel=0.02)


def test_the_helix_meets_left_crown_right_invert_and_left_again():
    x, y, z = seam("helix").T
    at = duct.section(x)
    angle = np.unwrap(np.arctan2((z - at.zc) / np.where(z >= at.zc, at.b_above, at.b_below), y / at.a))
    np.testing.assert_allclose(angle, 2 * np.pi * (x - 0.2) / 0.7, atol=1e-9)


def test_a_job_names_its_seam_in_a_file_of_any_folder_and_on_the_command_line(tmp_path):
    (tmp_path / "job.yaml").write_text("workpiece: {path: crown}\n")
    for job in (load_config(tmp_path / "job.yaml"), load_config(None, ["workpiece.path=crown"])):
        assert np.array_equal(workpiece_of(job.workpiece, gp50()).path, seam("crown"))
        assert anchor_files(job.model_dump()) == []  # a seam is not a file that belongs to a run's identity


def test_the_weld_is_a_seam_like_the_others():
    assert SEAMS == ("weld", *BEADS)
    assert np.array_equal(seam("weld"), duct.weld())
    for name in SEAMS:
        assert np.array_equal(load_workpiece(GeneratedDuct(points=1000, seam=name)).path, seam(name))


def test_an_unknown_seam_gives_a_line_with_those_that_there_are():
    line = rf"^workpiece.path is ceiling; valid: a seam of the duct \({', '.join(SEAMS)}\), or a table of x,y,z \(.xyz"
    with pytest.raises(InputError, match=line):
        load_workpiece(GeneratedDuct(seam="ceiling"))


def test_a_seam_of_the_duct_is_none_of_another_cloud(tmp_path):
    np.savetxt(tmp_path / "part.xyz", duct.duct_cloud(1000))
    with pytest.raises(InputError, match=r"part.xyz: workpiece.path is missing"):
        workpiece_of(WorkpieceConfig(cloud=str(tmp_path / "part.xyz"), path="crown"), gp50())


def test_the_sweep_takes_every_bead_to_every_pose_of_the_workpiece_sweep():
    sweep = load_sweep(ROOT / "sweeps" / "seams.yaml")
    parts = [point.config.workpiece for point in sweep.points()]
    poses = [point.config.workpiece for point in load_sweep(ROOT / "sweeps" / "workpiece.yaml").points()]
    assert [part.path for part in parts] == [name for name in BEADS for _ in range(49)]
    assert [part.model_copy(update={"path": "weld"}) for part in parts] == poses * len(BEADS)
    assert {point.config.start_rad for point in sweep.points()} == {(0.0, -2.3, 0.5, 0.0, 0.5, -2.0)}
    assert from_record(group_record(sweep.groups[0], ()), sweep.robot.joint_names) == sweep.groups[0]


def test_scenarios_of_one_batch_have_their_own_seams():
    grid = {"grid": [{"workpiece.path": ["weld", "crown", "helix"]}]}
    batch = load_sweep(grid).batch()
    assert len(batch.cells) == 1 and batch.scenarios.count.tolist() == [105, 101, 121]
    T = batch.scenarios.T_world_workpiece[1]
    np.testing.assert_allclose(batch.scenarios.targets[1, 11:101], seam("crown") @ T[:3, :3].T + T[:3, 3], atol=1e-12)


def test_the_page_s_table_is_the_one_that_the_beads_are_made_from():
    rows = [line.split("|") for line in (ROOT / "docs" / "paths.md").read_text().splitlines()]
    reported = {row[1].strip(" `"): [cell.strip() for cell in row[2:5]] for row in rows if row[1:] and "`" in row[1]}
    for name, bead in BEADS.items():
        spans = [" to ".join(f"{v:g}" for v in dict.fromkeys(pair)) for pair in (bead.x_m, bead.angle_deg)]
        assert reported[name] == [*spans, str(bead.points)], name
