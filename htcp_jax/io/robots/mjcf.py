"""Export of an imported arm as an MJCF file for `load_robot`, readable and editable by hand."""

from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import mujoco
import numpy as np

from htcp_jax.io.robots.body_covers import BodyCover
from htcp_jax.io.robots.capsule_fit import Capsule
from htcp_jax.io.robots.followers import equation
from htcp_jax.io.robots.link_meshes import VISUAL, cuts_text
from htcp_jax.io.robots.model_file import EXCLUDED
from htcp_jax.io.robots.mujoco_models import SLIDE, body_name, excluded_bodies, joint_name
from htcp_jax.io.robots.safe_xml import CUTS, LIST, MADE_FROM, OMITTED, PART
from htcp_jax.io.robots.stored_pieces import EXCESS, FITTED, PIECE, RADIUS, vertices_text
from htcp_jax.io.robots.vendor_import import ImportedArm

Listed = tuple[str, str, str, float]  # an `Exclusion`, with the capsules' names

HEAD = """
  {what} of capsules, made by htcp {command} from {source}. Metres, radians.
  Correct what is not as it should be: a capsule's "fromto" are the ends of its axis in the frame of its body, "size" is
  its radius. The site "tcp" is the TCP{tip}.{frozen}
"""
PART_HEAD = """
    The link that carries the part: workpieces are posed in its frame. The joints from it to the TCP are the robot's.
    """
OMITTED_HEAD = """
    Links whose shapes were excluded although no capsule of this file moves as they do.
    """
FOLLOWERS_HEAD = """
    Joints that follow others: q = ref + c0 + c1 (q2 - ref2).
    """
LIST_HEAD = """
    Pairs of capsules that are not checked against each other (docs/cell.md, Self-collision). Rule b: the capsules
    overlap in at least 95 % of 10,000 random configurations. Rule c: they overlap in some, but the links' meshes touch
    in none. The number is the share of configurations in which they overlap. Remove a pair to have it checked. The
    pairs of bodies under contact are those that the model excludes, rule a.
    """
PIECES_HEAD = """
    For each fitted capsule the convex piece around the part of the mesh inside it: vertices in the frame of the
    capsule's body, and a radius by which their hull is thickened. If you change a capsule, its piece is ignored. The
    excess is the largest distance of the capsule's surface from the mesh, except inside other capsules of the body.
    """
MANY = {"mesh": "meshes", "box": "boxes", "cylinder": "cylinders", "ellipsoid": "ellipsoids"}


def arm_xml(arm: ImportedArm, source: str, listed: Sequence[Listed] | None = None) -> str:
    """Return the text of an MJCF file for `load_robot`.

    Args:
        arm: The imported arm.
        source: Path of the model, relative to the file.
        listed: Pairs of capsules that are not checked, in addition to the bodies that the model or an SRDF excludes.
            None: the pairs are determined whenever the file is read.
    """
    model = arm.model
    frozen = f"\n  Frozen as drawn: {', '.join(arm.frozen)}." if arm.frozen else ""
    frozen += f"\n  Frozen at a value: {', '.join(fixed_text(arm))}." if arm.fixed else ""
    root = Element("mujoco", model=arm.name)
    what, command = ("An arm", "robot") if arm.part is None else ("A cell", "cell")
    tip = f": here {arm.tip.name or 'its only site'} of the model"
    if not arm.chain.joints:
        what, command, tip = "A tool", "tool", ", the frame's origin is on the flange"
    root.append(_comment(HEAD.format(what=what, command=command, source=source, tip=tip, frozen=frozen)))
    light = {"boundmass": "1e-6", "boundinertia": "1e-6"}  # else MuJoCo refuses a link without a capsule
    SubElement(root, "compiler", angle="radian", autolimits="true", **light)
    SubElement(SubElement(root, "option"), "flag", contact="disable")
    custom = SubElement(root, "custom")
    if arm.omitted:
        custom.append(_comment(OMITTED_HEAD))
        SubElement(custom, "text", name=OMITTED, data="\n".join(arm.omitted))
    if arm.part is not None:
        custom.append(_comment(PART_HEAD))
        SubElement(custom, "text", name=PART, data=arm.part)
    for name, numbers in arm.numbers.items():
        SubElement(custom, "numeric", name=name, data=_numbers_text(numbers))
    _add_pieces(custom, arm)
    if listed is not None:
        _add_list(custom, arm, source, listed)
    elements = {0: SubElement(root, "worldbody")}
    for b in arm.bodies:
        if b > 0:
            elements[b] = _body_element(elements[int(model.body_parentid[b])], arm, b)
        _add_capsules(elements[b], arm.covers.get(b))
    position, turn = arm.tip.T_body_tcp[:3, 3], np.empty(4)
    mujoco.mju_mat2Quat(turn, arm.tip.T_body_tcp[:3, :3].ravel())
    SubElement(elements[arm.tip.body], "site", name="tcp", **_pose_attributes(position, turn))
    _add_exclusions(root, arm)
    _add_followers(root, arm)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def fixed_text(arm: ImportedArm) -> tuple[str, ...]:
    """Format the joints that are frozen at given values: ("torso=0.2", ...)."""
    return tuple(f"{name}={value:.6g}" for name, value in arm.fixed.items())


def follower_text(arm: ImportedArm) -> tuple[str, ...]:
    """Format the joints that follow others: ("a5b = -0.5 a5 + 0.1", ...)."""
    names = {j: (joint_name(arm.model, j), joint_name(arm.model, each.master)) for j, each in arm.followers.items()}
    return tuple(equation(*names[j], each.factor, each.offset) for j, each in arm.followers.items())


def _body_element(parent: Element, arm: ImportedArm, b: int) -> Element:
    model = arm.model
    body = SubElement(
        parent, "body", name=body_name(model, b), **_pose_attributes(model.body_pos[b], model.body_quat[b])
    )
    if b in arm.massive:
        inertia = {"mass": _numbers_text([model.body_mass[b]]), "diaginertia": _numbers_text(model.body_inertia[b])}
        SubElement(
            body, "inertial", pos=_numbers_text(model.body_ipos[b]), quat=_numbers_text(model.body_iquat[b]), **inertia
        )
    for j in sorted(arm.chain.joints):
        if model.jnt_bodyid[j] == b:
            SubElement(body, "joint", name=joint_name(model, j), **_joint(model, j))
    return body


def _add_pieces(custom: Element, arm: ImportedArm) -> None:
    if any(cover.hulls for cover in arm.covers.values()):
        custom.append(_comment(PIECES_HEAD))
    for cover in arm.covers.values():
        for name, piece in cover.hulls.items():
            SubElement(custom, "text", name=PIECE + name, data=vertices_text(piece))
            SubElement(custom, "numeric", name=RADIUS + name, data=_numbers_text([piece.radius]))
            fitted = cover.pieces[name].capsule
            SubElement(custom, "numeric", name=FITTED + name, data=_numbers_text([*fitted.p, *fitted.q, fitted.radius]))
            SubElement(custom, "numeric", name=EXCESS + name, data=f"{cover.excesses[name]:.6f}")


def _add_list(custom: Element, arm: ImportedArm, source: str, listed: Sequence[Listed]) -> None:
    """Add the list of excluded pairs, and the source of the meshes with which the pairs were determined."""
    custom.append(_comment(LIST_HEAD))
    SubElement(custom, "text", name=LIST, data=f"{len(listed)} pairs are not checked")
    for number, (one, other, rule, share) in enumerate(listed, 1):
        pair = SubElement(custom, "tuple", name=EXCLUDED.format(number, rule))
        SubElement(pair, "element", objtype="geom", objname=one, prm=f"{share:.4f}")
        SubElement(pair, "element", objtype="geom", objname=other)
    SubElement(custom, "text", name=MADE_FROM, data=source + (VISUAL if arm.visual else ""))
    for cover in arm.covers.values():
        for name, piece in cover.pieces.items():
            SubElement(custom, "text", name=CUTS + name, data=cuts_text(piece.cuts) or " ")


def _add_exclusions(root: Element, arm: ImportedArm) -> None:
    """Add the pairs of bodies that the model and an SRDF exclude."""
    model = arm.model
    names = {0: "world"} | {b: body_name(model, b) for b in arm.bodies if b > 0}
    own = [pair for pair in sorted(excluded_bodies(model)) if set(pair) <= names.keys()]
    if pairs := dict.fromkeys([*((names[a], names[b]) for a, b in own), *arm.disabled]):
        contact = SubElement(root, "contact")
        for one, other in pairs:
            SubElement(contact, "exclude", body1=one, body2=other)


def _add_followers(root: Element, arm: ImportedArm) -> None:
    """Add the joints that follow others."""
    if not arm.followers:
        return
    equality = SubElement(root, "equality")
    equality.append(_comment(FOLLOWERS_HEAD))
    for j, follower in arm.followers.items():
        one, two = (joint_name(arm.model, each) for each in (j, follower.master))
        SubElement(
            equality, "joint", joint1=one, joint2=two, polycoef=_numbers_text([*follower.coefficients[:2], 0, 0, 0])
        )


def _joint(model: mujoco.MjModel, j: int) -> dict[str, str]:
    slides = model.jnt_type[j] == SLIDE
    given = {"type": "slide"} if slides else {}
    given |= {"axis": _numbers_text(model.jnt_axis[j])}
    if model.jnt_pos[j].any():
        given["pos"] = _numbers_text(model.jnt_pos[j])
    if model.qpos0[model.jnt_qposadr[j]]:
        given["ref"] = _numbers_text([model.qpos0[model.jnt_qposadr[j]]])
    if model.jnt_limited[j]:
        given["range"] = _numbers_text(model.jnt_range[j])
    if model.jnt_actfrclimited[j]:
        given["actuatorfrcrange"] = _numbers_text(model.jnt_actfrcrange[j])
    return given


def _add_capsules(body: Element, cover: BodyCover | None) -> None:
    if cover is None:
        return
    for name, capsule in cover.own.items():
        _add_capsule_element(body, name, capsule)
    if cover.fitted:
        ratio = "flat" if np.isnan(cover.ratio) else f"{cover.ratio:.2f} times its hull"
        body.append(_comment(f" about {shapes_label(cover)}, {ratio} "))
    for name, capsule in cover.fitted.items():
        _add_capsule_element(body, name, capsule)


def _add_capsule_element(body: Element, name: str, capsule: Capsule) -> None:
    size = _numbers_text([capsule.radius])
    if (capsule.p == capsule.q).all():
        SubElement(body, "geom", name=name, type="sphere", pos=_numbers_text(capsule.p), size=size)
    else:
        SubElement(body, "geom", name=name, type="capsule", fromto=_numbers_text([*capsule.p, *capsule.q]), size=size)


def shapes_label(cover: BodyCover) -> str:
    """Describe the shapes in the fitted capsules: "mesh", "2 meshes, box"; "" if nothing was fitted."""
    count = {kind: cover.kinds.count(kind) for kind in dict.fromkeys(cover.kinds)}
    return ", ".join(kind if n == 1 else f"{n} {MANY[kind]}" for kind, n in count.items())


def _pose_attributes(position: np.ndarray, turn: np.ndarray) -> dict[str, str]:
    pose = {"pos": _numbers_text(position)} if position.any() else {}
    return pose if (turn == [1, 0, 0, 0]).all() else pose | {"quat": _numbers_text(turn)}


def _numbers_text(numbers) -> str:
    """Format numbers with 15 significant digits, without noise in the last place."""
    return " ".join(f"{number + 0.0:.15g}" for number in numbers)


def _comment(text: str) -> Element:
    return ElementTree.Comment(text.replace("--", "- -"))
