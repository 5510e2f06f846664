"""Proofs about motions: lower bounds on clearance, and bounds on task errors, between two configurations.

Each module begins with the inequality that it implements. `motion_proof` proves or refutes that a straight joint path
is clear; its `Tube` is the region in which the TCP must stay. `motion_bound` bounds how far points of the arm move.
`margin` is the clearance that a proof requires. `bisection` has the result, a `Proof` with a `PathVerdict`, and the
state of a search in progress, `Bisection`. `known_rows` bounds distances by those measured at other configurations.

`error_bound` bounds the scale up to which errors of part, tool and joints cause no contact, for the pairs that
`error_pairs` finds.

`row_proof` proves that a path satisfies the task's rows. `exclusion` proves, from the tool's bodies, that no
configuration with the tool's orientation in a given cell is clear; it and `branch_exclusion` use the rest
of the arm, too.

A proof is valid for every configuration on the path; the bounds include rounding errors.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
