"""Obstacles: everything that the arm must not collide with. All kinds derive from `htcp_jax.clearance.Obstacle`.

`of_workpiece` makes the obstacles of a workpiece, `make_fixtures` and `placed_cloud` those of a work cell: solids and
point clouds that are fixed in the world. `self_collision` is the arm itself as an obstacle; `self_exclusions` finds the
pairs of capsules that need no check, from sampled configurations. `tip_guard` tests whether the bare tip of the tool
passes through a wall of the workpiece.

`given_obstacle` computes distances of bodies to obstacles of other packages, see `htcp_jax.spec.ObstacleKind`.

`linearisation` computes task and clearance at one configuration to first order, for the step QP. `contact_model`
predicts distances near a configuration from its contacts, without another search.

Package `clearance` has the functions for the distances to a tuple of these obstacles.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
