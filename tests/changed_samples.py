"""Valid files for `changed_files`, and the elements in them that may change without effect, each with its reason."""

import numpy as np

from htcp_jax.io.motions import JobController
from htcp_jax.io.motions.job_controller import EncoderScale

ARM_URDF = """<robot name="arm">
<link name="base"><collision><origin xyz="0 0 .1"/><geometry><sphere radius=".1"/></geometry></collision></link>
<link name="upper"><inertial><origin xyz="0 0 .1"/><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision name="ball"><origin xyz="0 0 .15"/><geometry><sphere radius=".06"/></geometry></collision>
<collision name="case"><geometry><box size=".1 .1 .3"/></geometry></collision></link>
<link name="fore"><visual><geometry><sphere radius=".07"/></geometry><material name="grey"><color rgba="1 1 1 1"/>
</material></visual><collision><origin xyz="0 .02 .1"/><geometry><sphere radius=".05"/></geometry>
</collision></link>
<link name="hand"><collision><geometry><sphere radius=".04"/></geometry></collision></link>
<link name="tool"/>
<joint name="j1" type="revolute"><origin xyz="0 0 .2" rpy="0 0 .1"/><parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2.5" effort="90" velocity="1.5"/><dynamics damping=".1" friction=".2"/>
<safety_controller soft_lower_limit="-1.8" soft_upper_limit="2.2" k_position="15" k_velocity="10"/></joint>
<joint name="j2" type="continuous"><origin xyz="0 0 .3"/><parent link="upper"/><child link="fore"/>
<axis xyz="0 1 0"/><limit effort="60" velocity="2"/></joint>
<joint name="j3" type="prismatic"><origin xyz=".02 0 .2"/><parent link="fore"/><child link="hand"/>
<axis xyz="1 0 0"/><limit lower="-.1" upper=".4" effort="40" velocity=".3" acceleration="2"/></joint>
<joint name="mount" type="fixed"><origin xyz="0 0 .1" rpy="0 .3 0"/><parent link="hand"/><child link="tool"/></joint>
<link name="rod"><collision><geometry><sphere radius=".02"/></geometry></collision></link>
<joint name="push" type="revolute"><origin xyz="0 .1 0"/><parent link="upper"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="3" effort="60" velocity="2"/>
<mimic joint="j1" multiplier="-.5" offset=".2"/></joint>
<transmission name="t1"><joint name="j1"/></transmission></robot>
"""
FINGERS = """<link name="left"><collision><geometry><cylinder radius=".02" length=".1"/></geometry></collision></link>
<link name="right"><collision><geometry><box size=".03 .02 .06"/></geometry></collision></link>
<joint name="g1" type="prismatic"><origin xyz="0 .1 0"/><parent link="upper"/><child link="left"/>
<axis xyz="0 1 0"/><limit lower="0" upper=".04" effort="5" velocity=".1"/></joint>
<joint name="g2" type="prismatic"><origin xyz="0 -.1 0"/><parent link="upper"/><child link="right"/>
<axis xyz="0 1 0"/><limit lower="0" upper=".05" effort="5" velocity=".1"/>
<mimic joint="g1" multiplier="1.2" offset=".01"/></joint>
</robot>
"""
VENDOR_URDF = ARM_URDF.replace('<box size=".1 .1 .3"/>', '<mesh filename="box.stl" scale=".1 .1 .3"/>').replace(
    "</robot>\n", FINGERS
)
ARM_MJCF = """<mujoco model="arm"><compiler angle="radian" autolimits="true"/>
<custom><numeric name="speed" data="1 2 3 4"/><numeric name="acceleration" data="4 5 6 7"/></custom>
<default><default class="c"><joint axis="0 1 0" range="-2 2"/></default></default>
<contact><exclude body1="a" body2="c"/></contact>
<worldbody><body name="a" pos="0 0 .3"><joint name="j1" axis="0 0 1" range="-1 2" actuatorfrcrange="-9 9"/>
<geom name="trunk" type="capsule" size=".05" fromto="0 0 0 0 0 .3"/>
<body name="b" pos="0 0 .3" euler=".1 0 0"><joint name="j2" class="c"/><geom type="capsule" size=".04 .1"/>
<body name="c" pos=".1 0 .3" quat="1 .1 0 0"><joint name="j3" type="slide" range="0 .5"/>
<geom type="sphere" size=".04"/><inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .1"/><site name="tcp" pos="0 0 .1"/>
</body></body><body name="rod"><joint name="push" class="c" ref=".1"/><geom type="sphere" size=".02"/></body>
</body></worldbody><equality><joint joint1="push" joint2="j2" polycoef=".1 -.5"/></equality></mujoco>
"""
VENDOR_MJCF = ARM_MJCF.replace(
    "<worldbody>", '<asset><mesh name="shell" file="box.stl" scale=".1 .2 .1"/></asset><worldbody>'
).replace('<body name="c"', '<geom type="mesh" mesh="shell" pos="0 0 .1"/><body name="c"')
CELL = """<mujoco model="cell"><compiler angle="radian"/><default><default class="wall">
<geom type="box" size=".5 .02 .4"/></default></default>
<asset><mesh name="block" file="box.stl" scale=".2 .2 .1"/></asset>
<worldbody><geom name="floor" type="plane" size="2 2 .1" pos="0 0 -.1"/><light pos="0 0 3"/>
<body name="table" pos=".5 0 .2" euler="0 0 .3"><geom name="top" type="box" size=".4 .3 .02"/>
<body name="jig" pos="0 .1 .05"><geom type="cylinder" size=".02 .1"/><geom name="knob" type="sphere" size=".03"
pos="0 0 .1"/><geom name="part" type="mesh" mesh="block" pos=".1 0 .1"/></body></body>
<body name="fence" pos="0 -1 .4"><geom class="wall"/><geom name="rail" type="capsule" size=".02"
fromto="0 0 0 .5 0 .5"/><geom name="sign" type="box" size=".1 .1 .1" contype="0" conaffinity="0"/></body>
</worldbody></mujoco>
"""
SRDF = """<robot name="arm"><group name="manipulator"><chain base_link="base" tip_link="tool"/></group>
<group_state name="home" group="manipulator"><joint name="j1" value="0.5"/></group_state>
<virtual_joint name="fixed" type="fixed" parent_frame="world" child_link="base"/>
<disable_collisions link1="base" link2="upper" reason="Adjacent"/>
<disable_collisions link1="upper" link2="fore" reason="Adjacent"/>
<disable_collisions link1="base" link2="fore" reason="Never"/></robot>
"""
OBJ = """# a prism and a plate
mtllib paint.mtl
o prism
v 0 0 0
v 0.3 0 0
v 0 0.4 0
v 0 0 0.5
vt 0.5 0.5
vn 0 0 1
usemtl red
s off
f 1 3 2
f 1 2 4
f 2/1/1 3/1/1 4/1/1
f 3//1 1//1 4//1
o plate
g top
v 1 0 0.1
v 1.5 0 0.1
v 1.5 0.6 0.1
v 1 0.7 0.1
f 5 6 7 8
"""
STL = "solid prism\n" + "".join(
    "  facet normal 0 0 1\n    outer loop\n"
    + "".join(f"      vertex {corner}\n" for corner in corners)
    + "    endloop\n  endfacet\n"
    for corners in (
        ("0 0 0", "0.3 0 0", "0 0.4 0"), ("0 0 0", "0.3 0 0", "0 0 0.5"), ("0.3 0 0", "0 0.4 0", "0 0 0.5"),
        ("0 0 0", "0 0.4 0", "0 0 0.5"),
    )
) + "endsolid prism\n"  # fmt: skip
PLY = """ply
format ascii 1.0
comment a plate with a step
element vertex 6
property float x
property float y
property float z
element face 3
property list uchar int vertex_indices
end_header
0.1 0.2 0.3
1.1 0.25 0.3
1.2 0.9 0.35
0.15 0.95 0.4
1.3 0.1 0.6
1.4 0.8 0.7
4 0 1 2 3
3 1 4 5
3 1 5 2
"""
PLY_CLOUD = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
end_header
0.1 0.2 0.3 0 0 1 10
1.1 0.25 0.3 0 0 1 20
1.2 0.9 0.35 0 1 0 30
0.15 0.95 0.4 1 0 0 40
1.3 0.1 0.6 0 0 1 50
"""
PATH = """x [mm],y [mm],z [mm],nx,ny,nz
500,100,200,0,0,1
510,101,200,0,0,1
520,103,201,0,0.6,0.8
530,106,203,0,0.6,0.8
540,110,204,0.6,0,0.8
"""
POSES = """# timestamp tx ty tz qx qy qz qw
0.1 0.5 0.1 0.2 0 0 0 1
0.2 0.51 0.11 0.2 0 0 0.6 0.8
0.3 0.52 0.13 0.21 0 0.6 0 0.8
0.4 0.53 0.16 0.22 0.6 0 0 0.8
"""
JOINT_LIMITS = """default_velocity_scaling_factor: 0.1
joint_limits:
""" + "".join(
    f"""  {name}:
    has_position_limits: true
    min_position: {-1 - k}
    max_position: {1.5 + k}
    has_velocity_limits: true
    max_velocity: {2 + k}
    has_acceleration_limits: true
    max_acceleration: {5 + k}
    has_jerk_limits: true
    max_jerk: {50 + k}
"""
    for k, name in enumerate(("joint1", "joint2", "joint3", "joint4", "joint5", "joint6"))
)
JOB = """robot:
  model: arm.xml
  base_m: [0.1, 0.2, 0.3]
  tcp: tcp
workpiece:
  cloud: part.stl
  path: path.csv
  path_unit: mm
  interior: none
  neutral_translation_m: [0.5, 0.1, 0.2]
  rotation_y_rad: 0.2
cell:
  model: cell.xml
start_rad: [0.1, 0.2, 0.3]
margin_m: 0.002
method: beam
task:
  - axis: tcp.z
    towards: [0, 0, 1]
    within_deg: 5
settings:
  alpha_rad: 0.05
  beam_width: 20
  seed: 3
program:
  velocity: [1, 2, 3]
"""

MOTION = """time_s,joint1_rad,joint2_rad,joint3_rad,joint4_rad,joint5_rad,joint6_rad,force
0.5,0.1,0.2,0.3,0.4,0.5,0.6,10
1.25,0.15,0.25,-0.35,0.45,0.55,0.65,20
2.75,0.11,0.22,-0.33,0.44,0.56,0.66,30
"""
TRAJECTORY = """joint_names:
  - joint1
  - joint2
  - joint3
  - joint4
  - joint5
  - joint6
points:
  - positions: [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    velocities: [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    time_from_start:
      sec: 1
      nanosec: 500000000
  - positions: [0.11, 0.22, 0.33, 0.44, 0.55, 0.66]
    velocities: [0.15, 0.25, 0.35, 0.45, 0.05, 0.06]
    time_from_start:
      sec: 3
      nanosec: 250000000
"""
KEY_FRAMES = """<mujoco><keyframe>
<key name="0_approach" time="0.5" qpos="0.1 0.2 0.3 0.4 0.5 0.6" qvel="1 2 3 4 5 6"/>
<key name="1_process" time="1.25" qpos="0.11 0.21 0.31 0.41 0.51 0.61" qvel="1.1 2.1 3.1 4.1 5.1 6.1"/>
</keyframe></mujoco>
"""
NO_AXES = ",".join(["9E9"] * 6)
RAPID = f"""MODULE WeldModule
CONST jointtarget begin := [[10,20,30,40,50,60],[{NO_AXES}]];
PROC weld()
MoveAbsJ begin,v50,fine,tool0;
SetDO arc,1;
MoveAbsJ [[11,21,31,41,51,61],[{NO_AXES}]],v1000\\T:=0.5,z10,tool0;
MoveAbsJ [[12,22,32,42,52,62],[{NO_AXES}]],v1000\\T:=0.75,fine,tool0;
ENDPROC
ENDMODULE
"""
KRL = """&ACCESS RVP
DEF weld()
DECL E6AXIS begin
BAS(#INITMOV,0)
begin={A1 10, A2 20, A3 30, A4 40, A5 50, A6 60}
$VEL_AXIS[1]=5
PTP begin
$OUT[5]=TRUE
$APO.CPTP=20
PTP {E6AXIS: A1 11, A2 21, A3 31, A4 41, A5 51, A6 61} C_PTP
PTP {A1 12, A2 22, A3 32, A4 42, A5 52, A6 62}
END
"""
LS = """/PROG WELD
/ATTR
/MN
   1:J P[1] 5% FINE ;
   2:  DO[5]=ON ;
   3:J P[2] 500msec CNT50 ;
   4:J P[3] 2.5sec FINE ;
/POS
P[1]{
   GP1:
 UF : 0, UT : 1,
 J1= 10 deg, J2= 20 deg, J3= 30 deg,
 J4= 40 deg, J5= 50 deg, J6= 60 deg
};
P[2]{
   GP1:
 UF : 0, UT : 1,
 J1= 11 deg, J2= 21 deg, J3= 31 deg,
 J4= 41 deg, J5= 51 deg, J6= 61 deg
};
P[3]{
   GP1:
 UF : 0, UT : 1,
 J1= 12 deg, J2= 22 deg, J3= 32 deg,
 J4= 42 deg, J5= 52 deg, J6= 62 deg
};
/END
"""
APT = """PARTNO PRISM
UNITS/MM
FROM/1,2,3,0,0,1
FEDRAT/600,MMPM
RAPID
GOTO/10,20,30,0,0.6,0.8
GOTO/11,21,31
GOTO/12,22,32,$
0.6,0,0.8
COOLNT/ON
RAPID
GOTO/40,50,60
GODLTA/1,2,3
GOTO/41.5,51.5,61.5
FINI
"""
URSCRIPT = """def weld():
home = [0.1,0.2,0.3,0.4,0.5,0.6]
movej(home, 1.5, 0.5)
set_digital_out(0, True)
movej([0.11,0.21,0.31,0.41,0.51,0.61], t=1.5, r=0.05)
servoj([0.12,0.22,0.32,0.42,0.52,0.62], t=0.25)
end
"""
INFORM = """/JOB
//NAME WELD
//POS
///NPOS 3,0,0,0,0,0
///TOOL 3
///POSTYPE PULSE
///PULSE
C00000=1000,2000,3000,4000,5000,6000
C00001=1100,2100,3100,4100,5100,6100
C00002=1200,2200,3200,4200,5200,6200
//INST
///DATE 2020/01/02 03:04
///ATTR SC,RW
///GROUP1 RB1
NOP
MOVJ C00000 VJ=5.00
DOUT OT#(1) ON
MOVJ C00001 VJ=6.00
MOVJ C00002 VJ=7.00 PL=0
END
"""
MOTION_CONTROLLER = JobController(pulses=EncoderScale(np.full(6, 1e5), np.zeros(6)))

SAMPLES = {
    "arm.urdf": ARM_URDF, "vendor.urdf": VENDOR_URDF, "arm.xml": ARM_MJCF, "vendor.xml": VENDOR_MJCF, "cell.xml": CELL,
    "arm.srdf": SRDF, "part.obj": OBJ, "part.stl": STL, "part.ply": PLY, "scan.ply": PLY_CLOUD, "path.csv": PATH,
    "motion.csv": MOTION, "trajectory.yaml": TRAJECTORY, "keys.xml": KEY_FRAMES, "weld.mod": RAPID,
    "weld.src": KRL, "weld.ls": LS, "part.apt": APT,
    "weld.script": URSCRIPT, "weld.jbi": INFORM, "poses.txt": POSES, "joint_limits.yaml": JOINT_LIMITS, "job.yaml": JOB,
}  # fmt: skip
SIDE_FILES = {"box.stl": STL}

# Of XML: an element by its tag or place, "tag.attribute" or "place.attribute", "2 ..." if only doubling is harmless.
# Of lines: patterns that are removed before texts are compared. Of YAML: keys.
URDF_HARMLESS = {
    "material": "a colour",
    "visual": "the collision geometry is used",
    "transmission": "of a controller",
    "dynamics": "damping and friction, which no result depends on",
    "inertial": "masses do not affect a motion",
    "safety_controller.k_position": "a controller's gain",
    "safety_controller.k_velocity": "a controller's gain",
    "2 axis.xyz": "a direction has no length",
    "<joint name='mount'>.name": "the joint is fixed",
    "2 <joint name='j1'> > <limit>.lower": "the soft limit is tighter",
    "2 <joint name='j1'> > <limit>.upper": "the soft limit is tighter",
}
MJCF_HARMLESS = {
    "light": "a picture's",
    "option": "a simulation's",
    "inertial": "masses do not affect a motion",
    "2 compiler": "MuJoCo merges repeated sections",
    "2 contact": "MuJoCo merges repeated sections",
    "2 exclude": "the same pair again",
    "2 joint.axis": "a direction has no length",
    "2 body.quat": "a rotation has no length",
}
HARMLESS = {
    "URDF, loaded": URDF_HARMLESS | {"<link name='upper'> > <collision name='case'>": "listed in `ignored_geoms`"},
    "URDF, imported": {key: why for key, why in URDF_HARMLESS.items() if key != "inertial"}
    | {"collision.name": "a name"}
    | {f"<joint name='{name}'> > <limit>": "the joint is fixed" for name in ("g1", "g2")},
    "MJCF arm": MJCF_HARMLESS,
    "MJCF arm, imported": {key: why for key, why in MJCF_HARMLESS.items() if key != "inertial"},
    "MJCF cell": MJCF_HARMLESS
    | {"mujoco.model": "a name", "<worldbody> > <body name='fence'> > <geom name='sign'>": "a shape without contacts"},
    "SRDF": {
        "group": "of a planner", "group_state": "a named configuration of a planner", "virtual_joint": "of a planner",
        "disable_collisions.reason": "a remark",
    },
    "OBJ": {
        r"^(?:vt|vn|usemtl|mtllib|s|o|g)\b.*\n": "pictures, normals and names", r"#.*": "a remark",
        r"(?<=[ \d])/[^ \n]*": "the picture's and the normal's number of a corner",
        r"^(v( \S+){3}) .*": "a vertex's weight, of curves, or its colour",
        r"^v 1 0\.7 0\.1\n(?=v 1 0\.7 0\.1\n)": "the last vertex again: no face uses it",
    },
    "STL": {r"(?<=solid) .*": "a name", r"^ *facet normal \S+ \S+ \S+$": "a normal follows from the corners"},
    "PLY": {r"^comment.*": "a remark"},
    "PLY cloud": {
        r"^((\S+ ){3})\S+ \S+ \S+ \S+$": "a point's normal and colour",
        r"^property \S+ (?![xyz]$)\S+$": "a point's normal and colour, and numbers of the user",
    },
    "path": {r"(?<=\[mm)\]": "the unit is known without the closing bracket"},
    "path with quaternions": {
        r"^[\d.]+(?=(?: \S+){7}$)|(?<=# )\S*timestam\S* |^timestamp (?=# )": "a time: speeds are planned anew",
        r" 0 0 0 [\d.]+$": "a rotation has no length",
        r"^#.*\n(?=#)": "the same remark again",
    },
    "motion table": {r",\d+$": "a column that is not used, which a note names"},
    "trajectory message": {},
    "key frames": {},
    "RAPID": {
        r"(?<=,)\w*(?:v\d+|tool0)\w*(?=[,\\])|(?<=,)\w+(?=;)|(?<=,)\w*z10?\w*(?=,)": "names of speeds, tools and zones",
        r"^SetDO.*$": "an instruction that does not move, which a note names",
        r"(?<=PROC )\w+(?=\(\))|(?<=MODULE )\w+$": "names",
        r"^CONST.*\n": "a constant may stand anywhere before its use",
    },
    "KRL": {
        r"^&.*$": "a header line, which the editor uses",
        r"^\$(?:VEL_AXIS|OUT).*$|^BAS.*$": "a statement that does not move, which a note names",
        r"(?<=DEF )\w+(?=\()": "a name",
        r"^DECL.*\n": "a declaration without a value",
        r"(?<=CPTP=)\d+": "a number, which may also be shorter",
    },
    "LS": {
        r"^/ATTR\n|(?<=/PROG ).*": "names and attributes",
        r"^ *\d+(?=:)": "the number of a line",
        r"^.*DO\[.*$": "an instruction that does not move, which a note names",
        r"^ UF.*$": "frame and tool, which joint positions do not depend on",
        r"(?<=J P\[1\] )\d+%": "the speed to the first position",
        r"(?<=CNT)\d+": "a number without a published distance",
    },
    "APT": {
        r"^PARTNO.*$|^FINI$": "a text, and the end",
        r"^COOLNT.*$": "a record that does not move, which a note names",
        r"^FROM.*\n": "a position that a rapid leaves",
        r"(?<=[/,])[\d.]+": "a number, which may also be shorter",
        r"(?<=\$).*$": "what follows the sign of continuation",
        r"^FEDRAT.*\n": "a feed may be stated anywhere before its move; tests/test_apt.py reads feeds",
        r"^((?:UNITS|RAPID).*\n)\1+": "what holds until it changes may be repeated",
    },
    "URScript": {
        r"(?<=^movej\(home, )[\d., ]*(?=\)$)": "an acceleration and a velocity",
        r"(?<=def )\w+(?=\()": "a name",
        r"^set_digital_out\(.*\)$": "a command that does not move, which a note names",
        r"t=[\d.]+|(?<=servoj\(\[)[\d.]+": "a number, which may also be shorter",
    },
    "INFORM": {
        r"^//NAME.*\n|^/JOB.*\n|^//POS.*\n|^///(?:TOOL|NPOS|POSTYPE).*\n|^NOP.*\n": "names, heads and counts",
        r"^///(?:DATE|ATTR|GROUP1).*\n": "attributes of the job",
        r"^C\d+=.*\n(?=(?:C|//INST))": "positions are found by their numbers",
        r"(?<=MOVJ C0000)\d*": "a number without zeros",
        r"^DOUT.*$": "an instruction that does not move, which a note names",
        r"VJ=[\d.]+|PL=\d?": "speeds, and the level of the last position",
    },
    "joint limits": {"default_velocity_scaling_factor": "speeds are the user's"},
    "job": {},
}  # fmt: skip
