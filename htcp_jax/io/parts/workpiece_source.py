"""Workpieces from files or arrays, and the generated duct; implausible sizes are refused.

A `WorkpieceSource` states the source of the walls: `GeneratedDuct`, `PointCloud`, `TriangleMesh` or `NoCloud`. Each has
points on its walls, and the defaults of its kind.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.files import known_ending
from htcp_jax.io.parts.duct_seams import SEAMS, seam
from htcp_jax.io.parts.path_file import read_frames
from htcp_jax.io.parts.point_cloud import TEXT, load_geometry
from htcp_jax.io.parts.table import read_table
from htcp_jax.io.parts.units import check_extent, check_path_unit
from htcp_jax.model import PathFrames, Robot, Workpiece, arrays, duct, mesh_points, workpiece
from htcp_jax.types import Anywhere

MOST_POINTS = 10_000_000  # of the generated duct
# Where the duct's wall is convex nearly every point is a vertex of the hull: 22,914 facets. With this tolerance there
# are 944, whose corners lie at most 0.42 mm outside the exact hull.
DUCT_HULL_TOLERANCE_M = 5e-4


class GeneratedDuct(NamedTuple):
    """The generated duct, see `model.duct`; its interior lies along the world's x, as in the paper."""

    points: int = duct.POINTS
    seed: int = 0
    seam: str = "weld"  # of `duct_seams.SEAMS`; the path, if no other one is given

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        along = workpiece.InletDirection.WORLD_X
        tolerance_m = DUCT_HULL_TOLERANCE_M
        return {"name": "duct", "inlet": duct.INLET, "hull_tolerance_m": tolerance_m, "inlet_direction": along}

    def walls(self, body: mesh_points.NearbyBody | None) -> mesh_points.PointCover:
        """Return the points on the duct [m].

        Raises:
            InputError: For a number or a seed out of range.
        """
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}; it must be 0 or more")
        if not 4 <= self.points <= MOST_POINTS:
            raise InputError(f"points is {self.points}; valid are 4 to {MOST_POINTS}")
        return mesh_points.PointCover(duct.duct_cloud(self.points, self.seed), 0.0)

    def path(self) -> Float[np.ndarray, "T 3"]:
        """Return the points of the seam [m].

        Raises:
            InputError: For an unknown seam.
        """
        if self.seam not in SEAMS:
            raise InputError(
                f"{self.seam}: no seam of the generated duct, nor a table of x,y,z; seams are {', '.join(SEAMS)}, "
                f"tables end in {' '.join(TEXT)}"
            )
        return seam(self.seam)


class PointCloud(NamedTuple):
    """Points on the walls of a part."""

    points: Float[np.ndarray, "P 3"]  # [m]
    label: str = "cloud"  # its file, for messages; the stem is the part's name

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        return {"name": Path(self.label).stem, "inlet_direction": workpiece.InletDirection.HULL_FACET}

    def walls(self, body: mesh_points.NearbyBody | None) -> mesh_points.PointCover:
        """Return the points [m]."""
        return mesh_points.PointCover(self.points, 0.0)


class TriangleMesh(NamedTuple):
    """Triangles of a part's walls, and the widest gap between the points that cover them."""

    triangles: Float[np.ndarray, "F 3 3"]  # [m]
    label: str = "mesh"  # its file, for messages; the stem is the part's name
    spacing_m: float | None = None  # None: see `mesh_points.cover_mesh`

    @property
    def points(self) -> Float[np.ndarray, "P 3"]:
        """The corners of the triangles [m]."""
        return self.triangles.reshape(-1, 3)

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        direction = workpiece.InletDirection.HULL_FACET
        return {"name": Path(self.label).stem, "inlet_direction": direction, "triangles": self.triangles}

    def walls(self, body: mesh_points.NearbyBody | None) -> mesh_points.PointCover:
        """Return points that cover the mesh [m].

        Raises:
            InputError: As `mesh_points.cover_mesh` does.
        """
        return mesh_points.cover_mesh(self.triangles, self.label, self.spacing_m, body)


class NoCloud(NamedTuple):
    """A path without walls; the part has the path's name."""

    @property
    def defaults(self) -> dict[str, Any]:
        """Fields of `Workpiece` for this kind."""
        return {"inlet_direction": workpiece.InletDirection.HULL_FACET}

    def walls(self, body: mesh_points.NearbyBody | None) -> mesh_points.PointCover:
        """Return no points."""
        return mesh_points.PointCover(np.empty((0, 3)), 0.0)


WorkpieceSource = GeneratedDuct | PointCloud | TriangleMesh | NoCloud
DUCT = GeneratedDuct()


def read_source(file: str | Path, spacing_m: float | None = None) -> PointCloud | TriangleMesh:
    """Read the walls of a part from a file of points or triangles, see `load_geometry`.

    Args:
        file: The file.
        spacing_m: Widest gap between the points on a mesh, see `mesh_points.cover_mesh`.

    Raises:
        InputError: For an unreadable file.
    """
    points, triangles = load_geometry(file)
    return TriangleMesh(triangles, str(file), spacing_m) if len(triangles) else PointCloud(points, str(file))


def load_workpiece(
    source: WorkpieceSource | str | Path | Anywhere = DUCT,
    path: str | Path | Anywhere | None = None,
    *,
    robot: Robot | None = None,
    **fields: Any,
) -> Workpiece:
    """Load a workpiece; by default the generated duct and its weld.

    Args:
        source: Its walls; a file is read by `read_source`, and an array (P, 3) is a `PointCloud` [m].
        path: A file, see `read_path`, or points (T, 3) [m]; None: the seam of a `GeneratedDuct`.
        robot: The arm for which the sizes of part and path must be plausible, see `units`, and whose thinnest body
            near the part determines the spacing of points on a mesh; None: neither.
        **fields: Fields of `Workpiece`, in place of the source's own.

    Raises:
        InputError: For an invalid file or number, and for a cloud or a mesh without a path.
    """
    if path is None and not isinstance(source, GeneratedDuct):
        label = source if _is_file(source) else getattr(source, "label", "cloud")
        raise InputError(f"{label}: a cloud needs a tool path of its own (x,y,z rows in a CSV file)")
    if _is_file(source):
        source = read_source(source)
    elif not isinstance(source, WorkpieceSource):
        source = PointCloud(arrays.points(source, "cloud", 4))
    track = source.path() if path is None else read_path(path)
    name, frames = (Path(path).stem, read_frames(Path(path))) if _is_file(path) else ("path", PathFrames())
    own = {"name": name, "frames": frames, **source.defaults, **fields}
    if robot is not None and isinstance(source, PointCloud | TriangleMesh):
        check_extent(robot, source.points, track, own["name"])
    surface = source.walls(None if robot is None else mesh_points.thinnest_nearby(robot))
    if robot is not None and not isinstance(source, NoCloud):
        check_path_unit(surface.points, track, own["name"])
    return Workpiece(cloud=surface.points, path=track, covering_radius_m=surface.radius_m, **own)


def _is_file(given: object) -> bool:
    return isinstance(given, str | Path)


def read_path(path: str | Path | Anywhere) -> Float[np.ndarray, "T 3"]:
    """Read a tool path [m], workpiece frame, in tracking order.

    Args:
        path: A text file (.csv .txt .xyz) with rows of x,y,z, or with columns of these names, or an array (T, 3) [m].
            `point_cloud.read_points` also returns normals.

    Raises:
        InputError: For an unreadable or empty file, an invalid line (naming it) and NaN.
    """
    if not _is_file(path):
        return arrays.points(path, "path", 1)
    path = Path(path)
    known_ending(path, TEXT)
    points = read_table(path).xyz
    if not len(points):
        raise InputError(f"{path}: the tool path is empty")
    arrays.check_points(points, str(path), at_least=1)
    return points
