"""Loading of a Workpiece from files or arrays, or the generated duct; implausible sizes are refused."""

from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.duct_seams import SEAMS, seam
from htcp_jax.io.files import known_ending
from htcp_jax.io.path_file import read_frames
from htcp_jax.io.point_cloud import TEXT, Geometry, load_geometry
from htcp_jax.io.table import read_table
from htcp_jax.io.units import check_extent, check_path
from htcp_jax.model import arrays, duct
from htcp_jax.model.duct import INTERIOR_DEPTH_M, NEUTRAL_TRANSLATION, PIVOT
from htcp_jax.model.mesh_points import Cover, cover
from htcp_jax.model.path_frames import PathFrames
from htcp_jax.model.robot import Robot
from htcp_jax.model.workpiece import NO_CLOUD, Workpiece
from htcp_jax.types import Anywhere, Triple

MOST_POINTS = 10_000_000  # of the generated duct
# Where the duct's wall is convex nearly every point is a vertex of the hull: 22,914 facets. With this tolerance there
# are 944, whose corners lie at most 0.42 mm outside the exact hull.
DUCT_HULL_TOLERANCE_M = 5e-4


NOTHING = Geometry(np.empty((0, 3)), np.empty((0, 3, 3)))


def load_workpiece(
    cloud: str | Path | Anywhere | None = None,
    path: str | Path | Anywhere | None = None,
    *,
    name: str | None = None,
    inlet: Triple | Literal["auto"] | None = "auto",
    pivot: Triple = PIVOT,
    neutral_translation: Triple = NEUTRAL_TRANSLATION,
    interior_depth_m: float = INTERIOR_DEPTH_M,
    interior: Literal["hull", "none"] = "hull",
    hull_tolerance_m: float | None = None,
    inlet_direction: Triple | Literal["world-x"] | None = None,
    tip_contact_m: float | None = None,
    points: int | None = None,
    seed: int = 0,
    spacing: float | None = None,
    thinnest_m: float = np.inf,
    robot: Robot | None = None,
    frames: PathFrames | None = None,
) -> Workpiece:
    """Load a workpiece from files or arrays; without a cloud the generated duct, without both the duct and its weld.

    cloud: "none" means a path without a cloud.
    cloud, path: files, see `load_cloud` and `read_path`, or points (P, 3), (T, 3) [m]; the path of the generated duct
        may also be one of `duct_seams.SEAMS`.
    inlet: "auto" is the duct's inlet for the duct and None for another cloud.
    hull_tolerance_m: None is 0 (the exact hull) for a cloud and 0.5 mm for the duct.
    inlet_direction: "world-x" is the world's x for every orientation of the part, as in the paper's scene; None means
        "world-x" for the duct, and "facet" for another cloud, see `Workpiece`.
    points, seed: of the generated duct.
    spacing [m]: of the points on a mesh, see `mesh_points.cover`; thinnest_m: radius of the thinnest body [m], which
        must be larger than the covering radius of a mesh.
    robot: the arm for which the sizes of part and path must be plausible, see `units`; None: no such check.
    frames: the path's normals, tangents and orientations; None: those in its file.
    Raises InputError for an invalid file or number, and for a cloud without a path.
    """
    generated, no_cloud = cloud is None, _is_file(cloud) and str(cloud) == NO_CLOUD
    name = name or ("duct" if generated else Path(_named(path if no_cloud else cloud)).stem)
    if generated:
        track = _on_the_duct(path)
        surface, triangles = _generated(points, seed, spacing), np.empty((0, 3, 3))
    elif path is None or (_is_file(path) and str(path) in SEAMS):
        raise InputError(f"{_named(cloud)}: a cloud needs a tool path of its own (x,y,z rows in a CSV file)")
    elif points is not None:
        raise InputError(f"{_named(cloud)}: the number of points is for the generated duct; a mesh takes a spacing")
    else:
        read, triangles = _geometry(cloud)
        track, surface = read_path(path), Cover(read, 0.0)
        if robot is not None and not no_cloud:
            check_extent(robot, read, track, name)
        if len(triangles):
            surface = cover(triangles, str(cloud), spacing, thinnest_m)
            _check_thinnest(surface, str(cloud), thinnest_m)
    if robot is not None and not no_cloud:
        check_path(surface.points, track, name)
    if inlet == "auto":
        inlet = duct.INLET if generated else None
    if hull_tolerance_m is None:
        hull_tolerance_m = DUCT_HULL_TOLERANCE_M if generated else 0.0
    if inlet_direction is None and not generated:
        inlet_direction = "facet"
    elif inlet_direction == "world-x":
        inlet_direction = None
    return Workpiece(
        name,
        surface.points,
        track,
        inlet,
        pivot,
        neutral_translation,
        interior_depth_m,
        interior,
        hull_tolerance_m,
        inlet_direction,
        triangles,
        surface.radius_m,
        tip_contact_m,
        _frames(path) if frames is None else frames,
    )


def _on_the_duct(path: str | Path | Anywhere | None) -> Float[np.ndarray, "T 3"]:
    if path is None:
        return seam("weld")
    if not _is_file(path) or Path(path).suffix:
        return read_path(path)
    if str(path) not in SEAMS:
        raise InputError(
            f"{path}: no seam of the generated duct, nor a table of x,y,z; seams are {', '.join(SEAMS)}, "
            f"tables end in {' '.join(TEXT)}"
        )
    return seam(str(path))


def _geometry(cloud: str | Path | Anywhere) -> Geometry:
    if _is_file(cloud):
        return NOTHING if str(cloud) == NO_CLOUD else load_geometry(cloud)
    return Geometry(arrays.points(cloud, "cloud", 4), np.empty((0, 3, 3)))


def _frames(path: str | Path | Anywhere | None) -> PathFrames:
    """Return the frames in a path's file; none for an array and a seam of the duct."""
    return read_frames(Path(path)) if _is_file(path) and str(path) not in SEAMS else PathFrames()


def _is_file(given: object) -> bool:
    return isinstance(given, str | Path)


def _named(cloud: str | Path | Anywhere) -> str | Path:
    return cloud if _is_file(cloud) else "cloud"


def read_path(path: str | Path | Anywhere) -> Float[np.ndarray, "T 3"]:
    """Read a tool path [m], workpiece frame: x,y,z rows of a text file (.csv .txt .xyz), or its columns with these
    names, or an array, in tracking order; `point_cloud.read_points` also returns normals.

    Raises InputError for an unreadable or empty file, an invalid line (naming it) and NaN.
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


def _generated(points: int | None, seed: int, spacing: float | None) -> Cover:
    if spacing is not None:
        raise InputError("spacing is for meshes; the generated duct takes points")
    if seed < 0:
        raise InputError(f"seed is {seed}; it must be 0 or more")
    if points is not None and not 4 <= points <= MOST_POINTS:
        raise InputError(f"points is {points}; valid are 4 to {MOST_POINTS}")
    return Cover(duct.duct_cloud(duct.POINTS if points is None else points, seed), 0.0)


def _check_thinnest(surface: Cover, source: str, thinnest_m: float) -> None:
    if surface.radius_m >= thinnest_m:
        raise InputError(
            f"{source}: the mesh is up to {1e3 * surface.radius_m:.4g} mm from its points, and the thinnest body has a "
            f"radius of {1e3 * thinnest_m:.4g} mm; workpiece.mesh_spacing_m must be smaller"
        )
