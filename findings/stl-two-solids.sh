#!/usr/bin/env bash
# A text STL with two solids: numpy-stl returns the first one
#
# Guess: reading a file returns all of its triangles.
# Seen: Mesh.from_file of numpy-stl 4.1.1 returns 4 of 8 triangles without a message (from_multi_file has both);
# trimesh 5.2.0 returns a scene of two meshes, meshio 5.3.5 and pyvista 0.49.1 one mesh of 8.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy-stl==4.1.1 trimesh==5.2.0 scipy==1.17.1 meshio==5.3.5 pyvista==0.49.1 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import meshio, pyvista, trimesh
from stl import mesh


def solid(name, x):
    corners = [(x, 0, 0), (x + 1, 0, 0), (x, 1, 0), (x, 0, 1)]
    text = f"solid {name}\n"
    for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)):
        text += "facet normal 0 0 0\nouter loop\n"
        text += "".join("vertex {} {} {}\n".format(*corners[k]) for k in face)
        text += "endloop\nendfacet\n"
    return text + f"endsolid {name}\n"


pathlib.Path("two.stl").write_text(solid("a", 0) + solid("b", 5))
print("numpy-stl, from_file:", len(mesh.Mesh.from_file("two.stl").vectors))
print("numpy-stl, from_multi_file:", [len(each.vectors) for each in mesh.Mesh.from_multi_file("two.stl")])
print("trimesh:", [len(each.faces) for each in trimesh.load("two.stl").geometry.values()])
print("meshio:", [len(each.data) for each in meshio.read("two.stl").cells])
print("pyvista:", pyvista.read("two.stl").n_cells)
PY
diff seen.txt - <<'EXPECTED' || exit 1
numpy-stl, from_file: 4
numpy-stl, from_multi_file: [4, 4]
trimesh: [4, 4]
meshio: [8]
pyvista: 8
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
