"""Distances of capsules from points, half-spaces and solids.

Every index (tree, bounding discs, sweeps) may only skip what a bound proves to be irrelevant, so the distances are
exact. `cloud` is a point cloud with its indices; `solids` has convex shapes; `segments` the distance of two segments.
`convex_pieces` has convex polyhedra as bodies, which are also measured against each other; `gjk` finds their nearest
points.
"""
