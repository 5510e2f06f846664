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
from .obstacles.obstacles import ClearanceRows, clearance, clearances, contacts, is_clear, nearest_to

__all__ = [
    "ClearanceRows",
    "HasWorkpiecePose",
    "Obstacle",
    "Obstacles",
    "Scene",
    "by_pieces",
    "clearance",
    "clearances",
    "contacts",
    "in_workpiece",
    "is_clear",
    "nearest_to",
    "own_scene",
    "rows_of",
    "surface_points",
]
