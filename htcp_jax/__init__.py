"""HTCP in JAX: path tracking inside narrow parts, batched over scenarios, with hard constraints.

    import htcp_jax

    plan = htcp_jax.plan()                                               # one job: the default one, or a YAML file
    plan.frame(), plan.figure()                                          # one row per target, and the picture
    run = htcp_jax.sweep("sweeps/workpiece", "baseline,hybrid")          # a grid of jobs by several methods
    run.frame()                                                          # one row per method and scenario
    htcp_jax.time_run(run, "20mm/s").frame()                             # and execution times at that feed rate
    report = htcp_jax.make_report(run)                                   # the paper's tables, and all charts
    report.frame("results"), report.figures["success"]

Kinematics, clearance and the null-space objective are pure functions of arrays, for jax.grad, jax.vmap and jax.jit:

    jax.grad(htcp_jax.clearance.clearance, argnums=3)(plan.robot, obstacle, plan.scenario, x)

The names in `__init__.pyi` are public; each is loaded when it is first used. That also turns on the cache of compiled
functions (see `compile_cache`), as the command does, and lets a notebook show figures. Every package has such a list.
"""

import importlib
import os
import sys
import time

import lazy_loader

_imported_s = time.time()  # source files that are newer may not be what this process runs, see `executable_key`

# On a CPU, XLA compiles a loop in an executable to a series of small kernels, which it hands one by one to its own
# threads, or to a library (YNNPACK). Our loops consist of hundreds of tiny ones: as one native function each they take
# half the time, and threads that run executables do not wait for each other. Read when JAX starts, so it comes first;
# a value that is set already is kept.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000000000000"
    ",xla_cpu_disable_loop_unrolling=true --xla_cpu_experimental_ynn_fusion_type=",
)

# Clearances of 0.1 mm decide results; 32-bit floats carry 0.1 um at 2 m, and the step QPs lose more. Once, here. JAX
# itself is imported later: the command handles signals before.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str):
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public are {', '.join(__all__)}")
    importlib.import_module("htcp_jax.device.compile_cache").enable()
    importlib.import_module("htcp_jax.notebook").show_figures()
    return _load(name)
