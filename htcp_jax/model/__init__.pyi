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
    scenario_setup,
    surface,
    task,
    task_rows,
    workpiece,
)
from .convex_piece import BodyPieces, ConvexPiece
from .fixture import Fixture
from .path_frames import ONE_POINT_M, PathFrames
from .robot import Robot
from .scenario import Scenario
from .task import Task
from .workpiece import Workpiece

__all__ = [
    "ONE_POINT_M",
    "BodyPieces",
    "ConvexPiece",
    "Fixture",
    "PathFrames",
    "Robot",
    "Scenario",
    "Task",
    "Workpiece",
    "arrays",
    "convex_piece",
    "duct",
    "fixture",
    "goals",
    "inverse_kinematics",
    "kinematics",
    "mesh_points",
    "robot",
    "rotations",
    "row_bounds",
    "scenario",
    "scenario_setup",
    "surface",
    "task",
    "task_rows",
    "workpiece",
]
