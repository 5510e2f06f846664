"""Proofs of motions: proven joint paths hold at a thousand samples, refuted ones fail at the reported place."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from made_once import prove
from sphere_references import Where, place
from test_joint_path import rail

from htcp_jax.clearance import Scene
from htcp_jax.clearance.distance.solids import HalfSpace
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.proof.bisection import PathVerdict, Proof
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, JointSweep, tcp_sweep
from htcp_jax.clearance.proof.motion_proof import DEEPEST, Tube
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model.kinematics import jacobian, tcp_position
from htcp_jax.spec import GP50
from htcp_jax.status import SegmentStatus
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall

PLACES = 1000
_PROVEN = made_once.quick_jit(prove)
_TCP, _JACOBIAN = made_once.quick_jit(tcp_position), made_once.quick_jit(jacobian)


def tcp(x):
    return np.asarray(_TCP(made_once.robot(), jnp.asarray(x)))


def straight(a, b, places=PLACES):
    """Samples of the joint path, including its ends."""
    return np.asarray(a) + np.linspace(0, 1, places)[:, None] * (np.asarray(b) - np.asarray(a))


def proof_of(where, a, b, around=None, deepest=DEEPEST):
    found = _PROVEN(Scene(*made_once.scene()), where, a, b, around, deepest=np.int64(deepest), kept=0.5)
    return Proof(*(leaf.item() for leaf in found))


def tube(start, end, radius):
    return Tube(jnp.asarray(start, float), jnp.asarray(end, float), jnp.asarray(radius, float))


def off_line(start, end, points):
    """Distances of points (n, 3) to the segment from start to end, in numpy."""
    line = end - start
    along = np.clip((points - start) @ line / (line @ line or 1.0), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * line, axis=1)


@cache
def motions():
    """Motions (where, a, b, tube) of all lengths from recorded configurations and from the start.

    The tubes contain some of them: around the line from end to end, reversed, or around a point.
    """
    rng, found = np.random.default_rng(0), []
    for k in range(0, 200, 2):
        where, x = place(k)
        a = np.asarray(x) if k % 4 else np.array(made_once.START)
        step = 10.0 ** rng.uniform(-3, -0.3) * rng.normal(size=6)
        if k % 3 == 0:  # the TCP hardly moves, and reverses
            jac = np.asarray(_JACOBIAN(made_once.robot(), jnp.asarray(a)))
            step -= 0.9 * np.linalg.pinv(jac) @ jac @ step
        start, end = tcp(a), tcp(a + step)
        length = np.linalg.norm(end - start)
        radius = length * 10.0 ** rng.uniform(-3, 0.7)
        if k % 10 == 8:
            start, end = end, start
        if k % 10 == 4:
            end, radius = start, length * rng.uniform(0.5, 2.0)
        found.append((where, jnp.asarray(a), jnp.asarray(a + step), tube(start, end, radius)))
    return found


@cache
def proofs():
    return [proof_of(*motion) for motion in motions()]


def those(*verdicts):
    """Motions with one of these verdicts, and their proofs; at least five."""
    found = [(m, proof) for m, proof in zip(motions(), proofs(), strict=True) if proof.verdict in verdicts]
    assert len(found) >= 5
    return found


@pytest.mark.parametrize("model", ["gp50", "rail"])
def test_the_tcp_bends_no_more_than_the_bound(model, tmp_path):
    """Check random points of the interval by autodiff along the joint path, for hinges and a slide."""
    robot = made_once.robot() if model == "gp50" else load_robot(rail(tmp_path), limits="model")
    n, rng = len(robot.slides), np.random.default_rng(2)
    along = lambda x, rates: jax.jacfwd(jax.jacfwd(lambda s: tcp_position(robot, x + s * rates)))(0.0)  # noqa: E731
    second, sweep = made_once.quick_jit(along), made_once.quick_jit(tcp_sweep)
    tightest, alone = 0.0, 0.0
    for _ in range(300):
        x, half = rng.uniform(-2, 2, n), rng.uniform(0, 0.5) * rng.integers(0, 2)
        rates = rng.normal(size=n) * rng.integers(0, 2, n)
        most = float(sweep(robot, jnp.asarray(x), JointSweep(jnp.asarray(rates), half)).bend)
        there = x + half * rates * rng.uniform(-1, 1)
        bend = float(np.linalg.norm(second(jnp.asarray(there), jnp.asarray(rates))))
        assert bend <= most + 1e-9
        part = bend / max(most, 1e-9)
        tightest = max(tightest, part)
        alone = max(alone, part if np.count_nonzero(rates) > 1 and half else 0.0)
    assert tightest > 0.99 and alone > 0.5  # with a single hinge the bound is attained, at the configuration itself


def test_a_slide_does_not_bend_the_way_of_the_tcp(tmp_path):
    """Check a slide alone, and before a hinge, where it does not change the bound."""
    robot, sweep = load_robot(rail(tmp_path), limits="model"), made_once.quick_jit(tcp_sweep)
    of = lambda *rates: float(sweep(robot, jnp.zeros(3), JointSweep(jnp.array(rates), 0.3)).bend)  # noqa: E731
    assert of(1.0, 0.0, 0.0) == 0.0 and of(1.0, 0.5, 0.2) == of(0.0, 0.5, 0.2) > 0


def test_a_proven_motion_is_clear_in_its_tube_and_advances_at_a_thousand_places():
    lines = 0
    for (where, a, b, around), proof in those(PathVerdict.VALID):
        x = straight(a, b)
        D, points = made_once.measured(where, x)
        assert 0 < proof.clearance <= D.min() + ROUNDING_M
        start, end = np.asarray(around.start), np.asarray(around.end)
        assert off_line(start, end, points).max() <= float(around.radius)
        assert (np.diff(points @ (end - start)) >= -1e-15).all()
        assert proof.place == 1.0 and proof.queries >= 1
        lines += (start != end).any()
    assert lines > 5


def test_a_refuted_motion_is_wrong_where_it_says():
    for (where, a, b, _), proof in those(PathVerdict.IN_COLLISION):
        assert made_once.measured(where, np.asarray(a + proof.place * (b - a))[None])[0][0] <= 0
    for (_, a, b, around), proof in those(PathVerdict.OFF_PATH):
        point = tcp(a + proof.place * (b - a))
        assert off_line(np.asarray(around.start), np.asarray(around.end), point[None])[0] > float(around.radius)
    for (_, a, b, around), proof in those(PathVerdict.REVERSES):
        line, h = np.asarray(around.end - around.start), 1e-7
        before, after = (tcp(a + (proof.place + side * h) * (b - a)) for side in (-1, 1))
        assert (after - before) @ line < 0


def test_nothing_is_left_open_but_what_grazes():
    """Check that no motion is undecided, and that a motion cut just after the refuted place is not proven."""
    assert not [proof for proof in proofs() if proof.verdict == PathVerdict.UNDECIDED]
    for (where, a, b, around), proof in those(PathVerdict.OFF_PATH, PathVerdict.IN_COLLISION, PathVerdict.REVERSES):
        assert 0 < proof.place < 1
        again = proof_of(where, a, a + proof.place * (b - a) * (1 + 1e-6), around)
        assert again.verdict != PathVerdict.VALID


def test_with_fewer_halvings_what_needs_more_is_open_and_nothing_else_changes():
    opened = 0
    for (where, a, b, around), proof in zip(motions(), proofs(), strict=True):
        again = proof_of(where, a, b, around, deepest=1)
        assert again.depth <= 1 and again.queries <= 3
        assert again == proof if proof.depth <= 1 else again.verdict == PathVerdict.UNDECIDED
        opened += again.verdict == PathVerdict.UNDECIDED
    assert 5 < opened < 95


def test_an_interval_that_is_too_long_is_divided_at_once_into_as_many_parts_as_are_needed():
    """Turn the base above floors at different heights, where all parts of the path are as near to the floor."""
    robot, where, x = made_once.gp50(), made_once.nominal(), jnp.asarray(made_once.START)
    depths = set()
    for height in (-0.5, 0.0, 0.2, 0.25):
        floor = fixtures(robot, [("floor", HalfSpace(np.array([0.0, 0.0, 1.0]), np.array(height)))])
        proof = _PROVEN(Scene(robot, (floor,)), where, x, x + jnp.eye(6)[0] * 2.0)
        assert proof.verdict == PathVerdict.VALID
        assert proof.queries == (1 + 2**proof.depth if proof.depth else 1)
        depths.add(int(proof.depth))
    assert depths == {0, 1, 2, 3}


def test_what_touches_its_tube_all_along_is_open():
    """Check an arm at rest with its TCP exactly on the tube: undecided, never proven."""
    where, start = place(0)[0], jnp.asarray(made_once.START)
    here = tcp(start)
    line = tube(here + np.array([0, 0, 0.25]), here + np.array([1, 0, 0.25]), 0.25)
    proof = proof_of(where, start, start, line)
    assert proof.verdict == PathVerdict.UNDECIDED
    assert proof_of(where, start, start, tube(line.start, line.end, 0.26)).verdict == PathVerdict.VALID
    assert proof_of(where, start, start, tube(line.start, line.end, 0.24)).verdict == PathVerdict.OFF_PATH


@pytest.mark.parametrize("turn", [0.3, 1.5, 1.65, 2.5])
def test_a_turn_of_the_base_leaves_its_tangent_and_turns_back_where_a_circle_does(turn):
    """Check a turn by +-`turn`, far from any workpiece, along its tangent.

    In the middle the TCP is on the line and advances. At the ends it is r (1 - cos turn) away from the line, and beyond
    a right angle it reverses.
    """
    where, start, first = (
        Where(jnp.eye(4).at[:3, 3].set(1e3), jnp.array([1.0, 0, 0, jnp.inf])),
        made_once.START,
        np.eye(6)[0],
    )
    here, (r, h) = tcp(start), (np.hypot(*tcp(start)[:2]), 1e-6)
    forwards = (tcp(start + h * first) - tcp(start - h * first)) / (2 * h * r)
    off = r * (1 - np.cos(turn))
    for radius, verdict in (
        (0.999 * off, PathVerdict.OFF_PATH),
        (1.001 * off, PathVerdict.VALID),
        (10 * r, PathVerdict.VALID),
    ):
        around = tube(here - 2 * r * forwards, here + 2 * r * forwards, radius)
        proof = proof_of(where, jnp.asarray(start - turn * first), jnp.asarray(start + turn * first), around)
        beyond = turn > np.pi / 2
        assert proof.verdict in ({PathVerdict.REVERSES, PathVerdict.OFF_PATH} if beyond else {verdict})
        assert proof.verdict != PathVerdict.OFF_PATH or verdict == PathVerdict.OFF_PATH


def test_with_an_infinite_radius_the_tcp_may_be_anywhere():
    """Check a distant, reversed line: the same result as without a tube."""
    clear = 0
    for where, a, b, around in motions()[::3]:
        anywhere = tube(around.end + 1.0, around.start, np.inf)
        with_tube = proof_of(where, a, b, anywhere)
        assert with_tube == proof_of(where, a, b)
        clear += with_tube.verdict == PathVerdict.VALID
    assert 5 <= clear < len(motions()[::3])


def test_about_a_point_the_tcp_may_move_any_way():
    """Check motions that reverse on their line: valid in a ball that contains them, if they are clear."""
    turned = 0
    for (where, a, b, _), _ in those(PathVerdict.REVERSES):
        points = made_once.measured(where, straight(a, b))[1]
        middle = points.mean(axis=0)
        radius = np.linalg.norm(points - middle, axis=1).max()
        is_clear = proof_of(where, a, b).verdict == PathVerdict.VALID
        ball, tight = tube(middle, middle, 1.01 * radius), tube(middle, middle, 0.9 * radius)
        assert (proof_of(where, a, b, ball).verdict == PathVerdict.VALID) == is_clear
        assert proof_of(where, a, b, tight).verdict != PathVerdict.VALID
        turned += is_clear
    assert turned >= 5


def test_a_motion_and_its_reverse_are_clear_together_but_one_of_them_turns_back():
    for (where, a, b, around), _ in those(PathVerdict.VALID)[::3]:
        if bool((around.start == around.end).all()):
            continue
        assert proof_of(where, b, a, around).verdict == PathVerdict.REVERSES
        assert proof_of(where, b, a, Tube(around.end, around.start, around.radius)).verdict == PathVerdict.VALID


def test_the_verdicts_are_those_that_a_plan_records():
    assert all(SegmentStatus[one.name] == one.value for one in PathVerdict)
    own = {"NOT_CHECKED", "WRONG_START", "SAMPLED", "REDUCED_MARGIN"}
    assert {status.name for status in SegmentStatus} - {one.name for one in PathVerdict} == own


def test_another_engine_finds_nothing_that_touches_on_a_proven_motion():
    """Compare with MuJoCo at 100 samples of each: its minimum clearance is at least the guaranteed one."""
    duct, arm = made_once.duct(), MujocoArm(GP50, 0.0, "simulation")
    wall = Wall(np.asarray(duct.cloud), "hull")
    for (where, a, b, _), proof in those(PathVerdict.VALID)[::4]:
        T = np.asarray(where.T_world_workpiece)
        scene = CheckedScene(arm, wall, T[:3, :3], T[:3, 3], duct.interior_depth_m)
        assert scene.at(straight(a, b, 100)).clearance.min() >= proof.clearance - ROUNDING_M
