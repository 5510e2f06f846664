"""Readers of STL, PLY and OBJ meshes: a file is read as its author meant it, or refused in one line."""

import struct
import warnings

import numpy as np
import pytest
import trimesh

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts import load_geometry
from htcp_jax.io.parts.polygons import triangulate

BOX = trimesh.creation.box((1.0, 2.0, 3.0))
TURNED = trimesh.creation.icosphere(subdivisions=2).apply_transform(
    trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0))
)


def geometry(folder, name, content):
    file = folder / name
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return load_geometry(file)


def refusal(folder, name, content) -> str:
    with pytest.raises(InputError) as caught:
        geometry(folder, name, content)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{folder / name}: ")
    return message.removeprefix(f"{folder / name}: ")


def area(triangles) -> float:
    edges = triangles[:, 1:] - triangles[:, :1]
    return float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2)


@pytest.mark.parametrize("kind, options", [
    ("stl", {}), ("stl_ascii", {}), ("obj", {}), ("ply", {}), ("ply", {"encoding": "ascii"}),
])  # fmt: skip
def test_a_mesh_is_read_as_trimesh_reads_it(tmp_path, kind, options):
    data = TURNED.export(file_type=kind, **options)
    data = data if isinstance(data, bytes) else f"{data.rstrip()}\n".encode()
    name = f"ball.{kind.partition('_')[0]}"
    (tmp_path / name).write_bytes(data)
    expected = trimesh.load_mesh(tmp_path / name, process=False).triangles
    assert np.array_equal(geometry(tmp_path, name, data).triangles, expected)


def facet(*corners, normal="0 0 1") -> str:
    rows = "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners)
    return f"facet normal {normal}\nouter loop\n{rows}endloop\nendfacet\n"


ONE = facet((0, 0, 0), (1, 0, 0), (0, 1, 0))
TEXTS = {
    "several solids": (f"solid a\n{ONE}endsolid a\nsolid b\n{ONE}{ONE}endsolid b\n", 3),
    "solids of one name": (f"solid a\n{ONE}endsolid a\nsolid a\n{ONE}endsolid a\n", 2),
    "solids without a name": (f"solid\n{ONE}endsolid\nsolid\n{ONE}endsolid\n", 2),
    "an empty solid": (f"solid a\nendsolid a\nsolid b\n{ONE}endsolid b\n", 1),
    "upper case": (f"solid A\n{ONE}endsolid A\n".upper(), 1),
    "blanks and a mark": (f"\ufeff \t\nsolid a\n{ONE}endsolid a\n", 1),
    "tabs and Windows lines": (f"solid a\n{ONE}endsolid a\n".replace("\n", "\r\n\t"), 1),
    "words of the format as a name": (f"solid facet endsolid vertex\n{ONE}endsolid facet\n", 1),
    "a facet on the line of the name": (f"solid a {ONE.replace(chr(10), ' ', 6)}{ONE}endsolid a\n", 2),
    "a facet that begins on the line of the name": (f"solid a {ONE}{ONE}endsolid a\n", 2),
    "all in one line": (f"solid a {ONE}{ONE}endsolid a".replace("\n", " ") + "\n", 2),
    "no normal": (f"solid a\n{ONE.replace('0 0 1', 'nan nan nan', 1)}endsolid a\n", 1),
}


@pytest.mark.parametrize("case", TEXTS)
def test_a_text_stl_has_the_triangles_of_all_its_solids(tmp_path, case):
    text, count = TEXTS[case]
    assert len(geometry(tmp_path, "a.stl", text).triangles) == count


@pytest.mark.parametrize("text, words", [
    (f"solid left\n{ONE}", 'damaged: solid "left" has no endsolid'),
    (f"solid left\n{ONE}solid right\n{ONE}endsolid\n", 'solid "left" has no endsolid before line 9'),
    (f"solid\n{ONE[:60]}", 'damaged: solid "1" has no endsolid'),
    (f"solid a\n{ONE[:60]}\nendsolid a\n", "line 2: 'facet' is not part of a valid facet"),
    (f"solid a\n{ONE}{ONE.replace('vertex 1', 'vertx 1')}endsolid\n", "line 9: a facet has 2 vertices"),
    (f"solid a\n{ONE.replace('outer loop', 'inner loop')}endsolid\n", "'facet' is not part of a valid facet"),
    (f"solid a\n{facet((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))}endsolid\n", "a facet has 4 vertices"),
    (f"solid a\n{facet((0, 0, 0), (1, 0, 0))}endsolid\n", "a facet has 2 vertices"),
    (f"solid a\n{ONE.replace('1 0 0', '1 0 zero')}endsolid\n", "could not convert string to float: 'zero'"),
    (f"solid a\n{ONE.replace('1 0 0', '1 0 1_0')}endsolid\n", "'1_0' is not a number"),
    (f"solid a\n{ONE}endsolid\nfacet\n", "line 10: 'facet' where a solid must begin"),
    (f"solid a\n{ONE}endsolid a {ONE}endsolid a\n", "line 9: 'facet' where a solid must begin"),
    (f"solid a\n{ONE.replace('normal', 'facet')}endsolid\n", "line 2: 'facet' is not part of a valid facet"),
    (f"solid a\n{ONE.replace('0 0 1', '0 0 1 vertex')}endsolid\n", "line 2: a facet has 4 vertices"),
    ("solid a\nendsolid a\n", "it contains no triangles"),
])  # fmt: skip
def test_a_text_stl_that_is_damaged_is_refused_with_the_place(tmp_path, text, words):
    assert words in refusal(tmp_path, "a.stl", text)


def binary_stl(triangles=BOX.triangles, declared=None, header=b"") -> bytes:
    count = len(triangles) if declared is None else declared
    rows = [struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles]
    return header.ljust(80) + struct.pack("<I", count) + b"".join(rows)


@pytest.mark.parametrize("declared", [0, 4, 13, 2**32 - 1])
def test_a_binary_stl_with_a_wrong_count_is_refused_with_both_numbers(tmp_path, declared):
    text = f"damaged: the header declares {declared:,} triangles, the file contains 12"
    assert refusal(tmp_path, "a.stl", binary_stl(declared=declared)) == text


@pytest.mark.parametrize("tail", [b"\0", b"\0" * 100, b"made by a scanner  " * 4, b"\xff" * 64, b"\n"])
def test_a_tail_of_padding_of_a_binary_stl_is_named(tmp_path, tail):
    with pytest.warns(Note, match=f"a.stl: {len(tail)} bytes after the last of 12 triangles are ignored"):
        assert len(geometry(tmp_path, "a.stl", binary_stl() + tail).triangles) == 12


def test_triangles_after_a_wrong_count_are_found_before_a_tail(tmp_path):
    assert "declares 3 triangles, the file contains 12" in refusal(
        tmp_path, "a.stl", binary_stl(declared=3) + b"\0" * 7
    )


def test_a_binary_stl_may_begin_with_the_word_solid(tmp_path):
    data = binary_stl(header=b"solid made by a program")
    assert len(geometry(tmp_path, "a.stl", data).triangles) == 12
    assert "the file contains 11" in refusal(tmp_path, "a.stl", data[:-1])


CORNERS = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n"


def ply(elements: str, rows: str, corners: str = CORNERS) -> str:
    count = corners.count("\n")
    header = f"ply\nformat ascii 1.0\nelement vertex {count}\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    return f"{header}{elements}end_header\n{corners}{rows}"


STRIPS = "element tristrips 1\nproperty list int int vertex_indices\n"
FACES = "element face 1\nproperty list uchar int {}\n"


@pytest.mark.parametrize("strip, corners", [
    ("4 0 1 2 3", [[0, 1, 2], [2, 1, 3]]), ("7 0 1 2 -1 1 2 3", [[0, 1, 2], [1, 2, 3]]),
    ("5 0 1 2 3 -1", [[0, 1, 2], [2, 1, 3]]), ("6 0 1 2 2 1 3", [[0, 1, 2], [2, 1, 3]]),
])  # fmt: skip
def test_the_strips_of_a_ply_are_triangles(tmp_path, strip, corners):
    vertices = np.array([row.split() for row in CORNERS.splitlines()], float)
    found = geometry(tmp_path, "a.ply", ply(STRIPS, f"{strip}\n")).triangles
    assert [sorted(map(tuple, each)) for each in found] == [sorted(map(tuple, vertices[each])) for each in corners]


def test_the_triangles_of_a_strip_have_one_sense(tmp_path):
    found = geometry(tmp_path, "a.ply", ply(STRIPS, "4 0 1 2 3\n")).triangles
    assert (np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])[:, 2] > 0).all()


@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index"])
@pytest.mark.parametrize("element", ["face", "polygons"])
def test_the_faces_of_a_ply_are_found_by_any_usual_name(tmp_path, name, element):
    header = FACES.format(name).replace("face", element)
    assert len(geometry(tmp_path, "a.ply", ply(header, "4 0 1 3 2\n")).triangles) == 2


def test_a_list_of_another_name_is_read_as_the_vertices_of_the_faces_and_named(tmp_path):
    with pytest.warns(Note, match="the list 'corners' of its elements 'face' is read as their vertices"):
        found = geometry(tmp_path, "a.ply", ply(FACES.format("corners"), "4 0 1 3 2\n"))
    assert len(found.triangles) == 2


@pytest.mark.parametrize("elements, rows, words", [
    ("element trifans 1\nproperty list int int vertex_index\n", "4 0 1 2 3\n", "elements 'trifans' may hold vertices"),
    ("element patch 1\nproperty list int int corner_index\n", "3 0 1 2\n", "'patch' may hold vertices"),
    ("element cell 1\nproperty list uchar int corners\n", "3 0 1 2\n", "'cell' may hold vertices"),
    ("element triangles 1\n" + "".join(f"property int v{k}\n" for k in range(3)), "0 1 2\n",
     "'triangles' may hold vertices"),
    ("element beam 1\nproperty int vertex1\nproperty int vertex2\n", "0 1\n", "'beam' may hold vertices"),
    ("element face 1\nproperty int a\n", "3\n", "elements 'face' have the lists none"),
    (FACES.format("a") + "property list uchar int b\n", "3 0 1 2 3 0 1 2\n", "have the lists a, b; one with the"),
    (FACES.format("vertex_index"), "3 0 1 4\n", "damaged: face 1 has vertex 5; the file has 4 vertices"),
    (FACES.format("vertex_index"), "3 0 1 -1\n", "damaged: face 1 has vertex 0; the file has 4 vertices"),
    (STRIPS, "3 0 1 4\n", "has vertex 5"), (STRIPS, "2 0 1\n", "a triangle strip has 2 corners"),
    (FACES.format("vertex_index"), "4 0 1 2\n", "damaged: face 1 of 1 is not complete"),
    (FACES.format("vertex_index"), "3 0 1 2 3\n", "face 1 has more numbers than its header declares"),
    (FACES.format("vertex_index"), "2 0 1\n", "face 1 has 2 corners; at least 3 are needed"),
    (FACES.format("vertex_index"), "3 0 1 2.5\n", "2.5 is not of the type int32"),
    (FACES.format("vertex_index"), "", "damaged: its header declares 1 elements 'face', the file contains 0"),
    (FACES.format("vertex_index"), "3 0 1 2\n3 1 2 3\n", "damaged: it has 1 lines more than its header declares"),
    ("element vertex 4\n", "", "its header has the line 'element vertex 4'"),
    ("property a\n", "", "its header has the line 'property a'"),
    ("property real a\n", "", "its header has the line 'property real a'"),
])  # fmt: skip
def test_a_ply_that_is_damaged_or_hides_faces_is_refused(tmp_path, elements, rows, words):
    assert words in refusal(tmp_path, "a.ply", ply(elements, rows))


@pytest.mark.parametrize("elements, rows, what", [
    ("element edge 1\nproperty int vertex1\nproperty int vertex2\n", "0 1\n", "its 1 elements 'edge'"),
    ("element range_grid 2\nproperty list uchar int vertex_indices\n", "1 0\n0\n", "its 2 elements 'range_grid'"),
    ("element multi_texture_face 1\nproperty list uchar uint texture_vertex_indices\n", "1 0\n",
     "its 1 elements 'multi_texture_face'"),
    ("element camera 1\nproperty float view_px\n", "0.5\n", "its 1 elements 'camera'"),
    ("element material 1\nproperty int vertex_count\n", "4\n", "its 1 elements 'material'"),
    ("element material 1\n" + "".join(f"property uchar ambient_{name}\n" for name in ("red", "green", "blue")),
     "9 9 9\n", "its 1 elements 'material'"),
])  # fmt: skip
def test_other_elements_of_a_ply_cloud_are_named(tmp_path, elements, rows, what):
    with pytest.warns(Note) as notes:
        assert len(geometry(tmp_path, "a.ply", ply(elements, rows)).points) == 4
    cloud = "it has no faces; its 4 vertices are read as a cloud"
    assert [str(each.message) for each in notes] == [f"{tmp_path / 'a.ply'}: {text}" for text in (
        f"{what} are ignored", cloud)]  # fmt: skip


@pytest.mark.parametrize("order, name", [("<", "little"), (">", "big")])
def test_a_binary_ply_with_faces_of_several_lengths_is_read_or_refused(tmp_path, order, name):
    """Faces with 3 and 4 corners, whose rows are not equally long, and a flag after each list."""
    header = ply("element face 2\nproperty list uchar ushort vertex_index\nproperty char flag\n", "").partition(
        "0 0 0\n"
    )
    vertices = np.array([row.split() for row in CORNERS.splitlines()], f"{order}f4").tobytes()
    faces = struct.pack(f"{order}B4Hb", 4, 0, 1, 3, 2, 1) + struct.pack(f"{order}B3Hb", 3, 0, 1, 2, 1)
    data = header[0].replace("ascii", f"binary_{name}_endian").encode() + vertices + faces
    assert len(geometry(tmp_path, "a.ply", data).triangles) == 3
    assert "damaged: it has 3 bytes more" in refusal(tmp_path, "a.ply", data + b"end")
    assert "damaged: face 2 of 2 is not complete" in refusal(tmp_path, "a.ply", data[:-1])
    with pytest.warns(Note, match="4 bytes after the last element are ignored"):
        geometry(tmp_path, "a.ply", data + b"\0" * 4)


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize("text", [
    f"{SQUARE}f 1 2 3 4\n", f"{SQUARE}f -4 -3 -2 -1\n", f"{SQUARE}f 1/1 2/2 3/3\nf -4//1 -2//1 -1//1\n",
    f"{SQUARE}f 1 2 \\\n3 4\n", f"{SQUARE}o a\nf 1 2 3\no b\nf 1 3 4\n",
    f"g a\n{SQUARE}usemtl m\nf 1 2 3\ng b\nf 1 3 4\n",
    f"\ufeff{SQUARE}f 1 2 3 4 # a comment\n".replace("\n", "\r\n"), f"{SQUARE}f 1 2 3 4\n".replace(" ", "\t "),
    f"v 9 9 9\n{SQUARE}f -4 -3 -2 -1\nv 9 9 9\n",
])  # fmt: skip
def test_an_obj_is_read_in_any_usual_notation(tmp_path, text):
    found = geometry(tmp_path, "a.obj", text).triangles
    assert len(found) == 2 and area(found) == pytest.approx(1.0)


@pytest.mark.parametrize("line, words", [
    ("f 1 2 5", "face 1 has vertex 5; the file has 4 vertices"),
    ("f 1 2 -5", "there is no vertex -5; the first vertex is 1"),
    ("f 0 1 2", "there is no vertex 0"), ("f 1 2", "face 1 has 2 corners; at least 3 are needed"),
    ("f 1 2 x", "line 5: 'x' is not a corner"), ("f 1 2 3.5", "'3.5' is not a corner"),
    ("ff 1 2 3", "line 5: unknown key 'ff'; write # before the line"),
    ("surf 0 1 0 1 1 2 3", "'surf' is not a polygon"),
    ("v 1 2", "line 5: a vertex needs three numbers"), ("v 1 2 1e", "line 5: a vertex needs three numbers"),
    ("call other.obj", "'call' is not a polygon"),
])  # fmt: skip
def test_a_line_of_an_obj_that_is_not_read_is_refused(tmp_path, line, words):
    assert words in refusal(tmp_path, "a.obj", f"{SQUARE}{line}\nf 1 2 3\n")


def test_a_backslash_in_a_comment_of_an_obj_does_not_hide_the_next_line(tmp_path):
    text = f"# C:\\parts\\\n{SQUARE}f 1 2 3 4 # C:\\\n"
    assert len(geometry(tmp_path, "a.obj", text).triangles) == 2


def test_lines_of_an_obj_that_a_backslash_joins_count_as_lines(tmp_path):
    assert "line 7: unknown key 'ff'" in refusal(tmp_path, "a.obj", f"{SQUARE}f 1 2 \\\n3 4\nff \\\n1\n")


@pytest.mark.parametrize("line, what", [
    ("l 1 2 3", r"its 1 lines \(l\) are ignored"), ("p 1", r"its 1 points \(p\) are ignored"),
])  # fmt: skip
def test_lines_and_points_next_to_faces_of_an_obj_are_named(tmp_path, line, what):
    with pytest.warns(Note, match=what):
        assert len(geometry(tmp_path, "a.obj", f"{SQUARE}f 1 2 3\n{line}\n").triangles) == 1


def test_an_obj_without_faces_is_named_as_a_cloud(tmp_path):
    with pytest.warns(Note, match="it has no faces; its 4 vertices are read as a cloud"):
        assert len(geometry(tmp_path, "a.obj", SQUARE).points) == 4


U = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
POLYGONS = {
    "square": [(0, 0), (1, 0), (1, 1), (0, 1)],
    "a corner on an edge": [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
    "arrow head": [(0, 0), (2, 0), (0.5, 0.5), (0, 2)],
    "arrow head from its notch": [(0.5, 0.5), (0, 2), (0, 0), (2, 0)],
    "L": [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)],
    "U": U,
    "U the other way": U[::-1],
    "a frame with a bridge": [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)],
    "a plate with three holes and bridges": [
        (0, 0),
        *((x + 3 * k, y) for k in range(3) for x, y in ((1, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1), (1, 0))),
        (9, 0),
        (9, 3),
        (0, 3),
    ],
    "comb": [(-1, -3), (40, -3), *((39 - k, 0 if k % 2 else 5) for k in range(40))],
    "spiral": [
        *((r * np.cos(a), r * np.sin(a)) for a, r in zip(np.linspace(0, 20, 60), np.linspace(1, 9, 60), strict=True)),
        *((r * np.cos(a), r * np.sin(a)) for a, r in zip(np.linspace(20, 0, 60), np.linspace(8, 0.5, 60), strict=True)),
    ],
}
STAR = np.random.default_rng(1).uniform(0.2, 1.0, 200) * np.exp(2j * np.pi * np.arange(200) / 200)
POLYGONS["star"] = list(zip(STAR.real, STAR.imag, strict=True))
SPACE = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]


def covers(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Number of triangles in the plane that contain each point."""
    a, b, c = (corners[:, k, None] for k in range(3))
    side = [(q - p)[..., 0] * (points - p)[..., 1] - (q - p)[..., 1] * (points - p)[..., 0]
            for p, q in ((a, b), (b, c), (c, a))]  # fmt: skip
    return (np.all(np.array(side) > 0, axis=0) | np.all(np.array(side) < 0, axis=0)).sum(axis=0)


def winding(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Number of turns of a polygon around each point."""
    arms = polygon[:, None] - points
    ends = np.roll(arms, -1, axis=0)
    turn = np.arctan2(arms[..., 0] * ends[..., 1] - arms[..., 1] * ends[..., 0], (arms * ends).sum(axis=-1))
    return np.abs(np.round(turn.sum(axis=0) / (2 * np.pi))).astype(int)


@pytest.mark.parametrize("shape", POLYGONS)
@pytest.mark.parametrize("turn", [0, 1, 3])
def test_the_triangles_of_a_polygon_cover_it_and_nothing_else(shape, turn):
    polygon = np.roll(np.array(POLYGONS[shape], float), turn, axis=0)
    vertices = 0.01 * np.column_stack([polygon, np.zeros(len(polygon))]) @ SPACE + [3.0, -2.0, 1.0]
    found = triangulate(vertices, np.arange(len(polygon)), np.array([len(polygon)]), "part.obj")
    points = np.random.default_rng(0).uniform(polygon.min(axis=0) - 0.1, polygon.max(axis=0) + 0.1, (2000, 2))
    assert np.array_equal(covers(polygon[found.corners], points), winding(polygon, points))


def test_a_convex_polygon_is_a_fan_from_its_first_corner():
    angle = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    vertices = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]) @ SPACE
    found = triangulate(vertices, np.arange(7), np.array([7]), "part.obj")
    assert found.corners.tolist() == [[0, k, k + 1] for k in range(1, 6)]


@pytest.mark.parametrize("polygon", [
    [(0, 0), (1, 1), (1, 0), (0, 1)], [(0, 0), (2, 2), (2, 0), (0, 1)], [(0, 0), (3, 0), (1, 2), (2, -2), (2.5, 2)],
])  # fmt: skip
def test_a_polygon_that_crosses_itself_is_refused(tmp_path, polygon):
    vertices = "".join(f"v {x} {y} 0\n" for x, y in polygon)
    numbers = " ".join(str(k + 1) for k in range(len(polygon)))
    assert "face 1 crosses itself" in refusal(tmp_path, "a.obj", f"{vertices}f {numbers}\n")


def test_a_polygon_that_is_not_flat_is_named(tmp_path):
    with pytest.warns(Note, match="1 of 1 polygons are not flat; they are divided into triangles"):
        found = geometry(tmp_path, "a.obj", SQUARE.replace("v 1 1 0", "v 1 1 0.4") + "f 1 2 3 4\n")
    assert len(found.triangles) == 2


def test_a_concave_face_covers_the_same_in_every_format(tmp_path):
    vertices = [(x, y, 0.0) for x, y in U]
    obj = "".join("v {} {} {}\n".format(*row) for row in vertices) + "f 1 2 3 4 5 6 7 8\n"
    rows = "".join("{} {} {}\n".format(*row) for row in vertices)
    faces = ply(FACES.format("vertex_indices"), "8 0 1 2 3 4 5 6 7\n", rows)
    one, other = geometry(tmp_path, "a.obj", obj).triangles, geometry(tmp_path, "a.ply", faces).triangles
    assert np.array_equal(one, other) and area(one) == pytest.approx(7.0)


def test_a_file_that_is_complete_is_read_in_silence(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("a.stl", "a.ply", "a.obj"):
            data = TURNED.export(file_type=name[2:])
            geometry(tmp_path, name, data if isinstance(data, bytes) else f"{data}\n")
