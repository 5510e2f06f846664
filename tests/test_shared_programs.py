"""Executables that arms, cells and parts share: the arm's structure is data, and padding changes no result."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import test_known_rows
import toy
from test_kept_executables import key_of, traced

from htcp_jax.clearance import Scene, contacts, is_clear, rows_of
from htcp_jax.clearance.distance.half_spaces import half_spaces
from htcp_jax.clearance.distance.solids import Box
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.obstacles.obstacle import slopes
from htcp_jax.clearance.obstacles.obstacles import clearance_rows
from htcp_jax.clearance.obstacles.of_workpiece import Interior, with_interior
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.cli import typical_jobs
from htcp_jax.model import Robot
from htcp_jax.model.robot import FAR_M
from htcp_jax.model.scenario import stack
from htcp_jax.motion.measured_rows import MeasuredRows
from htcp_jax.motion.start_check import start_contact
from htcp_jax.motion.step_functions import ADVANCE, PROVE
from htcp_jax.reachability.obstruction import obstruction


def cell(robot: Robot, points: int, boxes: int, pairs: tuple[tuple[int, int], ...]) -> Scene:
    """A cloud, boxes, and pairs of bodies."""
    solids = [(str(k), Box(np.eye(3), np.array([2.0, k, 0.0]), np.full(3, 0.1))) for k in range(boxes)]
    cloud = cloud_of(np.random.default_rng(0).normal(size=(points, 3)), 0.001)
    return Scene(robot, (cloud, fixtures(robot, solids), SelfCollision(pairs)))


def another_arm() -> Robot:
    """The toy arm with a slide in place of a hinge, other links, and one more of the bodies."""
    arm = toy.robot()
    rows = {name: jnp.concatenate([getattr(arm, name), getattr(arm, name)[-1:]]) for name in ("capsule_p", "capsule_q")}
    rows |= {
        "capsule_radius": jnp.append(arm.capsule_radius, 0.1),
        "on_tool": jnp.zeros((len(arm.capsule_link) + 1, 2)),
    }
    links, names = (0, *arm.capsule_link), (*arm.capsule_names, "more")
    return replace(arm, **rows, capsule_link=links, capsule_names=names, slides=(True, *arm.slides[1:]))


def test_arms_parts_and_cells_of_the_same_sizes_share_executables():
    arm, other = toy.robot(), another_arm()
    scenes = cell(arm, 20, 1, ((2, 0),)), cell(other, 3000, 3, ((3, 0), (3, 1)))
    assert all(len({key_of(each, scene=scene) for scene in scenes}) == 1 for each in (ADVANCE, PROVE))
    cloud, solids, pairs = scenes[0].obstacles
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
    interior = Interior(half_spaces(np.vstack([np.eye(3), -np.eye(3)]), np.ones(6), corners))
    inlets = Scene(arm, with_interior(scenes[0].obstacles)), Scene(arm, (cloud, solids, pairs, interior))
    assert len({key_of(PROVE, scene=scene) for scene in inlets}) == 1
    few, many, more = (key_of(ADVANCE, scene=cell(arm, points, 1, ((2, 0),))) for points in (4096, 4097, 20_000))
    assert few != many == more


def test_padding_changes_no_clearance_and_is_far_from_everything():
    """Rows of a cloud, solids and pairs, of capsules and pieces; of an arm with a body fewer than in the tables."""
    plain, where = test_known_rows.scene(), jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), test_known_rows.paths()[0])
    bodies = len(plain.robot.capsule_link) - 1
    own = {
        name: getattr(plain.robot, name)[:bodies] for name in ("capsule_p", "capsule_q", "capsule_radius", "on_tool")
    }
    own |= {"capsule_link": plain.robot.capsule_link[:bodies], "capsule_names": plain.robot.capsule_names[:bodies]}
    robot = replace(plain.robot, **own, pieces=jax.tree.map(lambda leaf: leaf[:bodies], plain.robot.pieces))
    cloud, solids, pairs = plain.obstacles
    pairs = SelfCollision(tuple(pair for pair in pairs.pairs if max(pair) < bodies))
    plain = Scene(robot, (cloud, replace(solids, is_checked=solids.is_checked[:, :bodies]), pairs))
    padded, x = plain.for_programs(), jnp.asarray(test_known_rows.paths()[1][:40])
    rows, known_rows = plain.rows_within(padded), rows_of(*plain[:2])

    def measured(scene: Scene, *queries) -> list:
        """Return the results of several programs; one program for all would take twice as long to compile."""
        each = (lambda x, query=query: query(*scene[:2], where, x) for query in queries)
        return [made_once.quick_jit(partial(jax.lax.map, at))(x) for at in each]

    @made_once.quick_jit
    @jax.vmap
    def gradients(x, touch):
        return slopes(plain.robot, x, known_rows, touch.normal, touch.point, touch.witness)

    (known,) = measured(plain, contacts)
    found, near, padded_clear = measured(padded, contacts, clearance_rows, is_clear)
    clear = (known.distance > 0).all(axis=1)
    for name in ("distance", "point", "normal", "radius", "plane"):
        np.testing.assert_allclose(getattr(found, name)[:, rows], getattr(known, name), atol=1e-12, err_msg=name)
    np.testing.assert_allclose(near.gradient[:, rows], gradients(x, known), atol=1e-9)
    assert (np.delete(np.asarray(found.distance), rows, axis=1) > FAR_M / 2).all()
    np.testing.assert_array_equal(clear, padded_clear)
    assert len(rows) < found.distance.shape[1] and 0 < clear.sum() < 40


def test_the_reason_why_a_plan_fails_compiles_nothing_for_another_arm():
    """The body at a failed target, the contact at the start, and the nearest solid or body of every row."""

    def reasons(scene: Scene):
        known, others = (scene.robot, toy.workpiece(), toy.scenario()), scene.obstacles[1:]
        found = obstruction(*known, np.array(toy.START), 4, toy.SETTINGS, others)
        near = start_contact(*known, obstacles=others)
        measured = MeasuredRows(scene.robot, others, stack([known[2]]), found.x[None])
        return found.description, near, [measured.other(row, 0) for row in range(measured.distance.shape[1])]

    reasons(cell(toy.robot(), 20, 2, ((1, 0),)))
    scene = cell(another_arm(), 3000, 3, ((2, 0), (2, 1)))
    (description, near, nearest), functions = traced(lambda: reasons(scene))
    assert functions == 0
    assert description.startswith("inverse kinematics") and near[1:3] == ("capsule more", "the workpiece")
    assert nearest == [*["the fixture '0'"] * 3, "capsule forearm", "capsule tool"]


@pytest.mark.parametrize("joints", [6, 7, 8])
def test_a_typical_arm_has_the_sizes_that_imported_arms_with_a_torch_have(joints):
    """As the KR 16-2, UR5e and iiwa 7, with meshes and four bodies of a torch: 15, 12 and 18 bodies."""
    robot = typical_jobs._arm(joints)
    own_pairs = SelfCollision(typical_jobs._pairs(robot)[: typical_jobs.PAIRS[joints]])
    scene = Scene(robot, (own_pairs,)).for_programs()
    bodies, pairs = (16, (128, 64, 8)) if joints == 6 else (24, (160, 80, 8))
    table = scene.obstacles[0].table
    assert (scene.robot.dof, len(scene.robot.capsule_link)) == (joints, bodies)
    assert (len(table.first), *table.numbers.shape) == pairs
    assert scene.robot.pieces.piece.vertices.shape == (bodies, 96, 3)
    assert scene.robot.pieces.planes.shape == (bodies, 384, 4)


@pytest.mark.parametrize("joints", [6, 8])
def test_padded_closely_as_on_a_gpu_an_arm_has_few_more_bodies_and_pairs_than_its_own(joints):
    robot = typical_jobs._arm(joints)
    own_pairs = SelfCollision(typical_jobs._pairs(robot)[:35])
    close = Scene(robot, (own_pairs,)).for_programs(closely=True)
    assert 0 <= len(close.robot.capsule_link) - len(robot.capsule_link) < 4
    table = close.obstacles[0].table
    assert 0 <= len(table.first) - 35 < 16 and table.is_pair.sum() == 35
    np.testing.assert_array_equal(table.first[:35], [pair[0] for pair in own_pairs.pairs])
