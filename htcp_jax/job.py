"""From a configuration to what it speaks of: the robot, the workpiece, the scenario. All raise InputError."""

from typing import Literal

from htcp_jax.config import PlanConfig, RobotConfig, WorkpieceConfig
from htcp_jax.robot import GP50, Robot, load_robot
from htcp_jax.scenario import Scenario, make_scenario
from htcp_jax.workpiece import Workpiece, load_workpiece


def scene(job: PlanConfig) -> tuple[Robot, Workpiece, Scenario]:
    """The robot, the workpiece and the one scenario of a configuration."""
    robot, workpiece = robot_of(job.robot), workpiece_of(job.workpiece)
    return robot, workpiece, scenario_of(job, robot, workpiece)


def robot_of(arm: RobotConfig) -> Robot:
    """The robot, without the tool's extension: that belongs to the scenario."""
    return load_robot(GP50 if arm.model == "gp50" else arm.model, limits=arm.limits)


def workpiece_of(part: WorkpieceConfig) -> Workpiece:
    """The workpiece, without its pose: that belongs to the scenario."""
    return load_workpiece(
        None if part.cloud == "duct" else part.cloud,
        None if part.path == "weld" else part.path,
        inlet="auto" if part.inlet_m is None else part.inlet_m,
        interior=part.interior,
        gate_depth_m=part.gate_depth_m,
        pivot=part.pivot_m,
        neutral_translation=part.neutral_translation_m,
    )


def scenario_of(
    job: PlanConfig,
    robot: Robot,
    workpiece: Workpiece,
    number: int = 0,
    beyond_reach: Literal["raise", "record"] = "raise",
) -> Scenario:
    """Start, pose, targets, margin and tool of a configuration; `number` is its identity for the random keys;
    beyond_reach: see `make_scenario`."""
    part = job.workpiece
    return make_scenario(
        robot,
        workpiece,
        job.start_rad,
        rotation=(part.rotation_y_rad, part.rotation_z_rad),
        shift=part.shift_m,
        approach=(part.approach_to_inlet, part.approach_to_path),
        margin_m=job.margin_m,
        tool_extension_m=job.robot.tool_extension_m,
        number=number,
        beyond_reach=beyond_reach,
    )
