"""Joint torques of a timed motion, by inverse dynamics with the inertias in the arm's model.

Only inertias from `<inertial>` elements of the URDF or MJCF file are used. They are not estimated from shapes: if a
link has no inertia, the torques are unknown. A tool that the job mounts has no mass. Gravity is 9.81 m/s2 downwards in
the world. Damping and armature are included if the model has them. Equal masses of all moving links are placeholders
that an exporter wrote, and are not used. MuJoCo takes 4 us for a configuration on one core, MJX 10 to 20 us there and
5 s to compile for each arm; a test compares them.
"""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.io.robots import (
    chain_of_file,
    compile_spec,
    delete_all,
    fix_joints,
    joint_name,
    massive_bodies,
    read_model,
)
from htcp_jax.model import Coupling
from htcp_jax.spec import config, model_source, tool
from htcp_jax.trajectory.timed_motion import TimedMotion

GRAVITY_M_S2 = 9.81
FEWEST_EQUAL = 3  # number of moving bodies with equal masses from which on the masses are placeholders
TORQUES_EVERY_S = 0.01  # time step between samples
_OFF = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_CONTACT


class PeakTorque(NamedTuple):
    """Largest torque of a motion, relative to the joint's effort limit if the joints have limits."""

    torque: float  # absolute value [N m or N]
    share: float  # share of the joint's effort limit; 0 if it has none
    joint: str
    time_s: float


def model_of(arm: config.RobotConfig, tree: model_source.ComposedModel | None = None) -> mujoco.MjModel | None:
    """Return the model of a job's arm with its inertias; None if a link has none, or if all masses are equal.

    Args:
        arm: The job's section of the arm.
        tree: Models of the cell, including the arm's; None: only the arm's file.

    Raises:
        InputError: If the file cannot be read.
    """
    source, turned = (arm.file, arm.base_rpy_rad) if tree is None else (tree, tool.ZERO)
    path = model_source.label_of(source)
    spec = read_model(source)
    delete_all(spec, spec.tuples, spec.excludes, spec.geoms, spec.meshes)
    model = compile_spec(spec, path)
    fix_joints(model, path, dict(arm.locked))
    massive = massive_bodies(spec)
    moved = np.isin(model.body_weldid[massive], model.body_weldid[model.jnt_bodyid])
    mass = model.body_mass[massive][moved]
    if not np.isin(model.body_weldid[model.jnt_bodyid], model.body_weldid[massive]).all():
        return None
    if len(mass) >= FEWEST_EQUAL and np.ptp(mass) == 0:
        return None
    model.opt.gravity = tool.pose(tool.ZERO, turned)[:3, :3].T @ [0, 0, -GRAVITY_M_S2]
    model.opt.disableflags |= int(_OFF)
    return model


def torques(
    model: mujoco.MjModel, locked: Collection[str] = (), coupling: Coupling | None = None
) -> Callable[..., Float[np.ndarray, "n N"]]:
    """Return a function of configurations, velocities and accelerations (n, N) that returns joint torques [N m or N].

    The torque at a coordinate is C^T times those at the joints that it moves.

    Args:
        model: The arm's model from `model_of`.
        locked: Names of the joints that do not move.
        coupling: The arm's joints that follow others; None: no joint does.
    """
    fixed = [j for j in range(model.njnt) if joint_name(model, j) in locked]
    if coupling is None:
        joints = np.array(chain_of_file(model, Path("model"), fixed).joints)  # in the robot's order
    else:
        names = [joint_name(model, j) for j in range(model.njnt)]
        joints = np.array([names.index(name) for name in coupling.joint_names])

    def found(x: Float[np.ndarray, "n N"], v: Float[np.ndarray, "n N"], a: Float[np.ndarray, "n N"]) -> np.ndarray:
        if coupling is not None:
            x, v, a = coupling.positions(x), coupling.rates(v), coupling.rates(a)
        data, torque = mujoco.MjData(model), np.empty_like(x)
        for k in range(len(x)):
            data.qpos[joints], data.qvel[joints], data.qacc[joints] = x[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_inverse[joints]
        return torque if coupling is None else torque @ np.asarray(coupling.factors)

    return found


def peak_torque(timed: TimedMotion, torque: Float[np.ndarray, "n N"], effort: Float[np.ndarray, "N"]) -> PeakTorque:
    """Return the torque with the largest share of its joint's effort limit; without limits, the largest torque.

    Args:
        timed: Samples of the motion.
        torque: Joint torques at the samples [N m or N].
        effort: Effort limits of the joints [N m or N]; inf for a joint without a limit.
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
    """Return the peak torque of each of an arm's motions, computed in one batch, see `peak_torque`.

    Args:
        torque: The function from `torques`.
        motions: Samples of each motion.
        effort: Effort limits of the joints [N m or N]; inf for a joint without a limit.
    """
    rows = [np.concatenate([getattr(each, name) for each in motions]) for name in ("x", "velocity", "acceleration")]
    ends = np.cumsum([len(each.x) for each in motions])
    return [
        peak_torque(each, own, effort) for each, own in zip(motions, np.split(torque(*rows), ends[:-1]), strict=True)
    ]
