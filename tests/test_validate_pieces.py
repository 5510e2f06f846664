"""Validation by the convex pieces of meshes: where capsules touch and pieces do not, and where both do."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls
from small_cell import small_job
from stranger_jobs import ARM

import htcp_jax
from htcp_jax.errors import InputError
from htcp_jax.proving import prove
from htcp_jax.spec.config import CellConfig
from htcp_jax.status import SegmentStatus
from htcp_jax.validation import validate_results
from htcp_jax.validation.convex_hull import Hull
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_cell import MujocoCell
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall

HALF_M, THICK_M = 0.02, 0.001  # of the bar that is the piece in the forearm's capsule of 50 mm; its radius
BAR = np.array(list(product((0.02, 0.55), (-HALF_M, HALF_M), (-HALF_M, HALF_M))))
X = np.array([0.1, -1.2, 1.4, 0.3, 0.5, 0.2])
RNG = np.random.default_rng(0)


def arm_file(folder: Path, text: str | None = None, radius: str = str(THICK_M), size: str = "0.05") -> Path:
    """The arm with a bar in its forearm's capsule."""
    text = text or "; ".join(" ".join(map(str, row)) for row in BAR.tolist())
    custom = (
        f'<custom><text name="piece of fore" data="{text}"/><numeric name="radius of fore" data="{radius}"/></custom>'
    )
    file = folder / "arm.xml"
    sized = ARM.replace('"fore" type="capsule" size="0.05"', f'"fore" type="capsule" size="{size}"')
    file.write_text(sized.replace("<worldbody>", custom + "<worldbody>", 1))
    return file


def beside(arm: MujocoArm, x: np.ndarray, away_m: float) -> np.ndarray:
    """World point at a distance from the middle of the forearm's axis, over a face of the bar."""
    k, poses = arm.names.index("fore"), arm.arm_poses(x[None])
    return (poses.p[0, k] + poses.q[0, k]) / 2 + poses.axes[0, k] @ [away_m, 0, 0]


def measured(arm: MujocoArm, cell: CellConfig, below: float) -> float:
    own = MujocoCell(cell, arm, arm)
    poses = arm.arm_poses(X[None])
    return own.by_hulls(X[None], poses, own.distances(X[None], poses), np.array([below])).min()


def with_sphere(folder: Path, at: np.ndarray, radius: float) -> CellConfig:
    text = f'<geom name="ball" type="sphere" size="{radius}" pos="{" ".join(map(str, at.tolist()))}"/>'
    (folder / "cell.xml").write_text(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    return CellConfig(model=str(folder / "cell.xml"), self_collision=False)


def test_a_ball_in_the_capsule_is_as_far_away_as_the_piece(tmp_path):
    arm = MujocoArm(arm_file(tmp_path))
    cell = with_sphere(tmp_path, beside(arm, X, 0.04), 0.005)
    assert measured(arm, cell, -np.inf) == pytest.approx(0.04 - 0.005 - 0.05)
    assert measured(arm, cell, 0.0) == pytest.approx(0.04 - 0.005 - HALF_M - THICK_M, abs=1e-6)
    cell = with_sphere(tmp_path, beside(arm, X, 0.022), 0.005)
    assert measured(arm, cell, 0.0) == pytest.approx(0.022 - 0.005 - HALF_M - THICK_M, abs=1e-6)


@pytest.mark.parametrize("is_mesh", [False, True])
def test_a_wall_is_as_far_away_as_the_piece(tmp_path, is_mesh):
    arm = MujocoArm(arm_file(tmp_path))
    near = beside(arm, X, 0.04)
    corners = near + 0.01 * np.vstack([np.zeros(3), np.eye(3)[:2]]) * np.sign(near - beside(arm, X, 0.0))
    far = near + RNG.uniform(5, 6, (50, 3))
    wall = Wall(np.vstack([corners, far]), "none", None, corners[None] if is_mesh else None)
    scene = CheckedScene(arm, wall, np.eye(3), np.zeros(3), 0.0)
    k, poses = arm.names.index("fore"), arm.arm_poses(X[None])
    middle = (poses.p[0, k] + poses.q[0, k]) / 2
    seen = (corners - middle) @ poses.axes[0, k]
    hull = arm.hulls[k]
    assert hull is not None
    apart = hull.clearance(seen[None] if is_mesh else seen[:, None])
    assert scene.at(X[None]).clearance[0] < -0.009
    known = scene.at(np.stack([X, X]), 0.1)
    assert known.clearance == pytest.approx(min(apart, 0.1))
    assert scene.between(X[None], np.array([0]), known, 0.05)[1] == pytest.approx(apart)


def test_between_targets_a_piece_is_measured_where_the_plan_recorded_more_than_its_capsule_has(tmp_path):
    """Regression: a plan was refuted where a capsule is as near as at the nearest target, and its piece is far away."""
    arm = MujocoArm(arm_file(tmp_path))
    point = beside(arm, X, 0.08)[None]
    scene = CheckedScene(arm, Wall(point, "none"), np.eye(3), np.zeros(3), 0.0)
    known = scene.at(np.stack([X, X]))
    capsule, piece = 0.08 - 0.05, 0.08 - HALF_M - THICK_M
    assert known.clearance == pytest.approx(capsule)
    below = float(known.clearance.min())
    between = lambda recorded: scene.between(X[None], np.array([0]), known, below, recorded)[1]  # noqa: E731
    assert between(capsule - 1e-3) == pytest.approx(capsule) and between(piece - 1e-3) == np.inf


@pytest.mark.parametrize("curved", [False, True])
def test_a_clearance_far_above_the_job_s_margin_is_proven_by_pieces_and_refuted_where_they_lack_it(tmp_path, curved):
    """Regression: pieces were measured up to 5 mm above the job's margin, so that more was refuted."""
    arm = MujocoArm(arm_file(tmp_path))
    with_sphere(tmp_path, beside(arm, X, 0.08), 0.005)
    cell = {"model": f"{tmp_path}/cell.xml", "self_collision": False}
    job = {"robot": {"model": f"{tmp_path}/arm.xml"}, "workpiece": {"cloud": "none"}, "cell": cell}
    capsule, piece = 0.08 - 0.005 - 0.05, 0.08 - 0.005 - HALF_M - THICK_M
    x, lag = np.stack([X, X + 1e-3]), 1e-6 if curved else 0.0
    proof = prove(job, x, margin_m=(capsule + piece) / 2, tracking_rad=lag)
    assert proof.proven and (capsule + piece) / 2 <= proof.guaranteed_m <= piece
    refuted = prove(job, x, margin_m=piece + 0.005, tracking_rad=lag)
    assert refuted.verdict.tolist() == [SegmentStatus.BELOW_MARGIN]


def test_a_piece_s_distance_from_a_mesh_less_the_cover_is_what_a_plan_saves(tmp_path):
    """Regression: pieces were measured up to the saved clearance only, and the cover subtracted from that once more."""
    arm = MujocoArm(arm_file(tmp_path))
    corners = beside(arm, X, 0.04) + 0.01 * np.vstack([np.zeros(3), np.eye(3)[:2]])
    scene = CheckedScene(arm, Wall(corners, "none", None, corners[None]), np.eye(3), np.zeros(3), 0.0)
    exact = scene.at(X[None], 1.0).to_wall[0]
    assert scene.at(X[None]).to_wall[0] < exact
    cover, saved = 0.6 * exact, 0.4 * exact
    assert scene.at(X[None], saved, cover).less_cover(cover) == pytest.approx(saved)


@pytest.mark.parametrize("corners", [1, 3])
def test_a_hull_is_as_far_away_as_its_nearest_point(corners):
    for _ in range(20):
        points = RNG.normal(size=(30, 3))
        wall = RNG.normal(size=(40, 1, 3)) * 2 + 0.5 * RNG.normal(size=(40, corners, 3))
        wall = wall[[_apart(points, each) > 1e-6 for each in wall]]
        assert Hull(points, 0.1).clearance(wall) == pytest.approx(min(_apart(points, each) for each in wall) - 0.1)
    assert Hull(np.array(list(product((-1.0, 1.0), repeat=3)))).clearance(
        np.array([[[0.0, 0.0, 0.7]]])
    ) == pytest.approx(-0.3)


def test_a_hull_measures_no_part_of_a_wall_that_its_planes_separate_by_more_than_is_asked_for(monkeypatch):
    cube = Hull(np.array(list(product((-1.0, 1.0), repeat=3))), 0.1)
    wall = np.array([[[1.5, 0.0, 0.0]], [[3.0, 0.0, 0.0]]])
    assert cube.clearance(wall, 0.4) == pytest.approx(cube.clearance(wall)) == pytest.approx(0.4)
    monkeypatch.setattr(Hull, "_distance", lambda *_: pytest.fail("measured"))
    assert cube.clearance(wall, 0.3) > 0.3


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two convex hulls, by the weights of their corners."""
    sums = np.zeros((2, len(a) + len(b)))
    sums[0, : len(a)], sums[1, len(a) :] = 1e4, 1e4
    weight, _ = nnls(np.vstack([np.concatenate([a, -b]).T, sums]), np.array([0, 0, 0, 1e4, 1e4]))
    own, other = weight[: len(a)], weight[len(a) :]
    return float(np.linalg.norm(own @ a / own.sum() - other @ b / other.sum()))


def test_a_capsule_that_does_not_hold_its_piece_decides_alone_and_so_does_a_longer_tool(tmp_path):
    assert any(MujocoArm(arm_file(tmp_path)).hulls)
    assert not any(MujocoArm(arm_file(tmp_path), pieces=False).hulls)
    assert not any(MujocoArm(arm_file(tmp_path, size="0.027")).hulls)
    moved = arm_file(tmp_path)
    moved.write_text(moved.read_text().replace("of fore", "of spindle").replace("0.55", "0.02"))
    assert not any(MujocoArm(moved, 0.05).hulls)


@pytest.mark.parametrize(("text", "radius"), [("0 0", "0"), ("0 0 a", "0"), ("0 0 0", "-1")])
def test_a_piece_that_cannot_be_read_is_bad_input(tmp_path, text, radius):
    with pytest.raises(InputError, match="'piece of fore' needs rows of 3 numbers and a 'radius of fore'"):
        MujocoArm(arm_file(tmp_path, text, radius))


def test_a_flat_piece_is_measured(tmp_path):
    text = f"0 {HALF_M} 0; 0.5 {HALF_M} 0; 0.5 -{HALF_M} 0; 0 -{HALF_M} 0"
    arm = MujocoArm(arm_file(tmp_path, text))
    cell = with_sphere(tmp_path, beside(arm, X, 0.03), 0.005)
    assert measured(arm, cell, 0.0) == pytest.approx(0.025 - THICK_M, abs=1e-5)


def test_a_plan_past_a_ball_in_a_capsule_is_validated_until_the_ball_is_in_the_piece(tmp_path):
    """End to end: contact is found with capsules alone, and where the piece really collides."""
    job = small_job(arm_file(tmp_path), tmp_path, out=(0, 1, 0))
    arm, start = MujocoArm(Path(job["robot"]["model"])), np.array(job["start_rad"])
    with_sphere(tmp_path, beside(arm, start, 0.045), 0.005)
    found = htcp_jax.plan(
        job | {"cell": {"model": str(tmp_path / "cell.xml"), "self_collision": False}, "method": "baseline"}
    )
    found.save(tmp_path / "plan")
    assert validate_results(tmp_path / "plan").validated
    summary = tmp_path / "plan" / "summary.json"
    saved = json.loads(summary.read_text())
    saved["config"]["cell"]["shift_m"] = (beside(arm, start, 0.02) - beside(arm, start, 0.045)).tolist()
    summary.write_text(json.dumps(saved))
    assert_contact(tmp_path / "plan", -0.005 - THICK_M)
    saved["config"]["cell"]["shift_m"] = [0, 0, 0]
    saved["config"]["robot"]["bodies"] = "capsules"
    summary.write_text(json.dumps(saved))
    assert_contact(tmp_path / "plan", 0.045 - 0.005 - 0.05)


def assert_contact(plan: Path, clearance_m: float) -> None:
    """The first target is refuted, with that clearance, and proven segments."""
    refuted = validate_results(plan).refuted
    assert f"in collision: clearance {1e3 * clearance_m:.3f} mm" in refuted[0].reason and refuted[0].target == 0
    assert any("is recorded as valid, but collides" in each.reason for each in refuted)
