from . import (
    capsule_fit,
    cell,
    duct_seams,
    files,
    robot_file,
    robot_import,
    robot_model,
    robot_xml,
    safe_xml,
    strict_model,
    strict_yaml,
    units,
    workpiece_file,
)
from .link_meshes import LinkMeshes
from .point_cloud import load_geometry

__all__ = [
    "LinkMeshes",
    "capsule_fit",
    "cell",
    "duct_seams",
    "files",
    "load_geometry",
    "robot_file",
    "robot_import",
    "robot_model",
    "robot_xml",
    "safe_xml",
    "strict_model",
    "strict_yaml",
    "units",
    "workpiece_file",
]
