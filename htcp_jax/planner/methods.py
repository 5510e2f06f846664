"""The built-in methods: step QPs, by what each does when these are stuck and between targets; and the roadmap."""

from htcp_jax.planner.roadmap import Roadmap
from htcp_jax.planner.sampling import best_nspace_samples, cspace_samples, nspace_samples
from htcp_jax.planner.stages import NullSpace, Sample
from htcp_jax.planner.step_qps import StepQPs
from htcp_jax.solvers import sphere

_SQP = NullSpace(lambda problem, seen, key, settings: sphere.sqp(problem, seen))
_SPREAD = (0.005, 0.01, 0.02, 0.04)
_WALKED = ("samples", "sample_steps", "max_sample_distance_rad")

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
        "restarts from the ends of walks along random null-space directions",
        stages=(
            Sample(
                lambda scene, s, where, stuck: nspace_samples(scene, s, where, stuck, (s.sample_step_rad,)),
                (*_WALKED, "sample_step_rad"),
            ),
        ),
    ),
    StepQPs("nspace-sqp", "N-Space SQP", "null-space steps by sequential quadratic programming", stages=(_SQP,)),
    StepQPs(
        "nspace-ip",
        "N-Space Interior Point",
        "null-space steps by a barrier method on the sphere",
        stages=(NullSpace(lambda problem, seen, key, settings: sphere.interior_point(problem, seen)),),
    ),
    StepQPs(
        "nspace-cmaes",
        "N-Space CMA-ES",
        "null-space steps by CMA-ES",
        stages=(
            NullSpace(
                lambda problem, seen, key, s: sphere.cmaes(problem, seen, key, s.population, s.generations),
                ("population", "generations"),
            ),
        ),
    ),
    StepQPs(
        "nspace-adam",
        "N-Space Adam",
        "null-space steps by Adam, projected on the sphere",
        stages=(NullSpace(lambda problem, seen, key, settings: sphere.adam(problem, seen)),),
    ),
    StepQPs(
        "keep-clear", "Keep clear", "null-space ascent of the clearance after every target, no escape", keep_clear=True
    ),
    StepQPs(
        "hybrid",
        "Hybrid",
        "keep clear; SQP, then null-space samples, then other postures planned backwards; every joint path clear",
        stages=(
            _SQP,
            Sample(lambda scene, s, where, stuck: best_nspace_samples(scene, s, where, stuck, _SPREAD), _WALKED),
        ),
        keep_clear=True,
        replan_backwards=True,
        check_paths=True,
    ),
    Roadmap(
        "roadmap",
        "Roadmap",
        "a set of postures at every target, connected to the start by proven motions; the best path through them",
    ),
)
