"""A point cloud as an obstacle. D is the distance from a capsule's axis to the nearest point, less the radius.

If the points were sampled on a mesh, D is reduced by their covering radius, and is a lower bound on the clearance to
the mesh. The nearest point is found once and then fixed. The gradient is therefore that of a distance to a fixed point:
exact wherever D is differentiable, and one of the one-sided gradients elsewhere.
"""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.backend import backend
from htcp_jax.clearance.distance.cloud_pieces import lowest_points
from htcp_jax.clearance.distance.cloud_sweep import clear_along
from htcp_jax.clearance.distance.cloud_tree import body_within, build_index, nearest_body, nearest_rows
from htcp_jax.clearance.distance.clusters import CloudIndex
from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance, SweptCapsules
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle, in_workpiece
from htcp_jax.model import Robot
from htcp_jax.model import robot as robots
from htcp_jax.numerics import axis_contact, capsule_point_distance, product, with_repeated
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Bool, Float, Scalar

# On a CPU the tree of more than SMALL points on a mesh has at least 4 levels: up to a million share executables.
SMALL, MESH_LEVELS = 4096, 4


@register_pytree
@dataclass(frozen=True)
class Cloud(Obstacle):
    """Point cloud of a workpiece: P points in the workpiece frame [m], and their search index.

    For every distance, bodies are thickened by the covering radius `cover` [m].
    """

    points: Float[jax.Array, "P 3"]  # on a CPU, with padding by the last one
    index: CloudIndex
    cover: Float[jax.Array, ""]
    count: int = field(metadata=LABEL)  # of points, without padding
    of_mesh: bool = field(default=False, metadata=LABEL)  # True: the points stand for a mesh

    of_workpiece = True
    sweeps = True
    is_exact = True

    @property
    def covering_radius_m(self) -> float:
        """Covering radius of the points, which is subtracted from every distance [m]."""
        return float(self.cover)

    @property
    def without_covering_radius(self) -> "Cloud":
        """The points alone."""
        return replace(self, cover=jax.device_put(np.zeros(())))

    def __repr__(self) -> str:
        return f"Cloud({self.count} points)"

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with its nearest point."""
        return self._nearest(robot, where, bodies, None)

    def free_radius_up_to(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, enough: Float[jax.Array, "K"]
    ) -> Float[jax.Array, "K"]:
        """Return each needed body's distance [m]; -inf for the others, for which no point is searched."""
        needed = enough > -jnp.inf
        return jnp.where(needed, self._nearest(robot, where, bodies, needed).distance, -jnp.inf)

    def _nearest(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, needed: Bool[jax.Array, "K"] | None
    ) -> Contacts:
        """Return the contact of every needed body with its nearest point; any contact for the others."""
        is_tested = robots.radius_to_workpiece(robot) > -robots.FAR_M / 2
        searched = is_tested if needed is None else needed & is_tested
        rows = nearest_rows(self.index, bodies.p_workpiece, bodies.q_workpiece, searched)
        nearest = self.points[rows]
        found = self._contacts(robot, where, bodies, nearest)
        return found if robot.pieces is None else self._by_pieces(robot, where, bodies, found, nearest, needed)

    def closest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with one point: the cloud's point that is nearest to the arm.

        One search for all bodies is enough, as for `smallest`. For an arm with pieces the result is that of
        `contacts`, as the nearest piece may belong to another body than the nearest capsule.
        """
        if robot.pieces is not None:
            return self.contacts(robot, where, bodies)
        radius = robots.radius_to_workpiece(robot) + self.cover
        row = nearest_body(self.index, bodies.p_workpiece, bodies.q_workpiece, radius).row
        return self._contacts(robot, where, bodies, self.points[jnp.broadcast_to(row, radius.shape)])

    def _contacts(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, witness: Float[jax.Array, "K 3"]
    ) -> Contacts:
        """Return the contact of every body with the given point of the cloud, `witness` (K, 3), workpiece frame [m]."""
        rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
        p, q = bodies.p_workpiece, bodies.q_workpiece
        radius = robots.radius_to_workpiece(robot) + self.cover
        point, normal = axis_contact(p, q, witness)
        return Contacts(
            distance=capsule_point_distance(p, q, radius, witness),
            point=product(point, rotate.T) + translate[None, :],
            normal=product(normal, rotate.T),
            radius=radius,
            plane=jnp.zeros(radius.shape, bool),
        )

    def _by_pieces(
        self,
        robot: Robot,
        where: HasWorkpiecePose,
        bodies: BodyAxes,
        capsules: Contacts,
        nearest: Float[jax.Array, "K 3"],
        needed: Bool[jax.Array, "K"] | None,
    ) -> Contacts:
        """Return the contacts of capsules; for capsules in doubt, of the pieces in them, see `narrow_phase`.

        `nearest` is the point nearest to each capsule, workpiece frame [m].
        """
        limit = narrow_phase.limit_m(where)
        doubt = narrow_phase.in_doubt(capsules.distance, robot.pieces.excess_m, limit)
        doubt = doubt if needed is None else doubt & needed
        found = lowest_points(
            self.index,
            robot.pieces.planes,
            narrow_phase.link_poses_in(where.T_world_workpiece, bodies.T),
            bodies.p_workpiece,
            bodies.q_workpiece,
            jnp.where(doubt, robots.radius_to_workpiece(robot) + self.cover + limit, -1.0),
            limit + self.cover,
            nearest,
        )
        rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
        distance = found.height - self.cover
        pieces = Contacts(
            distance=distance,
            point=product(found.point - found.normal * found.height[:, None], rotate.T) + translate[None, :],
            normal=product(-found.normal, rotate.T),
            radius=jnp.broadcast_to(self.cover, distance.shape),
            plane=capsules.plane,
        )
        far = found.height >= limit + self.cover  # no point of the cloud was found
        pieces = narrow_phase.chosen(far, narrow_phase.undecided(capsules, limit), pieces)
        return narrow_phase.decided(capsules, pieces, doubt)

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
        """Return the smallest distance [m]: one search for all bodies, cheaper than one per body."""
        if robot.pieces is not None:
            return super().smallest(robot, where, bodies)
        radius = robots.radius_to_workpiece(robot) + self.cover
        body, row = nearest_body(self.index, bodies.p_workpiece, bodies.q_workpiece, radius)
        p, q = bodies.p_workpiece[body], bodies.q_workpiece[body]
        return capsule_point_distance(p, q, radius[body], self.points[row])

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return a distance below the limit [m]: the search skips all points beyond it."""
        if robot.pieces is not None:
            return super().any_below(robot, where, bodies, limit_m)
        radius = robots.radius_to_workpiece(robot) + self.cover
        body, row = body_within(self.index, bodies.p_workpiece, bodies.q_workpiece, radius + limit_m)
        p, q = bodies.p_workpiece[body], bodies.q_workpiece[body]
        return jnp.where(row < 0, jnp.inf, capsule_point_distance(p, q, radius[body], self.points[row]))

    def clear_along(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, sweep: BodySweep, wanted: RequiredClearance
    ) -> Float[jax.Array, "K"]:
        """Return lower bounds on the clearance along the sweep, to second order: see `cloud_sweep`."""
        rotate, radius = where.T_world_workpiece[:3, :3], robots.radius_to_workpiece(robot) + self.cover
        own = sweep._replace(p=product(sweep.p, rotate), q=product(sweep.q, rotate))
        return clear_along(self.index, bodies.p_workpiece, bodies.q_workpiece, own, radius, wanted)

    def surely_touches(self, where: HasWorkpiecePose, bodies: SweptCapsules) -> Bool[jax.Array, ""]:
        """Return True if a point of the cloud is certainly nearer to a body than the margin."""
        within = bodies.radius + narrow_phase.margin_m(where) - bodies.moves
        own = in_workpiece(where, bodies.p), in_workpiece(where, bodies.q)
        return body_within(self.index, *own, within + self.cover).row >= 0


def cloud_of(points: Float[np.ndarray, "P 3"], covering_radius_m: float) -> Cloud:
    """Return the obstacle of a cloud of points [m]. Their order does not change any distance."""
    points, count, of_mesh = np.asarray(points), len(points), bool(covering_radius_m > 0)
    is_large_mesh = of_mesh and count > SMALL and backend().is_cpu
    index = build_index(points, MESH_LEVELS if is_large_mesh else 2)
    if backend().is_cpu:  # as many as there are places in the tree's leaves
        points = with_repeated(points, index.rows.size)
    return Cloud(*jax.device_put((points, index, np.asarray(covering_radius_m, float))), count, of_mesh)
