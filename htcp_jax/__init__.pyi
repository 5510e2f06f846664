from .api import Plan, methods, plan
from .clearance.obstacles.linearisation import linearise
from .clearance.obstacles.obstacles import clearances, minimum_clearance
from .clearance.obstacles.of_workpiece import make_obstacle
from .errors import InputError
from .io.parts.workpiece_source import GeneratedDuct, NoCloud, PointCloud, TriangleMesh, load_workpiece
from .io.robots.loading import gp50, load_robot
from .model.arm_features import axis_of, point_of
from .model.inverse_kinematics import reanchor
from .model.kinematics import capsule_segments, jacobian, tcp_pose, tcp_position
from .model.robot import lengthen_tool
from .model.scenario_setup import make_scenario
from .motion.plans import Plans
from .motion.problem import Problem
from .numerics import capsule_point_distance, null_basis
from .placement.place import place
from .planning.extensions import register
from .planning.method import Method
from .planning.tracking.null_space import null_space_objective
from .proving.file_proof import FileProof, prove_file
from .proving.prove import MotionProof, prove
from .report import charts
from .report.reach_study import reach_study
from .report.report import chart, make_report
from .runs.run_folder import open_run
from .runs.sweep import sweep
from .settings import Settings
from .spec.obstacle_kind import ObstacleKind, ObstacleShape
from .spec.task_list import AxisRow, OrientationRow, PointRow
from .spec.task_row_kind import TaskRowKind
from .status import SegmentStatus, Status
from .trajectory.run_timing import time_run

__version__: str

__all__ = [
    "AxisRow",
    "FileProof",
    "GeneratedDuct",
    "InputError",
    "Method",
    "MotionProof",
    "NoCloud",
    "ObstacleKind",
    "ObstacleShape",
    "OrientationRow",
    "Plan",
    "Plans",
    "PointCloud",
    "PointRow",
    "Problem",
    "SegmentStatus",
    "Settings",
    "Status",
    "TaskRowKind",
    "TriangleMesh",
    "axis_of",
    "capsule_point_distance",
    "capsule_segments",
    "chart",
    "charts",
    "clearances",
    "gp50",
    "jacobian",
    "lengthen_tool",
    "linearise",
    "load_robot",
    "load_workpiece",
    "make_obstacle",
    "make_report",
    "make_scenario",
    "methods",
    "minimum_clearance",
    "null_basis",
    "null_space_objective",
    "open_run",
    "place",
    "plan",
    "point_of",
    "prove",
    "prove_file",
    "reach_study",
    "reanchor",
    "register",
    "sweep",
    "tcp_pose",
    "tcp_position",
    "time_run",
]
