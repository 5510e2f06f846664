"""Parts that the programs of robots with six axes share: RAPID, KRL and LS."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import ControllerData
from htcp_jax.trajectory.timed_motion import TimedMotion

ROBOT_AXES = 6
ANGLES = "ABCWPR"  # order in which a controller lists its angles
SLOWEST = 1e-9  # largest velocity at which the arm counts as at rest [rad/s or m/s]


def check_robot(format: str, timed: TimedMotion, controller: ControllerData, needed: str, reason: str = "") -> None:
    """Check that the group of the robot has six joints, all of them hinges.

    Args:
        format: Name of the format.
        timed: Samples in the file, for the names of the joints.
        controller: The controller data.
        needed: End of the message about another number of joints.
        reason: End of the message about a slide.

    Raises:
        InputError: For another number of joints, and for a slide.
    """
    robot = controller.joint_groups.robot
    if len(robot) != ROBOT_AXES:
        raise InputError(f"{format}: a robot of {len(robot)} joints; {needed}")
    if sliding := [timed.joint_names[k] for k in robot if controller.slides[k]]:
        raise InputError(f"{format}: {sliding[0]} is a slide joint; put it into program.groups.base{reason}")


def at_rest(velocity: Float[np.ndarray, "n N"]) -> Bool[np.ndarray, "n"]:
    """Return True for rows at which the arm is at rest."""
    return np.abs(velocity).max(axis=1, initial=0.0) <= SLOWEST


def exact_rows(timed: TimedMotion, controller: ControllerData) -> Bool[np.ndarray, "n"]:
    """Return True for rows that the arm reaches exactly: where it stops, where no corner is blended, at outputs."""
    exact = at_rest(timed.velocity)
    if timed.blended is not None:
        exact |= timed.blended <= 0
    exact[[0, -1, *controller.rows_with_outputs]] = True
    return exact


def section_names(timed: TimedMotion) -> list[str]:
    """Return for each row the name of the section that begins with the move to it: process or air move; else ""."""
    names = np.where(timed.is_process, "process", "air move").tolist()
    return ["", *(name if k == 1 or name != names[k - 1] else "" for k, name in enumerate(names[1:], start=1))]


def tcp_sentences(controller: ControllerData, tool: str, angles: str) -> list[str]:
    """Return a sentence with the pose of the planned TCP, which a tool of the controller must have.

    Args:
        controller: The controller data; without its TCP there is no sentence.
        tool: The controller's name of its tool.
        angles: The controller's names of the rotations about z, then the new y, then the new x.
    """
    if (tcp := controller.tcp) is None:
        return []
    x, y, z = (np.round(1e3 * tcp.T_frame_tcp[:3, 3], 3) + 0.0).tolist()
    turns = Rotation.from_matrix(tcp.T_frame_tcp[:3, :3]).as_euler("ZYX", degrees=True)
    named = dict(zip(angles, (np.round(turns, 3) + 0.0).tolist(), strict=True))
    about = ", ".join(f"{name} {named[name]:.3f}" for name in sorted(angles, key=ANGLES.index))
    return [
        f"The planned TCP is at X {x:.3f}, Y {y:.3f}, Z {z:.3f} mm, {about} degrees in the frame of {tcp.frame}; "
        f"{tool} must have it."
    ]
