"""Base class of planning methods."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

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
