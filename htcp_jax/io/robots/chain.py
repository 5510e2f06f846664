"""The serial chain of joints from the world, or from the part's link, to the TCP, in a compiled model.

The chain's root is the world, unless the file names a link as the part's link by <text name="link of the part">. The
chain then begins at that link, leads up to the first common ancestor with the TCP through reversed joints, and down to
the TCP. The axis of a reversed joint is negated: the same joint value then gives the same relative pose of its two
bodies, so that the joint keeps its name, limits, zero and sign.

Side branches are moved by joints that follow the chain's, such as those of a parallelogram's rods, and by joints that
the chain's follow.
"""

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.followers import Follower, followers
from htcp_jax.io.robots.frames import body_frame, shifted_frame, turned_frame
from htcp_jax.io.robots.mujoco_models import HINGE, SLIDE, joint_name, joints_of, text_of, upwards
from htcp_jax.io.robots.safe_xml import PART
from htcp_jax.model import LimitArrays, coordinate_limits

FEWEST_JOINTS = 3
MOST_JOINTS = 9  # maximum number of joints if the part moves


class Chain(NamedTuple):
    """The chain of joints from the part's link to the TCP, in order, by their indices in the model."""

    root: int  # the body that carries the part; 0: the world
    up: tuple[int, ...]  # reversed joints: the chain leads from the joint's body to that body's parent
    down: tuple[int, ...]  # the joints after them
    side: tuple[int, ...] = ()  # moving joints on side branches

    @property
    def to_tcp(self) -> tuple[int, ...]:
        """The joints between the part's link and the TCP."""
        return self.up + self.down

    @property
    def joints(self) -> tuple[int, ...]:
        """All joints, those on side branches last."""
        return self.to_tcp + self.side

    def without(self, fixed: Collection[int]) -> "Chain":
        """Return the chain without the joints `fixed`, given by their indices in the model."""
        return Chain(self.root, *(tuple(j for j in part if j not in fixed) for part in self[1:]))


class JointMap(NamedTuple):
    """The J joints of a chain as q = C u + d of its N coordinates u, the joints that follow no other one."""

    joints: tuple[int, ...]  # by their indices in the model, as in `Chain.joints`
    free: tuple[int, ...]  # those of the coordinates, see `_in_order`
    factors: Float[np.ndarray, "J N"]  # C [1, m/rad or rad/m]
    offsets: Float[np.ndarray, "J"]  # d [rad or m]

    def names(self, model: mujoco.MjModel) -> tuple[str, ...]:
        """Return the names of the joints."""
        return tuple(joint_name(model, j) for j in self.joints)

    @property
    def is_coupled(self) -> bool:
        """True if a joint follows another one."""
        return len(self.free) < len(self.joints)

    @classmethod
    def of(cls, model: mujoco.MjModel, path: Path, chain: Chain) -> "JointMap":
        """Return the map of a chain whose followers are linear."""
        pairs = _followers_on(model, path, chain)
        free = tuple(j for j in _in_order(model, chain.root) if j in chain.joints and j not in pairs)
        rows = {j: (k, 1.0, 0.0) for k, j in enumerate(free)}
        for j, follower in pairs.items():  # masters first
            k, factor, offset = rows[follower.master]
            rows[j] = k, follower.factor * factor, follower.factor * offset + follower.offset
        factors, offsets = np.zeros((len(chain.joints), len(free))), np.zeros(len(chain.joints))
        for row, j in enumerate(chain.joints):
            k, factors[row, rows[j][0]], offsets[row] = rows[j]
        return cls(chain.joints, free, factors, offsets)

    def positions(self, u: Float[np.ndarray, "*n N"]) -> Float[np.ndarray, "*n J"]:
        """Return the positions q of the joints at coordinates u [rad or m]."""
        return u @ self.factors.T + self.offsets if self.is_coupled else u

    def limits(
        self,
        model: mujoco.MjModel,
        path: Path,
        ranges: Float[np.ndarray, "J 2"],
        speed: Float[np.ndarray, "J"] | None = None,
        acceleration: Float[np.ndarray, "J"] | None = None,
        effort: Float[np.ndarray, "J"] | None = None,
    ) -> LimitArrays:
        """Return the limits of the coordinates, within which all joints keep their own.

        Args:
            model: The compiled model.
            path: Its file, for messages.
            ranges: Lower and upper limits of the joints [rad or m].
            speed: Their limits of speed [rad/s or m/s]; None for no limits, as for the others.
            acceleration: Their limits of acceleration [rad/s2 or m/s2].
            effort: Their limits of effort [N m or N].

        Raises:
            InputError: If no range of a coordinate satisfies the limits of all joints that it moves.
        """
        unlimited = np.full(len(self.joints), np.inf)
        rates = (unlimited if each is None else each for each in (speed, acceleration, effort))
        own = LimitArrays(ranges[:, 0], ranges[:, 1], *rates)
        if not self.is_coupled:
            return own
        free = [joint_name(model, j) for j in self.free]
        return coordinate_limits(self.factors, self.offsets, own, self.names(model), free, f"{path}: ")


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
    """Return the joints of an arm's or a cell's file: `down` has all that are not fixed, see `_in_order`.

    Joints that follow a fixed one, and joints that are held, are fixed, too.

    Raises:
        InputError: If the file names an unknown link as the part's link.
    """
    root, still = part_body(model, path), set(fixed)
    for j, follower in followers(model, path).items():  # masters first
        if follower.is_held or follower.master in still:
            still.add(j)
    return Chain(root, (), _in_order(model, root)).without(still)


def _in_order(model: mujoco.MjModel, root: int) -> tuple[int, ...]:
    """Return all joints: those between the part's link and the world, then the others in the model's order."""
    up = [j for body in upwards(model, root) for j in reversed(joints_of(model, body))]
    return (*up, *(j for j in range(model.njnt) if j not in up))


def with_side_branches(
    model: mujoco.MjModel, path: Path, chain: Chain, fixed: Collection[int], bodies: Collection[int]
) -> Chain:
    """Return a chain with the joints off it that its joints follow, and those that follow its joints linearly.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        chain: The chain between the part's link and the TCP.
        fixed: Joints that do not move, with all that follow them.
        bodies: The robot's bodies.

    Raises:
        InputError: If a joint on the chain follows a joint of another body than the robot's.
    """
    pairs = {j: each for j, each in followers(model, path).items() if j not in fixed}
    moving = set(chain.to_tcp)
    for j in chain.to_tcp:
        while j in pairs:
            follower, j = j, pairs[j].master
            moving.add(j)
            if model.jnt_bodyid[j] not in bodies:
                names = joint_name(model, follower), joint_name(model, j)
                raise InputError(f"{path}: joint {names[0]!r} follows {names[1]!r}, which is not a joint of the robot")
    for j, each in pairs.items():
        if each.is_linear and each.master in moving and model.jnt_bodyid[j] in bodies:
            moving.add(j)
    return chain._replace(side=tuple(j for j in _in_order(model, chain.root) if j in moving - set(chain.to_tcp)))


def _followers_on(model: mujoco.MjModel, path: Path, chain: Chain) -> dict[int, Follower]:
    """Return the joints of a chain that follow others, masters before their followers."""
    return {j: each for j, each in followers(model, path).items() if j in chain.joints}


def whole_chain(model: mujoco.MjModel, path: Path, tcp_body: int, fixed: Collection[int], next_step: str) -> Chain:
    """Return the chain to the TCP; raise InputError unless it contains all joints of the model that are not fixed."""
    chain = chain_between(model, part_body(model, path), tcp_body).without(fixed)
    chain = with_side_branches(model, path, chain, fixed, range(model.nbody))
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
) -> JointMap:
    """Check the joints on a chain, and return them with those that they follow.

    Raises:
        InputError: For ball, free and planar joints and couplings that are not linear, see `remarks`, for too few
            joints (with the hint), and, if the part moves, for more than MOST_JOINTS joints, without followers.
    """
    joints, names = chain.joints, [joint_name(model, j) for j in chain.joints]
    for j, follower in _followers_on(model, path, chain).items():
        if not follower.is_linear:
            remedy = remedies.freeze.format(joint_name(model, follower.master))
            rule = f"joint {joint_name(model, j)!r} follows {joint_name(model, follower.master)!r} by a polynomial"
            raise InputError(f"{path}: {rule}; only factor and offset are supported; freeze that joint with {remedy}")
    carriers = {int(model.jnt_bodyid[j]) for j in joints}
    moved = [model.body(b).name for b in range(1, model.nbody) if int(model.body_weldid[b]) in carriers]
    remarks.check_kinds(model, path, names, moved, remedies)
    odd = [joint_name(model, j) for j in joints if model.jnt_type[j] not in (HINGE, SLIDE)]
    if odd:
        raise InputError(f"{path}: ball or free joints ({', '.join(odd)}); only hinge and slide joints are supported")
    mapped = JointMap.of(model, path, chain)
    count = len(mapped.free)
    found = f"{path}: {count or 'no'} joints from {_root_name(model, chain)} to the TCP"
    if count < fewest:
        raise InputError(f"{found}; at least {fewest} {'are' if fewest > 1 else 'is'} needed{hint}")
    if chain.root and count > MOST_JOINTS:
        raise InputError(f"{found}; at most {MOST_JOINTS} are supported: freeze some with --fix or robot.locked")
    return mapped


class LinkFrames(NamedTuple):
    """Frames of a chain's links, of which each joint moves one."""

    T_parent_joint: Float[np.ndarray, "J 4 4"]  # each joint's frame at 0, in the link that carries it [m]
    parents: tuple[int, ...]  # link that carries each joint; -1: the chain's root
    reversed: tuple[bool, ...]  # True for joints that lead from their body to that body's parent
    of_bodies: list[tuple[int, np.ndarray]]  # for each body of the model its link, -1 for the root, and T_link_body


def link_frames(model: mujoco.MjModel, T_world_base: np.ndarray, chain: Chain) -> LinkFrames:
    """Return the frames of a chain's links and bodies.

    They account for joint anchors, and for qpos0, the joint values of the model's initial configuration. Joints that
    are not on the chain stay at qpos0.

    Args:
        model: The compiled model.
        T_world_base: Pose of the model's own frame in the world (4, 4) [m]; ignored unless the world is the root.
        chain: The chain.
    """
    T_parent_joint, number = np.zeros((len(chain.joints), 4, 4)), {j: k for k, j in enumerate(chain.joints)}
    parents, is_reversed = [-1] * len(chain.joints), [False] * len(chain.joints)
    link, T_link_body, body = -1, T_world_base if chain.root == 0 else np.eye(4), chain.root
    known = {body: (link, T_link_body)}
    while body > 0:
        for j in reversed(joints_of(model, body)):
            if j in number:  # from the frame that moves with the body to the one that it moves against
                T_parent_joint[number[j]] = T_link_body @ shifted_frame(model.jnt_pos[j])
                parents[number[j]], is_reversed[number[j]], link = link, True, number[j]
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
                parents[number[j]], link, T_link_body = link, number[j], shifted_frame(-model.jnt_pos[j])
        frames.append((link, T_link_body))
    return LinkFrames(T_parent_joint, tuple(parents), tuple(is_reversed), frames)


def _drawn_back(model: mujoco.MjModel, j: int) -> np.ndarray:
    """Return the motion of a joint from its value in the initial configuration, qpos0, to its zero (4, 4)."""
    axis, drawn_at = model.jnt_axis[j], model.qpos0[j]
    return turned_frame(axis, -drawn_at) if model.jnt_type[j] == HINGE else shifted_frame(-drawn_at * axis)
