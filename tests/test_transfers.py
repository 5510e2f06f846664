"""Configurations sampled at targets, for many scenarios together."""

import jax
import numpy as np
import toy

from htcp_jax.device import Executor
from htcp_jax.motion import transfers


def test_scenarios_sampled_together_get_the_configurations_of_each_alone(monkeypatch):
    """Check also that scenarios share the calls of lane functions, and that the configurations are valid."""
    problem = toy.problem(threads=1)
    checker, limits = problem.checkers[0], problem.checkers[0].executor.limits
    lanes = []
    call = Executor.__call__
    monkeypatch.setattr(
        Executor, "__call__", lambda self, function, *of: lanes.append(len(of[1])) or call(self, function, *of)
    )
    scenario, round_, target = np.array([3, 0, 4, 0]), np.array([0, 0, 7, 1]), np.array([0, 2, 3, 2])
    at, lane = transfers.other_configurations(problem, checker, scenario, round_, target)
    draws = len(scenario) * transfers.DRAWS
    assert lanes[:2] == [draws] * 2 and len(lanes) == 3 and lanes[2] < draws
    assert set(lane.tolist()) == set(range(len(scenario))) and (np.diff(lane) >= 0).all()
    for k in range(len(scenario)):
        alone, _ = transfers.other_configurations(problem, checker, scenario[k : k + 1], int(round_[k]), int(target[k]))
        jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda leaf, k=k: leaf[lane == k], at), alone)
        one = jax.tree.map(lambda leaf, k=k: leaf[scenario[k]], problem.scenarios)
        clearance, tcp = toy.measured(one, alone.x)
        assert (
            (clearance >= float(one.margin_m)).all() and (limits[0] <= alone.x).all() and (alone.x <= limits[1]).all()
        )
        assert np.linalg.norm(tcp - one.targets[target[k]], axis=1).max() <= toy.SETTINGS.tolerance_m + 1e-12
    assert not np.array_equal(at.x[lane == 1], at.x[lane == 3])  # two rounds of one scenario


def test_no_valid_configuration_is_discarded_before_it_is_measured():
    """Check also configurations that are only just within the task's tolerance, beyond that of inverse kinematics."""
    problem = toy.problem(threads=1)
    checker, scenario = problem.checkers[0], np.array([0, 3, 4])
    drawn, lane = transfers.drawn_configurations(problem, checker, scenario, 0), np.repeat(scenario, transfers.DRAWS)
    exact, inputs = transfers.projected(problem, checker, lane, 0, np.concatenate(drawn)), problem.inputs(lane, 0)
    off = 0.5 * toy.SETTINGS.tolerance_m * np.random.default_rng(0).normal(size=exact.x.shape)
    for here in (exact, checker.states(inputs, exact.x + off)):
        valid, kept = checker.valid(inputs, here), checker.may_be_valid(inputs, here.x)
        assert valid.any() and kept[valid].all() and kept.sum() < len(kept) / 2
    assert (here.residual[valid] > 2 * problem.task.fine_m).any()
