from . import attached, capsule_fit, close_fit, composed, joint_limits, mjcf, model_file, model_source, safe_xml
from .link_meshes import LinkMeshes
from .loading import gp50, load_robot, part_moves
from .vendor_import import ImportedArm, body_name, chain_text, import_robot

__all__ = [
    "ImportedArm",
    "LinkMeshes",
    "attached",
    "body_name",
    "capsule_fit",
    "chain_text",
    "close_fit",
    "composed",
    "gp50",
    "import_robot",
    "joint_limits",
    "load_robot",
    "mjcf",
    "model_file",
    "model_source",
    "part_moves",
    "safe_xml",
]
