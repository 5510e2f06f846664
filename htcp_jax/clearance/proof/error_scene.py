"""The bodies of a robot and the features of its obstacles, as `error_pairs` pairs them."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.distance import gjk
from htcp_jax.clearance.distance.solids import Cylinder, HalfSpace, Polyhedron, Rod
from htcp_jax.clearance.obstacles.cloud import Cloud
from htcp_jax.clearance.obstacles.fixtures import CUBE, Fixtures, _prism
from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacle
from htcp_jax.clearance.obstacles.of_cell import PlacedCloud
from htcp_jax.clearance.proof.error_bound import ErrorSet, Places, largest_moves, levers_of
from htcp_jax.model import Robot, kinematics
from htcp_jax.numerics import table_size

CLUSTER = 32  # maximum number of points in a cluster
PLACES = 64  # smallest number of places that are measured together
ROWS = 256  # smallest number of pairs whose normals are computed together


@dataclass(frozen=True)
class ErrorScene:
    """A robot, its obstacles in one scenario, and the errors, for `limits_at`."""

    robot: Robot  # with the scenario's tool
    obstacles: tuple[Obstacle, ...]
    where: HasWorkpiecePose
    errors: ErrorSet

    @cached_property
    def clouds(self) -> dict[int, "Points"]:
        """Points of all clouds by the obstacle's number, in the root's frame."""
        robot, found = self.robot, {}
        links = np.array(robot.capsule_link)
        for number, each in enumerate(self.obstacles):
            if isinstance(each, Cloud):
                is_checked = links >= 0 if robot.part_moves else np.ones(len(links), bool)
                found[number] = Points.of(each, np.asarray(self.where.T_world_workpiece), is_checked, True)
            elif isinstance(each, PlacedCloud):
                is_checked = (links >= 0) & ~np.isin(links, each.excluded)
                found[number] = Points.of(each.cloud, np.asarray(each.T_world), is_checked, False)
        return found

    @cached_property
    def solids(self) -> dict[int, list["Solid"]]:
        """Solids of the cell by the obstacle's number."""
        return {k: list(solids_of(each)) for k, each in enumerate(self.obstacles) if isinstance(each, Fixtures)}

    @cached_property
    def ends(self) -> Float[np.ndarray, "K 2 3"]:
        """Both ends of each capsule's axis, in its link's frame [m]."""
        return np.stack([np.asarray(self.robot.capsule_p), np.asarray(self.robot.capsule_q)], axis=1)

    @cached_property
    def has_piece(self) -> Bool[np.ndarray, "K"]:
        """True for bodies with a convex piece."""
        count = len(self.robot.capsule_link)
        return np.zeros(count, bool) if self.robot.pieces is None else np.asarray(self.robot.pieces.excess_m) > 0

    @cached_property
    def pieces(self) -> tuple[Float[np.ndarray, "K V 3"], Float[np.ndarray, "K"], Float[np.ndarray, "K D 4"]]:
        """Vertices and radius of each body's piece [m], and the planes about it, in its link's frame."""
        own = self.robot.pieces
        return np.asarray(own.piece.vertices), np.asarray(own.piece.radius), np.asarray(own.planes)

    def moves(self, places: Places, most: float) -> Float[np.ndarray, "n K"]:
        """Return bounds on the displacement of each body's points, for all errors up to a scale [m]."""
        ends, levers = placed(self, places, self.ends), levers_of(self.robot, places)
        return largest_moves(self.robot, self.errors, places, levers, ends, most)

    def places(self, x, rates, turns, rest) -> Places:
        """Return intervals with their links' frames, see `Places`."""
        count = len(x)
        most = table_size(count, PLACES)
        T = np.asarray(_link_poses(self.robot, jnp.asarray(np.resize(x, (most, x.shape[1])))))[:count]
        root = np.broadcast_to(np.eye(4), (count, 1, 4, 4))
        return Places(x, rates, turns, rest, np.concatenate([T, root], axis=1))


class Points(NamedTuple):
    """Points of a cloud in clusters, which follow each other, and a tree of the clusters' middles."""

    points: Float[np.ndarray, "P 3"]  # in the root's frame [m]
    cover: float  # radius about each point [m]
    first: Int[np.ndarray, "C"]  # first point of each cluster
    count: Int[np.ndarray, "C"]  # number of its points
    radius: Float[np.ndarray, "C"]  # of a ball about its middle [m]
    tree: scipy.spatial.cKDTree
    is_checked: Bool[np.ndarray, "K"]
    of_part: bool

    @classmethod
    def of(cls, cloud: Cloud, T: Float[np.ndarray, "4 4"], is_checked: Bool[np.ndarray, "K"], of_part: bool):
        """Return the points of a cloud at a pose [m]."""
        points = np.asarray(cloud.points)[: cloud.count] @ T[:3, :3].T + T[:3, 3]
        parts = _split(points, np.arange(len(points)))
        middle = np.array([0.5 * (points[rows].min(axis=0) + points[rows].max(axis=0)) for rows in parts])
        radius = [np.linalg.norm(points[rows] - own, axis=1).max() for rows, own in zip(parts, middle, strict=True)]
        count, points = np.array(list(map(len, parts))), points[np.concatenate(parts)]
        tree = scipy.spatial.cKDTree(middle)
        first = np.cumsum(count) - count
        return cls(points, float(cloud.cover), first, count, np.array(radius), tree, is_checked, of_part)

    @property
    def middle(self) -> Float[np.ndarray, "C 3"]:
        """Middles of the clusters [m]."""
        return self.tree.data


class Solid(NamedTuple):
    """A solid of the cell."""

    number: int  # row of `Fixtures.is_checked`
    corners: Float[np.ndarray, "V 3"]  # of the solid, or of a prism about a cylinder [m]
    radius: float  # about the corners [m]
    plane: Float[np.ndarray, "4"] | None = None  # normal and offset of a half-space
    cylinder: Cylinder | None = None

    def height(self, normal: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P"]:
        """Return the largest n.b of the solid's points [m]."""
        if self.cylinder is None:
            return (normal @ self.corners.T).max(axis=1) + self.radius
        own, across = self.cylinder, normal @ np.asarray(self.cylinder.rotation)
        round_ = float(own.radius) * np.hypot(across[:, 0], across[:, 1])
        return normal @ np.asarray(own.centre) + round_ + float(own.half) * np.abs(across[:, 2])


def _split(points: Float[np.ndarray, "P 3"], rows: Int[np.ndarray, "p"]) -> list[Int[np.ndarray, "_"]]:
    """Return some points' rows in groups of at most CLUSTER near points."""
    if len(rows) <= CLUSTER:
        return [rows]
    own = points[rows]
    axis, half = int(np.ptp(own, axis=0).argmax()), len(rows) // 2
    order = np.argpartition(own[:, axis], half)
    return _split(points, rows[order[:half]]) + _split(points, rows[order[half:]])


def placed(scene: ErrorScene, places: Places, corners: Float[np.ndarray, "K V 3"]) -> Float[np.ndarray, "n K V 3"]:
    """Return points of the bodies' links at the middles of intervals [m]."""
    T = places.T[:, np.array(scene.robot.capsule_link)]
    return np.einsum("nkij,kvj->nkvi", T[..., :3, :3], corners) + T[:, :, None, :3, 3]


def solids_of(own: Fixtures) -> Iterator[Solid]:
    """Yield the solids of a cell, without padding."""
    number = 0
    for stack in (*own.simple, *(() if own.pieces is None else (own.pieces,))):
        leaves, kind = [np.asarray(leaf) for leaf in stack], type(stack)
        for row in range(len(leaves[0])):
            if own.names[number]:
                yield _solid(number, kind(*(leaf[row] for leaf in leaves)))
            number += 1


def _solid(number: int, solid) -> Solid:
    if isinstance(solid, HalfSpace):
        return Solid(number, np.zeros((1, 3)), 0.0, np.append(solid.normal, solid.offset))
    if isinstance(solid, Rod):
        return Solid(number, np.stack([solid.p, solid.q]), float(solid.radius))
    if isinstance(solid, Polyhedron):
        return Solid(number, np.unique(solid.corners.reshape(-1, 3), axis=0), 0.0)
    is_round = isinstance(solid, Cylinder)
    own = _prism(float(solid.radius), float(solid.half)) if is_round else CUBE * solid.half
    return Solid(number, own @ solid.rotation.T + solid.centre, 0.0, cylinder=solid if is_round else None)


def normals_between(bodies: Float[np.ndarray, "P V 3"], others: Float[np.ndarray, "P W 3"]) -> Float[np.ndarray, "P 3"]:
    """Return unit normals from convex features to convex bodies, by the points nearest to each other.

    The normals of bodies that overlap are arbitrary.

    Args:
        bodies: Corners of the bodies [m].
        others: Corners of the features [m].
    """
    count = len(bodies)
    most = table_size(count, ROWS)
    padded = (jnp.asarray(np.resize(each, (most, *each.shape[1:]))) for each in (bodies, others))
    normal = np.asarray(_normals(*padded))[:count]
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(length > 0.5, normal / np.maximum(length, 0.5), np.array([0.0, 0.0, 1.0]))


@jax.jit
@jax.vmap
def _normals(body, other):
    def lowest(corners, direction):
        return corners[jnp.argmin(corners @ direction)]

    return gjk.nearest(partial(lowest, body), partial(lowest, other)).normal


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _link_poses(robot: Robot, x):
    return kinematics.link_poses(robot, x)
