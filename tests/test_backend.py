"""Backend that functions are compiled for: chosen by the device, kept apart in JAX's caches."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
import toy

from htcp_jax.backend import Backend, backend, compiled_for
from htcp_jax.device import Executor
from htcp_jax.device.executor import ExecutableCache
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.device.tables import pad
from htcp_jax.model.scenario import stack
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.numerics import fold_keys
from htcp_jax.planning import methods
from htcp_jax.reachability import reachable_prefixes
from htcp_jax.settings import Settings

CPU, GPU = Backend.of("cpu"), Backend.of("gpu")
ROOT = Path(__file__).parents[1]


@jax.jit
def inner(x):
    return x + (1.0 if backend().is_cpu else 2.0)


@jax.jit
def outer(x):
    return jax.lax.map(inner, x)


def test_a_nested_function_is_traced_once_for_each_backend_and_never_mixed():
    x, found = jnp.zeros(2), []
    for each in (CPU, GPU, CPU, Backend("another"), GPU):
        with compiled_for(each):
            found.append(float(outer(x)[0]))
    assert found == [1.0, 2.0, 1.0, 2.0, 2.0] and outer._cache_size() == 3


def test_loops_of_the_mathematics_are_unrolled_for_a_gpu_alone():
    def loops(each):
        with compiled_for(each):
            return str(jax.make_jaxpr(lambda k: fold_keys(jax.random.PRNGKey(0), k, k, k))(1)).count("unroll=1")

    assert (loops(CPU), loops(GPU)) == (1, 0)


class Lowered(LaneFunction):
    """A function that notes the backend of its trace, in place of one for a device that is not here."""

    def jitted(self, settings, device):
        return self

    def lower(self, *arguments):
        SEEN.append(backend())
        return self

    def compile(self, options):
        return mock.Mock(spec=jax.stages.Compiled)


SEEN = []


def test_a_function_compiled_for_a_gpu_takes_the_gpus_branch_and_one_for_a_cpu_the_cpus():
    lane_function, executables = Lowered("noted", abs, STEP), ExecutableCache()
    gpu = mock.Mock(spec=jax.Device, platform="gpu")  # none is here
    executables.get(lane_function, Settings(), gpu, (np.zeros(1),))
    with compiled_for(GPU):
        executables.get(lane_function, Settings(), jax.devices("cpu")[0], (np.zeros(1),))
    assert SEEN == [GPU, CPU]


def test_what_starts_searches_and_bounds_run_can_be_traced_for_a_gpu(monkeypatch):
    """Trace the lane functions of all methods and, as they are called, of starts, transfers, dead ends and bounds."""
    called, call = {}, Executor.__call__

    def noted(self, lane_function, *tables):
        called.setdefault(lane_function.name, (self, lane_function, *tables))
        return call(self, lane_function, *tables)

    monkeypatch.setattr(Executor, "__call__", noted)
    settings = replace(toy.SETTINGS, transfers=True)
    toy.planned([replace(toy.scenario(), auto_start=np.array(True)), toy.scenarios()[3]], settings=settings)
    reachable_prefixes(toy.robot(), toy.workpiece(), stack([toy.scenario()]), toy.SETTINGS, resolution_rad=0.9)
    problem = toy.problem()
    warm_ups = [each.warm_up(problem) for each in methods.BUILT_IN]
    planned = [(problem.checkers[0].executor, *each) for own in warm_ups for each in (*own.first, *own.hard)]
    for executor, lane_function, *tables in (*called.values(), *planned):
        size, scene = lane_function.sizes.gpu, executor._for_either if lane_function.any_cone else executor._scene
        padded = jax.tree.map(lambda rows, size=size: pad(np.asarray(rows)[:1], size.capacity, size.width), tables)
        with compiled_for(Backend("gpu", has_kernels=True, interprets=True)):
            traced = lane_function.jitted(settings, mock.Mock(spec=jax.Device, platform="gpu"))
            assert jax.tree.leaves(jax.eval_shape(traced, scene, np.int32(1), *padded))
    assert {"may_be_valid", "settle", "self_motion", "push", "prove", "tool"} <= set(called)


def test_a_lane_function_gets_the_scene_with_the_lanes_own_tool():
    lane_function = LaneFunction("tool", lambda settings, scene, lane: scene.robot.T_link_tcp, STEP)
    lanes = lane_inputs(jax.tree.map(np.asarray, stack([made_once.nominal()] * 3)), np.arange(3), np.zeros(3, int))
    lanes = lanes._replace(tool_extension_m=np.array([0.0, 0.1, -0.02]))
    found = Executor(made_once.scene(), Settings())(lane_function, lanes)
    own = np.asarray(made_once.robot().T_link_tcp)
    np.testing.assert_allclose(found[:, :3, 3] - own[:3, 3], lanes.tool_extension_m[:, None] * own[:3, 2], atol=1e-15)


TWO_DEVICES = """
import jax, jax.numpy as jnp
from htcp_jax.backend import default_device
from htcp_jax.device.devices import on
first, second = jax.devices()
with on(second):
    assert jnp.zeros(1).device == default_device() == second
    with on(first):
        assert jnp.zeros(1).device == default_device() == first
assert jnp.zeros(1).device == default_device() == first and jax.config.jax_default_device is None
"""


def test_arrays_are_made_on_the_chosen_device_as_long_as_it_is_chosen():
    flags = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu", "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", TWO_DEVICES], env=os.environ | flags, check=True)


@pytest.mark.parametrize(
    "given",
    [
        "",
        "--xla_force_host_platform_device_count=2",
        "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling=false",
    ],
    ids=["none", "another flag", "one of ours"],
)
def test_flags_of_the_user_for_xla_are_kept_and_ours_are_added_once(given):
    code = "import os, htcp_jax; print(os.environ['XLA_FLAGS'])"
    flags, found = given, []
    for _ in range(2):  # a process, and one that it starts
        env = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
        done = subprocess.run([sys.executable, "-c", code], env=env, check=True, capture_output=True, text=True)
        flags = done.stdout.strip()
        found.append(flags)
    assert found[0] == found[1] and found[0].startswith(given)
    names = [flag.partition("=")[0] for flag in found[0].removeprefix(given).split()]
    ours = ["--xla_backend_extra_options", "--xla_cpu_experimental_ynn_fusion_type"]
    assert names == [name for name in ours if name not in given]
