"""The methods: what each does when the step QPs are stuck, and between targets."""

from collections.abc import Callable
from dataclasses import dataclass

from htcp_jax.clearance.obstacles import Posed
from htcp_jax.clearance.scene import Scene
from htcp_jax.planner.null_space import Minimise, Stuck
from htcp_jax.planner.sampling import Candidates, best_nspace_samples, cspace_samples, nspace_samples
from htcp_jax.settings import Settings
from htcp_jax.solvers import sphere


@dataclass(frozen=True)
class NullSpace:
    """A stage that walks the null space, one minimisation a step."""

    minimise: Minimise


@dataclass(frozen=True)
class Sample:
    """A stage that proposes candidates for the step QP to track from."""

    propose: Callable[[Scene, Settings, Posed, Stuck], Candidates]


@dataclass(frozen=True)
class Method:
    """A planner: what it does when the step QPs are stuck, and between targets."""

    title: str
    sentence: str
    stages: tuple[NullSpace | Sample, ...] = ()  # tried in turn at a stuck target
    keep_clear: bool = False  # ascend after every target
    retries: bool = False  # when all stages fail, draw a clear configuration there and plan the way to it backwards
    check_paths: bool = False  # every joint path must be clear, whatever the settings say


_SQP = NullSpace(lambda problem, seen, key, settings: sphere.sqp(problem, seen))
_SPREAD = (0.005, 0.01, 0.02, 0.04)


METHODS: dict[str, Method] = {
    "baseline": Method("Baseline planner", "iterative convex optimisation alone, equation (8)"),
    "cspace-sample": Method(
        "C-Space sample", "restarts from configurations sampled about the last one", (Sample(cspace_samples),)
    ),
    "nspace-sample": Method(
        "N-Space sample",
        "restarts from the ends of walks along random null-space directions",
        (Sample(lambda scene, s, where, stuck: nspace_samples(scene, s, where, stuck, (s.sample_step_rad,))),),
    ),
    "nspace-sqp": Method("N-Space SQP", "null-space steps by sequential quadratic programming", (_SQP,)),
    "nspace-ip": Method(
        "N-Space Interior Point",
        "null-space steps by a barrier method on the sphere",
        (NullSpace(lambda problem, seen, key, settings: sphere.interior_point(problem, seen)),),
    ),
    "nspace-cmaes": Method(
        "N-Space CMA-ES",
        "null-space steps by CMA-ES",
        (NullSpace(lambda p, seen, key, s: sphere.cmaes(p, seen, key, s.population, s.generations)),),
    ),
    "nspace-adam": Method(
        "N-Space Adam",
        "null-space steps by Adam, projected on the sphere",
        (NullSpace(lambda problem, seen, key, settings: sphere.adam(problem, seen)),),
    ),
    "keep-clear": Method(
        "Keep clear", "null-space ascent of the clearance after every target, no escape", keep_clear=True
    ),
    "hybrid": Method(
        "Hybrid",
        "keep clear; SQP, then null-space samples, then other postures planned backwards; every joint path clear",
        (_SQP, Sample(lambda scene, s, where, stuck: best_nspace_samples(scene, s, where, stuck, _SPREAD))),
        keep_clear=True,
        retries=True,
        check_paths=True,
    ),
}
