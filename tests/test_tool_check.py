"""`htcp tool JOB`: the tool alone at each target; compared with distances in NumPy and with a slot of known width."""

import json
import re
from operator import itemgetter
from pathlib import Path

import jax
import numpy as np
import pytest
import toy
import trimesh
from scipy.spatial.transform import Rotation

from htcp_jax.cli.main import main
from htcp_jax.jobs import load_sweep_or_job
from htcp_jax.reachability import tool_clearances
from htcp_jax.reachability.tool_clearance import TURNS_RAD

CONE_DEG, REACH_M = 0.5, 0.25  # half angle of the cone; length of the tool
UPWARDS = {"axis": "tcp.z", "towards": [0.0, 0.0, 1.0], "cone_deg": CONE_DEG}  # to the shelf
POINT = {"point": "tcp", "on": "path"}
LONGER_M = np.array([0.0, 0.01])


def one_job(folder, *rows):
    """Robot, part, scenario, settings and task of the toy's job with some rows."""
    job = toy.write_job(folder, 3, shift_m=(0.45, 0.02, 0.0), **({"task": list(rows)} if rows else {}))
    (folder / "arm.xml").write_text(
        toy.ARM.replace('<body pos="0 0 0.4"><joint name="j3"', '<body name="elbow" pos="0 0 0.4"><joint name="j3"')
    )
    batch = load_sweep_or_job(job).batch(None)
    (cell,) = batch.cells
    return cell.robot, cell.workpiece, jax.tree.map(itemgetter(0), batch.scenarios), cell.settings, cell.task


def brute_force(robot, part, scenario, axes, count=4000):
    """Largest clearance of the last link's capsules at each target over random orientations, for z of the TCP."""
    T = np.linalg.inv(np.asarray(robot.T_link_tcp))
    own = [k for k, link in enumerate(robot.capsule_link) if link == robot.tcp_link]
    p, q, radius = (np.asarray(each)[own] for each in (robot.capsule_p, robot.capsule_q, robot.capsule_radius))
    p, q = (each @ T[:3, :3].T + T[:3, 3] for each in (p, q))
    W = np.asarray(scenario.T_world_workpiece)
    cloud = part.cloud @ W[:3, :3].T + W[:3, 3]
    found = []
    for target in np.asarray(scenario.targets)[int(scenario.on_path) : int(scenario.count)]:
        turned = Rotation.random(count, rng=np.random.default_rng(5)) if axes is None else axes
        R = turned.as_matrix()
        a, b = (np.einsum("nij,kj->nki", R, each) + target for each in (p, q))
        share = np.einsum("nkpi,nki->nkp", cloud - a[:, :, None], b - a)
        share = np.clip(share / np.maximum(((b - a) ** 2).sum(-1), 1e-12)[..., None], 0, 1)[..., None]
        away = np.linalg.norm(cloud - a[:, :, None] - share * (b - a)[:, :, None], axis=-1)
        found.append((away.min(axis=-1) - radius).min(axis=1).max())
    return np.array(found)


def test_the_clearance_found_is_that_of_the_best_orientation(tmp_path):
    job = one_job(tmp_path)
    found = tool_clearances(*job, LONGER_M)
    assert (found.clearance_m[0] >= brute_force(*job[:3], None, 400) - 1e-3).all()
    assert (np.diff(found.clearance_m, axis=0) > -1e-3).all()
    assert found.target.tolist() == list(range(len(job[2].targets) - 3, len(job[2].targets)))


def test_within_a_narrow_cone_the_clearance_is_that_of_its_axis_and_a_longer_tip_adds_its_length(tmp_path):
    job = one_job(tmp_path, POINT, UPWARDS)
    found = tool_clearances(*job, LONGER_M)
    spins = Rotation.from_euler("z", np.linspace(0, 2 * np.pi, 90)[:, None])
    more = found.clearance_m[0] - brute_force(*job[:3], spins)
    assert (more > -2e-4).all() and (more < np.deg2rad(CONE_DEG) * REACH_M).all()
    np.testing.assert_allclose(np.diff(found.clearance_m, axis=0), LONGER_M[1], atol=2e-3)


def test_the_check_says_how_many_of_its_rounds_are_done(tmp_path):
    steps = []
    tool_clearances(*one_job(tmp_path), LONGER_M, lambda done, count: steps.append((done, count)))
    count = 1 + len(TURNS_RAD) * len(LONGER_M)
    assert steps == [(done, count) for done in range(count)]


def test_a_row_about_another_link_is_named_and_not_considered(tmp_path):
    other = {"axis": "elbow.z", "towards": [0.0, 0.0, 1.0], "cone_deg": 120}
    found = tool_clearances(*one_job(tmp_path, POINT, UPWARDS, other), LONGER_M)
    assert found.ignored == (3,)
    alone = tool_clearances(*one_job(tmp_path, POINT, UPWARDS), LONGER_M)
    np.testing.assert_array_equal(found.clearance_m, alone.clearance_m)


@pytest.fixture
def job(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    toy.write_job(tmp_path, 3, shift_m=(0.45, 0.02, 0.0), task=[POINT, UPWARDS])


def test_the_command_counts_the_targets_and_its_exit_code_is_3_if_one_is_not_clear(job, capsys):
    assert main(["tool", "job.yaml"]) == 0
    assert "clears the part at 3 of 3 targets" in capsys.readouterr().out
    assert main(["tool", "job.yaml", "--set", "margin_m=0.088"]) == 3
    printed = capsys.readouterr().out
    assert "clears the part at 0 of 3 targets" in printed and "required: 88 mm" in printed
    assert "10 mm more would clear the part at every target" in printed
    assert main(["tool", "job.yaml", "--set", "margin_m=0.088", "--json"]) == 3
    (seam,) = json.loads(capsys.readouterr().out)["seams"]
    assert [each["clear"] for each in seam["lengths"]] == sorted(each["clear"] for each in seam["lengths"])


def test_a_clearance_that_coarse_points_on_the_mesh_take_away_is_said_with_the_spacing_that_returns_it(job, capsys):
    """A plate 88 mm above the tool: at the default spacing more than 2 mm of these are subtracted."""
    plate = trimesh.creation.box(
        (0.5, 0.5, 0.01), trimesh.transformations.translation_matrix((0.61, 0, toy.SHELF_M + 0.005))
    )
    plate.export("plate.stl")
    words = ["tool", "job.yaml", "--set", "workpiece.cloud=plate.stl", "--set", "workpiece.unit=m"]
    assert main([*words, "--json"]) == 0
    (seam,) = json.loads(capsys.readouterr().out)["seams"]
    clearance = 1e-3 * min(seam["lengths"][0]["clearance_mm"])
    words += ["--set", f"margin_m={clearance + 1e-3:.4f}"]
    assert main(words) == 3
    said = capsys.readouterr().out
    assert "is subtracted from every clearance to the part" in said
    _, change = re.search(r"try first +--set (workpiece.mesh_spacing_m)=([0-9.]+)", said).groups()
    assert main([*words, "--set", f"workpiece.mesh_spacing_m={change}"]) == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["job.yaml", "--tip", "0,0,1"], "--tip applies to a mesh; job.yaml is a job"),
        (["torch.stl", "--set", "margin_m=0"], "--set applies to a job"),
        (["torch.stl", "--out", "torch.xml"], "--tip is missing"),
        (["torch.stl", "--tip", "0,0,1"], "--out is missing"),
        (["job.yaml", "--set", "workpiece.cloud=none"], "without a part"),
        (["grid.yaml"], "grid.yaml is a sweep; htcp tool checks one job"),
    ],
)
def test_what_does_not_apply_is_refused_in_one_line(job, words, said, capsys):
    Path("grid.yaml").write_text("config: job.yaml\ngrid:\n  - margin_m: [0.001, 0.002]\n")
    assert main(["tool", *words]) == 2
    assert said in capsys.readouterr().err.splitlines()[-1]
