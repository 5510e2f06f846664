#!/usr/bin/env bash
# A continuous URDF joint that states a range: endless for some readers, limited for others
#
# Guess: URDF says that lower and upper are to be omitted for a continuous joint, so a reader ignores them.
# Seen: MuJoCo 4.0.0 and pinocchio 4.1.0 (two coordinates on a circle) ignore them; Drake 1.51.1, pybullet 3.2.7,
# yourdfpy 0.0.60, urchin 0.0.30 and roboticstoolbox 1.5.0 report the range -1 to 1.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 pin==4.1.0 drake==1.51.1 pybullet==3.2.7 yourdfpy==0.0.60 urchin==0.0.30 roboticstoolbox-python==1.5.0
cat > arm.urdf <<'XML'
<robot name="arm">
<link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
</robot>
XML
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import os

import mujoco, pinocchio, pybullet, roboticstoolbox, urchin, yourdfpy
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant


def mujoco_range(file):
    joint = mujoco.MjModel.from_xml_path(file).joint("j2")
    limited = mujoco.MjModel.from_xml_path(file).jnt_limited[joint.id]
    return joint.range if limited else "no limit"


def pin_range(file):
    model = pinocchio.buildModelFromUrdf(file)
    return model.lowerPositionLimit[1], model.upperPositionLimit[1]


def drake_range(file):
    plant = MultibodyPlant(0.001)
    Parser(plant).AddModels(file)
    plant.Finalize()
    joint = plant.GetJointByName("j2")
    return joint.position_lower_limit(), joint.position_upper_limit()


def pybullet_range(file):
    pybullet.connect(pybullet.DIRECT)
    arm = pybullet.loadURDF(file)
    info = pybullet.getJointInfo(arm, 1)
    pybullet.disconnect()
    return info[8:10]


def yourdfpy_range(file):
    limit = yourdfpy.URDF.load(file, load_meshes=False, load_collision_meshes=False).joint_map["j2"].limit
    return limit.lower, limit.upper


def urchin_range(file):
    return urchin.URDF.load(file).joint_limits[1]


def toolbox_range(file):
    return roboticstoolbox.Robot.URDF(file).qlim[:, 1]


def show(file):
    readers = {
        "mujoco": mujoco_range, "pinocchio": pin_range, "drake": drake_range, "pybullet": pybullet_range,
        "yourdfpy": yourdfpy_range, "urchin": urchin_range, "roboticstoolbox": toolbox_range,
    }
    for name, read in readers.items():
        found = read(file)
        words = found if isinstance(found, str) else " to ".join("none" if v is None else f"{v:.4g}" for v in found)
        print(f"{name}: {words}")

pin_range = lambda file: ("no limit" if pinocchio.buildModelFromUrdf(file).nqs[2] == 2 else "limited")  # cos, sin
show(os.path.abspath("arm.urdf"))
PY
diff seen.txt - <<'EXPECTED' || exit 1
mujoco: no limit
pinocchio: no limit
drake: -1 to 1
pybullet: -1 to 1
yourdfpy: -1 to 1
urchin: -1 to 1
roboticstoolbox: -1 to 1
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
