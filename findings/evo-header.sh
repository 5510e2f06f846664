#!/usr/bin/env bash
# evo reads a trajectory's columns by their place, whatever its comment line names
#
# Guess: the comment line `timestamp tx ty tz qw qx qy qz` decides; two blanks between columns are one separator, as
# for numpy.
# Seen: evo 1.38.1 takes the last column as w, so poses without rotation are turned by 180 degrees about x; with two
# blanks it refuses the file for its number of entries.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check evo==1.38.1
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import numpy
from evo.tools import file_interface

pathlib.Path("poses.txt").write_text("# timestamp tx ty tz qw qx qy qz\n0.1 1 2 3 1 0 0 0\n0.2 1 2 4 1 0 0 0\n")
poses = file_interface.read_tum_trajectory_file("poses.txt").poses_se3
print("y of the first frame:", [round(value) for value in poses[0][:3, 1]])
pathlib.Path("blanks.txt").write_text("0.1  1 2 3 0 0 0 1\n0.2  1 2 4 0 0 0 1\n")
print("numpy:", numpy.loadtxt("blanks.txt").shape)
try:
    file_interface.read_tum_trajectory_file("blanks.txt")
except file_interface.FileInterfaceException:
    print("evo: refused")
PY
diff seen.txt - <<'EXPECTED' || exit 1
y of the first frame: [0, -1, 0]
numpy: (2, 8)
evo: refused
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
