"""Reading of a robot's model file, on the host: MuJoCo compiles it, and the chain to the TCP is extracted (`chain`).

Every error in a file is an InputError with one line that starts with the file's path. `loading` makes the Robot.
"""

import itertools
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import joint_limits, remarks
from htcp_jax.io.robots.capsule_fit import Capsule
from htcp_jax.io.robots.chain import (
    FEWEST_JOINTS,
    Chain,
    JointMap,
    check_joints,
    link_frames,
    whole_chain,
)
from htcp_jax.io.robots.composed import read_model
from htcp_jax.io.robots.constraints import check_loops
from htcp_jax.io.robots.fixed_joints import fix_joints
from htcp_jax.io.robots.frames import site_frame
from htcp_jax.io.robots.mujoco_models import (
    HINGE,
    SLIDE,
    compile_spec,
    delete_all,
    excluded_bodies,
    has_numeric,
    joint_name,
    joint_numbers,
    model_name,
    text_of,
    upwards,
)
from htcp_jax.io.robots.safe_xml import LIST, OMITTED
from htcp_jax.io.robots.stored_pieces import StoredPiece, pieces_of, read_pieces
from htcp_jax.model import BodyPieces, robot
from htcp_jax.model import arrays as coordinates
from htcp_jax.spec import ModelSource, Tool, label_of
from htcp_jax.spec import tool as tools

_SPHERE, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_DESCRIBED_ELSEWHERE = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF
NUMBERS = {  # names of an arm's arrays, for messages
    "T_parent_joint": "the pose of a joint",
    "axis": "the axis of a joint",
    "T_link_tcp": "the pose of the TCP",
    "capsule_p": "an end of a capsule",
    "capsule_q": "an end of a capsule",
    "capsule_radius": "the radius of a capsule",
    "on_tool": "an end of a capsule on the tool",
}
EXCLUDED = "excluded {}, rule {}"  # name of the <tuple> for a pair in an arm's list of exclusions
NONE_LOCKED: Mapping[str, float] = {}


class RobotFields(NamedTuple):
    """Content of a model file as fields of a Robot."""

    arrays: dict[str, np.ndarray]  # fields that are arrays, by name
    facts: dict[str, Any]  # other fields, by name
    coupling: dict[str, Any] | None  # fields of a Coupling, by name; None: no joint follows another
    stored: dict[str, StoredPiece]  # convex pieces by the capsules' names
    held: dict[str, tuple[Capsule, np.ndarray]]  # capsules with their bodies' poses, see `pieces_of`

    def pieces(self) -> BodyPieces | None:
        """Compute the capsules' convex pieces, which takes longer than reading the file."""
        return pieces_of(self.stored, self.held) if self.stored else None


class _Body(NamedTuple):
    """A capsule of the arm: its body and its link (-1: the chain's root), and itself in the link's frame."""

    name: str
    body: int
    link: int
    capsule: Capsule


class _Pair(NamedTuple):
    """A <tuple> in an arm's list of excluded pairs."""

    name: str
    capsules: tuple[str, ...]
    share: float


class _Lists(NamedTuple):
    """The excluded pairs in a file's list, or in the lists of the models that form a cell."""

    pairs: list[_Pair]
    is_complete: bool  # True for a single file with a list
    models: tuple[frozenset[str], ...]  # for each model of a cell with a list, the names of its capsules


def read_robot_file(
    source: ModelSource,
    tcp_site: str,
    limits: str,
    T_world_base: np.ndarray,
    tool: Tool | None,
    locked: Mapping[str, float] = NONE_LOCKED,
    fewest: int = FEWEST_JOINTS,
) -> RobotFields:
    """Read the serial chain from the world, or from the part's link, to the TCP.

    Args:
        source: The file, or the models that form the cell.
        tcp_site: Name of the TCP's site or body, see `loading.load_robot`.
        limits: Profile or file of the joint limits, see `loading.load_robot`.
        T_world_base: Pose of the model's own frame in the world (4, 4) [m]; the identity if the part moves.
        tool: Tool to mount on the TCP's frame; None for no tool.
        locked: Values [rad or m], by joint name, of joints that do not move.
        fewest: Minimum number of joints.

    Raises:
        InputError: See `loading.load_robot`.
    """
    path = label_of(source)
    model, geom_types, lists, stored = _compile_model(source)
    tcp_body, T_body_tcp = _find_tcp(model, path, tcp_site)
    next_step = "freeze them with robot.locked" if path != source else _next_step(path)
    chain = whole_chain(model, path, tcp_body, fix_joints(model, path, locked, "robot.locked: "), next_step)
    if chain.root and (T_world_base != np.eye(4)).any():
        raise InputError(f"{path}: the part moves, so robot.base_m and base_rpy_rad must be 0")
    joints, mapped = list(chain.joints), check_joints(model, path, chain, fewest=fewest)
    slides = tuple(bool(kind == SLIDE) for kind in model.jnt_type[joints])
    arm_name = model_name(model) or path.stem
    ranges, is_within = _ranges(model, path, mapped, limits, slides, arm_name)
    T_parent_joint, parents, is_reversed, frames = link_frames(model, T_world_base, chain)
    check_loops(model, path, [link for link, _ in frames])
    bodies = [_capsule_geom(model, geom, frames) for geom in range(model.ngeom) if _is_round(model, geom)]
    link, T_link_body = frames[tcp_body]
    T_link_flange = T_link_body @ T_body_tcp
    mounted = [] if tool is None else _mounted(tool, path, tcp_body, link, T_link_flange, bodies)
    on_tool = mounted or _on_tcp_body(model, tcp_body, bodies, chain)
    bodies += mounted
    if not bodies:
        known = f"geoms of the model: {geom_types or 'none'}"
        visual = "" if geom_types else "; with --visual if the model has only visual geometry"
        raise InputError(f"{path}: no capsule or sphere geoms; {known}; {_next_step(path)}{visual}")
    arrays = {
        "T_parent_joint": T_parent_joint,
        "axis": model.jnt_axis[joints] * np.where(is_reversed, -1.0, 1.0)[:, None],
        "T_link_tcp": T_link_flange if tool is None else T_link_flange @ tools.pose(tool.tip_m, tool.tip_rpy_rad),
        "capsule_p": np.array([each.capsule.p for each in bodies]),
        "capsule_q": np.array([each.capsule.q for each in bodies]),
        "capsule_radius": np.array([each.capsule.radius for each in bodies]),
        "on_tool": _ends_on_tool(bodies, on_tool),
    }
    _check_numbers(path, arrays)
    rates = {name: _positive_numbers(model, path, name, joints) for name in ("speed", "acceleration")}
    arrays |= mapped.limits(model, path, ranges, **rates, effort=_effort(model)[joints])._asdict()
    facts = {
        "name": arm_name,
        "joint_names": tuple(joint_name(model, j) for j in mapped.free),
        "slides": slides,
        "capsule_names": tuple(each.name for each in bodies),
        "capsule_link": tuple(each.link for each in bodies),
        "ignored_geoms": _ignored_geoms(model),
        **_exclusions(model, path, lists, bodies, is_within),
        "mounted": tuple(range(len(bodies) - len(mounted), len(bodies))),
        "frames": _named_frames(model, frames, moving=True),
        "base_frames": _named_frames(model, frames, moving=False),
        "world": _arm_frame(robot.WORLD.name, *frames[0]) if chain.root else robot.WORLD,
        "omitted": tuple((text_of(model, OMITTED) or "").splitlines()),
    }
    remarks.note_limits(model, path, joints, ranges, rates)
    free = tuple(slides[joints.index(j)] for j in mapped.free)
    coupling = {
        "factors": mapped.factors,
        "offsets": mapped.offsets,
        "joint_names": mapped.names(model),
        **{name: tuple(each.tolist()) for name, each in rates.items()},
        "parents": parents,
        "tcp_link": len(chain.to_tcp) - 1,
        "slides": free,
    }
    held = {each.name: (each.capsule, frames[each.body][1]) for each in bodies}
    return RobotFields(arrays, facts, coupling if mapped.is_coupled else None, stored, held)


def _check_numbers(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Check that the numbers of an arm are finite, and not too large."""
    for name, numbers in arrays.items():
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: {NUMBERS[name]} is not finite; correct the model")
        if (largest := np.abs(numbers).max(initial=0.0)) > coordinates.LARGEST_COORDINATE:
            raise InputError(
                f"{path}: {NUMBERS[name]} is {largest:g} m; at most {coordinates.LARGEST_COORDINATE:g} m are possible; "
                "check the model's units and mesh scale"
            )


# The file


def _compile_model(source: ModelSource) -> tuple[mujoco.MjModel, str, _Lists, dict[str, StoredPiece]]:
    """Return the compiled model, the types of its geoms in the file, its lists of excluded pairs, and its pieces."""
    path = label_of(source)
    spec = read_model(source)
    geom_types = sorted({_type_name(geom) for geom in spec.geoms})
    _check_radii(spec, path)
    _forget_shapes(spec)
    pairs = [_Pair(each.name, tuple(each.objname), float(each.objprm[0])) for each in spec.tuples if len(each.objname)]
    has_list = any(text.name == LIST for text in spec.texts)
    models = tuple(frozenset(text.data.split("\n")) for text in spec.texts if text.name.startswith(f"{LIST} of "))
    if pairs and not has_list and source == path:
        raise InputError(f"{path}: tuple {pairs[0].name!r} has no effect without <text name={LIST!r}>")
    delete_all(spec, spec.tuples)
    stored = read_pieces(spec, path)
    return compile_spec(spec, path), ", ".join(geom_types), _Lists(pairs, has_list, models), stored


def _next_step(path: Path) -> str:
    return f"convert it to an arm of capsules: htcp robot {path} --out arm.xml"


def _type_name(geom: mujoco.MjsGeom) -> str:
    return geom.type.name.removeprefix("mjGEOM_").lower()


def _check_radii(spec: mujoco.MjSpec, path: Path) -> None:
    for geom in spec.geoms:
        if geom.type in (_SPHERE, _CAPSULE) and not 0 < geom.size[0] < math.inf:
            body = f"{path}: {_type_name(geom)} {geom.name!r} of body {geom.parent.name!r}"
            if geom.meshname:
                raise InputError(f"{body} is fitted to a mesh; {_next_step(path)}")
            raise InputError(f"{body} has radius {geom.size[0]:g} m; it must be positive")


def _forget_shapes(spec: mujoco.MjSpec) -> None:
    """Replace meshes, height fields and SDFs by boxes: all are ignored, and their files are not opened."""
    for geom in spec.geoms:
        if geom.type in _DESCRIBED_ELSEWHERE:
            geom.type, geom.size, geom.meshname, geom.hfieldname = mujoco.mjtGeom.mjGEOM_BOX, [1.0, 1.0, 1.0], "", ""
    delete_all(spec, spec.meshes)


def _effort(model: mujoco.MjModel) -> np.ndarray:
    """Return the joints' `actuatorfrcrange`, which MuJoCo also reads from a URDF; inf for joints without one."""
    return np.where(model.jnt_actfrclimited > 0, np.abs(model.jnt_actfrcrange).min(axis=1), math.inf)


def _positive_numbers(model: mujoco.MjModel, path: Path, name: str, joints: list[int]) -> np.ndarray:
    numbers = joint_numbers(model, path, name)[joints]
    if not (numbers > 0).all():
        raise InputError(f"{path}: numeric {name!r} must be positive")
    return numbers


# The TCP, the joints and the frames


def _outermost_body(model: mujoco.MjModel) -> int:
    """Return the body with the most joints between it and the world; the last one of several."""
    depths = [sum(model.body_jntnum[list(upwards(model, body))]) for body in range(model.nbody)]
    return max(range(model.nbody), key=lambda body: (depths[body], body))


def _find_tcp(model: mujoco.MjModel, path: Path, name: str) -> tuple[int, np.ndarray]:
    """Return the body that carries the TCP, and the TCP's frame in it."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if site < 0 and body < 0 and name == "tcp":
        if model.nsite == 1:
            site = 0
        elif path.suffix.lower() == ".urdf":
            body = _outermost_body(model)
    if site >= 0:
        return int(model.site_bodyid[site]), site_frame(model, site)
    if body >= 0:
        return body, np.eye(4)
    sites = ", ".join(model.site(i).name or "(unnamed)" for i in range(model.nsite)) or "none"
    bodies = ", ".join(model.body(i).name or "(unnamed)" for i in range(1, model.nbody)) or "none"
    known = f"sites of the model: {sites}; bodies: {bodies}"
    step = f"; set robot.tcp in the job, or run: htcp robot {path} --tcp NAME --out arm.xml"
    raise InputError(f"{path}: no site or body {name!r} for the TCP; {known}{step if name == 'tcp' else ''}")


class JointsInFile(NamedTuple):
    """The order of a model file's joints, and its joints that do not move."""

    order: tuple[int, ...]  # for each joint in the file, its index in the list of moving joints and then `locked`
    locked: dict[str, float]  # values of joints that do not move, by name [rad or m]


def joints_in_file(source: ModelSource, moving: Sequence[str], locked: Mapping[str, float]) -> JointsInFile:
    """Return the joints in a model file.

    Args:
        source: The file, or the models that form the cell.
        moving: Names of the joints that move, also those that follow others.
        locked: Values of locked joints, by name [rad or m].

    Raises:
        InputError: For a file that cannot be read.
    """
    model = _compile_model(source)[0]
    fixed = fix_joints(model, label_of(source), dict(locked))
    still = {joint_name(model, j): value for j, value in fixed.items()}
    order = [*moving, *still]
    return JointsInFile(tuple(order.index(joint_name(model, j)) for j in range(model.njnt)), still)


def _joint_limits(model: mujoco.MjModel, path: Path, profile: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper joint limits of a profile, see loading.load_robot."""
    ranges = np.where(model.jnt_limited[:, None], model.jnt_range, [-math.inf, math.inf])
    hinges = model.jnt_type[:, None] == HINGE
    profiles = {"model": ranges, "simulation": np.where(hinges, [-math.pi, math.pi], ranges)}
    if has_numeric(model, "datasheet_lower"):
        sides = [joint_numbers(model, path, f"datasheet_{side}", default=math.nan) for side in ("lower", "upper")]
        profiles["datasheet"] = np.stack(sides, axis=1)
    if profile not in profiles:
        valid = f"{', '.join(profiles)}, or a file such as joint_limits.yaml"
        raise InputError(f"{path}: it has no joint limits {profile!r} for robot.limits; valid: {valid}")
    lower, upper = profiles[profile].T
    if not (lower < upper).all():
        raise InputError(f"{path}: joint limits {profile!r} must be lower < upper for every joint")
    return lower, upper


def _ranges(
    model: mujoco.MjModel,
    path: Path,
    mapped: JointMap,
    limits: str,
    slides: tuple[bool, ...],
    arm: str,
) -> tuple[np.ndarray, bool]:
    """Return the ranges (J, 2) of an arm's joints, and True if none is wider than in the model.

    A Note names what a file of limits leaves to the model, what is wider or faster than in it, and what is not used.
    """
    joints = list(mapped.joints)
    widest = [limit[joints] for limit in _joint_limits(model, path, "model")]  # the lists were sampled within these
    if joint_limits.is_limits_file(limits):
        speed = joint_numbers(model, path, "speed")[joints]
        stated = joint_limits.read_joint_limits(limits, mapped.names(model), arm)
        lower, upper = stated.ranges(slides, *widest)
        if text := stated.note((widest[0], widest[1]), speed):
            warnings.warn(text, Note, stacklevel=2)
    else:
        lower, upper = (limit[joints] for limit in _joint_limits(model, path, limits))
    ranges = np.stack([lower, upper], axis=1)
    free = np.stack(mapped.limits(model, path, ranges)[:2], axis=1)
    remarks.check_ranges(model, path, mapped.free, free, remarks.OF_JOB)
    return ranges, bool((lower >= widest[0]).all() and (upper <= widest[1]).all())


def _named_frames(
    model: mujoco.MjModel, frames: list[tuple[int, np.ndarray]], moving: bool
) -> tuple[robot.ArmFrame, ...]:
    """Return the frames of sites, then bodies: those on moving links if `moving`, else those fixed to the root.

    Of two frames with the same name the first is returned.
    """
    bodies = [(model.body(body).name, *frames[body]) for body in range(1, model.nbody)]
    sites = []
    for site in range(model.nsite):
        link, T_link_body = frames[model.site_bodyid[site]]
        sites.append((model.site(site).name, link, T_link_body @ site_frame(model, site)))
    found: dict[str, robot.ArmFrame] = {}
    for name, link, T in [*sites, *bodies]:
        if name and (link >= 0) == moving:
            found.setdefault(name, _arm_frame(name, link, T))
    return tuple(found.values())


def _arm_frame(name: str, link: int, T: np.ndarray) -> robot.ArmFrame:
    return robot.ArmFrame(name, link, tuple(T[:3, 3].tolist()), tuple(map(tuple, T[:3, :3].T.tolist())))


# Capsules


def _is_round(model: mujoco.MjModel, geom: int) -> bool:
    return model.geom_type[geom] in (_SPHERE, _CAPSULE)


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    return model.geom(geom).name or f"{model.body(model.geom_bodyid[geom]).name}:{geom}"


def _capsule_geom(model: mujoco.MjModel, geom: int, frames: list[tuple[int, np.ndarray]]) -> _Body:
    body = int(model.geom_bodyid[geom])
    link, T_link_body = frames[body]
    return _Body(_geom_name(model, geom), body, link, Capsule.of_geom(model, geom, T_link_body))


def _ignored_geoms(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the names of geoms for contact that are no capsules."""
    geoms = np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
    return tuple(_geom_name(model, geom) for geom in geoms if not _is_round(model, geom))


def _exclusions(
    model: mujoco.MjModel, path: Path, lists: _Lists, bodies: list[_Body], is_within: bool
) -> dict[str, Any]:
    """Return an arm's fields on excluded pairs; the lists hold if no range is wider than in the model (`is_within`)."""
    found = [*_excluded(model, bodies), *_listed_pairs(path, lists.pairs, bodies)]
    names = lists.models if is_within else ()
    return {
        "exclusions": tuple(each for each in found if is_within or each.rule == "a"),
        "listed": lists.is_complete and is_within,
        "listed_together": tuple(tuple(k for k, each in enumerate(bodies) if each.name in own) for own in names),
    }


def _excluded(model: mujoco.MjModel, bodies: list[_Body]) -> Iterator[robot.Exclusion]:
    """Yield the pairs of capsules whose bodies are in an <exclude> of the file."""
    excluded = excluded_bodies(model)
    for a, b in itertools.combinations(range(len(bodies)), 2):
        one, other = bodies[a].body, bodies[b].body
        if (one, other) in excluded or (other, one) in excluded:
            yield _exclusion(bodies, a, b, "a", 0.0)


def _listed_pairs(path: Path, pairs: Sequence[_Pair], bodies: list[_Body]) -> Iterator[robot.Exclusion]:
    """Yield the excluded pairs in the arm's own list.

    Raises:
        InputError: For an invalid pair.
    """
    numbers = {each.name: k for k, each in enumerate(bodies)}
    for name, pair, share in pairs:
        rule = re.fullmatch(EXCLUDED.format(r"\S+", "([abc])"), name)
        if rule is None:
            raise InputError(
                f"{path}: the tuple {name!r} must be named {EXCLUDED.format('NUMBER', 'a')!r}, or rule b or c"
            )
        if len(pair) != 2:
            raise InputError(f"{path}: {name!r} has {len(pair)} capsules; it must have 2")
        if unknown := [each for each in pair if each not in numbers]:
            raise InputError(f"{path}: {name!r}: no capsule {unknown[0]!r}; valid: {', '.join(numbers)}")
        if pair[0] == pair[1]:
            raise InputError(f"{path}: {name!r} pairs {pair[0]!r} with itself; name two different capsules")
        yield _exclusion(bodies, *(numbers[each] for each in pair), rule[1], share)


def _exclusion(bodies: list[_Body], a: int, b: int, rule: str, share: float) -> robot.Exclusion:
    return robot.Exclusion(*sorted((a, b), key=lambda k: -bodies[k].link), rule, share)


def _mounted(
    tool: Tool, path: Path, tcp_body: int, link: int, T_link_flange: np.ndarray, others: list[_Body]
) -> list[_Body]:
    """Return a tool's bodies as capsules on the flange.

    Raises:
        InputError: For a body with the name of a capsule in the model.
    """
    R, t = T_link_flange[:3, :3], T_link_flange[:3, 3]
    for body in tool.bodies:
        if body.name in {each.name for each in others}:
            raise InputError(f"tool: {path} already has a capsule {body.name!r}; choose another name for the body")
    shapes = (Capsule(R @ body.p_m + t, R @ body.q_m + t, body.radius_m) for body in tool.bodies)
    return [_Body(body.name, tcp_body, link, shape) for body, shape in zip(tool.bodies, shapes, strict=True)]


def _on_tcp_body(model: mujoco.MjModel, tcp_body: int, bodies: list[_Body], chain: Chain) -> list[_Body]:
    """Return the capsules to lengthen with the tool: those of the TCP's body and its descendants, on the last link.

    If there are none, all capsules on the last link are returned; none if the part moves, as the last link may be the
    workshop.
    """
    last = [each for each in bodies if each.link == len(chain.to_tcp) - 1]
    tool = [each for each in last if each.body == tcp_body or tcp_body in upwards(model, each.body)]
    return tool or ([] if chain.root else last)


def _ends_on_tool(bodies: list[_Body], tool: list[_Body]) -> np.ndarray:
    """Return 1 for each end of the K capsules that moves when the tool is lengthened, else 0 (K, 2)."""
    moves = np.array([[any(each is part for part in tool)] * 2 for each in bodies], float)
    for k, (*_, capsule) in enumerate(bodies):
        if tool and bodies[k] is tool[0]:
            nearer = int(np.linalg.norm(capsule.q) < np.linalg.norm(capsule.p))
            moves[k, nearer] = 0.0  # the end at the flange: the one nearer to the last joint
    return moves
