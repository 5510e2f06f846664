#!/usr/bin/env bash
# A URDF's joint without an axis turns about x, but about z in pytorch_kinematics
#
# Guess: URDF defines the default axis as 1 0 0.
# Seen: pytorch-kinematics 0.10.0 turns about 0 0 1 (a column of the matrix changes that a turn about x leaves
# alone); MuJoCo 4.0.0 and yourdfpy 0.0.60 turn about x.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 yourdfpy==0.0.60 pytorch-kinematics==0.10.0 numpy==2.4.6 scipy==1.17.1
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import mujoco, pytorch_kinematics, torch, yourdfpy

print("mujoco:", mujoco.MjModel.from_xml_path("arm.urdf").joint("j2").axis.tolist())
arm = yourdfpy.URDF.load("arm.urdf", load_meshes=False, load_collision_meshes=False)
print("yourdfpy:", arm.joint_map["j2"].axis.tolist())
chain = pytorch_kinematics.build_serial_chain_from_urdf(open("arm.urdf").read().encode(), "b")
turned = chain.forward_kinematics(torch.tensor([0.0, 0.3])).get_matrix()[0, :3, :3].numpy()
print("pytorch_kinematics: x of the link is", *(f"{value:.3g}" for value in turned[:, 0]))
PY
diff seen.txt - <<'EXPECTED' || exit 1
mujoco: [1.0, 0.0, 0.0]
yourdfpy: [1.0, 0.0, 0.0]
pytorch_kinematics: x of the link is 0.955 0.296 0
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
