"""Limits on the joints' velocity, acceleration and jerk."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.motions import values_per_joint
from htcp_jax.io.robots import RATES, JointLimits
from htcp_jax.model import Robot
from htcp_jax.spec import config


class MotionLimits(NamedTuple):
    """Velocity, acceleration and jerk limits of N joints, equal in both directions."""

    velocity: Float[np.ndarray, "N"]  # [rad/s or m/s]
    acceleration: Float[np.ndarray, "N"]  # [rad/s2 or m/s2]
    jerk: Float[np.ndarray, "N"]  # [rad/s3 or m/s3]

    def shares(
        self,
        velocity: Float[np.ndarray, "n N"],
        acceleration: Float[np.ndarray, "n N"],
        jerk: Float[np.ndarray, "n N"],
    ) -> Float[np.ndarray, "n M"]:
        """Return the factor by which time must be stretched to satisfy each of the M = 3 N limits, joint by joint.

        A factor is at most 1 if the limit is already satisfied.

        Args:
            velocity: Joint velocities at n instants [rad/s or m/s].
            acceleration: Joint accelerations at n instants [rad/s2 or m/s2].
            jerk: Joint jerks at n instants [rad/s3 or m/s3].
        """
        v, a, j = np.abs(velocity), np.abs(acceleration), np.abs(jerk)
        found = [v / self.velocity, np.sqrt(a / self.acceleration), np.cbrt(j / self.jerk)]
        return np.stack(found, axis=2).reshape(len(v), -1)


def joint_limits(
    robot: Robot, job: config.ProgramConfig | None = None, stated: JointLimits | None = None
) -> MotionLimits:
    """Return the limits of an arm.

    Limits in the job's section `program` take precedence over a file's, and those over the model's. The default
    acceleration limit reaches full speed in `job.full_speed_s`, the default jerk limit reaches full acceleration in
    `job.full_acceleration_s`.

    Args:
        robot: The arm.
        job: Section `program` of the job; None: the default section.
        stated: Limits in the file that the job's `robot.limits` names, see `limits_of_job`; None: no file.

    Raises:
        InputError: If a joint has no velocity limit, or if a list in the job has not one value per joint.
    """
    job = config.ProgramConfig() if job is None else job
    given = {kind: values_per_joint(robot, f"program.{kind}", getattr(job, kind)) for kind in RATES}
    own = own_rates(robot, stated)
    velocity = _given_or(given["velocity"], own["velocity"])
    for name, speed in zip(robot.joint_names, velocity, strict=True):
        if not 0 < speed < np.inf:
            raise InputError(
                f"{robot.name} has no velocity limit for joint {name}; set program.velocity, with one value per joint"
            )
    default = np.where(np.isfinite(own["acceleration"]), own["acceleration"], velocity / job.full_speed_s)
    acceleration = _given_or(given["acceleration"], default)
    default = np.where(np.isfinite(own["jerk"]), own["jerk"], acceleration / job.full_acceleration_s)
    return MotionLimits(velocity, acceleration, _given_or(given["jerk"], default))


def stated_limits(
    robot: Robot, job: config.ProgramConfig | None = None, stated: JointLimits | None = None
) -> MotionLimits:
    """Return the limits that a job, its file of limits or the robot's model states; infinite where none does.

    Args:
        robot: The arm.
        job: Section `program` of the job; None: no job.
        stated: Limits in the file that the job's `robot.limits` names, see `limits_of_job`; None: no file.

    Raises:
        InputError: If a list in the job has not one value per joint.
    """
    own = own_rates(robot, stated)
    given = {kind: values_per_joint(robot, f"program.{kind}", getattr(job, kind, None)) for kind in RATES}
    return MotionLimits(*(_given_or(given[kind], own[kind]) for kind in ("velocity", "acceleration", "jerk")))


def own_rates(robot: Robot, *stated: JointLimits | None) -> dict[str, Float[np.ndarray, "N"]]:
    """Return the limits of the coordinates by kind [rad or m, per s, s2 or s3]; infinite without one.

    Each joint has the limits in the last file that states them, else the model's. A coordinate's limit is the largest
    at which all joints that it moves keep theirs.

    Args:
        robot: The arm.
        *stated: Limits of the joints in files; None: no file.
    """
    own = robot if robot.coupling is None else robot.coupling
    found = {"velocity": own.speed, "acceleration": own.acceleration, "jerk": np.full(len(robot.slides), np.inf)}
    for kind in RATES:
        for given in (file.rates(kind) for file in stated if file is not None):
            found[kind] = np.where(np.isnan(given), found[kind], given)
    return {kind: _of_coordinates(robot, np.asarray(found[kind], float)) for kind in RATES}


def _of_coordinates(robot: Robot, limits: Float[np.ndarray, "J"]) -> Float[np.ndarray, "N"]:
    """Return the limits of the coordinates' rates, from those of the joints' rates."""
    if robot.coupling is None:
        return limits
    size = np.abs(np.asarray(robot.coupling.factors))
    return np.where(size > 0, limits[:, None] / np.where(size > 0, size, 1.0), np.inf).min(axis=0)


def _given_or(given: np.ndarray | None, otherwise: np.ndarray) -> np.ndarray:
    return otherwise if given is None else given
