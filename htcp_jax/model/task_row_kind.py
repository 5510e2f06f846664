"""Kinds of task rows, as written in a job; the base class for kinds of other packages.

`given_row` converts a kind, a Python object with fields, to a `task_rows.Row` for a robot with goals at every target.
See docs/add-a-task-row.md. This module reads jobs, and does not import JAX until a method is called.
"""

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.spec import ExtensionKind, Registry, kind_fault
from htcp_jax.types import Array

if TYPE_CHECKING:
    from htcp_jax.model.robot import Robot
    from htcp_jax.model.task_rows import Feature, Row
    from htcp_jax.model.workpiece import Workpiece

ON_PATH = {"place": "places", "tangent": "tangents", "normal": "normals"}  # values along the path that a kind may use


class PlacedPath(NamedTuple):
    """A workpiece's pose and its path in the world."""

    rotate: Float[np.ndarray, "3 3"]  # rotation of the workpiece
    translate: Float[np.ndarray, "3"]  # its translation [m]
    path: Float[np.ndarray, "T 3"]  # points of the path in the world [m]
    workpiece: "Workpiece"


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

    on: ClassVar[Any] = None  # for built-in rows only: "path" if the row's point follows the path
    frame: ClassVar[str] = "world"

    def features(self, robot: "Robot") -> tuple["Feature", ...]:
        """Return the constrained points and directions of the arm, from `point_of` and `axis_of`."""
        raise NotImplementedError

    def error(self, value: Float[Array, "v"]) -> Float[Array, "m"]:
        """Return the errors of the row's equations, computed in jax.numpy.

        Args:
            value: World coordinates of the features, concatenated: points [m], directions of length 1.
        """
        import jax.numpy as jnp

        return jnp.zeros(0)

    def slack(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the slacks of the row's inequalities, computed in jax.numpy; negative if violated.

        Args:
            value: World coordinates of the features, concatenated: points [m], directions of length 1.
        """
        import jax.numpy as jnp

        return jnp.zeros(0)

    def aim(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the distance inside each inequality at which a step aims [m or rad]."""
        import jax.numpy as jnp

        from htcp_jax.model.task_rows import AIM_M, AIM_RAD

        return jnp.full(self.inequalities, AIM_RAD if self.angular else AIM_M)

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
        """Names of the path's directions that the row requires: normals, tangents."""
        return {ON_PATH[name] for name in self.along} - {"places"}

    def part(self, robot: "Robot") -> "Row":
        """Return the planner's row for a robot.

        Raises:
            InputError: For an invalid `along`, a name that the robot lacks, and a wrong number of errors or slacks.
        """
        return _given_row().row_of_kind(self, robot)

    def goals(self, part: "Row", posed: PlacedPath) -> Float[np.ndarray, "T g"]:
        """Return the goals of the row at the T points of the path."""
        return _given_row().goals_of_kind(self, posed)

    def drawn(self, part: "Row", rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal: the row's own numbers, with random vectors for the path's place and directions."""
        return _given_row().drawn_of_kind(self, rng)


def _given_row() -> ModuleType:
    """Import module `given_row` on first use, as it imports JAX."""
    return import_module("htcp_jax.model.given_row")


def _row_fault(kind: Any) -> str:
    return kind_fault(kind, TaskRowKind, ["features"]) or kind_fault(kind, TaskRowKind, ["error", "slack"])


TASK_ROWS = Registry("htcp_jax.task_rows", "kind of task row", _row_fault)
