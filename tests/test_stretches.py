"""Paths that are proven in stretches, side by side, come out as if each had been looked at from end to end."""

from dataclasses import replace
from functools import cache

import jax
import made_once
import numpy as np
import pytest
from test_motion_proof import motions

from htcp_jax.clearance.motion_proof import Tube
from htcp_jax.planner.kernel import Load, Table
from htcp_jax.planner.lane_inputs import lane_inputs
from htcp_jax.planner.programs import Kernels, Programs
from htcp_jax.planner.proofs import proofs_of
from htcp_jax.planner.tables import gather
from htcp_jax.scene.scenario import stack
from htcp_jax.settings import Settings
from htcp_jax.status import Way


@cache
def kernels():
    return Kernels(made_once.scene(), Settings())


@cache
def asked():
    """Of each motion's path, with its tube and without: (inputs, a, b, tube, kept, resolution_m, deepest)."""
    nominal = jax.tree.map(np.asarray, made_once.nominal())
    ways, a, b, tubes = zip(*motions(), strict=True)
    poses = [replace(nominal, **jax.tree.map(np.asarray, where)._asdict()) for where in ways]
    which = np.tile(np.arange(len(poses)), 2)
    inputs = lane_inputs(stack(poses), which, np.zeros_like(which))
    free = [Tube(np.zeros(3), np.zeros(3), np.array(np.inf))] * len(poses)
    tube = jax.tree.map(lambda *leaves: np.stack(leaves), *tubes, *free)
    rng = np.random.default_rng(0)
    kept, deepest = rng.choice([0.0, 0.5, 0.99], len(which)), rng.choice([3, 20, 30], len(which))
    resolution_m = rng.choice([-1e-9, 1e-5], len(which))
    return inputs, np.stack(a + a), np.stack(b + b), tube, kept, resolution_m, deepest


@cache
def unbroken():
    return proofs_of(kernels(), *asked())


def test_several_paths_of_a_lane_are_proven_as_those_of_as_many_lanes():
    inputs, a, b, tube, *closely = asked()
    lane, few = np.repeat([3, 0, 3], 10), slice(30)
    ways, closely = gather((a, b), few), gather(closely, few)
    own_inputs, own_tube = gather((inputs, tube), lane)
    apart = proofs_of(kernels(), own_inputs, *ways, own_tube, *closely)
    found = proofs_of(kernels(), inputs, *ways, tube, *closely, lane=lane)
    assert len(np.unique(found.verdict)) > 1
    for one, other in zip(apart, found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("table", [Table(16, 1, True), Table(64, 8, True), Table(512, 300, True)])
def test_proofs_in_stretches_are_unbroken_ones(table, monkeypatch):
    """Verdicts, places, and how many places were looked at how closely; clearances but for what rounds otherwise where
    lanes are computed side by side. Whatever other paths there are, and however many slots."""
    expected = unbroken()
    assert np.unique(expected.verdict).tolist() == [Way.PROVEN, Way.COLLIDES, Way.LEAVES, Way.TURNS_BACK, Way.OPEN]
    monkeypatch.setattr(Load, "on", lambda load, device: table)
    in_stretches = Kernels(made_once.scene(), Settings(), programs=Programs())
    for rows in (slice(None), slice(7, None, 20), [int(np.argmax(expected.queries))]):
        found, own = proofs_of(in_stretches, *gather(asked(), rows)), gather(expected, rows)
        for name, value in found._asdict().items():
            np.testing.assert_allclose(value, getattr(own, name), atol=1e-14 * (name == "clearance"), err_msg=name)
            assert value.dtype == getattr(own, name).dtype


def test_of_a_path_that_is_not_proven_nothing_else_is_told():
    """What was looked at before it was refuted depends on the order."""
    found = gather(unbroken(), unbroken().verdict != Way.PROVEN)
    assert not found.queries.any() and not found.depth.any() and np.isinf(found.clearance).all()
    assert (found.place < 1).all()
