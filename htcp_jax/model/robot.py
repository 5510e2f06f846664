"""The robot: a serial arm with capsules around its links.

Each joint moves one link. The link's frame lies on the joint's axis, and bodies fixed to the link, including tools,
belong to it. A Robot consists of plain arrays, read once from a model file (`io.robots`); kinematics.py needs nothing
else.

The chain's root carries the part. It is the world, unless the part moves: on a positioner, or in the arm's gripper. The
root is then the part's link, and objects fixed in the workshop are fixed to a link of the chain. Everywhere else in
this package "world" means the root's frame; `Robot.world` is the workshop's frame.
"""

import dataclasses
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.model.convex_piece import BodyPieces
from htcp_jax.model.coupling import Coupling
from htcp_jax.notebook import html_facts
from htcp_jax.pytree import LABEL, STRUCTURE, register_pytree
from htcp_jax.types import Anywhere, Array, Bool, Float, Int, Joints, Pose, Scalar, Triple

FAR_M = 1e6  # distance between bodies that are not tested against each other
BODIES = 8  # programs are compiled for a multiple of this number of bodies,
MORE_BODIES = 24  # and for at least this number for an arm with more than six joints and more than BODIES bodies
PREPARED_BODIES = {6: 16, 7: MORE_BODIES, 8: MORE_BODIES}  # most bodies that `htcp prepare` compiles for, by joints
TOUCHING_M = 1e-3  # allowed overlap of meshes that touch by design
_STATIC = {"static": True}


class ArmFrame(NamedTuple):
    """The frame of a site or a body of the model."""

    name: str
    link: int | None  # link to which the frame is fixed, -1 for the world; None: the TCP's own frame
    origin_m: Triple  # in the frame of the link
    columns: tuple[Triple, Triple, Triple]  # the frame's axes x, y, z in the frame of the link


WORLD = ArmFrame("world", -1, (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


class Exclusion(NamedTuple):
    """A pair of capsules, by their indices, that is not checked for collision, and the reason."""

    first: int  # farther from the base than the second
    second: int
    rule: str  # rule of `clearance.obstacles.self_exclusions`: a, b, c or d
    share: float  # share of the sampled configurations in which the capsules (nearly) overlap [1]; 0 by rule a


@runtime_checkable
class VendorMeshes(Protocol):
    """Protocol of the vendor's meshes in an arm's capsules; objects read from the same files are equal."""

    def deepest_m(self, first: str, second: str, x: Float[np.ndarray, "N"]) -> float:
        """Return the depth of the deepest contact between the meshes in two capsules [m]; 0 without meshes.

        Args:
            first: Name of a capsule.
            second: Name of another capsule.
            x: The configuration [rad or m].
        """

    def outside_m(
        self, capsule: str, robot: "Robot", x: Float[np.ndarray, "N"], point: Float[np.ndarray, "3"]
    ) -> float | None:
        """Return the distance of a point from the mesh in a capsule [m]; None without a mesh.

        Args:
            capsule: Name of the capsule.
            robot: The robot.
            x: The configuration [rad or m].
            point: The point, in the world [m].
        """


@register_pytree
@dataclasses.dataclass(frozen=True)
class Robot:
    """An arm of J hinge or slide joints, moved by N coordinates x, with K capsules, in metres and radians.

    The frame of link i is the frame of joint i after its motion: its origin lies on the joint's axis, and at
    q = 0 it is T_parent_joint[i] in the frame of link i - 1 (of the world for i = 0). Unless joints follow others, see
    `coupling`, the joints are the coordinates: J = N and q = x.
    """

    T_parent_joint: Float[Array, "J 4 4"]  # joint i's frame at q = 0, in its parent link
    axis: Float[Array, "J 3"]  # unit, in the joint's own frame
    T_link_tcp: Pose  # in the link `tcp_link`; z points out of the tool
    lower: Joints  # [rad or m], -inf where the model sets no limit
    upper: Joints  # [rad or m], inf where the model sets no limit
    speed: Joints  # [rad/s or m/s], inf where the model sets no limit
    acceleration: Joints  # [rad/s2 or m/s2], inf where the model sets no limit
    effort: Joints  # [N m or N], inf where the model sets no limit
    capsule_p: Float[Array, "K 3"]  # first ends of the axes, in the frame of the capsule's link [m]
    capsule_q: Float[Array, "K 3"]  # second ends [m]; a sphere has p == q
    capsule_radius: Float[Array, "K"]  # [m]
    on_tool: Float[Array, "K 2"]  # 1 where the end p, q moves with the tool's tip, see lengthen_tool
    name: str = dataclasses.field(metadata=LABEL)
    joint_names: tuple[str, ...] = dataclasses.field(metadata=LABEL)  # of the coordinates
    slides: tuple[bool, ...] | Bool[Anywhere, "J"] = dataclasses.field(
        metadata=STRUCTURE
    )  # of the J joints; in programs an array
    capsule_names: tuple[str, ...] = dataclasses.field(metadata=LABEL)
    capsule_link: tuple[int, ...] | Int[Anywhere, "K"] = dataclasses.field(
        metadata=STRUCTURE
    )  # -1 is the world; in programs an array
    ignored_geoms: tuple[str, ...] = dataclasses.field(metadata=LABEL)  # for contact, no capsule or sphere
    exclusions: tuple[Exclusion, ...] = dataclasses.field(default=(), metadata=LABEL)  # pairs that the model excludes
    # True: `exclusions` is complete, except for pairs with a capsule of `mounted`
    listed: bool = dataclasses.field(default=False, metadata=_STATIC)
    # groups of capsules; within each group `exclusions` is complete
    listed_together: tuple[tuple[int, ...], ...] = dataclasses.field(default=(), metadata=LABEL)
    mounted: tuple[int, ...] = dataclasses.field(default=(), metadata=LABEL)  # capsules of the job: tool, fixtures
    attached: tuple[int, ...] = dataclasses.field(default=(), metadata=_STATIC)  # capsules of fixtures on moving links
    pieces: BodyPieces | None = None  # convex pieces of the meshes in the capsules; None: only capsules are checked
    meshes: VendorMeshes | None = dataclasses.field(default=None, metadata=LABEL)  # None: the arm's file has none
    frames: tuple[ArmFrame, ...] = dataclasses.field(default=(), metadata=LABEL)  # frames that a task may name
    # frames that are fixed to the chain's root, link -1
    base_frames: tuple[ArmFrame, ...] = dataclasses.field(default=(), metadata=LABEL)
    # the workshop's frame; on a link of the chain if the part moves
    world: ArmFrame = dataclasses.field(default=WORLD, metadata=_STATIC)
    omitted: tuple[str, ...] = dataclasses.field(default=(), metadata=LABEL)  # links that move and have no capsules
    coupling: Coupling | None = None  # None: no joint follows another, J = N, and the links are one chain
    # names of coordinates that move only before the path and between seams
    indexed: frozenset[str] = dataclasses.field(default=frozenset(), metadata=LABEL)

    @property
    def dof(self) -> int:
        """Number of coordinates, N."""
        return len(self.joint_names)

    @property
    def sliding(self) -> tuple[bool, ...]:
        """True for coordinates that are sliding joints."""
        return tuple(self.slides) if self.coupling is None else self.coupling.slides

    @property
    def body_links(self) -> Int[Anywhere, "K"]:
        """The link of each body, -1 for the world; on the host, except in programs."""
        return np.array(self.capsule_link, int) if isinstance(self.capsule_link, tuple) else self.capsule_link

    @property
    def hinges(self) -> Bool[Anywhere, "J"]:
        """True for joints that are hinges; on the host, except in programs."""
        return ~(np.array(self.slides) if isinstance(self.slides, tuple) else self.slides)

    @property
    def parents(self) -> tuple[int, ...]:
        """The link that carries each joint; -1 is the world."""
        return tuple(range(-1, len(self.slides) - 1)) if self.coupling is None else self.coupling.parents

    @property
    def tcp_link(self) -> int:
        """The link that carries the TCP, the last one of the chain."""
        return len(self.slides) - 1 if self.coupling is None else self.coupling.tcp_link

    @property
    def root_links(self) -> tuple[int, ...]:
        """The links that joints connect to the chain's root: the first one, and those of side branches there."""
        return tuple(link for link, parent in enumerate(self.parents) if parent < 0)

    @property
    def all_joint_names(self) -> tuple[str, ...]:
        """Names of the J joints, of which `joint_names` are those of the coordinates."""
        return self.joint_names if self.coupling is None else self.coupling.joint_names

    @property
    def followers(self) -> tuple[int, ...]:
        """Indices of the joints that follow others."""
        return tuple(j for j, name in enumerate(self.all_joint_names) if name not in self.joint_names)

    @property
    def counted_joints(self) -> str:
        """The number of coordinates as text; if joints follow others, with the names of both."""
        followers = ", ".join(self.all_joint_names[j] for j in self.followers)
        return f"{self.dof} joints" + (followers and f" ({', '.join(self.joint_names)}; {followers} follow them)")

    @property
    def part_moves(self) -> bool:
        """True if the chain's root is the part's link; bodies fixed to the root are never tested against the part."""
        return self.world != WORLD

    @property
    def part_link(self) -> str | None:
        """Name of the link that carries the part; None if the part does not move."""
        return next(frame.name for frame in self.base_frames if not any(frame.origin_m)) if self.part_moves else None

    def __repr__(self) -> str:
        return f"Robot({self.name}: {self.dof} joints, {len(self.capsule_names)} capsules)"

    def _repr_html_(self) -> str:
        limits = zip(self.joint_names, self.lower.tolist(), self.upper.tolist(), self.sliding, strict=True)
        radii = zip(self.capsule_names, self.capsule_radius.tolist(), strict=True)
        facts = {name: f"{low:.4g} to {high:.4g} {'m' if slides else 'rad'}" for name, low, high, slides in limits}
        facts["capsules"] = ", ".join(f"{name} ({1e3 * radius:.0f} mm)" for name, radius in radii)
        if self.ignored_geoms:
            facts["ignored geoms"] = ", ".join(self.ignored_geoms)
        if self.omitted:
            facts["omitted links"] = ", ".join(self.omitted)
        return html_facts(f"{self.name}: {len(self.joint_names)} joints", facts)


def carrier_of(robot: Robot, name: str) -> ArmFrame:
    """Return the frame to which a fixture may be fixed, by its name: the world, a link or a site.

    Raises:
        InputError: For an unknown name.
    """
    known = {frame.name: frame for frame in (*robot.base_frames, *robot.frames, robot.world)}
    if name not in known:
        raise InputError(f"no link {name!r} on {robot.name}; valid: {', '.join(sorted(known))}")
    return known[name]


def for_programs(robot: Robot, closely: bool = False) -> Robot:
    """Return a robot whose structure is data in compiled functions, with padding up to one of few numbers of bodies.

    Padding is the first body again, with the radius -FAR_M, so that it is far from everything.

    Args:
        robot: A robot without labels in which no joint follows another.
        closely: True for little padding.
    """
    bodies, step = len(robot.capsule_link), BODIES // 2 if closely else BODIES
    count = -(-bodies // step) * step
    count = max(count, MORE_BODIES) if robot.dof > 6 and bodies > BODIES and not closely else count
    is_body = np.arange(count) < bodies
    taken = np.where(is_body, np.arange(count), 0)
    p, q, radius, on_tool = (
        np.asarray(each)[taken] for each in (robot.capsule_p, robot.capsule_q, robot.capsule_radius, robot.on_tool)
    )
    pieces = robot.pieces
    if pieces is not None:
        pieces = jax.tree.map(lambda leaf: np.asarray(leaf)[taken], pieces)
        pieces = pieces._replace(excess_m=np.where(is_body, pieces.excess_m, 0.0))
    data = {
        "capsule_p": p,
        "capsule_q": q,
        "capsule_radius": np.where(is_body, radius, -FAR_M),
        "on_tool": np.where(is_body[:, None], on_tool, 0.0),
        "slides": np.array(robot.slides),
        "capsule_link": robot.body_links[taken],
        "pieces": pieces,
    }
    unread = {"capsule_names": ("",) * count, "ignored_geoms": (), "omitted": (), "listed": False}
    found: Robot = dataclasses.replace(robot, **{**jax.device_put(data), **unread})
    return found


def core_radius(robot: Robot) -> Float[Array, "K"]:
    """Return the largest radii (K,) at which the capsules certainly lie within the bodies [m]; may be negative.

    The result is the capsules' radii. If the robot has pieces, `excess_m` is subtracted: a piece's support function is
    no smaller than the capsule's minus the excess.
    """
    return robot.capsule_radius if robot.pieces is None else robot.capsule_radius - robot.pieces.excess_m


def radius_to_workpiece(robot: Robot) -> Float[Array, "K"]:
    """Return the capsules' radii (K,) for clearances to the workpiece [m]; -FAR_M for capsules that are not tested."""
    if not robot.part_moves:
        return robot.capsule_radius
    return jnp.where(jnp.asarray(robot.capsule_link) < 0, -FAR_M, robot.capsule_radius)


def capsule_label(robot: Robot, name: str) -> str:
    """Return the name for a message of a capsule, or of the part of a mesh whose convex piece is checked.

    The label of a numbered capsule, such as capsule3, is its link's name if the link has one. If the link has several
    capsules, the capsule's own name follows in brackets. The label of a part of a mesh is its own name, after its
    link's unless it begins with that.
    """
    has_piece = _has_piece(robot, name)
    if not (name.startswith("capsule") or has_piece):
        return f"capsule {name}"
    link = robot.capsule_link[robot.capsule_names.index(name)]
    own = tuple(frame.name for frame in robot.frames if frame.link == link and not any(frame.origin_m))
    if not own or name.startswith(own):
        return name
    return f"{own[0]} ({name})" if has_piece or robot.body_links.tolist().count(link) > 1 else own[0]


def mesh_note(
    robot: Robot,
    capsule: str,
    other: str,
    x: Float[np.ndarray, "N"],
    points: Float[np.ndarray, "2 3"],
    by_piece: bool,
) -> str:
    """Return the end of a collision message: how closely the bodies that were measured follow the vendor's meshes.

    Args:
        robot: The robot.
        capsule: Name of the capsule.
        other: Name of the obstacle; in a self-collision the label of the other capsule.
        x: The configuration [rad or m].
        points: The nearest points on the surfaces of the capsule and of the obstacle, in the world [m].
        by_piece: True if the clearance was measured to the convex piece in the capsule.

    Returns:
        The end of the message; "" if the arm's file refers to no mesh for these capsules.
    """
    names = [capsule, *(name for name in robot.capsule_names if capsule_label(robot, name) == other)]
    if by_piece:
        measured = " and ".join(name for name in names if _has_piece(robot, name))
        return f"; measured to the convex piece of the mesh in {measured}"
    if robot.meshes is None:
        return ""
    known = [
        f"{1e3 * gap:.3g} mm below the capsule's surface in {name}"
        for name, point in zip(names, points, strict=False)
        if (gap := robot.meshes.outside_m(name, robot, x, point)) is not None
    ]
    return f"; the mesh itself is there {' and '.join(known)}" if known else ""


def checked_pieces(robot: Robot) -> dict[int, tuple[Float[np.ndarray, "V 3"], float]]:
    """Return the convex pieces that are checked, by capsule: vertices in the link's frame and radius about them [m]."""
    if robot.pieces is None:
        return {}
    vertices, radius = np.asarray(robot.pieces.piece.vertices), np.asarray(robot.pieces.piece.radius)
    has_piece = np.flatnonzero(np.asarray(robot.pieces.excess_m) > 0).tolist()
    return {k: (vertices[k], float(radius[k])) for k in has_piece}


def _has_piece(robot: Robot, name: str) -> bool:
    return robot.capsule_names.index(name) in checked_pieces(robot)


def lengthen_tool(robot: Robot, extension_m: float | Scalar) -> Robot:
    """Return the robot with its tool longer by `extension_m` [m] along the tool's z axis; negative shortens.

    The TCP moves, and with it the capsules of the body that carries it. The first of these capsules keeps its end at
    the flange and is lengthened. Unless the extension is 0, capsules that move lose their convex pieces. JAX may trace
    the extension.
    """
    shift = extension_m * robot.T_link_tcp[:3, 2]
    ends = robot.on_tool[:, :, None] * shift[None, None, :]
    pieces = robot.pieces
    if pieces is not None:
        moved = (robot.on_tool != 0).any(axis=1) & (jnp.asarray(extension_m) != 0)
        pieces = pieces._replace(excess_m=jnp.where(moved, 0.0, pieces.excess_m))
    return dataclasses.replace(
        robot,
        T_link_tcp=robot.T_link_tcp + jnp.pad(shift[:, None], ((0, 1), (3, 0))),
        capsule_p=robot.capsule_p + ends[:, 0],
        capsule_q=robot.capsule_q + ends[:, 1],
        pieces=pieces,
    )
