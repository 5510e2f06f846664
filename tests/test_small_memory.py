"""Executor on a device with too little memory for its tables."""

import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from htcp_jax.device import Executor
from htcp_jax.device.executor import ExecutableCache
from htcp_jax.device.lane_function import BatchSize, DeviceSizes, LaneFunction
from htcp_jax.settings import Settings

LANES, SAMPLES = 2048, 32768  # a table of all lanes' samples takes 537 MB
SIZE = BatchSize(LANES, LANES)
LESS = "too little memory for ordered; its tables are halved"


class Lane(NamedTuple):
    """Input of the lane function."""

    tool_extension_m: np.ndarray
    seed: np.ndarray


def ordered(settings, scene, lane: Lane) -> jax.Array:
    """Middle one of many numbers, which cannot be found without all of them in memory."""
    return jnp.sort(jnp.sin(lane.seed + jnp.arange(SAMPLES, dtype=float)))[SAMPLES // 2]


ORDERED = LaneFunction("ordered", ordered, DeviceSizes(SIZE, SIZE))


def lanes(count: int) -> Lane:
    return Lane(np.zeros(count), np.arange(count, dtype=float))


def expected(count: int) -> np.ndarray:
    return np.array([np.sort(np.sin(seed + np.arange(SAMPLES, dtype=float)))[SAMPLES // 2] for seed in range(count)])


class Full(ExecutableCache):
    """Cache of executables that run out of memory above a number of rows."""

    def __init__(self, most: int):
        super().__init__()
        self.most, self.rows = most, []

    def get(self, lane_function, settings, device, arguments, *waiting):
        self.rows.append(len(jax.tree.leaves(arguments)[-1]))
        if self.rows[-1] > self.most:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 1099511627776 bytes.")
        return super().get(lane_function, settings, device, arguments, *waiting)


def executor(most: int) -> Executor:
    return Executor(toy.scene(), Settings(), executables=Full(most))


def test_tables_are_halved_until_they_fit_and_one_line_says_so():
    full = executor(8)
    with pytest.warns(UserWarning, match=LESS) as warned:
        found = full(ORDERED, lanes(20))
    assert len(warned) == 1 and full._executables.rows == [2048 >> k for k in range(9)]
    np.testing.assert_allclose(found, expected(20), rtol=0, atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(full(ORDERED, lanes(20)), found)
        with full.preparing([(ORDERED, lanes(1))]):
            pass
    assert full._executables.rows[9:] == [8]


def test_a_call_that_no_table_can_hold_is_an_error():
    with pytest.warns(UserWarning, match=LESS), pytest.raises(jax.errors.JaxRuntimeError, match="Out of memory"):
        executor(0)(ORDERED, lanes(20))


CHILD = """
import resource
import test_small_memory as of

executor = of.Executor(of.toy.scene(), of.Settings(), executables=of.ExecutableCache())
executor(of.LaneFunction("small", of.ordered, of.DeviceSizes(of.BatchSize(1, 1), of.SIZE)), of.lanes(1))
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 450_000_000
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
found = executor(of.ORDERED, of.lanes(3))
print(executor._executables.fitting(of.ORDERED).sizes.cpu.capacity, *found)
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_a_process_with_a_limited_memory_plans_on():
    """The address space has room for a part of the table, so that XLA itself reports that memory is exhausted."""
    path = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    known = os.environ | {"PYTHONPATH": os.pathsep.join(path), "HTCP_CACHE": "off"}
    words = [sys.executable, "-W", "always", "-c", CHILD]
    process = subprocess.run(words, env=known, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    rows, *found = map(float, process.stdout.split())
    assert rows < LANES and process.stderr.count(LESS) == 1
    np.testing.assert_allclose(found, expected(3), rtol=0, atol=1e-12)
