"""Rows of a task: each compares features of the arm with a goal. `built_in_rows` has the kinds that a job lists.

Features are points and directions that are fixed to a link. A row computes the error of an equality, or the slack of an
inequality (negative if violated), from the values of its features and its goal at one target. Kinds are static in JAX;
goals are data: a cone's angle, for example, may differ between scenarios.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model.robot import ArmFrame
from htcp_jax.model.row_bounds import Region, Slabs
from htcp_jax.spec import AIM_M, AIM_RAD
from htcp_jax.types import Array, Float, Triple

XYZ = (0, 1, 2)
AIM_SHARE = 0.25  # upper limit of AIM_RAD and AIM_M, as a share of the half angle or band
SLACK = 1e-6  # widening of goals on the approach, for rounding [rad; for rows of other packages also m]


class Feature(NamedTuple):
    """A point or a direction that is fixed to a link of the arm; its value is its coordinates in the world."""

    link: int | None  # link to which the feature is fixed; None: the TCP's frame
    vector: Triple  # position [m] or unit direction in that frame
    is_direction: bool = False
    rows: tuple[int, ...] = XYZ  # indices of the coordinates in use
    seen_from: ArmFrame | None = None  # frame of a direction's coordinates; None: the chain's root


class Row:
    """Base class of all kinds of rows, at one target.

    In the methods, `value` is the concatenated coordinates of the row's features, and `goal` its numbers at the target.
    Errors and slacks are in metres, or in radians if `angular`.

    Attributes:
        turns: True if all features are directions, and a rotation of them by an angle changes errors and slacks by at
            most this angle.
    """

    turns: ClassVar[bool] = False

    @property
    def angular(self) -> bool:
        """True if errors and slacks are angles."""
        return False

    @property
    def is_view(self) -> bool:
        """True if the first feature is an axis that points at a place, and the second feature is its origin."""
        return False

    @property
    def sampled(self) -> bool:
        """True if the row has no bound between two configurations, so that edges are sampled."""
        return False

    @property
    def features(self) -> tuple[Feature, ...]:
        """The features of the arm."""
        raise NotImplementedError

    @property
    def equalities(self) -> int:
        """Number of equations."""
        return 0

    @property
    def inequalities(self) -> int:
        """Number of inequalities."""
        return 0

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        raise NotImplementedError

    @property
    def size(self) -> int:
        """Number of coordinates of the features."""
        return sum(len(feature.rows) for feature in self.features)

    def error(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "m"]:
        """Return the errors of the equations [m or rad]."""
        return jnp.zeros(0)

    def slack(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the slacks of the inequalities [m or rad]; negative if violated."""
        return jnp.zeros(0)

    def aim(self, value: Float[Array, "v"], goal: Float[Array, "g"]) -> Float[Array, "b"]:
        """Return the distance inside each inequality at which a step aims [m or rad]."""
        return jnp.zeros(0)

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> Region:
        """Return the allowed region of the features between two targets.

        Args:
            goals: Goals at both targets.
            tolerance_m: Tolerance of lengths.
            tolerance_rad: Tolerance of angles.
        """
        raise NotImplementedError

    def drawn(self, rng: np.random.Generator) -> Float[np.ndarray, "g"]:
        """Return a random goal."""
        return rng.normal(size=self.numbers)

    def eased(
        self,
        start: Float[np.ndarray, "v"],
        first: Float[np.ndarray, "g"],
        share: Float[np.ndarray, "A"],
        places: Float[np.ndarray, "A 3"] | None,
    ) -> Float[np.ndarray, "A g"]:
        """Return the goals at the A targets of the approach: from a goal that the start satisfies to the path's first.

        Args:
            start: Value of the features at the start.
            first: Goal at the path's first point.
            share: Share of the interpolation at each target, 0 at the start [1].
            places: Positions of the point that follows the path, if this row constrains it [m]; else None.
        """
        raise NotImplementedError

    def interpolated(
        self,
        goals: Float[np.ndarray, "n 2 g"],
        share: Float[np.ndarray, "n"],
        places: Float[np.ndarray, "n 2 3"] | None = None,
    ) -> Float[np.ndarray, "n g"]:
        """Interpolate goals between two targets.

        Args:
            goals: Goals at both targets.
            share: Share of the segment from the first target to the second [1].
            places: Positions of the targets, world [m]; None: unknown.
        """
        return mixed(goals, share)

    def turn(self, goals: Float[np.ndarray, "n 2 g"], least: bool = False) -> Float[np.ndarray, "n"]:
        """Return the angle between the orientations that two goals require [rad]; 0 if they require none.

        With `least`, the half angles of both goals' cones are subtracted.
        """
        return np.zeros(len(goals))


@dataclass(frozen=True)
class TaskPoint(Row):
    """A point of the arm whose world coordinates, some or all, must equal a goal [m].

    Raises:
        InputError: For an empty or invalid tuple of axes, and for an `offset_m` without a link.
    """

    link: int | None = None  # link to which the point is fixed; None: the point is the TCP
    offset_m: Triple = (0.0, 0.0, 0.0)  # position in the frame of the link; must be 0 for the TCP
    axes: tuple[int, ...] = XYZ  # constrained world coordinates: 0, 1, 2 are x, y, z

    def __post_init__(self):
        if not self.axes or sorted(set(self.axes)) != list(self.axes) or not set(self.axes) <= set(XYZ):
            raise InputError(f"axes of a task point is {self.axes}; valid: some of 0, 1, 2, in this order")
        if self.link is None and any(self.offset_m):
            raise InputError("offset_m of the TCP must be 0; set link to the link that the point is fixed to")

    @property
    def features(self) -> tuple[Feature, ...]:
        """The point."""
        return (Feature(self.link, self.offset_m, rows=self.axes),)

    @property
    def equalities(self) -> int:
        """Number of equations: one per coordinate."""
        return len(self.axes)

    @property
    def numbers(self) -> int:
        """Number of coordinates of a goal."""
        return len(self.axes)

    def error(self, value: Float[Array, "m"], goal: Float[Array, "m"]) -> Float[Array, "m"]:
        """Return the vector from the point to its goal [m]."""
        return goal - value

    def between(self, goals: Float[Array, "2 g"], tolerance_m: float, tolerance_rad: float) -> Slabs:
        """Return the region of positions within the tolerance."""
        across = jnp.broadcast_to(jnp.eye(3)[jnp.array(self.axes)], (2, len(self.axes), 3))
        return Slabs(across, goals, jnp.full(2, tolerance_m))

    def eased(self, start, first, share, places):
        """Interpolate the position from the start to the first goal; with `places`, return their coordinates."""
        wanted = start + share[:, None] * (first - start)
        return wanted if places is None else places[:, list(self.axes)]


def eased_offsets(
    row: Row, start: Float[np.ndarray, "v"], first: Float[np.ndarray, "g"], share: Float[np.ndarray, "A"]
) -> Float[np.ndarray, "A g"]:
    """Return the first goal with other offsets: they decrease from those by which the start satisfies the row to 0.

    A goal of such a row ends with one offset for each error, which is subtracted, and for each slack, which is added.

    Args:
        row: The row.
        start: Value of its features at the start.
        first: Goal at the path's first point.
        share: Share of the interpolation at each target, 0 at the start [1].
    """
    value, goal = jnp.asarray(start), jnp.asarray(first)
    error, slack = np.asarray(row.error(value, goal)), np.asarray(row.slack(value, goal))
    short = np.where(slack < 0, 2 * (AIM_RAD if row.angular else AIM_M) - slack, 0.0) + SLACK
    goals = np.tile(first, (len(share), 1))
    goals[:, row.numbers - len(error) - len(slack) :] += (1.0 - share)[:, None] * np.append(error, short)
    return goals


def mixed(goals: Float[np.ndarray, "n 2 *g"], share: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n *g"]:
    """Interpolate the numbers of two goals linearly; share 0 is the first goal, 1 the second."""
    share = share.reshape(-1, *[1] * (goals.ndim - 2))
    return (1.0 - share) * goals[:, 0] + share * goals[:, 1]
