"""Distances of capsules from points, half-spaces and solids.

The distances are exact: an index (tree, bounding discs, sweep) skips only pairs that a bound proves to be irrelevant.
`cloud_tree` has the index of a point cloud, `solids` has convex shapes, and `segments` computes the distance of two
segments. `convex_pieces` computes distances of convex polyhedra from all shapes; `gjk` finds nearest points.
"""
