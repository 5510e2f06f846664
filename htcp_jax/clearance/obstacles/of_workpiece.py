"""Obstacles of a workpiece: the paper's O."""

from htcp_jax.caching import cached_for_last
from htcp_jax.clearance.distance.half_spaces import half_spaces
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.obstacles.interior import Interior
from htcp_jax.clearance.obstacles.obstacle import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.model import Workpiece


@cached_for_last(2)
def make_obstacle(workpiece: Workpiece) -> Obstacles:
    """Return a workpiece's obstacles, on the device: its points and, if it has one, its interior rule.

    A workpiece without a cloud has no obstacles. The obstacles of the last two workpieces are cached for the next plan.
    """
    if not len(workpiece.cloud):
        return ()
    cloud = cloud_of(workpiece.cloud, workpiece.covering_radius_m)
    if not len(workpiece.hull_offset):
        return (cloud,)
    return cloud, Interior(half_spaces(workpiece.hull_normal, workpiece.hull_offset, workpiece.hull_vertices))


def all_obstacles(workpiece: Workpiece, others: Obstacles) -> Obstacles:
    """Return one tuple of the workpiece's obstacles and other obstacles.

    Raises:
        InputError: If there are no obstacles at all.
    """
    found = (*make_obstacle(workpiece), *others)
    if not found:
        raise InputError("no obstacles: set workpiece.cloud, cell.model or cell.clouds, or cell.self_collision: true")
    return found
