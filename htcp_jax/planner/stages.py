"""What a method made of step QPs does when these are stuck: stages tried in turn, each with a kernel of its own."""

from dataclasses import dataclass

from htcp_jax.planner.kernel import Kernel
from htcp_jax.planner.kernels import sample_kernel, walk_kernel
from htcp_jax.planner.null_space import Minimise
from htcp_jax.planner.sampling import Propose


@dataclass(frozen=True)
class NullSpace:
    """A stage that walks the null space, one minimisation a step."""

    minimise: Minimise
    settings: tuple[str, ...] = ()  # that `minimise` reads

    in_null_space = True

    def kernel(self, index: int) -> Kernel:
        """One step of the walk, as stage `index` of a method."""
        return walk_kernel(self.minimise, index, self.settings)


@dataclass(frozen=True)
class Sample:
    """A stage that proposes candidates for the step QP to track from."""

    propose: Propose
    settings: tuple[str, ...] = ()  # that `propose` reads
    in_null_space: bool = True  # whether it has nothing to propose where there is none

    def kernel(self, index: int) -> Kernel:
        """The candidates of a lane, as stage `index` of a method."""
        return sample_kernel(self.propose, index, self.settings)


@dataclass(frozen=True, kw_only=True)
class Escapes:
    """What is done when the step QPs are stuck, and between targets."""

    stages: tuple[NullSpace | Sample, ...] = ()  # tried in turn at a stuck target
    keep_clear: bool = False  # ascend after every target
    replan_backwards: bool = False  # when all stages fail, draw a clear posture there and plan the way to it backwards
    check_paths: bool = False  # every joint path must be clear, whatever the settings say

    @property
    def backwards(self) -> int:
        """`Plans.escape` of targets that were planned backwards: one beyond the last stage."""
        return len(self.stages) + 1
