"""Distances between the arm and its obstacles, their gradients, and proofs that a motion is clear.

`Obstacle` is the protocol of a kind of obstacle, and `Obstacles` a tuple of them. `Scene` is a robot with its obstacles
and its task, which all scenarios of a plan share; `own_scene` gives it a scenario's own tool.

`clearance` is the minimum clearance of a configuration, `clearances` has one number per capsule, `contacts` the nearest
points and their normals, and `is_clear` compares with a margin, at less cost. `ClearanceRows` are the linearised
clearances of a step QP. `HasWorkpiecePose`, `rows_of`, `in_workpiece` and `nearest_to` serve code that evaluates single
pairs.

Three packages, from the bottom up: `distance` has the distances of a capsule from points, half-spaces and solids, with
the indices that make them fast, for this package only; `clearance.obstacles` has the kinds of obstacle and makes them;
`clearance.proof` bounds clearance and task errors between two configurations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
