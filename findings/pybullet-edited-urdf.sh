#!/usr/bin/env bash
# A URDF that was edited and loaded again is the old one in pybullet
#
# Guess: loadURDF reads the file, so that a changed limit is there at the next call.
# Seen: pybullet 3.2.7 returns the old limit, as it keeps the text by the file's name; under another name the same
# text is read.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pybullet==3.2.7 numpy==2.4.6
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit lower="-0.5" upper="1" effort="10" velocity="2"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import pathlib

import pybullet

pybullet.connect(pybullet.DIRECT)
file, text = pathlib.Path("arm.urdf"), pathlib.Path("arm.urdf").read_text()


def lower(file):
    return pybullet.getJointInfo(pybullet.loadURDF(str(file)), 1)[8]


print("before:", lower(file))
file.write_text(text.replace('lower="-0.5"', 'lower="-0.2"'))
print("after the edit:", lower(file))
print("under another name:", lower(file.rename("copy.urdf")))
PY
diff seen.txt - <<'EXPECTED' || exit 1
before: -0.5
after the edit: -0.5
under another name: -0.2
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
