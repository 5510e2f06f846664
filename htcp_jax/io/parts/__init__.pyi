from .lengths import PER_METRE
from .path_file import PathPoints, has_feeds, read_path_points
from .point_cloud import load_geometry
from .units import check_cell_extent, check_tool, check_tool_extent
from .workpiece_source import (
    GeneratedDuct,
    NoCloud,
    PointCloud,
    TriangleMesh,
    WorkpieceSource,
    load_workpiece,
    read_source,
)

__all__ = [
    "PER_METRE",
    "GeneratedDuct",
    "NoCloud",
    "PathPoints",
    "PointCloud",
    "TriangleMesh",
    "WorkpieceSource",
    "check_cell_extent",
    "check_tool",
    "check_tool_extent",
    "has_feeds",
    "load_geometry",
    "load_workpiece",
    "read_path_points",
    "read_source",
]
