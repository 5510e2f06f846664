from . import (
    contact_model,
    given_obstacle,
    linearisation,
    of_workpiece,
    self_collision,
    self_exclusions,
    tip_guard,
)
from .given_obstacle import given_obstacles
from .of_cell import PlacedCloud, make_fixtures, placed_cloud
from .self_collision import make_self_collision

__all__ = [
    "PlacedCloud",
    "contact_model",
    "given_obstacle",
    "given_obstacles",
    "linearisation",
    "make_fixtures",
    "make_self_collision",
    "of_workpiece",
    "placed_cloud",
    "self_collision",
    "self_exclusions",
    "tip_guard",
]
