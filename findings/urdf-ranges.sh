#!/usr/bin/env bash
# Ranges of URDF joints: seven readers disagree on 0 to 0, on missing bounds and on continuous joints
#
# Guess: 0 to 0 states a joint that cannot move, though exporters also write it for values that were not filled in; a
# missing bound is 0, as URDF defines it; a continuous joint has no range; soft limits narrow the range.
# Seen: MuJoCo 4.0.0 has no limit for 0 to 0 and for one bound. With one bound or none hardly two readers agree.
# Five of seven limit a continuous joint that states a range. The soft limits are in no reader's range; Drake warns
# that it ignores them.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
export MPLCONFIGDIR="$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mujoco==4.0.0 pin==4.1.0 drake==1.51.1 pybullet==3.2.7 yourdfpy==0.0.60 urchin==0.0.30 roboticstoolbox-python==1.5.0 numpy==2.4.6 scipy==1.17.1
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import os

import mujoco, pinocchio, pybullet, roboticstoolbox, urchin, yourdfpy
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

LINK = """<link name="{}"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
ARM = f"""<robot name="arm">{"".join(map(LINK.format, ("base", "a", "b")))}
<joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="TYPE"><parent link="a"/><child link="b"/><origin xyz="0 0 0.5"/><axis xyz="0 1 0"/>
<limit BOUNDS effort="10" velocity="2"/>SOFT</joint>
</robot>
"""
SOFT = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="0.5" k_position="15" k_velocity="10"/>'
VARIANTS = {
    "0 to 0": ("revolute", 'lower="0" upper="0"', ""),
    "no bound": ("revolute", "", ""),
    "lower -1": ("revolute", 'lower="-1"', ""),
    "continuous": ("continuous", 'lower="-1" upper="1"', ""),
    "soft": ("revolute", 'lower="-1" upper="1"', SOFT),
}


def mujoco_range(file):
    model = mujoco.MjModel.from_xml_path(file)
    joint = model.joint("j2")
    return joint.range if model.jnt_limited[joint.id] else None


def pin_range(file):
    model = pinocchio.buildModelFromUrdf(file)
    if model.nqs[2] == 2:  # cosine and sine
        return None
    return model.lowerPositionLimit[1], model.upperPositionLimit[1]


def drake_range(file):
    plant = MultibodyPlant(0.001)
    Parser(plant).AddModels(file)
    plant.Finalize()
    joint = plant.GetJointByName("j2")
    return joint.position_lower_limit(), joint.position_upper_limit()


def pybullet_range(file):
    pybullet.connect(pybullet.DIRECT)
    info = pybullet.getJointInfo(pybullet.loadURDF(file), 1)
    pybullet.disconnect()
    return info[8:10]


def yourdfpy_range(file):
    limit = yourdfpy.URDF.load(file, load_meshes=False, load_collision_meshes=False).joint_map["j2"].limit
    return limit.lower, limit.upper


def urchin_range(file):
    return urchin.URDF.load(file).joint_limits[1]


def toolbox_range(file):
    return roboticstoolbox.Robot.URDF(file).qlim[:, 1]


def text(found):
    return "no limit" if found is None else " to ".join("none" if v is None else f"{v:.3g}" for v in found)


READERS = {
    "mujoco": mujoco_range, "pinocchio": pin_range, "drake": drake_range, "pybullet": pybullet_range,
    "yourdfpy": yourdfpy_range, "urchin": urchin_range, "roboticstoolbox": toolbox_range,
}
print(" | ".join(["reader", *VARIANTS]))
files = []
for number, (kind, bounds, soft) in enumerate(VARIANTS.values()):
    files.append(os.path.abspath(f"arm{number}.urdf"))
    with open(files[-1], "w") as file:
        file.write(ARM.replace("TYPE", kind).replace("BOUNDS", bounds).replace("SOFT", soft))
for name, read in READERS.items():
    print(" | ".join([name, *(text(read(file)) for file in files)]))
PY
diff seen.txt - <<'EXPECTED' || exit 1
reader | 0 to 0 | no bound | lower -1 | continuous | soft
mujoco | no limit | no limit | no limit | no limit | -1 to 1
pinocchio | 0 to 0 | 0 to 0 | -1 to 0 | no limit | -1 to 1
drake | 0 to 0 | -inf to inf | -1 to inf | -1 to 1 | -1 to 1
pybullet | 0 to 0 | 0 to -1 | -1 to -1 | -1 to 1 | -1 to 1
yourdfpy | 0 to 0 | none to none | -1 to none | -1 to 1 | -1 to 1
urchin | 0 to 0 | -inf to inf | -1 to inf | -1 to 1 | -1 to 1
roboticstoolbox | 0 to 0 | -3.14 to 3.14 | -3.14 to 3.14 | -1 to 1 | -1 to 1
EXPECTED
cat seen.txt
echo "as seen on 2026-11-28"
