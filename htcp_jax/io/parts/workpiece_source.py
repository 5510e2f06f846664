"""Workpieces from files or arrays, and the generated duct; implausible sizes are refused.

A `WorkpieceSource` is the source of the walls: `GeneratedDuct`, `PointCloud`, `TriangleMesh` or `NoCloud`. Each kind
provides points on the walls, and defaults for fields of `Workpiece`.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import apt
from htcp_jax.io.parts.duct_seams import seam
from htcp_jax.io.parts.path_file import PathPoints, read_path_points
from htcp_jax.io.parts.path_table import ENDINGS, PathTable
from htcp_jax.io.parts.point_cloud import load_geometry
from htcp_jax.io.parts.seams import check_one_seam
from htcp_jax.io.parts.units import check_extent, check_path_unit, unit_key
from htcp_jax.model import (
    InletDirection,
    NearbyBody,
    PathFrames,
    PointCover,
    Robot,
    Workpiece,
    arrays,
    cover_mesh,
    duct,
    thinnest_nearby,
)
from htcp_jax.spec import SEAMS, Maker
from htcp_jax.types import Anywhere, Triple

MOST_POINTS = 10_000_000  # maximum number of points on the generated duct
# Where the duct's wall is convex nearly every point is a vertex of the hull: 22,914 facets. With this tolerance there
# are 944, whose corners lie at most 0.42 mm outside the exact hull.
DUCT_HULL_TOLERANCE_M = 5e-4


class GeneratedDuct(NamedTuple):
    """The generated duct, see `model.duct`; its interior lies along the world's x, as in the paper."""

    points: int = duct.POINTS
    seed: int = 0
    seam: str = "weld"  # name in `spec.SEAMS`; the seam is the path unless another path is given

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        along = InletDirection.WORLD_X
        tolerance_m = DUCT_HULL_TOLERANCE_M
        return {"name": "duct", "inlet": duct.INLET, "hull_tolerance_m": tolerance_m, "inlet_direction": along}

    def walls(self, body: NearbyBody | None) -> PointCover:
        """Return the points on the duct [m].

        Raises:
            InputError: For a number of points or a seed out of range.
        """
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; it must be 0 or more")
        if not 4 <= self.points <= MOST_POINTS:
            raise InputError(f"points is {self.points}; valid are 4 to {MOST_POINTS}")
        return PointCover(duct.duct_cloud(self.points, self.seed), 0.0)

    def path(self) -> Float[np.ndarray, "T 3"]:
        """Return the points of the seam [m].

        Raises:
            InputError: For an unknown seam.
        """
        if self.seam not in SEAMS:
            raise InputError(
                f"workpiece.path is {self.seam}; valid: a seam of the duct ({', '.join(SEAMS)}), or a table of x,y,z "
                f"({' '.join(ENDINGS)})"
            )
        return seam(self.seam)


class PointCloud(NamedTuple):
    """Points on the walls of a part."""

    points: Float[np.ndarray, "P 3"]  # [m]
    label: str = "cloud"  # its file, for messages; the stem is the part's name
    unit: str | None = None  # unit in which its file was read, for messages; None: m, or the file's own

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        return {"name": Path(self.label).stem, "inlet_direction": InletDirection.HULL_FACET}

    def walls(self, body: NearbyBody | None) -> PointCover:
        """Return the points [m]."""
        return PointCover(self.points, 0.0)


class TriangleMesh(NamedTuple):
    """Triangles of a part's walls, and the widest gap between the points that cover them."""

    triangles: Float[np.ndarray, "F 3 3"]  # [m]
    label: str = "mesh"  # its file, for messages; the stem is the part's name
    spacing_m: float | None = None  # None: see `mesh_points.cover_mesh`
    unit: str | None = None  # unit in which its file was read, for messages; None: m, or the file's own

    @property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """The corners of the triangles [m]."""
        return self.triangles.reshape(-1, 3)

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        direction = InletDirection.HULL_FACET
        return {"name": Path(self.label).stem, "inlet_direction": direction, "triangles": self.triangles}

    def walls(self, body: NearbyBody | None) -> PointCover:
        """Return points that cover the mesh [m].

        Raises:
            InputError: As `mesh_points.cover_mesh` does.
        """
        return cover_mesh(self.triangles, self.label, self.spacing_m, body)


class NoCloud(NamedTuple):
    """A path without walls; the part is named after the path's file."""

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        return {"inlet_direction": InletDirection.HULL_FACET}

    def walls(self, body: NearbyBody | None) -> PointCover:
        """Return an empty set of points."""
        return PointCover(np.empty((0, 3)), 0.0)


WorkpieceSource = GeneratedDuct | PointCloud | TriangleMesh | NoCloud
DUCT = GeneratedDuct()


def read_source(file: str | Path, spacing_m: float | None = None, unit: str | None = None) -> PointCloud | TriangleMesh:
    """Read the walls of a part from a file of points or triangles, see `load_geometry`.

    Args:
        file: The file.
        spacing_m: Widest gap between the points on a mesh, see `mesh_points.cover_mesh`.
        unit: Unit of the file's coordinates: m, mm, cm or in; None: m, or the unit that the file states.

    Raises:
        InputError: For an unreadable file, and for a unit of a file that states its own.
    """
    points, triangles = load_geometry(file, unit)
    if len(triangles):
        return TriangleMesh(triangles, str(file), spacing_m, unit)
    return PointCloud(points, str(file), unit)


FAR_M = 10_000.0  # coordinates beyond it are those of a map, such as UTM's, not of a part
COARSEST_M = 1e-3  # largest rounding of far coordinates that is accepted [m]


def load_workpiece(
    source: WorkpieceSource | str | Path | Anywhere = DUCT,
    path: str | Path | Anywhere | PathPoints | None = None,
    *,
    robot: Robot | None = None,
    path_columns: Mapping[str, int | str] = MappingProxyType({}),
    path_unit: str | None = None,
    path_angles: Maker | None = None,
    unit: str | None = None,
    origin: Anywhere | Triple | None = None,
    **fields: Any,
) -> Workpiece:
    """Load a workpiece; by default the generated duct and its weld.

    Args:
        source: The walls. `read_source` reads a file; an array (P, 3) [m] is a `PointCloud`.
        path: A file of one seam, see `read_path_points`, or points (T, 3) [m], or the points of several seams; None:
            the seam of a `GeneratedDuct`.
        robot: The arm. The sizes of part and path must be plausible for it, see `units`, and its thinnest body near the
            part determines the spacing of points on a mesh. None: sizes are not checked, and the default spacing is
            used.
        path_columns: Columns of the path's file, see `read_path_points`.
        path_unit: Unit of the path's file, see `read_path_points`.
        path_angles: Maker whose order the angles in the path's file have, see `read_path_points`.
        unit: Unit of the file `source`, see `read_source`.
        origin: Point (3,) [m] to subtract from the coordinates of cloud, path and inlet. None: 0; for a part further
            than FAR_M from 0 its centre in whole metres (without a cloud, the path's centre), with a Note.
        **fields: Fields of `Workpiece`, in place of the source's defaults; the inlet is in the files' coordinates.

    Raises:
        InputError: For an invalid file or number, and for a cloud or a mesh without a path.
    """
    if path is None and not isinstance(source, GeneratedDuct):
        label = source if _is_file(source) else getattr(source, "label", "cloud")
        raise InputError(f"{label}: workpiece.path is missing; with your own cloud, set it to a CSV file of x,y,z rows")
    for key, value in (("path_columns", path_columns), ("path_unit", path_unit), ("path_angles", path_angles)):
        if value and not _is_file(path):
            what = "a seam of the generated duct" if path is None else "an array"
            raise InputError(f"workpiece.{key} is {value!r}, but the path is {what}, not a file; omit the key")
    if unit is not None and not _is_file(source):
        raise InputError(f"workpiece.unit is {unit!r}, but the walls are not read from a file here; omit the key")
    if _is_file(source):
        source = read_source(source, unit=unit)
    elif not isinstance(source, WorkpieceSource):
        source = PointCloud(arrays.points(source, "cloud", 4))
    if path is None:
        track = PathPoints(source.path(), PathFrames())
    else:
        track = _read_track(path, path_columns, path_unit, path_angles)
    own = {"name": Path(path).stem if _is_file(path) else "path", "frames": track.frames, **source.defaults, **fields}
    if robot is not None and isinstance(source, PointCloud | TriangleMesh):
        check_extent(robot, source.points, track.xyz, own["name"], unit_key(source.label), source.unit)
    own["origin"] = _origin(source, track.xyz, own["name"]) if origin is None else arrays.triple(origin, "origin")
    source, track = _moved(source, track, own)
    surface = source.walls(None if robot is None else thinnest_nearby(robot))
    if robot is not None and not isinstance(source, NoCloud):
        label = Path(getattr(source, "label", own["name"])).name
        check_path_unit(surface.points, track.xyz, label, track.unit)
    return Workpiece(cloud=surface.points, path=track.xyz, covering_radius_m=surface.radius_m, **own)


def _origin(source: WorkpieceSource, path: Float[np.ndarray, "T 3"], name: str) -> Float[np.ndarray, "3"]:
    """Return the default point to subtract from all coordinates; a Note reports it if it is not 0."""
    if isinstance(source, GeneratedDuct):
        return np.zeros(3)
    points = path if isinstance(source, NoCloud) else source.points
    centre = np.round(0.5 * (points.min(axis=0) + points.max(axis=0)))
    if np.abs(centre).max() <= FAR_M:
        return np.zeros(3)
    text = ", ".join(f"{value:.0f}" for value in centre)
    what = f"{name} is far from the origin; ({text}) m is subtracted from cloud, path and inlet (workpiece.origin_m)"
    warnings.warn(what, Note, stacklevel=3)
    rounding = float(np.spacing(np.float32(np.abs(points).max())))
    if (points == points.astype(np.float32)).all():
        what = f"{name}: its coordinates are 32-bit numbers, rounded to {1e3 * rounding:.3g} mm far from the origin"
        if rounding > COARSEST_M:
            raise InputError(f"{what}; write the file relative to a point near the part")
        warnings.warn(what, UserWarning, stacklevel=3)
    return centre


def _moved(source: WorkpieceSource, track: PathPoints, own: dict[str, Any]) -> tuple[WorkpieceSource, PathPoints]:
    """Subtract the origin from walls and path, and from mesh and inlet in the fields `own`."""
    origin = own["origin"]
    if not origin.any():
        return source, track
    if isinstance(source, GeneratedDuct):
        raise InputError("workpiece.origin_m applies to files only; omit it for the generated duct")
    if own.get("inlet") is not None:
        own["inlet"] = arrays.triple(own["inlet"], "inlet") - origin
    if isinstance(source, TriangleMesh):
        source = source._replace(triangles=source.triangles - origin)
        own["triangles"] = source.triangles
    elif isinstance(source, PointCloud):
        source = source._replace(points=source.points - origin)
    return source, track._replace(xyz=track.xyz - origin)


def _is_file(given: object) -> bool:
    return isinstance(given, str | Path)


def read_path(path: str | Path | Anywhere) -> Float[np.ndarray, "T 3"]:
    """Read a tool path [m] in the workpiece frame, in tracking order.

    Args:
        path: A text file (.csv .txt .xyz) with rows of x,y,z or with columns of these names, or an array (T, 3) [m].
            Use `point_cloud.read_points` to read normals, too.

    Raises:
        InputError: For an unreadable or empty file, an invalid line, which the message names, and NaN.
    """
    return _read_track(path, {}, None, None, directions=False).xyz


def _read_track(
    path: str | Path | Anywhere,
    columns: Mapping[str, int | str],
    unit: str | None,
    maker: Maker | None,
    directions: bool = True,
) -> PathPoints:
    if isinstance(path, PathPoints):
        return path
    if not _is_file(path):
        return PathPoints(arrays.points(path, "path", 1), PathFrames())
    found = read_path_points(Path(path), columns, unit, maker) if directions else _points_only(Path(path))
    check_one_seam(str(path), found.seams)
    return found


def _points_only(path: Path) -> PathPoints:
    if path.suffix.lower() in (*apt.ENDINGS, *apt.G_CODE):
        return read_path_points(path)
    table = PathTable(path)
    return PathPoints(table.xyz, PathFrames(), table.seams)
