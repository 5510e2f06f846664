"""How far the arm is from its obstacles: distances, their gradients, and proofs that it is clear.

`htcp_jax.clearance.clearance` is the smallest distance, see `obstacles`.
"""

import importlib


def __getattr__(name: str):
    if name != "clearance":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module("htcp_jax.clearance.obstacles").clearance
