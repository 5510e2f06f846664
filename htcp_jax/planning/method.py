"""Base class of planning methods."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from htcp_jax.motion import Plans, Problem


class Method:
    """Base class of a planning method: derive from it, and define `name`, `title`, `description` and `plan`.

    Attributes:
        name: Name on the command line and in file names: lower-case letters, digits and hyphens.
        title: Column heading in tables.
        description: A few words for lists of methods.
        smooth: True if the method's motions are smoothed, unless the settings disable it.
    """

    name: str
    title: str
    description: str
    smooth: ClassVar[bool] = False

    def plan(self, problem: "Problem") -> "Plans":
        """Plan every scenario of the problem, and return the plans; begin with `problem.empty_plans()`.

        A target that is not tracked ends its scenario; set its status to the reason. Results may depend only on the
        problem; take the seed of random numbers from `problem.settings.seed`.

        Raises:
            InputError: For a problem that the method cannot plan.
        """
        raise NotImplementedError

    def first_calls(self, problem: "Problem") -> Sequence[tuple]:
        """Return calls that `plan` will make, to compile their functions in parallel, see `Executor.preparing`."""
        return ()

    def further_calls(self, problem: "Problem") -> Sequence[tuple]:
        """Return calls that `plan` makes if targets are hard; a sweep compiles their functions, too, before it plans.

        The call with the longest compilation comes first.
        """
        return ()
