"""Reading of a robot's model file, on the host: MuJoCo compiles it, and the chain to the TCP is extracted.

The chain's root is the world, unless the file names a link as the part's link by <text name="link of the part">. The
chain then begins at that link, leads up to the first common ancestor with the TCP through reversed joints, and down to
the TCP. The axis of a reversed joint is negated: the same joint value then gives the same relative pose of its two
bodies, so that the joint keeps its name, limits, zero and sign.

Every error in a file is an InputError with one line that starts with the file's path. `loading` makes the Robot.
"""

import itertools
import math
import re
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import joint_limits, remarks
from htcp_jax.io.robots.capsule_fit import Capsule
from htcp_jax.io.robots.composed import read_model
from htcp_jax.io.robots.fixed_joints import fix_joints
from htcp_jax.io.robots.frames import frame, joint_name, shifted_frame, turned_frame
from htcp_jax.io.robots.safe_xml import LIST, PART, unreadable_model
from htcp_jax.io.robots.stored_pieces import StoredPiece, pieces_of, read_pieces
from htcp_jax.model import BodyPieces, robot
from htcp_jax.model import arrays as coordinates
from htcp_jax.spec import ModelSource, Tool, label_of
from htcp_jax.spec import tool as tools

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_SPHERE, _CAPSULE = int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_DESCRIBED_ELSEWHERE = mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF
FEWEST_JOINTS = 3
MOST_JOINTS = 9  # maximum number of joints if the part moves
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
    stored: dict[str, StoredPiece]  # convex pieces by the capsules' names
    held: dict[str, tuple[Capsule, np.ndarray]]  # capsules with their bodies' poses, see `pieces_of`

    def pieces(self) -> BodyPieces | None:
        """Compute the capsules' convex pieces, which takes longer than reading the file."""
        return pieces_of(self.stored, self.held) if self.stored else None


class _Capsule(NamedTuple):
    """A capsule geom: its body and its link (-1: the chain's root), with ends in the link's frame [m]."""

    name: str
    body: int
    link: int
    p: np.ndarray
    q: np.ndarray
    radius: float


class Chain(NamedTuple):
    """The chain of joints from the part's link to the TCP, in order, by their indices in the model."""

    root: int  # the body that carries the part; 0: the world
    joints: tuple[int, ...]
    reversed: tuple[bool, ...]  # True: the chain leads from the joint's body to that body's parent

    def without(self, fixed: Collection[int]) -> "Chain":
        """Return the chain without the joints `fixed`, given by their indices in the model."""
        pairs = [pair for pair in zip(self.joints, self.reversed, strict=True) if pair[0] not in fixed]
        return self._replace(joints=tuple(j for j, _ in pairs), reversed=tuple(back for _, back in pairs))


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
    chain = _whole_chain(model, path, tcp_body, fix_joints(model, path, locked, "robot.locked: "), next_step)
    if chain.root and (T_world_base != np.eye(4)).any():
        raise InputError(f"{path}: the part moves, so robot.base_m and base_rpy_rad must be 0")
    joints = list(chain.joints)
    joint_names = check_joints(model, path, joints, chain, fewest=fewest)
    slides = tuple(bool(kind == _SLIDE) for kind in model.jnt_type[joints])
    arm_name = model.names.partition(b"\0")[0].decode(errors="replace") or path.stem
    widest = [limit[joints] for limit in _joint_limits(model, path, "model")]  # the lists were sampled within these
    if joint_limits.is_limits_file(limits):
        speed = joint_numbers(model, path, "speed", default=math.inf)[joints]
        lower, upper = _limits_of_file(limits, joint_names, arm_name, slides, widest, speed)
    else:
        lower, upper = (limit[joints] for limit in _joint_limits(model, path, limits))
    ranges = np.stack([lower, upper], axis=1)
    remarks.check_ranges(model, path, joints, ranges, remarks.OF_JOB)
    T_parent_joint, frames = link_frames(model, T_world_base, chain)
    capsules = [_capsule_geom(model, geom, frames) for geom in range(model.ngeom) if _is_round(model, geom)]
    link, T_link_body = frames[tcp_body]
    T_link_flange = T_link_body @ T_body_tcp
    mounted = [] if tool is None else _mounted(tool, path, tcp_body, link, T_link_flange, capsules)
    on_tool = mounted or _on_tcp_body(model, tcp_body, capsules, chain)
    capsules += mounted
    if not capsules:
        known = f"geoms of the model: {geom_types or 'none'}"
        raise InputError(f"{path}: no capsule or sphere geoms; {known}{geom_types and '; ' + _next_step(path)}")
    arrays = {
        "T_parent_joint": T_parent_joint,
        "axis": model.jnt_axis[joints] * np.where(chain.reversed, -1.0, 1.0)[:, None],
        "T_link_tcp": T_link_flange if tool is None else T_link_flange @ tools.pose(tool.tip_m, tool.tip_rpy_rad),
        "capsule_p": np.array([capsule.p for capsule in capsules]),
        "capsule_q": np.array([capsule.q for capsule in capsules]),
        "capsule_radius": np.array([capsule.radius for capsule in capsules]),
        "on_tool": _ends_on_tool(capsules, on_tool),
    }
    for name, numbers in arrays.items():
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: {NUMBERS[name]} is not finite; correct the model")
        if (largest := np.abs(numbers).max(initial=0.0)) > coordinates.LARGEST_COORDINATE:
            raise InputError(
                f"{path}: {NUMBERS[name]} is {largest:g} m; at most {coordinates.LARGEST_COORDINATE:g} m are possible; "
                "check the model's units and mesh scale"
            )
    arrays |= {"lower": lower, "upper": upper, "effort": _effort(model)[joints]}
    for name in ("speed", "acceleration"):
        arrays[name] = joint_numbers(model, path, name, default=math.inf)[joints]
        if not (arrays[name] > 0).all():
            raise InputError(f"{path}: numeric {name!r} must be positive")
    exclusions = [*_excluded(model, capsules), *_listed_pairs(path, lists.pairs, capsules)]
    valid = bool((lower >= widest[0]).all() and (upper <= widest[1]).all())
    facts = {
        "name": arm_name,
        "joint_names": joint_names,
        "slides": slides,
        "capsule_names": tuple(capsule.name for capsule in capsules),
        "capsule_link": tuple(capsule.link for capsule in capsules),
        "ignored_geoms": tuple(
            _geom_name(model, g)
            for g in np.flatnonzero(model.geom_contype | model.geom_conaffinity).tolist()
            if not _is_round(model, g)
        ),
        "exclusions": tuple(each for each in exclusions if valid or each.rule == "a"),
        "listed": lists.is_complete and valid,
        "listed_together": tuple(
            tuple(k for k, capsule in enumerate(capsules) if capsule.name in names) for names in lists.models if valid
        ),
        "mounted": tuple(range(len(capsules) - len(mounted), len(capsules))),
        "frames": _named_frames(model, frames, moving=True),
        "base_frames": _named_frames(model, frames, moving=False),
        "world": _arm_frame(robot.WORLD.name, *frames[0]) if chain.root else robot.WORLD,
    }
    remarks.note_limits(model, path, joints, ranges, arrays)
    held = {each.name: (Capsule(each.p, each.q, each.radius), frames[each.body][1]) for each in capsules}
    return RobotFields(arrays, facts, stored, held)


# The file


def _compile_model(source: ModelSource) -> tuple[mujoco.MjModel, str, _Lists, dict[str, StoredPiece]]:
    """Return the compiled model, the types of its geoms in the file, its lists of excluded pairs, and its pieces."""
    path = label_of(source)
    with no_log():
        spec = read_model(source)
    geom_types = sorted({_type_name(geom) for geom in spec.geoms})
    _check_radii(spec, path)
    _forget_shapes(spec)
    pairs = [_Pair(each.name, tuple(each.objname), float(each.objprm[0])) for each in spec.tuples if len(each.objname)]
    has_list = any(text.name == LIST for text in spec.texts)
    models = tuple(frozenset(text.data.split("\n")) for text in spec.texts if text.name.startswith(f"{LIST} of "))
    if pairs and not has_list and source == path:
        raise InputError(f"{path}: tuple {pairs[0].name!r} has no effect without <text name={LIST!r}>")
    for each in list(spec.tuples):
        spec.delete(each)
    stored = read_pieces(spec, path)
    return compile_spec(spec, path), ", ".join(geom_types), _Lists(pairs, has_list, models), stored


def compile_spec(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    """Compile a model whose shapes refer to no files.

    Raises:
        InputError: For a model that MuJoCo refuses, and for a descending joint range.
    """
    _check_ranges(spec, path)
    spec.compiler.fusestatic = False  # keep the fixed links of a URDF, as the TCP may be one of them
    # Kinematics needs no masses, but MuJoCo requires them.
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    spec.compiler.balanceinertia = True
    try:
        with no_log():
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise unreadable_model(path, error) from None


@contextmanager
def no_log() -> Iterator[None]:
    """Prevent MuJoCo from writing its warnings into MUJOCO_LOG.TXT in the working folder."""
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(handler)


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


def _check_ranges(spec: mujoco.MjSpec, path: Path) -> None:
    """Check that joint ranges ascend, as MuJoCo itself treats a descending or nan range as no limit.

    Raises:
        InputError: For the first range that does not ascend.
    """
    for joint in spec.joints:
        lower, upper = joint.range
        requested = joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE and (lower, upper) != (0, 0)
        if requested and not lower < upper:
            raise InputError(
                f"{path}: joint {joint.name!r} has range {lower:g} to {upper:g}; the lower limit must come first"
            )


def _forget_shapes(spec: mujoco.MjSpec) -> None:
    """Replace meshes, height fields and SDFs by boxes: all are ignored, and their files are not opened."""
    for geom in spec.geoms:
        if geom.type in _DESCRIBED_ELSEWHERE:
            geom.type, geom.size, geom.meshname, geom.hfieldname = mujoco.mjtGeom.mjGEOM_BOX, [1.0, 1.0, 1.0], "", ""
    for mesh in list(spec.meshes):
        spec.delete(mesh)


def joint_numbers(model: mujoco.MjModel, path: Path, name: str, default: float) -> np.ndarray:
    """Return the <custom><numeric> `name`, (N,), one value per joint.

    Args:
        model: The compiled model.
        path: Its file, for messages.
        name: Name of the <numeric>.
        default: Value for every joint if the file has no such <numeric>.

    Raises:
        InputError: If the number of values is not the number of joints.
    """
    at = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if at < 0:
        return np.full(model.njnt, default)
    start, size = model.numeric_adr[at], model.numeric_size[at]
    if size != model.njnt:
        raise InputError(f"{path}: numeric {name!r} has {size} values for {model.njnt} joints")
    return model.numeric_data[start : start + size].copy()


def _effort(model: mujoco.MjModel) -> np.ndarray:
    """Return the joints' `actuatorfrcrange`, which MuJoCo also reads from a URDF; inf for joints without one."""
    return np.where(model.jnt_actfrclimited > 0, np.abs(model.jnt_actfrcrange).min(axis=1), math.inf)


# The chain and its frames


def upwards(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """Yield the body and its ancestors, by their indices in the model, without the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


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
        return int(model.site_bodyid[site]), frame(model.site_pos[site], model.site_quat[site])
    if body >= 0:
        return body, np.eye(4)
    sites = ", ".join(model.site(i).name or "(unnamed)" for i in range(model.nsite)) or "none"
    bodies = ", ".join(model.body(i).name or "(unnamed)" for i in range(1, model.nbody)) or "none"
    known = f"sites of the model: {sites}; bodies: {bodies}"
    step = f"; set robot.tcp in the job, or run: htcp robot {path} --tcp NAME --out arm.xml"
    raise InputError(f"{path}: no site or body {name!r} for the TCP; {known}{step if name == 'tcp' else ''}")


def part_body(model: mujoco.MjModel, path: Path) -> int:
    """Return the body that the file names as the part's link; 0, the world, if it names none.

    Raises:
        InputError: For an unknown body.
    """
    text = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, PART)
    if text < 0:
        return 0
    start, size = model.text_adr[text], model.text_size[text]
    name = model.text_data[start : start + size].rstrip(b"\0").decode(errors="replace")
    return find_link(model, path, name, range(model.nbody), f"text {PART!r}")


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
    joints = [_joints_of(model, body)[::-1] for body in up if body not in down]
    count = sum(map(len, joints))
    joints += [_joints_of(model, body) for body in reversed(down) if body not in up]
    found = tuple(itertools.chain.from_iterable(joints))
    return Chain(root, found, tuple(k < count for k in range(len(found))))


def chain_of_file(model: mujoco.MjModel, path: Path, fixed: Collection[int] = ()) -> Chain:
    """Return the chain of an arm's or a cell's file: all joints that are not fixed are on the chain.

    Raises:
        InputError: If the file names an unknown link as the part's link.
    """
    root = part_body(model, path)
    up = [j for body in upwards(model, root) for j in reversed(_joints_of(model, body))]
    down = [j for j in range(model.njnt) if j not in up]
    return Chain(root, (*up, *down), (*(True for _ in up), *(False for _ in down))).without(fixed)


def joints_in_file(source: ModelSource, locked: Sequence[str] = ()) -> tuple[int, ...]:
    """Return, for each joint in the file's order, its index in the list of the robot's joints and then `locked`.

    Raises:
        InputError: For a file that cannot be read.
    """
    model = _compile_model(source)[0]
    names = [joint_name(model, j) for j in chain_of_file(model, label_of(source)).joints]
    order = [*(name for name in names if name not in locked), *locked]
    return tuple(order.index(joint_name(model, j)) for j in range(model.njnt))


def _joints_of(model: mujoco.MjModel, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def _whole_chain(model: mujoco.MjModel, path: Path, tcp_body: int, fixed: Collection[int], next_step: str) -> Chain:
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
    joints: Sequence[int],
    chain: Chain,
    hint: str = "",
    fewest: int = FEWEST_JOINTS,
    remedies: remarks.Remedies = remarks.OF_JOB,
) -> tuple[str, ...]:
    """Check the joints on a chain, given by their indices in the model, and return their names.

    Raises:
        InputError: For ball, free and planar joints and those that do not move on their own, see `remarks`, for too few
            joints (with the hint), and, if the part moves, for more than MOST_JOINTS joints.
    """
    names = [joint_name(model, j) for j in joints]
    carriers = {int(model.jnt_bodyid[j]) for j in joints}
    moved = [model.body(b).name for b in range(1, model.nbody) if _carrier(model, b) in carriers]
    remarks.check_kinds(model, path, names, moved, remedies)
    odd = [joint_name(model, j) for j in joints if model.jnt_type[j] not in (_HINGE, _SLIDE)]
    if odd:
        raise InputError(f"{path}: ball or free joints ({', '.join(odd)}); only hinge and slide joints are supported")
    found = f"{path}: {len(joints) or 'no'} joints from {_root_name(model, chain)} to the TCP"
    if len(joints) < fewest:
        raise InputError(f"{found}; at least {fewest} {'are' if fewest > 1 else 'is'} needed{hint}")
    if chain.root and len(joints) > MOST_JOINTS:
        raise InputError(f"{found}; at most {MOST_JOINTS} are supported: freeze some with --fix or robot.locked")
    return tuple(names)


def _carrier(model: mujoco.MjModel, body: int) -> int:
    """Return the nearest body with a joint, from a body up; 0, the world, if there is none."""
    return next((b for b in upwards(model, body) if model.body_jntnum[b]), 0)


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
        for j in reversed(_joints_of(model, body)):
            if j in number:  # from the frame that moves with the body to the one that it moves against
                T_parent_joint[number[j]] = T_link_body @ shifted_frame(model.jnt_pos[j])
                link = number[j]
                T_link_body = np.linalg.inv(shifted_frame(model.jnt_pos[j]) @ _drawn_back(model, j))
        T_link_body = T_link_body @ np.linalg.inv(frame(model.body_pos[body], model.body_quat[body]))
        body = int(model.body_parentid[body])
        known[body] = link, T_link_body
    frames = []
    for body in range(model.nbody):  # parents come before children
        if body in known:
            frames.append(known[body])
            continue
        link, T_link_parent = frames[model.body_parentid[body]]
        T_link_body = T_link_parent @ frame(model.body_pos[body], model.body_quat[body])
        for j in _joints_of(model, body):
            if j in number:
                T_parent_joint[number[j]] = T_link_body @ shifted_frame(model.jnt_pos[j]) @ _drawn_back(model, j)
                link, T_link_body = number[j], shifted_frame(-model.jnt_pos[j])
        frames.append((link, T_link_body))
    return T_parent_joint, frames


def _drawn_back(model: mujoco.MjModel, j: int) -> np.ndarray:
    """Return the motion of a joint from its value in the initial configuration, qpos0, to its zero (4, 4)."""
    axis, drawn_at = model.jnt_axis[j], model.qpos0[j]
    return turned_frame(axis, -drawn_at) if model.jnt_type[j] == _HINGE else shifted_frame(-drawn_at * axis)


def _joint_limits(model: mujoco.MjModel, path: Path, profile: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper joint limits of a profile, see loading.load_robot."""
    ranges = np.where(model.jnt_limited[:, None], model.jnt_range, [-math.inf, math.inf])
    hinges = model.jnt_type[:, None] == _HINGE
    profiles = {"model": ranges, "simulation": np.where(hinges, [-math.pi, math.pi], ranges)}
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, "datasheet_lower") >= 0:
        sides = [joint_numbers(model, path, f"datasheet_{side}", default=math.nan) for side in ("lower", "upper")]
        profiles["datasheet"] = np.stack(sides, axis=1)
    if profile not in profiles:
        valid = f"{', '.join(profiles)}, or a file such as joint_limits.yaml"
        raise InputError(f"{path}: it has no joint limits {profile!r} for robot.limits; valid: {valid}")
    lower, upper = profiles[profile].T
    if not (lower < upper).all():
        raise InputError(f"{path}: joint limits {profile!r} must be lower < upper for every joint")
    return lower, upper


def _limits_of_file(
    file: str,
    names: tuple[str, ...],
    arm: str,
    slides: tuple[bool, ...],
    ranges: Sequence[np.ndarray],
    speed: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper limits in a file, or the model's `ranges` where it states none.

    A Note names what the file leaves to the model, what is wider or faster than in the model, and what is not used.
    """
    lower, upper = ranges
    stated = joint_limits.read_joint_limits(file, names, arm)
    limits = stated.ranges(slides, lower, upper)
    if text := stated.note((lower, upper), speed):
        warnings.warn(text, Note, stacklevel=2)
    return limits


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
        sites.append((model.site(site).name, link, T_link_body @ frame(model.site_pos[site], model.site_quat[site])))
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


def _capsule_geom(model: mujoco.MjModel, geom: int, frames: list[tuple[int, np.ndarray]]) -> _Capsule:
    body = int(model.geom_bodyid[geom])
    link, T_link_body = frames[body]
    T_link_geom = T_link_body @ frame(model.geom_pos[geom], model.geom_quat[geom])
    half = model.geom_size[geom, 1] if model.geom_type[geom] == _CAPSULE else 0.0
    middle, reach = T_link_geom[:3, 3], half * T_link_geom[:3, 2]
    p, q = middle + reach, middle - reach  # MJCF's `fromto` runs from +z to -z
    return _Capsule(_geom_name(model, geom), body, link, p, q, float(model.geom_size[geom, 0]))


def excluded_bodies(model: mujoco.MjModel) -> set[tuple[int, int]]:
    """Return the pairs of bodies in the file's <exclude>s, by their indices."""
    return {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in model.exclude_signature}


def _excluded(model: mujoco.MjModel, capsules: list[_Capsule]) -> Iterator[robot.Exclusion]:
    """Yield the pairs of capsules whose bodies are in an <exclude> of the file."""
    bodies = excluded_bodies(model)
    for a, b in itertools.combinations(range(len(capsules)), 2):
        one, other = capsules[a].body, capsules[b].body
        if (one, other) in bodies or (other, one) in bodies:
            yield _exclusion(capsules, a, b, "a", 0.0)


def _listed_pairs(path: Path, pairs: Sequence[_Pair], capsules: list[_Capsule]) -> Iterator[robot.Exclusion]:
    """Yield the excluded pairs in the arm's own list.

    Raises:
        InputError: For an invalid pair.
    """
    numbers = {capsule.name: k for k, capsule in enumerate(capsules)}
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
        yield _exclusion(capsules, *(numbers[each] for each in pair), rule[1], share)


def _exclusion(capsules: list[_Capsule], a: int, b: int, rule: str, share: float) -> robot.Exclusion:
    return robot.Exclusion(*sorted((a, b), key=lambda k: -capsules[k].link), rule, share)


def _mounted(
    tool: Tool, path: Path, tcp_body: int, link: int, T_link_flange: np.ndarray, others: list[_Capsule]
) -> list[_Capsule]:
    """Return a tool's bodies as capsules on the flange.

    Raises:
        InputError: For a body with the name of a capsule in the model.
    """
    R, t = T_link_flange[:3, :3], T_link_flange[:3, 3]
    for body in tool.bodies:
        if body.name in {capsule.name for capsule in others}:
            raise InputError(f"tool: {path} already has a capsule {body.name!r}; choose another name for the body")
    return [
        _Capsule(body.name, tcp_body, link, R @ body.p_m + t, R @ body.q_m + t, body.radius_m) for body in tool.bodies
    ]


def _on_tcp_body(model: mujoco.MjModel, tcp_body: int, capsules: list[_Capsule], chain: Chain) -> list[_Capsule]:
    """Return the capsules to lengthen with the tool: those of the TCP's body and its descendants, on the last link.

    If there are none, all capsules on the last link are returned; none if the part moves, as the last link may be the
    workshop.
    """
    last = [capsule for capsule in capsules if capsule.link == model.njnt - 1]
    tool = [capsule for capsule in last if capsule.body == tcp_body or tcp_body in upwards(model, capsule.body)]
    return tool or ([] if chain.root else last)


def _ends_on_tool(capsules: list[_Capsule], tool: list[_Capsule]) -> np.ndarray:
    """Return 1 for each end of the K capsules that moves when the tool is lengthened, else 0 (K, 2)."""
    moves = np.array([[any(capsule is part for part in tool)] * 2 for capsule in capsules], float)
    for k, capsule in enumerate(capsules):
        if tool and capsule is tool[0]:
            nearer = int(np.linalg.norm(capsule.q) < np.linalg.norm(capsule.p))
            moves[k, nearer] = 0.0  # the end at the flange: the one nearer to the last joint
    return moves
