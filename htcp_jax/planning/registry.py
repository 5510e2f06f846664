"""Names and descriptions of planning methods, and the registry of those of other packages.

No method is imported here. `planning.methods` has the built-in ones, and finds any method by its name.
"""

from typing import Any

from htcp_jax.planning.method import Method
from htcp_jax.spec import Registry


def _fault(method: Any) -> str:
    if isinstance(method, type):
        return "it must be an instance, not a class"
    for key in ("name", "title", "description"):
        if not (isinstance(getattr(method, key, None), str) and getattr(method, key)):
            return f"its attribute {key} is missing"
    if not isinstance(method, Method) or type(method).plan is Method.plan:
        return "its class must derive from htcp_jax.Method and define plan(problem)"
    return ""


DESCRIPTIONS = {  # titles and descriptions of the built-in methods, known before JAX is imported
    "baseline": ("Baseline planner", "iterative convex optimisation alone, equation (9)"),
    "cspace-sample": ("C-Space sample", "restarts from configurations sampled about the last one"),
    "nspace-sample": ("N-Space sample", "restarts from the ends of self-motions along random null-space directions"),
    "nspace-sqp": ("N-Space SQP", "null-space steps by sequential quadratic programming"),
    "nspace-ip": ("N-Space Interior Point", "null-space steps by a barrier method on the sphere"),
    "nspace-cmaes": ("N-Space CMA-ES", "null-space steps by CMA-ES"),
    "nspace-adam": ("N-Space Adam", "null-space steps by Adam, projected on the sphere"),
    "keep-clear": ("Keep clear", "null-space ascent of the clearance after every target, no recovery"),
    "hybrid": (
        "Hybrid",
        "keep clear; SQP, then null-space samples, then other configurations planned backwards; every joint path clear",
    ),
    "beam": (
        "Beam",
        "a set of configurations at every target, connected to the start by proven motions; the best path through them",
    ),
}


METHODS = Registry("htcp_jax.methods", "method", _fault, tuple(DESCRIPTIONS))


def descriptions() -> dict[str, tuple[str, str]]:
    """Return the title and the description of every method, by name; built-in ones are not imported.

    A method of another package that cannot be imported is omitted, with a UserWarning.
    """
    return DESCRIPTIONS | {name: (each.title, each.description) for name, each in METHODS.added().items()}


def names() -> tuple[str, ...]:
    """Return the names of all methods: built-in ones, then those of packages, then those registered in this process."""
    return METHODS.names()
