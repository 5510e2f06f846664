"""Compilation: once per lane function, in parallel, nothing unused, and with results that do not depend on batching."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy
from made_once import compiled_from, prove

from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.clearance.proof.motion_proof import RESOLUTION_M
from htcp_jax.device import Executor, Loop
from htcp_jax.device.batching import chunked, refilled
from htcp_jax.device.devices import cores
from htcp_jax.device.executor import COMPILER, EXECUTABLES, ExecutableCache, Stopwatch
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.collision_checker import prove_call
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import PROVE
from htcp_jax.numerics import fold_keys
from htcp_jax.settings import Settings
from htcp_jax.status import Status


def requested(count):
    """Lanes of a scenario, and joint paths from near its start, some of them not clear."""
    a = made_once.configurations_near(toy.START, count, 0.3)
    b = a + 1.5 * np.random.default_rng(1).standard_normal(a.shape)
    return lane_inputs(stack([toy.scenario()]), np.zeros(count, int), np.zeros(count, int)), a, b


def test_what_is_prepared_is_what_is_called():
    """Check that a lane function is compiled once: the first call waits for the prepared program, later calls do not
    wait."""
    executables = ExecutableCache()
    executor = Executor(toy.scene(), Settings(), executables=executables)
    checker, (inputs, a, b) = CollisionChecker(executor, Settings()), requested(20)
    with executor.preparing([prove_call(checker.task, inputs, a, b)]):
        clear = checker.path_clear(inputs, a, b)
        assert len(executables) == 1 and executor.compile_s > 0 and compiled_from(executables, PROVE)
    before = executor.compile_s
    assert checker.path_clear(inputs, a, b).tolist() == clear.tolist()
    assert len(executables) == 1 and executor.compile_s == before
    scene, scenario = toy.scene(), toy.scenario()
    alone = jax.jit(lambda *ends: prove(scene, scenario, *ends, resolution_m=RESOLUTION_M).verdict)
    assert clear.tolist() == [int(alone(*ends)) == PathVerdict.VALID for ends in zip(a, b, strict=True)]
    assert clear.any() and not clear.all()


def test_what_is_prepared_is_there_in_the_end_and_a_fault_of_it_is_reported():
    executables = ExecutableCache()
    executor = Executor(toy.scene(), Settings(), executables=executables)
    inputs, a, b = requested(2)
    with executor.preparing([prove_call(executor.task, inputs, a, b)]):
        pass
    assert compiled_from(executables, PROVE)
    faulty = LaneFunction("faulty", lambda settings, scene, lane: settings.samples, STEP)
    with pytest.raises(AttributeError, match="samples"), executor.preparing([(faulty, inputs)]):
        pass


@pytest.mark.parametrize("method", ["nspace-sqp", "nspace-sample", "hybrid"])
def test_what_is_compiled_first_is_what_hard_targets_need(method, monkeypatch):
    monkeypatch.setattr(EXECUTABLES, "_compiled", {})  # nothing is in memory yet
    toy.planned(method="baseline", warm_up=(method,))
    before, hard = len(EXECUTABLES), toy.planned(method=method)
    assert (hard.status == Status.TRACKED_AFTER_RECOVERY).any()
    assert len(EXECUTABLES) == before and hard.compile_s == 0


def test_a_cancelled_compilation_never_begins():
    """Cancel what waits behind one compilation per core: a faulty lane function there is not compiled."""
    executor = Executor(toy.scene(), Settings(), executables=ExecutableCache())
    inputs, a, b = requested(2)
    faulty = LaneFunction("faulty", lambda settings, scene, lane: settings.samples, STEP)
    calls = [prove_call(executor.task, inputs, a, b)] * cores() + [(faulty, inputs)]
    with executor.preparing(calls) as compilations:
        assert compilations[-1].cancel()


def test_a_clock_goes_while_anybody_waits():
    """Time with two concurrent waits counts once, so that the rest of the wall time is computing time."""
    waiting, both, began = Stopwatch(), threading.Barrier(2), time.perf_counter()

    def wait():
        with waiting:
            both.wait()
            time.sleep(0.05)

    with ThreadPoolExecutor() as pool:
        list(pool.map(lambda _: wait(), range(2)))
    assert 0.05 <= waiting.seconds <= time.perf_counter() - began


def test_lanes_one_by_one_are_lanes_side_by_side():
    """Loop whose length differs between lanes, with a float and an integer result."""

    def lane_function(scene, x, n):
        return jax.lax.fori_loop(0, n, lambda k, x: x + scene * k.astype(float), x), n + 1

    x, n, done = np.arange(16.0).reshape(8, 2), np.arange(8, dtype=np.int32), np.arange(8) < 6
    alone, together = (chunked(lane_function, width)(jnp.asarray(0.5), np.int32(6), x, n) for width in (1, 2))
    for found in (alone, together):
        np.testing.assert_array_equal(found[0], np.where(done[:, None], x + (0.25 * n * (n - 1))[:, None], 0.0))
        np.testing.assert_array_equal(found[1], np.where(done, n + 1, 0))


def test_lanes_that_leave_their_slot_to_others_are_lanes_one_by_one():
    """Loops of 0 to 40 steps in fewer slots than lanes, as many, and more.

    Each lane gives the same result as alone, in its own row; rows that were not requested stay zero.
    """

    def lane_function(scene, x, n):
        each = n.astype(float)
        return Loop((x, jnp.zeros((), jnp.int32)), lambda s: s[1] < n, lambda s: (s[0] * scene + each, s[1] + 1))

    rng = np.random.default_rng(0)
    x, n = rng.normal(size=(64, 2)), rng.integers(0, 41, 64).astype(np.int32)
    one_by_one, scene = chunked(lane_function, 1), np.asarray(0.9)
    for run in (refilled(lane_function, width) for width in (4, 8, 64)):
        for lanes in (1, 7, 50, 64):
            alone, together = (jax.device_get(each(scene, np.int32(lanes), x, n)) for each in (one_by_one, run))
            for one, other in zip(alone, together, strict=True):
                np.testing.assert_array_equal(one[:lanes], other[:lanes])
                assert not other[lanes:].any()


def test_a_key_is_folded_number_by_number():
    for key in (jax.random.PRNGKey(3), jax.random.key(4)):
        one_by_one = key
        for value in (7, jnp.int32(-5), jnp.int64(2**40 + 3)):
            one_by_one = jax.random.fold_in(one_by_one, value)
        both = (jax.random.bits(each) for each in (one_by_one, fold_keys(key, 7, jnp.int32(-5), jnp.int64(2**40 + 3))))
        assert len({int(bits) for bits in both}) == 1


@pytest.mark.parametrize("platform", COMPILER)
def test_what_the_compiler_is_reported_it_understands(platform):
    """Compile with our options: an option that XLA has removed would stop every plan on this platform."""
    compiled = jax.jit(jnp.sin).lower(1.0).compile(COMPILER[platform])
    assert compiled(1.0) == pytest.approx(np.sin(1.0))
