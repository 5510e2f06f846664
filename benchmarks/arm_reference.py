"""Chain, limits, followers and poses of an arm as Pinocchio (URDF) or MuJoCo (MJCF) reads the original file.

Run by `python -m benchmarks arm-files` in an environment of its own, without htcp_jax: a JSON object per line on stdin,
{"file", "tcp", "moving": [joints], "x": {coordinate: [values]}}, and one on stdout: {"joints", "ranges", "followers",
"poses", "evidence"} or {"error", "evidence"}. `joints` lead from the world to the TCP; `ranges` are those of the
coordinates, within which all moving joints are in their own; infinite limits are null. Joints that follow others take
the values that follow; all others without values stay at their initial ones. `evidence` has what a refusal may be
about: ties of bodies, formats of meshes, elements <geometry> with another number of shapes than one.
"""

import json
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio
import xacrodoc

ENDLESS = -np.inf, np.inf


class Rule(NamedTuple):
    """A joint that follows another one, or that is held if `other` is None."""

    other: str | None
    value: Callable[[float], float]
    text: str


class Reading(NamedTuple):
    """A file as a library reads it."""

    joints: list[str]  # from the world to the TCP
    ranges: dict[str, tuple[float, float]]  # of all joints of one degree of freedom
    rules: dict[str, Rule]  # of the joints that follow others
    start: dict[str, float]  # initial values of all joints of one degree of freedom
    pose: Callable[[dict[str, float]], np.ndarray]  # pose of the TCP for values of all these joints


def by_pinocchio(file: str, tcp: str) -> Reading:
    """Return a URDF's reading; only <mimic> is read here, all else by Pinocchio."""
    model = pinocchio.buildModelFromUrdf(file)
    data, frame = model.createData(), model.getFrameId(tcp, pinocchio.FrameType.BODY)
    if frame >= model.nframes:
        raise ValueError(f"no link {tcp!r}")
    path, joint = [], model.frames[frame].parentJoint
    while joint:
        path.insert(0, joint)
        joint = model.parents[joint]
    ranges = {}
    for name, joint in zip(model.names, model.joints, strict=True):
        if joint.nv == 1:  # a continuous joint has two numbers: cosine and sine
            lower, upper = model.lowerPositionLimit, model.upperPositionLimit
            ranges[name] = ENDLESS if joint.nq == 2 else (lower[joint.idx_q], upper[joint.idx_q])
    rules = {}
    for each in without_prefixes(file).findall("joint"):
        if (mimic := each.find("mimic")) is not None and {each.get("name"), mimic.get("joint")} <= set(ranges):
            m, d = float(mimic.get("multiplier", 1)), float(mimic.get("offset", 0))
            text = f"{m:g} {mimic.get('joint')} + {d:g}"
            rules[each.get("name")] = Rule(mimic.get("joint"), lambda value, m=m, d=d: m * value + d, text)

    def pose(values: dict[str, float]) -> np.ndarray:
        q = pinocchio.neutral(model)
        for name, value in values.items():
            joint = model.joints[model.getJointId(name)]
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pinocchio.framesForwardKinematics(model, data, q)
        return data.oMf[frame].homogeneous

    return Reading([model.names[j] for j in path], ranges, rules, dict.fromkeys(ranges, 0.0), pose)


def by_mujoco(file: str, tcp: str) -> Reading:
    """Return an MJCF file's reading."""
    model = mujoco.MjModel.from_xml_path(file)
    data, site = mujoco.MjData(model), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tcp)
    body = int(model.site_bodyid[site]) if site >= 0 else model.body(tcp).id
    path, b = [], body
    while b:
        first = int(model.body_jntadr[b])
        path = [*range(first, first + int(model.body_jntnum[b])), *path]
        b = int(model.body_parentid[b])
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    single = [j for j in range(model.njnt) if model.jnt_type[j] in kinds]
    name_of = {j: model.joint(j).name or f"joint{j + 1}" for j in range(model.njnt)}
    ranges = {name_of[j]: tuple(model.jnt_range[j]) if model.jnt_limited[j] else ENDLESS for j in single}
    start = {name_of[j]: float(model.qpos0[model.jnt_qposadr[j]]) for j in single}
    rules = {}
    for k in np.flatnonzero((model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & (model.eq_active0 > 0)):
        name, other = name_of[int(model.eq_obj1id[k])], name_of.get(int(model.eq_obj2id[k]))
        c = model.eq_data[k, :5].copy()

        def value(x: float, name=name, other=other, c=c) -> float:
            return start[name] + float(np.polynomial.polynomial.polyval(x - start[other] if other else 0.0, c))

        rules[name] = Rule(other, value, f"{' '.join(f'{each:g}' for each in c)} of {other}")

    def pose(values: dict[str, float]) -> np.ndarray:
        for j in single:
            data.qpos[model.jnt_qposadr[j]] = values[name_of[j]]
        mujoco.mj_kinematics(model, data)
        at = (data.site_xpos[site], data.site_xmat[site]) if site >= 0 else (data.xpos[body], data.xmat[body])
        found = np.eye(4)
        found[:3, 3], found[:3, :3] = at[0], at[1].reshape(3, 3)
        return found

    return Reading([name_of[j] for j in path], ranges, rules, start, pose)


def without_prefixes(file: str) -> ElementTree.Element:
    """Return the root of an XML file, whose prefixes may be undeclared."""
    return ElementTree.fromstring(re.sub(r"(</?|\s)[\w-]+:(?=\w)", r"\1", Path(file).read_text(encoding="utf-8")))


def expanded(file: Path, folder: Path) -> str:
    """Expand a xacro file into a folder; the packages that its folder's files include are folders above it."""
    texts = [each.read_text(encoding="utf-8") for each in file.parent.rglob("*.xacro")]
    for package in {name for text in texts for name in re.findall(r"\$\(find (\w+)\)", text)}:
        near = [above if above.name == package else above / package for above in file.parents]
        if found := [each for each in near if each.is_dir()]:
            xacrodoc.packages.update_package_cache({package: found[0]})
    made = folder / "arm.urdf"
    made.write_text(xacrodoc.XacroDoc.from_file(file, resolve_packages=False).to_urdf_string(), encoding="utf-8")
    return str(made)


def following(reading: Reading, given: dict[str, float]) -> dict[str, float]:
    """Return the values of all joints for given values of some."""
    values = reading.start | given
    for _ in reading.rules:  # one that follows a follower comes last
        values |= {name: rule.value(values.get(rule.other, 0.0)) for name, rule in reading.rules.items()}
    return values


def range_of(reading: Reading, coordinate: str, moving: list[str]) -> list[float | None]:
    """Return the range of a coordinate in which all moving joints that depend on it are in their ranges."""
    at_0, at_1 = (following(reading, {coordinate: value}) for value in (0.0, 1.0))
    lower, upper = ENDLESS
    for name in {coordinate, *moving} & set(reading.ranges):
        if (factor := at_1[name] - at_0[name]) != 0:
            ends = sorted((end - at_0[name]) / factor for end in reading.ranges[name])
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
    return [None if np.isinf(end) else float(end) for end in (lower, upper)]


def poses(reading: Reading, x: dict[str, list[float]]) -> Iterator[list]:
    """Yield the pose of the TCP for each configuration."""
    for row in zip(*x.values(), strict=True):
        yield reading.pose(following(reading, dict(zip(x, row, strict=True)))).tolist()


def evidence(file: str) -> list[str]:
    """Return what is in a file that a reader may refuse."""
    if file.endswith(".xml"):
        spec, found = mujoco.MjSpec.from_file(file), set()
        for each in spec.equalities:
            if each.active and each.type in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                found.add(f"{each.type.name.removeprefix('mjEQ_').lower()} of {each.name1} and {each.name2}")
        return sorted(found)
    root = without_prefixes(file)
    meshes = {Path(each.get("filename")).suffix.lower() for each in root.findall("link/collision/geometry/mesh")}
    shapes = root.findall("link/*/geometry")
    found = [f"meshes {each}" for each in sorted(meshes)] + ([] if shapes else ["no <geometry>"])
    return found + [f"<geometry> with {count} shapes" for count in sorted({len(each) for each in shapes} - {1})]


def answer(wanted: dict) -> dict:
    """Return the results for a request."""
    read = by_mujoco if wanted["file"].endswith(".xml") else by_pinocchio
    with tempfile.TemporaryDirectory() as folder:
        file = expanded(Path(wanted["file"]), Path(folder)) if wanted["file"].endswith(".xacro") else wanted["file"]
        try:
            reading = read(file, wanted["tcp"])
        except Exception as error:
            return {"error": f"{type(error).__name__}: {error}", "evidence": evidence(file)}
        seen = evidence(file)
    if wrong := [name for name in reading.joints if name not in reading.ranges]:
        return {"error": f"joints of several degrees of freedom: {', '.join(wrong)}", "evidence": seen}
    return {
        "joints": reading.joints,
        "ranges": {name: range_of(reading, name, wanted["moving"]) for name in wanted["x"]},
        "evidence": seen,
        "followers": {name: rule.text for name, rule in reading.rules.items()},
        "poses": list(poses(reading, wanted["x"])),
    }


if __name__ == "__main__":
    for line in sys.stdin:
        try:
            print(json.dumps(answer(json.loads(line))), flush=True)
        except Exception as error:
            print(json.dumps({"error": f"{type(error).__name__}: {error}"}), flush=True)
