"""Convex pieces in an arm's capsules decide where these are in doubt: distances by FCL, proofs by dense samples."""

import dataclasses
from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import qpsolvers
from made_once import prove, quick_jit
from scipy.sparse import csc_matrix
from scipy.spatial import ConvexHull

import htcp_jax
from htcp_jax.clearance import Scene, by_pieces, contacts, is_clear, minimum_clearance
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.clearance.obstacles import surely_collides
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.obstacles.fixtures import Fixtures, fixtures
from htcp_jax.clearance.obstacles.narrow_phase import decide_together
from htcp_jax.clearance.obstacles.obstacle import Contacts, bodies_at
from htcp_jax.clearance.obstacles.obstacles import clearance_rows
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.model import Robot, kinematics
from htcp_jax.model.convex_piece import body_pieces, make_piece
from htcp_jax.model.robot import capsule_label, mesh_note
from htcp_jax.status import SegmentStatus
from htcp_jax.trajectory.displacement import arm_at, displacement_bound
from htcp_jax.types import Float

MARGIN_M, LIMIT_M = 0.02, 0.025  # and the distance below which pieces are measured


@dataclasses.dataclass
class Pose:
    """The world's frame, with a margin."""

    T_world_workpiece: Float[jax.Array, "4 4"]
    interior_plane: Float[jax.Array, "4"]
    margin_m: Float[jax.Array, ""]


jax.tree_util.register_dataclass(Pose, ["T_world_workpiece", "interior_plane", "margin_m"], [])
WHERE = Pose(jnp.eye(4), jnp.zeros(4), jnp.asarray(MARGIN_M))


def corners_in(arm: Robot, k: int) -> np.ndarray:
    """Random points within a capsule."""
    rng = np.random.default_rng(k)
    p, q, radius = (np.asarray(each)[k] for each in (arm.capsule_p, arm.capsule_q, arm.capsule_radius))
    away = rng.normal(size=(20, 3))
    away *= radius * rng.uniform(0.3, 0.99, (20, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    return p + rng.uniform(size=(20, 1)) * (q - p) + away


@cache
def arm_with_pieces() -> Robot:
    """An arm with a random polyhedron in every capsule but the last."""
    arm = made_once.gp50()
    bodies = range(len(arm.capsule_link))
    radius = np.asarray(arm.capsule_radius)
    excess = np.where(np.array(bodies) == len(bodies) - 1, 0.0, 2 * radius)
    pieces = body_pieces([make_piece(corners_in(arm, k)) for k in bodies], excess)
    return dataclasses.replace(arm, pieces=jax.tree.map(jnp.asarray, pieces))


def apart_m(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two convex hulls by a QP in the weights of their corners [m]."""
    both = np.concatenate([a, -b])
    sums = np.zeros((2, len(both)))
    sums[0, : len(a)], sums[1, len(a) :] = 1, 1
    found = qpsolvers.solve_qp(
        *(csc_matrix(both @ both.T), np.zeros(len(both)), None, None),
        *(csc_matrix(sums), np.ones(2), np.zeros(len(both)), None),
        solver="clarabel",
        tol_gap_abs=1e-9,
        tol_gap_rel=1e-9,
    )
    return float(np.linalg.norm(found @ both))


def placed_corners(arm: Robot, x: np.ndarray, k: int) -> tuple[np.ndarray, float]:
    """Corners in the world of what decides about a body, and its radius: its piece, or the axis of its capsule."""
    T = np.asarray(kinematics.body_poses(arm, jnp.asarray(x)))[k]
    if arm.pieces.excess_m[k] == 0:
        ends, radius = np.stack([arm.capsule_p[k], arm.capsule_q[k]]), float(arm.capsule_radius[k])
    else:
        ends, radius = corners_in(arm, k), 0.0
    return ends @ T[:3, :3].T + T[:3, 3], radius


def expected_m(capsules: float, pieces: list[float]) -> float:
    return max(capsules, min([LIMIT_M, *pieces]))


@quick_jit
def verdicts(arm, obstacles, xs, above):
    """Distances, verdicts at margins `above` them by the distance and by the query alone, and sure collisions."""

    def at(x, above):
        D = minimum_clearance(arm, obstacles, WHERE, x)
        margin = jnp.maximum(D + above, 0.0)
        here = arm, obstacles, WHERE, x
        return D, D > margin, is_clear(*here, margin), surely_collides(*here)

    return jax.lax.map(lambda row: at(*row), (xs, above))


def test_clear_by_a_margin_is_the_verdict_of_the_pieces_also_where_both_are_nearly_equal():
    obstacles, above = (cloud_of(points(300), 1e-3), SelfCollision(pairs())), (-1e-3, -1e-9, 0.0, 1e-9, 1e-3)
    xs, above = np.repeat(configurations(), len(above), axis=0), np.tile(above, len(configurations()))
    D, truth, found, _ = verdicts(arm_with_pieces(), obstacles, xs, above)
    np.testing.assert_array_equal(found, truth)
    assert 10 < truth.sum() < len(truth) - 10 and (np.asarray(D) > 0).sum() > 20
    pieces = arm_with_pieces().pieces
    close = dataclasses.replace(arm_with_pieces(), pieces=pieces._replace(excess_m=0.1 * pieces.excess_m))
    D, *_, surely = verdicts(close, obstacles, xs, above)
    assert surely.any() and (D[surely] < 0).all()


SETS = ("floor", "crate"), ("bar", "post")
PART = {"own": slice(0, 10), "points": slice(10, 18)} | dict.fromkeys((*SETS[0], *SETS[1]), slice(18, 38))


@quick_jit
def each_alone(arm, obstacles, xs):
    """Contacts of each obstacle alone, at every configuration."""
    return jax.lax.map(lambda x: [contacts(arm, (each,), WHERE, x) for each in obstacles], xs)


def sets_of_solids() -> tuple[Fixtures, Fixtures]:
    """Two sets of solids, one with a floor, with different numbers of corners."""
    return tuple(fixtures(arm_with_pieces(), [(name, SOLIDS[name]) for name in names]) for names in SETS)


def only(solids: Fixtures, name: str) -> Fixtures:
    """The same solids, of which one is checked."""
    return dataclasses.replace(solids, is_checked=solids.is_checked & (np.array(solids.names) == name)[:, None])


@cache
def measured(first: str = "", second: str = "", by_capsules: bool = False) -> list[Contacts]:
    """Contacts with both sets of solids or one solid of each, with points, and of the arm's own bodies."""
    arm = dataclasses.replace(arm_with_pieces(), pieces=None) if by_capsules else arm_with_pieces()
    solids = (only(each, name) if name else each for each, name in zip(sets_of_solids(), (first, second), strict=True))
    obstacles = *solids, cloud_of(points(3000), 1e-3), SelfCollision(pairs())
    return jax.tree.map(np.asarray, each_alone(arm, obstacles, configurations()))


def configurations() -> np.ndarray:
    arm = arm_with_pieces()
    return np.concatenate([made_once.configurations(arm, count, seed) for count, seed in ((10, 0), (8, 3), (20, 1))])


def measured_at(name: str):
    """Configurations of a test, and the distances to an obstacle by pieces and by capsules."""
    solids = next((own for own in zip(*SETS, strict=True) if name in own), ("", ""))
    row = {"points": 2, "own": 3}.get(name) or solids.index(name)
    distances = [measured(*solids, by_capsules)[row].distance for by_capsules in (False, True)]
    return [each[PART[name]] for each in (configurations(), *distances)]


def points(count: int) -> np.ndarray:
    return np.random.default_rng(2).uniform([-1.5, -1.5, 0], [1.5, 1.5, 2], (count, 3))


def pairs() -> tuple[tuple[int, int], ...]:
    """Pairs of bodies of links that are not adjacent."""
    link = made_once.gp50().capsule_link
    return tuple((a, b) for a in range(8) for b in range(8) if link[a] > link[b] + 1)


def test_bodies_of_an_arm_are_as_far_apart_as_their_pieces():
    arm, rows, seen = arm_with_pieces(), SelfCollision(pairs()).rows(arm_with_pieces()), 0
    for x, found, capsules in zip(*measured_at("own"), strict=True):
        bodies = [placed_corners(arm, x, k) for k in range(8)]
        for row, (body, link) in enumerate(zip(*rows, strict=True)):
            others = [b for a, b in pairs() if a == body and arm.capsule_link[b] == link]
            if capsules[row] >= LIMIT_M:
                assert found[row] == pytest.approx(capsules[row], abs=1e-6)
                continue
            away = [apart_m(bodies[body][0], bodies[b][0]) - bodies[body][1] - bodies[b][1] for b in others]
            if min(away) > 1e-6:
                assert found[row] == pytest.approx(expected_m(capsules[row], away), abs=1e-6)
            else:
                assert capsules[row] <= found[row] <= 1e-6
            seen += found[row] > capsules[row] + 1e-3
    assert seen > 20


SOLIDS = {
    "floor": HalfSpace(np.array([0.0, 0.0, 1.0]), np.array(0.3)),
    "bar": Rod(np.array([0.5, -1.0, 0.9]), np.array([0.5, 1.0, 1.0]), np.array(0.05)),
    "crate": Box(np.eye(3), np.array([0.6, 0.0, 0.6]), np.array([0.3, 0.6, 0.6])),
    "post": Cylinder(np.eye(3), np.array([0.5, -0.4, 0.8]), np.array(0.1), np.array(0.5)),
}


def outline(name: str) -> tuple[np.ndarray, float]:
    """Corners and radius of a solid that is no half-space."""
    solid = SOLIDS[name]
    if name == "bar":
        return np.stack([solid.p, solid.q]), float(solid.radius)
    if name == "crate":
        return solid.centre + np.array([np.array(s) * solid.half for s in product((-1, 1), repeat=3)]), 0.0
    turn = np.linspace(0, 2 * np.pi, 120)
    rim = [np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), np.full(120, z)], axis=1) for z in (-0.5, 0.5)]
    return solid.centre + np.concatenate(rim), 0.0


def test_obstacles_that_are_searched_together_have_the_contacts_of_each_alone():
    """Two sets of solids, one with a floor, with different numbers of corners, and the arm itself."""
    arm, every = arm_with_pieces(), (*sets_of_solids(), SelfCollision(pairs()))

    @quick_jit
    @jax.vmap
    def together(x):
        bodies = bodies_at(arm, WHERE, x)
        return [each.contacts(arm, WHERE, bodies) for each in decide_together(arm, every, WHERE, bodies)]

    alone = [measured()[row] for row in (0, 1, 3)]
    for one, other in zip(jax.tree.leaves(alone), jax.tree.leaves(together(configurations())), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert sum(int(np.sum(each.radius == 0)) for each in alone) > 40  # decided by pieces


@pytest.mark.parametrize("name", SOLIDS)
def test_a_solid_is_as_far_away_as_the_pieces_are(name):
    arm, seen = arm_with_pieces(), 0
    checked = next(
        np.asarray(each.is_checked)[each.names.index(name)] for each in sets_of_solids() if name in each.names
    )
    for x, found, capsules in zip(*measured_at(name), strict=True):
        for k in np.flatnonzero(checked & np.isfinite(capsules)):
            if capsules[k] <= -arm.pieces.excess_m[k] or arm.pieces.excess_m[k] == 0:
                assert found[k] == capsules[k]
                continue
            if capsules[k] >= LIMIT_M:
                assert found[k] == pytest.approx(capsules[k], abs=1e-6)
                continue
            corners, radius = placed_corners(arm, x, k)
            if name == "floor":
                away = float(corners[:, 2].min()) - 0.3 - radius
            else:
                others, thick = outline(name)
                away = apart_m(corners, others) - radius - thick
            if away > 1e-6 or name == "floor":
                assert found[k] == pytest.approx(expected_m(capsules[k], [away]), abs=3e-4 if name == "post" else 1e-6)
            else:
                assert capsules[k] <= found[k] <= 1e-6
            seen += found[k] > capsules[k] + 1e-3
    assert seen > 3


def test_points_are_as_far_away_as_the_pieces_are_at_most_by_a_tenth_less():
    arm, cloud, seen = arm_with_pieces(), points(3000), 0
    for x, found, capsules in zip(*measured_at("points"), strict=True):
        for k in range(8):
            if capsules[k] >= LIMIT_M or arm.pieces.excess_m[k] == 0:
                assert found[k] == capsules[k]
                continue
            corners, _ = placed_corners(arm, x, k)
            faces = ConvexHull(corners).equations
            depth = -(cloud @ faces[:, :3].T + faces[:, 3]).max(axis=1).min()
            if depth > 0:
                assert found[k] == pytest.approx(max(capsules[k], -depth - 1e-3), abs=1e-6)
                continue
            near = cloud[np.argsort(np.linalg.norm(cloud - corners.mean(axis=0), axis=1))[:20]]
            away = min(apart_m(corners, point[None]) for point in near) - 1e-3
            least, most = (expected_m(capsules[k], [share * (away + 1e-3) - 1e-3]) for share in (0.8, 1.0))
            assert least - 1e-6 <= found[k] <= most + 1e-6
            seen += found[k] > capsules[k] + 1e-3
    assert seen > 3


def test_the_gradient_is_that_of_the_distance():
    arm = arm_with_pieces()
    obstacles = cloud_of(points(3000), 1e-3), fixtures(arm, list(SOLIDS.items())), SelfCollision(pairs())
    xs, seen = made_once.configurations(arm, 8, seed=4), 0
    steps = 1e-6 * np.concatenate([np.zeros((1, 6)), np.eye(6), -np.eye(6)])
    measured = quick_jit(lambda xs: jax.lax.map(lambda x: clearance_rows(arm, obstacles, WHERE, x), xs))
    found = measured((xs[:, None] + steps).reshape(-1, 6))
    for k in range(0, len(found.distance), 13):
        rows = jax.tree.map(lambda leaf, k=k: np.asarray(leaf[k]), found)
        ahead, back = np.asarray(found.distance)[k + 1 : k + 13].reshape(2, 6, -1).transpose(0, 2, 1)
        slope = (ahead - back) / 2e-6
        smooth = np.abs(ahead + back - 2 * np.asarray(rows.distance)[:, None]).max(axis=1) < 1e-9
        flat = np.asarray(rows.distance) == LIMIT_M
        use = smooth & ~flat & np.isfinite(rows.distance)
        assert np.abs(slope - np.asarray(rows.gradient))[use].max() < 1e-4
        seen += use.sum()
    assert seen > 60


def test_a_path_that_only_the_pieces_prove_is_clear_at_dense_samples():
    arm = arm_with_pieces()
    pairs = SelfCollision(((5, 0), (5, 1), (6, 0), (6, 1)))
    scene = Scene(arm, (cloud_of(points(300), 1e-3), fixtures(arm, [("crate", SOLIDS["crate"])]), pairs))
    bare = arm.pieces._replace(excess_m=jnp.zeros_like(arm.pieces.excess_m))  # the capsules decide, in the same program
    thick = scene._replace(robot=dataclasses.replace(arm, pieces=bare))
    proved = quick_jit(lambda scene, a, b: prove(scene, WHERE, a, b, kept=0.5))
    places = quick_jit(jax.vmap(lambda x: minimum_clearance(arm, scene.obstacles, WHERE, x)))
    gained = 0
    for x in made_once.configurations(arm, 30, seed=5):
        a, b = x, x + 0.05 * np.random.default_rng(6).normal(size=len(x))
        found, before = proved(scene, a, b), proved(thick, a, b)
        if before.verdict == SegmentStatus.VALID:
            assert found.verdict == SegmentStatus.VALID
        if found.verdict == SegmentStatus.VALID:
            between = a + np.linspace(0, 1, 1000)[:, None] * (b - a)
            assert np.asarray(places(between)).min() >= float(found.clearance) - 1e-9
            gained += int(before.verdict) != SegmentStatus.VALID
    assert gained > 2


def test_a_message_says_that_a_piece_was_measured_where_it_decided():
    arm, x = arm_with_pieces(), jnp.zeros(6)
    own = (fixtures(arm, [("floor", HalfSpace(np.array([0.0, 0.0, 1.0]), np.array(0.3)))]),)
    touch = quick_jit(lambda arm: contacts(arm, own, WHERE, x))
    rows, bare = Scene(arm, own).rows, dataclasses.replace(arm, pieces=None)
    found, capsules = touch(arm), np.asarray(touch(bare).distance)
    decided = np.asarray(by_pieces(arm, rows, found))
    np.testing.assert_array_equal(decided, np.asarray(found.distance) != capsules)
    assert decided.any() and not decided.all() and not np.asarray(by_pieces(bare, rows, touch(bare))).any()
    first, second = arm.capsule_names[:2]
    notes = {"the workpiece": first, capsule_label(arm, second): f"{first} and {second}"}
    for other, names in notes.items():
        note = mesh_note(arm, first, other, np.zeros(6), np.zeros((2, 3)), by_piece=True)
        assert note == f"; measured to the convex piece of the mesh in {names}"
    assert mesh_note(arm, first, "the workpiece", np.zeros(6), np.zeros((2, 3)), by_piece=False) == ""


def test_a_message_names_the_nearest_body_by_the_pieces_where_they_decide():
    """The crate is nearer to the capsule of a body, and the post to its piece; likewise of the arm's own bodies."""
    arm, seen = dataclasses.replace(arm_with_pieces(), capsule_link=(0, 1, 2, 3, 3, 4, 5, 5)), 0
    bare = dataclasses.replace(arm, pieces=None)
    post = Rod(np.array([0.9, 0.2, 0.0]), np.array([0.9, 0.2, 2.0]), np.array(0.05))
    crate = Box(np.eye(3), np.array([0.9, -0.4, 1.0]), np.array([0.3, 0.3, 1.0]))
    both = fixtures(arm, [("crate", crate), ("post", post)])
    pairs = tuple((a, b) for a in range(8) for b in range(8) if arm.capsule_link[a] > arm.capsule_link[b])
    own = SelfCollision(pairs)
    others = [[b for a, b in pairs if (a, arm.capsule_link[b]) == row] for row in zip(*own.rows(arm), strict=True)]
    row = next(k for k, each in enumerate(others) if len(each) > 1)
    of_row = [SelfCollision(((int(own.rows(arm).body[row]), other),)) for other in others[row]]
    xs = jnp.asarray(made_once.configurations(arm, 300, seed=3))

    def distances_of(arm):
        crate, *own = (each.distance for each in each_alone(arm, (only(both, "crate"), *of_row), xs))
        post, *_ = (each.distance for each in each_alone(arm, (only(both, "post"), *of_row), xs))
        return list(map(np.asarray, (crate, post, *own)))

    by_piece, by_capsule = distances_of(arm), distances_of(bare)
    solid, of_capsule = (np.argmin(each[:2], axis=0) for each in (by_piece, by_capsule))
    close = np.min(by_piece[:2], axis=0) < LIMIT_M
    rows = sorted(np.argwhere(close).tolist(), key=lambda each: solid[*each] == of_capsule[*each])  # unequal ones first
    for k, body in rows[:3]:
        name = made_once.nearest_name(arm, both, body, xs[k], MARGIN_M)
        assert name == f"the fixture {('crate', 'post')[solid[k, body]]!r}"
        seen += solid[k, body] != of_capsule[k, body]
    pair, of_capsule = (np.argmin(np.concatenate(each[2:], axis=1), axis=1) for each in (by_piece, by_capsule))
    for k in np.argsort(pair == of_capsule, kind="stable")[:3].tolist():
        name = made_once.nearest_name(arm, own, row, xs[k], MARGIN_M)
        assert name == capsule_label(arm, arm.capsule_names[others[row][pair[k]]])
        seen += pair[k] != of_capsule[k]
    assert seen > 0, "in which the capsules would name the other one"


def blade_on_its_hinge(folder) -> Robot:
    """An arm whose first capsule lies on its hinge, with a blade in it that turns about the capsule's axis."""
    capsule = '<geom name="{}" type="capsule" fromto="{}" size="{}"/>'
    file = folder / "blade.xml"
    file.write_text(
        "<mujoco><worldbody><body><joint axis='0 0 1'/>"
        + capsule.format("blade", "0 0 0 0 0 0.3", 0.1)
        + "<body pos='0 0 2'><joint axis='0 1 0'/><body><joint axis='1 0 0'/>"
        + capsule.format("hand", "0 0 0.1 0 0 0.2", 0.02)
        + "<site name='tcp' pos='0 0 0.3'/></body></body></body></worldbody></mujoco>"
    )
    arm = htcp_jax.load_robot(file)
    blade = np.array(list(product((-0.09, 0.09), (-0.005, 0.005), (0.05, 0.25))))
    pieces = body_pieces([make_piece(blade), make_piece(np.zeros((1, 3)))], np.array([0.11, 0.0]))
    return dataclasses.replace(arm, pieces=jax.tree.map(jnp.asarray, pieces))


@pytest.mark.parametrize("kind", ["ball", "points"])
def test_a_piece_that_turns_about_the_axis_of_its_capsule_is_not_called_clear(kind, tmp_path):
    arm = blade_on_its_hinge(tmp_path)
    at = np.array([0.0, 0.08, 0.15])
    ball = Rod(at, at, np.array(0.001))
    obstacle = fixtures(arm, [("ball", ball)]) if kind == "ball" else cloud_of(at[None], 1e-3)
    if kind == "ball":
        obstacle = dataclasses.replace(obstacle, is_checked=jnp.ones_like(obstacle.is_checked))
    a, b = jnp.array([-1.5, 0, 0]), jnp.array([1.5, 0.0, 0.0])
    near, far = (float(minimum_clearance(arm, (obstacle,), WHERE, jnp.array([x, 0, 0]))) for x in (np.pi / 2, 0.0))
    assert near < 0 < far
    proved = quick_jit(lambda a, b: prove(Scene(arm, (obstacle,)), WHERE, a, b, kept=0.99))
    assert int(proved(a, b).verdict) == SegmentStatus.IN_COLLISION
    beside = proved(jnp.array([-0.3, 0, 0]), jnp.array([0.3, 0, 0]))
    assert int(beside.verdict) == SegmentStatus.VALID
    if kind == "ball":  # 50 mm away from the blade at all of the path
        assert int(beside.queries) == 1 and float(beside.clearance) == pytest.approx(LIMIT_M)


def test_a_witness_is_a_point_of_the_cloud_also_where_rounding_meets_the_limit(tmp_path):
    arm, at = blade_on_its_hinge(tmp_path), np.array([0.0, 0.08, 0.15])
    for cover in np.linspace(0.004, 0.0041, 30):
        touch = contacts(arm, (cloud_of(at[None], cover),), WHERE, jnp.zeros(3))
        assert float(touch.distance[0]) == pytest.approx(LIMIT_M) and np.abs(touch.witness[0] - at).max() < 1e-9


def test_blends_allow_for_a_piece_that_turns_about_its_capsule_s_axis(tmp_path):
    arm = blade_on_its_hinge(tmp_path)
    levers = arm_at(arm, np.zeros((1, 3)))
    moved = levers.moved(displacement_bound(levers, np.zeros((1, 3)), np.array([[0.5, 0.0, 0.0]])))
    corner = np.array([0.09, 0.005, 0.0])
    turned = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]]) @ corner
    assert np.linalg.norm(turned - corner) <= moved.bodies[0] <= 0.06
