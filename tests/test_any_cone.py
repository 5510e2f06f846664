"""One executable serves axes with and without a cone, with the results of an executable of their own.

The arm has four joints; the task is a height and an axis.
"""

from dataclasses import replace

import jax
import made_once
import numpy as np
import pytest
import toy

from htcp_jax.clearance import Scene
from htcp_jax.device import Executor
from htcp_jax.device.executor import EXECUTABLES, ExecutableCache
from htcp_jax.model import Task, TaskPoint
from htcp_jax.model.built_in_rows import AxisTowards
from htcp_jax.model.scenario import stack
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.manipulability import manipulability
from htcp_jax.motion.step_functions import ADVANCE, SETTLE, TASK_ROWS
from htcp_jax.planning.beam.functions import EXTEND, SELF_MOTION
from htcp_jax.planning.tracking.stages import PUSH

COUNT, SHARED = 24, ExecutableCache()
HALF_ANGLES = {"a cone": 0.06, "no cone": 0.0}
FUNCTIONS = SETTLE, EXTEND, SELF_MOTION, PUSH


def task(kind: str) -> Task:
    """A height of the TCP, and an axis with or without a cone."""
    return Task((TaskPoint(axes=(2,)), AxisTowards(None, (0.0, 0.0, 1.0), cone=HALF_ANGLES[kind] > 0)))


def calls(kind: str) -> dict:
    """Tables of calls for a task: goals that configurations satisfy, and others near these configurations."""
    there = made_once.configurations_near(toy.START, COUNT, 0.2)
    value = made_once.quick_jit(jax.vmap(task(kind).value, (None, 0)))
    goals = np.column_stack([np.asarray(value(toy.robot(), there)), np.full(COUNT, HALF_ANGLES[kind])])
    inputs = lane_inputs(stack([toy.scenario()]), np.zeros(COUNT, int), np.zeros(COUNT, int))
    inputs = inputs._replace(target=goals)
    near = there + made_once.configurations_near(np.zeros(4), COUNT, 0.05, seed=1)
    number = np.arange(COUNT, dtype=np.int32)
    return {
        ADVANCE: (inputs, near, np.zeros_like(near)),
        SETTLE: (inputs, near),
        EXTEND: (inputs, near),
        SELF_MOTION: (inputs, there, np.full_like(there, np.nan), number),
        PUSH: (inputs, near),
    }


def executor(kind: str, executables: ExecutableCache) -> Executor:
    """Executor of lane functions for a task."""
    return Executor(Scene(toy.robot(), toy.scene().obstacles, task(kind)), toy.SETTINGS, executables=executables)


@pytest.mark.parametrize("lane_function", FUNCTIONS, ids=[each.name for each in FUNCTIONS])
def test_axes_with_and_without_a_cone_share_an_executable_with_the_results_of_their_own(lane_function):
    before, quick = len(SHARED), replace(lane_function, compiles_quickly=True)
    alone = replace(quick, any_cone=False)
    for kind in HALF_ANGLES:
        tables = calls(kind)[lane_function]
        found, own = executor(kind, SHARED)(quick, *tables), executor(kind, ExecutableCache())(alone, *tables)
        for leaf, other in zip(jax.tree.leaves(found), jax.tree.leaves(own), strict=True):
            np.testing.assert_allclose(leaf, other, rtol=0, atol=1e-9)
            assert leaf.dtype.kind == "f" or (leaf == other).all()
    assert len(SHARED) == before + 1


@pytest.mark.parametrize("kind", HALF_ANGLES)
def test_the_rows_of_a_task_are_those_of_its_own(kind):
    inputs, x, y = calls(kind)[ADVANCE]
    own, linear = task(kind), executor(kind, SHARED)(ADVANCE, inputs, x, y).linear
    rows = own.own_rows(executor(kind, SHARED)(TASK_ROWS, inputs, linear))
    alone = made_once.quick_jit(jax.vmap(own.linear_at, (None, 0, 0)))(toy.robot(), x, inputs.target)
    for leaf, other in zip(rows, alone, strict=True):
        assert leaf.shape == other.shape
        np.testing.assert_allclose(leaf, other, rtol=0, atol=1e-12)
    found = manipulability(toy.robot(), own, x, inputs.target)
    np.testing.assert_allclose(found, np.linalg.svd(np.asarray(alone.jacobian), compute_uv=False)[:, -1], atol=1e-12)


def test_another_margin_path_tolerance_seed_and_54_placements_compile_nothing(monkeypatch):
    """Also if dead ends, which need more lane functions, are elsewhere: all are compiled first, as for a sweep."""
    monkeypatch.setattr(EXECUTABLES, "_compiled", {})
    short = replace(toy.workpiece(), path=toy.workpiece().path[:3])
    first = toy.planned([toy.scenario(part=short)], part=short, warm_up=("beam",))
    before = len(EXECUTABLES)
    many = [toy.scenario(number, shift=(0.0, 1e-4 * number, 0.0), margin_m=1e-3) for number in range(54)]
    for placements, effort in ((many, 0.0), (many[:2], 0.1)):  # smoothing and dead ends are long, and need no more rows
        other = replace(toy.SETTINGS, path_tolerance_m=5e-4, seed=3, effort=effort, smooth=effort > 0)
        plans = toy.planned(placements, settings=other)
        assert len(EXECUTABLES) == before and plans.compile_s == 0
    assert len(first.dead_ends.scenario) == 0 and len(plans.dead_ends.scenario) == 2
