"""Sanitising of a robot's model file before MuJoCo reads it.

MuJoCo opens every file that a model names: included models, meshes, textures, height fields, plugins. This module reads
a file as plain XML without a document type, and therefore without entities. It replaces includes by the content of
files from the model's own folder, and removes elements that do not affect the poses of links and capsules. The
resulting text names no files except meshes: those of a URDF, and those of an MJCF file if requested. The caller removes
these before MuJoCo opens them.
"""

import math
import re
import warnings
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import constraints, remarks
from htcp_jax.io.robots.ledger import Ledger
from htcp_jax.io.robots.mujoco_models import forget_impossible_inertias, no_log, unreadable_model
from htcp_jax.io.robots.urdf_elements import check_elements, read_elements
from htcp_jax.io.robots.urdf_joints import WORLD, UrdfJoints, check_tree, read_joints, refuse_repeated_names
from htcp_jax.io.robots.xacro_file import expand
from htcp_jax.system import opened

LARGEST_FILE = 10 * 2**20  # [bytes]
MOST_ELEMENTS, DEEPEST = 50_000, 200
LARGEST_NUMERIC = 1000  # maximum number of values in a <numeric>

# MJCF elements without effect on kinematics: tendons, actuators, visual and dynamic properties, and so on.
LEFT_OUT = {
    "actuator", "asset", "camera", "contact", "deformable", "extension", "hfield", "keyframe", "light",
    "material", "mesh", "option", "plugin", "sensor", "size", "skin", "statistic", "tendon", "text", "texture", "tuple",
    "visual",
}  # fmt: skip
# Attributes of dynamics, contacts and pictures, which are only counted; MuJoCo refuses what it does not know.
HARMLESS = {
    "actuatorgravcomp", "armature", "condim", "damping", "density", "friction", "frictionloss", "gravcomp", "margin",
    "material", "priority", "rgba", "solimp", "solimpfriction", "solimplimit", "solmix", "solref", "solreffriction",
    "solreflimit", "springdamper", "springref", "stiffness", "user",
}  # fmt: skip
MESHES = "asset", "mesh"  # kept if meshes are requested
CONTACTS = "contact", "text", "tuple"  # excluded pairs, an arm's own list, and the part's link; kept if requested
UNUSED = "not used"  # name of the text that lists what was not used
# Names of an arm's own texts: its list, the part's link, the vendor's model, a capsule's cuts.
LIST, PART, MADE_FROM, CUTS = "self_collision", "link of the part", "made from", "cuts of "
OMITTED = "moving links without capsules"  # name of the text that lists them
# Names of the texts and tuples in the list, of the convex pieces, and of the part's link.
OWN = re.compile(rf"self_collision|link of the part|made from|{OMITTED}|cuts of .*|piece of .*|excluded .*")
VALID = {  # children of some sections, as anything else there, such as a misplaced body, would be removed with them
    "asset": {"hfield", "material", "mesh", "model", "skin", "texture"},
    "contact": {"exclude", "pair"},
    "equality": {"connect", "flex", "flexstrain", "flexvert", "joint", "tendon", "weld"},
}
# Children to keep in some kept elements.
ONLY = {"asset": ("mesh",), "contact": ("exclude",), "equality": ("connect", "joint", "weld")}
NAMED = {"deformable", "flex", "flexstrain", "flexvert"}  # removed elements that are named
TENDONS = {"fixed", "spatial", "tendon"}  # tendons, and their defaults
# Elements that generate bodies and joints.
REFUSED = {"attach", "composite", "flexcomp", "replicate"}


class _Builder(ElementTree.TreeBuilder):
    """A tree builder that refuses document types, which define entities, and too many or too deeply nested elements."""

    def __init__(self, path: Path):
        super().__init__()
        self._path, self._elements, self._depth = path, 0, 0

    def doctype(self, *_) -> None:
        raise InputError(f"{self._path}: a document type (<!DOCTYPE) is not allowed in a model")

    def start(self, tag, attributes):
        self._elements += 1
        if self._elements > MOST_ELEMENTS:
            raise InputError(f"{self._path}: more than {MOST_ELEMENTS:,} elements")
        self._depth += 1
        if self._depth > DEEPEST:
            raise InputError(f"{self._path}: elements nested more than {DEEPEST} deep")
        return super().start(tag, attributes)

    def end(self, tag):
        self._depth -= 1
        return super().end(tag)


@no_log()
def read_spec(path: Path, *, meshes: bool = False, visual: bool = False, contacts: bool = False) -> mujoco.MjSpec:
    """Read an MJCF or URDF file as an MjSpec, without compiling it.

    Args:
        path: The file.
        meshes: Keep the names of an MJCF file's meshes; a URDF's are always kept.
        visual: Keep a URDF's visual geometry.
        contacts: Keep an MJCF file's contact exclusions, and the list of pairs that `htcp robot` writes.

    Raises:
        InputError: For a file that cannot be read or is too large, for an included file outside its folder, for a xacro
            file that cannot be expanded, for repeated names of links and joints, for a URDF whose elements or joints
            are damaged, and for a misplaced element that would be removed.
    """
    root, ledger = parse_model(path), Ledger()
    _put_includes_in_place(root, path, {path.resolve()})
    _rename_world(root)
    refuse_repeated_names(root, path)
    joints, bodies = UrdfJoints({}, {}, {}), {}
    if root.tag == "robot":
        check_elements(root, path, visual, ledger)
        check_tree(root, path)
        joints = read_joints(root, path)
    elif root.tag == "mujoco":
        of_joints, bodies = constraints.tendon_remarks(root, path)
        joints = UrdfJoints({}, of_joints, {})
        kept = {*(MESHES if meshes else ()), *(CONTACTS if contacts else ())}
        _leave_out(root, path, LEFT_OUT - kept, ledger)
    ledger.warn(path)
    if visual and root.tag == "robot":
        ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", discardvisual="false")
    text = ElementTree.tostring(root, encoding="unicode")
    try:
        spec = mujoco.MjSpec.from_string(text)
        for name, given in joints.numbers.items():
            numbers = [given.get(joint.name, math.inf) for joint in spec.joints]
            if numbers and (name == "speed" or min(numbers) < math.inf):
                spec.add_numeric(name=name, data=numbers, size=len(numbers))
        for name, value in joints.held.items():
            spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=name).data[0] = (
                value
            )
        remarks.add_remarks(spec, joints.remarks, bodies)
        if unused := ledger.lines():
            spec.add_text(name=UNUSED, data="\n".join(unused))
        if odd := forget_impossible_inertias(spec):
            text = "masses of bodies whose inertia has a negative eigenvalue are not used"
            warnings.warn(f"{path}: {text}: {remarks.listed(odd)}", Note, stacklevel=4)
        return spec
    except (ValueError, mujoco.FatalError) as error:
        raise unreadable_model(path, error) from None


def model_files(path: Path) -> set[Path]:
    """Return the absolute paths of a model file and its included files.

    Raises:
        InputError: As `read_spec` does.
    """
    seen, root = {path.resolve()}, parse(path)
    if _is_xacro(root, path):
        return seen | expand(path).included
    _put_includes_in_place(root, path, seen)
    return seen


def parse_model(path: Path, kind: str = "a model that MuJoCo can read", ending: str = ".urdf") -> ElementTree.Element:
    """Return the root of an XML file, which is expanded if it is a xacro file, see `xacro_file`.

    Args:
        path: The file.
        kind: Name of its kind, for the message about a damaged file.
        ending: Ending of the expanded file, for messages.

    Raises:
        InputError: As `parse` and `xacro_file.expand` do.
    """
    root = parse(path, kind)
    return _parsed(expand(path, ending).text.encode(), _Builder(path)) if _is_xacro(root, path) else root


def _is_xacro(root: ElementTree.Element, path: Path) -> bool:
    """Return True for a file that xacro has not expanded; an expanded file may still declare the prefix xacro."""
    is_unexpanded = any(each.tag.startswith("xacro:") for each in root.iter()) or any(
        map(_has_macro, read_elements(root))
    )
    return path.suffix.lower() == ".xacro" or is_unexpanded


def _has_macro(element: ElementTree.Element) -> bool:
    """Return True for an element with an expression that xacro expands: ${...} or $(...)."""
    return any("${" in text or "$(" in text for text in (element.text or "", *element.attrib.values()))


def _rename_world(root: ElementTree.Element) -> None:
    """Rename links and bodies called world, except a URDF's root, which MuJoCo merges with its own world.

    Repeated empty links of this name are removed: the macros of a robot and of its stand often define one each.
    """
    worlds = [each for each in root.findall("link") if each.get("name") == WORLD]
    for link in [each for each in worlds if not len(each)][: len(worlds) - 1]:
        root.remove(link)
    children = {each.get("link") for each in root.findall("joint/child")}
    moved = [each for each in root.iter("body") if each.get("name") == WORLD]
    if WORLD in children:
        moved += [each for each in root.findall("link") if each.get("name") == WORLD]
    name, taken = "world_link", {each.get("name") for each in root.iter()}
    while name in taken:
        name += "_"
    for each in moved:
        each.set("name", name)
    for end in [*root.findall("joint/parent"), *root.findall("joint/child")] if moved else ():
        if end.get("link") == WORLD:
            end.set("link", name)


def parse(path: Path, kind: str = "a model that MuJoCo can read") -> ElementTree.Element:
    """Return the root of an XML file.

    Args:
        path: The file.
        kind: Name of its kind, for the message about a damaged file.

    Raises:
        InputError: For a file that cannot be read, is too large, or defines entities.
    """
    try:
        with opened(path, largest=LARGEST_FILE) as stream:
            return _parsed(stream.read(), _Builder(path))
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot read the model: {error.strerror}") from None
    except (expat.ExpatError, ValueError, LookupError) as error:  # LookupError: an unknown encoding
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: not {kind}: {reason}") from None


def _parsed(text: bytes, builder: _Builder) -> ElementTree.Element:
    """Parse a text without resolving namespaces, as models use undeclared prefixes."""
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = builder.doctype
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


def _put_includes_in_place(root: ElementTree.Element, path: Path, seen: set[Path], own: Path | None = None) -> None:
    """Replace every <include file="..."/> by the children of the file's root.

    Args:
        root: Root of the file that includes others; it is modified.
        path: The main file.
        seen: Absolute paths of the main file and the included files, which are added.
        own: The file of `root`; None: the main file.
    """
    for parent in list(root.iter()):
        for include in [child for child in parent if child.tag == "include"]:
            file = _included(include, path, own or path)
            if file in seen:
                raise InputError(f"{path}: {include.get('file')} is included twice")
            seen.add(file)
            part = parse(file)
            _put_includes_in_place(part, path, seen, file)
            at = list(parent).index(include)
            parent.remove(include)
            for k, child in enumerate(part):
                parent.insert(at + k, child)


def _included(include: ElementTree.Element, path: Path, own: Path) -> Path:
    """Return the included file: as in MuJoCo relative to the main file's folder, else to the including file's folder.

    Raises:
        InputError: For a file outside the main file's folder.
    """
    name, folder = include.get("file", ""), path.parent.resolve()
    try:
        places = [(folder / name).resolve(), (own.parent.resolve() / name).resolve()]
        found = next((file for file in places if file.exists()), None)
    except (OSError, ValueError, RuntimeError):  # an invalid name, links in a circle
        raise InputError(f"{path}: cannot include {name!r}") from None
    file = found or next((place for place in places if place.is_relative_to(folder)), places[0])
    if not name or not file.is_relative_to(folder):
        raise InputError(f"{path}: cannot include {name!r}: it is outside the model's folder")
    return file


def _name_bounds(root: ElementTree.Element, ledger: Ledger) -> None:
    """Name limits of motors and tendons, and flags that switch off joints' constraints: plans do not use them."""
    if any("forcerange" in each.attrib for each in root.iter()):
        ledger.name("'forcerange' in <actuator>")
    for each in root.iter():
        if each.tag in TENDONS and "range" in each.attrib and each.get("limited") != "false":
            ledger.name(f"'range' in <{each.tag}>", each.get("name", ""))
    for flag in root.findall("option/flag") if root.find("equality/joint") is not None else ():
        for name in ("constraint", "equality"):
            if flag.get(name) == "disable":
                ledger.name(f"{name}='disable' in <flag>")


def _leave_out(root: ElementTree.Element, path: Path, unwanted: set[str], ledger: Ledger) -> None:
    _name_bounds(root, ledger)
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in REFUSED:
                raise InputError(f"{path}: <{child.tag}> is not supported; write its bodies out")
            if child.tag not in VALID.get(parent.tag, (child.tag,)):
                valid = ", ".join(sorted(VALID[parent.tag]))
                raise InputError(f"{path}: <{child.tag}> is not valid in <{parent.tag}>; valid: {valid}")
            is_text = child.tag in ("text", "tuple") and not OWN.fullmatch(child.get("name", ""))
            if child.tag in unwanted or is_text or child.tag not in ONLY.get(parent.tag, (child.tag,)):
                parent.remove(child)
                (ledger.name if child.tag in NAMED else ledger.count)(f"<{child.tag}>")
        for name in HARMLESS.intersection(parent.attrib):
            ledger.count(f"{name!r} in <{parent.tag}>")
        parent.attrib.pop("material", None)
    for numeric in root.iter("numeric"):
        if not numeric.get("size", "0").strip().isdigit() or int(numeric.get("size", "0")) > LARGEST_NUMERIC:
            raise InputError(f"{path}: numeric {numeric.get('name')!r} must have a size of at most {LARGEST_NUMERIC:,}")
