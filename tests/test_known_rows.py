"""Rows that a proof knows: their bounds hold, they save measurements, and a proof by them is the plain one."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import toy
from test_narrow_phase import arm_with_pieces

from htcp_jax.clearance import Scene
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.obstacles.narrow_phase import decide_together
from htcp_jax.clearance.obstacles.obstacle import bodies_at
from htcp_jax.clearance.obstacles.self_collision import SelfCollision, make_self_collision
from htcp_jax.clearance.proof import known_rows
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.device import Executor
from htcp_jax.model import Robot
from htcp_jax.model.scenario import stack
from htcp_jax.motion.collision_checker import prove_call
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import PROVE, prove_path
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus


def cell(robot: Robot):
    """Solids of all simple kinds around the arm, a cloud, and the pairs of its own bodies."""
    solids = [
        ("floor", HalfSpace(np.array([0.0, 0.0, 1.0]), np.array(-0.2))),
        ("box", Box(np.eye(3), np.array([1.1, 0.4, 1.2]), np.array([0.2, 0.1, 0.4]))),
        ("post", Cylinder(np.eye(3), np.array([0.9, -0.5, 0.9]), np.array(0.1), np.array(0.9))),
        ("rod", Rod(np.array([0.5, 1.0, 1.2]), np.array([1.5, 0.6, 1.6]), np.array(0.05))),
    ]
    along = np.linspace(-0.5, 0.5, 12)
    wall = np.stack(np.meshgrid([1.3], along, along + 1.2), axis=-1).reshape(-1, 3)
    pairs = SelfCollision(make_self_collision(replace(robot, pieces=None)).pairs)
    return cloud_of(wall, 0.001), fixtures(robot, solids), pairs


@cache
def scene() -> Scene:
    """An arm with pieces, in a cell of three exact kinds of obstacles."""
    return Scene(arm_with_pieces(), cell(arm_with_pieces()))


@cache
def paths():
    """Inputs and ends of random joint paths of all lengths; every second one leads on from the one before."""
    rng, count = np.random.default_rng(0), 60
    nominal = jax.tree.map(np.asarray, made_once.nominal())
    nominal = replace(nominal, T_world_workpiece=np.eye(4), margin_m=np.array(0.02))
    a = made_once.configurations_near(made_once.START, count, 0.6)
    b = a + 10.0 ** rng.uniform(-3, 0, (count, 1)) * rng.normal(size=(count, 6))
    a, b = np.stack([a, b], axis=1).reshape(-1, 6), np.stack([b, 2 * b - a], axis=1).reshape(-1, 6)
    return lane_inputs(stack([nominal]), np.zeros(2 * count, int), np.zeros(2 * count, int)), a, b


def without_memory(*given):
    """The plain proof: every query measures all rows."""
    return prove_path(*given)._replace(remembering=None)


def test_a_proof_by_known_rows_is_the_plain_one():
    """Proofs against a cloud, solids and the arm's own bodies, decided by pieces where capsules are near.

    Margins alternate, as pieces are measured for capsules that are nearer than a distance that depends on the margin.
    """
    executor, rng = Executor(scene(), Settings()), np.random.default_rng(1)
    prove = replace(PROVE, compiles_quickly=True)
    count = len(paths()[1])
    how = {"kept": rng.choice([0.0, 0.5, 0.99], count), "resolution_m": rng.choice([-ROUNDING_M, 1e-5], count)}
    inputs = paths()[0]._replace(margin_m=np.resize([0.2, 0.0, 0.02], count))
    _, *tables = prove_call(executor.task, inputs, *paths()[1:], **how, deepest=12)
    plain_prove = replace(prove, function=without_memory, remembers=False)
    found, plain = (executor(one, *tables) for one in (prove, plain_prove))
    for name in ("verdict", "place", "queries", "depth"):
        np.testing.assert_array_equal(getattr(found, name), getattr(plain, name), name)
    assert (found.clearance >= plain.clearance - 1e-14).all()
    np.testing.assert_allclose(found.clearance, plain.clearance, rtol=0, atol=1e-12)
    verdicts = plain.verdict.tolist()
    assert verdicts.count(SegmentStatus.VALID) > 20 and verdicts.count(SegmentStatus.IN_COLLISION) > 10


def test_the_free_radius_at_another_configuration_is_within_its_bounds():
    """Compare with the free radius itself, for rows of capsules and of pieces, near and far."""

    own, where = scene(), jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), paths()[0])

    @made_once.quick_jit
    def measured(x):
        bodies = bodies_at(own.robot, where, x)
        queries = decide_together(*own[:2], where, bodies)
        free = jnp.concatenate([each.free_radius(own.robot, where, bodies) for each in queries])
        ends = known_rows._relative_ends(own.robot, known_rows._rows(*own[:2]), x, bodies)
        return known_rows.KnownRows(free, ends)

    bounds = made_once.quick_jit(lambda known, ends: known_rows._bounds(own.robot, where, known, ends))
    here, there = ([measured(x) for x in column] for column in paths()[1:])
    free = np.stack([other.free_radius for other in there])
    found = [bounds(known, other.ends) for known, other in zip(here, there, strict=True)]
    lower, upper = (np.stack(column) for column in zip(*found, strict=True))
    assert all(each.is_exact for each in own.obstacles)
    assert (lower <= free).all() and (free <= upper).all()
    near = free < 0.3
    assert (near & (lower > 0)).sum() > 50 and (near & (upper - lower < 0.01)).sum() > 50


def test_rows_that_decide_nothing_are_not_measured():
    """Move the cloud away after a first query: only rows that are measured again notice."""
    robot, where = toy.robot(), jax.tree.map(jnp.asarray, toy.scenario())
    x, near, far = jnp.asarray(toy.START), *(cloud_of(np.array([[0.4, 0.0, z]]), 0.0) for z in (0.5, 3.0))
    bodies = bodies_at(robot, where, x)

    @made_once.quick_jit
    def query(cloud, travel, is_recorded, known):
        rows, known = known_rows.free_radii(
            robot, (cloud,), where, x, bodies, [travel], [0 * travel], 0.0, is_recorded, known
        )
        return rows[0].free_radius, known

    nothing, little = known_rows.nothing_known(robot, (near,)), jnp.full(2, 0.01)
    first, known = query(near, little, False, nothing)
    away, lowest = query(far, little, False, nothing)[0], int(jnp.argmin(first))
    again = lambda *given: np.asarray(query(far, *given, known)[0])  # noqa: E731
    np.testing.assert_allclose(again(little, False), first, rtol=0, atol=3 * ROUNDING_M)
    np.testing.assert_allclose(again(little.at[1].set(1.0), False), [first[0], away[1]], rtol=0, atol=3 * ROUNDING_M)
    assert again(little, True)[lowest] == away[lowest]  # the smallest free radius is always measured


def test_rows_of_other_kinds_are_not_passed_on_to_other_proofs():
    robot, obstacles = made_once.scene()[:2]  # a cloud, whose distances are exact, and an interior
    known = known_rows.nothing_known(robot, obstacles)._replace(free_radius=jnp.ones(16))
    passed_on = known_rows.exact_alone(robot, obstacles, known).free_radius
    np.testing.assert_array_equal(passed_on, [1.0] * 8 + [-np.inf] * 8)
