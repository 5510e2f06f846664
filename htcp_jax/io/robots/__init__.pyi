from . import capsule_fit, close_fit, composed, mjcf, model_file, safe_xml
from .attached import AttachedBody, attach
from .chain import chain_of_file
from .fixed_joints import fix_joints
from .joint_limits import LIMIT_ROUNDING, RATES, JointLimits, read_joint_limits
from .link_meshes import LinkMeshes
from .loading import gp50, load_robot, part_moves
from .mujoco_models import body_name, compile_spec, delete_all, joint_name, massive_bodies
from .vendor_import import ImportedArm, chain_text, import_robot

__all__ = [
    "LIMIT_ROUNDING",
    "RATES",
    "AttachedBody",
    "ImportedArm",
    "JointLimits",
    "LinkMeshes",
    "attach",
    "body_name",
    "capsule_fit",
    "chain_of_file",
    "chain_text",
    "close_fit",
    "compile_spec",
    "composed",
    "delete_all",
    "fix_joints",
    "gp50",
    "import_robot",
    "joint_name",
    "load_robot",
    "massive_bodies",
    "mjcf",
    "model_file",
    "part_moves",
    "read_joint_limits",
    "safe_xml",
]
