#!/usr/bin/env bash
# meshio ends the Python process at a PLY with elements that it does not know
#
# Guess: a file that a library cannot read raises an exception that `except Exception` catches.
# Seen: meshio 5.3.5 calls sys.exit for a valid PLY file with strips or edges, so a loop over files ends without a
# traceback.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check meshio==5.3.5
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import meshio

HEAD = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n"
POINTS = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n1 2 0\n"
STRIPS = "element tristrips 1\nproperty list int int vertex_indices\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"

edges = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
pathlib.Path("edges.ply").write_text(HEAD + FACES + edges + "end_header\n" + POINTS + "3 0 1 2\n0 3\n")
try:
    meshio.read("edges.ply")
except Exception as error:
    print("Exception:", type(error).__name__)
except BaseException as error:
    print("not an Exception:", type(error).__name__)
PY
diff seen.txt - <<'EXPECTED' || exit 1
Expected `element vertex` or `element face` or `obj_info`, got `element edge 1`
not an Exception: SystemExit
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
