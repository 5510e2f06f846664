"""The built-in methods: path tracking by step QPs with different recoveries, and the beam search, `beam`.

`find` also finds the methods of other packages.
"""

import jax

from htcp_jax.device import lane_function
from htcp_jax.planning.beam.beam import BeamSearchMethod
from htcp_jax.planning.method import Method
from htcp_jax.planning.registry import DESCRIPTIONS, METHODS
from htcp_jax.planning.tracking.sampling import best_nspace_samples, cspace_samples, nspace_samples
from htcp_jax.planning.tracking.stages import NullSpace, Sample
from htcp_jax.planning.tracking.step_qps import StepQPs
from htcp_jax.settings import Settings
from htcp_jax.solvers import sphere


def _named(name: str) -> tuple[str, str, str]:
    """Return the name, the title and the description of a built-in method."""
    return name, *DESCRIPTIONS[name]


def _start_key(settings: Settings, key: jax.Array, cmaes: bool = False) -> jax.Array | None:
    """Return the random key for a minimiser's initial direction; None to use the best of 64 fixed directions."""
    random = settings.first_direction == "random" or (cmaes and settings.first_direction == "random_for_cmaes")
    return jax.random.split(key)[1] if random else None


_FIRST = ("first_direction",)
_SQP = NullSpace(lambda problem, seen, key, s: sphere.sqp(problem, seen, start_key=_start_key(s, key)), _FIRST)
_SPREAD = (0.005, 0.01, 0.02, 0.04)
_SAMPLE_SETTINGS = ("samples", "sample_steps", "max_sample_distance_rad")

BUILT_IN = (
    StepQPs(*_named("baseline")),
    StepQPs(
        *_named("cspace-sample"),
        stages=(Sample(cspace_samples, ("samples", "max_sample_distance_rad"), in_null_space=False),),
    ),
    StepQPs(
        *_named("nspace-sample"),
        stages=(
            Sample(
                lambda scene, s, where, stuck: nspace_samples(scene, s, where, stuck, (s.sample_step_rad,)),
                (*_SAMPLE_SETTINGS, "sample_step_rad"),
            ),
        ),
    ),
    StepQPs(*_named("nspace-sqp"), stages=(_SQP,)),
    StepQPs(
        *_named("nspace-ip"),
        stages=(
            NullSpace(
                lambda problem, seen, key, s: sphere.interior_point(problem, seen, start_key=_start_key(s, key)),
                _FIRST,
            ),
        ),
    ),
    StepQPs(
        *_named("nspace-cmaes"),
        stages=(
            NullSpace(
                lambda problem, seen, key, s: sphere.cmaes(
                    problem, seen, key, s.population, s.generations, start_key=_start_key(s, key, cmaes=True)
                ),
                ("population", "generations", *_FIRST),
                lane_function.SAMPLED_LOOP,
            ),
        ),
    ),
    StepQPs(
        *_named("nspace-adam"),
        stages=(
            NullSpace(lambda problem, seen, key, s: sphere.adam(problem, seen, start_key=_start_key(s, key)), _FIRST),
        ),
    ),
    StepQPs(*_named("keep-clear"), keep_clear=True),
    StepQPs(
        *_named("hybrid"),
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
    BeamSearchMethod(*_named("beam")),
)
_BY_NAME: dict[str, Method] = {method.name: method for method in BUILT_IN}


def find(name: str) -> Method:
    """Return the method with the given name.

    Raises:
        InputError: If the name is unknown, or the method cannot be imported. In the second case the message names the
            method's entry point and package.
    """
    return _BY_NAME[name] if name in _BY_NAME else METHODS.find(name)


def is_shared(method: Method) -> bool:
    """Return True if other processes find the same method by its name."""
    return method is _BY_NAME.get(method.name) or METHODS.is_shared(method)
