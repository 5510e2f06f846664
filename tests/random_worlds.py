"""Random worlds: no proof of a joint motion is refuted by a thousand samples and a descent from the nearest ones.

A world has spheres, boxes, convex and other meshes and clouds, among them thin plates and slots, and a few motions of
the toy arm; the same seed gives the same world. In most worlds a sphere grazes one of the motions. Configurations and
distances are computed in NumPy, from the arm's lengths, triangles and points. All worlds have the same numbers of
solids and points, and share one program. `python tests/random_worlds.py [[FIRST] WORLDS]` lists wrong
proofs and the counts.
"""

import sys
from collections import Counter
from functools import cache, partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import toy
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from htcp_jax.clearance import Scene
from htcp_jax.clearance.distance.solids import Box, Rod
from htcp_jax.clearance.obstacles import PlacedCloud
from htcp_jax.clearance.obstacles.cloud import cloud_of
from htcp_jax.clearance.obstacles.fixtures import fixtures
from htcp_jax.clearance.obstacles.of_cell import convex_piece
from htcp_jax.clearance.proof import ROUNDING_M
from htcp_jax.device import Executor
from htcp_jax.model import cover_mesh
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus

SPHERES, BOXES, HULLS, CORNERS = 2, 4, 2, 8  # per world; of a hull
POINTS, MESH_POINTS, SPACING_M = 512, 2560, 0.01  # of a cloud; of a mesh's cover
MOTIONS, SAMPLES, NEAREST, SECTIONS = 4, 1000, 20, 25
GRAZING_M = 1e-3  # a motion grazes if its smallest distance is within this of 0
BASE, UPPER, FOREARM, ELBOW_TO_WRIST, TOOL = 0.3, 0.4, 0.36, 0.4, 0.16  # lengths in `toy.ARM` [m]
RADIUS = np.array([0.03, 0.02])
AWAY = np.array([0.0, 0.0, 15.0])  # position of what a world does not have
LEAST = {"proven": 0.2, "refuted": 0.1, "grazing": 0.02}  # shares of the motions
GOLDEN = (np.sqrt(5) - 1) / 2


class World(NamedTuple):
    """Obstacles and motions; lengths in metres, joints in radians."""

    spheres: np.ndarray  # (SPHERES, 4): centre, radius
    boxes: list[tuple[np.ndarray, np.ndarray, np.ndarray]]  # rotation, centre, half sizes
    hulls: np.ndarray  # (HULLS, CORNERS, 3)
    triangles: np.ndarray  # (F, 3, 3), of a mesh that is not convex
    cloud: np.ndarray  # (POINTS, 3)
    a: np.ndarray  # (MOTIONS, 4): starts
    b: np.ndarray  # (MOTIONS, 4): ends


class Verdicts(NamedTuple):
    """Counts of motions by result, and a line about every wrong verdict."""

    counts: Counter
    wrong: list[str]


# Worlds


def world(seed: int) -> World:
    """Return a random world."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(-1, 1, (MOTIONS, 4)) * [2.9, 1.2, 2.2, 2.2]
    step = rng.normal(size=(MOTIONS, 4))
    b = a + step * (10 ** rng.uniform(-1.5, 0.3, (MOTIONS, 1)) / np.linalg.norm(step, axis=1, keepdims=True))
    has = dict(zip(("boxes", "hulls", "mesh", "cloud", "slot"), rng.random(5) < [0.6, 0.5, 0.5, 0.5, 0.3], strict=True))
    boxes = [_plate(rng) if rng.random() < 0.5 else _box(rng) for _ in range(BOXES)]
    boxes = boxes if has["boxes"] else [(np.eye(3), AWAY, np.full(3, 0.1))] * BOXES
    hulls = _unit(rng.normal(size=(HULLS, CORNERS, 3))) * rng.uniform(0.02, 0.15, (HULLS, 1, 3))
    hulls = hulls + (np.stack([_place(rng) for _ in range(HULLS)])[:, None] if has["hulls"] else AWAY)
    triangles = _moved(_slotted_plate(rng), _turn(rng), _place(rng) if has["mesh"] else AWAY)
    if has["slot"]:  # the arm moves in its own plane, between two walls: boxes, or the mesh
        b[0] = a[0] + [0.0, *rng.uniform(-0.3, 0.3, 3)]
        if rng.random() < 0.5:
            boxes[:2] = _walls(rng, a[0], 0.25, 0.0)
        else:
            triangles = np.concatenate([_side(*wall) for wall in _walls(rng, a[0], 0.1, SPACING_M / 2)])
    cloud = (_place(rng) if has["cloud"] else AWAY) + _sheet(rng)
    spheres = np.array([[*_place(rng), rng.uniform(0.01, 0.15)] for _ in range(SPHERES)])
    made = World(spheres, boxes, hulls, triangles, cloud, a, b)
    return _grazing(rng, made) if rng.random() < 0.8 else made


def _place(rng) -> np.ndarray:
    return [0.0, 0.0, BASE] + _unit(rng.normal(size=3)) * rng.uniform(0.35, 1.1)


def _turn(rng) -> np.ndarray:
    return Rotation.random(random_state=rng).as_matrix()


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _moved(triangles: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    return triangles @ R.T + t


def _box(rng):
    return _turn(rng), _place(rng), rng.uniform(0.01, 0.15, 3)


def _plate(rng):
    return _turn(rng), _place(rng), np.array([*rng.uniform(0.05, 0.3, 2), 10 ** rng.uniform(-5, -3)])


def _walls(rng, q: np.ndarray, size: float, aside: float):
    """Return two plates on both sides of the plane in which the arm moves at q, a little farther than its radius."""
    R = Rotation.from_euler("z", q[0]).as_matrix()
    p, end = (each[0, 0] for each in axes(q[None]))
    half = np.array([size, 10 ** rng.uniform(-4, -2.5), size])
    away = aside + RADIUS[0] + 10 ** rng.uniform(-4.5, -2.3, 2) + half[1]
    return [(R, (p + end) / 2 + side * R[:, 1], half) for side in away * [1, -1]]


def _slotted_plate(rng) -> np.ndarray:
    """Return the triangles of a sheet with a slot, of which the arm is wider or narrower."""
    x, y, wide, long = 0.12, 0.12, rng.uniform(0.015, 0.06), rng.uniform(0.04, 0.1)
    sides = [(-x, -wide, -y, y), (wide, x, -y, y), (-wide, wide, -y, -long), (-wide, wide, long, y)]
    corners = [np.array([[l, d, 0], [r, d, 0], [r, u, 0], [l, u, 0]]) for l, r, d, u in sides]  # noqa: E741
    return np.concatenate([quad[[[0, 1, 2], [0, 2, 3]]] for quad in corners])


def _side(R, centre, half) -> np.ndarray:
    """Return the triangles of a plate's middle, which is perpendicular to y."""
    quad = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1.0]]) * half
    return _moved(quad[[[0, 1, 2], [0, 2, 3]]], R, centre)


def _sheet(rng) -> np.ndarray:
    """Return points on a bent sheet."""
    uv, bend = rng.uniform(-0.15, 0.15, (POINTS, 2)), rng.uniform(-4, 4, 2)
    return np.column_stack([uv, (uv * uv) @ bend]) @ _turn(rng).T


def _grazing(rng, made: World) -> World:
    """Return the world with its first sphere grazing a motion: its radius is changed to a distance of nearly 0."""
    k = rng.integers(MOTIONS)
    p, q = axes(made.a[k] + np.linspace(0, 1, SAMPLES)[:, None] * (made.b[k] - made.a[k]))
    centre = made.spheres[0, :3]
    near = (_to_points(p.reshape(-1, 3), q.reshape(-1, 3), centre[None]).reshape(-1, 2) - RADIUS).min()
    if near < 5e-3:
        return made
    radius = near - rng.choice([-1, 1]) * 10 ** rng.uniform(-7, -3)
    return made._replace(spheres=np.array([[*centre, radius], *made.spheres[1:]]))


# Verdicts of the planner


@cache
def _lanes():
    rows = np.zeros(MOTIONS, int)
    return lane_inputs(stack([toy.scenario(margin_m=0.0)]), rows, rows)


def proofs(made: World, resolution_m: float):
    """Return the proofs of the world's motions that D > -resolution_m, and the covering radius of its mesh [m]."""
    named = [("", Rod(each[:3], each[:3], each[3])) for each in made.spheres]
    named += [("", Box(*each)) for each in made.boxes] + [("", convex_piece(each)) for each in made.hulls]
    points, cover = cover_mesh(made.triangles, "mesh", SPACING_M)
    points = np.concatenate([points, np.repeat(points[-1:], MESH_POINTS - len(points), axis=0)])
    clouds = [PlacedCloud(cloud_of(*each), jnp.eye(4), "") for each in ((points, cover), (made.cloud, 0.0))]
    scene = Scene(toy.robot(), (fixtures(toy.robot(), named), *clouds))
    checker = CollisionChecker(Executor(scene, Settings(), threads=1), Settings())
    return checker.edges(_lanes(), made.a, made.b, resolution_m=resolution_m), cover


# Distances in NumPy


def axes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return both ends of the axes of forearm and tool (n, 2, 3) [m] at configurations (n, 4) of the toy arm."""
    turn, angles = x[:, 0], np.cumsum(x[:, 1:], axis=1)
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ahead = np.concatenate([np.sin(angles)[..., None] * out[:, None], np.cos(angles)[..., None]], axis=2)
    elbow = [0.0, 0.0, BASE] + UPPER * ahead[:, 0]
    wrist = elbow + ELBOW_TO_WRIST * ahead[:, 1]
    return np.stack([elbow, wrist], 1), np.stack([elbow + FOREARM * ahead[:, 1], wrist + TOOL * ahead[:, 2]], 1)


def distances(made: World, parts: list, x: np.ndarray) -> np.ndarray:
    """Return the arm's distance from the obstacles at configurations (n, 4) [m]; minus a radius or less inside.

    `parts` are the world's `parts_of`. A part is measured only for axes to which its ball is nearer than all obstacles
    measured before.
    """
    p, q = (end.reshape(-1, 3) for end in axes(x))
    found = (_to_points(p, q, made.spheres[:, :3]) - made.spheres[:, 3]).min(1)
    for (*centre, radius), measure in parts:
        near = np.flatnonzero(_to_points(p, q, np.array([centre]))[:, 0] - radius < found)
        if len(near):
            found[near] = np.minimum(found[near], measure(p[near], q[near]))
    return (found.reshape(len(x), 2) - RADIUS).min(1)


def parts_of(made: World) -> list:
    """Return the bounding ball (4,) of each obstacle except the spheres, and its distance as a function of segments."""
    signs = 2 * np.array(list(np.ndindex(2, 2, 2))) - 1
    parts = [(c + signs * half @ R.T, partial(_to_box, box=(R, c, half))) for R, c, half in made.boxes]
    parts += [(hull, partial(_to_hull, sides=ConvexHull(hull))) for hull in made.hulls]
    parts.append((made.triangles.reshape(-1, 3), partial(_to_triangles, corners=made.triangles)))
    parts.append((made.cloud, lambda p, q: _to_points(p, q, made.cloud).min(1)))
    return [(_ball(points), measure) for points, measure in parts]


def _ball(points: np.ndarray) -> np.ndarray:
    centre = (points.min(0) + points.max(0)) / 2
    return np.append(centre, np.linalg.norm(points - centre, axis=1).max())


def _to_points(p, q, points):
    """Return the distances (n, m) of points (m, 3) from segments (n, 3) [m]."""
    d = q - p
    along = d @ points.T - (d * p).sum(1)[:, None]
    square, dd = (points * points).sum(1) - 2 * p @ points.T + (p * p).sum(1)[:, None], (d * d).sum(1)[:, None]
    s = np.clip(along / dd, 0, 1)
    return np.sqrt(np.maximum(square - s * (2 * along - s * dd), 0))


def _to_box(p, q, box):
    """Return the distances of a box from segments [m]: the distance of a point is convex along a segment."""
    R, centre, half = box
    p, d = (p - centre) @ R, (q - p) @ R
    low, high = np.zeros(len(p)), np.ones(len(p))

    def at(s):
        beyond = np.maximum(np.abs(p + s[:, None] * d) - half, 0)
        return np.einsum("nd,nd->n", beyond, beyond)

    for _ in range(60):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        nearer = at(left) <= at(right)
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    return np.sqrt(at((low + high) / 2))


def _to_hull(p, q, sides):
    inside = (p @ sides.equations[:, :3].T + sides.equations[:, 3] <= 0).all(1)
    return np.where(inside, 0.0, _to_triangles(p, q, sides.points[sides.simplices]))


def _to_triangles(p, q, corners):
    """Return the distance of the nearest triangle (F, 3, 3) from each segment (n, 3) [m]; 0 if they intersect."""
    starts, sides = corners.reshape(-1, 3), (np.roll(corners, -1, axis=1) - corners).reshape(-1, 3)
    found = _to_segments(p, q, starts, sides).min(1)
    normal = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    inwards, offset = np.cross(np.repeat(normal, 3, axis=0), sides), (corners[:, 0] * normal).sum(1)

    def is_over(points):  # (n, F, 3)
        ahead = np.repeat(points, 3, axis=1) - starts
        return (np.einsum("nfd,fd->nf", ahead, inwards) >= 0).reshape(*points.shape[:2], 3).all(2)

    h, k = (end @ normal.T - offset for end in (p, q))
    across = (h * k <= 0) & (h != k)
    share = h / np.where(across, h - k, 1.0)
    place = p[:, None] + share[..., None] * (q - p)[:, None]
    found = np.where((across & is_over(place)).any(1), 0.0, found)
    for end, height in ((p, h), (q, k)):
        over = is_over(np.broadcast_to(end[:, None], place.shape))
        found = np.minimum(found, np.where(over, np.abs(height), np.inf).min(1))
    return found


def _to_segments(p, q, r, e):
    """Return the distances (n, m) of segments from r to r + e (m, 3) and the segments p q (n, 3) [m].

    The nearest points of both lines are projected onto the segments, and so are the ends (Ericson, section 5.1.9).
    """
    d, ee = q - p, (e * e).sum(1)
    dd, de, dw = (d * d).sum(1)[:, None], d @ e.T, (d * p).sum(1)[:, None] - d @ r.T
    ew, w = p @ e.T - (e * r).sum(1), p[:, None] - r
    free = np.clip((de * ew - ee * dw) / np.maximum(dd * ee - de * de, 1e-30), 0, 1)
    best = np.full(de.shape, np.inf)
    for t in (free, np.zeros_like(free), np.ones_like(free)):
        u = np.clip((ew + t * de) / ee, 0, 1)
        t = np.clip((u * de - dw) / dd, 0, 1)
        apart = w + t[..., None] * d[:, None] - u[..., None] * e
        best = np.minimum(best, np.einsum("nmd,nmd->nm", apart, apart))
    return np.sqrt(best)


# The check


def checked(seed: int, resolution_m: float = -ROUNDING_M) -> Verdicts:
    """Return the verdicts on a world's motions, compared with samples and descents; by default of proofs that D > 0."""
    made = world(seed)
    (proof, cover), parts = proofs(made, resolution_m), parts_of(made)
    place = np.linspace(0, 1, SAMPLES)
    at = lambda k, s: made.a[k] + s[:, None] * (made.b[k] - made.a[k])  # noqa: E731
    motion = np.arange(MOTIONS)
    sampled = distances(made, parts, np.concatenate([at(k, place) for k in motion])).reshape(MOTIONS, SAMPLES)
    nearest = np.argsort(sampled, axis=1)[:, :NEAREST]
    low, high = (np.clip(place[nearest] + side / (SAMPLES - 1), 0, 1) for side in (-1, 1))
    flat = lambda s: distances(made, parts, np.concatenate([at(k, s[k]) for k in motion])).reshape(s.shape)  # noqa: E731
    least = sampled.min(axis=1)
    for _ in range(SECTIONS):
        left, right = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        on_left, on_right = flat(left), flat(right)
        least = np.minimum(least, np.minimum(on_left, on_right).min(axis=1))
        nearer = on_left < on_right
        low, high = np.where(nearer, low, left), np.where(nearer, right, high)
    there = distances(made, parts, made.a + proof.place[:, None] * (made.b - made.a))
    counts, wrong = Counter(), []
    for k in motion:
        verdict = SegmentStatus(proof.verdict[k])
        counts["proven"] += verdict == SegmentStatus.VALID
        counts["refuted"] += verdict == SegmentStatus.IN_COLLISION
        counts["grazing"] += bool(abs(least[k]) <= GRAZING_M)
        if verdict == SegmentStatus.VALID and least[k] <= 0:
            wrong.append(f"world {seed}, motion {k}: proven, but the distance is {least[k]:.3g} m")
        if verdict == SegmentStatus.VALID and proof.clearance[k] > least[k] + 1e-9:
            wrong.append(f"world {seed}, motion {k}: {proof.clearance[k]:.9g} m are proven, there are {least[k]:.9g} m")
        if verdict == SegmentStatus.IN_COLLISION and there[k] > 2 * cover:
            wrong.append(f"world {seed}, motion {k}: refuted where the distance is {there[k]:.3g} m")
    return Verdicts(counts, wrong)


def check(seeds) -> Verdicts:
    """Return the verdicts on all motions of some worlds; shares below LEAST are wrong, too."""
    every = [checked(seed) for seed in seeds]
    counts = sum((each.counts for each in every), Counter())
    wrong = [line for each in every for line in each.wrong]
    total = MOTIONS * len(every)
    wrong += [f"{name}: {counts[name]} of {total}" for name, share in LEAST.items() if counts[name] < share * total]
    return Verdicts(counts, wrong)


if __name__ == "__main__":
    first, last = (0, *map(int, sys.argv[1:] or ["2000"]))[-2:]
    found = check(range(first, last))
    print(*found.wrong, dict(found.counts), sep="\n")
    sys.exit(bool(found.wrong))
