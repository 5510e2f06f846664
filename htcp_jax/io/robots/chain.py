"""The serial chain of joints from the world, or from the part's link, to the TCP, in a compiled model.

The chain's root is the world, unless the file names a link as the part's link by <text name="link of the part">. The
chain then begins at that link, leads up to the first common ancestor with the TCP through reversed joints, and down to
the TCP. The axis of a reversed joint is negated: the same joint value then gives the same relative pose of its two
bodies, so that the joint keeps its name, limits, zero and sign.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.frames import body_frame, shifted_frame, turned_frame
from htcp_jax.io.robots.mujoco_models import joint_name, joints_of, text_of, upwards
from htcp_jax.io.robots.safe_xml import PART

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
FEWEST_JOINTS = 3
MOST_JOINTS = 9  # maximum number of joints if the part moves


class Chain(NamedTuple):
    """The chain of joints from the part's link to the TCP, in order, by their indices in the model."""

    root: int  # the body that carries the part; 0: the world
    up: tuple[int, ...]  # reversed joints: the chain leads from the joint's body to that body's parent
    down: tuple[int, ...]  # the joints after them

    @property
    def joints(self) -> tuple[int, ...]:
        """All joints."""
        return self.up + self.down

    @property
    def reversed(self) -> tuple[bool, ...]:
        """True for each reversed joint of `joints`."""
        return (True,) * len(self.up) + (False,) * len(self.down)

    def without(self, fixed: Collection[int]) -> "Chain":
        """Return the chain without the joints `fixed`, given by their indices in the model."""
        return Chain(self.root, *(tuple(j for j in part if j not in fixed) for part in self[1:]))


def part_body(model: mujoco.MjModel, path: Path) -> int:
    """Return the body that the file names as the part's link; 0, the world, if it names none.

    Raises:
        InputError: For an unknown body.
    """
    name = text_of(model, PART)
    return 0 if name is None else find_link(model, path, name, range(model.nbody), f"text {PART!r}")


def find_link(model: mujoco.MjModel, path: Path, name: str, bodies: Sequence[int], what: str) -> int:
    """Return the index of the body with a name, among `bodies`; the name of body 0 is world.

    Raises:
        InputError: For an unknown name; `what` describes the name in the message.
    """
    known = {model.body(b).name: b for b in bodies if model.body(b).name}
    if name not in known:
        raise InputError(f"{path}: {what}: no link {name!r}; valid: {', '.join(known)}")
    return known[name]


def chain_between(model: mujoco.MjModel, root: int, tcp_body: int) -> Chain:
    """Return the chain between two bodies: the joints from `root` up to their common ancestor, then down to the TCP."""
    up, down = list(upwards(model, root)), list(upwards(model, tcp_body))
    before = [j for body in up if body not in down for j in reversed(joints_of(model, body))]
    return Chain(root, tuple(before), tuple(j for b in reversed(down) if b not in up for j in joints_of(model, b)))


def chain_of_file(model: mujoco.MjModel, path: Path, fixed: Collection[int] = ()) -> Chain:
    """Return the chain of an arm's or a cell's file: all joints that are not fixed are on the chain.

    Raises:
        InputError: If the file names an unknown link as the part's link.
    """
    root = part_body(model, path)
    up = [j for body in upwards(model, root) for j in reversed(joints_of(model, body))]
    return Chain(root, tuple(up), tuple(j for j in range(model.njnt) if j not in up)).without(fixed)


def whole_chain(model: mujoco.MjModel, path: Path, tcp_body: int, fixed: Collection[int], next_step: str) -> Chain:
    """Return the chain to the TCP; raise InputError unless it contains all joints of the model that are not fixed."""
    chain = chain_between(model, part_body(model, path), tcp_body).without(fixed)
    if chain.root and not chain.joints:
        part, carrier = (model.body(body).name for body in (chain.root, tcp_body))
        where = f"both are on {part!r}" if chain.root == tcp_body else f"it is on {carrier!r}"
        raise InputError(f"{path}: no joint between the part's link {part!r} and the TCP: {where}")
    stray = [joint_name(model, j) for j in range(model.njnt) if j not in (*chain.joints, *fixed)]
    if stray:
        off = f"joints off the chain from {_root_name(model, chain)} to the TCP: {', '.join(stray)}"
        raise InputError(f"{path}: {off}; {next_step}")
    return chain


def _root_name(model: mujoco.MjModel, chain: Chain) -> str:
    return f"the part's link {model.body(chain.root).name!r}" if chain.root else "the world"


def check_joints(
    model: mujoco.MjModel,
    path: Path,
    chain: Chain,
    hint: str = "",
    fewest: int = FEWEST_JOINTS,
    remedies: remarks.Remedies = remarks.OF_JOB,
) -> tuple[str, ...]:
    """Check the joints on a chain, and return their names.

    Raises:
        InputError: For ball, free and planar joints and those that do not move on their own, see `remarks`, for too few
            joints (with the hint), and, if the part moves, for more than MOST_JOINTS joints.
    """
    joints, names = chain.joints, [joint_name(model, j) for j in chain.joints]
    carriers = {int(model.jnt_bodyid[j]) for j in joints}
    moved = [model.body(b).name for b in range(1, model.nbody) if int(model.body_weldid[b]) in carriers]
    remarks.check_kinds(model, path, names, moved, remedies)
    odd = [joint_name(model, j) for j in joints if model.jnt_type[j] not in (HINGE, SLIDE)]
    if odd:
        raise InputError(f"{path}: ball or free joints ({', '.join(odd)}); only hinge and slide joints are supported")
    found = f"{path}: {len(joints) or 'no'} joints from {_root_name(model, chain)} to the TCP"
    if len(joints) < fewest:
        raise InputError(f"{found}; at least {fewest} {'are' if fewest > 1 else 'is'} needed{hint}")
    if chain.root and len(joints) > MOST_JOINTS:
        raise InputError(f"{found}; at most {MOST_JOINTS} are supported: freeze some with --fix or robot.locked")
    return tuple(names)


def link_frames(
    model: mujoco.MjModel, T_world_base: np.ndarray, chain: Chain
) -> tuple[np.ndarray, list[tuple[int, np.ndarray]]]:
    """Return T_parent_joint (N, 4, 4) [m], and for each body its link (-1: the chain's root) and T_link_body.

    Both account for joint anchors, and for qpos0, the joint values of the model's initial configuration. Joints that
    are not on the chain stay at qpos0.

    Args:
        model: The compiled model.
        T_world_base: Pose of the model's own frame in the world (4, 4) [m]; ignored unless the world is the root.
        chain: The chain.
    """
    T_parent_joint, number = np.zeros((len(chain.joints), 4, 4)), {j: k for k, j in enumerate(chain.joints)}
    link, T_link_body, body = -1, T_world_base if chain.root == 0 else np.eye(4), chain.root
    known = {body: (link, T_link_body)}
    while body > 0:
        for j in reversed(joints_of(model, body)):
            if j in number:  # from the frame that moves with the body to the one that it moves against
                T_parent_joint[number[j]] = T_link_body @ shifted_frame(model.jnt_pos[j])
                link = number[j]
                T_link_body = np.linalg.inv(shifted_frame(model.jnt_pos[j]) @ _drawn_back(model, j))
        T_link_body = T_link_body @ np.linalg.inv(body_frame(model, body))
        body = int(model.body_parentid[body])
        known[body] = link, T_link_body
    frames = []
    for body in range(model.nbody):  # parents come before children
        if body in known:
            frames.append(known[body])
            continue
        link, T_link_parent = frames[model.body_parentid[body]]
        T_link_body = T_link_parent @ body_frame(model, body)
        for j in joints_of(model, body):
            if j in number:
                T_parent_joint[number[j]] = T_link_body @ shifted_frame(model.jnt_pos[j]) @ _drawn_back(model, j)
                link, T_link_body = number[j], shifted_frame(-model.jnt_pos[j])
        frames.append((link, T_link_body))
    return T_parent_joint, frames


def _drawn_back(model: mujoco.MjModel, j: int) -> np.ndarray:
    """Return the motion of a joint from its value in the initial configuration, qpos0, to its zero (4, 4)."""
    axis, drawn_at = model.jnt_axis[j], model.qpos0[j]
    return turned_frame(axis, -drawn_at) if model.jnt_type[j] == HINGE else shifted_frame(-drawn_at * axis)
