"""Obstacles of the work cell, fixed in the world.

A mesh that is closed and convex becomes a solid. Any other mesh is sampled by points, like a workpiece's mesh, and the
points' covering radius is subtracted from every distance.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float as HostFloat

from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Polyhedron, Rod, Solid
from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.clearance.obstacles import narrow_phase
from htcp_jax.clearance.obstacles.cloud import Cloud, cloud_of
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.obstacles.obstacle import BodyAxes, Contacts, HasWorkpiecePose, Obstacle, Obstacles
from htcp_jax.model import Fixture, PointCover, Robot, cover_mesh, thinnest_nearby
from htcp_jax.model import robot as robots
from htcp_jax.numerics import product
from htcp_jax.pytree import LABEL, register_pytree
from htcp_jax.types import Float, Pose, Scalar


class _PlacedFrame(NamedTuple):
    T_world_workpiece: Pose
    interior_plane: Float[jax.Array, "4"]
    margin_m: Scalar


@register_pytree
@dataclass(frozen=True)
class PlacedCloud(Obstacle):
    """A point cloud fixed in the world.

    Bodies that are fixed in the world, and bodies of excluded links, are not checked.
    """

    cloud: Cloud
    T_world: Pose
    name: str = field(metadata=LABEL)
    excluded: tuple[int, ...] = field(default=(), metadata={"static": True})  # links whose bodies are not checked

    sweeps = True
    is_exact = True

    def contacts(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Contacts:
        """Return the contact of every body with its nearest point."""
        return self.cloud.contacts(*self._seen(robot, where, bodies))

    def smallest(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Scalar:
        """Return the smallest distance of all bodies [m]."""
        return self.cloud.smallest(*self._seen(robot, where, bodies))

    def any_below(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, limit_m: Scalar) -> Scalar:
        """Return a distance below the limit [m], if there is one."""
        return self.cloud.any_below(*self._seen(robot, where, bodies), limit_m)

    def free_radius(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> Float[jax.Array, "K"]:
        """Return each body's distance [m]: it is a free radius, as the cloud does not move."""
        return self.cloud.free_radius(*self._seen(robot, where, bodies))

    def free_radius_up_to(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, enough: Float[jax.Array, "K"]
    ) -> Float[jax.Array, "K"]:
        """Return each needed body's distance [m]; -inf for the others."""
        return self.cloud.free_radius_up_to(*self._seen(robot, where, bodies), enough)

    def clear_along(
        self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes, sweep: BodySweep, wanted: RequiredClearance
    ) -> Float[jax.Array, "K"]:
        """Return lower bounds on the clearance along the sweep [m], to second order."""
        return self.cloud.clear_along(*self._seen(robot, where, bodies), sweep, wanted)

    @property
    def covering_radius_m(self) -> float:
        """Covering radius of the points, which is subtracted from every distance [m]."""
        return self.cloud.covering_radius_m

    @property
    def of_mesh(self) -> bool:
        """True if the points stand for a mesh."""
        return self.cloud.of_mesh

    @property
    def without_covering_radius(self) -> "PlacedCloud":
        """The points alone."""
        return dataclasses.replace(self, cloud=self.cloud.without_covering_radius)

    @property
    def names(self) -> tuple[str]:
        """The cloud's name, as a tuple."""
        return (self.name,)

    def part_name(self, robot: Robot, part: int) -> str:
        """Return the cloud's name, for messages."""
        return f"the fixture {self.name!r}"

    def _seen(self, robot: Robot, where: HasWorkpiecePose, bodies: BodyAxes) -> tuple[Robot, _PlacedFrame, BodyAxes]:
        """Return the arguments for the methods of `Cloud`: robot, pose, and bodies in the cloud's frame.

        Bodies that are not checked get the radius -FAR_M, so that they are far from everything.
        """
        R, t = self.T_world[:3, :3], self.T_world[:3, 3].reshape(1, 3)
        own = bodies._replace(p_workpiece=product(bodies.p - t, R), q_workpiece=product(bodies.q - t, R))
        links = jnp.asarray(robot.capsule_link)
        is_checked = (links >= 0) & ~jnp.isin(links, jnp.array(self.excluded, int))
        radius = jnp.where(is_checked, robot.capsule_radius, -robots.FAR_M)
        return (
            dataclasses.replace(robot, capsule_radius=radius),
            _PlacedFrame(self.T_world, jnp.zeros(4), narrow_phase.margin_m(where)),
            own,
        )


def make_fixtures(
    robot: Robot, shapes: Sequence[Fixture], excluded: Mapping[str, Collection[int]] = MappingProxyType({})
) -> Obstacles:
    """Return the obstacles of a cell's shapes for a robot.

    Args:
        robot: The robot.
        shapes: The shapes.
        excluded: Name of a shape -> indices of links whose bodies are not checked against this shape.

    Raises:
        InputError: If a mesh has no area; the message names it.
    """
    solids = [(each.name, found) for each in shapes if (found := solid_of(each)) is not None]
    meshes = [each for each in shapes if each.kind == "mesh" and not each.convex]
    clouds = []
    for mesh in meshes:
        T, without = np.eye(4), tuple(excluded.get(mesh.name, ()))
        points = _covered(robot, mesh.triangles, T, f"fixture {mesh.name!r}", without)
        clouds.append(PlacedCloud(cloud_of(*points), jnp.asarray(T), mesh.name, without))
    return ((fixtures(robot, solids, excluded),) if solids else ()) + tuple(clouds)


def placed_cloud(
    robot: Robot,
    points: HostFloat[np.ndarray, "P 3"],
    triangles: HostFloat[np.ndarray, "F 3 3"],
    T_world: HostFloat[np.ndarray, "4 4"],
    source: str,
    name: str,
    excluded: Collection[int] = (),
) -> PlacedCloud:
    """Return a cloud at a pose: the given points or, if there are triangles, points sampled on them.

    Args:
        robot: The robot. Its thinnest body that can reach the mesh determines the spacing of the points.
        points: The points [m].
        triangles: The mesh [m]; empty for a cloud of the given points.
        T_world: The pose [m].
        source: Name of the mesh in messages.
        name: Name of the obstacle.
        excluded: Indices of links whose bodies are not checked against the obstacle.

    Raises:
        InputError: For a mesh without an area, and if it needs too many points.
    """
    is_mesh = len(triangles) > 0
    found = _covered(robot, triangles, T_world, source, excluded) if is_mesh else PointCover(points, 0.0)
    return PlacedCloud(cloud_of(*found), jnp.asarray(T_world), name, tuple(excluded))


def _covered(
    robot: Robot,
    triangles: HostFloat[np.ndarray, "F 3 3"],
    T_world: HostFloat[np.ndarray, "4 4"],
    source: str,
    excluded: Collection[int],
) -> PointCover:
    base = T_world[:3, :3].T @ (np.asarray(robot.T_parent_joint)[0, :3, 3] - T_world[:3, 3])
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    distance = float(np.linalg.norm(np.maximum(np.maximum(low - base, base - high), 0.0)))  # to the mesh's bounding box
    return cover_mesh(triangles, source, body=thinnest_nearby(robot, distance, excluded))


def solid_of(shape: Fixture) -> Solid | None:
    """Return a shape as a solid; None for a mesh that is not convex."""
    R, t, size = shape.T_world[:3, :3], shape.T_world[:3, 3], shape.size
    if shape.kind == "plane":
        return HalfSpace(R[:, 2], R[:, 2] @ t)
    if shape.kind == "sphere":
        return Rod(t, t, size[0])
    if shape.kind == "capsule":
        return Rod(t + size[1] * R[:, 2], t - size[1] * R[:, 2], size[0])
    if shape.kind == "box":
        return Box(R, t, size)
    if shape.kind == "cylinder":
        return Cylinder(R, t, size[0], size[1])
    return convex_piece(shape.triangles.reshape(-1, 3)) if shape.convex else None


def convex_piece(points: HostFloat[np.ndarray, "V 3"]) -> Polyhedron:
    """Return the convex hull of points that are not in one plane, world [m]."""
    hull = scipy.spatial.ConvexHull(points)
    corners, normal = points[hull.simplices], hull.equations[:, :3]
    backwards = np.einsum("fi,fi->f", np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)), normal) < 0
    corners[backwards] = corners[backwards, ::-1]
    edges, adjacent = [], []
    for face, neighbours in enumerate(hull.neighbors):
        for side, other in enumerate(neighbours):  # neighbour i is opposite corner i
            if face < other:
                edges.append(points[np.delete(hull.simplices[face], side)])
                adjacent.append((face, other))
    return Polyhedron(corners, normal, np.array(edges), np.array(adjacent))
