#!/usr/bin/env bash
# Relative vertex numbers of an OBJ: two readers use the vertices of other places
#
# Guess: f -3 -2 -1 means the three vertices read last, at the place of the face.
# Seen: trimesh 5.2.0 returns the second triangle twice; meshio 5.3.5 twice a triangle of vertices 3, 4 and 5, which
# the file does not have; pyvista 0.49.1 returns both triangles.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 scipy==1.17.1 meshio==5.3.5 pyvista==0.49.1 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import meshio, pyvista, trimesh

first, second = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n", "v 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
pathlib.Path("two.obj").write_text(first + second)
print("x of trimesh's corners:", trimesh.load("two.obj", process=False).triangles[:, :, 0].tolist())
mesh = meshio.read("two.obj")
print("x of meshio's corners:", mesh.points[mesh.cells[0].data][:, :, 0].tolist())
mesh = pyvista.read("two.obj")
print("x of pyvista's corners:", mesh.points[mesh.regular_faces][:, :, 0].tolist())
PY
diff seen.txt - <<'EXPECTED' || exit 1
x of trimesh's corners: [[5.0, 6.0, 5.0], [5.0, 6.0, 5.0]]
x of meshio's corners: [[0.0, 5.0, 6.0], [0.0, 5.0, 6.0]]
x of pyvista's corners: [[0.0, 1.0, 0.0], [5.0, 6.0, 5.0]]
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
