"""Hand-made plan for display tests: the GP50 reaches towards a coarse duct, without running a planner."""

from pathlib import Path

import numpy as np
from hand_made import plans_with
from made_once import START, robot

from htcp_jax import api
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.jobs import load_config
from htcp_jax.model.duct import duct_cloud, weld
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Plans, ViaPoints
from htcp_jax.spec.config import PlanConfig
from htcp_jax.status import SegmentStatus, Status

A, E, LIMIT, NOT = Status.TRACKED, Status.TRACKED_AFTER_RECOVERY, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED
STATUSES = [A, A, A, A, A, A, E, A, LIMIT, NOT], [A] * 10  # of two scenarios: the first fails at target 8
END = (-0.05, -1.7, 0.3, -0.1, 0.25, -2.0)


def made_plan(folder: Path) -> api.Plan:
    """Plan of the first scenario; the files of its job are written into `folder`."""
    folder.mkdir(exist_ok=True)
    np.save(folder / "cloud.npy", duct_cloud(3000))
    np.savetxt(folder / "path.csv", weld()[::14], delimiter=",")
    steps = {"workpiece.approach_to_inlet": 1, "workpiece.approach_to_path": 1}
    files = {"workpiece.cloud": str(folder / "cloud.npy"), "workpiece.path": str(folder / "path.csv")}
    as_the_duct = {f"workpiece.{key}": value for key, value in PlanConfig().workpiece.model_dump().items()}
    own = {"workpiece.inlet_m": (0.0, 0.0, 0.19138), "method": "baseline"}
    job = load_config(None, as_the_duct | steps | files | own)
    workpiece = load_workpiece(folder / "cloud.npy", folder / "path.csv", inlet=(0.0, 0.0, 0.19138))
    scenario = make_scenario(robot(), workpiece, START, approach=(1, 1))
    return api.Plan(job, robot(), workpiece, scenario, made_plans(scenario.targets, STATUSES[:1]))


def made_plans(targets: np.ndarray, statuses: list[list[Status]]) -> Plans:
    """Plans that interpolate from START to END; scenario k ends at (1 - 0.02 k) of these configurations."""
    plans = plans_with([list(row) for row in statuses], joints=6)
    ends = [np.linspace(START, END, len(targets)) * (1 - 0.02 * k) for k in range(len(statuses))]
    x = np.where(np.isnan(plans.x), np.nan, np.stack(ends))
    return plans._replace(
        start=np.tile(START, (len(statuses), 1)),
        x=x,
        target=np.repeat(np.asarray(targets)[None], len(statuses), axis=0),
    )


def with_a_dwell(plans: Plans) -> Plans:
    """Plans with proven motions to targets 0 to 6, a wrist turn at target 4 and a small clearance before target 5."""
    turning = np.stack([plans.x[:, 4] + turn * np.eye(6)[3] for turn in (0.2, 0.5)], axis=1)
    target = np.broadcast_to(np.arange(plans.segment_status.shape[1]), plans.segment_status.shape)
    segment_status = np.where(target < 7, SegmentStatus.VALID, SegmentStatus.NOT_CHECKED).astype(np.int8)
    clear = np.where(segment_status == SegmentStatus.VALID, np.where(target == 5, 2e-4, 3e-3), np.nan)
    via_points = ViaPoints.of([(s, 5, x) for s, x in enumerate(turning)], 6)
    return plans._replace(segment_status=segment_status, segment_clearance=clear, via_points=via_points)


def driven(plans: Plans) -> Plans:
    """Plans with proven motions to all tracked targets."""
    segment_status = np.where(plans.tracked, SegmentStatus.VALID, SegmentStatus.NOT_CHECKED).astype(np.int8)
    clear = np.where(plans.tracked, 3e-3, np.nan)
    return plans._replace(
        segment_status=segment_status, segment_clearance=clear, residual=np.where(plans.tracked, 1e-4, np.nan)
    )
