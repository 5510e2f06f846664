from . import arrays, duct, fixture, kinematics, robot, scenario, surface
from .convex_piece import BodyPieces, ConvexPiece, body_pieces, make_piece, stack_pieces
from .coupling import Coupling, LimitArrays, coordinate_limits, joints_between, moved_by
from .fillet_plates import with_plates
from .fixture import Fixture
from .goals import RowError, check_constant_angles, follower_position, task_of, tool_angles_at, with_goals
from .inverse_kinematics import damped_step, reanchor, within_limits
from .mesh_points import NearbyBody, PointCover, cover_mesh, denser_spacing, thinnest_nearby
from .path_frames import ONE_POINT_M, PathFrames
from .robot import Robot
from .rotations import axis_angle_matrix, quaternion_matrix, sine_error
from .row_bounds import FeatureMotion, Region, RowSlack
from .scenario import NOT_REFUSED, Scenario
from .scenario_setup import (
    beyond_reach,
    interior_plane_of,
    interior_rule,
    make_scenario,
    make_scenarios,
    place_of,
    start_and_home,
    tcp_at,
    with_own_tool,
)
from .task import TCP_POSITION, Task, TaskLinear, feature_at
from .task_rows import Feature, Row, TaskPoint
from .workpiece import InletDirection, Workpiece, median_distance

__all__ = [
    "NOT_REFUSED",
    "ONE_POINT_M",
    "TCP_POSITION",
    "BodyPieces",
    "ConvexPiece",
    "Coupling",
    "Feature",
    "FeatureMotion",
    "Fixture",
    "InletDirection",
    "LimitArrays",
    "NearbyBody",
    "PathFrames",
    "PointCover",
    "Region",
    "Robot",
    "Row",
    "RowError",
    "RowSlack",
    "Scenario",
    "Task",
    "TaskLinear",
    "TaskPoint",
    "Workpiece",
    "arrays",
    "axis_angle_matrix",
    "beyond_reach",
    "body_pieces",
    "check_constant_angles",
    "coordinate_limits",
    "cover_mesh",
    "damped_step",
    "denser_spacing",
    "duct",
    "feature_at",
    "fixture",
    "follower_position",
    "interior_plane_of",
    "interior_rule",
    "joints_between",
    "kinematics",
    "make_piece",
    "make_scenario",
    "make_scenarios",
    "median_distance",
    "moved_by",
    "place_of",
    "quaternion_matrix",
    "reanchor",
    "robot",
    "scenario",
    "sine_error",
    "stack_pieces",
    "start_and_home",
    "surface",
    "task_of",
    "tcp_at",
    "thinnest_nearby",
    "tool_angles_at",
    "with_goals",
    "with_own_tool",
    "with_plates",
    "within_limits",
]
