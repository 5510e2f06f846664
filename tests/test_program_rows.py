"""Rounded corners keep every row of a task: its slack bounds the displacement, by MuJoCo, for each kind of row."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from test_joint_path import rail
from test_row_proof import PATHS, SETTINGS, arm, configurations, held, rows

from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model.kinematics import link_poses
from htcp_jax.model.task_rows import Feature
from htcp_jax.trajectory.displacement import arm_at, displacement_bound
from htcp_jax.trajectory.row_slack import slack_of_rows
from htcp_jax.validation.records import data_of
from htcp_jax.validation.task_check import PartPose, hold_between

SHARES = np.linspace(0, 1, 9)  # of a segment, where it is checked
SIZES = np.geomspace(0.3, 1e-7, 60)  # of displacements, tried in turn
ON = np.ones(PATHS, bool)
_POSES = made_once.quick_jit(jax.vmap(link_poses, (None, 0)))


@cache
def beside():
    """Slack of the rows along the segments of `test_row_proof`'s configurations, and the arm there."""
    task, goals, _ = held()
    left = slack_of_rows(task, made_once.robot(), configurations(), np.stack([goals[:-1], goals[1:]], axis=1), ON)
    return left, arm_at(made_once.robot(), configurations()[:-1], left.features)


def holds(row: int, segment_status: int, displacement: np.ndarray) -> bool:
    """Return True if a row holds all along a displaced segment, by MuJoCo."""
    _, _, part = held()
    a, b = configurations()[segment_status : segment_status + 2]
    places = [
        PartPose(np.eye(3), np.zeros(3), data_of(part), np.full(len(SHARES), k))
        for k in (segment_status, segment_status + 1)
    ]
    x = a + SHARES[:, None] * (b - a) + displacement
    return bool(hold_between(rows()[row : row + 1], arm(), x, *places, SETTINGS).all())


def test_a_row_holds_on_every_leg_that_is_displaced_by_no_more_than_is_left_of_it():
    left, there = beside()
    draws = np.random.default_rng(4).normal(size=(PATHS, 6))
    nudges = SIZES[:, None, None] * draws
    within = np.broadcast_to(np.abs(np.diff(configurations(), axis=0)), nudges.shape)
    moved = there.moved(displacement_bound(there, within, nudges)).features
    fits = (left.taken(moved) <= left.left) & (left.left > 0)
    for row in range(len(rows())):
        known = np.flatnonzero(fits[:, :, row].any(axis=0))
        largest = SIZES[fits[:, known, row].argmax(axis=0)]
        assert len(known) >= 3, str(rows()[row])
        for segment_status, size in zip(known, largest, strict=True):
            assert holds(row, segment_status, size * draws[segment_status]), (str(rows()[row]), segment_status)
        assert not all(
            holds(row, segment_status, 30 * size * draws[segment_status])
            for segment_status, size in zip(known, largest, strict=True)
        )


def test_off_the_path_anything_may_be_taken():
    task, goals, _ = held()
    left = slack_of_rows(task, made_once.robot(), configurations(), np.stack([goals[:-1], goals[1:]], axis=1), ~ON)
    assert np.isinf(left.left).all() and np.isinf(left.apart).all()
    assert (left.taken(np.full((PATHS, len(left.features)), 1e3)) <= left.left).all()


def test_a_row_that_looks_past_its_place_has_nothing_left():
    left, _ = beside()
    looks = np.isfinite(left.apart).any(axis=0)
    far = np.full((PATHS, len(left.features)), 1.0)  # more than the feature's distance
    assert looks.any() and np.isinf(left.taken(far)[:, looks]).all()


FEATURES = {
    "the tool's axis": Feature(None, (0.0, 0.0, 1.0), is_direction=True),
    "an axis of link 4": Feature(3, (0.0, 0.6, 0.8), is_direction=True),
    "a point next to link 4": Feature(3, (0.3, -0.2, 0.5)),
}


@pytest.mark.parametrize("model", ["gp50", "rail"])
def test_no_feature_is_displaced_further_than_its_bound_by_points_of_a_rigid_body(model, tmp_path):
    """Bound on the displacement of features, by points of a rigid body.

    Random configurations and displacements; a direction is the difference of two points.
    """
    robot = made_once.robot() if model == "gp50" else load_robot(rail(tmp_path), limits="model")
    last, n = len(robot.slides) - 1, len(robot.slides)
    features = tuple(each._replace(link=last if each.link is None else min(3, last)) for each in FEATURES.values())
    rng = np.random.default_rng(1)
    x, within, displacement = (
        rng.uniform(-1, 1, (30, n)),
        rng.uniform(0, 0.05, (30, n)),
        rng.normal(scale=0.02, size=(30, n)),
    )
    there = arm_at(robot, x, features)
    most, tightest = there.moved(displacement_bound(there, within, displacement)).features, 0.0
    for _ in range(20):
        near = x + within * rng.choice([-1.0, 1.0, 0.3], (30, n))
        moved = np.linalg.norm(ends(robot, features, near + displacement) - ends(robot, features, near), axis=2)
        assert (moved <= most + 1e-12).all()
        tightest = max(tightest, float((moved / np.maximum(most, 1e-9)).max()))
    assert tightest > 0.8


def ends(robot, features, x) -> np.ndarray:
    """Features in the world frame, by the poses of their links."""
    T = np.asarray(_POSES(robot, jnp.asarray(x)))
    own = [T[:, each.link, :3, :3] @ np.array(each.vector) for each in features]
    place = [0.0 if each.is_direction else T[:, each.link, :3, 3] for each in features]
    return np.stack([a + b for a, b in zip(own, place, strict=True)], axis=1)
