"""Reachable targets, and proofs that others are not: lower and upper bounds on what any planner can do.

`reachable_prefixes` searches configurations at each target and proves cells of tool orientations unreachable. Its
`Reachability` has two numbers for each scenario: leading targets that are known to be reachable, and the number beyond
which no plan can come. `PROOF_CELLS` and `RESOLUTION_RAD` limit the work of the proof; `SearchStopped` is raised when
the user interrupts it, and `initial_reachability` is the result without any search.

`obstruction` finds the colliding body at the target where a plan ended: an `Obstruction` names the capsule of the arm
and the body that it would touch there.

This package uses the planner's own collision checker and null-space steps, but none of its methods.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
