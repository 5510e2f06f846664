#!/usr/bin/env bash
# An OBJ with two objects: MuJoCo has the vertices of both and the faces of the first
#
# Guess: all faces of the file belong to the mesh, as in trimesh (8 triangles).
# Seen: MuJoCo 4.0.0 keeps 4 of the 8 faces, without a message, and all 8 vertices.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 trimesh==5.2.0 scipy==1.17.1 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import mujoco, trimesh

text = ""
for k, x in enumerate((0, 5)):
    text += f"o part{k}\nv {x} 0 0\nv {x + 1} 0 0\nv {x} 1 0\nv {x} 0 1\n"
    text += "".join("f {} {} {}\n".format(*(4 * k + v for v in face)) for face in ((1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4)))
pathlib.Path("two.obj").write_text(text)
print("trimesh:", len(trimesh.load("two.obj").faces), "faces")
xml = "<mujoco><asset><mesh file='two.obj'/></asset><worldbody><geom type='mesh' mesh='two'/></worldbody></mujoco>"
model = mujoco.MjModel.from_xml_string(xml, {"two.obj": text.encode()})
print("mujoco:", model.nmeshface, "faces,", model.nmeshvert, "vertices")
PY
diff seen.txt - <<'EXPECTED' || exit 1
trimesh: 8 faces
mujoco: 4 faces, 8 vertices
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
