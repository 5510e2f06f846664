"""The rows of a task that are of some `task_row_kind.TaskRowKind`, and their goals."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.kinds import Slot, Template, numbers_of, template_of
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import turned_directions
from htcp_jax.model.row_bounds import RateBound
from htcp_jax.model.task_row_kind import ON_PATH, PlacedPath, TaskRowKind
from htcp_jax.model.task_rows import AIM_M, AIM_RAD, SLACK, Feature, Row, mixed
from htcp_jax.numerics import safe_norm
from htcp_jax.types import Array, Scalar


def row_of_kind(kind: TaskRowKind, robot: Robot) -> "GivenRow":
    """Return the row of a kind for a robot. Raises InputError for what is wrong with the kind."""
    if unknown := [name for name in kind.along if name not in ON_PATH]:
        raise InputError(f"along of {kind.name} has {unknown[0]!r}; valid: {', '.join(ON_PATH)}")
    template = template_of(kind)
    own = tuple((name, Slot((3,))) for name in kind.along)
    template = Template(template.kind, (*template.fields, *own))
    features = tuple(kind.features(robot))
    for name in ("equalities", "inequalities"):
        given, what = getattr(kind, name), "error" if name == "equalities" else "slack"
        found = np.shape(_evaluated(template, what, features))
        if found != (given,):
            raise InputError(f"{what} of {kind.name} returns the shape {found}; {name} is {given}")
    if not kind.equalities + kind.inequalities:
        raise InputError(f"{kind.name} has neither equalities nor inequalities")
    return GivenRow(template, features)


def goals_of_kind(kind: TaskRowKind, posed: PlacedPath) -> Float[np.ndarray, "T g"]:
    """Return the numbers of the row at the points of the path."""
    count = len(posed.path)
    columns = [np.tile(numbers_of([kind]), (count, 1)), *path_values(kind.along, posed).values()]
    return np.column_stack([*columns, np.zeros((count, kind.equalities + kind.inequalities))])


def drawn_of_kind(kind: TaskRowKind, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
    """Return a random goal: the kind's own numbers, at a random place of a path."""
    random = rng.normal(size=(len(kind.along), 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    return np.concatenate([numbers_of([kind]), random.ravel(), np.zeros(kind.equalities + kind.inequalities)])


def path_values(names: tuple[str, ...], posed: PlacedPath) -> dict[str, Float[np.ndarray, "T 3"]]:
    """Return places, tangents and normals of a path in the world, by name."""
    return {
        name: posed.path if name == "place" else getattr(posed.workpiece, ON_PATH[name]) @ posed.rotate.T
        for name in names
    }


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
