"""Distances of an arm's convex pieces next to FCL's: to points, boxes, prisms, capsules and pieces.

    python -m benchmarks piece-reference ARM.xml... [--rows N]

One row is a random configuration, one of the arm's pieces, and one body of each kind near it. Points and the axes of
capsules are 1 um thick in FCL, whose distances from wider round bodies are too large by up to 0.3 mm. A cylinder is the
prism that fixtures are measured by. Overlapping bodies are compared by their verdict alone.
"""

import argparse
import time

import fcl
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from htcp_jax.clearance.distance.convex_pieces import PlacedPiece, face_contact, piece_contact
from htcp_jax.clearance.distance.solids import Box, Rod
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model import kinematics
from htcp_jax.model.convex_piece import make_piece

HALF = np.array([0.06, 0.1, 0.08])  # of the box [m]
RADIUS, REACH = 0.07, 0.1  # of the capsule and the prism, and half their length [m]
SIDES = 48  # of the prism
NEAR_M, FAR_M = 0.05, 0.8  # distance of the bodies' middles from that of the piece's capsule
SURE_M = 1e-6  # verdicts are compared beyond this distance
REQUEST = {"enable_signed_distance": False, "gjk_solver_type": 1}  # FCL's own solver


def convex(points: np.ndarray) -> fcl.Convex:
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    faces = number[hull.simplices]
    a, b, c = corners[faces].swapaxes(0, 1)
    inwards = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    return fcl.Convex(corners, len(faces), np.column_stack([np.full(len(faces), 3), faces]).ravel())


def placed(geometry, T: np.ndarray) -> fcl.CollisionObject:
    return fcl.CollisionObject(geometry, fcl.Transform(T[:3, :3], T[:3, 3]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arms", nargs="+")
    parser.add_argument("--rows", type=int, default=2500)
    given = parser.parse_args()
    for file in given.arms:
        compare(file, given.rows)


def compare(file: str, count: int) -> None:
    begun, rng, robot = time.process_time(), np.random.default_rng(0), load_robot(file)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    x = jnp.asarray(rng.uniform(lower, upper, (count, len(lower))))
    poses = np.asarray(jax.jit(jax.vmap(lambda x: kinematics.body_poses(robot, x)))(x))
    ends = np.stack(jax.jit(jax.vmap(lambda x: kinematics.capsule_segments(robot, x)))(x))
    own = np.flatnonzero(np.asarray(robot.pieces.excess_m) > 0)
    first, second, row = rng.choice(own, count), rng.choice(own, count), np.arange(count)
    T, away = poses[row, first], rng.normal(size=(count, 3))
    away *= rng.uniform(NEAR_M, FAR_M, (count, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    U = np.tile(np.eye(4), (count, 1, 1))
    U[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    U[:, :3, 3] = ends[:, row, first].mean(axis=0) + away
    V = U.copy()  # of another piece, whose middle comes to the same place
    V[:, :3, 3] -= np.einsum("nij,nj->ni", U[:, :3, :3], np.asarray(robot.capsule_p + robot.capsule_q)[second] / 2)

    pieces, radius = robot.pieces.piece, np.asarray(robot.pieces.piece.radius)
    shapes = {k: convex(np.asarray(pieces.vertices)[k]) for k in own}
    tip = REACH * np.array([0.0, 0.0, 1.0])
    turn = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    rim = np.column_stack([RADIUS * np.cos(turn), RADIUS * np.sin(turn)])
    prism = make_piece(np.concatenate([np.column_stack([rim, np.full(SIDES, z)]) for z in (-REACH, REACH)]))
    kinds = {
        "point": (lambda U, k: Rod(U[:3, 3], U[:3, 3], jnp.zeros(())), U, lambda k: fcl.Sphere(SURE_M), SURE_M),
        "box": (lambda U, k: Box(U[:3, :3], U[:3, 3], jnp.asarray(HALF)), U, lambda k: fcl.Box(*2 * HALF), 0.0),
        "prism": (lambda U, k: PlacedPiece(prism, U), U, lambda k: convex(np.asarray(prism.vertices)), 0.0),
        "capsule": (
            lambda U, k: Rod(U[:3, 3] - U[:3, :3] @ tip, U[:3, 3] + U[:3, :3] @ tip, jnp.asarray(RADIUS)),
            U, lambda k: fcl.Capsule(SURE_M, 2 * REACH), SURE_M - RADIUS,
        ),
        "piece": (
            lambda U, k: PlacedPiece(jax.tree.map(lambda leaf: leaf[k], pieces), U),
            V, lambda k: shapes[k], 0.0,
        ),
    }  # fmt: skip
    for name, (body, at, shape, thick) in kinds.items():
        measure = face_contact if name in ("piece", "prism") else piece_contact

        def distance(k, T, U, other, body=body, measure=measure):
            return measure(PlacedPiece(jax.tree.map(lambda leaf: leaf[k], pieces), T), body(U, other)).distance

        ours = jax.jit(lambda *rows, f=distance: jax.lax.map(lambda row: f(*row), rows))(first, T, at, second)
        theirs, touch = np.empty(count), np.empty(count, bool)
        for n in range(count):
            pair = placed(shapes[first[n]], T[n]), placed(shape(second[n]), at[n])
            inflated = radius[first[n]] + (radius[second[n]] if name == "piece" else 0.0)
            found = fcl.distance(*pair, fcl.DistanceRequest(**REQUEST), fcl.DistanceResult())
            touch[n] = found <= 0 or found + thick <= inflated
            theirs[n] = found + thick - inflated
        ours = np.asarray(ours)
        apart = theirs > SURE_M
        off = np.abs(ours - theirs)[apart]
        differ = int(((ours <= 0) != touch)[np.abs(ours) > SURE_M].sum())
        print(
            f"{file} {name}: {count} rows, {apart.sum()} apart; largest difference {off.max():.1e} m, over 1e-6 m in "
            f"{(off > 1e-6).sum()}, FCL's smaller by at most {(ours - theirs)[apart].max():.1e}; "
            f"verdicts differ: {differ}",
            flush=True,
        )
    print(f"{time.process_time() - begun:.0f} s of processor time")


if __name__ == "__main__":
    main()
