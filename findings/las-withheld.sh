#!/usr/bin/env bash
# Points that a LAS file marks as withheld are among the points that laspy returns
#
# Guess: a withheld point is deleted by the format's definition, so a reader leaves it out, as pye57 0.4.19 does
# with invalid points.
# Seen: laspy 2.7.0 returns it among x, y, z; the caller has to look at the flag.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check laspy==2.7.0 pye57==0.4.19 numpy==2.4.6
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import laspy, numpy, pye57

scan = laspy.create(point_format=6, file_version="1.4")
scan.x = scan.y = scan.z = numpy.array([1.0, 2.0, 3.0])
scan.withheld = numpy.array([0, 0, 1])
scan.write("scan.las")
print("laspy:", numpy.array(laspy.read("scan.las").x).tolist())
with pye57.E57("scan.e57", mode="w") as file:
    points = dict.fromkeys(("cartesianX", "cartesianY", "cartesianZ"), numpy.array([1.0, 2.0, 3.0]))
    file.write_scan_raw({**points, "cartesianInvalidState": numpy.array([0, 0, 2], dtype=numpy.int8)})
with pye57.E57("scan.e57") as file:
    print("pye57:", file.read_scan(0, ignore_missing_fields=True)["cartesianX"].tolist())
PY
diff seen.txt - <<'EXPECTED' || exit 1
laspy: [1.0, 2.0, 3.0]
pye57: [1.0, 2.0]
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
