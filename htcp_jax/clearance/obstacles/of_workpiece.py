"""Obstacles of a workpiece: the paper's O, which is its points and the interior rule.

By the interior rule, a body outside the cloud's convex hull deep inside the workpiece has a negative clearance. The
interior begins at a plane, at a set depth behind the cloud's inlet. An end of a capsule's axis beyond this plane is
called deep, and must lie in the cloud's convex hull. Otherwise the body's clearance is at most minus the end's distance
outside the hull. A body whose deep ends all lie inside the hull is infinitely far from this obstacle. The crossed facet
is found once and then fixed.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.caching import cached_for_last
from htcp_jax.clearance.distance.half_spaces import HalfSpaces, crossed_facets, depths, half_spaces
from htcp_jax.clearance.distance.sweep import SweptCapsules
from htcp_jax.clearance.obstacles.cloud import Cloud, cloud_of
from htcp_jax.clearance.obstacles.obstacle import (
    DECIDED_M,
    BodyAxes,
    Contacts,
    HasWorkpiecePose,
    Obstacle,
    Obstacles,
    in_workpiece,
)
from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Workpiece
from htcp_jax.numerics import product
from htcp_jax.pytree import register_pytree
from htcp_jax.types import Bool, Float, Scalar

KEEP_OUT = "the keep-out zone around the workpiece's hull"  # in messages
NEAR_M = 0.05  # distance in front of the plane within which the depth in the hull is computed


@cached_for_last(2)
def make_obstacle(workpiece: Workpiece) -> Obstacles:
    """Return a workpiece's obstacles, on the device. Those of the last two workpieces are cached for the next plan.

    Args:
        workpiece: The workpiece.

    Returns:
        A tuple of up to two obstacles. The first is the cloud of the workpiece's points. The second, if the workpiece
        has a hull, is the `Interior` rule: no body may leave the hull below the plane at which the interior begins.
        Functions such as `minimum_clearance` take the complete tuple. It is empty for a workpiece without a cloud.
    """
    if not len(workpiece.cloud):
        return ()
    cloud = cloud_of(workpiece.cloud, workpiece.covering_radius_m)
    if not len(workpiece.hull_offset):
        return (cloud,)
    return cloud, Interior(half_spaces(workpiece.hull_normal, workpiece.hull_offset, workpiece.hull_vertices))


def with_interior(obstacles: Obstacles) -> Obstacles:
    """Return obstacles with the `Interior` rule: if a workpiece has a cloud but no hull, one that is always fulfilled.

    Workpieces with and without an inlet can thus share executables, see `Scene.for_programs`.
    """
    kinds = {type(each) for each in obstacles}
    if Cloud not in kinds or Interior in kinds:
        return obstacles
    return *obstacles, Interior(half_spaces(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))))


def all_obstacles(workpiece: Workpiece, others: Obstacles) -> Obstacles:
    """Return one tuple of the workpiece's cloud, other obstacles and the workpiece's `Interior` rule, if it has them.

    Raises:
        InputError: If there are no obstacles at all.
    """
    cloud_and_interior = make_obstacle(workpiece)
    found = (*cloud_and_interior[:1], *others, *cloud_and_interior[1:])
    if not found:
        raise InputError("no obstacles: set workpiece.cloud, cell.model or cell.clouds, or cell.self_collision: true")
    return found


@register_pytree
@dataclass(frozen=True)
class Interior(Obstacle):
    """The hull of the cloud in the workpiece frame, with at least one facet.

    The plane at which the interior begins is in the scenario, see `HasWorkpiecePose`.
    """

    hull: HalfSpaces

    of_workpiece = True

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the name of the space outside the hull, into which a body's clearance is the negative depth."""
        return KEEP_OUT

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with the facet that its outermost deep end has crossed, if any."""
        rotate, translate = where.T_world_workpiece[:3, :3], where.T_world_workpiece[:3, 3]
        outside, second, inwards = self._outside(where, bodies)
        # Transformed from the workpiece frame, as for the cloud, so that the same end is the same point bit for bit.
        end = jnp.where(second[:, None], bodies.q_workpiece, bodies.p_workpiece)
        return Contacts(
            distance=jnp.where(outside > 0, -outside, jnp.inf),
            point=product(end, rotate.T) + translate[None, :],
            normal=product(inwards, rotate.T),
            radius=jnp.zeros_like(outside),
            plane=jnp.ones(outside.shape, bool),
        )

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
        """Return minus the largest distance of a deep end outside the hull [m]; infinite if none is outside."""
        outside, _, _ = self._outside(where, bodies)
        return jnp.min(jnp.where(outside > 0, -outside, jnp.inf))

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return minus the distance of a deep end outside the hull [m]; infinite if none is outside."""
        outside, _, _ = self._outside(where, bodies, jnp.maximum(DECIDED_M, -limit_m))
        return jnp.min(jnp.where(outside > 0, -outside, jnp.inf))

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[jax.Array, "K"]:
        """Return each body's free radius [m]: the smaller one of its two ends.

        The free radius of an end is its distance to the interior's plane or its depth inside the hull, whichever is
        larger.
        """
        beyond = _depth_of_ends(where, bodies.p, bodies.q)
        return self._deepened(bodies, beyond, beyond > -NEAR_M)

    def free_radius_up_to(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, enough: Float[jax.Array, "K"]
    ) -> Float[jax.Array, "K"]:
        """Return each body's free radius [m]; only its distance to the interior's plane if that is enough."""
        beyond = _depth_of_ends(where, bodies.p, bodies.q)
        requested = (beyond > -NEAR_M) & (-beyond < jnp.tile(enough, 2))
        deepened = lambda: self._deepened(bodies, beyond, requested)  # noqa: E731
        return jax.lax.cond(jnp.any(requested), deepened, lambda: jnp.min(-beyond.reshape(2, -1), axis=0))

    def _deepened(
        self, bodies: BodyAxes, beyond: Float[jax.Array, "ends"], requested: Bool[jax.Array, "ends"]
    ) -> Float[jax.Array, "K"]:
        """Return each body's free radius [m], with the depth in the hull only of requested ends."""
        depth = depths(self.hull, jnp.concatenate([bodies.p_workpiece, bodies.q_workpiece]), requested)
        return jnp.min(jnp.where(requested, jnp.maximum(depth, -beyond), -beyond).reshape(2, -1), axis=0)

    def surely_touches(self, where: HasWorkpiecePose, bodies: SweptCapsules) -> Bool[jax.Array, ""]:
        """Return True if an end of a body is certainly deep and outside the hull, wherever it has moved."""
        p, q, _, moves = bodies
        own, moves = in_workpiece(where, jnp.concatenate([p, q])), jnp.concatenate([moves, moves])
        facet = crossed_facets(self.hull, own, _depth_of_ends(where, p, q) > moves)
        outside = jnp.sum(self.hull.normal[facet] * own, axis=1) - self.hull.offset[facet]
        return jnp.any((facet >= 0) & (outside > moves))

    def _outside(self, where: HasWorkpiecePose, bodies: BodyAxes, enough: Scalar | float = jnp.inf):
        """Return the distance of every body's outermost deep end outside the hull [m], -inf if no end is outside.

        If an end is farther outside than `enough` [m], other ends may be missing.
        Also return True for bodies whose second end is the outermost, and the inward normal of the facet that this end
        crossed, in the workpiece frame.
        """
        both = jnp.concatenate([bodies.p_workpiece, bodies.q_workpiece])
        facet = crossed_facets(self.hull, both, _depth_of_ends(where, bodies.p, bodies.q) > 0, enough)
        normal = self.hull.normal[facet]
        outside = jnp.where(facet < 0, -jnp.inf, jnp.sum(normal * both, axis=1) - self.hull.offset[facet])
        k = bodies.p.shape[0]
        second = outside[k:] > outside[:k]
        return (
            jnp.maximum(outside[:k], outside[k:]),
            second,
            -jnp.where(second[:, None], normal[k:], normal[:k]),
        )


def _depth_of_ends(
    where: HasWorkpiecePose, p: Float[jax.Array, "n 3"], q: Float[jax.Array, "n 3"]
) -> Float[jax.Array, "ends"]:
    """Return the distances by which the ends, first all p, then all q, are beyond the plane [m]."""
    return product(jnp.concatenate([p, q]), where.interior_plane[:3]) - where.interior_plane[3]
