#!/usr/bin/env bash
# A URDF's mimic joint with an offset: at rest, each reader has it somewhere else
#
# Guess: a joint that mimics j1 with the factor 2 and the offset 0.1 is at 0.1 rad while j1 is at 0.
# Seen: yourdfpy 0.0.60 has 0.1. In MuJoCo 4.0.0 the joint is at 0 in the model's own initial configuration, as
# mimic is a soft constraint of the simulation; urchin 0.0.30 gives 0 without a configuration and 0.1 with j1 = 0;
# for pybullet 3.2.7 and roboticstoolbox 1.5.0 it is an independent joint.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export MPLCONFIGDIR="$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 pybullet==3.2.7 yourdfpy==0.0.60 urchin==0.0.30 roboticstoolbox-python==1.5.0 numpy==2.4.6 scipy==1.17.1
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/><mimic joint="j1" multiplier="2" offset="0.1"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import os

import mujoco, numpy, pybullet, roboticstoolbox, urchin, yourdfpy


def angle(T):
    return f"{numpy.arctan2(T[0, 2], T[2, 2]):.3g} rad"  # about y


file = os.path.abspath("arm.urdf")
model = mujoco.MjModel.from_xml_path(file)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
print("mujoco:", angle(data.body("b").xmat.reshape(3, 3)))
arm = yourdfpy.URDF.load(file, load_meshes=False, load_collision_meshes=False)
arm.update_cfg(arm.zero_cfg)
print("yourdfpy:", angle(arm.get_transform("b")))
arm = urchin.URDF.load(file)
print("urchin, no configuration:", angle(arm.link_fk()[arm.link_map["b"]]))
print("urchin, j1 = 0:", angle(arm.link_fk(cfg={"j1": 0.0})[arm.link_map["b"]]))
pybullet.connect(pybullet.DIRECT)
arm = pybullet.loadURDF(file, useFixedBase=True)
print(f"pybullet: {pybullet.getJointState(arm, 1)[0]:.3g} rad")
arm = roboticstoolbox.Robot.URDF(file)
print("roboticstoolbox:", angle(arm.fkine(numpy.zeros(arm.n), end="b").A), f"with {arm.n} joints")
PY
diff seen.txt - <<'EXPECTED' || exit 1
mujoco: 0 rad
yourdfpy: 0.1 rad
urchin, no configuration: 0 rad
urchin, j1 = 0: 0.1 rad
pybullet: 0 rad
roboticstoolbox: 0 rad with 2 joints
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
