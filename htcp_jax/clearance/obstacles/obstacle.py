"""The obstacle protocol: rows of distances, and cheap queries about them.

A kind of obstacle is a small pytree that derives from `Obstacle`, in a file of its own. Its rows are distances [m]
between a body of the arm and something: the surroundings, or another body. Kinds with `per_body` have one row per body,
which they share: the nearest counts. Any other kind has its own rows.

`obstacle_kind` has the plainer protocol for obstacles of other packages.
"""

from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.model import Robot, kinematics
from htcp_jax.numerics import product
from htcp_jax.types import Bool, Float, Int, Joints, Pose, Scalar


@runtime_checkable
class HasWorkpiecePose(Protocol):
    """Workpiece pose: a scenario, or any object with these fields."""

    T_world_workpiece: Pose
    interior_plane: Float[jax.Array, "4"]  # unit normal n, offset [m]: ends with n @ x > offset must lie in the tunnel


class RowPairs(NamedTuple):
    """The pairs that R rows of distances are between; static."""

    body: tuple[int, ...]  # the number of the capsule
    other: tuple[int, ...]  # the link, before the body's, that the obstacle's nearest point is fixed to; -1: the world

    @classmethod
    def of_bodies(cls, robot: Robot) -> "RowPairs":
        """Return one row per body, against the world: the rows of every kind with `per_body`."""
        bodies = len(robot.capsule_link)
        return cls(tuple(range(bodies)), (-1,) * bodies)


class Contacts(NamedTuple):
    """Nearest points per row: the point on the body's axis, and the direction away from the obstacle."""

    distance: Float[jax.Array, "R"]  # D [m]
    point: Float[jax.Array, "R 3"]  # on the body's axis, world [m]
    normal: Float[jax.Array, "R 3"]  # unit, from the obstacle to the body, world
    radius: Float[jax.Array, "R"]  # distance from the axis at which D is 0 [m], see `witness`
    plane: Bool[jax.Array, "R"]  # True: a plane fixed in the world that an end of the body has crossed

    @property
    def witness(self) -> Float[jax.Array, "R 3"]:
        """The obstacle's points, world [m]."""
        return self.point - self.normal * (self.distance + self.radius)[:, None]


def surface_points(robot: Robot, rows: RowPairs, touch: Contacts) -> Float[jax.Array, "R 3"]:
    """Return the points of the bodies' surfaces in contacts, world [m]: of a capsule, or of the piece that decided."""
    radius = robot.capsule_radius[jnp.asarray(rows.body)]
    if robot.pieces is not None:  # contacts of pieces are on their surface, or on that of the mesh's cover
        radius = jnp.minimum(radius, touch.radius)
    return touch.point - radius[:, None] * touch.normal


def by_pieces(robot: Robot, rows: RowPairs, touch: Contacts) -> Bool[jax.Array, "R"]:
    """Return True for contacts whose distance a convex piece decided, not the capsule."""
    if robot.pieces is None:
        return jnp.zeros(touch.radius.shape, bool)
    of_capsules = touch.radius >= robot.capsule_radius[jnp.asarray(rows.body)]
    return ~(of_capsules | (touch.plane & (touch.radius == 0)))  # the last: an end of an axis, by the interior rule


class BodyAxes(NamedTuple):
    """Ends of the bodies' axes [m], in the world and in the workpiece frame."""

    p: Float[jax.Array, "*S K 3"]
    q: Float[jax.Array, "*S K 3"]
    p_workpiece: Float[jax.Array, "*S K 3"]
    q_workpiece: Float[jax.Array, "*S K 3"]
    T: Float[jax.Array, "*S K 4 4"] | None = None  # poses of the bodies' links in the world, for an arm with pieces


def bodies_at(robot: Robot, where: HasWorkpiecePose, x: Joints) -> BodyAxes:
    """Return the bodies' positions at configuration x [rad or m]."""
    p, q = kinematics.capsule_segments(robot, x)
    bodies = BodyAxes(p, q, in_workpiece(where, p), in_workpiece(where, q))
    return bodies if robot.pieces is None else bodies._replace(T=kinematics.body_poses(robot, x))


def in_workpiece(where: HasWorkpiecePose, points: Float[jax.Array, "n 3"]) -> Float[jax.Array, "n 3"]:
    """Return world points [m] in the workpiece's frame."""
    rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
    return product(points - translate[None, :], rotate)


class Obstacle:
    """Base class of all kinds of obstacle.

    A kind defines `contacts`; it may define the others, where it has something better than the defaults. Distances are
    exact or lower bounds, in metres; `bodies` are those at one configuration.

    per_body: its rows are the K bodies', shared with other such kinds; a kind of its own rows defines `rows`, too.
    of_workpiece: it is a part of the workpiece, in messages. sweeps: it defines `clear_along`. names: of its parts.
    in_pairs: for an arm with pieces it defines `doubts`, and no other query.
    """

    per_body: ClassVar[bool] = True
    of_workpiece: ClassVar[bool] = False
    sweeps: ClassVar[bool] = False
    in_pairs: ClassVar[bool] = False
    names: ClassVar[tuple[str, ...]] = ()

    def rows(self, robot: Robot) -> RowPairs:
        """Return the pairs that its rows are between."""
        return RowPairs.of_bodies(robot)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return every row's contact.

        At other configurations, a fixed contact must never predict less than the true distance, see `contact_model`.
        For a kind with `per_body`, a body without a contact has infinite distance.
        """
        raise NotImplementedError

    def doubts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Any:
        """Return the `narrow_phase.Doubts`, for a kind with `in_pairs` and an arm with pieces."""
        raise NotImplementedError

    def closest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return contacts of which only the one with the smallest distance has to be exact.

        The others may be overestimated.
        """
        return self.contacts(robot, where, bodies)

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
        """Return the smallest distance of all rows."""
        return jnp.min(self.contacts(robot, where, bodies).distance)

    def touches(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Bool[jax.Array, ""]:
        """Return True if any distance is 0 or less."""
        return self.smallest(robot, where, bodies) <= 0

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[jax.Array, "R"]:
        """Return each row's free radius; at most 0 in collision.

        It is a displacement of all points of the row's body, in any direction, as seen from the link of the row's
        other, within which the body is proven to stay clear.
        """
        return self.contacts(robot, where, bodies).distance

    def touches_along(
        self,
        robot: Robot,
        where: HasWorkpiecePose,
        bodies: BodyAxes,
        body: Int[jax.Array, ""],
        requested: Bool[jax.Array, "S"],
    ) -> Bool[jax.Array, ""]:
        """Return True if one body touches at any of the S configurations marked in `requested`.

        `bodies` are those at all of them. For kinds with `per_body`.
        """
        distance = jax.vmap(lambda own: self.contacts(robot, where, own).distance)(bodies)
        return jnp.any(requested & (distance[:, body] <= 0))

    def clear_along(
        self,
        robot: Robot,
        where: HasWorkpiecePose,
        bodies: BodyAxes,
        sweep: BodySweep,
        requested: Bool[jax.Array, "K"],
        wanted: RequiredClearance,
    ) -> Float[jax.Array, "K"]:
        """Return a lower bound on the clearance of each body in `requested` along the sweep.

        It is tighter than distance minus travel. Once a body has less than `wanted.least`, the values of the others are
        arbitrary. For kinds with `per_body`.
        """
        raise NotImplementedError

    def surely_touches(
        self,
        where: HasWorkpiecePose,
        margin_m: Scalar,
        p: Float[jax.Array, "n 3"],
        q: Float[jax.Array, "n 3"],
        radius: Float[jax.Array, "n"],
        moves: Float[jax.Array, "n"],
    ) -> Bool[jax.Array, ""]:
        """Return True if one of n capsules surely has less clearance than a margin.

        The capsules are in the world; their points may be anywhere within `moves` [m]. False where that is not known;
        margin_m [m].
        """
        return jnp.zeros((), bool)

    def nearest_name(self, robot: Robot, where: HasWorkpiecePose, row: int, bodies: BodyAxes) -> str:
        """Return the name of its part nearest to the body of a row, by what decides there, for messages."""
        return f"the obstacle {type(self).__name__!r}"


Obstacles = tuple[Obstacle, ...]


def rows_of(robot: Robot, obstacles: Obstacles) -> RowPairs:
    """Return the pairs that the rows of all obstacles together are between."""
    parts = [own[0].rows(robot) for own in grouped(obstacles)]
    return RowPairs(*(sum(columns, start=()) for columns in zip(*parts, strict=True)))


def grouped(obstacles: Obstacles) -> list[Obstacles]:
    """Return the obstacles that share the bodies' rows as one group, then every other one by itself."""
    shared = tuple(each for each in obstacles if each.per_body)
    return [own for own in (shared, *((each,) for each in obstacles if not each.per_body)) if own]


def slopes(
    robot: Robot,
    x: Joints,
    rows: RowPairs,
    normal: Float[jax.Array, "R 3"],
    point: Float[jax.Array, "R 3"],
    witness: Float[jax.Array, "R 3"],
) -> Float[jax.Array, "R N"]:
    """Return the rate at which a point of each row's body leaves the obstacle's along the normal [m/rad].

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        rows: The pairs.
        normal: Unit vectors from the obstacle to the body, world.
        point: Points of the bodies at x, world [m].
        witness: Points of the obstacles at x, world [m].
    """
    motion = kinematics.point_jacobians(robot, x, point, tuple(robot.capsule_link[body] for body in rows.body))
    if any(link >= 0 for link in rows.other):
        motion = motion - kinematics.point_jacobians(robot, x, witness, rows.other)
    return jnp.sum(normal[:, :, None] * motion, axis=1)
