"""Largest proven scale of errors: a plain reference, known truths, draws inside and the first collision, bad input.

The slow version with 10,000 draws in each of 20 sets is `python -m benchmarks errors`.
"""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_prove
import toy
import trimesh

import htcp_jax
from benchmarks import errors as draws
from htcp_jax.clearance.obstacles import placed_cloud
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.proof import error_pairs, error_scene
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.io.robots import load_robot
from htcp_jax.model import body_pieces, kinematics, make_piece
from htcp_jax.motion import Problem
from htcp_jax.numerics import safe_norm
from htcp_jax.proving import error_scale, error_set, scale_text, scene_of, straight
from htcp_jax.proving.scaled_errors import ErrorScale, scene_with
from htcp_jax.proving.stated_errors import read_errors

PART = {"part": {"shift_m": [1e-3, 5e-4, 2e-4], "turn_rad": [1e-3, 2e-3, 5e-4]}}
ALL = PART | {"tool": {"shift_m": 5e-4, "turn_rad": 1e-3}, "joints_rad": [1e-4, 3e-4, 2e-4, 5e-4], "cloud_m": 2e-4}


@pytest.fixture(scope="module")
def case(tmp_path_factory) -> draws.Case:
    """A motion of the toy arm under its shelf."""
    scene = scene_of(toy.write_job(tmp_path_factory.mktemp("toy")))
    return draws.Case("toy", scene, straight(toy.plans_by().x[0, 5:14]))


def sampled_scale(case: draws.Case, errors, places: int) -> float:
    """Smallest distance / first-order bound of all bodies and points at sampled configurations."""
    own, scene = error_set(case.problem, case.scene.job, errors), scene_with(case.problem, errors_of(case, errors))
    robot, cloud = scene.robot, scene.obstacles[0]
    T = np.asarray(scene.where.T_world_workpiece)
    points, least = np.asarray(cloud.points) @ T[:3, :3].T + T[:3, 3], np.inf
    row, s = np.repeat(np.arange(len(case.curves.segment)), places), np.tile(np.linspace(0, 1, places), 8)
    x = draws.configurations(case.curves, row, s)
    poses = scene.places(x, 0 * x, 0 * x, 0 * x).T
    for frames in poses:
        for k, link in enumerate(robot.capsule_link):
            p, q = (
                frames[link][:3, :3] @ np.asarray(end)[k] + frames[link][:3, 3]
                for end in (robot.capsule_p, robot.capsule_q)
            )
            along = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            on = p + along[:, None] * (q - p)
            away = np.linalg.norm(on - points, axis=1)
            normal = (on - points) / away[:, None]
            bound = np.abs(normal) @ own.part_shift_m + own.cloud_m
            bound += np.abs(np.cross(points - own.part_about_m, normal)) @ own.part_turn_rad
            for j in range(link + 1):
                axis = frames[j][:3, :3] @ np.asarray(robot.axis)[j]
                bound += np.abs(np.sum(normal * np.cross(axis, on - frames[j][:3, 3]), axis=1)) * own.joints[j]
            if own.is_tool[k]:
                frame = frames[robot.tcp_link] @ own.T_link_tool
                bound += np.abs(normal @ frame[:3, :3]) @ own.tool_shift_m
                bound += np.abs(np.cross(on - frame[:3, 3], normal) @ frame[:3, :3]) @ own.tool_turn_rad
            least = min(least, float(((away - np.asarray(robot.capsule_radius)[k] - float(cloud.cover)) / bound).min()))
    return least


def errors_of(case: draws.Case, errors):
    return error_set(case.problem, case.scene.job, errors)


@pytest.mark.parametrize("stated", [{"part": {"shift_m": 1e-3}}, PART, {"joints_rad": 1e-3}, {"cloud_m": 1e-3}, ALL])
def test_the_scale_is_at_most_that_of_a_plain_sampled_bound_and_at_least_95_percent_of_it(case, stated):
    stated = read_errors(stated)
    found = error_scale(case.problem, case.curves, errors_of(case, stated))
    least = sampled_scale(case, stated, 33)
    assert 0.95 * least <= found.scale <= least * (1 + 1e-6)


def test_no_error_inside_a_proven_set_collides_and_a_search_finds_a_collision_near_it(case):
    for number, stated in enumerate((PART, ALL)):
        found = draws.tested(case, read_errors(stated), 400, number)
        assert found["collisions"] == 0 and 1 <= found["ratio"] <= 1.1


def test_draws_beyond_the_first_collision_do_collide(case):
    numbers = errors_of(case, read_errors(ALL))
    found = error_scale(case.problem, case.curves, numbers)
    far = found._replace(scale=3 * found.scale)
    draw, x = draws.inside(case, numbers, far, 400, 0)
    assert draws.collisions(case, numbers, draw, x).any()


@pytest.fixture(scope="module")
def past_the_ball(tmp_path_factory):
    """Problem and motion of a rod that passes a ball of a cell by 1 mm."""
    folder = tmp_path_factory.mktemp("cell")
    for name, text in (("arm", test_prove.ARM), ("cell", test_prove.CELL)):
        (folder / f"{name}.xml").write_text(text)
    job = {"robot": {"model": f"{folder}/arm.xml"}, "cell": {"model": f"{folder}/cell.xml", "self_collision": False}}
    scene = scene_of(job)
    return scene, straight(test_prove.past_the_ball(-1e-3))


@pytest.mark.parametrize(
    "stated", [{"joints_rad": [0.0, 1e-3, 0.0]}, {"tool": {"shift_m": [0, 0, 5e-4]}}, {"joints_rad": [1e-3, 2e-3, 0.0]}]
)
def test_a_rod_that_passes_a_ball_by_1_mm_may_be_off_by_1_mm_towards_it(past_the_ball, stated):
    scene, curves = past_the_ball
    errors = read_errors(stated)
    found = error_scale(scene.problem, curves, error_set(scene.problem, scene.job, errors))
    towards = errors.tool.shift_m[2] if errors.tool else errors.joints_rad[1]
    assert 0.97 <= found.scale * towards / 1e-3 <= 1
    assert found.segment == 0 and scene.problem.robot.capsule_names[found.body] == "rod"
    lag = error_scale(scene.problem, curves.within([0.0, 5e-4, 0.0]), error_set(scene.problem, scene.job, errors))
    margin = error_scale(scene.problem, curves, error_set(scene.problem, scene.job, errors), margin_m=5e-4)
    assert 0.48 <= lag.scale * towards / 1e-3 <= 0.5 and 0.48 <= margin.scale * towards / 1e-3 <= 0.5


@dataclass(frozen=True)
class Ball(htcp_jax.ObstacleKind):
    """The ball of the cell, of which only distances are known."""

    centre_m: tuple[float, float, float]
    radius_m: float
    name = "ball of errors"

    def distance(self, point):
        return safe_norm(point - jnp.array(self.centre_m)) - self.radius_m


def test_errors_are_proven_next_to_an_obstacle_of_another_package(past_the_ball):
    scene, curves = past_the_ball
    known, ball = scene.problem, scene.problem.other_obstacles[0].simple[0]
    kind = Ball(tuple(np.asarray(ball.p)[0].tolist()), float(ball.radius[0]))
    own = Problem.of(known.robot, known.workpiece, known.scenarios, known.settings, known.task, [kind])
    errors = read_errors({"joints_rad": [0.0, 1e-3, 0.0]})
    exact, found = (error_scale(each, curves, error_set(each, scene.job, errors)) for each in (known, own))
    assert 0.25 * exact.scale < found.scale <= exact.scale * (1 + 1e-6)


def test_a_motion_in_contact_has_the_scale_0_and_one_far_from_everything_the_largest(past_the_ball):
    scene, _ = past_the_ball
    errors = error_set(scene.problem, scene.job, read_errors({"joints_rad": [1e-6, 1e-6, 0.0]}))
    hit = error_scale(scene.problem, straight(test_prove.past_the_ball(1e-4)), errors)
    far = error_scale(scene.problem, straight(test_prove.past_the_ball(-0.2)), errors)
    assert hit.scale == 0 and far.is_more and far.segment is None


def test_the_sentence_rounds_down_and_names_what_is_off():
    errors = read_errors({"part": {"shift_m": 5e-4, "turn_rad": [1e-3, 2e-3, 1e-3]}, "joints_rad": 1e-4})
    text = scale_text(errors, ErrorScale(1.2999, False, 3, 0.5, 1, 0, 10))
    assert text == (
        "proven with the part displaced by up to 0.645 mm along each axis and turned by up to 0.0739, 0.147, 0.0739 "
        "degrees about each axis; each joint off by up to 0.00739 degrees (1.29 times the errors stated)"
    )
    assert scale_text(errors, ErrorScale(0.5, False, 3, 0.5, 1, 0, 10)).startswith("not proven for the errors stated; ")
    assert "motion itself is not proven" in scale_text(errors, None)


def test_htcp_prove_prints_the_scale_and_exits_with_4_if_it_is_below_1(case, tmp_path, capsys):
    job, motion = toy.write_job(tmp_path), tmp_path / "motion.csv"
    x = case.curves.coefficients[:, 0]
    np.savetxt(motion, x, delimiter=",", header="j1,j2,j3,j4", comments="")
    for shift, code in ((1e-5, 0), (0.2, 4)):
        (tmp_path / "errors.yaml").write_text(f"part: {{shift_m: {shift}}}\n")
        words = ["--job", str(job), "--errors", str(tmp_path / "errors.yaml"), "--out", str(tmp_path / "out")]
        assert main(["prove", str(motion), *words]) == code
        record = json.loads((tmp_path / "out" / "proof.json").read_text())["errors"]
        assert (record["scale"] >= 1) is (code == 0)
        assert record["text"][:40] in " ".join(capsys.readouterr().out.split())


def test_errors_that_coarse_points_on_the_mesh_do_not_allow_are_proven_at_the_spacing_that_the_command_names(
    case, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    toy.write_job(tmp_path)
    at = trimesh.transformations.translation_matrix((0.61, 0, toy.SHELF_M + 0.005))
    trimesh.creation.box((0.5, 0.5, 0.01), at).export("plate.stl")
    np.savetxt("motion.csv", case.curves.coefficients[:2, 0], delimiter=",", header="j1,j2,j3,j4", comments="")
    words = ["prove", "motion.csv", "--job", "job.yaml", "--set", "workpiece.cloud=plate.stl"]
    words += ["--set", "workpiece.unit=m", "--out", "out"]
    assert main(words) == 0
    clearance_m = json.loads(Path("out/proof.json").read_text())["clearance_m"]
    Path("errors.yaml").write_text(f"part: {{shift_m: [0, 0, {clearance_m + 1e-3}]}}\n")
    capsys.readouterr()
    assert main([*words, "--errors", "errors.yaml"]) == 4
    change = re.search(r"try first +--set (workpiece.mesh_spacing_m=[0-9.]+)", capsys.readouterr().out)[1]
    assert main([*words, "--errors", "errors.yaml", "--set", change]) == 0


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({"part": {"shift_m": -1e-3}}, "at least 0"),
        ({"part": {"turn_rad": float("nan")}}, "finite"),
        ({"part": {"shift_m": [1e-3, float("inf"), 0]}}, "finite"),
        ({"parts": {"shift_m": 1e-3}}, "did you mean part"),
        ({"part": {"shift_m": 1e-3, "about": "seam"}}, "valid: path, part"),
        ({"joints_rad": 0.0}, "no value above 0"),
        ({"joints_rad": [1e-3, 1e-3]}, "one per joint: x, z, r"),
        ({"joints_rad": 1e-3}, "sliding"),
        ({"cloud_m": 1e-3}, "no part with a cloud"),
        ({"part": {"shift_m": 1e-3}}, "no part with a cloud"),
    ],
)
def test_bad_errors_are_refused_with_one_line(past_the_ball, stated, words):
    scene, _ = past_the_ball
    with pytest.raises(InputError, match=words) as caught:
        error_set(scene.problem, scene.job, read_errors(stated))
    assert "\n" not in str(caught.value)


def test_a_clouds_padding_is_no_point_of_its_errors():
    cloud = cloud_of(np.random.default_rng(0).normal(size=(5000, 3)), 0.001)
    points = error_scene.Points.of(cloud, np.eye(4), np.ones(1, bool), of_part=True)
    assert len(points.points) == cloud.count == 5000 < len(cloud.points)


def test_an_end_in_front_of_the_interior_may_be_displaced_up_to_the_interior_or_within_the_hull():
    scene = scene_of("duct")
    start, (cloud, interior) = np.array(scene.job.start_rad), scene.problem.obstacles
    whole = error_set(scene.problem, scene.job, read_errors({"part": {"shift_m": 0.05, "turn_rad": 0.01}}))
    found = {}
    for number, each in enumerate(((cloud, interior), (cloud,), (interior,))):
        known = replace(scene_with(scene.problem, whole), obstacles=each)
        x = start[None]
        limits = error_pairs.limits_at(known, known.places(x, 0 * x, 0 * x, 0 * x), 0.0, 16.0)
        found[number] = float(limits.scale.min(initial=16.0))
    assert found[0] == min(found[1], found[2]) and 0 < found[2] < 16


def test_a_piece_that_turns_about_its_capsules_axis_is_bounded_at_its_corners(tmp_path):
    axes = "0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"
    bodies = "".join(
        f'<body pos="{0.3 if k else 0} 0 0"><joint name="j{k}" axis="{axis}" range="-3 3"/>'
        '<geom type="capsule" fromto="0 0 0 .25 0 0" size=".1"/>'
        for k, axis in enumerate(axes)
    )
    text = f'<mujoco><worldbody>{bodies}<site name="tcp" pos=".5 0 0"/>{"</body>" * 6}</worldbody></mujoco>'
    (tmp_path / "arm.xml").write_text(text)
    robot = load_robot(tmp_path / "arm.xml")
    bar, plate = (
        np.array([[x, y, z] for x in (0, 0.25) for y in (-w, w) for z in (-h, h)])
        for w, h in ((0.05, 0.05), (0.09, 0.005))
    )
    pieces = body_pieces([*[make_piece(bar)] * 5, make_piece(plate)], np.full(6, 0.1))
    robot = replace(robot, pieces=jax.tree.map(jnp.asarray, pieces))
    x = np.array([0.2, -0.5, 0.7, 0.0, 0.4, 0.0])
    T = np.asarray(kinematics.link_poses(robot, jnp.asarray(x)))[5]
    above = T[:3, :3] @ [0.2, 0.08, 0.02] + T[:3, 3]  # 15 mm above the plate, 80 mm from the axis on which it turns
    cloud = placed_cloud(robot, above[None], np.empty((0, 3, 3)), np.eye(4), "p", "p")
    problem = scene_of(robot, obstacles=[cloud]).problem
    errors = error_set(problem, None, read_errors({"joints_rad": [0, 0, 0, 0, 0, 0.01]}))
    found = error_scale(problem, straight(np.stack([x, x + 1e-3 * np.eye(6)[5]])), errors)
    touches_rad = next(a for a in np.linspace(0, 0.4, 4001) if 0.08 * np.sin(a) + 0.005 * np.cos(a) >= 0.02)
    assert not found.is_more and 0.5 * touches_rad < 0.01 * found.scale < touches_rad
