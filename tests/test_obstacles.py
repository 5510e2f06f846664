"""Obstacles of other packages, and the arm's own bodies: measured, proven and planned with like the workpiece."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
from own_obstacles import Floor

from htcp_jax.clearance import Obstacle, Scene, clearance, clearances, contacts, is_clear, rows_of
from htcp_jax.clearance.obstacles.contact_model import hold_contacts, predict_distances
from htcp_jax.clearance.obstacles.obstacle import bodies_at
from htcp_jax.clearance.obstacles.obstacles import all_clear, clearance_rows, free_radius
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.clearance.proof.motion_proof import proven_clear
from htcp_jax.model.kinematics import capsule_segments

PAIRS = ((7, 1), (7, 2), (6, 1), (5, 0))  # the tool and the wrist against the lower arm


@cache
def obstacles() -> tuple[Obstacle, ...]:
    return (*make_obstacle(made_once.duct()), Floor(jnp.asarray(0.0)), SelfCollision(PAIRS))


@cache
def jitted(function):
    return jax.jit(function)


@cache
def configurations() -> np.ndarray:
    """Random configurations, then some near the start (M, 6)."""
    robot = made_once.robot()
    return np.concatenate(
        [made_once.configurations(robot, 60), made_once.configurations_near(made_once.START, 40, 0.6)]
    )


def by_hand(x) -> np.ndarray:
    """Distances of the floor's and the pairs' rows by numpy: capsule ends, and axes cut into 400 pieces."""
    robot = made_once.robot()
    p, q = (np.asarray(end) for end in jitted(capsule_segments)(robot, jnp.asarray(x)))
    radius = np.asarray(robot.capsule_radius)
    floor = np.where(np.array(robot.capsule_link) < 0, 10.0, np.minimum(p[:, 2], q[:, 2]) - radius)
    along = np.linspace(0, 1, 401)[:, None]
    axes = p[:, None] + along[None] * (q - p)[:, None]
    apart = [np.linalg.norm(axes[a][:, None] - axes[b][None], axis=2).min() - radius[a] - radius[b] for a, b in PAIRS]
    return np.concatenate([floor, apart])


def test_every_kind_is_an_obstacle_and_the_rows_are_those_of_the_bodies_and_of_the_pairs():
    robot = made_once.robot()
    assert all(isinstance(each, Obstacle) for each in obstacles())
    rows = rows_of(robot, obstacles())
    assert rows.body == (*range(8), *(a for a, _ in PAIRS))
    assert rows.other == (*[-1] * 8, *(robot.capsule_link[b] for _, b in PAIRS))


def test_a_bodys_row_is_the_nearest_of_all_kinds_and_a_pair_has_its_own():
    robot, where = made_once.robot(), made_once.nominal()
    decided = 0
    for x in configurations():
        own = by_hand(x)
        part = np.asarray(jitted(clearances)(robot, obstacles()[:2], where, x))
        found = np.asarray(jitted(clearances)(robot, obstacles(), where, x))
        np.testing.assert_allclose(found[:8], np.minimum(part, own[:8]), atol=1e-14)
        np.testing.assert_allclose(found[8:], own[8:], atol=3e-3)  # numpy cuts the axes into pieces of a few mm
        assert (found[8:] <= own[8:] + 1e-12).all()
        np.testing.assert_allclose(jitted(clearance)(robot, obstacles(), where, x), found.min(), atol=1e-14)
        assert jitted(is_clear)(robot, obstacles(), where, x) == (found.min() > 0)
        decided += (own[:8] < part).any() + (found[8:].min() < found[:8].min())
    assert decided > 20


def test_the_gradient_is_that_of_the_distance_also_where_both_bodies_move():
    robot, where, h = made_once.robot(), made_once.nominal(), 1e-6
    for x in configurations()[::4]:
        rows = jitted(clearance_rows)(robot, obstacles(), where, x)
        steps = h * np.eye(6)
        ends = [[np.asarray(jitted(clearances)(robot, obstacles(), where, x + s * d)) for d in steps] for s in (1, -1)]
        slope = ((np.array(ends[0]) - np.array(ends[1])) / (2 * h)).T
        kink = np.abs(slope - rows.gradient).max(axis=1) > 1e-4  # another point, or another kind, is nearest next to x
        assert kink.mean() < 0.2
        np.testing.assert_allclose(np.asarray(rows.gradient)[~kink], slope[~kink], atol=1e-4)


def test_a_contact_held_never_predicts_less_than_the_truth_and_the_truth_where_it_was_seen():
    robot, where = made_once.robot(), made_once.nominal()
    rows, rng = rows_of(robot, obstacles()), np.random.default_rng(0)
    hold = jax.jit(lambda robot, x, touch: hold_contacts(robot, x, rows, touch))
    predict = jax.jit(lambda robot, x, held: predict_distances(robot, x, rows, held)[0])
    for x in configurations()[60::2]:
        touch = jitted(contacts)(robot, obstacles(), where, x)
        held = hold(robot, jnp.asarray(x), touch)
        np.testing.assert_allclose(predict(robot, x, held), touch.distance, atol=1e-12)
        for near in x + rng.uniform(-0.1, 0.1, (4, 6)):
            truth = np.asarray(jitted(clearances)(robot, obstacles(), where, near))
            predicted = np.asarray(predict(robot, near, held))
            assert (predicted >= truth - 1e-12)[~np.asarray(touch.plane)].all()
            assert (predicted >= truth - 1e-12)[8:].all()


def test_paths_are_clear_where_no_place_of_them_touches_any_kind():
    robot, where, scene = made_once.robot(), made_once.nominal(), Scene(made_once.robot(), obstacles())
    proven = jax.jit(lambda a, b: proven_clear(scene, where, a, b))
    verdicts, rng = [], np.random.default_rng(1)
    for x in configurations()[20:80]:  # the first forty are random, often in collision
        end = x + rng.uniform(-0.2, 0.2, 6)
        places = x + np.linspace(0, 1, 41)[:, None] * (end - x)
        truth = all(bool(jitted(is_clear)(robot, obstacles(), where, place)) for place in places)
        assert bool(jitted(all_clear)(robot, obstacles(), where, jnp.asarray(places))) == truth
        assert truth or not bool(proven(x, end))
        verdicts.append(bool(proven(x, end)))
        if truth:
            assert (np.asarray(jitted(free_radius)(robot, obstacles(), where, x)) > 0).all()
    assert 5 <= sum(verdicts) <= len(verdicts) - 5


def test_contacts_alone_answer_every_query():
    robot, where, floor = made_once.robot(), made_once.nominal(), Floor(jnp.asarray(0.0))
    for x in configurations()[:20]:
        bodies = bodies_at(robot, where, jnp.asarray(x))
        for query in ("smallest", "touches", "free_radius"):
            by_contacts = getattr(Obstacle, query)(floor, robot, where, bodies)
            np.testing.assert_array_equal(by_contacts, getattr(floor, query)(robot, where, bodies))
    along = jax.vmap(lambda x: bodies_at(robot, where, x))(jnp.asarray(configurations()[:20]))
    for body in range(len(robot.capsule_link)):
        requested = robot, where, along, jnp.asarray(body), jnp.ones(20, bool)
        assert bool(Obstacle.touches_along(floor, *requested)) == bool(floor.touches_along(*requested))
