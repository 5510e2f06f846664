from . import capsule_fit, close_fit
from .attached import AttachedBody, attach
from .chain import chain_of_file
from .clear_share import CheckedArm, ClearShares, check_arm
from .composed import indexed_joints, read_model
from .fixed_joints import fix_joints
from .frames import frame
from .joint_limits import LIMIT_ROUNDING, RATES, JointLimits, read_joint_limits
from .link_meshes import LinkMeshes
from .loading import gp50, load_robot, part_moves
from .mjcf import Listed, arm_xml, fixed_text, follower_text, shapes_label
from .model_file import joints_in_file
from .mujoco_models import body_name, compile_spec, delete_all, joint_name, massive_bodies
from .safe_xml import model_files
from .tool_mesh import bare_length_m, import_tool, pose_along
from .vendor_import import ImportedArm, chain_text, import_robot

__all__ = [
    "LIMIT_ROUNDING",
    "RATES",
    "AttachedBody",
    "CheckedArm",
    "ClearShares",
    "ImportedArm",
    "JointLimits",
    "LinkMeshes",
    "Listed",
    "arm_xml",
    "attach",
    "bare_length_m",
    "body_name",
    "capsule_fit",
    "chain_of_file",
    "chain_text",
    "check_arm",
    "close_fit",
    "compile_spec",
    "delete_all",
    "fix_joints",
    "fixed_text",
    "follower_text",
    "frame",
    "gp50",
    "import_robot",
    "import_tool",
    "indexed_joints",
    "joint_name",
    "joints_in_file",
    "load_robot",
    "massive_bodies",
    "model_files",
    "part_moves",
    "pose_along",
    "read_joint_limits",
    "read_model",
    "shapes_label",
]
