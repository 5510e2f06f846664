"""Base class of planning methods."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, NamedTuple

if TYPE_CHECKING:
    from htcp_jax.motion import Plans, Problem


class WarmUp(NamedTuple):
    """Calls of lane functions, each a tuple (lane function, *tables), see `Executor.preparing`."""

    first: Sequence[tuple] = ()  # calls of every plan, in the order of use; compiled while planning begins
    hard: Sequence[tuple] = ()  # calls for hard targets, the longest compilation first; a sweep compiles them, too


class Method:
    """Base class of a planning method: derive from it, and define `name`, `title`, `description` and `plan`.

    Attributes:
        name: Name on the command line and in file names: lower-case letters, digits and hyphens.
        title: Column heading in tables.
        description: A few words for lists of methods.
        smooth: True if the method's motions are smoothed, unless the settings disable it.
        plans_indexed: True if the method keeps indexed axes still within each seam, see `Robot.indexed`.
    """

    name: str
    title: str
    description: str
    smooth: ClassVar[bool] = False
    plans_indexed: ClassVar[bool] = False

    def plan(self, problem: "Problem") -> "Plans":
        """Plan every scenario of the problem, and return the plans; begin with `problem.empty_plans()`.

        A target that is not tracked ends its scenario; set its status to the reason. Results may depend only on the
        problem; take the seed of random numbers from `problem.settings.seed`.

        Raises:
            InputError: For a problem that the method cannot plan.
        """
        raise NotImplementedError

    def warm_up(self, problem: "Problem") -> WarmUp:
        """Return calls of lane functions that `plan` makes, to compile these functions in parallel before the calls."""
        return WarmUp()
