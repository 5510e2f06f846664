"""Kinds of task rows, as a person writes them; and the base class for those of other packages.

A kind with its fields, a Python object, becomes a `task_rows.Row` for a robot, and its goals at every target, see
`given_row` and docs/add-a-task-row.md. This module does without JAX until a method is called, as it reads a job.
"""

from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.kinds import ExtensionKind, kind_fault
from htcp_jax.registry import Registry
from htcp_jax.types import Array

if TYPE_CHECKING:
    from htcp_jax.model.robot import Robot
    from htcp_jax.model.task_rows import Feature, Row
    from htcp_jax.model.workpiece import Workpiece

ON_PATH = {"place": "places", "tangent": "tangents", "normal": "normals"}  # what a kind may use of the path


class PlacedPath(NamedTuple):
    """A workpiece's pose and its path in the world."""

    rotate: Float[np.ndarray, "3 3"]  # of the workpiece
    translate: Float[np.ndarray, "3"]  # [m]
    path: Float[np.ndarray, "T 3"]  # [m]
    workpiece: "Workpiece"


class TaskRowKind(ExtensionKind):
    """A kind of task row: derive a frozen dataclass from it, and define `name`, `features`, and `error` or `slack`.

    equalities, inequalities: numbers of values that `error` and `slack` return. angular: they are angles [rad], not
    lengths [m]. rate: error and slack change by at most this times the displacement of the features' coordinates, as
    one vector [m, of directions 1]; None: not known, so edges are sampled, not proven. along: what it uses of the path
    at the target, some of place, tangent, normal: they are attributes then, in the world [m, or of length 1].
    """

    equalities: ClassVar[int] = 0
    inequalities: ClassVar[int] = 0
    angular: ClassVar[bool] = False
    rate: ClassVar[float | None] = None
    along: ClassVar[tuple[str, ...]] = ()

    on: ClassVar[Any] = None  # of built-in kinds: path, if the point of the row follows it
    frame: ClassVar[str] = "world"

    def features(self, robot: "Robot") -> tuple["Feature", ...]:
        """Return the points and directions of the arm that it constrains, see `point_of` and `axis_of`."""
        raise NotImplementedError

    def error(self, value: Float[Array, "v"]) -> Float[Array, "m"]:
        """Return the errors of its equations at the features' world coordinates, concatenated, in jax.numpy."""
        import jax.numpy as jnp

        return jnp.zeros(0)

    def slack(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the slacks of its inequalities, likewise; negative: violated."""
        import jax.numpy as jnp

        return jnp.zeros(0)

    def aim(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return how far inside the inequalities a step aims [m or rad]."""
        import jax.numpy as jnp

        from htcp_jax.model.task_rows import AIM_M, AIM_RAD

        return jnp.full(self.inequalities, AIM_RAD if self.angular else AIM_M)

    def deviation(self, frame: Callable[[str], tuple[np.ndarray, np.ndarray]]) -> Float[np.ndarray, "n"] | None:
        """Return by how much n configurations violate the row [m or rad], in plain numpy, for `htcp validate`.

        0 or less if they do not; None: the row is not validated. frame: Returns MuJoCo's origins (n, 3) [m] and
        rotations (n, 3, 3) of a frame by its name.
        """
        return None

    @property
    def sampled(self) -> bool:
        """True if it has no bound between two configurations."""
        return self.rate is None

    @property
    def uses(self) -> set[str]:
        """Path frames that the row requires."""
        return {ON_PATH[name] for name in self.along} - {"places"}

    def part(self, robot: "Robot") -> "Row":
        """Return the row for a robot. Raises InputError for what is wrong with the kind."""
        return _given_row().row_of_kind(self, robot)

    def goals(self, part: "Row", posed: PlacedPath) -> Float[np.ndarray, "T g"]:
        """Return the numbers of the row at the points of the path."""
        return _given_row().goals_of_kind(self, posed)

    def drawn(self, part: "Row", rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal: its own numbers, at a random place of a path."""
        return _given_row().drawn_of_kind(self, rng)


def _given_row() -> ModuleType:
    """Return the module that computes, imported when it is used, as it imports JAX."""
    return import_module("htcp_jax.model.given_row")


def _row_fault(kind: Any) -> str:
    return kind_fault(kind, TaskRowKind, ["features"]) or kind_fault(kind, TaskRowKind, ["error", "slack"])


TASK_ROWS = Registry("htcp_jax.task_rows", "kind of task row", _row_fault)
