#!/usr/bin/env bash
# A concave polygon of a mesh: triangles outside of it, and an area that is not its own
#
# Guess: a reader triangulates a U of the area 7 so that the triangles cover it.
# Seen: trimesh 5.2.0 makes a fan, whose triangles fill the U's gap and overlap (area 11, from OBJ and from PLY);
# pyvista 0.49.1 reports the area 11 for the polygon, and 7 once it is triangulated.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 scipy==1.17.1 pyvista==0.49.1 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import pyvista, trimesh

corners = ["0 0 0", "3 0 0", "3 3 0", "2 3 0", "2 1 0", "1 1 0", "1 3 0", "0 3 0"]
obj = "".join(f"v {corner}\n" for corner in corners) + "f 1 2 3 4 5 6 7 8\n"
pathlib.Path("u.obj").write_text(obj)
head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
pathlib.Path("u.ply").write_text(head + "\n".join(corners) + "\n8 0 1 2 3 4 5 6 7\n")
for file in ("u.obj", "u.ply"):
    print(f"{file}, trimesh: {trimesh.load(file, process=False).area:.3g}")
    mesh = pyvista.read(file)
    print(f"{file}, pyvista: {mesh.area:.3g}, triangulated {mesh.triangulate().area:.3g}")
PY
diff seen.txt - <<'EXPECTED' || exit 1
u.obj, trimesh: 11
u.obj, pyvista: 11, triangulated 7
u.ply, trimesh: 11
u.ply, pyvista: 11, triangulated 7
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
