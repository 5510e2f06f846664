"""The arm in MuJoCo, for validation: poses, capsules and distances are computed by MuJoCo only.

The code is independent of the planner's (robot.py, kinematics.py, clearance.py and their imports). It implements the
rules for a model file (the TCP's site, a longer tool, the limits) a second time.

If the part moves, MuJoCo computes the kinematics from the world, as the cell is modelled. The results are then
transformed to the frame of the part's link, which replaces the world frame.
"""

import copy
import math
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.robots import LinkMeshes, read_joint_limits, read_model
from htcp_jax.spec import Tool, is_limits_file, model_source
from htcp_jax.spec import tool as tools
from htcp_jax.types import Triple
from htcp_jax.validation.convex_hull import Hull, hull_in_capsule, read_hulls
from htcp_jax.validation.following import Following

PROBE_M = 1e-9  # radius of the sphere that represents a point; `distances` adds it
FAR_M = 1e3  # cut-off of MuJoCo's distances
_PART = "link of the part"
_PROBE, _TCP = "probe of htcp validate", "TCP of htcp validate"
_SPHERE, _CAPSULE = mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE
_OWN_FRAME = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)  # without this value MuJoCo may ignore a changed position
_HINGE = mujoco.mjtJoint.mjJNT_HINGE


class ArmPoses(NamedTuple):
    """TCP, ends p and q of the K capsules' axes, and orientations of the capsules, at n configurations; world [m]."""

    tcp: Float[np.ndarray, "n 3"]
    p: Float[np.ndarray, "n K 3"]
    q: Float[np.ndarray, "n K 3"]
    axes: Float[np.ndarray, "n K 3 3"]


class MujocoArm:
    """An arm's model file in MuJoCo, with a job's base and tool, and a movable probe that measures distances to points.

    `names`, `radius` [m] and `length` (of the axis) [m] describe the K capsules and spheres. `lower`, `upper` and
    `speed` are the joints' limits, in the order from the world (or a moving part) to the TCP; `speed` is inf if the
    model has no velocity limits. `root` is the body that carries the part, 0 for the world. `hulls` contains the convex
    piece in each capsule, in the capsule's frame; None for a capsule without a piece.

    Args:
        path: The model file, or the models that form a cell.
        tool_extension_m: Length added to the tool [m].
        limits: The profile or file of joint limits, as in `robots.load_robot`.
        tcp: The name of the TCP's site or body, `tcp_site` in `robots.load_robot`.
        base_m: Position of the model's frame in the world [m].
        base_rpy_rad: Rotation of the model's frame about world x, then y, then z [rad].
        tool: The job's tool; None: the tool in the model. With a tool, the frame `tcp` is the flange.
        locked: Values of locked joints, by name [rad or m].
        pieces: False to ignore convex pieces in the file.

    Raises:
        InputError: If MuJoCo cannot read the file, or if its convex pieces are invalid.
    """

    def __init__(
        self,
        path: model_source.ModelSource,
        tool_extension_m: float = 0.0,
        limits: str = "model",
        *,
        tcp: str = "tcp",
        base_m: Triple = tools.ZERO,
        base_rpy_rad: Triple = tools.ZERO,
        tool: Tool | None = None,
        locked: Mapping[str, float] | None = None,
        pieces: bool = True,
    ):
        spec = read_model(path)
        self._source, self._locked = path, locked or {}
        self._list, self._listed_together = _list(spec), _listed_together(spec)
        self._mounted = {body.name for body in tool.bodies} if tool else set()
        self._model, self._site = _compile(path, tcp, tool)
        self._probe = self._model.geom(_PROBE).id
        self._geoms = np.array([g for g in range(self._model.ngeom) if g != self._probe])
        self.hulls = _hulls(self._model, self._geoms, read_hulls(spec, model_source.label_of(path)) if pieces else {})
        if any((*base_m, *base_rpy_rad)):
            _move_base(self._model, self._geoms, base_m, base_rpy_rad)
        self._data = mujoco.MjData(self._model)
        self.root = _part_body(spec, self._model)
        fixed = {_joint_name(self._model, j): j for j in range(self._model.njnt)}
        fixed = {fixed[name]: value for name, value in self._locked.items()}
        self._data.qpos[list(fixed)] = list(fixed.values())
        moving = _joint_order(self._model, self.root, fixed)
        follow = Following.of(self._model, self._data, moving, fixed)
        self._order, self._follow = follow.free, follow
        carrier = int(self._model.site_bodyid[self._site])
        self._moves = _moves(self._model, self.root, follow.moving)
        chain = follow.moving[self._moves[carrier]]
        if tool_extension_m:
            own = _link_numbers(self._moves, carrier) if self.root else None
            moved = _lengthen(self._model, self._site, self._geoms, tool_extension_m, int(chain[-1]), own)
            self.hulls = tuple(
                None if g in moved else hull for g, hull in zip(self._geoms.tolist(), self.hulls, strict=True)
            )
        self.names = tuple(self._model.geom(g).name or f"geom {g}" for g in self._geoms)
        self.radius = self._model.geom_size[self._geoms, 0].copy()
        self._half = np.where(self._model.geom_type[self._geoms] == _CAPSULE, self._model.geom_size[self._geoms, 1], 0)
        self.length = 2 * self._half
        self.joints = tuple(_joint_name(self._model, j) for j in self._order.tolist())
        lower, upper = (limit[follow.moving] for limit in _limits_of_profile(self._model, limits))
        if is_limits_file(limits):
            slides = (self._model.jnt_type[follow.moving] != _HINGE).tolist()
            names = tuple(_joint_name(self._model, j) for j in follow.moving.tolist())
            stated = read_joint_limits(limits, names, model_source.label_of(path).name)
            lower, upper = stated.ranges(slides, lower, upper)
        self.lower, self.upper = follow.limits(lower, upper)
        self.speed = follow.speeds(_numeric(self._model, "speed", math.inf)[follow.moving])
        self._pose(np.zeros(len(self._order)))
        self._link_numbers = _link_numbers(self._moves, carrier)
        # number of each capsule's link; 0: fixed to the world or the part
        self.links = links = self._link_numbers[self._model.geom_bodyid[self._geoms]]
        ends = self._ends()
        self.base = np.vstack([self._data.xanchor[chain[:1]], *ends[:, links == 0]])  # fixed points, world [m]
        last = links[links <= len(chain)].max()
        away = np.where(links == last, np.linalg.norm(ends - self._data.site_xpos[self._site], axis=2), np.inf)
        self._tip = np.unravel_index(away.argmin(), away.shape)

    @property
    def apart(self) -> list[tuple[int, int]]:
        """Pairs of capsules on different links."""
        count = range(len(self.names))
        return [(a, b) for a in count for b in count if self.links[a] > self.links[b]]

    @property
    def excluded(self) -> set[tuple[int, int]]:
        """Pairs of capsules whose contact the file excludes."""
        bodies = self._model.geom_bodyid[self._geoms].tolist()
        excluded = {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in self._model.exclude_signature}
        return {(a, b) for a, b in self.apart if {(bodies[a], bodies[b]), (bodies[b], bodies[a])} & excluded}

    @property
    def stated(self) -> dict[tuple[int, int], str]:
        """Rules by which the model files' lists exclude pairs, by pair.

        The result is empty if the joint limits are wider than those for which the lists were computed.
        """
        if not self._within_model:
            return {}
        numbers = {name: k for k, name in enumerate(self.names)}
        pairs = (([numbers[name] for name in names], rule) for names, rule in self._list or ())
        return {tuple(sorted(pair, key=lambda k: -self.links[k])): rule for pair, rule in pairs}

    def is_listed(self, pair: tuple[int, int]) -> bool:
        """Return True if a model file's list covers a pair: the arm's, or a cell model's that contains both bodies."""
        if self._list is None or not self._within_model:
            return False
        together, names = self._listed_together, {self.names[k] for k in pair}
        return together is None or any(names <= own for own in together)

    @property
    def _within_model(self) -> bool:
        """True if no joint limit is wider than in the model."""
        limits = (limit[self._follow.moving] for limit in _limits_of_profile(self._model, "model"))
        lower, upper = self._follow.limits(*limits)
        return not ((self.lower < lower).any() or (self.upper > upper).any())

    @cached_property
    def meshes(self) -> LinkMeshes | None:
        """Vendor meshes to which the arm's file refers; None if the file has no list of pairs."""
        return None if self._list is None else LinkMeshes.read(self._source, self._locked)

    def random(self, count: int, seed: int) -> Float[np.ndarray, "n N"]:
        """Return random configurations within the joint limits; without limits, within pi rad or 1 m of zero."""
        free = np.where(self._model.jnt_type[self._order] == _HINGE, math.pi, 1.0)
        lower = np.where(np.isfinite(self.lower), self.lower, -free)
        upper = np.where(np.isfinite(self.upper), self.upper, free)
        return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))

    def is_tool(self, pair: tuple[int, int]) -> bool:
        """Return True if one of a pair's capsules belongs to the job's tool."""
        return any(self.names[k] in self._mounted for k in pair)

    def adjacent(self, pair: tuple[int, int]) -> bool:
        """Return True if exactly one joint lies between the capsules of a pair."""
        return len(self._joints_between(pair)) == 1

    def slides(self, pair: tuple[int, int]) -> bool:
        """Return True if the capsules of a pair are adjacent and the joint between them is prismatic."""
        between = self._joints_between(pair)
        return len(between) == 1 and bool(self._model.jnt_type[between[0]] != _HINGE)

    def _joints_between(self, pair: tuple[int, int]) -> Int[np.ndarray, "n"]:
        first, second = self._moves[self._model.geom_bodyid[self._geoms[list(pair)]]]
        return self._follow.moving[first != second]

    def same_links(self, pair: tuple[int, int], other: tuple[int, int]) -> bool:
        """Return True if two pairs of capsules belong to the same two links."""
        return all(self.links[a] == self.links[b] for a, b in zip(pair, other, strict=True))

    def only(self, which: Bool[np.ndarray, "K"]) -> "MujocoArm":
        """Return the arm with only the capsules for which `which` is True."""
        own = copy.copy(self)
        own._geoms, own._half, own.links = self._geoms[which], self._half[which], self.links[which]
        own.radius, own.length = self.radius[which], self.length[which]
        own.names = tuple(np.array(self.names)[which].tolist())
        own.hulls = tuple(self.hulls[k] for k in np.flatnonzero(which))
        return own

    def beside_workpiece(self) -> "MujocoArm":
        """Return the arm for distances from the workpiece, without the capsules that are fixed to a moving part."""
        if not self.root:
            return self
        own, away = copy.copy(self), self.links == 0
        own.radius = np.where(away, -FAR_M, self.radius)
        own.hulls = tuple(None if apart else hull for hull, apart in zip(self.hulls, away, strict=True))
        return own

    def arm_poses(self, x: Float[np.ndarray, "n N"]) -> ArmPoses:
        """Return the TCP and the capsules at n configurations, by MuJoCo's kinematics."""
        tcp, ends = np.empty((len(x), 3)), np.empty((2, len(x), len(self._geoms), 3))
        axes = np.empty((len(x), len(self._geoms), 3, 3))
        for k, row in enumerate(x):
            self._pose(row)
            tcp[k] = self._data.site_xpos[self._site]
            ends[:, k] = self._ends()
            axes[k] = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        return ArmPoses(tcp, *ends, axes)

    def link_of(self, name: str) -> int:
        """Return the number of the link of a named site or body, or of the world; 0 for the world or a moving part."""
        site = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
        body = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, name)
        if site < 0 and body < 0:
            raise InputError(f"no site or body {name!r} in the model")
        return int(self._link_numbers[self._model.site_bodyid[site] if site >= 0 else body])

    def frames(
        self, x: Float[np.ndarray, "n N"], name: str, tip: bool = True
    ) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
        """Return a frame's origins [m] and axes in the world at n configurations.

        Args:
            x: Configurations [rad or m].
            name: "tcp" for the TCP's frame, or the name of a site or body in the model.
            tip: True if "tcp" is the tip of the job's tool; False if it is the model's site or body.

        Raises:
            InputError: If the model has no site or body of that name.
        """
        site = self._site if name == "tcp" and tip else mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_SITE, name)
        body = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_BODY, name)
        if site < 0 and body < 0:
            raise InputError(f"no site or body {name!r} in the model")
        data = self._data
        own = (data.site_xpos[site], data.site_xmat[site]) if site >= 0 else (data.xpos[body], data.xmat[body])
        origin, rotation = np.empty((len(x), 3)), np.empty((len(x), 3, 3))
        for k, row in enumerate(x):
            self._pose(row)
            origin[k], rotation[k] = own[0], own[1].reshape(3, 3)
        return origin, rotation

    def tip_start(self, arm_poses: ArmPoses) -> Float[np.ndarray, "n 3"]:
        """Return the start of the bare tip, world [m]: of the last link's capsule ends, the one nearest to the TCP."""
        end, body = self._tip
        return (arm_poses.p, arm_poses.q)[end][:, body]

    def distances(
        self, x: Float[np.ndarray, "N"], capsules: Int[np.ndarray, "c"], points: Float[np.ndarray, "c 3"]
    ) -> Float[np.ndarray, "c"]:
        """Return the signed distance of each point from the surface of its capsule [m], by mj_geomDistance.

        Args:
            x: The configuration [rad or m].
            capsules: Index of each point's capsule.
            points: The points, world [m].
        """
        self._pose(x)
        found = np.empty(len(points))
        for k, (geom, point) in enumerate(zip(self._geoms[capsules].tolist(), points, strict=True)):
            self._data.geom_xpos[self._probe] = point
            found[k] = mujoco.mj_geomDistance(self._model, self._data, geom, self._probe, FAR_M, None)
        return found + PROBE_M

    def _ends(self) -> Float[np.ndarray, "2 K 3"]:
        reach = self._half[:, None] * self._data.geom_xmat[self._geoms, 2::3]  # the z axis is a capsule's axis
        return self._data.geom_xpos[self._geoms] + np.stack([reach, -reach])

    def _pose(self, x: Float[np.ndarray, "N"]) -> None:
        data = self._data
        data.qpos[self._follow.moving] = self._follow.positions(x)
        mujoco.mj_kinematics(self._model, data)
        if self.root:  # transform to the part's frame
            origin, rotation = data.xpos[self.root].copy(), data.xmat[self.root].reshape(3, 3).copy()
            for points in (data.xpos, data.geom_xpos, data.site_xpos, data.xanchor):
                points[:] = (points - origin) @ rotation
            for axes in (data.xmat, data.geom_xmat, data.site_xmat):
                axes[:] = (rotation.T @ axes.reshape(-1, 3, 3)).reshape(-1, 9)


def _compile(path: model_source.ModelSource, tcp: str, tool: Tool | None) -> tuple[mujoco.MjModel, int]:
    """Return a model whose geoms are only capsules, spheres, the tool's bodies and the probe, and its TCP site."""
    spec = read_model(path)
    try:
        for geom in list(spec.geoms):
            if geom.type not in (_SPHERE, _CAPSULE):
                spec.delete(geom)
        for each in [*spec.meshes, *spec.tuples]:
            spec.delete(each)
        spec.worldbody.add_geom(name=_PROBE, type=_SPHERE, size=[PROBE_M, 0, 0])
        spec.compiler.fusestatic = False  # keep a URDF's fixed links, one of which may be the TCP
        spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9  # MuJoCo requires masses
        spec.compiler.balanceinertia = True
        model = spec.compile()
        body, position, quaternion = _flange(model, tcp)
        flange = next(one for one in spec.bodies if one.id == body)
        if tool is not None:
            if tool.bodies:  # the tool is a separate body, as other geoms on the flange do not belong to it
                flange = flange.add_body(pos=position, quat=quaternion)
                position, quaternion = np.zeros(3), np.array([1.0, 0, 0, 0])
            for part in tool.bodies:
                _add_capsule_geom(flange, part.name, part.p_m, part.q_m, part.radius_m)
            position, quaternion = _composed(position, quaternion, np.array(tool.tip_m), _quaternion(tool.tip_rpy_rad))
        flange.add_site(name=_TCP, pos=position, quat=quaternion)
        model = spec.compile()
        return model, model.site(_TCP).id
    except (ValueError, OSError, mujoco.FatalError) as error:
        label = model_source.label_of(path)
        raise InputError(f"{label}: not a model that MuJoCo can read: {' '.join(str(error).split())}") from None


def _list(spec: mujoco.MjSpec) -> list[tuple[tuple[str, ...], str]] | None:
    """Return the capsule pairs, with rules, in the lists that `htcp robot` writes into models; None without a list."""
    if not spec.tuples and not any(text.name.startswith("self_collision") for text in spec.texts):
        return None
    return [(tuple(each.objname), each.name[-1]) for each in spec.tuples]


def _listed_together(spec: mujoco.MjSpec) -> list[frozenset[str]] | None:
    """Return the capsule names of each cell model with a list; None if the arm is a single file."""
    if any(text.name == "self_collision" for text in spec.texts):
        return None
    return [frozenset(text.data.split("\n")) for text in spec.texts if text.name.startswith("self_collision of ")]


def _hulls(model: mujoco.MjModel, geoms: np.ndarray, known: Mapping[str, Hull]) -> tuple[Hull | None, ...]:
    """Return the hull in each capsule, in the capsule's frame; None for a capsule without a hull.

    Args:
        model: The model.
        geoms: The capsules' geoms.
        known: Hulls by capsule name, each in its body's frame.
    """
    found = []
    for g in geoms.tolist():
        hull, (radius, half, _) = known.get(model.geom(g).name), model.geom_size[g].tolist()
        half = half if model.geom_type[g] == _CAPSULE else 0.0
        found.append(hull and hull_in_capsule(hull, model.geom_pos[g], model.geom_quat[g], radius, half))
    return tuple(found)


def _flange(model: mujoco.MjModel, name: str) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the body to which a named frame is fixed, and the frame's position and quaternion relative to it."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if site < 0 and body < 0 and model.nsite == 1:
        site = 0
    if site >= 0:
        return int(model.site_bodyid[site]), model.site_pos[site].copy(), model.site_quat[site].copy()
    return body if body >= 0 else _last_body(model), np.zeros(3), np.array([1.0, 0, 0, 0])


def _add_capsule_geom(body: mujoco.MjsBody, name: str, p: tuple, q: tuple, radius: float) -> None:
    if p == q:
        body.add_geom(name=name, type=_SPHERE, pos=p, size=[radius, 0, 0])
    else:
        body.add_geom(name=name, type=_CAPSULE, fromto=[*p, *q], size=[radius, 0, 0])


def _quaternion(rpy: tuple[float, float, float]) -> np.ndarray:
    """Return the quaternion of rotations about the fixed axes x, then y, then z."""
    quaternion = np.empty(4)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy), "XYZ")
    return quaternion


def _composed(
    position: np.ndarray, quaternion: np.ndarray, then_position: np.ndarray, then_quaternion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the product of two poses, as position and quaternion."""
    moved, turned = np.empty(3), np.empty(4)
    mujoco.mju_rotVecQuat(moved, then_position, quaternion)
    mujoco.mju_mulQuat(turned, quaternion, then_quaternion)
    return position + moved, turned


def _move_base(model: mujoco.MjModel, geoms: np.ndarray, position: tuple, rpy: tuple) -> None:
    """Move all bodies and geoms that are fixed to the world, except the probe, to the robot's base pose."""
    base = np.array(position), _quaternion(rpy)
    for body in np.flatnonzero(model.body_parentid == 0)[1:]:  # without the world, which is its own parent
        model.body_pos[body], model.body_quat[body] = _composed(*base, model.body_pos[body], model.body_quat[body])
    for geom in geoms[model.geom_bodyid[geoms] == 0]:
        model.geom_sameframe[geom] = _OWN_FRAME
        model.geom_pos[geom], model.geom_quat[geom] = _composed(*base, model.geom_pos[geom], model.geom_quat[geom])


def _upwards(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield a body and its ancestors up to, but without, the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def _part_body(spec: mujoco.MjSpec, model: mujoco.MjModel) -> int:
    """Return the body that carries the part according to the model file; 0 (the world) if it names none."""
    names = [text.data for text in spec.texts if text.name == _PART]
    return model.body(names[0]).id if names else 0


def _joint_name(model: mujoco.MjModel, j: int) -> str:
    return model.joint(j).name or f"joint{j + 1}"


def _joint_order(model: mujoco.MjModel, root: int, fixed: Collection[int]) -> np.ndarray:
    """Return the joints in the order from the part to the TCP, without locked joints but with those that follow others.

    The joints that move the part's link come first, in reverse order, followed by the others.
    """
    free = [j for j in range(model.njnt) if j not in fixed]
    own = [j for j in free if model.jnt_bodyid[j] in _upwards(model, root)]
    return np.array([*own[::-1], *(j for j in free if j not in own)], int)


def _moves(model: mujoco.MjModel, root: int, joints: np.ndarray) -> Bool[np.ndarray, "B n"]:
    """Return True for joints between the part's link and each body, that is, joints that move only one of them."""
    moving = [np.isin(model.jnt_bodyid[joints], list(_upwards(model, body))) for body in (root, *range(model.nbody))]
    return np.array([moving[0] != own for own in moving[1:]])


def _link_numbers(moves: Bool[np.ndarray, "B n"], carrier: int) -> Int[np.ndarray, "B"]:
    """Return the number of each body's link: of joints to it on the chain to the body `carrier`, then of side branches.

    Args:
        moves: The joints that move each body, see `_moves`.
        carrier: The body of the TCP.
    """
    side = np.unique(moves[(moves & ~moves[carrier]).any(axis=1)], axis=0)
    order = {own.tobytes(): k for k, own in enumerate(side[np.argsort(side.sum(axis=1), kind="stable")])}
    first = moves[carrier].sum() + 1
    return np.array([first + order[own.tobytes()] if own.tobytes() in order else own.sum() for own in moves])


def _joints_below(model: mujoco.MjModel, body: int) -> int:
    """Return the number of joints between the world and a body, including the body's own."""
    return int(model.body_jntnum[list(_upwards(model, body))].sum())


def _last_body(model: mujoco.MjModel) -> int:
    """Return the body with the most joints between it and the world, the last one if there are several."""
    depth = [_joints_below(model, body) for body in range(model.nbody)]
    return max(range(model.nbody), key=lambda body: (depth[body], body))


def _lengthen(
    model: mujoco.MjModel, site: int, geoms: np.ndarray, extension_m: float, last: int, links: np.ndarray | None
) -> list[int]:
    """Move the TCP and the geoms on its body outwards along the tool's z axis, and return these geoms.

    The first capsule on the body becomes longer; its end nearer to the last joint does not move. All poses are computed
    in the world, at the model's zero configuration.

    Args:
        model: The model.
        site: The TCP's site.
        geoms: The arm's geoms.
        extension_m: The length added to the tool.
        last: The last joint.
        links: If the part moves, the number of joints between the part and each body; only bodies on the TCP's link
            are then moved.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    shift = extension_m * data.site_xmat[site, 2::3]
    geoms = geoms.tolist()
    carrier = int(model.site_bodyid[site])
    tool = [g for g in geoms if carrier in (model.geom_bodyid[g], *_upwards(model, int(model.geom_bodyid[g])))]
    if links is not None:
        tool = [g for g in tool if links[model.geom_bodyid[g]] == links[carrier]]
    else:
        tool = tool or [g for g in geoms if model.jnt_bodyid[-1] in _upwards(model, int(model.geom_bodyid[g]))]
    for g in tool:
        half = model.geom_size[g, 1] if model.geom_type[g] == _CAPSULE else 0.0
        along = half * data.geom_xmat[g, 2::3]
        near, far = sorted(
            (data.geom_xpos[g] + along, data.geom_xpos[g] - along), key=lambda end: math.dist(end, data.xanchor[last])
        )
        _put(model, data, g, near if g == tool[0] else near + shift, far + shift)
    model.site_sameframe[site] = _OWN_FRAME
    model.site_pos[site] += data.xmat[model.site_bodyid[site]].reshape(3, 3).T @ shift
    return tool


def _put(model: mujoco.MjModel, data: mujoco.MjData, geom: int, p: np.ndarray, q: np.ndarray) -> None:
    """Set a geom's pose and length so that its axis is from p to q, world [m]."""
    body, length = model.geom_bodyid[geom], math.dist(p, q)
    rotation = data.xmat[body].reshape(3, 3)
    model.geom_sameframe[geom] = _OWN_FRAME
    model.geom_pos[geom] = rotation.T @ ((p + q) / 2 - data.xpos[body])
    if length > 0:
        model.geom_type[geom], model.geom_size[geom, 1] = _CAPSULE, length / 2
        mujoco.mju_quatZ2Vec(model.geom_quat[geom], rotation.T @ (q - p))


def _limits_of_profile(model: mujoco.MjModel, profile: str) -> tuple[np.ndarray, np.ndarray]:
    lower, upper = np.where(model.jnt_limited[:, None], model.jnt_range, [-math.inf, math.inf]).T
    if profile == "simulation":
        hinge = model.jnt_type == _HINGE
        return np.where(hinge, -math.pi, lower), np.where(hinge, math.pi, upper)
    if profile == "datasheet":
        return _numeric(model, "datasheet_lower", math.nan), _numeric(model, "datasheet_upper", math.nan)
    return lower, upper


def _numeric(model: mujoco.MjModel, name: str, default: float) -> np.ndarray:
    """Return the values of a model's <numeric> element, one per joint; `default` for each if there is no element."""
    at = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if at < 0:
        return np.full(model.njnt, default)
    return model.numeric_data[model.numeric_adr[at] :][: model.njnt].copy()
