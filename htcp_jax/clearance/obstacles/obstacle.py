"""The base class of obstacles: rows of distances, and cheap queries about them.

A kind of obstacle is a small pytree that derives from `Obstacle`, in a file of its own. Each of its rows is a distance
[m] between a body of the arm and the surroundings, or another body. All kinds with `per_body` share one row per body,
with the distance of the nearest obstacle. Any other kind has its own rows.

`obstacle_kind` has a simpler base class for obstacles of other packages. A `Scene` has the obstacles of a plan.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance, SweptCapsules
from htcp_jax.model import TCP_POSITION, Robot, Task, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.numerics import joined, product
from htcp_jax.pytree import without_labels
from htcp_jax.types import Anywhere, Bool, Float, Int, Joints, Pose, Scalar

THE_WORKPIECE = "the workpiece"  # in messages
DECIDED_M = 1e-12  # [m]; a distance in 64-bit floats is wrong by less than this within 100 m of the origin


@runtime_checkable
class HasWorkpiecePose(Protocol):
    """Protocol of objects with a workpiece pose, such as a scenario."""

    T_world_workpiece: Pose
    interior_plane: Float[jax.Array, "4"]  # unit normal n, offset [m]: ends with n @ x > offset must lie in the hull


class RowPairs(NamedTuple):
    """Both sides of each of R rows of distances: a body, and the link that the obstacle is fixed to."""

    body: Int[Anywhere, "R"]  # index of the capsule
    # link that the obstacle's nearest point is fixed to, nearer to the base, -1 for the world; None: always the world
    other: Int[Anywhere, "R"] | None = None

    @classmethod
    def of_bodies(cls, robot: Robot) -> "RowPairs":
        """Return one row per body, with the world as its other side: the rows of every kind with `per_body`."""
        return cls(np.arange(len(robot.capsule_link)))

    @classmethod
    def concatenate(cls, parts: "Sequence[RowPairs]") -> "RowPairs":
        """Return the rows of several parts, one part after the other."""
        body = joined([part.body for part in parts])
        if all(part.other is None for part in parts):
            return cls(body)
        return cls(body, joined([part.others for part in parts]))

    @property
    def others(self) -> Int[Anywhere, "R"]:
        """The link on the other side of each row; -1 is the world."""
        return np.full(len(self.body), -1) if self.other is None else self.other

    def links(self, robot: Robot) -> Int[Anywhere, "R"]:
        """Return the link of each row's body."""
        links = robot.body_links
        return (links if isinstance(self.body, np.ndarray) else jnp.asarray(links))[self.body]


class Contacts(NamedTuple):
    """Contact of each row: the distance, the nearest point on the body's axis, and the direction from the obstacle."""

    distance: Float[jax.Array, "R"]  # D [m]
    point: Float[jax.Array, "R 3"]  # on the body's axis, world [m]
    normal: Float[jax.Array, "R 3"]  # unit, from the obstacle to the body, world
    radius: Float[jax.Array, "R"]  # distance from the axis at which D is 0 [m]
    plane: Bool[jax.Array, "R"]  # True: the obstacle is a plane fixed in the world that an end of the body has crossed

    @property
    def witness(self) -> Float[jax.Array, "R 3"]:
        """The obstacle's nearest points, world [m]."""
        return self.point - self.normal * (self.distance + self.radius)[:, None]

    @property
    def by_interior_rule(self) -> Bool[jax.Array, "R"]:
        """True for rows whose distance comes from the interior rule: an end of the body's axis is outside the hull."""
        return self.plane & (self.radius == 0)


def surface_points(robot: Robot, rows: RowPairs, touch: Contacts) -> Float[jax.Array, "R 3"]:
    """Return the nearest point on each body's surface, world [m].

    The surface is that of the convex piece if the distance is the piece's, else that of the capsule.
    """
    radius = robot.capsule_radius[jnp.asarray(rows.body)]
    if robot.pieces is not None:  # contacts of pieces are on their surface, or on that of the mesh's cover
        radius = jnp.minimum(radius, touch.radius)
    return touch.point - radius[:, None] * touch.normal


def by_pieces(robot: Robot, rows: RowPairs, touch: Contacts) -> Bool[jax.Array, "R"]:
    """Return True for rows whose distance is that of a convex piece, False for those of a capsule."""
    if robot.pieces is None:
        return jnp.zeros(touch.radius.shape, bool)
    of_capsules = touch.radius >= robot.capsule_radius[jnp.asarray(rows.body)]
    return ~(of_capsules | touch.by_interior_rule)


class BodyAxes(NamedTuple):
    """Ends of the bodies' axes [m], in the world and in the workpiece frame."""

    p: Float[jax.Array, "K 3"]  # first ends, world
    q: Float[jax.Array, "K 3"]  # second ends, world
    p_workpiece: Float[jax.Array, "K 3"]
    q_workpiece: Float[jax.Array, "K 3"]
    T: Float[jax.Array, "K 4 4"] | None = None  # poses of the bodies' links in the world, for an arm with pieces


def bodies_at(robot: Robot, where: HasWorkpiecePose, x: Joints) -> BodyAxes:
    """Return the bodies' positions at configuration x [rad or m]."""
    p, q = kinematics.capsule_segments(robot, x)
    bodies = BodyAxes(p, q, in_workpiece(where, p), in_workpiece(where, q))
    return bodies if robot.pieces is None else bodies._replace(T=kinematics.body_poses(robot, x))


def in_workpiece(where: HasWorkpiecePose, points: Float[jax.Array, "n 3"]) -> Float[jax.Array, "n 3"]:
    """Transform points from the world to the workpiece's frame [m]."""
    rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
    return product(points - translate[None, :], rotate)


class Obstacle:
    """Base class of all kinds of obstacle.

    A kind must define `contacts`. It may override the other methods to be faster or tighter than the defaults.
    Distances are exact or lower bounds, in metres; `bodies` are the bodies at one configuration.

    Attributes:
        per_body: True if the kind has one row for each of the K bodies, shared with other such kinds. If False, the
            kind must define `rows`.
        of_workpiece: True if messages describe the obstacle as the workpiece.
        sweeps: True if the kind defines `clear_along`.
        in_pairs: True if, for an arm with pieces, the kind defines `doubts` and no other query.
        is_exact: True if `free_radius` is the distance of the capsules up to ROUNDING_M, so that it changes by no more
            than the bodies move; for an arm with pieces, if it is above `narrow_phase.limit_m`.
        names: Names of the obstacle's parts.
        of_mesh: True if distances are those from points that stand for a mesh.
        sunk: Text about bodies that are deep in it and are not checked; "" if there are none.
    """

    per_body: ClassVar[bool] = True
    of_workpiece: ClassVar[bool] = False
    sweeps: ClassVar[bool] = False
    in_pairs: ClassVar[bool] = False
    is_exact: ClassVar[bool] = False
    names: ClassVar[tuple[str, ...]] = ()
    of_mesh: ClassVar[bool] = False
    sunk: ClassVar[str] = ""

    def rows(self, robot: Robot) -> RowPairs:
        """Return both sides of each row; by default, one row per body."""
        return RowPairs.of_bodies(robot)

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return every row's contact.

        At any other configuration, the distance to a contact's fixed point must not be less than the true distance,
        see `contact_model`. For a kind with `per_body`, a body without a contact has infinite distance.
        """
        raise NotImplementedError

    def doubts(self, robot: Robot, bodies: BodyAxes, limit: Float[jax.Array, "..."]) -> Any:
        """Return the rows in doubt as `narrow_phase.Doubts`, for a kind with `in_pairs` and an arm with pieces."""
        raise NotImplementedError

    def closest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return every row's contact; only the smallest distance must be exact, others may be overestimated."""
        return self.contacts(robot, where, bodies)

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
        """Return the smallest distance of all rows [m]."""
        return jnp.min(self.contacts(robot, where, bodies).distance)

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return any row's distance [m] that is below the limit; if there is none, any value that is not."""
        return self.smallest(robot, where, bodies)

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[jax.Array, "R"]:
        """Return each row's free radius [m]; at most 0 in collision.

        A body stays clear if every point of it moves by less than the free radius, in any direction, relative to the
        row's other side.
        """
        return self.contacts(robot, where, bodies).distance

    def free_radius_up_to(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, enough: Float[jax.Array, "R"]
    ) -> Float[jax.Array, "R"]:
        """Return each row's free radius or, where that is at least `enough`, any lower bound of at least `enough` [m].

        A row with `enough` = -inf is not needed. An exact kind returns -inf or the free radius for it, and the free
        radius for all others.
        """
        return self.free_radius(robot, where, bodies)

    def clear_along(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, sweep: BodySweep, wanted: RequiredClearance
    ) -> Float[jax.Array, "K"]:
        """Return a lower bound on the clearance of each body in `wanted.requested` along the sweep [m].

        The bound is tighter than distance minus travel. If any body has less than `wanted.least`, the values of the
        other bodies are arbitrary. Only for kinds with `per_body`.
        """
        raise NotImplementedError

    def surely_touches(self, where: HasWorkpiecePose, bodies: SweptCapsules) -> Bool[jax.Array, ""]:
        """Return True if a body certainly has less clearance than the margin of `where`; False if this is not known."""
        return jnp.zeros((), bool)

    def for_programs(self, robot: Robot, bodies: int, closely: bool) -> "Obstacle":
        """Return the obstacle as compiled functions take it, see `Scene.for_programs`.

        Args:
            robot: The robot, without padding.
            bodies: Number of bodies with padding.
            closely: True for little padding.
        """
        return self

    def parts(self, robot: Robot, row: int) -> Sequence[int] | Int[np.ndarray, "n"]:
        """Return the numbers of the parts, at least one, that may be nearest to the body of a row."""
        return (0,)

    def only(self, robot: Robot, part: Int[jax.Array, ""]) -> "Obstacle":
        """Return the obstacle with one of several parts alone, for rows that have this part; all parts if negative."""
        return self

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the name of a part for messages."""
        return THE_WORKPIECE if self.of_workpiece else f"the obstacle {type(self).__name__!r}"

    @property
    def covering_radius_m(self) -> float:
        """Length that is subtracted from every distance, for the gaps between points that stand for a mesh [m]."""
        return 0.0

    @property
    def without_covering_radius(self) -> "Obstacle":
        """The obstacle with distances from the points themselves, which a mesh's distances do not exceed."""
        return self


Obstacles = tuple[Obstacle, ...]


def rows_of(robot: Robot, obstacles: Obstacles) -> RowPairs:
    """Return both sides of each row of all obstacles together."""
    return RowPairs.concatenate([own[0].rows(robot) for own in grouped(obstacles)])


def grouped(obstacles: Obstacles) -> list[Obstacles]:
    """Return the obstacles in groups: first all obstacles with `per_body`, then one group per other obstacle."""
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
    """Return the gradient of each row's distance: the rate at which its nearest points separate [m/rad].

    Args:
        robot: The robot.
        x: The configuration [rad or m].
        rows: Both sides of each row.
        normal: Unit vectors from the obstacle to the body, world.
        point: Points of the bodies at x, world [m].
        witness: Points of the obstacles at x, world [m].
    """
    motion = kinematics.point_jacobians(robot, x, point, rows.links(robot))
    if rows.other is not None:
        motion = motion - kinematics.point_jacobians(robot, x, witness, rows.other)
    return jnp.sum(normal[:, :, None] * motion, axis=1)


class Scene(NamedTuple):
    """Robot, obstacles and task that all scenarios of a plan share."""

    robot: Robot
    obstacles: Obstacles
    task: Task = TCP_POSITION

    @property
    def rows(self) -> RowPairs:
        """Both sides of each row of clearance, see `RowPairs`."""
        return rows_of(self.robot, self.obstacles)

    def for_programs(self, closely: bool = False) -> "Scene":
        """Return the scene as compiled functions take it: without labels, and with the arm's structure as data.

        The number of bodies and that of pairs are padded to one of few, so that most arms with the same number of
        joints share executables. An arm in which joints follow others is not changed.

        Args:
            closely: True for little padding, so that calls are faster, but fewer arms share executables.
        """
        own = self.without_labels()
        if own.robot.coupling is not None:
            return own
        robot = robots.for_programs(own.robot, closely)
        count = len(robot.capsule_link)
        obstacles = tuple(each.for_programs(own.robot, count, closely) for each in own.obstacles)
        return own._replace(robot=robot, obstacles=obstacles)

    def rows_within(self, padded: "Scene") -> Int[np.ndarray, "R"]:
        """Return the indices of the scene's rows among those of the same scene with padding, see `for_programs`."""
        own, theirs = (
            [len(each[0].rows(scene.robot).body) for each in grouped(scene.obstacles)] for scene in (self, padded)
        )
        starts = np.cumsum([0, *theirs])
        return np.concatenate([start + np.arange(count) for start, count in zip(starts, own, strict=False)])

    def without_labels(self) -> "Scene":
        """Return the scene without names and other data that only messages and files need.

        Functions are compiled for such a scene, so that other names do not cause another compilation.
        """
        return self._replace(robot=without_labels(self.robot), obstacles=tuple(map(without_labels, self.obstacles)))


def own_scene(scene: Scene, tool_extension_m: Scalar) -> Scene:
    """Return the scene with the tool lengthened by a scenario's extension [m]."""
    return scene._replace(robot=robots.lengthen_tool(scene.robot, tool_extension_m))
