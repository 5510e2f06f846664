"""Composition of the models of a cell into one tree: an arm, and a positioner, a rail and a tool, each with its parent.

MuJoCo attaches each model to a frame on its parent (`MjSpec.attach`). The result is the same tree as that of a single
file for the complete cell, see `model_file`. The robot's links keep their names; the key of any other model is put
before its links' names: positioner.table. Joints keep their names.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots import remarks
from htcp_jax.io.robots.mujoco_models import compile_unchecked, delete_all, joint_name, no_log, set_massless
from htcp_jax.io.robots.safe_xml import CUTS, LIST, MADE_FROM, OMITTED, PART, read_spec
from htcp_jax.io.robots.stored_pieces import EXCESS, FITTED, PIECE, RADIUS
from htcp_jax.spec import ROBOT, WORLD, ComposedModel, ModelSource, PlacedModel, split_name
from htcp_jax.types import Triple

PER_JOINT = "speed", "acceleration", "datasheet_lower", "datasheet_upper"  # <numeric>s with one value per joint
# Heads of the names of texts and numerics that are named after a capsule, a joint or a body.
_NAMED_AFTER = PIECE, CUTS, RADIUS, FITTED, EXCESS, remarks.ON_JOINT, remarks.ON_BODY


class _Carrier(NamedTuple):
    """A link of the tree, and a frame on it."""

    body: mujoco.MjsBody
    position: np.ndarray
    quaternion: np.ndarray


class _Part(NamedTuple):
    """A model of the cell, as read and as compiled."""

    placed: PlacedModel
    spec: mujoco.MjSpec
    model: mujoco.MjModel  # compiled without shapes

    @property
    def prefix(self) -> str:
        """Prefix of the model's names in the tree."""
        return "" if self.placed.key == ROBOT else f"{self.placed.key}."


@no_log()
def read_model(source: ModelSource) -> mujoco.MjSpec:
    """Read a model of an arm or a cell as an MjSpec, without compiling it.

    Args:
        source: The model's file, or the models that form the cell.

    Raises:
        InputError: As `read_spec` does, for an unknown parent, for a cycle of parents, and for a joint with the name of
            a joint in another model.
    """
    return _compose(source) if isinstance(source, ComposedModel) else read_spec(source, contacts=True)


def indexed_joints(named: Sequence[str], source: ModelSource) -> tuple[str, ...]:
    """Return the names of the joints that stand still within each seam.

    Args:
        named: Names in `robot.indexed` of a job.
        source: Its model, or the models that form its cell, of which some may be indexed.

    Raises:
        InputError: For a model that cannot be read.
    """
    models = source.models if isinstance(source, ComposedModel) else ()
    more = (_joint_names(each.file) for each in models if each.indexed)
    return tuple(dict.fromkeys(itertools.chain(named, *more)))


@no_log()
def _joint_names(file: Path) -> list[str]:
    return [joint.name for joint in _read_spec(file).joints]


def _read_spec(file: Path) -> mujoco.MjSpec:
    """Read a model whose joints all have names: their own, or those of `mujoco_models.joint_name`."""
    spec = read_spec(file, contacts=True)
    for number, joint in enumerate(spec.joints, 1):
        joint.name = joint.name or f"joint{number}"
    return spec


def _compose(cell: ComposedModel) -> mujoco.MjSpec:
    parts = {each.key: _read_part(each) for each in cell.models}
    _refuse_repeated_joints(parts.values())
    tree = mujoco.MjSpec()
    tree.modelname = " + ".join(_name_of(part) for part in parts.values())
    for key in _from_the_world(cell.models):
        placed, spec, _ = parts[key]
        found = _carrier(tree, parts, placed.parent, f"{key}.parent")
        on_parent = found.body.add_frame(pos=found.position, quat=found.quaternion)
        frame = found.body.add_frame(on_parent, pos=placed.base_m, quat=_quaternion(placed.base_rpy_rad))
        tree.attach(_without_custom(spec), frame=frame, prefix=f"{key}.")
        _rename(tree, parts[key])
    _add_custom(tree, parts.values())
    own = [text.data for text in parts[ROBOT].spec.texts if text.name == PART]
    if part := cell.part or next(iter(own), None):
        found = _carrier(tree, parts, part, "workpiece.parent")
        if found.position.any() or (found.quaternion != [1, 0, 0, 0]).any():  # a site: it gets a body
            body = found.body.add_body(name=part, pos=found.position, quat=found.quaternion)
        else:
            body = found.body
        tree.add_text(name=PART, data=body.name)
    return tree


def _read_part(placed: PlacedModel) -> _Part:
    spec = _read_spec(placed.file)
    set_massless(spec)  # as for a single file
    bare = spec.copy()
    delete_all(bare, bare.tuples, bare.excludes, bare.geoms, bare.meshes)
    return _Part(placed, spec, compile_unchecked(bare, placed.file))


def _without_custom(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a model without texts, numerics, tuples and exclusions with its world, which may move in the tree."""
    own = spec.copy()
    of_world = [each for each in own.excludes if WORLD in (each.bodyname1, each.bodyname2)]
    delete_all(own, own.tuples, own.texts, own.numerics, of_world)
    return own


def _name_of(part: _Part) -> str:
    name = part.spec.modelname
    return part.placed.file.stem if name in ("", "MuJoCo Model") else name


def _refuse_repeated_joints(parts: Collection[_Part]) -> None:
    owner: dict[str, str] = {}
    for part in parts:
        for j in range(part.model.njnt):
            name, file = joint_name(part.model, j), f"{part.placed.key}.model ({part.placed.file.name})"
            if name in owner:
                raise InputError(f"joint {name!r} is in {owner[name]} and in {file}; joint names must be unique")
            owner[name] = file


def _from_the_world(models: Sequence[PlacedModel]) -> tuple[str, ...]:
    """Return the models' keys, parents before children.

    Raises:
        InputError: For a parent without a model, and for a cycle of parents.
    """
    parents = {each.key: split_name(each.parent)[0] for each in models}
    order: list[str] = []
    for key in parents:
        line = [key]
        while (parent := parents[line[-1]]) != WORLD:
            if parent not in parents:
                raise _no_model(f"{line[-1]}.parent", parent, [other for other in parents if other != line[-1]])
            if parent in line:
                raise InputError(f"the parents form a circle: {' -> '.join([*line[line.index(parent) :], parent])}")
            line.append(parent)
        order += line[::-1]
    return tuple(dict.fromkeys(order))


def _no_model(what: str, key: str, others: Collection[str]) -> InputError:
    valid = ", ".join([WORLD, *(f"{other}.LINK" for other in others)])
    return InputError(f"{what} is on the {key}, but {key}.model is missing; set it, or choose: {valid}")


def _carrier(tree: mujoco.MjSpec, parts: Mapping[str, _Part], name: str, what: str) -> _Carrier:
    """Return the link or site of a name as a carrier; `what` is the job's key for it, for messages.

    Raises:
        InputError: For an unknown name.
    """
    key, link = split_name(name)
    still = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if key == WORLD:
        return _Carrier(tree.worldbody, *still)
    if key not in parts:
        raise _no_model(what, key, parts)
    part = parts[key]
    model = part.model
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link) > 0:
        return _Carrier(tree.body(part.prefix + link), *still)
    if (site := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, link)) >= 0:
        body = tree.site(part.prefix + link).parent
        return _Carrier(body, model.site_pos[site].copy(), model.site_quat[site].copy())
    names = [model.body(b).name for b in range(1, model.nbody)] + [model.site(s).name for s in range(model.nsite)]
    valid = ", ".join(dict.fromkeys(each for each in names if each)) or "none"
    raise InputError(f"{what}: no link {link!r} in {part.placed.file}; valid: {valid}")


def _rename(tree: mujoco.MjSpec, part: _Part) -> None:
    """Remove the prefix from the names of an attached model's joints; from all its names if the model is the robot."""
    prefix = f"{part.placed.key}."
    named = [*tree.joints]
    if part.placed.key == ROBOT:
        named += [*tree.bodies, *tree.geoms, *tree.sites]
        for pair in tree.excludes:
            pair.bodyname1 = pair.bodyname1.removeprefix(prefix)
            pair.bodyname2 = pair.bodyname2.removeprefix(prefix)
    for each in named:
        each.name = each.name.removeprefix(prefix)
    for each in tree.equalities:
        if each.type == mujoco.mjtEq.mjEQ_JOINT or part.placed.key == ROBOT:
            each.name1, each.name2 = each.name1.removeprefix(prefix), each.name2.removeprefix(prefix)


def _add_custom(tree: mujoco.MjSpec, parts: Collection[_Part]) -> None:
    """Add the texts, numerics and tuples of all models, with their names in the tree."""
    number, joints = 0, [joint.name for joint in tree.joints]
    values: dict[str, dict[str, float]] = {}
    omitted: list[str] = []
    for part in parts:
        prefix, own = part.prefix, [joint_name(part.model, j) for j in range(part.model.njnt)]
        for each in [*part.spec.texts, *part.spec.numerics]:
            if head := next((head for head in _NAMED_AFTER if each.name.startswith(head)), None):
                owner = each.name.removeprefix(head)  # joints keep their names
                _add_alike(tree, each, head + owner if head == remarks.ON_JOINT else head + prefix + owner)
            elif each.name in PER_JOINT:
                values.setdefault(each.name, {}).update(zip(own, each.data, strict=True))
            elif each.name == OMITTED:
                omitted += [prefix + name for name in each.data.splitlines()]
            elif each.name == MADE_FROM:
                tree.add_text(name=prefix + MADE_FROM, data=str(part.placed.file.resolve().parent / each.data))
            elif each.name == LIST:
                names = [prefix + geom.name for geom in part.spec.geoms if geom.name]
                tree.add_text(name=f"{LIST} of {part.placed.key}", data="\n".join(names))
        pairs = [(list(pair.objname), list(pair.objprm), pair.name.partition(", ")[2]) for pair in part.spec.tuples]
        pairs += [(list(pair), [0.0, 0.0], "rule a") for pair in _excluded_in_world(part.spec)]
        for names, numbers, rule in pairs:
            number += 1
            tree.add_tuple(
                name=f"excluded {number}, {rule}",
                objtype=[mujoco.mjtObj.mjOBJ_GEOM] * len(names),
                objname=[prefix + name for name in names],
                objprm=numbers,
            )
    if omitted:
        tree.add_text(name=OMITTED, data="\n".join(omitted))
    for name, known in values.items():
        complete = all(joint in known for joint in joints)
        if complete or not name.startswith("datasheet"):
            tree.add_numeric(name=name, data=[known.get(joint, np.inf) for joint in joints], size=len(joints))


def _add_alike(tree: mujoco.MjSpec, element: mujoco.MjsText | mujoco.MjsNumeric, name: str) -> None:
    if isinstance(element, mujoco.MjsText):
        tree.add_text(name=name, data=element.data)
    else:
        tree.add_numeric(name=name, data=element.data, size=len(element.data))


def _excluded_in_world(spec: mujoco.MjSpec) -> Iterator[tuple[str, str]]:
    """Yield the names of excluded pairs of capsules of which one is fixed to the model's world."""
    for each in spec.excludes:
        if WORLD in (names := {each.bodyname1, each.bodyname2}) and len(names) == 2:
            (other,) = names - {WORLD}
            both = [[geom.name for geom in body.geoms if geom.name] for body in (spec.worldbody, spec.body(other))]
            yield from itertools.product(*both)


def _quaternion(rpy_rad: Triple) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_euler2Quat(quaternion, np.array(rpy_rad, float), "XYZ")
    return quaternion
