"""`htcp_jax.prove`: verdicts where the truth is known, paths inside corners, batches, and bad input.

The arm slides along x and z and turns about y; its tool is a rod along y with a radius of 1 mm. A plate of 1 mm at
x = 0.213 m has a slot of 3 mm at z = 0, and a ball of 0.3 mm hangs at z = 0.5 m, between two of 1,000 samples of a
motion along x.
"""

import re

import jax
import made_once
import numpy as np
import pytest
import trimesh

import htcp_jax
from htcp_jax.clearance import Scene
from htcp_jax.errors import InputError
from htcp_jax.motion.motion_check import clearance_along
from htcp_jax.proving import JointCurves, MotionProof, corners, prove_curves, scene_of, straight
from htcp_jax.proving.prove import prove_within, tighten
from htcp_jax.proving.worst import deepest_contact
from htcp_jax.status import SegmentStatus, UndecidedCause

VALID, IN_COLLISION, UNDECIDED = SegmentStatus.VALID, SegmentStatus.IN_COLLISION, SegmentStatus.UNDECIDED
ARM = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
<body><joint name="z" type="slide" axis="0 0 1" range="-1 1"/><body><joint name="r" axis="0 1 0" range="-3 3"/>
<geom name="rod" type="capsule" fromto="0 -0.15 0 0 0.15 0" size="0.001"/><site name="tcp"/>
</body></body></body></worldbody></mujoco>"""
ROD_M, BALL_M = 0.001, 0.0003
BETWEEN = -1 + 2 * 299.5 / 999  # x of the ball: between two of 1,000 samples from -1 to 1 m
CELL = f"""<mujoco><worldbody>
<geom name="above" type="box" pos="0.213 0 0.1015" size="0.0005 0.5 0.1"/>
<geom name="below" type="box" pos="0.213 0 -0.1015" size="0.0005 0.5 0.1"/>
<geom name="ball" type="sphere" pos="{BETWEEN} 0 0.5" size="{BALL_M}"/>
</worldbody></mujoco>"""


@pytest.fixture(scope="module")
def job(tmp_path_factory) -> dict:
    folder = tmp_path_factory.mktemp("cell")
    for name, text in (("arm", ARM), ("cell", CELL)):
        (folder / f"{name}.xml").write_text(text)
    return {"robot": {"model": f"{folder}/arm.xml"}, "cell": {"model": f"{folder}/cell.xml", "self_collision": False}}


@pytest.fixture(scope="module")
def problem(job):
    return scene_of(job).problem


def past_the_ball(depth_m: float) -> np.ndarray:
    """A motion along x whose rod is `depth_m` deep in the ball."""
    z = 0.5 + ROD_M + BALL_M - depth_m
    return np.array([[-1, z, 0], [1, z, 0]])


@pytest.mark.parametrize("depth_mm", [0.01, 0.1, 0.3])
def test_a_collision_between_two_of_1000_samples_is_refuted_and_a_miss_by_as_much_is_proven(problem, depth_mm):
    hit, miss = past_the_ball(1e-3 * depth_mm), past_the_ball(-1e-3 * depth_mm)
    samples = hit[0] + np.arange(1000)[:, None] / 999 * (hit[1] - hit[0])
    apart = np.hypot(samples[:, 0] - BETWEEN, samples[:, 1] - 0.5) - ROD_M - BALL_M
    assert apart.min() > 0
    found = prove_curves(problem, straight(np.concatenate([hit, miss])[[0, 1, 3, 2]]), kept=0.0)
    assert found.verdict[[0, 2]].tolist() == [IN_COLLISION, VALID]
    assert abs(-1 + 2 * found.place[0] - BETWEEN) < ROD_M + BALL_M


def test_a_plate_of_1_mm_and_a_slot_of_3_mm_are_decided_within_60_queries(problem):
    scene = Scene(problem.robot, problem.obstacles)
    where = jax.tree.map(lambda leaf: leaf[0], problem.scenarios)
    for z, verdict in ((0.1, IN_COLLISION), (0.0, VALID)):
        found = made_once.prove(scene, where, np.array([-0.3, z, 0.0]), np.array([0.413, z, 0.0]))
        assert int(found.verdict) == verdict and int(found.queries) <= 60


def test_motions_have_the_same_results_alone_and_in_a_batch(job, problem):
    x = np.stack([past_the_ball(depth) for depth in (1e-5, -1e-5, 1e-4, -1e-2)])
    together = htcp_jax.prove(job, x)
    assert together.refuted.tolist() == [True, False, True, False]
    assert together.proven.tolist() == [False, True, False, True]
    for k, each in enumerate(x):
        alone = htcp_jax.prove(job, each)
        for name in ("verdict", "clearance_m", "place", "queries", "cause"):
            assert np.array_equal(getattr(alone, name), getattr(together, name)[k], equal_nan=True)


def test_a_segment_is_undecided_if_the_servo_may_reach_an_obstacle_and_below_the_margin_if_it_is_nearer(job):
    x = past_the_ball(-1e-3)  # misses by 1 mm
    lag = [0.0, 2e-3, 0.0]
    assert htcp_jax.prove(job, x, tracking_rad=[0.0, 5e-4, 0.0]).proven
    tracked = htcp_jax.prove(job, x, tracking_rad=lag)
    assert tracked.verdict.tolist() == [UNDECIDED] and tracked.cause.tolist() == [UndecidedCause.TRACKING]
    assert htcp_jax.prove(job, past_the_ball(1e-4), tracking_rad=lag).refuted
    assert htcp_jax.prove(job, x, margin_m=2e-3).verdict.tolist() == [SegmentStatus.BELOW_MARGIN]
    assert 5e-4 <= htcp_jax.prove(job, x, margin_m=5e-4).guaranteed_m <= 1e-3


def test_a_motion_that_grazes_an_obstacle_by_a_millionth_of_a_mm_is_undecided_at_the_finest_subdivision(problem):
    found = prove_curves(problem, straight(past_the_ball(-1e-9)), kept=0.0)
    assert found.verdict.tolist() == [UNDECIDED] and found.cause.tolist() == [UndecidedCause.SUBDIVISION]


@pytest.fixture(scope="module")
def with_plate(job, tmp_path_factory) -> dict:
    """A job with a part: a plate with its top at z = 0; its points are up to 8 mm from any place on it."""
    folder = tmp_path_factory.mktemp("plate")
    trimesh.creation.box(bounds=[[-0.1, -0.2, -0.02], [0.1, 0.2, 0.0]]).export(folder / "plate.stl")
    (folder / "path.csv").write_text("x,y,z\n0,0,0\n0.01,0,0\n")
    pose = {"neutral_translation_m": [0, 0, 0], "pivot_m": [0, 0, 0], "rotation_y_rad": 0, "rotation_z_rad": 0}
    part = {"cloud": f"{folder}/plate.stl", "unit": "m", "path": f"{folder}/path.csv", "path_unit": "m", **pose}
    return {**job, "workpiece": part | {"interior": "none", "mesh_spacing_m": 0.016}, "cell": {"self_collision": False}}


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("workpiece.shift_m=[0, 0, 620]", "a target of the part's path is farther away than the arm is long; lengths"),
        ("workpiece.inlet_m=[0, 0, 105]", "workpiece.inlet_m is 105 m away from the part, which is 0.448 m large; it"),
    ],
)
def test_a_length_in_millimetres_causes_a_warning(with_plate, key, says):
    with pytest.warns(UserWarning, match="clearance is reduced"), pytest.warns(UserWarning, match=re.escape(says)):
        scene_of(with_plate, [key])


def test_a_motion_that_only_the_gaps_between_points_on_a_mesh_refute_is_undecided(with_plate):
    with pytest.warns(UserWarning, match=r"every clearance is reduced by 7\.81 mm"):
        cell = scene_of(with_plate)

    def along(distance_m: float, margin_m: float = 0.0) -> MotionProof:
        z = distance_m + ROD_M
        return prove_curves(cell.problem, straight(np.array([[-0.05, z, 0], [0.05, z, 0]])), margin_m=margin_m)

    assert along(0.02).proven
    assert along(-0.002).verdict.tolist() == [IN_COLLISION]
    for found in (along(0.003), along(0.006, margin_m=0.005)):
        assert found.verdict.tolist() == [UNDECIDED] and found.cause.tolist() == [UndecidedCause.MESH_POINTS]
    assert along(0.003, margin_m=0.02).verdict.tolist() == [SegmentStatus.BELOW_MARGIN]

    def found_at(distance_m: float) -> str:
        z, bare = distance_m + ROD_M, cell.problem.without_covering_radius
        return deepest_contact(bare, straight(np.array([[-0.05, z, 0], [0.05, z, 0]])), 0).text

    assert found_at(0.003) == "capsule rod is at most 3 mm from the workpiece"
    assert found_at(-0.0005) == "capsule rod is at least 0.5 mm inside the workpiece"


def tcp_of(x: np.ndarray) -> np.ndarray:
    return np.stack([x[:, 0], np.zeros(len(x)), x[:, 1]], axis=1)


def test_every_path_inside_a_corner_is_within_the_paths_that_are_proven():
    rng = np.random.default_rng(0)
    x = np.array([[0.0, 0.0, 0.1], [0.3, 0.1, -0.4], [0.2, 0.6, 0.7], [0.9, 0.5, 0.0], [1.1, 0.47, -0.25]])
    radius = np.array([1.0, 0.05, 0.2, 0.1, 1.0])
    found = corners(x, radius, tcp_of)
    assert np.bincount(found.segment[~found.is_certain]).tolist() == [8, 8, 2]  # the last corner is flat
    for k in (1, 2, 3):
        bands = JointCurves(*(part[(found.segment == k - 1) & ~found.is_certain] for part in found))
        ends = [leg[(np.linalg.norm(leg[:, :2] - x[k, :2], axis=1) <= radius[k])][-1] for leg in legs(x, k)]
        u, v = rng.random((2, 2000))
        inside = x[k] + u[:, None] * ((1 - v)[:, None] * (ends[0] - x[k]) + v[:, None] * (ends[1] - x[k]))
        start, step = bands.coefficients[:, 0], bands.coefficients[:, 1]
        # Is a point within the tolerance of a band at any place? The distance is linear in the place for each joint.
        s = np.linspace(0, 1, 2001)
        near = np.zeros(len(inside), bool)
        for at, along, off in zip(start, step, bands.off, strict=True):
            path = at + s[:, None] * along
            near |= (np.abs(inside[:, None] - path[None]) <= off + 1e-3 * np.abs(along) + 1e-12).all(axis=2).any(axis=1)
        assert near.all()
    certain = JointCurves(*(part[found.is_certain] for part in found))
    assert certain.segment.tolist() == [0, 1, 2, 3]
    assert (certain.span[:, 1] < 1).tolist() == [True, True, True, False]


def test_repeated_configurations_at_a_rounded_corner_add_no_paths(problem):
    x = np.array([[BETWEEN - 0.1, 0.49, 0.0], [BETWEEN, 0.49, 0.0], [BETWEEN, 0.49, 0.0], [BETWEEN, 0.2, 0.0]])
    found = corners(x, np.full(4, 0.02), tcp_of)
    assert not found.off.any() and prove_curves(problem, found).proven


def test_a_corner_that_goes_straight_on_loses_no_clearance(problem):
    x = np.array([[BETWEEN - 0.1, 0.49, 0.0], [BETWEEN, 0.49, 0.0], [BETWEEN + 0.3, 0.49, 0.0]])
    rounded = corners(x, np.array([0, 0.02, 0]), tcp_of)
    clear_m = 0.01 - ROD_M - BALL_M  # bands of the corner would cost 1.2 mm
    assert 0.97 * clear_m <= prove_curves(problem, rounded, kept=0.999).guaranteed_m <= clear_m


def legs(x: np.ndarray, k: int) -> list[np.ndarray]:
    """Halves of both legs at a corner, as samples that begin at the corner."""
    s = np.linspace(0, 0.5, 5001)[:, None]
    return [x[k] + s * (x[other] - x[k]) for other in (k - 1, k + 1)]


def test_a_path_inside_a_corner_that_may_collide_makes_the_segment_undecided(problem):
    corner = np.array([BETWEEN, 0.5 - 0.01, 0.0])  # the ball is 10 mm above the corner, inside the triangle
    x = np.stack([corner + np.array([-0.1, 0.1, 0]), corner, corner + np.array([0.1, 0.1, 0])])
    assert prove_curves(problem, straight(x)).proven
    rounded = prove_curves(problem, corners(x, np.array([0, 0.05, 0]), tcp_of))
    assert rounded.verdict.tolist() == [UNDECIDED, VALID] and not rounded.refuted
    assert rounded.cause.tolist() == [UndecidedCause.CORNER, UndecidedCause.NONE]
    within = prove_within(problem, corners(x, np.array([0, 0.05, 0]), tcp_of), np.full(3, 1e-4))
    assert within.cause.tolist() == rounded.cause.tolist()
    assert prove_curves(problem, corners(x, np.array([0, 0.005, 0]), tcp_of)).proven


@pytest.mark.parametrize(
    ("x", "options", "message"),
    [
        (np.zeros((2, 4)), {}, "shape"),
        (np.zeros((1, 3)), {}, "shape"),
        (np.array([[0, 0, 0], [0, np.nan, 0]]), {}, "z at index"),
        (np.zeros((2, 3)), {"tracking_rad": -1.0}, "tracking_rad"),
        (np.zeros((2, 3)), {"tracking_rad": [0.1, 0.1]}, "tracking_rad"),
        (np.zeros((2, 3)), {"margin_m": np.nan}, "margin_m"),
    ],
)
def test_invalid_motions_and_options_are_refused_with_a_reason(job, x, options, message):
    with pytest.raises(InputError, match=message):
        htcp_jax.prove(job, x, **options)


def test_bodies_that_are_not_checked_are_named_in_a_warning_and_in_the_result(job, tmp_path):
    boxed = ARM.replace('<site name="tcp"/>', '<geom name="block" type="box" size="0.1 0.1 0.1"/><site name="tcp"/>')
    (tmp_path / "boxed.xml").write_text(boxed)
    with pytest.warns(UserWarning, match="not checked: block: no capsule or sphere"):
        found = scene_of(job | {"robot": {"model": f"{tmp_path}/boxed.xml"}})
    assert found.checked["not checked"].startswith("block: ")
    assert scene_of(job).checked == {"part": "none", "self-collision": "not checked", "fixtures": "ball, above, below"}


def test_shapes_of_a_cell_in_millimetres_cause_a_warning(job, tmp_path):
    (tmp_path / "cell.xml").write_text(CELL.replace("0.0005 0.5 0.1", "0.5 500 100", 1))
    with pytest.warns(UserWarning, match=r"above extends over 1e\+03 m"):
        scene_of(job | {"cell": {"model": f"{tmp_path}/cell.xml"}})


def test_a_job_without_walls_needs_no_path(job):
    assert not scene_of(job | {"workpiece": {"cloud": "none"}}).has_part


def test_the_bound_of_a_long_path_is_raised_to_its_clearance(problem):
    """An interval is halved a few times only to raise its bound: 2 m past a ball, 2 mm away from it."""
    curves = straight(past_the_ball(-0.002))
    once = prove_curves(problem, curves, kept=0.999)
    assert once.proven and once.guaranteed_m < 0.0015
    raised = tighten(problem, curves, prove_curves(problem, curves))
    assert 0.97 * 0.002 <= raised.guaranteed_m <= 0.002
    back = clearance_along(problem, past_the_ball(-0.002))
    assert 0.97 * 0.002 <= back.min() <= 0.002


def test_parts_of_a_curve_are_the_same_curve():
    draw = np.random.default_rng(4)
    coefficients, span = draw.normal(size=(3, 6, 2)), np.tile([0.2, 0.7], (3, 1))
    curves = JointCurves(coefficients, draw.uniform(size=(3, 2)), np.arange(3), span, np.ones(3, bool))
    begin, end = np.array([0.0, 0.3]), np.array([0.25, 0.9])
    parts, s = curves.between(1, begin, end), draw.uniform(size=(2, 1))
    x = (parts.coefficients * s[:, :, None] ** np.arange(6)[:, None]).sum(axis=1)
    whole = begin[:, None] + s * (end - begin)[:, None]
    expected = (coefficients[1] * whole[:, :, None] ** np.arange(6)[:, None]).sum(axis=1)
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-13)
    np.testing.assert_allclose(parts.span, [[0.2, 0.325], [0.35, 0.65]], atol=1e-15)
    assert parts.segment.tolist() == [0, 1] and (parts.off == curves.off[1]).all()
