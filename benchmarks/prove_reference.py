"""Independent reference for distances on motions: kinematics in NumPy from MuJoCo's model, and spheres and capsules.

Nothing of `htcp_jax` is used. The arm is a chain of hinges whose bodies are spheres and capsules.
"""

from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float, Int

CHUNK = 2000  # configurations that are measured together
_SPHERE, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)


class Link(NamedTuple):
    """A body of the chain; a fixed body has no axis."""

    parent: int
    T: Float[np.ndarray, "4 4"]  # pose in its parent's frame at angle 0
    joint: int  # number of its hinge; -1: none
    axis: Float[np.ndarray, "3"]


class ChainArm(NamedTuple):
    """Arm of hinges with K bodies, each a sphere or a capsule."""

    links: tuple[Link, ...]
    link: Int[np.ndarray, "K"]  # link of each body; 0: the world
    p: Float[np.ndarray, "K 3"]  # ends of its axis in the link's frame [m]
    q: Float[np.ndarray, "K 3"]
    radius: Float[np.ndarray, "K"]

    def poses(self, x: Float[np.ndarray, "n N"]) -> list[Float[np.ndarray, "n 4 4"]]:
        """Return the links' poses in the world."""
        found = [np.broadcast_to(np.eye(4), (len(x), 4, 4))]
        for link in self.links[1:]:
            T = found[link.parent] @ link.T
            found.append(T if link.joint < 0 else T @ _turns(link.axis, x[:, link.joint]))
        return found

    def ends(self, x: Float[np.ndarray, "n N"]) -> tuple[Float[np.ndarray, "n K 3"], Float[np.ndarray, "n K 3"]]:
        """Return the ends of the bodies' axes in the world [m]."""
        T = np.stack(self.poses(x), axis=1)[:, self.link]
        return tuple(np.einsum("nkij,kj->nki", T[:, :, :3, :3], at) + T[:, :, :3, 3] for at in (self.p, self.q))

    def to_ball(self, x: Float[np.ndarray, "n N"], centre: np.ndarray, radius: float) -> Float[np.ndarray, "n"]:
        """Return the smallest distance of the moving bodies from a ball [m]."""
        p, q = self.ends(x)
        away = _from_segment(centre, p, q) - self.radius - radius
        return away[:, self.link > 0].min(axis=1)

    def to_boxes(self, x: np.ndarray, centre: np.ndarray, half: np.ndarray) -> Float[np.ndarray, "n"]:
        """Return the smallest distance of the moving spheres from boxes along the world's axes (B, 3) [m]."""
        at = self.ends(x)[0][:, self.link > 0]
        least = np.full(at.shape[:2], np.inf)
        for middle, edges in zip(centre, half, strict=True):
            out = np.abs(at - middle) - edges
            outside = np.sqrt((np.maximum(out, 0) ** 2).sum(axis=-1))
            least = np.minimum(least, outside + np.minimum(out.max(axis=-1), 0))
        return (least - self.radius[self.link > 0]).min(axis=1)

    def to_itself(self, x: np.ndarray) -> Float[np.ndarray, "n"]:
        """Return the smallest distance between spheres of links that are not adjacent [m]."""
        first, second = self.pairs()
        at = self.ends(x)[0]
        away = at[:, first] - at[:, second]
        return (np.sqrt((away * away).sum(axis=-1)) - self.radius[first] - self.radius[second]).min(axis=1)

    def capsules_apart(self, x: np.ndarray) -> Float[np.ndarray, "n"]:
        """Return the smallest distance between capsules of links that are not adjacent [m]."""
        first, second = self.pairs()
        p, q = self.ends(x)
        a, b, c, d = p[:, first], q[:, first], p[:, second], q[:, second]
        away = _segments_apart(a, b, c, d)
        return (away - self.radius[first] - self.radius[second]).min(axis=1)

    def pairs(self) -> tuple[Int[np.ndarray, "P"], Int[np.ndarray, "P"]]:
        """Return both bodies of each pair whose links are neither the same nor adjacent."""
        first, second = np.triu_indices(len(self.link), 1)
        parents = np.array([link.parent for link in self.links])
        a, b = self.link[first], self.link[second]
        kept = (a != b) & (parents[a] != b) & (parents[b] != a)
        return first[kept], second[kept]


def chain_arm(model: mujoco.MjModel) -> ChainArm:
    """Return the arm of a MuJoCo model with hinges alone, and with spheres and capsules alone.

    Raises:
        ValueError: For another kind of joint, or a body that moves and is neither a sphere nor a capsule.
    """
    links = []
    for body in range(model.nbody):
        joint, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        if count > 1 or (count and model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE):
            raise ValueError("the reference measures arms of hinges, one per body")
        if count and np.abs(model.jnt_pos[joint]).max() > 0:
            raise ValueError("the reference measures hinges at their bodies' origins")
        T = _pose(model.body_pos[body], model.body_quat[body])
        axis = model.jnt_axis[joint] if count else np.zeros(3)
        links.append(Link(int(model.body_parentid[body]), T, joint if count else -1, axis))
    rows, p, q = [], [], []
    for geom in range(model.ngeom):
        kind, size = int(model.geom_type[geom]), model.geom_size[geom]
        if kind not in (_SPHERE, _CAPSULE):
            raise ValueError(f"body {geom} of the reference is neither a sphere nor a capsule")
        T = _pose(model.geom_pos[geom], model.geom_quat[geom])
        half = T[:3, 2] * (size[1] if kind == _CAPSULE else 0.0)
        rows.append(geom)
        p.append(T[:3, 3] - half)
        q.append(T[:3, 3] + half)
    radius = model.geom_size[rows, 0].copy()
    return ChainArm(tuple(links), model.geom_bodyid[rows].copy(), np.array(p), np.array(q), radius)


def smallest(
    path: Callable[[np.ndarray], Float[np.ndarray, "n N"]],
    distance: Callable[[np.ndarray], Float[np.ndarray, "n"]],
    samples: int,
    around: int = 4,
) -> tuple[float, float]:
    """Return the smallest distance on a path and its place, by samples and a search about the smallest ones.

    Args:
        path: Function that returns configurations at places 0 <= s <= 1.
        distance: Function that measures configurations [m].
        samples: Number of equal steps.
        around: Number of local minima about which the search continues.
    """
    s = np.linspace(0, 1, samples + 1)
    found = np.concatenate([distance(path(s[k : k + CHUNK])) for k in range(0, len(s), CHUNK)])
    padded = np.concatenate([[np.inf], found, [np.inf]])
    local = np.flatnonzero((found <= padded[:-2]) & (found <= padded[2:]))
    best = float(found.min()), float(s[found.argmin()])
    for k in local[np.argsort(found[local])][:around]:
        low, high = s[max(k - 1, 0)], s[min(k + 1, samples)]
        for _ in range(8):
            fine = np.linspace(low, high, 65)
            values = distance(path(fine))
            m = int(values.argmin())
            best = min(best, (float(values[m]), float(fine[m])))
            low, high = fine[max(m - 1, 0)], fine[min(m + 1, 64)]
    return best


def _segments_apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return the distances between line segments from a to b and from c to d, of any shapes (..., 3) [m]."""
    least = np.minimum.reduce([_from_segment(a, c, d), _from_segment(b, c, d), _from_segment(c, a, b)])
    least = np.minimum(least, _from_segment(d, a, b))
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = ((e * f).sum(-1) for e, f in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    square = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (uv * vw - vv * uw) / square, (uu * vw - uv * uw) / square  # of the common normal
    inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    across = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    return np.where(inside, np.minimum(least, across), least)


def _from_segment(point: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    d = q - p
    t = np.clip(((point - p) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-30), 0, 1)
    return np.linalg.norm(p + t[..., None] * d - point, axis=-1)


def _turns(axis: Float[np.ndarray, "3"], angle: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 4 4"]:
    """Return rotations about an axis, by Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] += np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)
    return T


def _pose(position: np.ndarray, quaternion: np.ndarray) -> Float[np.ndarray, "4 4"]:
    matrix, T = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(matrix, quaternion)
    T[:3, :3], T[:3, 3] = matrix.reshape(3, 3), position
    return T
