from . import (
    arrays,
    convex_piece,
    duct,
    fixture,
    goals,
    inverse_kinematics,
    kinematics,
    mesh_points,
    robot,
    rotations,
    row_bounds,
    scenario,
    surface,
    task,
    task_list,
    task_rows,
    tool,
    workpiece,
)
from .convex_piece import BodyPieces, ConvexPiece
from .fixture import Fixture
from .path_frames import ONE_POINT_M, PathFrames
from .robot import Robot
from .scenario import Scenario
from .task import Task
from .task_list import TASK_ROWS, TCP_ON_PATH, AxisRow, BuiltInRow, OrientationRow, PointRow, path_row
from .task_row_kind import TaskRowKind
from .tool import Tool
from .workpiece import Workpiece

__all__ = [
    "ONE_POINT_M",
    "TASK_ROWS",
    "TCP_ON_PATH",
    "AxisRow",
    "BodyPieces",
    "BuiltInRow",
    "ConvexPiece",
    "Fixture",
    "OrientationRow",
    "PathFrames",
    "PointRow",
    "Robot",
    "Scenario",
    "Task",
    "TaskRowKind",
    "Tool",
    "Workpiece",
    "arrays",
    "convex_piece",
    "duct",
    "fixture",
    "goals",
    "inverse_kinematics",
    "kinematics",
    "mesh_points",
    "path_row",
    "robot",
    "rotations",
    "row_bounds",
    "scenario",
    "surface",
    "task",
    "task_list",
    "task_rows",
    "tool",
    "workpiece",
]
