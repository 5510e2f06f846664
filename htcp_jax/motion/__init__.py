"""Plans and motions: their results, verification, transfers and smoothing.

`Problem` is what a method plans, `Execution` says on which devices and in how many threads and processes, and `Plans`
are the results: one row per scenario and target. `ViaPoints` are the configurations that a plan passes between two
targets, where the segment is not a straight joint path. `Motion` has all configurations that an arm passes from its
start to its last target. `CollisionChecker` checks configurations and the joint paths between them, on one device.

`start_check` checks single starts, `start_cause` finds the reason for a start that fails, `motion_check` verifies each
segment, `raised_bounds` raises the bounds that decide a motion's clearance, `home` joins the home configuration to the
start, and `smoothing` shortens a motion within its margin.
`configurations` selects configurations that are far apart, and stores them in trees; `transfers` joins a start to other
configurations. `tool_cells` proves that a target has no clear configuration. `step_functions` has the compiled
functions of one lane, `lane_inputs` their inputs. `plans` computes outcomes; `motion` computes figures such as cost,
curvature and clearance. `measured_rows` measures and names, for messages, the bodies nearest to each other.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
