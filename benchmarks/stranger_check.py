"""Plans and exclusions of one job, checked with the original meshes of its arm.

Run by `python -m benchmarks strangers` in an environment of its own, without htcp_jax: a JSON object per line on stdin,
{"folder", "file", "tcp"}, and one on stdout. The folder has job.yaml, part.obj and seam.csv, and what `htcp` made of
them: plan/motion.csv, plan/trajectory.csv and reach/reach.csv, or only clear.csv. Pinocchio (URDF) or MuJoCo (MJCF)
moves the arm, and FCL finds contacts of triangles.

- Motion: PLACES places on the straight line between two rows are free, within the joint ranges, and the TCP is on the
  seam at its targets and near the chord between them. Distances at the targets are at least those that the plan states.
- Reachable targets: the configuration in reach.csv is on the target and free.
- Excluded targets: STARTS random configurations are moved onto the target by damped least squares. A solution in which
  neither the tool nor the arm is nearer to the part than the margin is a counterexample. The same starts are used at
  reachable targets, where they should find a solution.
- Clear configurations: in those in clear.csv the arm and its tool do not touch themselves or each other.

Links that are rigidly connected are not tested against each other, nor adjacent links of the same model, nor pairs that
touch in at least 95 % of random configurations. Distances of the tool from the link before it do not count.
"""

import csv
import json
import sys
import time
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import fcl
import mujoco
import numpy as np
import trimesh
import yaml
from scipy.linalg import logm
from scipy.spatial.transform import Rotation

PLACES = 200  # of a segment
STARTS = 5000  # at a target
STEPS = 60  # of damped least squares
SAME_M, ON_TARGET_M, NEAR_M = 1e-9, 1e-6, 1e-3  # of two forward kinematics; of a solution; of the plan's TCP
ROUND_M = 2e-4  # a plan's clearance may be larger than that of the triangles that replace round bodies
SAMPLED = 200  # configurations by which pairs that always touch are found
USUAL = 0.95
PLANE_M = 5.0  # half of the edge of the box that replaces a plane

Values = dict[str, float]
Poses = dict[str, np.ndarray]


class Model(NamedTuple):
    """A file as a library reads it, in its own frame."""

    ranges: dict[str, tuple[float, float]]  # of its joints, from the base on
    poses: Callable[[Values], Poses]  # of all links
    shapes: list[tuple[str, trimesh.Trimesh]]  # link, and mesh in its frame


def by_pinocchio(file: Path) -> Model:
    """Read a URDF."""
    import pinocchio

    model = pinocchio.buildModelFromUrdf(str(file))
    data, ranges = model.createData(), {}
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        endless = joint.nq == 2
        at = joint.idx_q
        ranges[name] = (-np.inf, np.inf) if endless else (model.lowerPositionLimit[at], model.upperPositionLimit[at])

    def poses(values: Values) -> Poses:
        q = pinocchio.neutral(model)
        for name, value in values.items():
            if model.existJointName(name):
                joint = model.joints[model.getJointId(name)]
                q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pinocchio.framesForwardKinematics(model, data, q)
        kind = pinocchio.FrameType.BODY
        return {f.name: data.oMf[k].homogeneous.copy() for k, f in enumerate(model.frames) if f.type == kind}

    shapes = []
    for link in ElementTree.parse(file).findall("link"):
        for each in link.findall("collision"):
            origin, geometry = each.find("origin"), each.find("geometry")[0]
            mesh = urdf_mesh(geometry, file)
            if origin is not None:
                mesh.apply_transform(pose(numbers(origin, "xyz", "0 0 0"), numbers(origin, "rpy", "0 0 0")))
            shapes.append((link.get("name"), mesh))
    return Model(ranges, poses, shapes)


def numbers(element: ElementTree.Element, name: str, default: str) -> list[float]:
    """Return an attribute's numbers."""
    return [float(each) for each in element.get(name, default).split()]


def pose(xyz: Iterable[float], rpy: Iterable[float] = (0, 0, 0)) -> np.ndarray:
    """Return the matrix of a position and angles about fixed x, y and z."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = list(xyz), Rotation.from_euler("xyz", list(rpy)).as_matrix()
    return T


def urdf_mesh(geometry: ElementTree.Element, file: Path) -> trimesh.Trimesh:
    """Return the mesh of an element in <geometry>."""
    if geometry.tag == "box":
        return trimesh.creation.box(numbers(geometry, "size", ""))
    if geometry.tag == "sphere":
        return trimesh.creation.icosphere(3, float(geometry.get("radius")))
    if geometry.tag == "cylinder":
        return trimesh.creation.cylinder(float(geometry.get("radius")), float(geometry.get("length")), sections=64)
    name = geometry.get("filename").removeprefix("package://").removeprefix("file://")
    inner = [name, name.partition("/")[2]]
    found = [above / each for above in file.parents for each in inner if each and (above / each).is_file()]
    mesh = trimesh.load(found[0], force="mesh")
    return mesh.apply_scale(numbers(geometry, "scale", "1 1 1"))


def by_mujoco(file: Path) -> Model:
    """Read an MJCF file."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    names = [model.joint(j).name or f"joint{j + 1}" for j in range(model.njnt)]
    ranges = {
        name: tuple(model.jnt_range[j]) if model.jnt_limited[j] else (-np.inf, np.inf) for j, name in enumerate(names)
    }
    bodies = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
    sites = [model.site(s).name for s in range(model.nsite)]

    def poses(values: Values) -> Poses:
        data.qpos[:] = model.qpos0
        for j, name in enumerate(names):
            if name in values:
                data.qpos[model.jnt_qposadr[j]] = values[name]
        mujoco.mj_kinematics(model, data)
        found = {name: matrix(data.xpos[b], data.xmat[b]) for b, name in enumerate(bodies)}
        return {name: matrix(data.site_xpos[s], data.site_xmat[s]) for s, name in enumerate(sites)} | found

    shapes = []
    for g in range(model.ngeom):
        if model.geom_contype[g] or model.geom_conaffinity[g]:
            mesh = geom_mesh(model, g)
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, model.geom_quat[g])
            shapes.append((bodies[model.geom_bodyid[g]], mesh.apply_transform(matrix(model.geom_pos[g], rotation))))
    return Model(ranges, poses, shapes)


def matrix(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return the matrix of a pose."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = position, rotation.reshape(3, 3)
    return T


def geom_mesh(model: mujoco.MjModel, g: int) -> trimesh.Trimesh:
    """Return the mesh of a geom in its own frame."""
    kind, size = mujoco.mjtGeom(model.geom_type[g]), model.geom_size[g]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        m = model.geom_dataid[g]
        first, count = model.mesh_vertadr[m], model.mesh_vertnum[m]
        face, faces = model.mesh_faceadr[m], model.mesh_facenum[m]
        vertices = model.mesh_vert[first : first + count]
        return trimesh.Trimesh(vertices.astype(float), model.mesh_face[face : face + faces], process=False)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return trimesh.creation.icosphere(3, size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return capsule(np.array([0, 0, -size[1]]), np.array([0, 0, size[1]]), size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(size[0], 2 * size[1], sections=64)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return trimesh.creation.box([2 * PLANE_M, 2 * PLANE_M, 0.1]).apply_translation([0, 0, -0.05])
    raise ValueError(f"no mesh of a {kind.name}")


def capsule(p: np.ndarray, q: np.ndarray, radius: float) -> trimesh.Trimesh:
    """Return a capsule's mesh, whose vertices are on its surface."""
    length = float(np.linalg.norm(q - p))
    mesh = trimesh.creation.capsule(length, radius, count=[48, 48])  # begins at its middle or end, by version
    mesh.apply_translation([0, 0, -mesh.bounds[:, 2].mean()])
    turned = trimesh.geometry.align_vectors([0, 0, 1], (q - p) / length) if length else np.eye(4)
    return mesh.apply_transform(pose((p + q) / 2) @ turned)


class Body:
    """A mesh on a link."""

    def __init__(self, name: str, link: str, mesh: trimesh.Trimesh):
        self.name, self.link = name, link
        self.middle = mesh.bounds.mean(axis=0)
        self.radius = float(np.linalg.norm(mesh.vertices - self.middle, axis=1).max())
        geometry = fcl.BVHModel()
        geometry.beginModel(len(mesh.vertices), len(mesh.faces))
        geometry.addSubModel(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        geometry.endModel()
        self.object = fcl.CollisionObject(geometry)

    def place(self, poses: Poses) -> None:
        T = poses[self.link]
        self.object.setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        self.at = T[:3, :3] @ self.middle + T[:3, 3]


def gap(a: Body, b: Body) -> float:
    """Return a lower bound on the distance of two placed bodies."""
    return float(np.linalg.norm(a.at - b.at)) - a.radius - b.radius


def touch(a: Body, b: Body) -> bool:
    """Return True if the triangles of two placed bodies intersect."""
    return gap(a, b) <= 0 and fcl.collide(a.object, b.object, fcl.CollisionRequest(), fcl.CollisionResult()) > 0


class Cell:
    """The models of a job in the world, its part and its fixed bodies."""

    def __init__(self, folder: Path, file: Path, tcp: str):
        self.job = job = yaml.safe_load((folder / "job.yaml").read_text())
        self.models: dict[str, tuple[Model, str, np.ndarray]] = {}
        for name in ("rail", "positioner", "robot", "tool"):
            if own := job.get(name):
                path = file if name == "robot" else folder / own["model"]
                model = by_pinocchio(path) if path.suffix == ".urdf" else by_mujoco(path)
                base = pose(own.get("base_m", (0, 0, 0)), own.get("base_rpy_rad", (0, 0, 0)))
                self.models[name] = model, own.get("parent", "world"), base
        self.locked: Values = job["robot"].get("locked", {})
        part, hand = job["workpiece"], job["robot"].get("tool") or {}
        self.flange = f"robot.{tcp}"
        self.tip = pose(hand.get("tip_m", (0, 0, 0)), hand.get("tip_rpy_rad", (0, 0, 0)))
        self.part_link = part.get("parent", "world").replace("robot.tcp", self.flange)
        turns = [part.get(f"rotation_{axis}_rad", 0.0) for axis in "xyz"]
        self.part = pose(part.get("shift_m", (0, 0, 0)), turns)
        self.rows = [row for row in job.get("task", []) if "axis" in row]
        self.margin = job.get("margin_m", 5e-4)
        seam = np.genfromtxt(folder / "seam.csv", delimiter=",", names=True)
        self.seam = np.column_stack([seam[axis] for axis in "xyz"])
        self.normal = np.column_stack([seam[f"n{axis}"] for axis in "xyz"])
        self.bodies, self.fixed = self._bodies(folder, hand)

    def _bodies(self, folder: Path, hand: dict[str, Any]) -> tuple[list[Body], list[Body]]:
        bodies = []
        for name, (model, _, _) in self.models.items():
            for link in dict.fromkeys(link for link, _ in model.shapes):
                mesh = trimesh.util.concatenate([each for own, each in model.shapes if own == link])
                bodies.append(Body(f"{name}.{link}", f"{name}.{link}", mesh))
        for each in hand.get("bodies", []):
            mesh = capsule(np.array(each["p_m"], float), np.array(each["q_m"], float), each["radius_m"])
            bodies.append(Body(f"hand.{each['name']}", self.flange, mesh))
        fixed = [Body("part", "part", trimesh.load(folder / "part.obj", force="mesh", process=False))]
        if model := (self.job.get("cell") or {}).get("model"):
            own = by_mujoco(folder / model)
            at_rest = own.poses({})
            fixed += [Body(f"cell.{k}", "world", m.apply_transform(at_rest[n])) for k, (n, m) in enumerate(own.shapes)]
        return bodies, fixed

    def poses(self, values: Values) -> Poses:
        """Return the poses of all links, the part and the TCP in the world."""
        found: Poses = {"world": np.eye(4)}
        for name, (model, parent, base) in self.models.items():
            carrier = found[parent if parent in found else f"robot.{parent}"] @ base
            found |= {f"{name}.{link}": carrier @ T for link, T in model.poses(values | self.locked).items()}
        found["part"] = found[self.part_link] @ self.part
        found["tcp"] = found["tool.tcp"] if "tool" in self.models else found[self.flange] @ self.tip
        return found

    def ranges(self, names: list[str]) -> np.ndarray:
        """Return the ranges of joints."""
        known = {joint: ends for model, _, _ in self.models.values() for joint, ends in model.ranges.items()}
        return np.array([known[name] for name in names])

    @cached_property
    def _pairs(self) -> dict[tuple[str, ...], list[tuple[Body, Body]]]:
        return {}

    def pairs(self, names: list[str]) -> list[tuple[Body, Body]]:
        """Return the pairs that are tested; those that touch in nearly all random configurations are not."""
        if tuple(names) not in self._pairs:
            moved = moving_joints(self, names)
            every = [*self.bodies, *self.fixed]
            candidates = [
                (a, b)
                for i, a in enumerate(every)
                for b in every[i + 1 :]
                if is_tested(a, b, moved[a.link], moved[b.link])
            ]
            count, rng = np.zeros(len(candidates)), np.random.default_rng(1)
            for q in samples(self, names, SAMPLED, rng):
                self.place(self.poses(dict(zip(names, q, strict=True))))
                count += [touch(a, b) for a, b in candidates]
            kept = count < USUAL * SAMPLED
            self._pairs[tuple(names)] = [pair for pair, is_kept in zip(candidates, kept, strict=True) if is_kept]
        return self._pairs[tuple(names)]

    def place(self, poses: Poses) -> None:
        """Place all bodies."""
        for body in (*self.bodies, *self.fixed):
            body.place(poses)

    def contacts(self, pairs: list[tuple[Body, Body]]) -> list[str]:
        """Return the names of placed pairs that touch."""
        return [f"{a.name} and {b.name}" for a, b in pairs if touch(a, b)]

    def distance(self, pairs: list[tuple[Body, Body]]) -> tuple[float, str]:
        """Return the smallest distance of placed pairs, and their names."""
        best, names = np.inf, ""
        for a, b in sorted(pairs, key=lambda pair: gap(*pair)):
            if gap(a, b) >= best:
                break
            found = 0.0 if touch(a, b) else fcl.distance(a.object, b.object, fcl.DistanceRequest(), None)
            if found < best:
                best, names = found, f"{a.name} and {b.name}"
        return best, names


def is_tested(a: Body, b: Body, first: frozenset[str], second: frozenset[str]) -> bool:
    """Return True if two bodies are on links that are neither rigidly connected nor adjacent in one model."""
    if first == second:
        return False
    is_one_arm = a.name.partition(".")[0] == b.name.partition(".")[0] != "hand"
    return not (is_one_arm and len(first ^ second) == 1)


def moving_joints(cell: Cell, names: list[str]) -> dict[str, frozenset[str]]:
    """Return the joints that move each link."""
    rest = cell.poses(dict.fromkeys(names, 0.1))
    moved = {name: cell.poses(dict.fromkeys(names, 0.1) | {name: 0.7}) for name in names}
    return {link: frozenset(n for n in names if np.abs(moved[n][link] - T).max() > SAME_M) for link, T in rest.items()}


def samples(cell: Cell, names: list[str], count: int, rng: np.random.Generator) -> np.ndarray:
    """Return random configurations within the ranges; those of endless joints within a turn."""
    lower, upper = np.clip(cell.ranges(names), -2 * np.pi, 2 * np.pi).T
    return rng.uniform(lower, upper, (count, len(names)))


class Chain:
    """Product of exponentials of the TCP and the part, for batches of configurations."""

    def __init__(self, cell: Cell, names: list[str]):
        self.names, rest = names, cell.poses(dict.fromkeys(names, 0.0))
        at_1 = {name: cell.poses({**dict.fromkeys(names, 0.0), name: 1.0}) for name in names}
        count = {n: sum(np.abs(at_1[n][link] - T).max() > SAME_M for link, T in rest.items()) for n in names}
        self.ends = {}
        for end in ("tcp", "part"):
            moving = [n for n in names if np.abs(at_1[n][end] - rest[end]).max() > SAME_M]
            order = sorted(moving, key=lambda n: -count[n])
            twists = [np.real(logm(at_1[n][end] @ np.linalg.inv(rest[end]))) for n in order]
            self.ends[end] = [names.index(n) for n in order], twists, rest[end]
        for q in samples(cell, names, 5, np.random.default_rng(2)):
            exact = cell.poses(dict(zip(names, q, strict=True)))
            for end in self.ends:
                assert np.abs(self.poses(end, q[None])[0][0] - exact[end]).max() < 1e-6, end

    def poses(self, end: str, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses of an end, and for each joint its twist in the world (angular, linear)."""
        order, twists, rest = self.ends[end]
        T, moved = np.tile(np.eye(4), (len(q), 1, 1)), np.zeros((len(q), len(self.names), 6))
        for j, twist in zip(order, twists, strict=True):
            axis, velocity = np.array([twist[2, 1], twist[0, 2], twist[1, 0]]), twist[:3, 3]
            R, t = T[:, :3, :3], T[:, :3, 3]
            moved[:, j, :3] = R @ axis
            moved[:, j, 3:] = np.cross(t, moved[:, j, :3]) + R @ velocity
            T = T @ exponentials(twist, q[:, j])
        return T @ rest, moved


def exponentials(twist: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Return the poses of a twist, whose rotation has length 1 or 0, for many angles."""
    W, v, a = twist[:3, :3], twist[:3, 3], angle[:, None, None]
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] += np.sin(a) * W + (1 - np.cos(a)) * W @ W
    T[:, :3, 3] = (a * np.eye(3) + (1 - np.cos(a)) * W + (a - np.sin(a)) * W @ W) @ v
    return T


AXES = {"x": 0, "y": 1, "z": 2}


def direction(row: dict[str, Any], part: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the directions in the world that a row of the task names, for poses of the part."""
    towards = row["towards"]
    if isinstance(towards, str):
        assert towards.lstrip("-") == "path.normal", towards
        return part[..., :3, :3] @ (-normal if towards.startswith("-") else normal)
    world = np.array(towards, float) / np.linalg.norm(towards)
    return np.broadcast_to(world, (*part.shape[:-2], 3))


def deviations(cell: Cell, tcp: np.ndarray, part: np.ndarray, normal: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Return for each row of the task the axis, its direction, the angle between them, and the allowed angle."""
    found = []
    for row in cell.rows:
        name, _, axis = row["axis"].rpartition(".")
        a = tcp[..., :3, AXES[axis]] if name == "tcp" else part[..., :3, :3] @ normal
        d = direction(row, part, normal)
        angle = np.arctan2(np.linalg.norm(np.cross(a, d), axis=-1), np.sum(a * d, axis=-1))
        found.append((a, d, angle, np.deg2rad(row.get("cone_deg", 0.0))))
    return found


def solutions(cell: Cell, chain: Chain, target: int, starts: np.ndarray) -> np.ndarray:
    """Return configurations on a target that damped least squares finds from starts."""
    lower, upper = cell.ranges(chain.names).T
    q, found = starts.copy(), []
    point, normal = cell.seam[target], cell.normal[target]
    for _ in range(STEPS):
        (tcp, tool), (part, carried) = chain.poses("tcp", q), chain.poses("part", q)
        goal = part[:, :3, :3] @ point + part[:, :3, 3]
        moved = tool - carried
        error = [goal - tcp[:, :3, 3]]
        jacobian = [np.swapaxes(np.cross(moved[..., :3], goal[:, None]) + moved[..., 3:], 1, 2)]
        is_done = np.linalg.norm(error[0], axis=1) < ON_TARGET_M
        for (a, d, angle, allowed), row in zip(deviations(cell, tcp, part, normal), cell.rows, strict=True):
            is_wide = angle > 0.97 * allowed
            turn = np.cross(a, d) / np.maximum(np.sin(angle), 1e-9)[:, None] * (angle - 0.95 * allowed)[:, None]
            turning = tool if row["axis"].startswith("tcp") else carried
            if isinstance(row["towards"], str):
                turning = turning - carried
            error.append(np.where(is_wide[:, None], turn, 0.0))
            jacobian.append(np.where(is_wide[:, None, None], np.swapaxes(turning[..., :3], 1, 2), 0.0))
            is_done &= angle <= allowed
        found.append(q[is_done])
        q, J = q[~is_done], np.concatenate(jacobian, axis=1)[~is_done]
        if not len(q):
            break
        e = np.concatenate(error, axis=1)[~is_done]
        size = np.linalg.norm(e, axis=1)
        damping = np.clip(0.1 * size, 1e-6, 0.05)[:, None, None] ** 2 * np.eye(e.shape[1])
        step = np.swapaxes(J, 1, 2) @ np.linalg.solve(J @ np.swapaxes(J, 1, 2) + damping, e[..., None])
        longest = np.abs(step).max(axis=1, keepdims=True)
        q = np.clip(q + (step * np.minimum(1.0, 0.5 / np.maximum(longest, 1e-12)))[..., 0], lower, upper)
    return np.concatenate(found)


def attacked(cell: Cell, chain: Chain, target: int, starts: np.ndarray) -> dict[str, Any]:
    """Return how many solutions are on a target, and one of those without contact of tool or arm with the part."""
    moved = moving_joints(cell, chain.names)
    part = cell.fixed[0]
    bodies = [body for body in reversed(cell.bodies) if moved[body.link] != moved["part"]]
    on_target = solutions(cell, chain, target, starts)
    free, best = 0, (-np.inf, "", None)
    for q in on_target:
        poses = cell.poses(dict(zip(chain.names, q, strict=True)))
        part.place(poses)
        for body in bodies:
            body.place(poses)
            if touch(body, part):
                break
        else:
            distance, names = cell.distance([(body, part) for body in bodies])
            if distance >= cell.margin:
                free += 1
            if distance > best[0]:
                best = distance, names, q
    counter = best[2].tolist() if free else None
    best_m = best[0] if best[1] else None
    return {"on_target": len(on_target), "free": free, "best_m": best_m, "nearest": best[1], "q": counter}


def checked_motion(cell: Cell, plan: Path, chain: Chain) -> dict[str, Any]:
    """Check all places of a plan's motion."""
    rows = rows_of(plan / "motion.csv")
    traced = rows_of(plan / "trajectory.csv")
    names = chain.names
    q = np.array([[float(row[f"{name}{unit_of(rows[0], name)}"]) for name in names] for row in rows])
    before = len(traced) - len(cell.seam)  # targets before the path's first point
    lower, upper = cell.ranges(names).T
    pairs, hits, places, nearest = cell.pairs(names), {}, 0, (np.inf, "")
    off_chord = off_limits = 0.0
    for k in range(1, len(rows)):
        target = int(rows[k]["target"]) - before
        for at in np.linspace(1 / PLACES, 1.0, PLACES) if k > 1 else np.linspace(0.0, 1.0, PLACES):
            x = q[k - 1] + at * (q[k] - q[k - 1])
            poses = cell.poses(dict(zip(names, x, strict=True)))
            cell.place(poses)
            places += 1
            off_limits = max(off_limits, float(np.maximum(lower - x, x - upper).max()))
            for each in cell.contacts(pairs):
                hits.setdefault(each, []).append([k, round(float(at), 3), rows[k]["kind"]])
            if rows[k]["kind"] == "PROCESS" and target >= 1:
                tcp = np.linalg.inv(poses["part"]) @ poses["tcp"][:, 3]
                off_chord = max(off_chord, from_chord(tcp[:3], cell.seam[target - 1], cell.seam[target]))
    moved, off_target, off_cone, too_large = moving_joints(cell, names), 0.0, 0.0, 0.0
    apart = [(a, b) for a, b in pairs if "part" in (a.name, b.name) or len(moved[a.link] ^ moved[b.link]) > 1]
    executed = {int(row["target"]) for row in rows}
    for row in traced:
        target = int(row["target"]) - before
        if target < 0 or int(row["target"]) not in executed or row["status"] == "NOT_ATTEMPTED":
            continue
        x = [float(row[f"{name}{unit_of(row, name)}"]) for name in names]
        poses = cell.poses(dict(zip(names, x, strict=True)))
        goal = poses["part"][:3, :3] @ cell.seam[target] + poses["part"][:3, 3]
        off_target = max(off_target, float(np.linalg.norm(goal - poses["tcp"][:3, 3])))
        for *_, angle, allowed in deviations(cell, poses["tcp"], poses["part"], cell.normal[target]):
            off_cone = max(off_cone, float(np.rad2deg(angle - allowed)))
        cell.place(poses)
        found = cell.distance(apart)
        nearest = min(nearest, found)
        too_large = max(too_large, float(row["clearance_m"]) - found[0])
    is_true = not hits and max(off_target, off_chord) <= 1.05 * NEAR_M and off_limits <= 1e-9 and off_cone <= 0.2
    return {
        "places": places, "segments": max(0, len(rows) - 1), "pairs": len(pairs),
        "distance_m": nearest[0] if nearest[1] else None,
        "nearest": nearest[1], "hits": {name: [len(at), at[0]] for name, at in hits.items()},
        "off_target_m": off_target, "off_chord_m": off_chord, "off_limits": off_limits, "off_cone_deg": off_cone,
        "clearance_too_large_m": too_large, "is_true": is_true and too_large <= ROUND_M,
    }  # fmt: skip


def rows_of(file: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with file.open(encoding="utf-8") as table:
        return list(csv.DictReader(table))


def unit_of(row: dict[str, str], name: str) -> str:
    """Return the ending of a joint's column."""
    return "_rad" if f"{name}_rad" in row else "_m"


def from_chord(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Return the distance of a point from a straight line between two points."""
    along = np.clip(np.dot(point - a, b - a) / max(np.dot(b - a, b - a), 1e-18), 0.0, 1.0)
    return float(np.linalg.norm(point - a - along * (b - a)))


def checked_reach(cell: Cell, file: Path, chain: Chain) -> dict[str, Any]:
    """Check all configurations in reach.csv, and attack all exclusions."""
    found: dict[str, Any] = {"reachable": 0, "undecided": 0, "excluded": [], "controls": [], "wrong": []}
    pairs = cell.pairs(chain.names)
    starts = samples(cell, chain.names, STARTS, np.random.default_rng(3))
    for row in rows_of(file):
        target, reach = int(row["waypoint"]), row["reach"]
        if reach == "reachable":
            found["reachable"] += 1
            x = [float(row[f"{name}{unit_of(row, name)}"]) for name in chain.names]
            poses = cell.poses(dict(zip(chain.names, x, strict=True)))
            cell.place(poses)
            goal = poses["part"][:3, :3] @ cell.seam[target] + poses["part"][:3, 3]
            off = float(np.linalg.norm(goal - poses["tcp"][:3, 3]))
            if off > 1.05 * NEAR_M or (hit := cell.contacts(pairs)):
                found["wrong"].append([target, off, hit])
        elif reach == "undecided":
            found["undecided"] += 1
        else:
            each = attacked(cell, chain, target, starts)
            found["excluded"].append({"target": target, "reach": reach, **each})
    rows = [int(row["waypoint"]) for row in rows_of(file) if row["reach"] == "reachable"]
    if found["excluded"]:
        found["controls"] = [{"target": t, **attacked(cell, chain, t, starts[:500])} for t in rows[:1] + rows[1:][-1:]]
    found["is_true"] = not found["wrong"] and not any(each["free"] for each in found["excluded"])
    return found


def checked_clear(cell: Cell, file: Path) -> dict[str, Any]:
    """Find contacts of the arm and its tool in the configurations of a file; shapes of the world are no part of it."""
    names, x = file.read_text(encoding="utf-8").splitlines()[0].split(","), np.loadtxt(file, delimiter=",", skiprows=1)
    others = {"world", "robot.world", *(body.link for body in cell.fixed)}
    pairs = [pair for pair in cell.pairs(names) if not {body.link for body in pair} & others]
    contacts: dict[str, list] = {}
    for q in x:
        poses = cell.poses(dict(zip(names, q, strict=True)))
        for body in cell.bodies:
            body.place(poses)
        for each in cell.contacts(pairs):
            contacts.setdefault(each, []).append(q.tolist())
    shown = {pair: {"count": len(at), "first": at[0]} for pair, at in contacts.items()}
    return {"pairs": len(pairs), "contacts": shown}


def answer(wanted: dict[str, str]) -> dict[str, Any]:
    """Return the results for a request."""
    begun, folder = time.process_time(), Path(wanted["folder"])
    cell = Cell(folder, Path(wanted["file"]), wanted["tcp"])
    if (folder / "clear.csv").exists():
        return checked_clear(cell, folder / "clear.csv") | {"check_s": time.process_time() - begun}
    header = rows_of(folder / "plan/trajectory.csv")[0]
    known = {joint for model, _, _ in cell.models.values() for joint in model.ranges}
    names = [each.rpartition("_")[0] for each in header if each.rpartition("_")[0] in known]
    chain, found = Chain(cell, names), {"joints": len(names)}
    if (folder / "plan/motion.csv").exists():
        found["motion"] = checked_motion(cell, folder / "plan", chain)
    if (folder / "reach/reach.csv").exists():
        found["reach"] = checked_reach(cell, folder / "reach/reach.csv", chain)
    return found | {"check_s": time.process_time() - begun}


if __name__ == "__main__":
    for line in sys.stdin:
        try:
            print(json.dumps(answer(json.loads(line))), flush=True)
        except Exception as error:
            print(json.dumps({"error": f"{type(error).__name__}: {error}"}), flush=True)
