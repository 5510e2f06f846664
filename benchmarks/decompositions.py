"""Convex pieces of link meshes by three methods: cuts by planes, CoACD and V-HACD.

    pip install coacd vhacdx        # into a separate environment that also contains this package
    python -m benchmarks decompositions MESH...

The cuts are those of `io.robots.capsule_fit`, which reduce the volume of the pieces' hulls most; every triangle is in a
piece. CoACD and V-HACD may leave parts of a mesh outside all pieces: `missed` is the largest distance from the pieces,
of 1,000 points of the mesh. `reduced` is the largest distance of a piece from the hull of 64 of its vertices, which is
the radius by which this hull must be enlarged. Times are CPU seconds.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from htcp_jax.io.robots.capsule_fit import CUTS, Cut, clip, hull_volume
from htcp_jax.model.convex_piece import make_piece

SPACING_M, POINTS = 0.005, 1000
MOST, WORTH = 4, 0.03  # maximum number of pieces by cuts; minimum share of the volume that a cut must save
VERTICES = 64


def by_cuts(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    parts = [np.asarray(mesh.triangles)]
    least = WORTH * hull_volume(mesh.vertices)
    while len(parts) < MOST:
        saved, k, halves = max(
            ((saved, k, halves) for k, part in enumerate(parts) for saved, halves in halved(part)),
            key=lambda cut: cut[0],
        )
        if saved < least:
            break
        parts[k : k + 1] = halves
    return [part.reshape(-1, 3) for part in parts]


def halved(part: np.ndarray):
    """Yield the volume saved by each cut, and both halves."""
    points = part.reshape(-1, 3)
    whole, corners = hull_volume(points), points[ConvexHull(points).vertices]
    for axis in np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]:
        along = corners @ axis
        for share in CUTS:
            offset = along.min() + share * np.ptp(along)
            halves = [clip(part, Cut(tuple(s * axis), s * offset)) for s in (1, -1)]
            if all(map(len, halves)):
                yield whole - sum(hull_volume(half.reshape(-1, 3)) for half in halves), halves


def by_coacd(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    import coacd

    coacd.set_log_level("off")
    return [points for points, _ in coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), threshold=0.1, seed=0)]


def by_vhacd(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    import vhacdx

    faces = mesh.faces.astype(np.uint32)
    return [points for points, _ in vhacdx.compute_vhacd(mesh.vertices, faces, maxConvexHulls=8, asyncACD=False)]


WAYS: dict[str, Callable[[trimesh.Trimesh], list[np.ndarray]]] = {
    "one hull": lambda mesh: [mesh.vertices],
    "cuts": by_cuts,
    "coacd": by_coacd,
    "vhacd": by_vhacd,
}


def missed(points: np.ndarray, pieces: list[np.ndarray]) -> float:
    """Return the largest distance of the points from the union of the pieces' hulls [m]."""
    left = np.full(len(points), np.inf)
    for piece in pieces:
        hull = ConvexHull(piece)
        height = np.max(points @ hull.equations[:, :3].T + hull.equations[:, 3], axis=1)
        for k in np.flatnonzero((height < left) & (left > 0)):
            triangles = piece[hull.simplices]
            at = trimesh.triangles.closest_point(triangles, np.broadcast_to(points[k], (len(triangles), 3)))
            left[k] = min(left[k], np.linalg.norm(at - points[k], axis=1).min() if height[k] > 1e-9 else 0.0)
    return left.max()


def reduced(points: np.ndarray) -> float:
    """Return the largest height of the points over the hull of VERTICES of them [m]."""
    chosen = list(dict.fromkeys([*points.argmin(axis=0), *points.argmax(axis=0)]))
    while True:
        faces = ConvexHull(points[chosen]).equations
        height = np.max(points @ faces[:, :3].T + faces[:, 3], axis=1)
        if len(chosen) >= min(VERTICES, len(points)):
            return max(height.max(), 0.0)
        chosen.append(int(height.argmax()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+")
    print(f"{'mesh':40s}{'way':>10s}  pieces  vertices       s  volume/mesh's  missed mm  reduced mm")
    for file in parser.parse_args().meshes:
        mesh = trimesh.load_mesh(file)
        mesh.merge_vertices()
        surface = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, SPACING_M, max_iter=12)[0]
        surface = np.random.default_rng(0).permutation(surface)[:POINTS]
        for name, way in WAYS.items():
            begun = time.process_time()
            pieces = way(mesh)
            taken = time.process_time() - begun
            volume = sum(map(hull_volume, pieces)) / abs(mesh.volume)
            pieces = [make_piece(piece).vertices for piece in pieces if hull_volume(piece) > 0]
            off = 0.0 if name in ("one hull", "cuts") else missed(surface, pieces)
            most, least = max(map(len, pieces)), max(map(reduced, pieces))
            print(
                f"{file[-40:]:40s}{name:>10s}{len(pieces):8d}{most:10d}{taken:8.1f}{volume:15.3f}"
                f"{1e3 * off:11.2f}{1e3 * least:12.2f}",
                flush=True,
            )
