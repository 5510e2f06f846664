"""Replays of motions in files: the motion is displayed like a plan, whose targets are the TCP's positions."""

from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans, start_cause
from htcp_jax.proving import FileProof
from htcp_jax.spec import PlanConfig
from htcp_jax.status import SegmentStatus, Status
from htcp_jax.trajectory import tcp_at
from htcp_jax.viewer.replay import Replays, replays_of

BETWEEN = 4  # displayed configurations between the ends of a curved segment
METHOD = "file"  # in place of the planning method's name


class _PlayedFile(NamedTuple):
    """A motion as `replay.PlannedJob` requires it."""

    job: PlanConfig
    robot: Robot
    workpiece: Workpiece
    scenario: Scenario
    plans: Plans


def replays_of_file(found: FileProof) -> Replays:
    """Return the replays of a file's motion; each row has the clearance there and the verdict on the segment to it.

    Args:
        found: The proof of the file.

    Raises:
        InputError: If the file has only poses, or the job has no part.
    """
    scene, motion = found.scene, found.motion
    if found.proof is None or found.curves is None:
        raise InputError(f"{found.file} has poses only; a file with joint values can be played")
    if scene.job is None or not scene.has_part:
        raise InputError(f"{found.file} cannot be played, as the job has no section workpiece")
    between = 0 if motion.interpolation == "linear" else BETWEEN
    x, verdict, bound = [motion.x[:1]], [int(SegmentStatus.VALID)], [np.nan]
    for k, status in enumerate(found.proof.verdict.tolist()):
        if between:
            share = np.arange(1, between + 1) / (between + 1)
            x.append(np.polynomial.polynomial.polyval(share, found.curves.coefficients[k]).T)
        x.append(motion.x[k + 1 : k + 2])
        verdict += [status] * (between + 1)
        bound += [float(found.proof.clearance_m[k])] * (between + 1)
    rows = np.concatenate(x)
    problem = scene.problem
    scenario = jax.tree.map(lambda leaf: leaf[0], problem.scenarios)
    tcp = tcp_at(robots.lengthen_tool(problem.robot, float(scenario.tool_extension_m)), rows)[0]
    plans = Plans.empty(rows[:1], tcp[None])
    for name, values in {
        "x": rows,
        "tcp": tcp,
        "status": int(Status.TRACKED),
        "clearance": start_cause.clearances_at(problem, rows),
        "residual": 0.0,
        "joint_step": np.append(0.0, np.linalg.norm(np.diff(rows, axis=0), axis=1)),
        "segment_status": verdict,
        "segment_clearance": bound,
    }.items():
        getattr(plans, name)[0] = values
    job = scene.job.model_copy(update={"method": METHOD, "start_rad": "auto"})  # without targets before the path
    return replays_of(found.file.name, _PlayedFile(job, problem.robot, problem.workpiece, scenario, plans))
