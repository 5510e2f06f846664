"""Processor time of distances of convex pieces, next to those of a capsule from a box and from a polyhedron.

    python -m benchmarks piece-distances [--rows N]

Random convex pieces at random poses; one row after the other, as in the searches of `clearance`. Times are of the
process, not of the clock, so that they hardly depend on other work.
"""

import argparse
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import hardware
from htcp_jax.clearance.distance.convex_pieces import PlacedPiece, piece_contact
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.clearance.obstacles.of_cell import convex_piece
from htcp_jax.model.convex_piece import make_piece

SIZES = 16, 32, 64  # vertices of a piece
APART_M, OVERLAPPING_M = 0.4, 0.06  # distance of the middles of two bodies, each about 0.2 m long
REPEATS = 5


def points(count: int, seed: int) -> np.ndarray:
    """Points on an ellipsoid: vertices of a piece."""
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * [0.1, 0.07, 0.13]


def poses(count: int, away_m: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3))
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = away_m * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return T


def timed(contact: Callable, *rows: np.ndarray) -> tuple[float, float]:
    """Nanoseconds per row, and seconds of compilation."""
    begun = time.process_time()
    run = jax.jit(lambda *rows: jax.lax.map(lambda row: contact(*row), rows)).lower(*rows).compile()
    compiled = time.process_time() - begun
    taken = []
    for _ in range(REPEATS):
        begun = time.process_time()
        jax.block_until_ready(run(*rows))
        taken.append(time.process_time() - begun)
    return 1e9 * min(taken) / len(rows[0]), compiled


def rod(T: jax.Array) -> Rod:
    return Rod(T[:3, 3] - 0.1 * T[:3, 2], T[:3, 3] + 0.1 * T[:3, 2], jnp.asarray(0.03))


def box(T: jax.Array) -> Box:
    return Box(T[:3, :3], T[:3, 3], jnp.array([0.1, 0.07, 0.13]))


OTHERS = {
    "point": lambda T: Rod(T[:3, 3], T[:3, 3], jnp.zeros(())),
    "capsule": rod,
    "box": box,
    "cylinder": lambda T: Cylinder(T[:3, :3], T[:3, 3], jnp.asarray(0.08), jnp.asarray(0.12)),
    "half-space": lambda T: HalfSpace(T[:3, 2], jnp.sum(T[:3, 2] * T[:3, 3])),
}


def cases() -> dict[str, Callable]:
    """Contacts as functions of the poses of both bodies, by name; the second one's frame is the world's axes."""
    found = {"capsule to box": lambda T, U: box(U).seen(rod(T).p, rod(T).q)}
    for size in SIZES:
        a, b = (jax.tree.map(jnp.asarray, make_piece(points(size, seed))) for seed in (0, 1))
        solid = jax.tree.map(jnp.asarray, convex_piece(points(size, 0)))
        found[f"capsule to polyhedron of {size}"] = lambda T, U, solid=solid: solid.seen(rod(T).p, rod(T).q)
        found[f"piece of {size} to piece"] = lambda T, U, a=a, b=b: piece_contact(PlacedPiece(a, T), PlacedPiece(b, U))
        for name, other in OTHERS.items():
            found[f"piece of {size} to {name}"] = lambda T, U, a=a, other=other: piece_contact(
                PlacedPiece(a, T), other(U)
            )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1000)
    count = parser.parse_args().rows
    print(f"{hardware.line()}\n{count} rows; ns a row{'apart':>22s}{'overlap':>12s}")
    for name, contact in cases().items():
        found = [timed(contact, poses(count, away, 0), poses(count, 0.0, 1)) for away in (APART_M, OVERLAPPING_M)]
        times = "".join(f"{ns:12,.0f}" for ns, _ in found)
        print(f"{name:28s}{times}   compiled in {found[0][1]:.1f} s", flush=True)
