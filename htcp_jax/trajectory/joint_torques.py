"""Joint torques of a timed motion, by inverse dynamics with the inertias in the arm's model.

Only inertias from URDF's and MJCF's `<inertial>` are used: none is estimated from shapes, and if a link has none the
torques are unknown. A tool mounted by the job has no mass. Gravity is 9.81 m/s2 downwards in the world. Damping and
armature are included if the model has them. MJX computes many configurations at once; a test compares it with MuJoCo.
"""

import contextlib
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.io.robots import model_file, safe_xml
from htcp_jax.jobs import config
from htcp_jax.model import tool
from htcp_jax.trajectory.timed_motion import TimedMotion

GRAVITY_M_S2 = 9.81
AT_ONCE = 1024  # configurations per call; more need memory and no less time. Rows are independent
TORQUES_EVERY_S = 0.01  # time step between samples
# XLA's fusion for CPUs recomputes the pose of each link for everything that depends on it: 10,000 times the work.
PLAIN = {"xla_cpu_use_fusion_emitters": False}
_OFF = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT


class PeakTorque(NamedTuple):
    """The largest torque, relative to the effort limits if there are any."""

    torque: float  # [N m or N]
    share: float  # of the joint's effort limit; 0 where it has none
    joint: str
    time_s: float


def model_of(arm: config.RobotConfig) -> mujoco.MjModel | None:
    """Load the arm of a job with its inertias; None if a link has none.

    Raises:
        InputError: For an unreadable file.
    """
    path = arm.file
    with model_file.no_log():
        spec = safe_xml.read_spec(path, contacts=True)
    for elements in spec.tuples, spec.excludes, spec.geoms, spec.meshes:  # MuJoCo deletes tuples with their geoms
        for each in list(elements):
            spec.delete(each)
    model = model_file.compile_spec(spec, path)
    model_file.fix_joints(model, path, dict(arm.locked))
    massive = {int(model.body_weldid[body.id]) for body in spec.bodies if body.explicitinertial and body.mass > 0}
    if not set(model.body_weldid[model.jnt_bodyid].tolist()) <= massive:
        return None
    model.opt.gravity = tool.pose(tool.ZERO, arm.base_rpy_rad)[:3, :3].T @ [0, 0, -GRAVITY_M_S2]
    model.opt.disableflags |= int(_OFF)
    return model


def torques(model: mujoco.MjModel, locked: Collection[str] = ()) -> Callable[..., Float[np.ndarray, "n N"]]:
    """Return a function from configurations, velocities and accelerations (n, N) to joint torques [N m or N].

    Args:
        model: See `model_of`.
        locked: Names of the joints that do not move.
    """
    with contextlib.redirect_stdout(None):  # its import prints messages about missing packages
        from mujoco import mjx
    device = mjx.put_model(model)
    fixed = [j for j in range(model.njnt) if model_file.joint_name(model, j) in locked]
    joints = np.array(model_file.chain_of_file(model, Path("model"), fixed).joints)  # in the robot's order
    still = np.array([model.qpos0, np.zeros(model.nv), np.zeros(model.nv)])
    blank = mjx.make_data(device)

    @partial(jax.jit, compiler_options=PLAIN)
    @jax.vmap
    def at(x, v, a):
        data = mjx.com_vel(device, mjx.com_pos(device, mjx.kinematics(device, blank.replace(qpos=x, qvel=v, qacc=a))))
        inertial = mjx.rne(device, data, flg_acc=True).qfrc_bias
        return inertial + device.dof_armature * a - mjx.passive(device, data).qfrc_passive

    def found(x: Float[np.ndarray, "n N"], v: Float[np.ndarray, "n N"], a: Float[np.ndarray, "n N"]) -> np.ndarray:
        torque = np.empty_like(x)
        with jax.numpy_rank_promotion("allow"):  # MJX has its own style
            for first in range(0, len(x), AT_ONCE):
                own = np.repeat(still[:, None], AT_ONCE, axis=1)
                for k, part in enumerate((x, v, a)):
                    own[k][:, joints] = np.resize(part[first : first + AT_ONCE], (AT_ONCE, x.shape[1]))
                torque[first : first + AT_ONCE] = np.asarray(at(*own))[: len(x) - first, joints]
        return torque

    return found


def peak_torque(timed: TimedMotion, torque: Float[np.ndarray, "n N"], effort: Float[np.ndarray, "N"]) -> PeakTorque:
    """Return the largest torque of one motion.

    Args:
        timed: Samples of the motion.
        torque: Joint torques at the samples [N m or N].
        effort: The joints' limits, inf without one [N m or N].
    """
    size = np.abs(torque)
    share = size / effort
    row, joint = np.unravel_index((share if share.any() else size).argmax(), size.shape)
    return PeakTorque(
        float(torque[row, joint]), float(share[row, joint]), timed.joint_names[joint], float(timed.time_s[row])
    )


def peak_torques(
    torque: Callable[..., Float[np.ndarray, "n N"]], motions: Sequence[TimedMotion], effort: Float[np.ndarray, "N"]
) -> list[PeakTorque]:
    """Return the largest torques of many motions of one arm, AT_ONCE configurations at a time.

    Args:
        torque: From `torques`.
        motions: Samples of each motion.
        effort: The joints' limits, inf without one [N m or N].
    """
    rows = [np.concatenate([getattr(each, name) for each in motions]) for name in ("x", "velocity", "acceleration")]
    ends = np.cumsum([len(each.x) for each in motions])
    return [
        peak_torque(each, own, effort) for each, own in zip(motions, np.split(torque(*rows), ends[:-1]), strict=True)
    ]
