"""The built-in methods: step QPs with different recoveries and steps between targets; and the beam search, `beam`."""

import jax

from htcp_jax.planning.beam.beam import BeamSearchMethod
from htcp_jax.planning.tracking.sampling import best_nspace_samples, cspace_samples, nspace_samples
from htcp_jax.planning.tracking.stages import NullSpace, Sample
from htcp_jax.planning.tracking.step_qps import StepQPs
from htcp_jax.settings import Settings
from htcp_jax.solvers import sphere


def _start_key(settings: Settings, key: jax.Array, cmaes: bool = False) -> jax.Array | None:
    """Return the key of a random first direction; None for the best of 64."""
    random = settings.first_direction == "random" or (cmaes and settings.first_direction == "random_for_cmaes")
    return jax.random.split(key)[1] if random else None


_FIRST = ("first_direction",)
_SQP = NullSpace(lambda problem, seen, key, s: sphere.sqp(problem, seen, start_key=_start_key(s, key)), _FIRST)
_SPREAD = (0.005, 0.01, 0.02, 0.04)
_SAMPLE_SETTINGS = ("samples", "sample_steps", "max_sample_distance_rad")

BUILT_IN = (
    StepQPs("baseline", "Baseline planner", "iterative convex optimisation alone, equation (9)"),
    StepQPs(
        "cspace-sample",
        "C-Space sample",
        "restarts from configurations sampled about the last one",
        stages=(Sample(cspace_samples, ("samples", "max_sample_distance_rad"), in_null_space=False),),
    ),
    StepQPs(
        "nspace-sample",
        "N-Space sample",
        "restarts from the ends of self-motions along random null-space directions",
        stages=(
            Sample(
                lambda scene, s, where, stuck: nspace_samples(scene, s, where, stuck, (s.sample_step_rad,)),
                (*_SAMPLE_SETTINGS, "sample_step_rad"),
            ),
        ),
    ),
    StepQPs("nspace-sqp", "N-Space SQP", "null-space steps by sequential quadratic programming", stages=(_SQP,)),
    StepQPs(
        "nspace-ip",
        "N-Space Interior Point",
        "null-space steps by a barrier method on the sphere",
        stages=(
            NullSpace(
                lambda problem, seen, key, s: sphere.interior_point(problem, seen, start_key=_start_key(s, key)),
                _FIRST,
            ),
        ),
    ),
    StepQPs(
        "nspace-cmaes",
        "N-Space CMA-ES",
        "null-space steps by CMA-ES",
        stages=(
            NullSpace(
                lambda problem, seen, key, s: sphere.cmaes(
                    problem, seen, key, s.population, s.generations, start_key=_start_key(s, key, cmaes=True)
                ),
                ("population", "generations", *_FIRST),
            ),
        ),
    ),
    StepQPs(
        "nspace-adam",
        "N-Space Adam",
        "null-space steps by Adam, projected on the sphere",
        stages=(
            NullSpace(lambda problem, seen, key, s: sphere.adam(problem, seen, start_key=_start_key(s, key)), _FIRST),
        ),
    ),
    StepQPs(
        "keep-clear",
        "Keep clear",
        "null-space ascent of the clearance after every target, no recovery",
        keep_clear=True,
    ),
    StepQPs(
        "hybrid",
        "Hybrid",
        "keep clear; SQP, then null-space samples, then other configurations planned backwards; every joint path clear",
        stages=(
            _SQP,
            Sample(
                lambda scene, s, where, stuck: best_nspace_samples(scene, s, where, stuck, _SPREAD), _SAMPLE_SETTINGS
            ),
        ),
        keep_clear=True,
        replan_backwards=True,
        check_paths=True,
    ),
    BeamSearchMethod(
        "beam",
        "Beam",
        "a set of configurations at every target, connected to the start by proven motions; the best path through them",
    ),
)
