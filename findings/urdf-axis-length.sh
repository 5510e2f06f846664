#!/usr/bin/env bash
# The length of a prismatic URDF joint's axis: a direction for some readers, a factor for others
#
# Guess: an axis is a direction, which a reader normalises; at 0.3 m the link has moved by 0.3 m.
# Seen: with the axis 0 0 2, pybullet 3.2.7 and yourdfpy 0.0.60 move the link by 0.6 m; MuJoCo 4.0.0, pinocchio
# 4.1.0, Drake 1.51.1, urchin 0.0.30 and roboticstoolbox 1.5.0 by 0.3 m.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export MPLCONFIGDIR="$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 pin==4.1.0 drake==1.51.1 pybullet==3.2.7 yourdfpy==0.0.60 urchin==0.0.30 roboticstoolbox-python==1.5.0 numpy==2.4.6 scipy==1.17.1
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import os

import mujoco, numpy, pinocchio, pybullet, roboticstoolbox, urchin, yourdfpy
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

file = os.path.abspath("arm.urdf")
model = mujoco.MjModel.from_xml_path(file)
data = mujoco.MjData(model)
data.qpos[:] = 0, 0.3
mujoco.mj_kinematics(model, data)
print(f"mujoco: {data.body('b').xpos[2] - 0.5:.3g} m")
model = pinocchio.buildModelFromUrdf(file)
data = model.createData()
pinocchio.forwardKinematics(model, data, numpy.array([0, 0.3]))
print(f"pinocchio: {data.oMi[2].translation[2] - 0.5:.3g} m")
plant = MultibodyPlant(0.001)
Parser(plant).AddModels(file)
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
plant.Finalize()
context = plant.CreateDefaultContext()
plant.GetJointByName("j2").set_translation(context, 0.3)
print(f"drake: {plant.GetBodyByName('b').EvalPoseInWorld(context).translation()[2] - 0.5:.3g} m")
pybullet.connect(pybullet.DIRECT)
arm = pybullet.loadURDF(file, useFixedBase=True)
pybullet.resetJointState(arm, 1, 0.3)
print(f"pybullet: {pybullet.getLinkState(arm, 1, computeForwardKinematics=1)[4][2] - 0.5:.3g} m")
arm = yourdfpy.URDF.load(file, load_meshes=False, load_collision_meshes=False)
arm.update_cfg(numpy.array([0, 0.3]))
print(f"yourdfpy: {arm.get_transform('b')[2, 3] - 0.5:.3g} m")
arm = urchin.URDF.load(file)
print(f"urchin: {arm.link_fk(cfg={'j2': 0.3})[arm.link_map['b']][2, 3] - 0.5:.3g} m")
arm = roboticstoolbox.Robot.URDF(file)
print(f"roboticstoolbox: {arm.fkine([0, 0.3], end='b').t[2] - 0.5:.3g} m")
PY
diff seen.txt - <<'EXPECTED' || exit 1
mujoco: 0.3 m
pinocchio: 0.3 m
drake: 0.3 m
pybullet: 0.6 m
yourdfpy: 0.6 m
urchin: 0.3 m
roboticstoolbox: 0.3 m
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
