from .obstacles.obstacle import (
    HasWorkpiecePose,
    Obstacle,
    Obstacles,
    Scene,
    by_pieces,
    in_workpiece,
    own_scene,
    rows_of,
    surface_points,
)
from .obstacles.obstacles import ClearanceRows, clearances, contacts, is_clear, minimum_clearance, nearest_to

__all__ = [
    "ClearanceRows",
    "HasWorkpiecePose",
    "Obstacle",
    "Obstacles",
    "Scene",
    "by_pieces",
    "clearances",
    "contacts",
    "in_workpiece",
    "is_clear",
    "minimum_clearance",
    "nearest_to",
    "own_scene",
    "rows_of",
    "surface_points",
]
