from . import (
    contact_model,
    given_obstacle,
    linearisation,
    of_cell,
    of_workpiece,
    self_collision,
    self_exclusions,
    tip_guard,
)

__all__ = [
    "contact_model",
    "given_obstacle",
    "linearisation",
    "of_cell",
    "of_workpiece",
    "self_collision",
    "self_exclusions",
    "tip_guard",
]
