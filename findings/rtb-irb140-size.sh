#!/usr/bin/env bash
# One package family, two sizes of an arm: the URDF of the ABB IRB 140 is four times as large as its DH parameters
#
# Guess: rtb-data's irb140.urdf and roboticstoolbox's models.DH.IRB140 describe the same arm, whose data sheet states a
# reach of 0.81 m.
# Seen: the upper arm is 1.42 m long in rtb-data 2.0.0, and 0.36 m in roboticstoolbox-python 1.5.0. Joint origins and
# meshes of the URDF agree, so that nothing looks wrong.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export MPLCONFIGDIR="$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check roboticstoolbox-python==1.5.0 rtb-data==2.0.0 numpy==2.4.6 scipy==1.17.1
venv/bin/python - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import roboticstoolbox
import rtbdata

(file,) = Path(rtbdata.__file__).parent.glob("xacro/abb_irb140_description/urdf/irb140.urdf")
origins = {each.get("name"): each.find("origin").get("xyz") for each in ET.parse(file).getroot().findall("joint")}
shoulder, elbow = (list(map(float, origins[name].split())) for name in ("joint_2", "joint_3"))
base, upper = roboticstoolbox.models.DH.IRB140().links[:2]
print(f"URDF: upper arm {math.hypot(*elbow):.2f} m, shoulder at {shoulder[0]:.2f}, {shoulder[2]:.2f} m")
print(f"DH:   upper arm {abs(upper.a):.2f} m, shoulder at {abs(base.a):.2f}, {abs(base.d):.2f} m")
PY
diff seen.txt - <<'EXPECTED' || exit 1
URDF: upper arm 1.42 m, shoulder at 0.28, 1.38 m
DH:   upper arm 0.36 m, shoulder at 0.07, 0.35 m
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
