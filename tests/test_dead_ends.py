"""Dead ends of the beam search: what is tried after them only adds targets, is bounded, and is recorded."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from htcp_jax.errors import InputError
from htcp_jax.motion import Plans
from htcp_jax.settings import Settings, settings_of


def with_effort(effort: float) -> Plans:
    return toy.planned(settings=replace(toy.SETTINGS, effort=effort, smooth=False), threads=1)


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


def test_the_search_ends_also_if_no_configuration_reaches_the_lost_target():
    """Every round of draws costs effort (regression: an endless loop)."""
    scenario = toy.scenario()
    targets = scenario.targets.copy()
    targets[-1] = [9.0, 0.0, 0.5]
    settings = replace(toy.SETTINGS, effort=2.0, path_check="recoveries")  # no inserted goals
    plans = toy.planned([replace(scenario, targets=targets)], settings=settings, threads=1)
    tried = plans.dead_ends.on(0)[len(targets) - 1]
    assert plans.outcome(0).failed == len(targets) - 1
    assert tried.found == 0 and tried.configurations > 0


def test_dead_ends_follow_their_scenarios():
    plans = with_effort(2.0)
    rows = np.arange(len(plans.status))[::-1]
    turned = plans.rows(rows)
    assert all(turned.dead_ends.on(new) == plans.dead_ends.on(old) for new, old in enumerate(rows.tolist()))
    both = Plans.concatenate([plans, turned])
    assert both.dead_ends.on(len(rows)) == plans.dead_ends.on(int(rows[0]))
    assert both.rows(rows).dead_ends.on(0) == plans.dead_ends.on(int(rows[0]))


def test_an_effort_below_zero_is_refused():
    with pytest.raises(InputError, match="effort"):
        settings_of({"effort": -1})
    assert Settings(effort=0.0).effort == 0.0
