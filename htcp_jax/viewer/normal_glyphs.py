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
    """Return one glyph per point of the path, or two if a row of the task refers to a fillet's plates.

    Where the path has no normal, a glyph has no length. None if no row of the task refers to normals.

    Args:
        task: Rows of the task.
        workpiece: The workpiece.
        T_world_workpiece: Pose of the workpiece.
    """
    if not any("normals" in row.uses for row in task):
        return NO_GLYPHS
    plates = workpiece.frames.plates if any("plates" in row.uses for row in task) else None
    normals = [workpiece.normals] if plates is None else [*np.moveaxis(plates, 1, 0)]
    both = np.concatenate(
        [np.stack([workpiece.path, workpiece.path + LENGTH_M * np.nan_to_num(each)], axis=1) for each in normals]
    )
    return both @ T_world_workpiece[:3, :3].T + T_world_workpiece[:3, 3]
