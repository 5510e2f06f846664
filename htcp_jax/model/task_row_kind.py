"""Kinds of task rows, as a person writes them; and the base class for those of other packages.

A kind with its fields, a Python object, becomes a `task_rows.Row` for a robot, and its goals at every target. See
docs/add-a-task-row.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.kinds import ExtensionKind, Slot, Template, kind_fault, numbers_of, template_of
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import turned_directions
from htcp_jax.model.row_bounds import RateBound
from htcp_jax.model.task_rows import AIM_M, AIM_RAD, SLACK, Feature, Row, mixed
from htcp_jax.model.workpiece import Workpiece
from htcp_jax.numerics import safe_norm
from htcp_jax.registry import Registry
from htcp_jax.types import Array, Scalar

ON_PATH = {"place": "places", "tangent": "tangents", "normal": "normals"}  # what a kind may use of the path


class PlacedPath(NamedTuple):
    """A workpiece's pose and its path in the world."""

    rotate: Float[np.ndarray, "3 3"]  # of the workpiece
    translate: Float[np.ndarray, "3"]  # [m]
    path: Float[np.ndarray, "T 3"]  # [m]
    workpiece: Workpiece


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

    def features(self, robot: Robot) -> tuple[Feature, ...]:
        """Return the points and directions of the arm that it constrains, see `point_of` and `axis_of`."""
        raise NotImplementedError

    def error(self, value: Float[Array, "v"]) -> Float[Array, "m"]:
        """Return the errors of its equations at the features' world coordinates, concatenated, in jax.numpy."""
        return jnp.zeros(0)

    def slack(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return the slacks of its inequalities, likewise; negative: violated."""
        return jnp.zeros(0)

    def aim(self, value: Float[Array, "v"]) -> Float[Array, "b"]:
        """Return how far inside the inequalities a step aims [m or rad]."""
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

    def part(self, robot: Robot) -> Row:
        """Return the row for a robot. Raises InputError for what is wrong with the kind."""
        if unknown := [name for name in self.along if name not in ON_PATH]:
            raise InputError(f"along of {self.name} has {unknown[0]!r}; valid: {', '.join(ON_PATH)}")
        template = template_of(self)
        own = tuple((name, Slot((3,))) for name in self.along)
        template = Template(template.kind, (*template.fields, *own))
        features = tuple(self.features(robot))
        for name in ("equalities", "inequalities"):
            given, what = getattr(self, name), "error" if name == "equalities" else "slack"
            found = np.shape(_evaluated(template, what, features))
            if found != (given,):
                raise InputError(f"{what} of {self.name} returns the shape {found}; {name} is {given}")
        if not self.equalities + self.inequalities:
            raise InputError(f"{self.name} has neither equalities nor inequalities")
        return GivenRow(template, features)

    def goals(self, part: Row, posed: PlacedPath) -> Float[np.ndarray, "T g"]:
        """Return the numbers of the row at the points of the path."""
        count = len(posed.path)
        columns = [np.tile(numbers_of([self]), (count, 1)), *path_values(self.along, posed).values()]
        return np.column_stack([*columns, np.zeros((count, self.equalities + self.inequalities))])

    def drawn(self, part: Row, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal: its own numbers, at a random place of a path."""
        random = rng.normal(size=(len(self.along), 3))
        random /= np.linalg.norm(random, axis=1, keepdims=True)
        return np.concatenate([numbers_of([self]), random.ravel(), np.zeros(self.equalities + self.inequalities)])


def path_values(names: tuple[str, ...], posed: PlacedPath) -> dict[str, Float[np.ndarray, "T 3"]]:
    """Return places, tangents and normals of a path in the world, by name."""
    return {
        name: posed.path if name == "place" else getattr(posed.workpiece, ON_PATH[name]) @ posed.rotate.T
        for name in names
    }


def _row_fault(kind: Any) -> str:
    return kind_fault(kind, TaskRowKind, ["features"]) or kind_fault(kind, TaskRowKind, ["error", "slack"])


TASK_ROWS = Registry("htcp_jax.task_rows", "kind of task row", _row_fault)


@dataclass(frozen=True)
class GivenRow(Row):
    """A row of some kind. A goal: the kind's numbers, then what is added to its errors and slacks before the path."""

    template: Template
    features: tuple[Feature, ...] = ()

    @property
    def kind(self) -> type[TaskRowKind]:
        """The kind of a row."""
        return self.template.kind

    @property
    def angular(self) -> bool:
        """True if errors and slacks are angles."""
        return self.kind.angular

    @property
    def sampled(self) -> bool:
        """True if the kind has no bound between two configurations."""
        return self.kind.rate is None

    @property
    def equalities(self) -> int:
        """Number of equations."""
        return self.kind.equalities

    @property
    def inequalities(self) -> int:
        """Number of inequalities."""
        return self.kind.inequalities

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return self.template.size + self.equalities + self.inequalities

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the kind's error, less what is added to it."""
        first = self.template.size
        return self._own(goal).error(value) - goal[first : first + self.equalities]

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the kind's slack, and what is added to it."""
        return self._own(goal).slack(value) + goal[self.template.size + self.equalities :]

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return how far inside the inequalities a step aims."""
        return self._own(goal).aim(value)

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> RateBound:
        """Return what is allowed by the goals at both targets, or by the numbers half way."""
        tolerance = tolerance_rad if self.angular else tolerance_m

        def by(goal: Float[Array, "g"], value: Float[Array, "v"]) -> Scalar:
            off = tolerance - safe_norm(self.error(value, goal)) if self.equalities else jnp.inf
            return jnp.minimum(off, jnp.min(self.slack(value, goal), initial=jnp.inf) + tolerance)

        def slack(value: Float[Array, "v"]) -> Scalar:
            return jnp.max(jnp.stack([by(goal, value) for goal in (goals[0], 0.5 * (goals[0] + goals[1]), goals[1])]))

        return RateBound(slack, tuple(feature.is_direction for feature in self.features), self.kind.rate)

    def eased(self, start, first, share, places):
        """Return goals whose errors and slacks are those of the start, faded out."""
        value, goal = jnp.asarray(start), jnp.asarray(first)
        error, slack = np.asarray(self.error(value, goal)), np.asarray(self.slack(value, goal))
        short = np.where(slack < 0, 2 * (AIM_RAD if self.angular else AIM_M) - slack, 0.0) + SLACK
        goals, first_own = np.tile(first, (len(share), 1)), self.template.size
        goals[:, first_own:] += (1.0 - share)[:, None] * np.append(error, short)
        return goals

    def interpolated(self, goals, share, places=None):
        """Return numbers on the line between the targets; tangents and normals are turned."""
        found, first = mixed(goals, share), 0
        for name, value in self.template.fields:
            if isinstance(value, Slot):
                own = slice(first, first + int(np.prod(value.shape)))
                if name in ON_PATH and name != "place":
                    found[:, own] = turned_directions(goals[:, 0, own], goals[:, 1, own], share)
                first = own.stop
        return found

    def _own(self, goal: Float[Array, "g"]) -> TaskRowKind:
        return self.template.with_numbers(goal[: self.template.size])


def _evaluated(template: Template, what: str, features: tuple[Feature, ...]) -> np.ndarray:
    """Return a kind's error or slack at some place, to see its shape."""
    size = sum(len(feature.rows) for feature in features)
    return np.asarray(getattr(template.with_numbers(jnp.ones(template.size)), what)(jnp.full(size, 0.5)))
