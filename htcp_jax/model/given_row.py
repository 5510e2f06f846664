"""Task rows of kinds that other packages define (`task_row_kind.TaskRowKind`), and the goals of these rows."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model.robot import Robot
from htcp_jax.model.rotations import turned_directions
from htcp_jax.model.row_bounds import RateBound
from htcp_jax.model.task_row_kind import ON_PATH, PlacedPath, TaskRowKind
from htcp_jax.model.task_rows import AIM_M, AIM_RAD, SLACK, Feature, Row, mixed
from htcp_jax.numerics import safe_norm
from htcp_jax.spec import Slot, Template, numbers_of, template_of
from htcp_jax.types import Array, Scalar


def row_of_kind(kind: TaskRowKind, robot: Robot) -> "GivenRow":
    """Return the planner's row for a kind's row and a robot.

    Raises:
        InputError: For an invalid `along`, a name that the robot lacks, and a wrong number of errors or slacks.
    """
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
            raise InputError(
                f"{what} of {kind.name} returns the shape {found}; with {name} = {given} it must be ({given},)"
            )
    if not kind.equalities + kind.inequalities:
        raise InputError(f"{kind.name}: `equalities` and `inequalities` are both 0; set one of them")
    return GivenRow(template, features)


def goals_of_kind(kind: TaskRowKind, posed: PlacedPath) -> Float[np.ndarray, "T g"]:
    """Return the goals of a kind's row at the T points of the path; their offsets are 0, see `GivenRow`."""
    count = len(posed.path)
    columns = [np.tile(numbers_of([kind]), (count, 1)), *path_values(kind.along, posed).values()]
    return np.column_stack([*columns, np.zeros((count, kind.equalities + kind.inequalities))])


def drawn_of_kind(kind: TaskRowKind, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
    """Return a random goal: the kind's numbers, with random vectors for the path's place, tangent and normal."""
    random = rng.normal(size=(len(kind.along), 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    return np.concatenate([numbers_of([kind]), random.ravel(), np.zeros(kind.equalities + kind.inequalities)])


def path_values(names: tuple[str, ...], posed: PlacedPath) -> dict[str, Float[np.ndarray, "T 3"]]:
    """Return values along a path in the world, by name: place [m], tangent, normal."""
    return {
        name: posed.path if name == "place" else getattr(posed.workpiece, ON_PATH[name]) @ posed.rotate.T
        for name in names
    }


@dataclass(frozen=True)
class GivenRow(Row):
    """A row of a `TaskRowKind`.

    A goal is the kind's numbers, then one offset per error and slack. The offsets are 0 on the path. On the approach
    they begin at values by which the start satisfies the row, and decrease to 0.
    """

    template: Template
    features: tuple[Feature, ...] = ()

    @property
    def kind(self) -> type[TaskRowKind]:
        """Class of the row's kind."""
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
        """Return the kind's error minus the goal's error offset."""
        first = self.template.size
        return self._own(goal).error(value) - goal[first : first + self.equalities]

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the kind's slack plus the goal's slack offset."""
        return self._own(goal).slack(value) + goal[self.template.size + self.equalities :]

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the distance inside the inequalities at which a step aims [m or rad]."""
        return self._own(goal).aim(value)

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> RateBound:
        """Return the allowed region: satisfied by goal 0, by goal 1, or by their mean."""
        tolerance = tolerance_rad if self.angular else tolerance_m

        def by(goal: Float[Array, "g"], value: Float[Array, "v"]) -> Scalar:
            off = tolerance - safe_norm(self.error(value, goal)) if self.equalities else jnp.inf
            return jnp.minimum(off, jnp.min(self.slack(value, goal), initial=jnp.inf) + tolerance)

        def slack(value: Float[Array, "v"]) -> Scalar:
            return jnp.max(jnp.stack([by(goal, value) for goal in (goals[0], 0.5 * (goals[0] + goals[1]), goals[1])]))

        return RateBound(slack, tuple(feature.is_direction for feature in self.features), self.kind.rate)

    def eased(self, start, first, share, places):
        """Return the first goal with offsets that decrease to 0; with the first offsets the start satisfies the row."""
        value, goal = jnp.asarray(start), jnp.asarray(first)
        error, slack = np.asarray(self.error(value, goal)), np.asarray(self.slack(value, goal))
        short = np.where(slack < 0, 2 * (AIM_RAD if self.angular else AIM_M) - slack, 0.0) + SLACK
        goals, first_own = np.tile(first, (len(share), 1)), self.template.size
        goals[:, first_own:] += (1.0 - share)[:, None] * np.append(error, short)
        return goals

    def interpolated(self, goals, share, places=None):
        """Interpolate the goals' numbers linearly, and tangents and normals by rotation."""
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
    """Evaluate a kind's error or slack at arbitrary values, to determine its shape."""
    size = sum(len(feature.rows) for feature in features)
    return np.asarray(getattr(template.with_numbers(jnp.ones(template.size)), what)(jnp.full(size, 0.5)))
