"""Distances between the arm and its obstacles, their gradients, and proofs that a motion is clear.

`Obstacle` is the base class of all kinds of obstacle, and `Obstacles` is a tuple of obstacles. `Scene` is a robot with
its obstacles and task, which all scenarios of a plan share; `own_scene` returns the scene with a scenario's own tool.

`minimum_clearance` returns the clearance of a configuration, `clearances` one distance per row of the obstacles, and
`contacts` the nearest points and their normals. `is_clear` tests D > margin_m at less cost. `ClearanceRows` are the
linearised clearances of a step QP. `HasWorkpiecePose`, `rows_of`, `in_workpiece` and `contacts_of_each` are for code
that evaluates single pairs.

There are three packages, from the bottom up. `distance`, for this package only, computes distances of a capsule from
points, half-spaces and solids, with spatial indices. `clearance.obstacles` has the kinds of obstacle.
`clearance.proof` bounds clearance and task errors between two configurations.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
