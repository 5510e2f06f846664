"""Values of a job that depend on its robot's file, which is read after the job."""

from dataclasses import replace
from pathlib import Path

from htcp_jax.errors import InputError
from htcp_jax.jobs.seam_keys import with_keys_of_only_seam
from htcp_jax.jobs.seam_paths import feeds_of_files, with_seams_of_files
from htcp_jax.model import Robot
from htcp_jax.spec import PlanConfig


def resolve(job: PlanConfig, robot: Robot, source: str = "the configuration") -> PlanConfig:
    """Return the job with the weights of all joints, and all seams of its files, see `with_weights` and `with_seams`.

    Args:
        job: The job.
        robot: The robot from `build.robot_of`.
        source: Name of the job, for messages.

    Raises:
        InputError: See `check_start` and `with_seams_of_files`.
    """
    check_start(job, robot, source)
    return with_seams(with_weights(job, len(robot.joint_names)))


def with_seams(job: PlanConfig) -> PlanConfig:
    """Return the job with one entry in `workpiece.seams` for each seam in its files, see `with_seams_of_files`.

    Feeds in these files apply if neither the job nor the seam states one. If there is only one seam, its own task,
    margin and feed become the job's.
    """
    part = with_seams_of_files(job.workpiece)
    job = job if part is job.workpiece else job.model_copy(update={"workpiece": part})
    feeds = [] if job.program.feed is not None else feeds_of_files(part)
    if part.seams and any(feeds):
        pairs = zip(part.seams, feeds, strict=True)
        seams = tuple(seam.model_copy(update={"feed": feed}) if seam.feed is None else seam for seam, feed in pairs)
        job = job.model_copy(update={"workpiece": part.model_copy(update={"seams": seams})})
    elif any(feeds):
        job = job.model_copy(update={"program": job.program.model_copy(update={"feed": feeds[0]})})
    return with_keys_of_only_seam(job)


def check_start(job: PlanConfig, robot: Robot, source: str) -> None:
    """Check that a job has a start.

    Args:
        job: The job.
        robot: Its robot.
        source: Name of the job, for messages.

    Raises:
        InputError: If the robot is not the GP50 and start_rad is missing.
    """
    if job.has_own_arm and job.start_rad == ():
        names = robot.joint_names
        raise InputError(
            f"{source}: robot.model is {Path(job.robot.model).name}, so start_rad must be given: "
            f"{len(names)} joint positions ({', '.join(names)}), or auto"
        )


def with_weights(job: PlanConfig, joints: int) -> PlanConfig:
    """Return the job with a weight of 1 for each joint if it has no weights and the robot is not the GP50.

    Args:
        job: The job.
        joints: Number of the robot's joints.
    """
    if job.settings.q_weights or not job.has_own_arm:
        return job
    return job.model_copy(update={"settings": replace(job.settings, q_weights=(1.0,) * joints)})
