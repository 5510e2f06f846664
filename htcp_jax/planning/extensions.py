"""Registration of extensions in this process: methods, kinds of obstacles and kinds of task rows."""

from typing import Any

from htcp_jax.planning.registry import METHODS
from htcp_jax.spec import TASK_ROWS, TaskRowKind, obstacle_kind


def register(value: Any) -> Any:
    """Register a planning method, a kind of obstacle or a kind of task row in this process, and return it.

    `htcp_jax.plan`, `sweep` and job files then accept its name. Ray's workers find only those of installed packages.

    Args:
        value: An instance of a `Method`, or a class that derives from `ObstacleKind` or `TaskRowKind`.

    Raises:
        InputError: If the value is incomplete, or if its name is already taken or not valid in file names.
    """
    kinds = {obstacle_kind.ObstacleKind: obstacle_kind.OBSTACLES, TaskRowKind: TASK_ROWS}
    known = (registry for kind, registry in kinds.items() if isinstance(value, type) and issubclass(value, kind))
    return next(known, METHODS).register(value)
