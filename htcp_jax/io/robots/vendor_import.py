"""Import of a vendor's URDF or MJCF file as an arm of capsules, or as a cell in which the part moves.

The joints on the chain to the TCP move, those that follow them, and those that they follow; all others are frozen.
Capsules enclose the shapes of each body. The chain begins at the world, or at the link that carries the part.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.robots.body_covers import BodyCover, CapsuleFit, cover_body, joined
from htcp_jax.io.robots.capsule_fit import Triangles
from htcp_jax.io.robots.chain import (
    FEWEST_JOINTS,
    Chain,
    chain_between,
    check_joints,
    find_link,
    link_frames,
    with_side_branches,
)
from htcp_jax.io.robots.constraints import check_loops, moved_bodies, omit_text
from htcp_jax.io.robots.fixed_joints import fix_followers, fix_joints
from htcp_jax.io.robots.followers import Follower, followers
from htcp_jax.io.robots.imported_limits import limits_of, write_ranges
from htcp_jax.io.robots.ledger import Ledger
from htcp_jax.io.robots.mujoco_models import (
    FREE,
    body_name,
    compile_spec,
    delete_all,
    is_mocap_alone,
    joint_name,
    massive_bodies,
    model_name,
    text_of,
    upwards,
)
from htcp_jax.io.robots.remarks import OF_IMPORT
from htcp_jax.io.robots.safe_xml import UNUSED, read_spec
from htcp_jax.io.robots.shapes import Geom, Shape, Shapes
from htcp_jax.io.robots.srdf import disabled_pairs
from htcp_jax.io.robots.tcp import Tip, find_tip, other_frames, warn_of_jaw

NOT_OF_AN_ARM = "plane", "hfield", "sdf"
ROUND = "capsule", "sphere"
CLOSE_LINKS = 2  # number of last links whose bodies are fitted within a tolerance


class ImportedArm(NamedTuple):
    """A robot's model as compiled by MuJoCo, without its shapes, and the data of the imported arm."""

    model: mujoco.MjModel
    tip: Tip
    chain: Chain  # chain from the world, or from the part's link, to the TCP, with side branches
    joint_names: tuple[str, ...]  # names of the joints that move by themselves
    followers: dict[int, Follower]  # those of the chain's joints that follow others, by their indices in the model
    frozen: tuple[str, ...]  # names of other joints that are frozen at their initial values
    fixed: dict[str, float]  # other values at which joints are frozen [rad or m], by name
    bodies: tuple[int, ...]  # indices of the robot's bodies in the model, see `_robot_bodies`
    covers: dict[int, BodyCover]  # by the body's index
    massive: tuple[int, ...]  # indices of bodies with an inertia in the file
    numbers: dict[str, Float[np.ndarray, "N"]]  # values of PER_JOINT by name, in the order of the joints in the model
    excluded: tuple[str, ...]  # names of shapes that no capsule represents
    visual: bool  # True if the capsules enclose visual geometry
    shapeless: tuple[str, ...]  # bodies with visual but no collision geometry
    disabled: tuple[tuple[str, str], ...]  # pairs of bodies that an SRDF excludes from self-collision checks
    unused: tuple[str, ...]  # elements and attributes that were not used, with their numbers, see `ledger`
    # links with omitted shapes: moved by followers or loops, or on the chain to the TCP and without other capsules
    omitted: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the model."""
        return model_name(self.model)

    @property
    def part(self) -> str | None:
        """Name of the link that carries the part; None if it is the world."""
        return self.model.body(self.chain.root).name if self.chain.root else None


def import_robot(
    path: Path,
    tcp: str | None = None,
    *,
    part: str | None = None,
    omit: Sequence[str] = (),
    most: int | None = None,
    tolerance_m: float | None = None,
    visual: bool = False,
    srdf: Path | None = None,
    fixed: Mapping[str, float] | None = None,
    fewest: int = FEWEST_JOINTS,
    limits: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, count: None,
) -> ImportedArm:
    """Read a URDF or MJCF file with its meshes.

    Args:
        path: The file.
        tcp: Name of the TCP's site or body; None: see `tcp.find_tip`.
        part: Name of the link that carries the part; None: the world.
        omit: Links whose shapes are not enclosed, such as a link that represents the part.
        most: Maximum number of fitted capsules per body; None: see `tolerance_m`.
        tolerance_m: Tolerance of a closer fit, see `close_fit.cover_closely`. It applies to bodies on the last two
            links, including the tool, with at most close_fit.MOST_CLOSE capsules each; other bodies have at most
            close_fit.MOST capsules. None: at most capsule_fit.MOST capsules per body.
        visual: True to enclose the visual geometry. False: the collision geometry, or the visual geometry of an MJCF
            file without collision geometry.
        srdf: SRDF file with excluded pairs of links, see `disabled_pairs`.
        fixed: Values [rad or m], by joint name, of joints to freeze, on the chain to the TCP or off it.
        fewest: Minimum number of joints; 1 for a positioner or a rail.
        limits: File with limits of moving joints that replace the model's, see `read_joint_limits`.
        progress: Function that is called with the number of finished bodies and their total.

    Raises:
        InputError: For a file or a mesh that cannot be read, a missing or ambiguous TCP, an unknown link of the part or
            one without a joint between it and the TCP, ball and free joints on the chain, too few joints, more than
            nine joints if the part moves, a joint without a range, a model without shapes, the SRDF file of another
            robot, an unknown joint, a follower or a value beyond its limits in `fixed`, a tolerance out of range, and
            couplings and loops that are not supported, see `check_joints` and `_moved_joints`.
    """
    fit = CapsuleFit(most, tolerance_m)
    spec, shapes, model = _read_model(path, visual)
    values = fix_joints(model, path, fixed or {})
    tip = find_tip(model, path, tcp, _robot_bodies(model, ()))
    root = 0 if part is None else find_link(model, path, part, _robot_bodies(model, ()), "--part")
    bodies = _robot_bodies(model, (*upwards(model, tip.body), *upwards(model, root)))
    omitted = {find_link(model, path, name, bodies, "--omit") for name in omit}
    names, in_srdf = [body_name(model, b) for b in bodies], Ledger()
    disabled = disabled_pairs(srdf, model_name(model), names, in_srdf) if srdf else ()
    chain = _moving_chain(model, path, root, tip, values)
    chain = with_side_branches(model, path, chain, values, bodies)
    joints = chain.joints
    geoms = [geom for geom in shapes.geoms if _body_of(model, geom) in bodies]
    chosen = _chosen_geoms(geoms, model, visual)
    own = _enclosed_geoms(model, path, chosen, omitted, geoms, visual)
    hint = other_frames(model, bodies, tip) if root == 0 else ""
    mapped = check_joints(model, path, chain, hint, fewest, OF_IMPORT)
    ranges, numbers = limits_of(model, path, mapped, limits)
    if root == 0:
        warn_of_jaw(model, path, tip, chain.to_tcp)
    frozen = [j for j in range(model.njnt) if j not in (*values, *joints) and model.jnt_bodyid[j] in bodies]
    found = _shapes_of_bodies(own, shapes, model)
    links = [link for link, _ in link_frames(model, np.eye(4), chain).of_bodies]
    moved = _moved_joints(model, path, chain, links, frozen, found)
    hidden = {*moved_bodies(model, moved, sorted(omitted)), *_bare_links(chain, links, omitted, found)}
    hidden &= {_body_of(model, geom) for geom in chosen}
    pairs = {j: each for j, each in followers(model, path).items() if j in joints}
    offset = fix_followers(model, path, frozen, values)
    covers = _covers(found, model, chain, fit, {model.geom(geom.at).name for geom in own}, progress)
    write_ranges(model, path, joints, ranges, numbers)
    return ImportedArm(
        model,
        tip,
        chain,
        tuple(joint_name(model, j) for j in mapped.free),
        pairs,
        frozen=tuple(joint_name(model, j) for j in frozen if j not in offset),
        fixed={joint_name(model, j): value for j, value in sorted((values | offset).items())},
        bodies=bodies,
        covers=covers,
        massive=tuple(b for b in massive_bodies(spec) if b in bodies),
        numbers={name: values[sorted(joints)] for name, values in numbers.items()},
        excluded=tuple(_described(geom, model) for geom in chosen if geom not in own),
        visual=visual,
        shapeless=tuple(body_name(model, b) for b in _shapeless(geoms, chosen, model)),
        disabled=tuple(disabled),
        unused=(*(text_of(model, UNUSED) or "").splitlines(), *in_srdf.lines()),
        omitted=tuple(body_name(model, b) for b in sorted(hidden)),
    )


def _enclosed_geoms(
    model: mujoco.MjModel, path: Path, chosen: list[Geom], omitted: set[int], geoms: list[Geom], visual: bool
) -> list[Geom]:
    """Return those of the chosen geoms that are enclosed; raise InputError if there are none."""
    own = [geom for geom in chosen if not _is_excluded(geom, model) and _body_of(model, geom) not in omitted]
    if not own:
        remedy = "" if visual else "; if the model has only visual geometry, pass --visual to enclose it"
        kinds = ", ".join(sorted({geom.kind for geom in geoms})) or "none"
        raise InputError(f"{path}: no shapes to enclose by capsules; geoms of the model: {kinds}{remedy}")
    return own


def _shapes_of_bodies(geoms: list[Geom], shapes: Shapes, model: mujoco.MjModel) -> dict[int, list[Shape]]:
    """Return the shapes of geoms, by the body's index, in the order of the bodies."""
    bodies = sorted({_body_of(model, geom) for geom in geoms})
    return {b: [shapes.shape(geom, model) for geom in geoms if _body_of(model, geom) == b] for b in bodies}


def _covers(
    shapes: Mapping[int, list[Shape]],
    model: mujoco.MjModel,
    chain: Chain,
    fit: CapsuleFit,
    names: set[str],
    progress: Callable[[int, int], None],
) -> dict[int, BodyCover]:
    """Enclose the shapes of each body in capsules whose names differ from `names`, which is modified."""
    covers, frames = {}, link_frames(model, np.eye(4), chain).of_bodies
    for done, (b, own) in enumerate(shapes.items()):
        progress(done, len(shapes))
        is_close = len(chain.to_tcp) - CLOSE_LINKS <= frames[b][0] < len(chain.to_tcp)
        covers[b] = cover_body(own, body_name(model, b), names, fit, is_close)
    return covers


def _moving_chain(model: mujoco.MjModel, path: Path, root: int, tip: Tip, fixed: Collection[int]) -> Chain:
    """Return the chain from the part's link to the TCP without frozen joints.

    Raises:
        InputError: If the part moves and all joints of the chain are frozen.
    """
    chain = chain_between(model, root, tip.body).without(fixed)
    if root and not chain.joints:
        part, carrier = model.body(root).name, body_name(model, tip.body)
        where = f"both are on link {part!r}" if tip.body == root else f"the TCP is on {carrier!r}"
        raise InputError(f"{path}: no joint between the part's link {part!r} and the TCP {tip.name!r}: {where}")
    return chain


def _moved_joints(
    model: mujoco.MjModel,
    path: Path,
    chain: Chain,
    links: Sequence[int],
    frozen: Sequence[int],
    shaped: Collection[int],
) -> list[int]:
    """Return the joints off the chain that couplings move: side branches, and frozen joints that move no shapes.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        chain: The chain, with its side branches.
        links: The link of each body; -1: the chain's root.
        frozen: The frozen joints.
        shaped: The bodies with shapes.

    Raises:
        InputError: For a frozen joint that moves shapes by a polynomial of a moving joint, or in a loop.
    """
    moving, curved = set(chain.joints), []
    for j, follower in followers(model, path).items():  # masters first
        if j in frozen and follower.master in moving:
            moving.add(j)
            curved.append(j)
            if bodies := moved_bodies(model, [j], shaped):
                names = joint_name(model, j), joint_name(model, follower.master)
                raise InputError(
                    f"{path}: joint {names[0]!r} follows {names[1]!r} by a polynomial; only factor and offset are "
                    f"supported; exclude the links that it moves with {omit_text(model, bodies)}"
                )
    return [*chain.side, *curved, *check_loops(model, path, links, frozen, shaped)]


def _bare_links(chain: Chain, links: Sequence[int], omitted: Collection[int], shaped: Collection[int]) -> list[int]:
    """Return the omitted bodies on links of the chain to the TCP of which no body has shapes."""
    covered = {links[b] for b in shaped}
    return [b for b in omitted if 0 <= links[b] < len(chain.to_tcp) and links[b] not in covered]


def enclosed_triangles(path: Path, visual: bool) -> dict[str, Triangles]:
    """Return the triangles to which `import_robot` fits capsules, by the name of their body, in the body's frame [m].

    Raises:
        InputError: For a file or a mesh that cannot be read.
    """
    _, shapes, model = _read_model(path, visual)
    chosen = [geom for geom in _chosen_geoms(shapes.geoms, model, visual) if not _is_excluded(geom, model)]
    found: dict[str, list[Shape]] = {}
    for geom in chosen:
        found.setdefault(body_name(model, _body_of(model, geom)), []).append(shapes.shape(geom, model))
    return {name: joined([shape for shape in own if shape.capsule is None]) for name, own in found.items()}


def _read_model(path: Path, visual: bool) -> tuple[mujoco.MjSpec, Shapes, mujoco.MjModel]:
    spec = read_spec(path, meshes=True, visual=visual, contacts=True)
    spec.compiler.discardvisual = False
    delete_all(spec, spec.tuples)  # the list in an arm by htcp robot refers to capsules that get other names here
    shapes = Shapes(spec, path)
    return spec, shapes, compile_spec(spec, path)


def chain_text(arm: ImportedArm) -> str:
    """Format the links and joints from the part to the TCP as text: part -a7- link_6 ... base -b1- table."""
    model, words, link = arm.model, [arm.part or "world"], arm.chain.root
    for j in arm.chain.to_tcp:
        link = int(model.jnt_bodyid[j])
        after = int(model.body_parentid[link]) if j in arm.chain.up else link
        words += [f"-{joint_name(model, j)}-", body_name(model, after)]
    return " ".join(words)


def _robot_bodies(model: mujoco.MjModel, on_chain: Sequence[int]) -> tuple[int, ...]:
    """Return the robot's bodies: all but mocap bodies without joints, and free bodies off the chain to the TCP."""

    def is_foreign(body: int) -> bool:
        free = model.body_jntnum[body] and model.jnt_type[model.body_jntadr[body]] == FREE
        return is_mocap_alone(model, body) or bool(on_chain and free and body not in on_chain)

    return tuple(b for b in range(model.nbody) if not any(map(is_foreign, upwards(model, b))))


def _body_of(model: mujoco.MjModel, geom: Geom) -> int:
    return int(model.geom_bodyid[geom.at])


def _chosen_geoms(geoms: list[Geom], model: mujoco.MjModel, visual: bool) -> list[Geom]:
    """Select the geoms that capsules represent: each body's collision geoms, or with `visual` its visual geoms, if any.

    Capsules and spheres always count as collision geoms, as in `load_robot`.
    """
    for_contact = [geom for geom in geoms if geom.touches]
    if not for_contact:
        return geoms
    if not visual:
        return [geom for geom in geoms if geom.touches or (geom.kind in ROUND and not geom.mesh)]
    drawn = {_body_of(model, geom) for geom in geoms if not geom.touches}
    return [geom for geom in geoms if not geom.touches or _body_of(model, geom) not in drawn]


def _shapeless(geoms: list[Geom], chosen: list[Geom], model: mujoco.MjModel) -> list[int]:
    """Return the bodies with geoms but without a chosen one."""
    with_shape = {_body_of(model, geom) for geom in chosen}
    return sorted({_body_of(model, geom) for geom in geoms} - with_shape)


def _is_excluded(geom: Geom, model: mujoco.MjModel) -> bool:
    """Return True for planes, height fields, SDFs, and shapes fixed to the world that are no capsules or spheres."""
    return geom.kind in NOT_OF_AN_ARM or (_body_of(model, geom) == 0 and geom.kind not in ROUND)


def _described(geom: Geom, model: mujoco.MjModel) -> str:
    return f"{model.geom(geom.at).name or geom.kind} of {body_name(model, _body_of(model, geom))}"
