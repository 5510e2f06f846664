from . import capsule_fit, close_fit, composed, mjcf, model_file, safe_xml
from .attached import AttachedBody, attach
from .joint_limits import LIMIT_ROUNDING, RATES, JointLimits, read_joint_limits
from .link_meshes import LinkMeshes
from .loading import gp50, load_robot, part_moves
from .vendor_import import ImportedArm, body_name, chain_text, import_robot

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
    "chain_text",
    "close_fit",
    "composed",
    "gp50",
    "import_robot",
    "load_robot",
    "mjcf",
    "model_file",
    "part_moves",
    "read_joint_limits",
    "safe_xml",
]
