"""Distances to the triangles of a mesh, for validation.

The code is independent of the planner's (mesh_points.py and tip_guard.py). The distance from a capsule's axis to a
triangle is 0 if they intersect. Otherwise it is attained at an end of the axis or on an edge of the triangle.
"""

import numpy as np
from jaxtyping import Bool, Float

GRAINS = 100_000  # approximate number of pieces into which triangles are cut, so that a tree of the centres is precise
AT_ONCE = 500_000  # maximum number of axis-triangle pairs in memory

Triangles = Float[np.ndarray, "m 3 3"]
Points = Float[np.ndarray, "m 3"]


def cut_into_grains(triangles: Triangles) -> Float[np.ndarray, "g 3 3"]:
    """Return the triangles, bisected across their longest edges until no edge is much longer than a grain."""
    area = _size(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])).sum() / 2
    longest, done = 2 * np.sqrt(area / GRAINS), []
    while len(triangles):
        edges = np.linalg.norm(triangles[:, [1, 2, 0]] - triangles, axis=2)
        row, first = np.arange(len(triangles)), edges.argmax(axis=1)
        long = edges[row, first] > longest
        done.append(triangles[~long])
        a, b, c = (triangles[row, (first + k) % 3][long] for k in range(3))
        triangles = np.concatenate([np.stack([a, (a + b) / 2, c], 1), np.stack([(a + b) / 2, b, c], 1)])
    return np.concatenate(done)


def axis_distances(p: Points, q: Points, triangles: Triangles) -> Float[np.ndarray, "m"]:
    """Return the distance of each segment from its triangle [m].

    Args:
        p: Starts of the segments [m].
        q: Ends of the segments [m].
        triangles: Corners of each segment's triangle [m].
    """
    steps = range(0, len(p), AT_ONCE)
    parts = [_triangle_distances(*(values[k : k + AT_ONCE] for values in (p, q, triangles))) for k in steps]
    return np.concatenate(parts or [np.empty(0)])


def point_distances(p: Points, q: Points, points: Points) -> Float[np.ndarray, "m"]:
    """Return the distance of each segment from its point [m].

    Args:
        p: Starts of the segments [m].
        q: Ends of the segments [m].
        points: Each segment's point [m].
    """
    u = q - p
    return _size(p + _clipped_ratio(_dot(points - p, u), _dot(u, u))[:, None] * u - points)


def _triangle_distances(p: Points, q: Points, triangles: Triangles) -> Float[np.ndarray, "m"]:
    import trimesh

    ends = [_size(trimesh.triangles.closest_point(triangles, end) - end) for end in (p, q)]
    corners = np.moveaxis(triangles, 1, 0)
    edges = [_segment_distance(p, q, corners[k], corners[k - 1]) for k in range(3)]
    return np.where(crosses(p, q, triangles), 0.0, np.minimum.reduce([*ends, *edges]))


def crosses(p: Points, q: Points, triangles: Triangles) -> Bool[np.ndarray, "m"]:
    """Return a mask of the segments, True for each that passes through its triangle.

    The ends of such a segment are on different sides of the triangle's plane, and the segment passes all three edges in
    the same sense of rotation.

    Args:
        p: Starts of the segments [m].
        q: Ends of the segments [m].
        triangles: Corners of each segment's triangle [m].
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    sides = [_signed_volume(a, b, c, end) for end in (p, q)]
    about = np.stack([_signed_volume(p, q, *edge) for edge in ((a, b), (b, c), (c, a))])
    return (sides[0] * sides[1] < 0) & ((about >= 0).all(axis=0) | (about <= 0).all(axis=0))


def _segment_distance(p: Points, q: Points, a: Points, b: Points) -> Float[np.ndarray, "m"]:
    """Return the distance of each segment p q from its segment a b [m].

    The result is the minimum over the lines' nearest points, clipped to the segments, and over the four ends. For
    parallel lines an end is always among the nearest points.
    """
    u, v, w = q - p, b - a, p - a
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    s = _clipped_ratio(uv * _dot(v, w) - vv * _dot(u, w), uu * vv - uv * uv)
    t = _clipped_ratio(_dot(v, w) + s * uv, vv)
    found = [_gap(p, u, _clipped_ratio(t * uv - _dot(u, w), uu), a, v, t)]
    for end in (np.zeros(len(p)), np.ones(len(p))):
        found.append(_gap(p, u, _clipped_ratio(end * uv - _dot(u, w), uu), a, v, end))
    return np.minimum.reduce(found)


def _gap(p: Points, u: Points, s: np.ndarray, a: Points, v: Points, t: np.ndarray) -> Float[np.ndarray, "m"]:
    return _size(p + s[:, None] * u - a - t[:, None] * v)


def _clipped_ratio(a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "m"]:
    """Return a / b, clipped to 0 and 1; 0 if b is 0."""
    return np.clip(np.divide(a, b, out=np.zeros_like(a), where=b > 0), 0.0, 1.0)


def _signed_volume(a: Points, b: Points, c: Points, d: Points) -> Float[np.ndarray, "m"]:
    return _dot(np.cross(b - a, c - a), d - a)


def _dot(u: Points, v: Points) -> Float[np.ndarray, "m"]:
    return (u * v).sum(axis=1)


def _size(u: Points) -> Float[np.ndarray, "m"]:
    return np.linalg.norm(u, axis=1)
