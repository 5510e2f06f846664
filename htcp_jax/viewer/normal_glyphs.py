"""Normal glyphs: lines along the path's normals, drawn if the task refers to normals."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from htcp_jax.model import Workpiece
from htcp_jax.spec import TaskRowKind

LENGTH_M = 0.04
NormalGlyphs = Float[np.ndarray, "n 2 3"]  # foot and tip of each glyph, world [m]
NO_GLYPHS = np.empty((0, 2, 3))


def glyphs(
    task: Sequence[TaskRowKind], workpiece: Workpiece, T_world_workpiece: Float[np.ndarray, "4 4"]
) -> NormalGlyphs:
    """Return one glyph per point of the path, or none if no row of the task refers to the normals.

    Args:
        task: Rows of the task.
        workpiece: The workpiece.
        T_world_workpiece: Pose of the workpiece.
    """
    if not any("normals" in row.uses for row in task):
        return NO_GLYPHS
    both = np.stack([workpiece.path, workpiece.path + LENGTH_M * workpiece.normals], axis=1)
    return both @ T_world_workpiece[:3, :3].T + T_world_workpiece[:3, 3]
