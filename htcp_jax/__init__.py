"""HTCP in JAX: path tracking inside narrow parts, batched over scenarios, with hard constraints.

    import htcp_jax

    plan = htcp_jax.plan()                                               # one job: the default one, or a YAML file
    plan.frame(), plan.figure()                                          # one row per target, and the picture
    run = htcp_jax.sweep("sweeps/workpiece", "baseline,hybrid")          # a grid of jobs by several methods
    run.frame()                                                          # one row per method and scenario
    htcp_jax.time_run(run, "20mm/s").frame()                             # execution times at that feed rate
    report = htcp_jax.make_report(run)                                   # the paper's tables, and all charts
    report.frame("results"), report.figures["success"]

Kinematics, clearance and the null-space objective are pure functions of arrays, for jax.grad, jax.vmap and jax.jit:

    jax.grad(htcp_jax.minimum_clearance, argnums=3)(plan.robot, obstacle, plan.scenario, x)

The names in `__init__.pyi` are public; each is loaded when it is first used. The first use of any of them also enables
the cache of compiled functions (see `cache_folder`) and the display of figures in notebooks. Every subpackage
lists its public names in an `__init__.pyi`, too.
"""

import importlib
import os
import sys
import time

import lazy_loader

_imported_s = time.time()  # source files changed later may differ from the imported code, see `cache_key`

# On a CPU, XLA compiles a loop to a series of small kernels, which its thread pool or a library (YNNPACK) runs one by
# one. Our loops consist of hundreds of tiny kernels. With these flags each loop is one native function. It takes less
# than half the time, and threads that run executables do not wait for each other. JAX reads the flags when it starts,
# so they are set before. A flag that the user has set is not changed.
_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000000000000"
    ",xla_cpu_disable_loop_unrolling=true",
    "--xla_cpu_experimental_ynn_fusion_type=",
)
_given = os.environ.get("XLA_FLAGS", "")
_own = (flag for flag in _FLAGS if flag.partition("=")[0] not in _given)
os.environ["XLA_FLAGS"] = " ".join(filter(None, (_given, *_own)))

# 64-bit floats: clearances of 0.1 mm decide results. 32-bit floats resolve 0.1 um at 2 m, and the step QPs lose more
# digits. JAX is not imported here, because the command installs its signal handlers first.
os.environ["JAX_ENABLE_X64"] = "1"
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str):
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    if name not in __all__:
        hint = importlib.import_module("htcp_jax.errors").did_you_mean(name, __all__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; {hint}public names: {', '.join(__all__)}")
    importlib.import_module("htcp_jax.caching.cache_folder").enable()
    importlib.import_module("htcp_jax.notebook").show_figures()
    return _load(name)
