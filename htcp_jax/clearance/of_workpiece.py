"""The obstacles that a workpiece is: the paper's O."""

from functools import lru_cache

from htcp_jax.clearance.cloud import cloud_of
from htcp_jax.clearance.half_spaces import half_spaces
from htcp_jax.clearance.interior import Interior
from htcp_jax.clearance.obstacle import Obstacles
from htcp_jax.scene.workpiece import Workpiece


@lru_cache(maxsize=2)
def make_obstacle(workpiece: Workpiece) -> Obstacles:
    """The obstacles that a workpiece is, on the device, kept for the next plan: its points, and its interior rule."""
    cloud = cloud_of(workpiece.cloud, workpiece.covering_radius_m)
    if not len(workpiece.hull_offset):
        return (cloud,)
    return cloud, Interior(half_spaces(workpiece.hull_normal, workpiece.hull_offset, workpiece.hull_vertices))
