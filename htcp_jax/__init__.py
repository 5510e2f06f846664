"""HTCP in JAX: position-only path tracking inside narrow parts, batched over scenarios, with hard constraints.

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

The names in `__all__` are public; each is loaded when it is first used. The first use also turns on the cache of
compiled functions (see `compile_cache`), as the command does, and lets a notebook show figures.
"""

import importlib
import os
import sys

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

_HOME = {
    "plan": "api",
    "Plan": "api",
    "sweep": "runs.sweep",
    "place": "placement.place",
    "open_run": "runs.run_folder",
    "time_run": "trajectory.whole_run",
    "make_report": "report.report",
    "methods": "api",
    "register": "planning.registry",
    "Method": "planning.registry",
    "Plans": "motion.plans",
    "Problem": "motion.problem",
    "Status": "status",
    "ObstacleKind": "clearance.obstacles.obstacle_kind",
    "Shape": "clearance.obstacles.obstacle_kind",
    "TaskRowKind": "model.task_row_kind",
    "TaskRow": "model.task_list",
    "point_of": "model.arm_features",
    "axis_of": "model.arm_features",
    "lengthen_tool": "model.robot",
    "charts": "report.charts",
    "gp50": "io.robot_file",
    "load_robot": "io.robot_file",
    "load_workpiece": "io.workpiece_file",
    "GeneratedDuct": "io.workpiece_file",
    "PointCloud": "io.workpiece_file",
    "TriangleMesh": "io.workpiece_file",
    "NoCloud": "io.workpiece_file",
    "make_scenario": "model.scenario",
    "InputError": "errors",
    # The mathematics, for jax.grad, jax.vmap and jax.jit; the smallest distance is clearance.clearance.
    "tcp_position": "model.kinematics",
    "tcp_pose": "model.kinematics",
    "jacobian": "model.kinematics",
    "capsule_segments": "model.kinematics",
    "capsule_point_distance": "numerics",
    "make_obstacle": "clearance.obstacles.of_workpiece",
    "clearance": "clearance",
    "clearances": "clearance.obstacles.obstacles",
    "linearise": "clearance.obstacles.linearisation",
    "null_basis": "numerics",
    "reanchor": "model.inverse_kinematics",
    "null_space_objective": "planning.tracking.null_space",
}
__all__ = [
    "GeneratedDuct",
    "InputError",
    "Method",
    "NoCloud",
    "ObstacleKind",
    "Plan",
    "Plans",
    "PointCloud",
    "Problem",
    "Shape",
    "Status",
    "TaskRow",
    "TaskRowKind",
    "TriangleMesh",
    "axis_of",
    "capsule_point_distance",
    "capsule_segments",
    "charts",
    "clearance",
    "clearances",
    "gp50",
    "jacobian",
    "lengthen_tool",
    "linearise",
    "load_robot",
    "load_workpiece",
    "make_obstacle",
    "make_report",
    "make_scenario",
    "methods",
    "null_basis",
    "null_space_objective",
    "open_run",
    "place",
    "plan",
    "point_of",
    "reanchor",
    "register",
    "sweep",
    "tcp_pose",
    "tcp_position",
    "time_run",
]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public are {', '.join(__all__)}")
    _begin()
    home = importlib.import_module(f"htcp_jax.{_HOME[name]}")
    return home if name in ("charts", "clearance") else getattr(home, name)  # those two are public as a whole


def _begin() -> None:
    importlib.import_module("htcp_jax.device.compile_cache").enable()
    importlib.import_module("htcp_jax.notebook").show_figures()


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
