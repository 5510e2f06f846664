"""Arms whose joints follow others, and MuJoCo's own solution of their constraints as a reference."""

import mujoco
import numpy as np

SHAPE = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'
# The reference's compiler: a URDF's links have no masses.
COMPILER = '<mujoco><compiler boundmass="1e-3" boundinertia="1e-3" fusestatic="false"/></mujoco>'


def joint(name, parent, child, axis="0 1 0", at="0 0 0.3", kind="revolute", limit="-1 1", more="", shape=SHAPE) -> str:
    """A link of a URDF and the joint that moves it."""
    lower, upper = limit.split()
    return f"""<link name="{child}">{shape}</link><joint name="{name}" type="{kind}"><parent link="{parent}"/>
      <child link="{child}"/><origin xyz="{at}" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>
      <limit lower="{lower}" upper="{upper}" velocity="2" effort="10"/>{more}</joint>"""


def mimic(master: str, factor: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{master}" multiplier="{factor}" offset="{offset}"/>'


def urdf(*joints: str) -> str:
    return f'<robot name="coupled"><link name="base">{SHAPE}</link>{"".join(joints)}</robot>'


def solved(model: mujoco.MjModel, u: dict[str, float]) -> tuple[mujoco.MjData, np.ndarray]:
    """MuJoCo's model with its equality constraints solved by Newton's method, and dq/du for all its joints (nv, N)."""
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    free = [model.joint(name).dofadr[0] for name in u]
    others = [k for k in range(model.nv) if k not in free]
    for name, value in u.items():
        data.joint(name).qpos[:] = value
    for _ in range(30):
        mujoco.mj_fwdPosition(model, data)
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        J = data.efc_J.reshape(-1, model.nv)[rows]
        step = np.linalg.lstsq(J[:, others], -data.efc_pos[rows], rcond=1e-9)[0]
        data.qpos[others] += step
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    assert np.abs(data.efc_pos[rows]).max(initial=0.0) < 1e-12
    along = np.zeros((model.nv, len(free)))
    along[free, range(len(free))] = 1.0
    along[others] = -np.linalg.lstsq(J[:, others], J[:, free], rcond=1e-9)[0]
    return data, along
