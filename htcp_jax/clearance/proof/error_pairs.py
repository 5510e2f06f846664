"""Pairs of a body and a feature that decide up to which scale errors cause no contact, see `error_bound`.

All pairs are found whose clearance at an interval's middle is at most the largest displacement of both sides: points of
clouds by a tree, solids and other bodies by bounding boxes and balls. All others have the largest scale to return. For
a body with a convex piece, both its capsule and its piece enclose the mesh, so the larger scale counts.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.obstacles.fixtures import Fixtures
from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Obstacle, bodies_at
from htcp_jax.clearance.obstacles.of_workpiece import Interior
from htcp_jax.clearance.obstacles.self_collision import SelfCollision
from htcp_jax.clearance.proof.error_bound import (
    NOTHING,
    Levers,
    Pairs,
    Places,
    displacement_size,
    largest_moves,
    levers_of,
    piece_radius,
    scales,
)
from htcp_jax.clearance.proof.error_scene import PLACES, ErrorScene, Points, Solid, normals_between, placed
from htcp_jax.model import Robot, surface
from htcp_jax.numerics import ragged_rows, table_size

BALLS = 64  # maximum number of balls that cover a body for the search among points
NUMBERS = 1 << 21  # entries of the largest table of a bound; more pairs are bounded in portions
SECTIONS = 6  # sections of a capsule that are bounded one by one
UNKNOWN = np.full(3, np.nan)


class Limits(NamedTuple):
    """The smallest scales found, one row for each pair or body that may limit them."""

    place: Int[np.ndarray, "P"]
    scale: Float[np.ndarray, "P"]  # [1]
    body: Int[np.ndarray, "P"]
    obstacle: Int[np.ndarray, "P"]  # number of the obstacle


def limits_at(scene: ErrorScene, places: Places, margin_m: float, most: float) -> Limits:
    """Return the smallest scales in each interval; an interval without a row has at least `most`.

    Args:
        scene: The scene.
        places: The intervals.
        margin_m: Required clearance [m].
        most: Largest scale to return [1].
    """
    ends = placed(scene, places, scene.ends)
    levers = levers_of(scene.robot, places)
    moves = largest_moves(scene.robot, scene.errors, places, levers, ends, most) + margin_m + NOTHING
    here = _Here(scene, places, levers, ends, moves, margin_m, most)
    found = []
    for number, each in enumerate(scene.obstacles):
        if number in scene.clouds:
            found.append(here.by_points(number, scene.clouds[number]))
        elif number in scene.solids:
            found.append(here.by_solids(number, each, scene.solids[number]))
        elif isinstance(each, SelfCollision):
            found.append(here.by_bodies(number, each))
        elif isinstance(each, Interior):
            found.append(here.by_interior(number, each))
        else:
            found.append(here.by_distance(number, each))
    return Limits(*map(np.concatenate, zip(*found, strict=True)))


@dataclass(frozen=True)
class _Here:
    """The bodies in n intervals."""

    scene: ErrorScene
    at: Places
    levers: Levers
    ends: Float[np.ndarray, "n K 2 3"]  # of the capsules' axes at the middles [m]
    moves: Float[np.ndarray, "n K"]  # margin, and largest displacement of each body's points [m]
    margin_m: float
    most: float

    @property
    def radius(self) -> Float[np.ndarray, "K"]:
        return np.asarray(self.scene.robot.capsule_radius)

    def by_points(self, number: int, own: Points) -> Limits:
        """Return the limits by a cloud."""
        errors, most = self.scene.errors, self.most
        reach = self.moves
        if own.of_part:
            far = np.linalg.norm(own.points - errors.part_about_m, axis=1).max()
            part = displacement_size(errors.part_shift_m, errors.part_turn_rad, far) + errors.cloud_m
            reach = reach + most * part
        place, body, row = self._points_near(own, reach + own.cover + self.radius)
        point = own.points[row]
        near = self._is_near(place, body, point, reach[place, body] + own.cover)
        place, body, point = place[near], body[near], point[near]
        apart = _on_axis(self.ends[place, body], point) - point
        away = np.linalg.norm(apart, axis=1)
        normal = apart / np.maximum(away, 1e-300)[:, None]
        known = point if own.of_part else np.broadcast_to(UNKNOWN, point.shape)

        def bounded(rows, normal, distance):
            """Return the scales of points that are `distance` from planes fixed to the bodies [m]."""
            corner, zero = point[rows][:, None], np.zeros(len(rows))
            height = np.einsum("pi,pi->p", normal, point[rows]) - distance + own.cover
            more = {"point": known[rows], "in_body": True}
            return self._portions(place[rows], body[rows], corner, zero, normal, height, **more)

        found = bounded(np.arange(len(place)), normal, away - self.radius[body])
        rows = np.flatnonzero(self.scene.has_piece[body] & (found < most))
        if len(rows):
            over, outward = self._over_pieces(place[rows], body[rows], point[rows])
            found[rows] = np.maximum(found[rows], bounded(rows, -outward, over))
            corners, radius = self._corners(place[rows], body[rows], True)
            normal = normals_between(corners, point[rows][:, None])
            lowest = np.einsum("pvi,pi->pv", corners - point[rows][:, None], normal).min(axis=1)
            found[rows] = np.maximum(found[rows], bounded(rows, normal, lowest - radius))
        return self._limits(number, place, body, found)

    def by_solids(self, number: int, own: Fixtures, solids: Sequence[Solid]) -> Limits:
        """Return the limits by solids of the cell."""
        low, high = self.ends.min(axis=2), self.ends.max(axis=2)
        is_checked, parts = np.asarray(own.is_checked), []
        for solid in solids:
            if solid.plane is not None:
                away = (self.ends @ solid.plane[:3]).min(axis=2) - solid.plane[3]
            else:
                least, largest = solid.corners.min(axis=0) - solid.radius, solid.corners.max(axis=0) + solid.radius
                away = np.linalg.norm(np.maximum(np.maximum(least - high, low - largest), 0.0), axis=2)
            near = (away - self.radius <= self.moves) & is_checked[solid.number]
            place, body = np.nonzero(near)
            if not len(place):
                continue
            parts.append(self._limits(number, place, body, self._by_solid(solid, place, body)))
        return _joined(parts)

    def _by_solid(self, solid: Solid, place, body) -> Float[np.ndarray, "P"]:
        found = np.zeros(len(place))
        for is_piece in (False, True):
            rows = (
                np.flatnonzero(self.scene.has_piece[body] & (found < self.most)) if is_piece else np.arange(len(body))
            )
            if not len(rows):
                continue
            least = np.full(len(rows), self.most)
            for corners, radius in self._shapes(place[rows], body[rows], is_piece):
                if solid.plane is not None:
                    normal = np.broadcast_to(solid.plane[:3], (len(rows), 3))
                    height = np.full(len(rows), solid.plane[3])
                else:
                    others = np.broadcast_to(solid.corners, (len(rows), *solid.corners.shape))
                    normal = normals_between(corners, others)
                    height = solid.height(normal)
                least = np.minimum(least, self._portions(place[rows], body[rows], corners, radius, normal, height))
            found[rows] = np.maximum(found[rows], least)
        return found

    def by_bodies(self, number: int, own: SelfCollision) -> Limits:
        """Return the limits by the arm's own bodies."""
        link, parts = np.array(self.scene.robot.capsule_link), []
        middle = self.ends.mean(axis=2)
        half = 0.5 * np.linalg.norm(self.ends[0, :, 1] - self.ends[0, :, 0], axis=1) + self.radius
        for first, second in own.pairs:
            away = np.linalg.norm(middle[:, first] - middle[:, second], axis=1) - half[first] - half[second]
            near = np.flatnonzero(away <= self.moves[:, first] + self.moves[:, second])
            if len(near):
                body, other = np.full(len(near), first), np.full(len(near), second)
                parts.append(self._limits(number, near, body, self._by_body(near, body, other, int(link[second]))))
        return _joined(parts)

    def _by_body(self, place, body, other, link: int) -> Float[np.ndarray, "P"]:
        found = np.zeros(len(place))
        has_piece = bool(self.scene.has_piece[[body[0], other[0]]].any())
        for is_piece in (False, True) if has_piece else (False,):
            rows = np.flatnonzero(found < self.most)
            if not len(rows):
                break
            others, around = self._corners(place[rows], other[rows], is_piece)
            least = np.full(len(rows), self.most)
            for corners, radius in self._shapes(place[rows], body[rows], is_piece):
                normal = normals_between(corners, others)
                height = np.einsum("pvi,pi->pv", others, normal).max(axis=1) + around
                known = (place[rows], body[rows], corners, radius, normal, height)
                least = np.minimum(least, self._portions(*known, other=link, other_body=other[rows]))
            found[rows] = np.maximum(found[rows], least)
        return found

    def by_interior(self, number: int, own: Interior) -> Limits:
        """Return the limits by the interior rule: each end is in front of the interior's plane, or in the hull."""
        errors, where = self.scene.errors, self.scene.where
        plane = np.asarray(where.interior_plane)
        if not np.isfinite(plane).all():
            return _joined([])
        far = np.linalg.norm(self.ends - errors.part_about_m, axis=3)
        part = np.linalg.norm(errors.part_shift_m) * (1 + self.most * np.linalg.norm(errors.part_turn_rad))
        reach = self.moves[:, :, None] + self.most * (part + np.linalg.norm(errors.part_turn_rad) * far)
        before = plane[3] - self.ends @ plane[:3]
        place, body, end = np.nonzero(before <= reach)
        if not len(place):
            return _joined([])
        T = np.asarray(where.T_world_workpiece)
        outward = np.asarray(own.hull.normal) @ T[:3, :3].T
        offset = np.asarray(own.hull.offset) + outward @ T[:3, 3]
        by_plane = self._by_sides(place, body, end, np.tile(-plane[:3], (len(place), 1)), -before[place, body, end])
        open_ = np.flatnonzero(by_plane < self.most)
        in_hull = np.full(len(place), self.most)
        size = max(1, NUMBERS // max(1, len(offset)))
        for rows in (open_[k : k + size] for k in range(0, len(open_), size)):
            depth = offset - self.ends[place[rows], body[rows], end[rows]] @ outward.T
            pair, facet = np.nonzero(depth <= reach[place[rows], body[rows], end[rows]][:, None])
            near = rows[pair]
            new = self._by_sides(place[near], body[near], end[near], -outward[facet], -depth[pair, facet])
            np.minimum.at(in_hull, near, new)
        return self._limits(number, place, body, np.maximum(by_plane, in_hull))

    def _by_sides(self, place, body, end, normal, less_m) -> Float[np.ndarray, "P"]:
        """Return the scales of ends that are -`less_m` beyond planes of the part [m]."""
        corner = self.ends[place, body, end]
        height = np.einsum("pi,pi->p", normal, corner) + less_m
        return self._portions(place, body, corner[:, None], np.zeros(len(place)), normal, height, is_side=True)

    def by_distance(self, number: int, own: Obstacle) -> Limits:
        """Return the limits by an obstacle of which only distances are known."""
        rows, count = own.rows(self.scene.robot), len(self.at.x)
        most = table_size(count, PLACES)
        x = jnp.asarray(np.resize(self.at.x, (most, self.at.x.shape[1])))
        free = np.asarray(_free_radii(own, self.scene.robot, self.scene.where, x))[:count]
        bodies, others = np.array(rows.body), np.array(rows.others)
        place, row = np.nonzero(free <= 2 * self.moves.max())
        corners = _boxes(self.ends[place, bodies[row]], piece_radius(self.scene.robot)[bodies[row]])
        normal, radius = np.broadcast_to(UNKNOWN, (len(place), 3)), np.zeros(len(place))
        found = self._portions(place, bodies[row], corners, radius, normal, free[place, row], other=others[row])
        return self._limits(number, place, bodies[row], found)

    def _limits(self, number: int, place, body, scale) -> Limits:
        kept = scale < self.most
        return Limits(place[kept], scale[kept], body[kept], np.full(int(kept.sum()), number))

    def _portions(self, place, body, corners, radius, normal, height, **more) -> Float[np.ndarray, "P"]:
        """Return the scales of pairs, in portions."""
        size = max(1, NUMBERS // (9 * corners.shape[1] * len(self.scene.robot.slides)))
        found = np.zeros(len(place))
        for first in range(0, len(place), size):
            rows = slice(first, first + size)
            known = {name: each if np.ndim(each) == 0 else each[rows] for name, each in more.items()}
            own = (each[rows] for each in (place, body, corners, radius, normal, height))
            found[rows] = self._bounded(*own, **known)
        return found

    def _bounded(
        self,
        place,
        body,
        corners,
        radius,
        normal,
        height,
        point=UNKNOWN,
        other=-1,
        other_body=-1,
        is_side=False,
        in_body=False,
    ) -> Float[np.ndarray, "P"]:
        count, scene = len(place), self.scene
        point = np.broadcast_to(point, (count, 3))
        other, other_body, is_side, in_body = (
            np.broadcast_to(each, count) for each in (other, other_body, is_side, in_body)
        )
        pairs = Pairs(place, body, other, corners, radius, normal, height, point, is_side, other_body, in_body)
        return scales(scene.robot, scene.errors, self.at, self.levers, pairs, self.margin_m, self.most)

    def _shapes(self, place, body, is_piece: bool) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield corners and radius of convex parts of bodies: sections of capsules, or the pieces."""
        corners, radius = self._corners(place, body, is_piece)
        sections = 1 if is_piece else SECTIONS
        p, d = corners[:, :1], corners[:, 1:2] - corners[:, :1]
        for k in range(sections):
            share = np.array([k, k + 1])[None, :, None] / sections
            yield (corners if is_piece else p + share * d), radius

    def _corners(self, place, body, is_piece: bool) -> tuple[Float[np.ndarray, "P V 3"], Float[np.ndarray, "P"]]:
        """Return corners of bodies and the radius about them [m]; capsules of bodies without a piece."""
        if not is_piece:
            return self.ends[place, body], self.radius[body]
        own = self._piece_corners(place, body)
        has_piece = self.scene.has_piece[body]
        axis = self.ends[place, body][:, np.arange(own.shape[1]) % 2]
        corners = np.where(has_piece[:, None, None], own, axis)
        return corners, np.where(has_piece, self.scene.pieces[1][body], self.radius[body])

    def _piece_corners(self, place, body) -> Float[np.ndarray, "P V 3"]:
        T = self.at.T[place, np.array(self.scene.robot.capsule_link)[body]]
        return np.einsum("pij,pvj->pvi", T[:, :3, :3], self.scene.pieces[0][body]) + T[:, None, :3, 3]

    def _over_pieces(self, place, body, point) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P 3"]]:
        """Return the heights of points over pieces [m], and the outward normals of the planes with these heights."""
        T = self.at.T[place, np.array(self.scene.robot.capsule_link)[body]]
        own = np.einsum("pji,pj->pi", T[:, :3, :3], point - T[:, :3, 3])
        best, normal = np.full(len(place), -np.inf), np.zeros((len(place), 3))
        for k in range(self.scene.pieces[2].shape[1]):
            plane = self.scene.pieces[2][body, k]
            height = np.einsum("pi,pi->p", plane[:, :3], own) - plane[:, 3]
            normal = np.where((height > best)[:, None], plane[:, :3], normal)
            best = np.maximum(best, height)
        return best, np.einsum("pij,pj->pi", T[:, :3, :3], normal)

    def _is_near(self, place, body, point, within: Float[np.ndarray, "P"]) -> Bool[np.ndarray, "P"]:
        """Return True for points at most `within` from bodies [m]: from the capsule and from the piece, if any."""
        away = np.linalg.norm(_on_axis(self.ends[place, body], point) - point, axis=1) - self.radius[body]
        near = away <= within
        rows = np.flatnonzero(near & self.scene.has_piece[body])
        if len(rows):
            near[rows] = self._over_pieces(place[rows], body[rows], point[rows])[0] <= within[rows]
        return near

    def _points_near(self, own: Points, reach: Float[np.ndarray, "n K"]):
        """Return the interval, body and row of all points in clusters that are within `reach` of the bodies' axes."""
        p, q = self.ends[:, :, 0], self.ends[:, :, 1]
        length, wide = np.linalg.norm(q - p, axis=2), own.radius.max()
        away = own.tree.query(0.5 * (p + q))[0]
        place, body = np.nonzero(own.is_checked & (away <= 0.5 * length + reach + wide))
        if not len(place):
            return (np.zeros(0, int),) * 3
        p, q, length, reach = (each[place, body] for each in (p, q, length, reach))
        count = np.clip(np.ceil(2 * length / np.maximum(reach + wide, 1e-6)), 1, BALLS).astype(int)
        pair, nth = ragged_rows(count)
        centre = p[pair] + ((nth + 0.5) / count[pair])[:, None] * (q - p)[pair]
        size = np.hypot((reach + wide)[pair], 0.5 * (length / count)[pair])
        pair = np.concatenate([pair, np.tile(np.arange(len(place)), 2)])
        centre, size = np.concatenate([centre, p, q]), np.concatenate([size, reach + wide, reach + wide]) + NOTHING
        hits = own.tree.query_ball_point(centre, size, return_sorted=False)
        counts = np.fromiter(map(len, hits), int, len(hits))
        clusters = np.fromiter(itertools.chain.from_iterable(hits), int, int(counts.sum()))
        key = np.unique(np.repeat(pair, counts) * len(own.first) + clusters)
        pair, cluster = np.divmod(key, len(own.first))
        within = reach[pair] - self.radius[body[pair]] + own.radius[cluster] + NOTHING
        near = self._is_near(place[pair], body[pair], own.middle[cluster], within)
        pair, cluster = pair[near], cluster[near]
        at, nth = ragged_rows(own.count[cluster])
        return place[pair[at]], body[pair[at]], own.first[cluster[at]] + nth


def _on_axis(ends: Float[np.ndarray, "P 2 3"], point: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "P 3"]:
    """Return the points of axes that are nearest to points [m]."""
    d = ends[:, 1] - ends[:, 0]
    return ends[:, 0] + surface.nearest_share(point - ends[:, 0], d)[:, None] * d


def _joined(parts: Sequence[Limits]) -> Limits:
    none = np.zeros(0, int)
    return Limits(*map(np.concatenate, zip(Limits(none, np.zeros(0), none, none), *parts, strict=True)))


@jax.jit
@partial(jax.vmap, in_axes=(None, None, None, 0))
def _free_radii(own: Obstacle, robot: Robot, where: HasWorkpiecePose, x):
    return own.free_radius(robot, where, bodies_at(robot, where, x))


def _boxes(ends: Float[np.ndarray, "P 2 3"], radius: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P 8 3"]:
    """Return the corners of boxes about axes with a radius [m]: a displacement is largest at a corner."""
    axis = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(length > 0, axis / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sides = np.stack([axis, across, np.cross(axis, across)], axis=1) * radius[:, None, None]
    signs = np.array([(a, b, c) for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])
    return ends[:, (signs[:, 0] > 0).astype(int)] + np.einsum("vi,pij->pvj", signs, sides)
