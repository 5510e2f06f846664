"""Obstacles of other packages, and the arm's own bodies: measured, proven and planned with like the workpiece."""

from functools import cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from own_obstacles import Floor

from htcp_jax.clearance import Obstacle, Scene, clearances, contacts, is_clear, minimum_clearance, rows_of
from htcp_jax.clearance.obstacles import surely_collides
from htcp_jax.clearance.obstacles.contact_model import hold_contacts, predict_distances
from htcp_jax.clearance.obstacles.obstacle import Contacts, bodies_at
from htcp_jax.clearance.obstacles.obstacles import ClearanceRows, clearance_rows, free_radius
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.clearance.proof.motion_proof import RESOLUTION_M
from htcp_jax.device import Executor
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus

PAIRS = ((7, 1), (7, 2), (6, 1), (5, 0))  # the tool and the wrist against the lower arm


@cache
def obstacles() -> tuple[Obstacle, ...]:
    return (*make_obstacle(made_once.duct()), Floor(jnp.asarray(0.0)), SelfCollision(PAIRS))


ROWS = 100  # configurations per call, in all tests


class Answers(NamedTuple):
    """Answers to every query at a configuration."""

    clearances: jax.Array
    clearance: jax.Array
    is_clear: jax.Array
    free_radius: jax.Array
    rows: ClearanceRows
    contacts: Contacts
    ends: tuple


@cache
def _together(queries):
    return lambda *here: [query(*here) for query in queries]


def answers(queries, x, own=None) -> list:
    """Answers to queries at every x."""
    given = made_once.robot(), obstacles() if own is None else own, made_once.nominal()
    return made_once.in_rows(_together(queries), ROWS)(given, x)


@cache
def answered() -> Answers:
    """Answers to every query at all `configurations`."""
    ends = lambda robot, obstacles, where, x: capsule_segments(robot, x)  # noqa: E731
    queries = clearances, minimum_clearance, is_clear, free_radius, clearance_rows, contacts, ends
    return Answers(*answers(queries, configurations()))


@cache
def configurations() -> np.ndarray:
    """Random configurations, then some near the start (M, 6)."""
    robot = made_once.robot()
    return np.concatenate(
        [made_once.configurations(robot, 60), made_once.configurations_near(made_once.START, 40, 0.6)]
    )


def by_hand(p, q) -> np.ndarray:
    """Distances of the floor's and the pairs' rows by numpy: capsule ends, and 401 points of an axis to the other."""
    robot = made_once.robot()
    radius = np.asarray(robot.capsule_radius)
    floor = np.where(np.array(robot.capsule_link) < 0, 10.0, np.minimum(p[:, 2], q[:, 2]) - radius)
    along = np.linspace(0, 1, 401)[:, None]
    apart = [
        smallest_distance(p[a] + along * (q[a] - p[a]), p[b], q[b] - p[b]) - radius[a] - radius[b] for a, b in PAIRS
    ]
    return np.concatenate([floor, apart])


def smallest_distance(points, p, d) -> float:
    s = np.clip((points - p) @ d / max(d @ d, 1e-30), 0, 1)
    return np.linalg.norm(points - p - s[:, None] * d, axis=1).min()


def test_every_kind_is_an_obstacle_and_the_rows_are_those_of_the_bodies_and_of_the_pairs():
    robot = made_once.robot()
    assert all(isinstance(each, Obstacle) for each in obstacles())
    rows = rows_of(robot, obstacles())
    assert rows.body.tolist() == [*range(8), *(a for a, _ in PAIRS)]
    assert rows.others.tolist() == [*[-1] * 8, *(robot.capsule_link[b] for _, b in PAIRS)]


def test_a_bodys_row_is_the_nearest_of_all_kinds_and_a_pair_has_its_own():
    every = answered()
    (parts,) = answers((clearances,), configurations(), obstacles()[:2])
    decided = 0
    for p, q, part, found in zip(*every.ends, parts, every.clearances, strict=True):
        own = by_hand(p, q)
        np.testing.assert_allclose(found[:8], np.minimum(part, own[:8]), atol=1e-14)
        np.testing.assert_allclose(found[8:], own[8:], atol=3e-3)  # numpy cuts the axes into pieces of a few mm
        assert (found[8:] <= own[8:] + 1e-12).all()
        decided += (own[:8] < part).any() + (found[8:].min() < found[:8].min())
    assert decided > 20
    np.testing.assert_allclose(every.clearance, every.clearances.min(axis=1), atol=1e-14)
    np.testing.assert_array_equal(every.is_clear, every.clearances.min(axis=1) > 0)


def test_capsules_surely_collide_where_their_clearance_is_negative():
    (found,) = answers((surely_collides,), configurations())
    np.testing.assert_array_equal(found, answered().clearance < 0)


def verdicts(robot, obstacles, where, x, above):
    """Verdicts at a margin `above` D [m], by the distance and by the query alone."""
    here = robot, obstacles, where, x
    D = minimum_clearance(*here)
    margin = jnp.maximum(D + above, 0.0)
    return D > margin, is_clear(*here, margin)


ABOVE_M = (-1e-3, -1e-9, -1e-13, 0.0, 1e-13, 1e-9, 1e-3)


@pytest.mark.parametrize("kinds", [slice(0, 1), slice(0, 2), slice(2, 3), slice(3, 4), slice(0, 4)])
def test_clear_by_a_margin_is_the_verdict_of_the_distance_also_where_they_are_nearly_equal(kinds):
    x, above = np.repeat(configurations(), len(ABOVE_M), axis=0), np.tile(ABOVE_M, len(configurations()))
    given = made_once.robot(), obstacles()[kinds], made_once.nominal()
    truth, found = made_once.in_rows(verdicts, 7 * ROWS)(given, x, above)
    np.testing.assert_array_equal(found, truth)
    assert truth.sum() > 40 and (~truth).sum() > 40


def test_the_gradient_is_that_of_the_distance_also_where_both_bodies_move():
    steps = 1e-6 * np.concatenate([np.eye(6), -np.eye(6)])
    (ends,) = answers((clearances,), (configurations()[::4, None] + steps).reshape(-1, 6))
    for gradient, (ahead, behind) in zip(answered().rows.gradient[::4], ends.reshape(-1, 2, 6, 12), strict=True):
        slope = ((ahead - behind) / 2e-6).T
        kink = np.abs(slope - gradient).max(axis=1) > 1e-4  # another point, or another kind, is nearest next to x
        assert kink.mean() < 0.2
        np.testing.assert_allclose(gradient[~kink], slope[~kink], atol=1e-4)


def test_a_contact_held_never_predicts_less_than_the_truth_and_the_truth_where_it_was_seen():
    robot = made_once.robot()
    rows, rng = rows_of(robot, obstacles()), np.random.default_rng(0)
    hold = made_once.quick_jit(lambda robot, x, touch: hold_contacts(robot, x, rows, touch))
    predict = made_once.quick_jit(lambda robot, x, held: predict_distances(robot, x, rows, held)[0])
    xs, touches = jax.tree.map(lambda leaf: leaf[60::2], (configurations(), answered().contacts))
    near = xs[:, None] + np.stack([rng.uniform(-0.1, 0.1, (4, 6)) for _ in xs])
    (truths,) = answers((clearances,), near.reshape(-1, 6))
    for k, (x, places, truth) in enumerate(zip(xs, near, truths.reshape(len(xs), 4, -1), strict=True)):
        touch = jax.tree.map(lambda leaf, k=k: jnp.asarray(leaf[k]), touches)
        held = hold(robot, jnp.asarray(x), touch)
        np.testing.assert_allclose(predict(robot, x, held), touch.distance, atol=1e-12)
        for place, exact in zip(places, truth, strict=True):
            predicted = np.asarray(predict(robot, place, held))
            assert (predicted >= exact - 1e-12)[~np.asarray(touch.plane)].all()
            assert (predicted >= exact - 1e-12)[8:].all()


def test_paths_are_clear_where_no_sample_of_them_touches_any_kind():
    """Check the verdicts by `path_test: samples` of each kind alone and of all kinds, and the proofs."""
    rng = np.random.default_rng(1)
    starts = configurations()[:80]  # the first forty are random, often in collision
    ends = starts + rng.uniform(-1, 1, starts.shape) * np.tile([0.2, 0.2, 0.2, 3.0], 20)[:, None]
    inner = (starts[:, None] + np.linspace(0, 1, 41)[1:-1, None] * (ends - starts)[:, None]).reshape(-1, 6)
    inputs = lane_inputs(stack([made_once.nominal()]), *np.zeros((2, len(starts)), int))
    settings = Settings(path_test="samples", path_steps=40)
    truth = np.ones(len(starts), bool)
    for each in obstacles():
        own = answers((minimum_clearance,), inner, (each,))[0].reshape(len(starts), 39).min(axis=1) > 0
        checker = CollisionChecker(Executor(Scene(made_once.robot(), (each,)), settings), settings)
        np.testing.assert_array_equal(checker.path_clear(inputs, starts, ends), own)
        truth &= own
    checker = CollisionChecker(Executor(Scene(made_once.robot(), obstacles()), settings), settings)
    np.testing.assert_array_equal(checker.path_clear(inputs, starts, ends), truth)
    assert truth.any() and not truth.all()
    proven = checker.edges(inputs, starts, ends, resolution_m=RESOLUTION_M).verdict == SegmentStatus.VALID
    assert truth[proven].all() and 5 <= proven.sum() <= len(proven) - 5
    clear_ends = answers((is_clear,), starts)[0]
    assert (answered().free_radius[:80][clear_ends] > 0).all()


def test_contacts_alone_answer_every_query():
    robot, where, floor = made_once.robot(), made_once.nominal(), Floor(jnp.asarray(0.0))

    @partial(made_once.quick_jit, static_argnums=0)
    def answer(of, xs):
        along = jax.vmap(lambda x: bodies_at(robot, where, x))(xs)
        each = [jax.vmap(lambda bodies, query=query: getattr(of, query)(floor, robot, where, bodies))(along)
                for query in ("smallest", "free_radius")]  # fmt: skip
        return each

    xs = jnp.asarray(configurations()[:20])
    for by_contacts, own in zip(*map(jax.tree.leaves, (answer(Obstacle, xs), answer(Floor, xs))), strict=True):
        np.testing.assert_array_equal(by_contacts, own)
