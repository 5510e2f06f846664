"""Cuts of pieces of meshes whose convex hulls overlap where the meshes do not.

A hull fills the hollows of its mesh: the throat of a forked wrist, the corner between two parts of a casting. A point
that is in the hulls of two pieces while their meshes are apart is such a place. Planes cut the pieces until few of
these points are left in the hulls of parts of both pieces.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.io.robots import capsule_fit
from htcp_jax.io.robots.capsule_fit import MeshPiece, Points, fit_capsule, hull_corners

MOST_CUTS = 12  # maximum number of cuts of all pieces
SHARES = 0.02, 0.25, 0.5, 0.75, 0.98  # quantiles of the points at which cuts are tried
ENDS = 0.02  # share of a piece's extent at its ends where it is not cut
WORTH = 0.02  # share of the points that a cut must take out of the hulls
SPREAD = 0.3  # parameter of the Dirichlet distribution of random points in a hull
DRAWN, KEPT = 200, 30  # points drawn in each hull of a pair; maximum number that are kept


class SharedPoints(NamedTuple):
    """Points in the hulls of two pieces each, in the frames of both pieces' bodies [m]."""

    pieces: Int[np.ndarray, "2 P"]  # indices of the pieces
    at: Float[np.ndarray, "2 P 3"]
    weight: Float[np.ndarray, "P"]


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a piece, and the points in its hull; it is equal to itself only."""

    piece: MeshPiece
    inside: Bool[np.ndarray, "P"]


def drawn_points(vertices: Points) -> Points:
    """Return the vertices of a hull, and random points in it, most of them near its surface [m]."""
    share = np.random.default_rng(0).dirichlet(np.full(len(vertices), SPREAD), DRAWN)
    return np.concatenate([vertices, share @ vertices])


def cut_apart(pieces: Mapping[str, MeshPiece], points: SharedPoints) -> dict[str, list[MeshPiece]]:
    """Cut pieces so that the hulls of their parts share few of the points.

    Each cut is the one that takes the largest weight of points out of the hulls of one of the two pieces; at most
    MOST_CUTS cuts are made, as long as a cut is WORTH it.

    Args:
        pieces: The pieces, by name, in the order of the indices in `points`.
        points: The points.

    Returns:
        The parts of each piece that was cut, by name, with their capsules.
    """
    sides = [_side(points, k) for k in range(len(pieces))]
    parts = [[_Part(piece, rows >= 0)] for piece, (rows, _) in zip(pieces.values(), sides, strict=True)]
    least = WORTH * points.weight.sum()

    @cache
    def splits(k: int, part: _Part) -> list[tuple[_Part, _Part]]:
        return list(_halves(part, sides[k][1]))

    for _ in range(MOST_CUTS):
        shared = np.array([_union(own) for own in parts]).sum(axis=0) == 2  # in the hulls of both pieces
        tried = []
        for k, own in enumerate(parts):
            for number, part in enumerate(own):
                others = own[:number] + own[number + 1 :]
                for halves in splits(k, part) if (part.inside & shared).any() else ():
                    saved = points.weight[shared & part.inside & ~_union([*others, *halves])].sum()
                    tried.append((saved, k, [*others, *halves]))
        best = max(tried, key=lambda each: each[0], default=(0.0,))
        if best[0] < least:
            break
        parts[best[1]] = best[2]
    return {
        name: [part.piece._replace(capsule=fit_capsule(part.piece.triangles.reshape(-1, 3))) for part in own]
        for name, own in zip(pieces, parts, strict=True)
        if len(own) > 1
    }


def _union(parts: list[_Part]) -> Bool[np.ndarray, "P"]:
    return np.any([part.inside for part in parts], axis=0)


def _side(points: SharedPoints, k: int) -> tuple[Int[np.ndarray, "P"], Points]:
    """Return the side of each point on which piece k is, -1 for none, and the points in the frame of its body."""
    side = np.where(points.pieces[0] == k, 0, np.where(points.pieces[1] == k, 1, -1))
    return side, points.at[np.maximum(side, 0), np.arange(len(side))]


def _halves(part: _Part, at: Points) -> Iterator[tuple[_Part, _Part]]:
    """Yield the halves of a part on both sides of planes through the points in its hull."""
    corners = part.piece.triangles.reshape(-1, 3)
    inner, outer = at[part.inside], hull_corners(corners)
    for axis in (*np.eye(3), *capsule_fit.principal(outer)):
        along = corners @ axis
        low, extent = along.min(), np.ptp(along)
        shares = (np.quantile(inner @ axis, SHARES) - low) / extent if extent > 0 else np.empty(0)
        for share in np.unique(shares.round(3)):
            if ENDS < share < 1 - ENDS:
                halves = capsule_fit.slabs(part.piece, axis, along, (float(share),))
                if len(halves) == 2:
                    yield tuple(_Part(half, part.inside & _in_hull(half, at, part.inside)) for half in halves)


def _in_hull(piece: MeshPiece, at: Points, rows: Bool[np.ndarray, "P"]) -> Bool[np.ndarray, "P"]:
    found = np.zeros(len(at), bool)
    found[rows] = in_hull(piece.triangles.reshape(-1, 3), at[rows])
    return found


def in_hull(corners: Points, points: Points) -> Bool[np.ndarray, "P"]:
    """Return True for points in the convex hull of corners [m]; no point is in a flat hull."""
    try:
        faces = scipy.spatial.ConvexHull(corners).equations
    except (scipy.spatial.QhullError, ValueError):
        return np.zeros(len(points), bool)
    return (points @ faces[:, :3].T + faces[:, 3] <= 0).all(axis=1)
