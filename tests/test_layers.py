"""Imports run downwards only, and never in a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import htcp_jax

PACKAGE = Path(htcp_jax.__file__).parent

# From the bottom up. A module may import from its own row and from those above it in this list.
LAYERS = [
    ["__init__", "errors", "notebook", "types", "pytree", "numerics", "status", "verdict", "settings", "plans"],
    ["compile_cache", "devices"],
    ["foreign", "columns", "parsers"],
    ["table", "scan"],
    ["robot", "robot_file", "robot_tool", "robot_xml", "kinematics", "duct", "mesh_points", "cloud", "hull", "surface"],
    ["clusters", "discs", "cloud_index_gpu", "cloud_index", "half_spaces"],
    ["units"],
    ["workpiece"],
    ["tip_guard"],
    ["scenario"],
    ["clearance", "task", "seen"],
    ["nullspace", "qp_dense", "cma_es"],
    ["sphere"],
    ["qp"],
    ["qp_clarabel", "qp_qpsolvers", "qp_device"],
    ["qp_solvers"],
    ["escape", "joint_path", "kernels", "tip_check", "lanes", "engine", "planner"],
    ["strict_yaml", "config_file", "config", "job"],
    ["paper", "grid_axes", "grid_points", "grid", "metrics", "results", "ceiling", "obstruction"],
    ["charts", "chart_style", "path_charts", "success_charts", "document"],
    ["run_folder", "run_identity", "run_lock", "run_signals", "run_tables", "run_writer", "scenario_label"],
    ["sweep_here", "sweep_ray", "sweep"],
    ["validate", "validate_arm", "validate_input", "validate_mesh", "validate_track", "validate_wall"],
    ["fates", "picture", "sides"],
    ["api"],
    ["replay"],
    ["report", "report_best", "report_chapter", "report_scene", "report_tables", "report_validation", "run_parts"],
    ["gate_baseline", "gate"],
    ["doctor", "framing", "movie", "offscreen", "render", "viewer", "viewer_stage"],
    ["cli_output"],
    ["cli_doctor", "cli_methods", "cli_plan", "cli_report", "cli_sweep", "cli_validate"],
    ["cli_ceiling", "cli_gate", "cli_render", "cli_view"],
    ["cli", "__main__"],
]
LAYER = {module: number for number, row in enumerate(LAYERS) for module in row}


def modules() -> list[str]:
    return sorted(path.stem for path in PACKAGE.glob("*.py"))


def imports(module: str) -> set[str]:
    """Modules of the package that `module` imports anywhere in its source."""
    found = set()
    for node in ast.walk(ast.parse((PACKAGE / f"{module}.py").read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}.py: imports are absolute"
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("htcp_jax.")}
    return found & set(modules())


@pytest.mark.parametrize("module", modules())
def test_imports_run_downwards(module):
    assert module in LAYER, f"{module}.py has no layer; give it one in {Path(__file__).name}"
    upwards = sorted(other for other in imports(module) if LAYER.get(other, 0) > LAYER[module])
    assert not upwards, f"{module}.py imports from the layers over it: {', '.join(upwards)}"


def test_imports_run_in_no_circle():
    try:
        TopologicalSorter({module: imports(module) - {module} for module in modules()}).prepare()
    except CycleError as error:
        pytest.fail(f"imports run in a circle: {' -> '.join(error.args[1])}")
