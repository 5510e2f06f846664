"""Selection of the frame of a model that is its TCP, or of candidates if that is ambiguous."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.model_file import frame, upwards

SURE = "tcp", "tool0"  # names of the TCP or the flange that take precedence
MOST_NAMED = 12  # candidates


class Tip(NamedTuple):
    """The frame of the TCP."""

    name: str
    body: int  # index of the body that carries it
    T_body_tcp: Float[np.ndarray, "4 4"]


def find_tip(model: mujoco.MjModel, path: Path, name: str | None, bodies: Sequence[int]) -> Tip:
    """Return the frame of the TCP.

    The site or body `name`. Without a name: `tcp` or `tool0`, or the only site, or the only outermost body.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        name: Name of a site or body; None: see above.
        bodies: Indices of the bodies to search.

    Raises:
        InputError: With the valid names, for an unknown name, and if the TCP is ambiguous.
    """
    tips = _tips(model, bodies)
    if name is not None:
        if name not in tips:
            raise InputError(f"{path}: no site or body {name!r} for the TCP; there are {', '.join(tips) or 'none'}")
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
        raise InputError(f"{path}: it is not clear where the TCP is: {candidates}; name it by --tcp NAME")
    return sure[0]


def _tips(model: mujoco.MjModel, bodies: Sequence[int]) -> dict[str, Tip]:
    """Return all named frames; a site takes precedence over a body with its name."""
    tips = [Tip(model.body(b).name, b, np.eye(4)) for b in bodies if b > 0]
    tips += [_site(model, k) for k in range(model.nsite) if model.site_bodyid[k] in bodies]
    return {tip.name: tip for tip in tips if tip.name}


def _site(model: mujoco.MjModel, k: int) -> Tip:
    T = frame(model.site_pos[k], model.site_quat[k])
    return Tip(model.site(k).name, int(model.site_bodyid[k]), T)


def _joints_to(model: mujoco.MjModel, body: int) -> frozenset[int]:
    """Return the joints from the world to a body, by their indices in the model."""
    first, count = model.body_jntadr, model.body_jntnum
    return frozenset(j for b in upwards(model, body) for j in range(first[b], first[b] + count[b]))


def _outermost(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """Return the leaves among the bodies with the most joints between them and the world."""
    depth = {b: len(_joints_to(model, b)) for b in bodies}
    far = [b for b in bodies if depth[b] == max(depth.values())]
    return [b for b in far if not any(b in list(upwards(model, other))[1:] for other in far)]


def _tcp_candidates(model: mujoco.MjModel, bodies: Sequence[int], outermost: list[int]) -> list[str]:
    """Return the names of sites, and of bodies that move with every joint shared by all outermost bodies."""
    shared = frozenset.intersection(*(_joints_to(model, b) for b in outermost))
    near = [b for b in bodies if b > 0 and shared <= _joints_to(model, b)]
    if not shared or len(near) > MOST_NAMED:
        near = outermost
    sites = [model.site(k).name for k in range(model.nsite) if model.site_bodyid[k] in bodies]
    return [name for name in (*sites, *(model.body(b).name for b in near)) if name]
