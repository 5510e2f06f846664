"""Joints that follow other joints, in a compiled model: MJCF's <equality>, to which a URDF's <mimic> is converted.

A follower is at q = qpos0 + c0 + c1 (q_master - qpos0_master), with further coefficients up to the fourth power.
Without a master it is held at qpos0 + c0. The master may be a follower itself. An inactive constraint has no effect.
"""

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.mujoco_models import joint_name

_EQUALITY = int(mujoco.mjtEq.mjEQ_JOINT)


class Follower(NamedTuple):
    """The motion of a joint that follows another one: a polynomial of its master's distance from the initial value."""

    master: int  # index of the joint that it follows; -1 if it is held
    coefficients: Float[np.ndarray, "5"]  # the constant first, in rad or m
    drawn_at: float  # its own value in the initial configuration, qpos0 [rad or m]
    master_drawn_at: float  # its master's; 0 if it is held

    @property
    def is_held(self) -> bool:
        """True if the joint has the same value wherever its master is."""
        return self.master < 0 or not self.coefficients[1:].any()

    @property
    def is_linear(self) -> bool:
        """True if the joint moves in proportion to its master."""
        return not self.coefficients[2:].any()

    @property
    def factor(self) -> float:
        """The joint's motion per motion of its master [1, m/rad or rad/m]."""
        return 0.0 if self.master < 0 else float(self.coefficients[1])

    @property
    def offset(self) -> float:
        """The value of a linear follower while its master is at 0 [rad or m]."""
        return self.at(0.0) if self.is_linear else np.nan

    def at(self, value: float) -> float:
        """Return the joint's value while its master has a value [rad or m]."""
        moved = 0.0 if self.is_held else value - self.master_drawn_at
        return float(self.drawn_at + np.polynomial.polynomial.polyval(moved, self.coefficients))


def followers(model: mujoco.MjModel, path: Path) -> dict[int, Follower]:
    """Return the joints that follow other joints, by their indices in the model, masters before their followers.

    Args:
        model: The compiled model.
        path: Its file, for messages.

    Raises:
        InputError: For a coefficient that is not finite, a joint that follows several joints, and joints that
            follow each other in a circle.
    """
    found: dict[int, Follower] = {}
    drawn_at = model.qpos0[model.jnt_qposadr]
    for k in np.flatnonzero((model.eq_type == _EQUALITY) & (model.eq_active0 > 0)):
        joint, master = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if not np.isfinite(model.eq_data[k, :5]).all():
            leader = _leader_text(model, master)
            raise InputError(f"{path}: joint {joint_name(model, joint)!r} {leader} by a polycoef that is not finite")
        if joint in found:
            both = [_leader_text(model, each) for each in (found[joint].master, master)]
            raise InputError(f"{path}: joint {joint_name(model, joint)!r} {' and '.join(both)}; it can follow only one")
        at = float(drawn_at[joint]), 0.0 if master < 0 else float(drawn_at[master])
        found[joint] = Follower(master, model.eq_data[k, :5].copy(), *at)
    order: dict[int, Follower] = {}
    for joint in found:
        line = [joint]
        while (master := found[line[-1]].master) in found and master not in order:
            if master in line:
                circle = [joint_name(model, each) for each in [*line[line.index(master) :], master]]
                raise InputError(f"{path}: joints follow each other in a circle: {' -> '.join(circle)}")
            line.append(master)
        order |= {each: found[each] for each in reversed(line) if each not in order}
    return order


def _leader_text(model: mujoco.MjModel, master: int) -> str:
    return "is held" if master < 0 else f"follows {joint_name(model, master)!r}"


def equation(name: str, master: str, factor: float, offset: float) -> str:
    """Format a linear follower: "a5b = -0.5 a5 + 0.1" [rad or m]."""
    scaled = {1.0: master, -1.0: f"-{master}"}.get(factor, f"{factor:.6g} {master}")
    return f"{name} = {scaled}" + (f" {'-' if offset < 0 else '+'} {abs(offset):.6g}" if offset else "")
