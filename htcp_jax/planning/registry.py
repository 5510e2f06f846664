"""Registry of planning methods by name; see `htcp_jax.spec.registry` for registries in general."""

from collections.abc import Iterator, Mapping
from importlib import import_module
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


class _BuiltIn(Mapping[str, Method]):
    """The built-in methods, imported when one of them is used."""

    def __getitem__(self, name: str) -> Method:
        return {method.name: method for method in import_module("htcp_jax.planning.methods").BUILT_IN}[name]

    def __contains__(self, name: object) -> bool:
        return name in DESCRIPTIONS

    def __iter__(self) -> Iterator[str]:
        return iter(DESCRIPTIONS)

    def __len__(self) -> int:
        return len(DESCRIPTIONS)


METHODS = Registry("htcp_jax.methods", "method", _fault, _BuiltIn)


def descriptions() -> dict[str, tuple[str, str]]:
    """Return the title and the description of every method, by name; built-in ones are not imported.

    A method of another package that cannot be imported is omitted, with a UserWarning.
    """
    others = {name: (each.title, each.description) for name, each in METHODS.all(without=DESCRIPTIONS).items()}
    return DESCRIPTIONS | others


def find(name: str) -> Method:
    """Return the method with the given name.

    Raises:
        InputError: If the name is unknown, or the method cannot be imported. In the second case the message names the
            method's entry point and package.
    """
    return METHODS.find(name)


def names() -> tuple[str, ...]:
    """Return the names of all methods: built-in ones, then those of packages, then those registered in this process."""
    return METHODS.names()


def register(value: Any) -> Any:
    """Register a planning method, a kind of obstacle or a kind of task row in this process, and return it.

    `htcp_jax.plan`, `sweep` and job files then accept its name. Ray's workers find only those of installed packages.

    Args:
        value: An instance of a `Method`, or a class that derives from `ObstacleKind` or `TaskRowKind`.

    Raises:
        InputError: If the value is incomplete, or if its name is already taken or not valid in file names.
    """
    from htcp_jax.model import task_row_kind
    from htcp_jax.spec import obstacle_kind

    kinds = {obstacle_kind.ObstacleKind: obstacle_kind.OBSTACLES, task_row_kind.TaskRowKind: task_row_kind.TASK_ROWS}
    known = (registry for kind, registry in kinds.items() if isinstance(value, type) and issubclass(value, kind))
    return next(known, METHODS).register(value)
