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
from .obstacles.obstacles import ClearanceRows, clearances, contacts, contacts_of_each, is_clear, minimum_clearance

__all__ = [
    "ClearanceRows",
    "HasWorkpiecePose",
    "Obstacle",
    "Obstacles",
    "Scene",
    "by_pieces",
    "clearances",
    "contacts",
    "contacts_of_each",
    "in_workpiece",
    "is_clear",
    "minimum_clearance",
    "own_scene",
    "rows_of",
    "surface_points",
]
