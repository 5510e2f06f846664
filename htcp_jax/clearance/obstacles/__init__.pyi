from . import self_exclusions
from .contact_model import ContactModel, hold_contacts, predict_distances
from .given_obstacle import given_obstacles, with_given
from .linearisation import Linearisation, TaskRows, linearise
from .narrow_phase import CLOSE_M
from .obstacle import THE_WORKPIECE, Contacts, grouped
from .obstacles import surely_collides
from .of_cell import PlacedCloud, make_fixtures, placed_cloud
from .of_workpiece import KEEP_OUT, all_obstacles, with_interior
from .self_collision import RefusedPair, SelfCollision, make_self_collision, refused_pair
from .tip_guard import NearWalls, TipGuard, make_tip_guard

__all__ = [
    "CLOSE_M",
    "KEEP_OUT",
    "THE_WORKPIECE",
    "ContactModel",
    "Contacts",
    "Linearisation",
    "NearWalls",
    "PlacedCloud",
    "RefusedPair",
    "SelfCollision",
    "TaskRows",
    "TipGuard",
    "all_obstacles",
    "given_obstacles",
    "grouped",
    "hold_contacts",
    "linearise",
    "make_fixtures",
    "make_self_collision",
    "make_tip_guard",
    "placed_cloud",
    "predict_distances",
    "refused_pair",
    "self_exclusions",
    "surely_collides",
    "with_given",
    "with_interior",
]
