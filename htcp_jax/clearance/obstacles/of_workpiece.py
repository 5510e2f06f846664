"""Obstacles of a workpiece: the paper's O."""

from functools import lru_cache

from htcp_jax.clearance.distance.cloud import cloud_of
from htcp_jax.clearance.distance.half_spaces import half_spaces
from htcp_jax.clearance.obstacles.interior import Interior
from htcp_jax.clearance.obstacles.obstacle import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.model.workpiece import Workpiece


@lru_cache(maxsize=2)
def make_obstacle(workpiece: Workpiece) -> Obstacles:
    """Return a workpiece's obstacles: its points, and its interior rule. Without a cloud there are none.

    They are on the device, and cached for the next plan.
    """
    if not len(workpiece.cloud):
        return ()
    cloud = cloud_of(workpiece.cloud, workpiece.covering_radius_m)
    if not len(workpiece.hull_offset):
        return (cloud,)
    return cloud, Interior(half_spaces(workpiece.hull_normal, workpiece.hull_offset, workpiece.hull_vertices))


def all_obstacles(workpiece: Workpiece, others: Obstacles) -> Obstacles:
    """Return the workpiece's obstacles and the others.

    Raises:
        InputError: If there are none.
    """
    found = (*make_obstacle(workpiece), *others)
    if not found:
        raise InputError(
            "there is nothing to keep clear of: no cloud, no cell, and no self-collision; give one of them"
        )
    return found
