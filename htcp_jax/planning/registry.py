"""Registry of planning methods; see `htcp_jax.registry`."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from htcp_jax.planning.method import Method
from htcp_jax.registry import Registry


def _fault(method: Any) -> str:
    if isinstance(method, type):
        return "it is a class, not an instance of one"
    for key in ("name", "title", "description"):
        if not (isinstance(getattr(method, key, None), str) and getattr(method, key)):
            return f"it has no {key}"
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

    A method of another package that cannot be imported is excluded, with a UserWarning.
    """
    others = {name: (each.title, each.description) for name, each in METHODS.all(without=DESCRIPTIONS).items()}
    return DESCRIPTIONS | others


def find(name: str) -> Method:
    """Return the method with that name.

    Raises:
        InputError: For an unknown name, and for a method that cannot be imported; names its entry point and package.
    """
    return METHODS.find(name)


def names() -> tuple[str, ...]:
    """Return the names of all methods: built-in ones in order, then those of packages, then those of this process."""
    return METHODS.names()


def register(value: Any) -> Any:
    """Make a planning method, a kind of obstacle or a kind of task row known to this process, and return it.

    value: an instance of a `Method`, or a class that derives from `ObstacleKind` or `TaskRowKind`. `htcp_jax.plan`,
    `sweep` and job files know it then by its name; Ray's workers know only those of installed packages. Raises
    InputError for one that is incomplete, and for a name that is not valid in file names or is taken.
    """
    from htcp_jax.clearance.obstacles import obstacle_kind
    from htcp_jax.model import task_row_kind

    kinds = {obstacle_kind.ObstacleKind: obstacle_kind.OBSTACLES, task_row_kind.TaskRowKind: task_row_kind.TASK_ROWS}
    known = (registry for kind, registry in kinds.items() if isinstance(value, type) and issubclass(value, kind))
    return next(known, METHODS).register(value)
