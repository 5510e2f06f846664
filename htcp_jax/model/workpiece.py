"""The workpiece: its walls and tool path in its own frame, its pose in the world, and its convex hull.

Walls are points, in numpy on the host. The points of a mesh cover it within a known distance, which is subtracted from
every clearance. The hull is for the interior rule of the clearance: deep behind the inlet, a point of the robot outside
the hull has pierced the wall.
"""

import copy
import enum
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float

from htcp_jax.caching import cached_by_values
from htcp_jax.errors import InputError
from htcp_jax.model.arrays import points, triple
from htcp_jax.model.path_frames import PathFrames, tangents, wall_normals
from htcp_jax.notebook import html_facts
from htcp_jax.spec import INTERIOR_DEPTH_M, NEUTRAL_TRANSLATION, PIVOT
from htcp_jax.types import Triple


class Hull(NamedTuple):
    """A convex hull: the points x with normal @ x <= offset. The normals have length 1 and point outwards."""

    normal: Float[np.ndarray, "F 3"]  # [1]
    offset: Float[np.ndarray, "F"]  # [m]
    vertices: Float[np.ndarray, "V 3"]  # vertices of the exact hull [m], also for a tolerance above 0


class InletDirection(enum.Enum):
    """Named directions into the part, in place of a vector."""

    WORLD_X = enum.auto()  # the world's x for any rotation of the part, as in the paper
    HULL_FACET = enum.auto()  # inward normal of the hull's facet nearest to the inlet; no interior without an inlet


@dataclass(frozen=True, eq=False)
class Workpiece:
    """A part: the points on its walls, and a tool path, both [m] in the workpiece frame.

    Workpieces are immutable: their arrays are read-only copies. A workpiece with an empty cloud is a path without
    walls.

    Attributes:
        name: Name of the part.
        cloud: Points on the walls.
        path: Points of the tool path; several seams follow each other.
        inlet: Centre of the inlet, a via point of the approach; None: no inlet.
        pivot: Fixed point of the rotation, see `T_world`.
        neutral_translation: Translation that is applied before the rotations, see `T_world`.
        interior_depth_m: Distance behind its nearest point at which the interior begins, see `interior_plane`.
        interior: "hull" computes the half-spaces below; "none" leaves them empty (F = 0), for flat clouds.
        hull_tolerance_m: 0 for the exact hull. A larger tolerance gives fewer facets, which still enclose the cloud and
            extend beyond the exact hull by at most about the tolerance.
        inlet_direction: Direction into the part. Once constructed it is a unit vector, or None for the world's x.
        triangles: The mesh that the cloud was sampled on [m]; none for a cloud.
        covering_radius_m: Largest distance from any point of the mesh to the nearest point of the cloud; 0 for a cloud.
        tip_contact_m: Length of the part of the bare tip, at the TCP, that may touch walls; None: all of the tip.
        frames: The path's normals, tangents and orientations, if given.
        seam_begins: First rows of the second and of each later seam in the path.
        origin: Point of the part's files, in their coordinates, that is the origin of the workpiece frame.
        hull_normal: Outward unit normals of the cloud's convex hull, the points x with hull_normal @ x <= hull_offset.
        hull_offset: Offsets of the hull's half-spaces.
        hull_vertices: Vertices of the exact hull; the complete cloud with interior "none".

    Raises:
        InputError: For arrays of the wrong shape or length, NaN, a cloud of 1 to 3 points, an empty path, and a flat
            cloud with "hull".
    """

    name: str
    cloud: Float[np.ndarray, "P 3"]
    path: Float[np.ndarray, "T 3"]
    inlet: Float[np.ndarray, "3"] | Triple | None = None  # an array once constructed
    pivot: Float[np.ndarray, "3"] | Triple = PIVOT  # an array once constructed
    neutral_translation: Float[np.ndarray, "3"] | Triple = NEUTRAL_TRANSLATION  # an array once constructed
    interior_depth_m: float = INTERIOR_DEPTH_M
    interior: Literal["hull", "none"] = "hull"
    hull_tolerance_m: float = 0.0
    inlet_direction: Float[np.ndarray, "3"] | Triple | InletDirection | None = InletDirection.WORLD_X
    triangles: Float[np.ndarray, "M 3 3"] = field(default_factory=lambda: np.empty((0, 3, 3)))
    covering_radius_m: float = 0.0
    tip_contact_m: float | None = None
    frames: PathFrames = field(default_factory=PathFrames)
    seam_begins: tuple[int, ...] = ()
    origin: Float[np.ndarray, "3"] | Triple = (0.0, 0.0, 0.0)
    hull_normal: Float[np.ndarray, "F 3"] = field(init=False)
    hull_offset: Float[np.ndarray, "F"] = field(init=False)
    hull_vertices: Float[np.ndarray, "V 3"] = field(init=False)

    def __post_init__(self):
        cloud = points(self.cloud, f"cloud of {self.name}", 4) if len(self.cloud) else np.empty((0, 3))
        path = points(self.path, f"path of {self.name}", 1)
        inlet = None if self.inlet is None else triple(self.inlet, "inlet")
        for name in ("interior_depth_m", "hull_tolerance_m", "covering_radius_m", "tip_contact_m"):
            if getattr(self, name) is not None and not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name)}; it must be 0 or more")
        for name, directions in self.frames._asdict().items():
            if directions is not None and len(directions) != len(path):
                raise InputError(f"{name} of the path has {len(directions)} rows, but the path has {len(path)} points")
        triangles = np.array(self.triangles, dtype=np.float64)
        corners = triangles.reshape(-1, 3) if len(triangles) else cloud  # sampled points between corners add no vertex
        lost = inlet is None and self.inlet_direction is InletDirection.HULL_FACET
        hull = _interior_hull(corners, "none" if lost else self.interior, self.hull_tolerance_m, self.name)
        arrays = {
            "cloud": cloud, "path": path, "inlet": inlet, "triangles": triangles,
            "inlet_direction": _direction(self.inlet_direction, hull, inlet),
            "pivot": triple(self.pivot, "pivot"), "origin": triple(self.origin, "origin"),
            "neutral_translation": triple(self.neutral_translation, "neutral_translation"),
            "hull_normal": hull.normal, "hull_offset": hull.offset, "hull_vertices": hull.vertices,
        }  # fmt: skip
        for name, array in arrays.items():
            if array is not None:
                array.setflags(write=False)
            object.__setattr__(self, name, array)  # a frozen dataclass; written here only

    def with_path(
        self, name: str, path: Float[np.ndarray, "T 3"], frames: PathFrames, seam_begins: tuple[int, ...]
    ) -> "Workpiece":
        """Return the part with another path [m], and the same walls and hull."""
        other = copy.copy(self)
        for cached in ("normals", "tangents"):
            other.__dict__.pop(cached, None)
        path = points(path, f"path of {name}", 1)
        path.setflags(write=False)
        for field_name, value in {"name": name, "path": path, "frames": frames, "seam_begins": seam_begins}.items():
            object.__setattr__(other, field_name, value)
        return other

    def T_world(
        self, wy: float, wz: float, shift: Triple = (0.0, 0.0, 0.0), wx: float = 0.0
    ) -> Float[np.ndarray, "4 4"]:
        """Return T_world_workpiece: x_world = pivot + Rz(wz) Ry(wy) Rx(wx) (x + neutral_translation - pivot) + shift.

        Args:
            wy: Rotation about world y [rad], applied second.
            wz: Rotation about world z [rad], applied last.
            shift: Translation in the world [m].
            wx: Rotation about world x [rad], applied first.
        """
        cy, sy, cz, sz = np.cos(wy), np.sin(wy), np.cos(wz), np.sin(wz)
        T = np.eye(4)
        T[:3, :3] = [[cz * cy, -sz, cz * sy], [sz * cy, cz, sz * sy], [-sy, 0.0, cy]]
        if wx:  # skipped for 0, so that the result stays the same bit for bit
            cx, sx = np.cos(wx), np.sin(wx)
            T[:3, :3] = T[:3, :3] @ [[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]]
        T[:3, 3] = self.pivot + T[:3, :3] @ (self.neutral_translation - self.pivot) + shift
        return T

    @cached_property
    def normals(self) -> Float[np.ndarray, "T 3"]:
        """The path's unit normals, from the wall into the free space: as given, else fitted to the cloud.

        Raises:
            InputError: If neither normals nor a cloud are given.
        """
        if self.frames.normals is not None:
            return self.frames.normals
        if not len(self.cloud):
            raise InputError(
                f"{self.name}: without a cloud, the path's file must have normals: columns nx,ny,nz, or those of plates"
            )
        return wall_normals(self.cloud, self.path)

    @cached_property
    def tangents(self) -> Float[np.ndarray, "T 3"]:
        """The path's unit tangents: as given, else by central differences along each seam; NaN at a seam of one point.

        Raises:
            InputError: If the path is one seam, of zero length.
        """
        if self.frames.tangents is not None:
            return self.frames.tangents
        seams = np.split(self.path, self.seam_begins)
        is_one = len(seams) == 1
        return np.concatenate(
            [tangents(seam) if is_one or len(seam) > 1 else np.full((1, 3), np.nan) for seam in seams]
        )

    @property
    def shown(self) -> Float[np.ndarray, "P 3"]:
        """The points to draw [m]: the cloud, or the path if there is no cloud."""
        return self.cloud if len(self.cloud) else self.path

    @cached_property
    def largest_gap_m(self) -> float:
        """Largest distance of a point of the cloud from its nearest neighbour [m]; the largest hole is no smaller."""
        return _largest_gap(self.cloud)

    @property
    def walls(self) -> str:
        """Description of the walls that clearance is measured to."""
        if not len(self.cloud):
            return "none"
        if len(self.triangles):
            reach = f"{len(self.triangles):,} triangles within {1e3 * self.covering_radius_m:.3g} mm of"
            return f"{reach} {len(self.cloud):,} points; this distance is subtracted"
        return f"{len(self.cloud):,} points, gaps up to {1e3 * self.largest_gap_m:.3g} mm"

    @property
    def interior_rule(self) -> str:
        """Description of the rule that bodies deep in the part must lie in its hull."""
        if len(self.hull_offset):
            along = "world x" if self.inlet_direction is None else f"({_numbers_text(self.inlet_direction)})"
            return f"convex hull, {self.interior_depth_m:.3g} m deep along {along}"
        return "off: no inlet" if self.inlet is None else "off"

    def __repr__(self) -> str:
        return f"Workpiece({self.name}: {len(self.cloud):,} points, a path of {len(self.path):,} points)"

    def _repr_html_(self) -> str:
        low, high = self.shown.min(axis=0), self.shown.max(axis=0)
        length = np.linalg.norm(np.diff(self.path, axis=0), axis=1).sum()
        facts = {
            "walls": self.walls,
            "extent": " x ".join(f"{side:.3f}" for side in high - low) + " m",
            "tool path": f"{len(self.path)} points, {length:.3f} m",
            "inlet": "none" if self.inlet is None else f"{_numbers_text(self.inlet)} m",
            "interior": self.interior_rule,
        }
        return html_facts(self.name, facts)

    def interior_plane(self, T_world_workpiece: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4"]:
        """Return the plane beyond which points of the robot must lie in the hull: its unit normal n and offset [m].

        A point x in the world lies beyond the plane if n @ x > offset. n is the inlet's direction; the plane lies
        interior_depth_m behind the part's first point along n.
        """
        rotate, translate = T_world_workpiece[:3, :3], T_world_workpiece[:3, 3]
        n = np.array([1.0, 0.0, 0.0]) if self.inlet_direction is None else rotate @ self.inlet_direction
        along = self.hull_vertices @ (rotate.T @ n) + translate @ n
        return np.append(n, along.min(initial=np.inf) + self.interior_depth_m)


def _direction(value: object, hull: Hull, inlet: np.ndarray | None) -> Float[np.ndarray, "3"] | None:
    """Return the unit vector into the part; None for the world's x, and if there is no interior."""
    if value is None or value is InletDirection.WORLD_X:  # None: a copy of a workpiece, see `dataclasses.replace`
        return None
    if value is InletDirection.HULL_FACET and not len(hull.offset):
        return None
    if value is InletDirection.HULL_FACET:
        return -hull.normal[np.argmax(hull.normal @ inlet - hull.offset)]
    direction = triple(value, "inlet_direction")
    if not np.linalg.norm(direction) > 0:
        raise InputError("inlet_direction is zero; it must be a direction into the part")
    return direction / np.linalg.norm(direction)


def _numbers_text(values: Float[np.ndarray, "3"]) -> str:
    return ", ".join(f"{value:.4g}" for value in values + 0.0)


def _interior_hull(cloud: Float[np.ndarray, "P 3"], interior: str, tolerance_m: float, name: str) -> Hull:
    if interior == "hull" and len(cloud):
        return convex_hull(cloud, tolerance_m, f"cloud of {name}")
    if interior in ("hull", "none"):
        return Hull(np.empty((0, 3)), np.empty(0), cloud)
    raise InputError(f"interior is {interior!r}; valid: hull, none")


@cached_by_values(4)
def _largest_gap(cloud: Float[np.ndarray, "P 3"]) -> float:
    return float(scipy.spatial.cKDTree(cloud).query(cloud, k=2)[0][:, 1].max())


@cached_by_values(4)
def median_distance(cloud: Float[np.ndarray, "P 3"], points: Float[np.ndarray, "n 3"]) -> float:
    """Return the median distance of points from a cloud [m]."""
    return float(np.median(scipy.spatial.cKDTree(cloud).query(points)[0]))


@cached_by_values(2)
def convex_hull(points: Float[np.ndarray, "P 3"], tolerance_m: float, source: str) -> Hull:
    """Return the convex hull of P points [m]: exact for tolerance 0, otherwise with fewer facets.

    With a tolerance the half-spaces still contain every point, and each touches one. They extend beyond the exact hull
    by at most about the tolerance. Use a tolerance for a smooth convex surface: nearly all of its points are vertices
    of the exact hull, and each vertex adds two facets.

    Args:
        points: The points [m].
        tolerance_m: Distance from the hull [m] below which a point adds no vertex.
        source: Name of the points in the error message.

    Raises:
        InputError: For points in one plane.
    """
    try:
        exact = scipy.spatial.ConvexHull(points)
    except scipy.spatial.QhullError:
        raise InputError(
            f"{source}: the points lie in one plane, so the hull has no inside; set interior to 'none'"
        ) from None
    vertices = points[exact.vertices]
    if tolerance_m == 0.0:
        planes = _distinct_planes(exact.equations)
        return Hull(planes[:, :3].copy(), -planes[:, 3], vertices)
    # Qhull's W: a point becomes a vertex only if it lies farther than this outside the facets so far.
    thinned = scipy.spatial.ConvexHull(vertices, qhull_options=f"Qt W{tolerance_m:.17g}")
    normal = _distinct_planes(thinned.equations)[:, :3].copy()
    # Push every facet out to its farthest point, so that no point is outside.
    return Hull(normal, np.max(normal @ vertices.T, axis=1), vertices)


def _distinct_planes(equations: Float[np.ndarray, "E 4"]) -> Float[np.ndarray, "F 4"]:
    """Return the planes without repetitions: Qhull cuts a flat facet into triangles with the same equation."""
    _, first = np.unique(equations.round(9), axis=0, return_index=True)
    return equations[np.sort(first)]
