#!/usr/bin/env bash
# A PLY with triangle strips: the strips vanish without a message
#
# Guess: the strips, as scanners' tools write them, are triangulated, or the file is refused.
# Seen: trimesh 5.2.0 returns the strips' corners as a cloud, and of a file with one face and strips only the face;
# pyvista 0.49.1 (VTK) the same: no cells with an area, and 1 of 4 triangles.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 scipy==1.17.1 pyvista==0.49.1 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import pyvista, trimesh

HEAD = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
POINTS = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n1 2 0\n"
STRIPS = "element tristrips 1\nproperty list int int vertex_indices\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"

pathlib.Path("strips.ply").write_text(HEAD + STRIPS + "end_header\n" + POINTS + "6 0 1 2 3 4 5\n")
both = HEAD + FACES + STRIPS + "end_header\n" + POINTS + "3 0 1 2\n5 1 2 3 4 5\n"
pathlib.Path("both.ply").write_text(both)
for name in ("strips", "both"):
    found = trimesh.load(f"{name}.ply", process=False)
    print(f"{name}, trimesh: {type(found).__name__}, area {getattr(found, 'area', 0):.2g}")
    print(f"{name}, pyvista: area {pyvista.read(f'{name}.ply').area:.2g}")
PY
diff seen.txt - <<'EXPECTED' || exit 1
strips, trimesh: PointCloud, area 0
strips, pyvista: area 0
both, trimesh: Trimesh, area 0.5
both, pyvista: area 0.5
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
