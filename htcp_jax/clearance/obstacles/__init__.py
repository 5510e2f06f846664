"""Obstacles: collision objects of the arm, behind one protocol, `htcp_jax.clearance.Obstacle`.

`of_workpiece` makes the obstacles of a part, all of them or its own alone; `of_cell` those of a work cell: solid
fixtures and clouds that stay where they are. `self_collision` keeps the arm clear of itself; `self_exclusions` finds
the pairs of capsules that need no check, from sampled configurations. `tip_guard` keeps the bare tip of the tool out of
the part's triangles.

`obstacle_kind` has the base class of kinds that other packages add, and their registry; `given_obstacle` their
distances to bodies.

`linearisation` has task and clearance at one configuration to first order, as the step QP needs them. `contact_model`
holds the contacts of one configuration fixed, to predict distances near it without another search.

The distances to a tuple of these obstacles are functions of package `clearance`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
