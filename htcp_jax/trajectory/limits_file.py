"""Joint limits from files: those that a job names, and those that `htcp program --limits` gets."""

from pathlib import Path

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots import LIMIT_ROUNDING, RATES, JointLimits, read_joint_limits
from htcp_jax.model import Robot, kinematics
from htcp_jax.motion import Motion, motion
from htcp_jax.spec import PlanConfig
from htcp_jax.status import Kind
from htcp_jax.trajectory.limits import own_rates


def limits_of_job(job: PlanConfig, robot: Robot) -> JointLimits | None:
    """Return the limits in the file that a job's `robot.limits` names; None if it names no file.

    Args:
        job: The job.
        robot: The job's robot.

    Raises:
        InputError: See `read_joint_limits`.
    """
    file = job.robot.limits_file
    return None if file is None else read_joint_limits(file, robot.all_joint_names, robot.name)


def limits_overrides(stated: JointLimits, robot: Robot, of_job: JointLimits | None = None) -> list[str]:
    """Return the velocity, acceleration and jerk limits in a file as overrides of a job's section `program`.

    A joint without a velocity or acceleration limit in the file gets the limit in the job's file, else the model's.

    Args:
        stated: The limits in the file.
        robot: The arm.
        of_job: The limits in the file that the job names; None: no file.

    Returns:
        Overrides such as "program.velocity=[...]", one for each kind of limit in the file.

    Raises:
        InputError: If the file limits some joints, but another joint has no such limit.
    """
    own, found = own_rates(robot, of_job, stated), []
    for kind in RATES:
        if np.isnan(stated.rates(kind)).all():
            continue
        values = own[kind]
        for name in (name for name, value in zip(robot.joint_names, values, strict=True) if not np.isfinite(value)):
            raise InputError(f"{stated.file}: max_{kind} of joint {name} is missing here and in the model")
        found.append(f"program.{kind}=[{', '.join(map(repr, values.tolist()))}]")
    return found


def check_ranges(stated: JointLimits, robot: Robot, moved: Motion | motion.Motions, name: str) -> None:
    """Check that the configurations of motions are within the ranges in a file; ends that it does not state are free.

    Args:
        stated: The limits in the file.
        robot: The motions' arm.
        moved: The motions.
        name: Name of the motions, for messages.

    Raises:
        InputError: If a joint is outside its range; the message has the joint that is farthest outside.
    """
    own, x = (np.asarray(robot.lower, float), np.asarray(robot.upper, float)), moved.x
    if robot.coupling is not None:
        farthest = kinematics.joint_travel(robot)
        own, x = (-farthest, farthest), robot.coupling.positions(x)
    lower, upper = stated.ranges(robot.slides, *own)
    lower = np.where([own.lower is None for own in stated.stated], -np.inf, lower)
    upper = np.where([own.upper is None for own in stated.stated], np.inf, upper)
    excess = np.maximum(lower - x, x - upper)
    if excess.max(initial=0.0) <= LIMIT_ROUNDING:
        return
    row, joint = map(int, np.unravel_index(excess.argmax(), excess.shape))
    value, limit = x[row, joint], (lower if x[row, joint] < lower[joint] else upper)[joint]
    digits = 3 if f"{value:.3g}" != f"{limit:.3g}" else 8
    others = [
        each for k, each in enumerate(robot.all_joint_names) if k != joint and excess[:, k].max() > LIMIT_ROUNDING
    ]
    also = f" ({', '.join(others)} beyond, too)" if others else ""
    scenario = f" of scenario {moved.scenario[row]}" if isinstance(moved, motion.Motions) else ""
    raise InputError(
        f"{name}: joint {robot.all_joint_names[joint]} reaches {value:.{digits}g} "
        f"{'m' if robot.slides[joint] else 'rad'} {_place(moved, row)}{scenario}, {stated.file} allows {limit:g}"
        f"{also}; set robot.limits to {Path(stated.file).name} in the job, and plan again"
    )


def _place(moved: Motion | motion.Motions, row: int) -> str:
    """Return the place of a motion's configuration as text."""
    kind, target = Kind(moved.kind[row]), int(moved.target[row])
    share = 1.0 if moved.span is None else moved.span[row, 1]
    if kind in (Kind.APPROACH, Kind.PROCESS, Kind.TRANSFER) and share == 1:
        return f"at target {target}"
    if kind == Kind.PROCESS:
        return f"on the segment to target {target}"
    return f"in the dwell at target {target}" if kind == Kind.DWELL else f"in the {kind.words}"
