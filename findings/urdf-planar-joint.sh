#!/usr/bin/env bash
# A planar joint of a URDF becomes a fixed one in roboticstoolbox
#
# Guess: a planar joint has three coordinates, or is refused.
# Seen: roboticstoolbox 1.5.0 loads the arm with one joint, j1, without a message; MuJoCo 4.0.0 makes three joints
# of it, pinocchio 4.1.0 four coordinates.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export MPLCONFIGDIR="$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 pin==4.1.0 roboticstoolbox-python==1.5.0 numpy==2.4.6 scipy==1.17.1
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="planar"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<axis xyz="0 0 1"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import os

import mujoco, pinocchio, roboticstoolbox

file = os.path.abspath("arm.urdf")
print("mujoco:", mujoco.MjModel.from_xml_path(file).nq, "coordinates")
print("pinocchio:", pinocchio.buildModelFromUrdf(file).nq, "coordinates")
print("roboticstoolbox:", roboticstoolbox.Robot.URDF(file).n, "coordinate")
PY
diff seen.txt - <<'EXPECTED' || exit 1
mujoco: 4 coordinates
pinocchio: 5 coordinates
roboticstoolbox: 1 coordinate
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
