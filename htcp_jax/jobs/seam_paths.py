"""Paths of a part's seams: the seams that its files contain, and the points of all seams in the order of work."""

import warnings
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io import parts
from htcp_jax.model import ONE_POINT_M, PathFrames, tangents
from htcp_jax.spec import SEAMS, SEVERAL, SeamConfig, WorkpieceConfig, check_seams


class SeamPoints(NamedTuple):
    """Points of all seams, one after the other."""

    points: parts.PathPoints
    begins: tuple[int, ...]  # first row of the second and of each later seam


def is_file(part: WorkpieceConfig, path: str) -> bool:
    """Return False if a path is a seam of the generated duct."""
    return not (path in (*SEAMS, SEVERAL) or (part.is_duct and not Path(path).suffix))


def with_seams_of_files(part: WorkpieceConfig) -> WorkpieceConfig:
    """Return the section `workpiece` with one entry in `seams` for each seam that the path's files contain.

    A file of one seam remains the path. A seam with `points: true` becomes one seam per row. Notes and warnings about a
    file are not given here, but when its points are read for the workpiece.

    Args:
        part: The section.

    Raises:
        InputError: If a file cannot be read, if a seam has rows that its file lacks, and for names that occur twice.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _with_seams_of_files(part)


def _with_seams_of_files(part: WorkpieceConfig) -> WorkpieceConfig:
    read = _reader(part)
    if not part.seams:
        found = read(part.path).seams if is_file(part, part.path) else ()
        if len(found) < 2:
            return part
        way = _direction_of(part.path)
        seams = [
            SeamConfig(name=each.label, path=part.path, rows=(each.first, each.count), direction=way) for each in found
        ]
        check_seams(seams)
        return part.model_copy(update={"path": SEVERAL, "seams": tuple(seams)})
    split = {seam.name: _split(seam, _points_of(seam, read)) for seam in part.seams}
    names = {name: tuple(own.name for own in found) for name, found in split.items()}
    seams = [
        own.model_copy(update={"after": tuple(name for other in seam.after for name in names[other])})
        for seam in part.seams
        for own in split[seam.name]
    ]
    check_seams(seams)
    return part.model_copy(update={"seams": tuple(seams)})


def feeds_of_files(part: WorkpieceConfig) -> list[str | None]:
    """Return the feed that the path's file states for each seam, with its unit; None where it states none.

    Args:
        part: The section `workpiece`, see `with_seams_of_files`.

    Returns:
        One feed for each of the seams; for a job with a path in place of seams, that of the path.

    Raises:
        InputError: If a file cannot be read.
    """
    read, found = _reader(part), list[str | None]()
    for path, rows in [(seam.path, seam.rows) for seam in part.seams] or [(part.path, None)]:
        feed = None
        if is_file(part, path) and parts.has_feeds(Path(path)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                points = read(path)
            last = sum(each.first <= (rows or (0, 0))[0] for each in points.seams) - 1
            feed = points.feeds_m_s[last]
        found.append(None if feed is None else f"{1e3 * feed:.9g}mm/s")
    return found


def points_of_seams(part: WorkpieceConfig) -> SeamPoints:
    """Return the points of all seams [m], each in its direction of travel, `backward` or else forward.

    If only some seams have normals, orientations or plates, those of the others are NaN; missing tangents are computed.

    Args:
        part: The section `workpiece`, with seams, see `with_seams_of_files`.

    Raises:
        InputError: If a file cannot be read; if a closed seam's last point is not its first one; and if `begins_at` is
            not one of its rows.
    """
    read = _reader(part)
    found = [_travelled(seam, _points_of(seam, read)) for seam in part.seams]
    joined = {}
    for name in PathFrames._fields:
        own = [getattr(each.frames, name) for each in found]
        some = next((each for each in own if each is not None), None)
        filled = [_missing(name, *pair, some) for pair in zip(found, own, strict=True)] if some is not None else []
        joined[name] = np.concatenate(filled) if filled else None
    begins = np.cumsum([len(each.xyz) for each in found])[:-1].tolist()
    unit = next((each.unit for each in found if each.unit), None)
    points = parts.PathPoints(np.concatenate([each.xyz for each in found]), PathFrames(**joined), unit=unit)
    return SeamPoints(points, tuple(begins))


def _missing(
    name: str, points: parts.PathPoints, given: np.ndarray | None, other: np.ndarray
) -> Float[np.ndarray, "T *d"]:
    """Return the directions of a seam; where its file has none, tangents of its points, or else NaN."""
    if given is not None:
        return given
    if name == "tangents" and len(points.xyz) > 1:
        return tangents(points.xyz)
    return np.full((len(points.xyz), *other.shape[1:]), np.nan)


def _reader(part: WorkpieceConfig):
    """Return a function that reads a path, each file once."""
    columns: Mapping[str, int | str] = {} if part.path_columns is None else part.path_columns.given
    given = {"path_columns": columns, "path_unit": part.path_unit, "path_angles": part.path_angles}

    @cache
    def read(path: str) -> parts.PathPoints:
        if not is_file(part, path):
            if not part.is_duct or path not in SEAMS:
                raise InputError(f"{path!r} is neither a file nor a seam of the duct: {', '.join(SEAMS)}")
            for key, value in given.items():
                if value:
                    what = f"the path {path!r} is a seam of the generated duct, not a file; omit the key"
                    raise InputError(f"workpiece.{key} is {value!r}, but {what}")
            return parts.PathPoints(parts.GeneratedDuct(seam=path).path(), PathFrames())
        return parts.read_path_points(Path(path), columns, part.path_unit, part.path_angles)

    return read


def _points_of(seam: SeamConfig, read: Callable[[str], parts.PathPoints]) -> parts.PathPoints:
    """Return the points of a seam's path; errors name the seam."""
    try:
        return read(seam.path)
    except InputError as error:
        raise InputError(f"seam {seam.name!r}: {error}") from None


def _direction_of(path: str) -> Literal["either", "forward"]:
    """Return the direction of travel of a file's seams: contours of a CAM system have one."""
    return "forward" if parts.has_feeds(Path(path)) else "either"


def _split(seam: SeamConfig, points: parts.PathPoints) -> list[SeamConfig]:
    """Return an entry for each seam in the rows of one entry."""
    count = len(points.xyz)
    if seam.rows is not None:
        first, own = seam.rows
        if not 0 < own <= count - first:
            raise InputError(f"seam {seam.name!r}: rows {list(seam.rows)}: {Path(seam.path).name} has {count} rows")
        inside = [each for each in points.seams if each.first < first + own and first < each.first + each.count]
        if len(inside) > 1 and not seam.points:
            bounds = ", ".join(f"{each.first} to {each.first + each.count - 1}" for each in inside)
            what = f"rows {list(seam.rows)} are in {len(inside)} seams of {Path(seam.path).name}: {bounds}"
            raise InputError(f"seam {seam.name!r}: {what}; choose rows of one seam")
        ranges = [(seam.name, (first, own))]
    elif len(points.seams) > 1:
        ranges = [(f"{seam.name} {each.label}", (each.first, each.count)) for each in points.seams]
    else:
        ranges = [(seam.name, (0, count))]
    if seam.points:
        rows = [row for _, (first, own) in ranges for row in range(first, first + own)]
        ranges = [(f"{seam.name} {k + 1}", (row, 1)) for k, row in enumerate(rows)]
    whole = len(ranges) == 1 and seam.rows is None and not seam.closed
    way = seam.direction or ("either" if seam.points else _direction_of(seam.path))
    return [
        seam.model_copy(update={"name": name, "rows": None if whole else rows, "points": False, "direction": way})
        for name, rows in ranges
    ]


def _travelled(seam: SeamConfig, points: parts.PathPoints) -> parts.PathPoints:
    """Return the points of a seam in the order of travel."""
    first, count = seam.rows or (0, len(points.xyz))
    rows = np.arange(first, first + count)
    if seam.closed:
        rows = _from_row(seam, points.xyz[rows], rows)
    return points.rows(rows[::-1] if seam.direction == "backward" else rows)


def _from_row(seam: SeamConfig, xyz: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the rows of a closed seam from row `begins_at` around to the same row."""
    if np.linalg.norm(xyz[-1] - xyz[0]) < ONE_POINT_M and len(rows) > 1:
        rows = rows[:-1]
    first = seam.begins_at or 0
    if first >= len(rows):
        raise InputError(f"seam {seam.name!r}: begins_at is {first}, but it has {len(rows)} rows")
    turned = np.roll(rows, -first)
    return np.append(turned, turned[0])
