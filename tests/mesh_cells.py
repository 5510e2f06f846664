"""Cells with a mesh, in files of many formats as exporters write them, with the triangles that their authors meant."""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from collada_box import CORNERS, DAE, SIDES
from scipy.spatial.transform import Rotation

BODY, GEOM = ((0.1, -0.05, 0.2), (0.0, 0.0, 20.0)), ((0.3, 0.1, 0.15), (30.0, -40.0, 10.0))  # position, euler [deg]
FAR = "0.5 0.3 9"  # a vertex of no face


class Mesh(NamedTuple):
    """A mesh: its corners [m] and faces."""

    corners: np.ndarray
    faces: list

    @property
    def triangles(self) -> np.ndarray:
        """Corners of the triangles, in which faces with four corners are halved."""
        halves = [half for face in self.faces for half in ([face[:3], [face[0], *face[2:]]] if face[3:] else [face])]
        return self.corners[np.array(halves)]

    def __add__(self, other: "Mesh") -> "Mesh":
        faces = [[k + len(self.corners) for k in face] for face in other.faces]
        return Mesh(np.concatenate([self.corners, other.corners]), [*self.faces, *faces])


class Cell(NamedTuple):
    """A cell: its files by name, attributes of its mesh, and the truth about it."""

    files: dict[str, str | bytes]
    expected: np.ndarray  # triangles of the first geom, in its frame [m]
    is_solid: bool
    attributes: str = ""
    defaults: str = ""
    second: bool = False  # a second geom with the same mesh
    by_mujoco: bool = False  # MuJoCo itself reads the file in the same way


def box(size, at=(0.0, 0.0, 0.0)) -> Mesh:
    low, high = np.array(at) - np.array(size) / 2, np.array(at) + np.array(size) / 2
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    return Mesh(low + corners * (high - low), [[int(k) for k in face.split()] for face in SIDES.split("  ")])


def channel() -> Mesh:
    """A profile of the shape of a U, closed, whose hull fills the groove."""
    outline = np.array([[0, 0], [6, 0], [6, 4], [5, 4], [5, 1], [1, 1], [1, 4], [0, 4]]) * 0.04
    corners = np.concatenate([np.column_stack([outline, np.full(8, z)]) for z in (-0.1, 0.1)])
    caps = [[0, 1, 4, 5], [1, 2, 3, 4], [0, 5, 6, 7]]
    sides = [[k, (k + 1) % 8, 8 + (k + 1) % 8, 8 + k] for k in range(8)]
    return Mesh(corners, [face[::-1] for face in caps] + [[8 + k for k in face] for face in caps] + sides)


WEDGE = Mesh(np.diag([0.3, 0.2, 0.25, 0.0])[[3, 0, 1, 2], :3], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
SHEET = Mesh(np.array([[-0.2, -0.15, 0.05], [0.2, -0.15, 0.05], [0.2, 0.15, 0.05], [-0.2, 0.15, 0.05]]), [[0, 1, 2, 3]])
TRAY = box((0.3, 0.2, 0.15))
TRAY = TRAY._replace(faces=[face for face in TRAY.faces if face != [4, 5, 6, 7]])  # without a lid


def obj(*objects: Mesh, word: str = "o", unused: str = "") -> str:
    """Text of an OBJ file with named objects or groups, whose faces are numbered through."""
    lines, first = ["# an exporter's header", *([f"v {unused}"] if unused else [])], 2 if unused else 1
    for k, mesh in enumerate(objects):
        lines += [f"{word} part.{k:03}", *(f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in mesh.corners), "s off"]
        lines += ["f " + " ".join(str(first + corner) for corner in face) for face in mesh.faces]
        first += len(mesh.corners)
    return "\n".join(lines) + "\n"


def stl(mesh: Mesh, is_text: bool = False) -> str | bytes:
    """An STL file with normals of zero, which many exporters write."""
    if is_text:
        facets = ["\n".join(f"      vertex {x:.9e} {y:.9e} {z:.9e}" for x, y, z in face) for face in mesh.triangles]
        loops = [f"  facet normal 0 0 0\n    outer loop\n{facet}\n    endloop\n  endfacet\n" for facet in facets]
        return f"solid part\n{''.join(loops)}endsolid part\n"
    rows = [struct.pack("<12fH", 0, 0, 0, *face.ravel(), 0) for face in mesh.triangles]
    return b"binary STL".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def ply(mesh: Mesh, is_text: bool = False, unused: str = "") -> str | bytes:
    """A PLY file with a colour for each vertex, as text, or binary with the most significant byte first."""
    corners = [*mesh.corners.tolist(), *([[float(x) for x in unused.split()]] if unused else [])]
    head = f"ply\nformat {'ascii' if is_text else 'binary_big_endian'} 1.0\ncomment an exporter\n"
    head += f"element vertex {len(corners)}\n" + "".join(f"property double {axis}\n" for axis in "xyz")
    head += f"property uchar red\nelement face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    if is_text:
        rows = [" ".join([*map(repr, corner), "255"]) for corner in corners]
        return head + "\n".join([*rows, *(f"{len(face)} " + " ".join(map(str, face)) for face in mesh.faces)]) + "\n"
    body = b"".join(struct.pack(">3dB", *corner, 255) for corner in corners)
    return head.encode() + body + b"".join(struct.pack(f">B{len(f)}i", len(f), *f) for f in mesh.faces)


def posed(triangles: np.ndarray, pose=GEOM) -> np.ndarray:
    """Triangles moved by a pose: a position, and MJCF's default angles [deg], about moving axes."""
    return triangles @ Rotation.from_euler("XYZ", pose[1], degrees=True).as_matrix().T + np.array(pose[0])


def mirrored() -> Cell:
    """A wedge in millimetres, shifted, turned and mirrored by its asset, partly by a class of defaults."""
    wedge, turn = Mesh(1e3 * WEDGE.corners, WEDGE.faces), Rotation.from_quat([0.1, 0.2, -0.3, 0.9])
    expected = turn.inv().apply((wedge.triangles - [10, 20, 30]).reshape(-1, 3)).reshape(-1, 3, 3) * [-1e-3, 1e-3, 1e-3]
    attributes = 'class="mm" refpos="10 20 30" refquat="0.9 0.1 0.2 -0.3"'
    return Cell(
        {"part.stl": stl(wedge)}, expected, True, attributes,
        defaults='<default><default class="mm"><mesh scale="-0.001 0.001 0.001"/></default></default>', by_mujoco=True,
    )  # fmt: skip


BLOCK, APART = box((0.2, 0.1, 0.15)), box((0.1, 0.1, 0.1), (0.5, 0.0, 0.1))
MILLIMETRES = DAE.replace('name="metre" meter="1"', 'name="millimeter" meter="0.001"')
COLLADA = Mesh(np.array(CORNERS.split(), float).reshape(-1, 3) + np.array([0.0, 0.0, 1.0]), box((1, 1, 1)).faces)
CELLS = {
    "OBJ, a convex object and a concave one": Cell(
        {"part.obj": obj(APART, channel())}, (APART + channel()).triangles, False
    ),
    "OBJ, a concave group and a convex one": Cell(
        {"part.obj": obj(channel(), APART, word="g")}, (channel() + APART).triangles, False
    ),
    "OBJ, two convex objects": Cell({"part.obj": obj(BLOCK, APART)}, (BLOCK + APART).triangles, False),
    "STL as text": Cell({"part.stl": stl(BLOCK, is_text=True)}, BLOCK.triangles, True),
    "binary STL": Cell({"part.stl": stl(WEDGE)}, WEDGE.triangles, True, by_mujoco=True),
    "PLY as text": Cell({"part.ply": ply(WEDGE, is_text=True)}, WEDGE.triangles, True),
    "binary PLY": Cell({"part.ply": ply(channel())}, channel().triangles, False),
    "Collada in millimetres": Cell(
        {"part.dae": MILLIMETRES}, 0.5 * COLLADA.triangles, True, attributes='scale="500 500 500"'
    ),
    "a box without a lid": Cell({"part.stl": stl(TRAY)}, TRAY.triangles, False, by_mujoco=True),
    "a flat sheet": Cell({"part.obj": obj(SHEET)}, SHEET.triangles, False),
    "a tilted sheet": Cell({"part.stl": stl(Mesh(posed(SHEET.corners), SHEET.faces))}, posed(SHEET.triangles), False),
    "mirrored, turned and in millimetres": mirrored(),
    "OBJ with a vertex of no face": Cell({"part.obj": obj(BLOCK, unused=FAR)}, BLOCK.triangles, True),
    "PLY with a vertex of no face": Cell({"part.ply": ply(WEDGE, unused=FAR)}, WEDGE.triangles, True),
    "two geoms of one mesh": Cell({"part.stl": stl(WEDGE)}, WEDGE.triangles, True, second=True, by_mujoco=True),
}


def write_cell(cell: Cell, folder: Path) -> Path:
    """Write the files of a cell, and return its model."""
    for name, content in cell.files.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())

    def pose(values) -> str:
        position, angles = (" ".join(map(str, each)) for each in values)
        return f'pos="{position}" euler="{angles}"'

    second = '<geom name="second" type="mesh" mesh="part" pos="0.2 -0.4 0.3"/>' if cell.second else ""
    (folder / "cell.xml").write_text(
        f"<mujoco>{cell.defaults}"
        f'<asset><mesh name="part" file="{next(iter(cell.files))}" {cell.attributes}/></asset><worldbody>'
        f'<body name="stand" {pose(BODY)}><geom name="first" type="mesh" mesh="part" {pose(GEOM)}/>{second}</body>'
        "</worldbody></mujoco>"
    )
    return folder / "cell.xml"


def truth(cell: Cell) -> list[np.ndarray]:
    """Triangles of the geoms of a cell, world [m]."""
    poses = [GEOM, ((0.2, -0.4, 0.3), (0.0, 0.0, 0.0))][: 2 if cell.second else 1]
    return [posed(posed(cell.expected, pose), BODY) for pose in poses]
