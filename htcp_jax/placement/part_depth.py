"""Depth of the part in the solids of the cell. The planner does not look at it: both stand still."""

from collections.abc import Mapping

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.jobs import build
from htcp_jax.model import Fixture, Robot, Workpiece
from htcp_jax.placement.mounting import PartDepth
from htcp_jax.placement.place_file import Search
from htcp_jax.placement.scores import sweep_of
from htcp_jax.spec import PlanConfig

LEAST_M = 1e-4  # a smaller depth is none


def part_depths(search: Search, values: Float[np.ndarray, "n d"]) -> list[PartDepth]:
    """Return the depth of the part in the solid in which it is deepest, compared with the job as given.

    Points of the part are measured against planes and convex solids. If the part moves, nothing is measured.

    Args:
        search: The search.
        values: Parameters of the mountings, each in its unit in the job.
    """
    batch, found = sweep_of(search, values).batch(), list[PartDepth]()
    robot = batch.cells[0].robot
    if robot.part_moves or not (search.job.cell.model or search.job.cell.obstacles):
        return [PartDepth()] * len(values)
    given = _depths(search.job, robot, batch.workpieces[0])
    for row in range(0, len(batch.points), max(1, len(search.seams))):
        robot = batch.cells[batch.cell[row]].robot
        own = _depths(batch.points[row].config, robot, batch.workpieces[row])
        deepest = max((PartDepth(depth - given.get(name, 0.0), name) for name, depth in own.items()), default=None)
        found.append(deepest if deepest and deepest.depth_m > LEAST_M else PartDepth())
    return found


def _depths(job: PlanConfig, robot: Robot, workpiece: Workpiece) -> Mapping[str, float]:
    """Return the depth of the part in each solid of the cell, by name [m]; 0 outside."""
    part, found = job.workpiece, dict[str, float]()
    T = workpiece.T_world(part.rotation_y_rad, part.rotation_z_rad, shift=part.shift_m, wx=part.rotation_x_rad)
    points = workpiece.cloud @ T[:3, :3].T + T[:3, 3]
    for shape in build.shapes_of(job.cell, robot):
        found[shape.name] = max(found.get(shape.name, 0.0), _depth(points, shape))
    return found


def _depth(points: Float[np.ndarray, "P 3"], shape: Fixture) -> float:
    """Return the depth of the deepest point in a shape [m]; 0 outside, and for a mesh that is no convex solid."""
    if shape.kind == "plane":
        return max(0.0, -float(((points - shape.T_world[:3, 3]) @ shape.T_world[:3, 2]).min(initial=0.0)))
    if shape.kind == "mesh" and not shape.convex:
        return 0.0
    corners = shape.surface.reshape(-1, 3)
    near = points[((points > corners.min(axis=0)) & (points < corners.max(axis=0))).all(axis=1)]
    if not len(near):
        return 0.0
    planes = scipy.spatial.ConvexHull(corners).equations
    heights = near @ planes[:, :3].T + planes[:, 3]
    return max(0.0, -float(heights.max(axis=1).min()))
