"""Joints that follow others, by MuJoCo's equality constraints: its residuals and their Jacobians, solved for them."""

from collections.abc import Collection
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError

_STEPS, EXACT = 3, 1e-10  # Newton steps; a smaller factor is rounding
_SOLVED = 1e-8  # largest residual of a constraint that holds [rad or m]
_DISABLED = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY)  # flags of a simulation


class Following(NamedTuple):
    """The joints of a model that move, as a linear function of those that follow no other one."""

    free: Int[np.ndarray, "N"]  # joints that follow no other one
    moving: Int[np.ndarray, "n"]  # all joints that move
    factors: Float[np.ndarray, "n N"]
    offsets: Float[np.ndarray, "n"]  # [rad or m]

    @classmethod
    def of(
        cls, model: mujoco.MjModel, data: mujoco.MjData, joints: Int[np.ndarray, "m"], fixed: Collection[int]
    ) -> "Following":
        """Return the function for a model's joints; those that follow fixed ones are set in `data`.

        Args:
            model: The model.
            data: Its state, in which the fixed joints have their values.
            joints: All joints that are not fixed.
            fixed: Joints that do not move.

        Raises:
            InputError: If the constraints do not hold together.
        """
        active = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 > 0)
        follow = [j for j in dict.fromkeys(model.eq_obj1id[active].tolist()) if j not in fixed]
        free = np.array([j for j in joints if j not in follow], int)
        if not follow:
            return cls(free, free, np.eye(len(free)), np.zeros(len(free)))
        model.opt.disableflags &= ~_DISABLED
        rows = [_solved(model, data, free, u, follow) for u in np.vstack([np.zeros(len(free)), np.eye(len(free))])]
        at_zero, factors = rows[0], np.array(rows[1:]).reshape(len(free), -1).T - rows[0][:, None]
        factors = np.where(np.abs(factors) < EXACT, 0.0, factors)
        still = [j for j, row in zip(follow, factors, strict=True) if not row.any()]
        data.qpos[follow] = at_zero
        moving = np.array([j for j in joints if j not in still], int)
        own = np.zeros((model.njnt, len(free))), np.zeros(model.njnt)
        own[0][free, np.arange(len(free))] = 1.0
        own[0][follow], own[1][follow] = factors, at_zero
        return cls(free, moving, own[0][moving], own[1][moving])

    def positions(self, x: Float[np.ndarray, "N"]) -> Float[np.ndarray, "n"]:
        """Return the positions of all joints that move [rad or m]."""
        return self.factors @ x + self.offsets

    def limits(
        self, lower: Float[np.ndarray, "n"], upper: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
        """Return the limits of the free joints, between which every joint that moves is within its own [rad or m]."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(limit - self.offsets)[:, None] / self.factors for limit in (lower, upper)], axis=0)
        moved = self.factors != 0
        return np.where(moved, ends[0], -np.inf).max(axis=0), np.where(moved, ends[1], np.inf).min(axis=0)

    def speeds(self, speed: Float[np.ndarray, "n"]) -> Float[np.ndarray, "N"]:
        """Return the limits of the free joints' speeds, from those of all that move [rad/s or m/s]."""
        size = np.abs(self.factors)
        return np.where(size > 0, speed[:, None] / np.where(size > 0, size, 1.0), np.inf).min(axis=0)


def _solved(
    model: mujoco.MjModel, data: mujoco.MjData, free: np.ndarray, u: np.ndarray, follow: list[int]
) -> Float[np.ndarray, "f"]:
    """Return the positions of the joints that follow others, from MuJoCo's constraints between joints alone."""
    own = mujoco.MjData(model)
    own.eq_active &= (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & np.isin(model.eq_obj1id, follow)
    own.qpos[:] = data.qpos
    own.qpos[free] = u
    for step in range(_STEPS + 1):
        mujoco.mj_fwdPosition(model, own)
        rows = np.flatnonzero(own.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        if step < _STEPS:
            jacobian = _dense(model, own)[np.ix_(rows, follow)]
            own.qpos[follow] -= np.linalg.lstsq(jacobian, own.efc_pos[rows], rcond=None)[0]
    if not (np.abs(own.efc_pos[rows]) < _SOLVED).all():
        names = ", ".join(model.joint(j).name for j in follow)
        raise InputError(f"MuJoCo's <equality> constraints of the joints {names} do not hold together")
    return own.qpos[follow].copy()


def _dense(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, "c v"]:
    if not mujoco.mj_isSparse(model):
        return data.efc_J.reshape(data.nefc, model.nv)
    found = np.zeros((data.nefc, model.nv))
    mujoco.mju_sparse2dense(found, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    return found
