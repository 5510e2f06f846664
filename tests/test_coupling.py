"""Joints that follow others: limits of the coordinates, and an arm whose joints follow, beside MuJoCo's."""

import numpy as np
import pytest

from htcp_jax.errors import InputError
from htcp_jax.model import JointLimits, coordinate_limits
from htcp_jax.model.coupling import moved_by

NAMES = ["a", "b", "c"]  # b and c follow a


def limits_of(lower, upper, factors=(1.0, -2.0, 0.5), offsets=(0.0, 0.25, 0.0)):
    joints = JointLimits(
        np.array(lower), np.array(upper), np.array([3.0, 2.0, 9.0]), np.array([np.inf, 8.0, 1.0]), np.array([5.0, 1, 2])
    )
    return coordinate_limits(np.array(factors)[:, None], np.array(offsets), joints, NAMES, ["a"], "arm.urdf: ")


def test_a_coordinate_keeps_the_limits_of_every_joint_that_follows_it():
    found = limits_of([-3.0, -0.75, -np.inf], [3.0, 1.25, 0.2])
    assert [float(each[0]) for each in found] == [-0.5, 0.4, 1.0, 2.0, 5.0]


@pytest.mark.parametrize(
    ("lower", "factors", "message"),
    [
        ([0.6, -0.75, -1.0], (1.0, -2.0, 0.5), "joint a has no range within the limits of a and c"),
        ([-3.0, -0.75, 0.1], (1.0, -2.0, 0.0), "joint c stays at 0, outside its limits 0.1 to 0.2"),
    ],
)
def test_limits_that_no_value_keeps_are_refused_by_name(lower, factors, message):
    with pytest.raises(InputError, match=f"arm.urdf: {message}"):
        limits_of(lower, [3.0, 1.25, 0.2], factors)


def test_a_joint_moves_the_links_after_it_on_its_own_branch():
    moves = moved_by((-1, 0, 1, 0))
    assert moves.tolist() == [[1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0], [1, 0, 0, 1], [0, 0, 0, 0]]
