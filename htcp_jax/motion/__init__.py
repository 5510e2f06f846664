"""Motions between configurations: plans, their segments, and the checks, joins and smoothing of them.

`Problem` is what a method plans, and `Plans` are the results: one row per scenario and target. `ViaPoints` are the
configurations that a plan passes between two targets, where the segment is not a straight joint path. `Motion` is all
that an arm follows, from its start to its last target. `CollisionChecker` checks configurations and the joint paths
between them, on one device; `collision_checker` has its calls.

`motion_check` verifies each segment, `home` leads from and to the home configuration, `start_cause` finds the reason
for a start that fails, `smoothing` shortens a motion within its margin. `configuration_tree` keeps configurations with
their parents, `selection` chooses some that lie apart, `transfers` joins a plan to its start. `tool_cells` and
`exclusions` prove that a target has no clear configuration. `lane_inputs` and `step_functions` are the rows that
compiled functions take, and those functions. `plans` and `motion` compute outcomes and figures: complete or not, cost,
curvature, clearance.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
