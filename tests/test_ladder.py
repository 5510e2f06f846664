"""The benchmark's ladder graph on toy scenes: valid vertices, the same for a seed, and as far as the beam."""

import numpy as np
import toy

from benchmarks.ladder import Ladder
from htcp_jax.motion import Problem

SAMPLES = 60


def problem(*scenarios) -> Problem:
    return toy.problem(scenarios, threads=1)


def test_a_ladder_gets_as_far_as_the_beam_with_valid_vertices_and_the_same_ones_by_the_same_seed():
    one = problem(*toy.scenarios())
    tracked = toy.plans_by().tracked.sum(axis=1)
    for s in range(len(tracked)):
        rungs = list(Ladder(one, s, SAMPLES).rungs())
        assert len(rungs) >= tracked[s]
        for target, x in enumerate(rungs):
            inputs = one.inputs(s, target, len(x))
            assert one.checkers[0].valid(inputs, one.checkers[0].states(inputs, x)).all()
    assert all(map(np.array_equal, rungs, Ladder(one, s, SAMPLES).rungs()))


def test_a_ladder_has_no_vertices_where_no_configuration_keeps_the_margin():
    assert not any(map(len, Ladder(problem(toy.scenario(margin_m=0.5)), 0, SAMPLES).rungs()))
