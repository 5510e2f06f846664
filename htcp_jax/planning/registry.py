"""Registry of planning methods, and the base class of a method; see `htcp_jax.registry`."""

from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from htcp_jax.registry import Registry

if TYPE_CHECKING:
    from htcp_jax.motion import Plans, Problem


class Method:
    """A planner: derive from it, and define `name`, `title`, `description` and `plan`.

    name: on the command line and in file names; small letters, digits and hyphens. title: column heading in tables.
    description: a few words. smooth: True if its motions are smoothed unless the settings disable that.
    """

    name: str
    title: str
    description: str
    smooth: ClassVar[bool] = False

    def plan(self, problem: "Problem") -> "Plans":
        """Plan every scenario of the problem; begin with `problem.empty_plans()`.

        A target that is not tracked ends its scenario, and its status gives the reason. Results may depend only on the
        problem, and on `problem.settings.seed` if they are random.

        Raises:
            InputError: For a problem that the method cannot plan.
        """
        raise NotImplementedError

    def first_calls(self, problem: "Problem") -> Sequence[tuple]:
        """Return the first calls of compiled functions, to be compiled in parallel, see `Executor.preparing`."""
        return ()


def _fault(method: Any) -> str:
    if isinstance(method, type):
        return "it is a class, not an instance of one"
    for key in ("name", "title", "description"):
        if not (isinstance(getattr(method, key, None), str) and getattr(method, key)):
            return f"it has no {key}"
    if not isinstance(method, Method) or type(method).plan is Method.plan:
        return "its class must derive from htcp_jax.Method and define plan(problem)"
    return ""


def _built_in() -> dict[str, Method]:
    return {method.name: method for method in import_module("htcp_jax.planning.methods").BUILT_IN}


METHODS = Registry("htcp_jax.methods", "method", _fault, _built_in)


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
