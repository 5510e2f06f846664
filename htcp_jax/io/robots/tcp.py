"""Selection of the frame of a model that is its TCP; if it is ambiguous or a poor choice, of candidates."""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.chain import FEWEST_JOINTS
from htcp_jax.io.robots.followers import Follower, followers
from htcp_jax.io.robots.frames import site_frame
from htcp_jax.io.robots.mujoco_models import SLIDE, joint_name, joints_of, upwards
from htcp_jax.io.robots.remarks import MOST_NAMED, listed

SURE = "tcp", "tool0"  # names of the TCP or the flange that take precedence
# Names of a gripper's joints and of the bodies that they move. "gripper" is missing: a wrist often moves such a body.
JAW_JOINT = re.compile("finger|jaw|gripper|knuckle|thumb", re.IGNORECASE)
JAW_BODY = re.compile("finger|jaw|knuckle|thumb", re.IGNORECASE)


class Tip(NamedTuple):
    """The frame of the TCP."""

    name: str
    body: int  # index of the body that carries it
    T_body_tcp: Float[np.ndarray, "4 4"]


def find_tip(model: mujoco.MjModel, path: Path, name: str | None, bodies: Sequence[int]) -> Tip:
    """Return the frame of the TCP.

    It is the site or body `name`. Without a name it is `tcp` or `tool0`, else the only site, else the only outermost
    body.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        name: Name of a site or body; None: see above.
        bodies: Indices of the bodies to search.

    Raises:
        InputError: For an unknown name, and if the TCP is ambiguous; the message lists the valid names.
    """
    tips = _tips(model, bodies)
    if name is not None:
        if name not in tips:
            raise InputError(f"{path}: no site or body {name!r} for the TCP; valid: {', '.join(tips) or 'none'}")
        return tips[name]
    sites = [k for k in range(model.nsite) if model.site_bodyid[k] in bodies]
    outermost = _outermost(model, bodies)
    sure = [tips[name] for name in SURE if name in tips]
    if not sure and len(sites) == 1:
        sure = [_site(model, sites[0])]
    if not sure and len(outermost) == 1:
        sure = [Tip(model.body(outermost[0]).name, outermost[0], np.eye(4))]
    if not sure:
        candidates = ", ".join(_tcp_candidates(model, bodies, outermost))
        raise InputError(f"{path}: the TCP is ambiguous: {candidates}; choose it with --tcp NAME")
    return sure[0]


def _tips(model: mujoco.MjModel, bodies: Sequence[int]) -> dict[str, Tip]:
    """Return all named frames, by name; a site takes precedence over a body with the same name."""
    tips = [Tip(model.body(b).name, b, np.eye(4)) for b in bodies if b > 0]
    tips += [_site(model, k) for k in range(model.nsite) if model.site_bodyid[k] in bodies]
    return {tip.name: tip for tip in tips if tip.name}


def _site(model: mujoco.MjModel, k: int) -> Tip:
    return Tip(model.site(k).name, int(model.site_bodyid[k]), site_frame(model, k))


def _joints_to(model: mujoco.MjModel, body: int) -> frozenset[int]:
    """Return the joints from the world to a body, by their indices in the model."""
    return frozenset(j for b in upwards(model, body) for j in joints_of(model, b))


def _outermost(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Return the bodies with the most joints between them and the world, without ancestors of other such bodies."""
    depth = {b: len(_joints_to(model, b)) for b in bodies}
    far = [b for b in bodies if depth[b] == max(depth.values())]
    return [b for b in far if not any(b in list(upwards(model, other))[1:] for other in far)]


def _tcp_candidates(model: mujoco.MjModel, bodies: Sequence[int], outermost: list[int]) -> list[str]:
    """Return the names of candidates for the TCP.

    They are all sites, and the bodies that are moved by every joint that moves all outermost bodies. If these are too
    many or there is no such joint, only the outermost bodies are used.
    """
    shared = frozenset.intersection(*(_joints_to(model, b) for b in outermost))
    near = [b for b in bodies if b > 0 and shared <= _joints_to(model, b)]
    if not shared or len(near) > MOST_NAMED:
        near = outermost
    sites = [model.site(k).name for k in range(model.nsite) if model.site_bodyid[k] in bodies]
    return [name for name in (*sites, *(model.body(b).name for b in near)) if name]


def other_frames(model: mujoco.MjModel, bodies: Sequence[int], tip: Tip) -> str:
    """Return a hint for the message about a TCP with too few joints: frames with enough joints for `--tcp`, or "".

    Args:
        model: The compiled model.
        bodies: Indices of the robot's bodies.
        tip: The TCP.
    """
    tips, names = _tips(model, bodies), _tcp_candidates(model, bodies, _outermost(model, bodies))
    tips.pop(tip.name, None)
    far = [name for name in names if name in tips and len(_joints_to(model, tips[name].body)) >= FEWEST_JOINTS]
    return f"; --tcp may name another frame: {listed(far)}" if far else ""


def warn_of_jaw(model: mujoco.MjModel, path: Path, tip: Tip, joints: Sequence[int]) -> None:
    """Warn if the TCP is on a moving jaw of a gripper, and list the frames that the gripper is mounted on.

    Args:
        model: The compiled model.
        path: Its file, for the message.
        tip: The TCP.
        joints: The moving joints from the world to the TCP.
    """
    arm, pairs = list(joints), followers(model, path)
    off_chain = {j: each for j, each in pairs.items() if j not in joints or each.master not in joints}
    while arm and _moves_jaw(model, arm[-1], off_chain):
        arm.pop()
    jaw = joints[len(arm) :]
    if not jaw or len(arm) < FEWEST_JOINTS:  # no gripper, or a robot that is a finger
        return
    base = model.body_parentid[model.jnt_bodyid[jaw[0]]]
    tips = _tips(model, range(model.nbody)).values()
    names = [each.name for each in tips if model.body_weldid[each.body] == model.body_weldid[base]]
    moved = [joint_name(model, j) for j in jaw]
    masters = {j: j for j in range(model.njnt)}
    for j, follower in pairs.items():
        masters[j] = masters.get(follower.master, j)
    fix = " ".join(f"--fix {joint_name(model, j)}=VALUE" for j in dict.fromkeys(masters[j] for j in jaw))
    warnings.warn(
        f"{path}: the TCP {tip.name!r} is on a jaw that {', '.join(moved)} moves as a part of the arm; "
        f"choose a frame before the jaw with --tcp ({listed(names)}), or freeze the jaw with {fix}",
        stacklevel=3,
    )


def _moves_jaw(model: mujoco.MjModel, joint: int, pairs: Mapping[int, Follower]) -> bool:
    """Return True for a gripper's joint.

    It has a gripper's name, or a joint off the chain, by `pairs`, follows it or leads it, or slides on the same body.
    """
    body, paired = int(model.jnt_bodyid[joint]), {*pairs, *(each.master for each in pairs.values())}
    named = JAW_JOINT.search(model.joint(joint).name) or JAW_BODY.search(model.body(body).name)
    slides = {int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == SLIDE}
    beside = {each for each in slides - {body} if model.body_parentid[each] == model.body_parentid[body]}
    return bool(named or joint in paired or (body in slides and beside))
