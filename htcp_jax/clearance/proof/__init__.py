"""Proofs about motions: lower bounds on clearance and bounds on task errors between two configurations.

Each module begins with the inequality that it implements. `motion_proof` proves or refutes that a straight joint path
is clear; its `Tube` bounds where the TCP may be meanwhile. `motion_bound` bounds how far points of the arm move, and
`bisection` is the search that both use: a `Proof` with a `PathVerdict` for each path, and `Bisection` for one in
progress.

`row_proof` proves that a path stays within the task's rows. `arm_exclusion` proves that no configuration in a cell of
tool orientations reaches a target.

A proof holds for every configuration on the path; rounding is part of the bounds.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
