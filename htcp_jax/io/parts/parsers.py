"""A script: `python parsers.py KIND FILE FOLDER MEMORY` parses FILE and writes its arrays into FOLDER.

For a damaged file, a parser that is written in C++ may crash, hang, fill the memory or print. It therefore runs in its
own process. `scan.parsed` starts the process, sets its limits and reads the result: FOLDER/arrays.npz, or the exception
in FOLDER/error.txt. In addition to points or triangles a parser returns `remarks`, a line for everything that the file
states and that is not used. The script does not import the package, so it starts fast. A pool of processes cannot be
used: the memory limit depends on the file, and a process cannot raise its own limit again.
"""

import contextlib
import io
import json
import math
import re
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

CHORD_DEVIATION_MM = 0.05  # largest distance of the triangles from a curved STEP face
TURN_RAD = 0.2
SHELLS = r"(CLOSED_SHELL|OPEN_SHELL|CONNECTED_FACE_SET|TESSELLATED_SHELL|TESSELLATED_SOLID)\b"
STEP_FACES = r"(ADVANCED_FACE|FACE_SURFACE|(COMPLEX_)?TRIANGULATED_FACE)\b"
MOST_COLUMNS = 1000  # maximum number of columns of a PCD cloud
# Limit of the points' size: [bytes], and times the file's size; LZF reaches 88.
LEAST_LIMIT, GROWTH = 2**26, 100
LAS_NOISE = 7, 18  # classes of points that are noise
GEO_UNITS, GEO_FEET = (3076, 4099), (9002, 9003, 9005)  # keys of the units of x, y and z, and values for feet
NO_LINE_END = "its last line has no line end; check that the file is complete"  # as in `files.note_missing_line_end`


def pcd(file: Path) -> dict[str, np.ndarray]:
    """Read the points of a PCD cloud, in the file's order and frame, and its normals if it has any."""
    from pypcd4 import Encoding, PointCloud

    about, body = _pcd_header(file)
    cloud = PointCloud.from_path(file)
    data, row = cloud.pc_data, _pcd_row(about)
    there, rest, remarks = data.size, b"", []
    if about.data == Encoding.BINARY:
        rest = body[about.points * row :]
        there = len(body if rest.strip(b"\0") else body[: about.points * row]) // row
    elif about.data == Encoding.BINARY_COMPRESSED and about.points:
        packed, unpacked = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
        there, rest = unpacked // row, body[8 + packed :]
    if there != about.points:
        raise ValueError(f"the header declares {about.points} points, the file contains {there}")
    if rest.strip(b"\0"):
        raise ValueError(f"damaged: it has {len(rest)} bytes more than its header declares")
    if rest:
        remarks.append(f"{len(rest)} bytes after the last of {about.points:,} points are ignored")
    if about.data == Encoding.ASCII and not body.endswith((b"\n", b"\r")):
        remarks.append(NO_LINE_END)
    if about.viewpoint[:3] != (0, 0, 0) or abs(about.viewpoint[3]) != 1:
        remarks.append(f"its VIEWPOINT is not applied: {' '.join(f'{value:g}' for value in about.viewpoint)}")
    families = {"points": ["x", "y", "z"], "normals": ["normal_x", "normal_y", "normal_z"]}
    return {
        key: np.stack([data[name].astype(np.float64) for name in names], axis=-1)
        for key, names in families.items()
        if key == "points" or set(names) <= {*data.dtype.names}
    } | {"remarks": np.array(remarks, str)}


def _pcd_header(file: Path):
    """Return the header of a PCD cloud, and what follows; pypcd4 itself would allocate any declared size."""
    from pypcd4 import MetaData

    lines: list[str] = []
    with file.open("rb") as stream:
        for line in stream:
            if (words := line.decode().strip()) and not words.startswith("#"):
                lines.append(words)
            if words.startswith("DATA") or len(lines) == 10:
                break
        body = stream.read()
    about, size = MetaData.parse_header(lines), file.stat().st_size
    if sum(about.count) > MOST_COLUMNS or about.points * _pcd_row(about) > max(LEAST_LIMIT, GROWTH * size):
        raise ValueError(f"{sum(about.count):,} columns and {about.points:,} points do not fit into {size:,} bytes")
    if about.width * about.height != about.points:
        raise ValueError(f"the header declares {about.points} points, and {about.width} x {about.height}")
    return about, body


def _pcd_row(about) -> int:
    """Return the size of a point [bytes]."""
    return sum(map(math.prod, zip(about.size, about.count, strict=True)))


def las(file: Path) -> dict[str, np.ndarray]:
    """Read the points of a LAS or LAZ cloud, with its header's scale and offset."""
    import laspy

    with file.open("rb") as stream:
        head = stream.read(104)
    if int.from_bytes(head[100:104], "little") * 54 > file.stat().st_size:  # laspy would try to read them all
        raise ValueError("it declares more variable length records than fit into the file")
    cloud, remarks = laspy.read(file), []
    if _is_in_feet(cloud.header.vlrs):
        raise ValueError("its coordinate system is in feet; convert the cloud to metres")
    declared, there = cloud.header.point_count, len(cloud.points)
    if not cloud.header.are_points_compressed:
        end = cloud.header.start_of_first_evlr if cloud.header.number_of_evlrs else file.stat().st_size
        there = max(there, (end - cloud.header.offset_to_point_data) // cloud.header.point_format.size)
    if there != declared:
        raise ValueError(f"the header declares {declared} points, the file contains {there}")
    withheld = np.array(cloud.withheld, bool)
    if withheld.any():
        remarks.append(f"{withheld.sum()} of {declared} points are marked as withheld and are ignored")
    if noise := int(np.isin(np.array(cloud.classification)[~withheld], LAS_NOISE).sum()):
        remarks.append(f"{noise} points are classified as noise (7, 18) and are used; delete them if they are no walls")
    points = np.array(cloud.xyz, dtype=np.float64)
    return {"points": points[~withheld] if withheld.any() else points, "remarks": np.array(remarks, str)}


def _is_in_feet(records) -> bool:
    """True if a coordinate system in the records of a LAS file has feet as a unit of length."""
    for record in records:
        keys = getattr(record, "geo_keys", ())  # of GeoTIFF
        if any(key.id in GEO_UNITS and key.value_offset in GEO_FEET for key in keys):
            return True
        if re.search(r"UNIT\s*\[\s*\"[^\"]*(foot|feet|ftUS)", getattr(record, "string", ""), re.IGNORECASE):
            return True
    return False


def e57(file: Path) -> dict[str, np.ndarray]:
    """Read the valid points of all scans in an E57 file, each transformed by its pose into the file's frame."""
    import pye57

    axes = ("cartesianX", "cartesianY", "cartesianZ")
    with pye57.E57(str(file)) as scans:  # spherical coordinates are converted
        read = [scans.read_scan(k, ignore_missing_fields=True) for k in range(scans.scan_count)]
        declared = sum(scans.get_header(k).point_count for k in range(scans.scan_count))
    clouds = [np.stack([scan[axis] for axis in axes], axis=-1) for scan in read]
    points = np.concatenate([np.empty((0, 3)), *clouds])
    invalid = declared - len(points)
    remarks = [f"{invalid} of {declared} points are marked as invalid and are ignored"] if invalid else []
    return {"points": points, "remarks": np.array(remarks, str)}


def step(file: Path) -> dict[str, np.ndarray]:
    """Read the triangles [m] of all solids and faces in a STEP file; the file contains its unit."""
    import trimesh

    data = file.read_bytes()
    about = _step_faces(data)
    # Open CASCADE omits faces that it cannot mesh. Only unmerged primitives can be counted, one for each face. Others
    # give the triangles, as the two kinds need not have one order; the first are freed before the second are made.
    read = _primitives(_tessellated(data, merge_primitives=False))
    if read < about.faces:
        missing = about.faces - read
        raise ValueError(f"{missing} of {about.faces} faces cannot be read; repair the part and export it again")
    glb = _tessellated(data, merge_primitives=True)
    scene = trimesh.load_scene(io.BytesIO(glb), file_type="glb", process=False)
    placed = [np.empty((0, 3, 3))]
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        triangles = np.asarray(scene.geometry[name].triangles, np.float64)
        placed.append(triangles @ T[:3, :3].T + T[:3, 3])
    return {"triangles": np.concatenate(placed), "remarks": np.array(about.remarks, str)}


def _tessellated(data: bytes, merge_primitives: bool) -> bytes:
    """Return the triangles of a STEP file as a GLB file."""
    import cascadio

    how = {"tol_linear": CHORD_DEVIATION_MM, "tol_angular": TURN_RAD, "use_parallel": False}
    if not (glb := cascadio.load(data, merge_primitives=merge_primitives, **how)):
        raise ValueError("the file contains no shapes")
    return glb


class StepFaces(NamedTuple):
    """Number of faces that a STEP file declares, and remarks."""

    faces: int  # in all shells
    remarks: list[str]


def _step_faces(data: bytes) -> StepFaces:
    """Check that a STEP file is complete, which Open CASCADE does not, and count its faces."""
    text = re.sub(r"/\*.*?\*/", "", data.decode("latin-1"), flags=re.DOTALL)
    text = re.sub(r"'(?:[^']|'')*'", "''", text)  # texts may contain anything
    if not re.search(r"END-ISO-10303-21\s*;", text):
        raise ValueError("damaged: it does not end with END-ISO-10303-21;")
    entities = dict(re.findall(r"#(\d+)\s*=\s*([^;]*);", text))
    shells = [body for body in entities.values() if re.match(SHELLS, body)]
    if missing := sorted({*re.findall(r"#(\d+)", text)} - entities.keys(), key=int):
        raise ValueError(f"damaged: it refers to #{missing[0]}, which it does not contain")
    if shells and not re.search(r"\bLENGTH_UNIT\b", text):
        raise ValueError("it states no unit of length")
    listed = {each for body in shells for each in re.findall(r"#(\d+)", body)}
    curves = sum(1 for body in entities.values() if re.match(r"GEOMETRIC_CURVE_SET\b", body))
    remarks = [f"its {curves} sets of curves are ignored, as they have no faces"] if curves else []
    if re.search(r"\bDOCUMENT_FILE\b", text):
        remarks.append("it refers to other files (DOCUMENT_FILE), which are not read")
    return StepFaces(sum(1 for each in listed if re.match(STEP_FACES, entities[each])), remarks)


def _primitives(glb: bytes) -> int:
    """Return the number of primitives of all meshes in a GLB file."""
    length = int.from_bytes(glb[12:16], "little")
    return sum(len(mesh["primitives"]) for mesh in json.loads(glb[20 : 20 + length]).get("meshes", ()))


def run_parser(kind: str, file: str, folder: str, memory: str) -> None:
    """Parse `file` with at most `memory` bytes and write its arrays or its error into `folder`.

    Args:
        kind: Name of the parser: pcd, las, e57 or step.
        file: Path of the file.
        folder: Path of an existing folder.
        memory: Maximum size of the process's memory [bytes].
    """
    with contextlib.suppress(ImportError, OSError, ValueError):  # only Linux limits the memory of a process
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    try:
        arrays = {"pcd": pcd, "las": las, "e57": e57, "step": step}[kind](Path(file))
        np.savez(Path(folder, "arrays.npz"), **arrays)
    except BaseException as error:  # a Rust parser's panic is no Exception
        Path(folder, "error.txt").write_text(f"{type(error).__name__}: {error}"[:500], errors="replace")
        raise SystemExit(1) from None


if __name__ == "__main__":
    run_parser(*sys.argv[1:])
