"""Dead ends of the beam search: what is tried after them only adds targets, is bounded, and is recorded."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import toy

from htcp_jax.device import Executor
from htcp_jax.errors import InputError
from htcp_jax.model import Workpiece
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Execution, Plans, Problem, Tried
from htcp_jax.motion.sparse_columns import DeadEnds
from htcp_jax.planning.batch import plan
from htcp_jax.planning.beam.dead_ends import FEW, MOST_MISSED
from htcp_jax.settings import Settings, settings_of
from htcp_jax.status import Exclusion, Status


def with_effort(effort: float) -> Plans:
    return toy.plans_by(settings=replace(toy.SETTINGS, effort=effort, smooth=False))


def test_effort_adds_targets_at_most_and_leaves_complete_plans_as_they_are():
    before, after = with_effort(0.0), with_effort(20.0)
    assert (after.outcomes.executable >= before.outcomes.executable).all()
    assert (after.executable == after.tracked).all()
    complete = np.flatnonzero(before.outcomes.complete)
    assert len(complete)
    for s in complete.tolist():
        toy.same(before, s, after, s, before.status.shape[1])
    assert not len(before.dead_ends.scenario) and not set(after.dead_ends.scenario) & set(complete)


def test_what_was_tried_is_recorded_at_the_lost_target_and_grows_with_the_effort():
    little, much = with_effort(2.0), with_effort(20.0)
    work = [plans.dead_ends.configurations.sum() for plans in (little, much)]
    assert 0 < work[0] < work[1]
    for s, target in zip(much.dead_ends.scenario, much.dead_ends.target, strict=True):
        assert 0 < target <= much.outcome(int(s)).failed
        assert "configurations sampled or extended" in much.dead_ends.on(int(s))[int(target)].description


def test_a_target_with_known_clear_configurations_is_lost_for_want_of_a_segment():
    """Regression: "no clear configuration found" next to "24 clear configurations found at the target"."""
    plans = with_effort(20.0)
    tried = [(end, plans.dead_ends.on(end.scenario).get(end.failed)) for end in map(plans.outcome, range(5))]
    found = [end.status for end, known in tried if known and known.found and not known.connected]
    assert len(found) > 2 and set(found) == {Status.PATH_BLOCKED}


def towards_a_ball(**changes) -> Plans:
    """A path that ends in the middle of a hollow ball, into which no tool gets."""
    count = len(toy.workpiece().cloud)  # as many points as the shelf has, so that the programs are the same
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ball = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    path = np.array([[0.5, 0.3, 0.6], [0.5, 0.0, 0.5]])
    part = Workpiece("ball", path[-1] + 0.05 * ball, path, interior="none", pivot=np.zeros(3),
                     neutral_translation=np.zeros(3))  # fmt: skip
    one, settings = make_scenario(toy.robot(), part, None, **changes), replace(toy.SETTINGS, path_check="recoveries")
    return toy.planned(one, settings=settings, part=part, threads=1)  # without inserted goals


def test_the_search_ends_also_if_no_configuration_reaches_the_lost_target():
    """Every round of draws costs effort (regression: an endless loop). With a small margin few cells prove nothing."""
    plans = towards_a_ball()
    (tried,) = plans.dead_ends.on(0).values()
    assert not tried.excluded and tried.found == 0 and tried.configurations > 0


def test_sampling_ends_if_no_draw_arrives_at_the_target_whatever_the_effort():
    """A path that ends beyond the first joint's limits (regression: the complete effort went into draws)."""
    arm = toy.robot()
    arm = replace(arm, lower=arm.lower.at[0].set(0.0), upper=arm.upper.at[0].set(2.0))
    path = np.linspace([0.5, 0.02, 0.5], [0.5, -0.02, 0.5], 5)
    away, zero = toy.workpiece().cloud + np.array([0.0, 0.0, 3.0]), np.zeros(3)
    part = Workpiece("line", away, path, interior="none", pivot=zero, neutral_translation=zero)
    settings = replace(toy.SETTINGS, effort=1000.0, path_check="recoveries")
    one = make_scenario(arm, part, None, rotation=(0.0, 0.0))
    plans = plan(Problem.of(arm, part, one, settings, execution=Execution(threads=1)))
    (tried,) = plans.dead_ends.on(0).values()
    assert not tried.excluded and tried.found == 0 and tried.configurations == MOST_MISSED // FEW


def test_nothing_is_searched_after_a_target_that_is_excluded_by_proof():
    plans = towards_a_ball(margin_m=0.08)
    assert plans.outcome(0).failed == plans.outcome(0).targets - 1
    assert plans.dead_ends.on(0) == {plans.outcome(0).failed: Tried(excluded=Exclusion.TOOL)}


def test_the_reason_of_an_exclusion_is_kept_when_rows_are_selected_and_folded():
    scenario = toy.scenario()
    targets, last = scenario.targets.copy(), len(scenario.targets) - 1
    targets[-1] = [9.0, 0.0, 0.5]
    settings = replace(toy.SETTINGS, path_check="recoveries")  # no inserted goals
    plans = toy.planned([toy.scenario(), replace(scenario, targets=targets)], settings=settings, threads=1)
    tried = Tried(excluded=Exclusion.OUT_OF_REACH)
    assert plans.dead_ends.on(1)[last] == tried and plans.rows([1]).dead_ends.on(0)[last] == tried
    assert "excluded by proof: the arm does not get there" in tried.description
    both = DeadEnds.of({(0, 3): Tried(1, 20, 0, 0), (0, 4): tried}).moved(np.zeros((1, 5), int))
    assert both.on(0) == {0: Tried(1, 20, 0, 0, excluded=Exclusion.OUT_OF_REACH)}


def test_dead_ends_follow_their_scenarios():
    plans = with_effort(2.0)
    rows = np.arange(len(plans.status))[::-1]
    turned = plans.rows(rows)
    assert all(turned.dead_ends.on(new) == plans.dead_ends.on(old) for new, old in enumerate(rows.tolist()))
    both = Plans.concatenate([plans, turned])
    assert both.dead_ends.on(len(rows)) == plans.dead_ends.on(int(rows[0]))
    assert both.rows(rows).dead_ends.on(0) == plans.dead_ends.on(int(rows[0]))


def test_searches_after_dead_ends_of_many_scenarios_share_their_calls(monkeypatch):
    """Of equal scenarios each is searched as if alone, with as many calls of lane functions for three as for one."""
    whole, calls, call = with_effort(20.0), [], Executor.__call__
    lost = int(whole.dead_ends.scenario[0])
    monkeypatch.setattr(Executor, "__call__", lambda self, *args: calls.append(args[0].name) or call(self, *args))
    settings, counts = replace(toy.SETTINGS, effort=20.0, smooth=False), []
    for many in (1, 3):
        calls.clear()
        plans = toy.planned([toy.scenarios()[lost]] * many, settings=settings, threads=1)
        counts.append(Counter(calls))
        for s in range(many):
            toy.same(whole, lost, plans, s, plans.status.shape[1])
            assert plans.dead_ends.on(s) == whole.dead_ends.on(lost)
    assert counts[0] == counts[1] and {"push", "prove", "extend"} <= set(counts[0])


def test_an_effort_below_zero_is_refused():
    with pytest.raises(InputError, match="effort"):
        settings_of({"effort": -1})
    assert Settings(effort=0.0).effort == 0.0
