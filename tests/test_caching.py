"""Caches: a result lives as long as its object, and each cache holds a limited number of them."""

import gc
import weakref
from unittest import mock

import jax
import numpy as np

from htcp_jax.caching.decorators import cached_by_values, cached_for_last
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.device.executor import ExecutableCache
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.io.parts.workpiece_source import GeneratedDuct, load_workpiece
from htcp_jax.settings import Settings


class Owner:
    """An object with a result of its own."""


def test_results_are_kept_for_the_last_owners_and_freed_with_them():
    made = []

    @cached_for_last(2)
    def result(owner):
        made.append(Owner())
        return made[-1]

    a, b, c = Owner(), Owner(), Owner()
    first = result(a)
    assert result(b) is not first and result(a) is first  # a was used last
    result(c)
    assert result(a) is first and result(b) is not made[1] and len(made) == 4
    gone = weakref.ref(made.pop())
    assert gone() is result(b)
    del b
    gc.collect()
    assert gone() is None


def test_results_are_kept_for_the_last_values_whatever_array_has_them():
    made = []

    @cached_by_values(2)
    def result(array, power):
        made.append(array**power)
        return made[-1]

    a, b = np.arange(6.0), np.arange(6.0).reshape(2, 3)
    first = result(a, 2)
    assert result(a.copy(), 2) is first and result(b, 2).shape == (2, 3) and result(a, 2) is first
    assert result(a, 3).tolist() == (a**3).tolist() and len(made) == 3
    a[0] = 7.0
    assert result(a, 2)[0] == 49.0 and len(made) == 4


def test_the_obstacles_of_a_workpiece_leave_the_device_with_it():
    part = load_workpiece(source=GeneratedDuct(points=200))
    cloud = make_obstacle(part)[0]
    assert make_obstacle(part)[0] is cloud
    points = weakref.ref(cloud.points)
    del part, cloud
    gc.collect()
    assert points() is None


class Compiled(LaneFunction):
    """A function that needs no compiling and counts how often it is compiled."""

    def jitted(self, settings, device):
        return self

    def lower(self, *arguments):
        return self

    def compile(self, options):
        self.parts[0].append(1)
        return mock.Mock(spec=jax.stages.Compiled)


class Counts(list):
    """A list that may be part of a key."""

    __hash__ = object.__hash__


def test_executables_beyond_the_most_are_dropped_those_first_that_were_not_asked_for_the_longest():
    executables, device = ExecutableCache(most=2), jax.devices()[0]
    a, b, c = (Compiled(name, abs, STEP, parts=(Counts(),)) for name in "abc")
    for each in (a, b, a, c, a, b):
        executables.get(each, Settings(), device, (np.zeros(1),))
        assert len(executables) <= 2
    assert [len(each.parts[0]) for each in (a, b, c)] == [1, 2, 1]
