"""Reachability analysis: lower and upper bounds on the number of consecutive targets that any planner can reach.

`reachable_prefixes` searches for configurations at each target, and proves targets unreachable by cells of tool
orientations. It returns a `Reachability` with both bounds for each scenario. `RESOLUTION_RAD` is the default resolution
of the search, `PROOF_CELLS` the default limit of a proof. A `Memo` gives a search the results of an earlier one that
was interrupted.

`obstruction` finds the colliding body at the target where a plan ended: an `Obstruction` names the arm's capsule and
the obstacle that this capsule penetrates.

This package uses the planner's collision checker and null-space steps, but none of the planning methods.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
