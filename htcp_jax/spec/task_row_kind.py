"""Base class of task rows, as written in a job: of the built-in ones (`task_list`), and of those of other packages.

`rows_of_spec` converts a row to a `task_rows.Row` for a robot with goals at every target. See docs/add-a-task-row.md.
This module contains data only, and does not import JAX.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from htcp_jax.spec.kinds import ExtensionKind
from htcp_jax.types import Array

PATH_VALUES = {"place": "path", "tangent": "tangents", "normal": "normals"}  # values along the path that a row may use
AIM_RAD, AIM_M = 1e-3, 2e-4  # distance inside an inequality at which a step aims, as rows are linearised


class TaskRowKind(ExtensionKind):
    """Base class of a kind of task row.

    Derive a frozen dataclass, and define `name`, `features`, and `error` or `slack`.

    Attributes:
        equalities: Number of values that `error` returns.
        inequalities: Number of values that `slack` returns.
        angular: True if `error` and `slack` are angles [rad]; False for lengths [m].
        rate: Lipschitz constant: error and slack change by at most `rate` times the norm of the change of all features'
            coordinates [m; 1 for directions]. None: unknown; edges are then sampled, not proven.
        along: Names of the path's values that the row uses: some of place, tangent, normal. Each is then an attribute
            with the value at the target, in the world [m, or of length 1].
    """

    equalities: ClassVar[int] = 0
    inequalities: ClassVar[int] = 0
    angular: ClassVar[bool] = False
    rate: ClassVar[float | None] = None
    along: ClassVar[tuple[str, ...]] = ()

    def features(self, robot: Any) -> Sequence[Any]:
        """Return the constrained points and directions of a robot's arm, from `point_of` and `axis_of`."""
        raise NotImplementedError

    def error(self, value: Float[Array, "v"]) -> Float[Array, "m"]:
        """Return the errors of the row's equations, computed in jax.numpy.

        Args:
            value: World coordinates of the features, concatenated: points [m], directions of length 1.
        """
        return _namespace(value).zeros(0)

    def slack(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the slacks of the row's inequalities, computed in jax.numpy; negative if violated.

        Args:
            value: World coordinates of the features, concatenated: points [m], directions of length 1.
        """
        return _namespace(value).zeros(0)

    def aim(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the distance inside each inequality at which a step aims [m or rad]."""
        return _namespace(value).full(self.inequalities, AIM_RAD if self.angular else AIM_M)

    def deviation(self, frame: Callable[[str], tuple[np.ndarray, np.ndarray]]) -> Float[np.ndarray, "n"] | None:
        """Return the violation of the row in n configurations [m or rad], in plain numpy, for `htcp validate`.

        Args:
            frame: Function from a frame's name to its origins (n, 3) [m] and rotations (n, 3, 3), computed by MuJoCo.

        Returns:
            The violations, 0 or less where the row is satisfied; None if the row is not validated.
        """
        return None

    @property
    def sampled(self) -> bool:
        """True if the row has no bound between two configurations, so that edges are sampled."""
        return self.rate is None

    @property
    def uses(self) -> set[str]:
        """Names of the path's directions that the row requires: normals, tangents, rotations."""
        return {PATH_VALUES[name] for name in self.along} - {"path"}


def _namespace(value: Any) -> Any:
    """Return the module with the functions of an array: jax.numpy or numpy."""
    return value.__array_namespace__()
