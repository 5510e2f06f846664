"""Distances between the arm and its obstacles, their gradients, and proofs that a motion is clear.

Three packages, from the bottom up: `distance` has the distances of a capsule from points, half-spaces and solids, with
the indices that make them fast; `obstacles` has the kinds of obstacle (workpiece, interior, fixtures, the arm itself)
behind one protocol, `Obstacle`; `proof` bounds clearance and task errors between two configurations.

`htcp_jax.clearance.clearance` is the minimum clearance of a configuration, see `obstacles.obstacles`.
"""

import importlib


def __getattr__(name: str):
    if name != "clearance":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module("htcp_jax.clearance.obstacles.obstacles").clearance
