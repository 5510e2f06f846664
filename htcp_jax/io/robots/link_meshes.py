"""Vendor meshes of an imported arm by the capsules that enclose them; FCL computes their contacts and distances.

J. Pan, S. Chitta, D. Manocha: FCL: A General Purpose Library for Collision and Proximity Queries. ICRA 2012.
"""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import fcl
import mujoco
import numpy as np
import scipy
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.robots.capsule_fit import Capsule, Cut, Points, Triangles, clip
from htcp_jax.io.robots.chain import Chain, JointMap, chain_of_file, link_frames
from htcp_jax.io.robots.close_fit import mesh_object, point_distance_m
from htcp_jax.io.robots.composed import read_model
from htcp_jax.io.robots.fixed_joints import fix_joints
from htcp_jax.io.robots.model_file import NONE_LOCKED
from htcp_jax.io.robots.mujoco_models import compile_spec, delete_all, joint_name, model_name
from htcp_jax.io.robots.safe_xml import CUTS, MADE_FROM
from htcp_jax.io.robots.stored_pieces import StoredPiece
from htcp_jax.io.robots.vendor_import import ImportedArm, enclosed_triangles
from htcp_jax.model import Robot
from htcp_jax.model import robot as robots
from htcp_jax.spec import ModelSource, label_of

VISUAL = " --visual"  # suffix of the text MADE_FROM if the capsules enclose visual geometry
MOST_CONTACTS = 1000  # maximum number of contacts between two pieces; the deepest contact is used
SAMPLES, NEAREST, STEPS = 200, 6, 60  # samples; nearest samples that start a search; steps of a search
FIRST_STEP, LESS = 0.05, 0.94  # first step, as a share of a joint's range; ratio of successive steps
CORE_M = 1e-4  # radius of the core of a capsule
FIRST = np.array([0])
_LIST = fcl.CollisionRequest(num_max_contacts=MOST_CONTACTS, enable_contact=True)


_Held = Triangles | Capsule | StoredPiece


class _MeshPart(NamedTuple):
    """Content of a capsule: a piece of a mesh, a convex hull of one, or the capsule itself.

    A capsule or sphere is a thin core with a thickness: FCL's depth of triangles in a sphere is negative, and in a
    capsule it depends on the mesh.
    """

    body: int
    shape: fcl.CollisionObject  # placed anew for every query
    T_body_shape: Float[np.ndarray, "4 4"] | None  # None: the shape is in the body's frame
    radius: float = 0.0  # thickness of a hull or of a core [m]


class Poses(NamedTuple):
    """Poses of a model's B bodies at n configurations, in the frame of the model."""

    rotation: Float[np.ndarray, "n B 3 3"]
    position: Float[np.ndarray, "n B 3"]


class LinkMeshes:
    """Pieces of the vendor's meshes, by the name of the capsule that encloses them.

    Args:
        model: The compiled model.
        chain: The arm's joints in the model.
        held: By the capsule's name: the index of its body in the model, and its piece of a mesh, the convex piece about
            that, or the capsule itself.
    """

    def __init__(self, model: mujoco.MjModel, chain: Chain, held: Mapping[str, tuple[int, _Held]]):
        self._model, self._chain = model, chain
        self._mapped = JointMap.of(model, Path(model_name(model)), chain)
        self._addresses = model.jnt_qposadr[list(chain.joints)].tolist()
        self.names = frozenset(held)  # of the capsules
        self._parts = {name: _capsule_part(*each) for name, each in held.items()}

    @classmethod
    def of(cls, arm: ImportedArm) -> "LinkMeshes":
        """Return the meshes of a newly imported arm."""
        held = {}
        for body, cover in arm.covers.items():
            held |= {name: (body, capsule) for name, capsule in cover.own.items()}
            held |= {name: (body, piece.triangles) for name, piece in cover.pieces.items()}
        return cls(arm.model, arm.chain, held)

    @classmethod
    def convex(cls, arm: ImportedArm) -> "LinkMeshes":
        """Return the convex pieces of a newly imported arm in place of its meshes."""
        held = {}
        for body, cover in arm.covers.items():
            held |= {name: (body, capsule) for name, capsule in cover.own.items()}
            held |= {name: (body, piece._replace(capsule=cover.fitted[name])) for name, piece in cover.hulls.items()}
        return cls(arm.model, arm.chain, held)

    @classmethod
    def read(cls, arm: ModelSource, locked: Mapping[str, float] = NONE_LOCKED) -> "LinkMeshes | None":
        """Read the meshes to which an arm's file refers; None if there is no reference, or the vendor's model is gone.

        Args:
            arm: The arm's file, or the models that form a cell.
            locked: Values of joints that do not move, by their names [rad or m].
        """
        path = label_of(arm)
        spec = read_model(arm)
        texts = {text.name: text.data for text in spec.texts}
        triangles: dict[str, Triangles] | None = None
        for name in [name for name in texts if name.endswith(MADE_FROM)]:
            source, visual, _ = texts[name].partition(VISUAL)
            if not source or not (path.parent / source).is_file():
                continue
            try:
                own = enclosed_triangles(path.parent / source, bool(visual))
            except InputError:  # its meshes are gone
                continue
            triangles = (triangles or {}) | {name.removesuffix(MADE_FROM) + body: each for body, each in own.items()}
        if triangles is None:
            return None
        delete_all(spec, spec.tuples)
        model, held = compile_spec(spec, path), {}
        for geom in range(model.ngeom):
            name, body = model.geom(geom).name, int(model.geom_bodyid[geom])
            cuts = texts.get(CUTS + name)
            piece = triangles.get(model.body(body).name) if cuts is not None else None
            for cut in _read_cuts(cuts or "") if piece is not None else ():
                piece = clip(piece, cut)
            held[name] = body, Capsule.of_geom(model, geom, np.eye(4)) if piece is None or not len(piece) else piece
        return cls(model, chain_of_file(model, path, fix_joints(model, path, locked)), held)

    def poses(self, x: Float[np.ndarray, "n N"], data: mujoco.MjData | None = None) -> Poses:
        """Return the bodies' poses at configurations x [rad or m].

        Args:
            x: The configurations.
            data: Data of the model to compute in, to save the time for making new data; None: new data are made.
        """
        model, data = self._model, data or mujoco.MjData(self._model)
        found = Poses(np.empty((len(x), model.nbody, 3, 3)), np.empty((len(x), model.nbody, 3)))
        for k, row in enumerate(self._mapped.positions(x)):
            data.qpos[self._addresses] = row
            mujoco.mj_kinematics(model, data)
            found.rotation[k], found.position[k] = data.xmat.reshape(-1, 3, 3), data.xpos
        return found

    def overlap(self, one: str, other: str, at: Poses, k: int | np.integer) -> bool:
        """Return True if two capsules' pieces overlap or touch.

        Args:
            one: Name of a capsule.
            other: Name of another capsule.
            at: Poses of the bodies.
            k: Row of `at` to check.
        """
        if self._thickness(one, other):
            return self._distance_m(one, other, at, k) <= 0
        return fcl.collide(self._placed(one, at, k), self._placed(other, at, k)) > 0

    def deepest_m(
        self, one: str, other: str, at: Poses, rows: Int[np.ndarray, "m"] = FIRST, enough_m: float = np.inf
    ) -> float:
        """Return the depth of the deepest contact between two capsules' pieces [m]; 0 without contact.

        Args:
            one: Name of a capsule.
            other: Name of another capsule.
            at: Poses of the bodies.
            rows: Rows of `at` to check; by default the first.
            enough_m: Depth [m] from which on the search stops.
        """
        deepest, is_thick = 0.0, self._thickness(one, other) > 0
        for k in rows:
            if is_thick:
                deepest = max(deepest, -self._distance_m(one, other, at, k))
            else:
                contacts = fcl.CollisionResult()
                fcl.collide(self._placed(one, at, k), self._placed(other, at, k), _LIST, contacts)
                deepest = max([deepest, *(contact.penetration_depth for contact in contacts.contacts)])
            if deepest > enough_m:
                break
        return deepest

    def can_touch(
        self, one: str, other: str, x: Float[np.ndarray, "n N"], at: Poses, rows: Int[np.ndarray, "m"]
    ) -> bool:
        """Return True if two capsules' pieces are found to overlap by more than TOUCHING_M.

        The given rows of x are checked. Contacts may be rarer than one in n, so a random local search then minimises
        the pieces' distance, starting from the NEAREST rows.

        Args:
            one: Name of a capsule.
            other: Name of another capsule.
            x: Configurations [rad or m].
            at: Poses of the bodies at x.
            rows: Rows of x to check.
        """
        if self.deepest_m(one, other, at, rows, robots.TOUCHING_M) > robots.TOUCHING_M:
            return True
        some = rows[:: max(1, len(rows) // SAMPLES)]
        order = np.argsort([self._distance_m(one, other, at, k) for k in some], kind="stable")
        rng, lower, upper = np.random.default_rng(0), x.min(axis=0), x.max(axis=0)
        data = mujoco.MjData(self._model)
        for k in some[order[:NEAREST]]:
            best, now = self._distance_m(one, other, at, k), x[k]
            for step in range(STEPS):
                spread = FIRST_STEP * (upper - lower) * LESS**step
                tried = np.clip(now + spread * rng.normal(size=len(now)), lower, upper)
                there = self.poses(tried[None], data)
                if (found := self._distance_m(one, other, there, 0)) < best:
                    best, now = found, tried
                    if best < -robots.TOUCHING_M:
                        return True
        return False

    def touching_share(self, pairs: Sequence[tuple[str, str]], at: Poses) -> float:
        """Return the share [1] of some poses in which the pieces of a pair overlap by more than TOUCHING_M.

        Args:
            pairs: Names of two capsules each.
            at: Poses of the bodies.
        """
        some = np.arange(len(at.position))[:: max(1, len(at.position) // SAMPLES)]
        touch_m = robots.TOUCHING_M
        deep = (any(self.deepest_m(*pair, at, row, touch_m) > touch_m for pair in pairs) for row in some[:, None])
        return float(np.mean(list(deep)))

    def _distance_m(self, one: str, other: str, at: Poses, k: int | np.integer) -> float:
        """Return the distance between two pieces [m]; minus the penetration depth if they overlap."""
        apart, thick = fcl.distance(self._placed(one, at, k), self._placed(other, at, k)), self._thickness(one, other)
        if thick:
            return max(apart, 0.0) - thick
        return apart if apart > 0 else -self.deepest_m(one, other, at, np.array([k]))

    def _thickness(self, one: str, other: str) -> float:
        return self._parts[one].radius + self._parts[other].radius

    def outside_m(self, name: str, robot: Robot, x: Float[np.ndarray, "N"], point: Float[np.ndarray, "3"]) -> float:
        """Return the distance of a point from the piece in a capsule, or from the capsule if it has no piece [m].

        Args:
            name: Name of the capsule.
            robot: The arm, at its place in the world.
            x: Configuration [rad or m].
            point: The point, world [m].
        """
        at = self.poses(x[None])
        if root := self._chain.root:
            seen = at.rotation[0, root] @ point + at.position[0, root]
        else:
            first = robot.joint_names if robot.coupling is None else robot.coupling.joint_names
            k = [joint_name(self._model, j) for j in self._chain.joints].index(first[0])
            T_model_joint = link_frames(self._model, np.eye(4), self._chain).T_parent_joint[k]
            T_world_model = np.asarray(robot.T_parent_joint[0]) @ np.linalg.inv(T_model_joint)
            seen = np.linalg.solve(T_world_model, [*point, 1.0])[:3]
        return max(0.0, point_distance_m(self._placed(name, at, 0), seen) - self._parts[name].radius)

    def _placed(self, name: str, at: Poses, k: int | np.integer) -> fcl.CollisionObject:
        body, shape, T, _ = self._parts[name]
        R, t = at.rotation[k, body], at.position[k, body]
        shape.setRotation(R if T is None else R @ T[:3, :3])
        shape.setTranslation(t if T is None else R @ T[:3, 3] + t)
        return shape


class MeshesInFile(NamedTuple):
    """`LinkMeshes` of an arm's file, read on first use."""

    file: ModelSource
    locked: tuple[tuple[str, float], ...] = ()  # joints that do not move, and their values [rad or m]

    def deepest_m(self, first: str, second: str, x: Float[np.ndarray, "N"]) -> float:
        """Return the depth of the deepest contact between two capsules' meshes [m]; 0 without meshes.

        Args:
            first: Name of a capsule.
            second: Name of another capsule.
            x: Configuration [rad or m].
        """
        meshes = _read_meshes(self.file, self.locked)
        return 0.0 if meshes is None else meshes.deepest_m(first, second, meshes.poses(x[None]))

    def outside_m(
        self, capsule: str, robot: Robot, x: Float[np.ndarray, "N"], point: Float[np.ndarray, "3"]
    ) -> float | None:
        """Return the distance of a point from the mesh in a capsule [m]; None without a mesh.

        Args:
            capsule: Name of the capsule.
            robot: The arm, at its place in the world.
            x: Configuration [rad or m].
            point: The point, world [m].
        """
        meshes = _read_meshes(self.file, self.locked)
        if meshes is None or capsule not in meshes.names:
            return None
        return meshes.outside_m(capsule, robot, x, point)


@lru_cache(maxsize=8)
def _read_meshes(file: ModelSource, locked: tuple[tuple[str, float], ...]) -> LinkMeshes | None:
    with warnings.catch_warnings():  # `load_robot` has shown the file's warnings
        warnings.simplefilter("ignore")
        return LinkMeshes.read(file, dict(locked))


def cuts_text(cuts: Iterable[Cut]) -> str:
    """Format cuts as text, as in an arm's file."""
    return "; ".join(" ".join(f"{number:.15g}" for number in (*cut.normal, cut.offset)) for cut in cuts)


def _read_cuts(text: str) -> list[Cut]:
    rows = [[float(number) for number in row.split()] for row in text.split(";") if row.strip()]
    return [Cut((row[0], row[1], row[2]), row[3]) for row in rows]


def _capsule_part(body: int, held: _Held) -> _MeshPart:
    if isinstance(held, StoredPiece):
        hull = _hull_object(held.vertices)
        if hull is not None:
            return _MeshPart(body, hull, None, held.radius)
        held = held.capsule
    if not isinstance(held, Capsule):
        return _MeshPart(body, mesh_object(held), None)
    T, along, turn, flat = np.eye(4), held.p - held.q, np.empty(4), np.empty(9)
    T[:3, 3], length = (held.p + held.q) / 2, float(np.linalg.norm(along))
    core = min(CORE_M, held.radius / 2)
    if length == 0:
        return _MeshPart(body, fcl.CollisionObject(fcl.Sphere(core)), T, held.radius - core)
    mujoco.mju_quatZ2Vec(turn, along / length)
    mujoco.mju_quat2Mat(flat, turn)
    T[:3, :3] = flat.reshape(3, 3)
    return _MeshPart(body, fcl.CollisionObject(fcl.Capsule(core, length)), T, held.radius - core)


def _hull_object(vertices: Points) -> fcl.CollisionObject | None:
    """Return the convex hull of points as an object of FCL, at the origin; None for fewer than four points, on a line.

    The points of a flat hull are moved slightly out of its plane.
    """
    try:
        hull = scipy.spatial.ConvexHull(vertices, qhull_options="QJ")
    except (scipy.spatial.QhullError, ValueError):
        return None
    corners = np.unique(hull.simplices)
    faces = np.searchsorted(corners, hull.simplices)
    counted = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    return fcl.CollisionObject(fcl.Convex(vertices[corners], len(faces), counted))
