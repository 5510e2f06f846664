"""Sensitivity of the regression gate: it detects a fault in each part that a plan depends on.

Every fault is injected where the number is computed, in a process of its own that then plans the same small sweep.
Cached programs cannot hide a fault, as a process that replaced a function of the core takes none by its source.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.spec.examples import examples

GRID = f"""
config: {examples()["port"]}
grid:
  - workpiece.rotation_y_rad: [0.2, 0.4, 0.6]
  - workpiece.rotation_z_rad: [-0.3, 0.0, 0.2]
"""
FAULTS = {
    "kinematics": """
from htcp_jax.model import kinematics
matrix = kinematics.axis_angle_matrix
kinematics.axis_angle_matrix = lambda axis, turn: matrix(axis, 1.0005 * turn)
""",
    "clearance sign": """
from htcp_jax.clearance.obstacles import obstacles
contacts = obstacles.contacts
def wrong(*arguments):
    found = contacts(*arguments)
    return found._replace(distance=-found.distance)
obstacles.contacts = wrong
""",
    "QP row": """
from htcp_jax.solvers import step_qp
assemble = step_qp.assemble
def wrong(*arguments):
    found = assemble(*arguments)
    return found._replace(G=-found.G)
step_qp.assemble = wrong
""",
    "cost about x_{t-1}": """
from htcp_jax.solvers import step_qp
assemble = step_qp.assemble
step_qp.assemble = lambda settings, x_ref, x_previous, *rest: assemble(settings, x_ref, x_ref, *rest)
""",
    "single clearance row": """
import jax.numpy as jnp
from htcp_jax.clearance.obstacles import linearisation
clearance_rows = linearisation.clearance_rows
def wrong(*arguments):
    rows = clearance_rows(*arguments)
    return rows._replace(gradient=jnp.flip(rows.gradient, axis=0))
linearisation.clearance_rows = wrong
""",
    "Q": """
from types import SimpleNamespace
from htcp_jax.solvers import step_qp
assemble = step_qp.assemble
def wrong(settings, *rest):
    read = {name: getattr(settings, name) for name in ("cost_about", "clearance_rows")}
    return assemble(SimpleNamespace(q_weights=settings.q_weights[::-1], **read), *rest)
step_qp.assemble = wrong
""",
    "J1's weight": """
from types import SimpleNamespace
from htcp_jax.planning.tracking import null_space
sphere_problem = null_space.sphere_problem
def wrong(scene, settings, *rest):
    read = {name: getattr(settings, name) for name in null_space.READS} | {"j1_weight": 0.0}
    return sphere_problem(scene, SimpleNamespace(**read), *rest)
null_space.sphere_problem = wrong
""",
    "null-space step": """
from htcp_jax.solvers import sphere
sqp = sphere.sqp
def wrong(*arguments, **start):
    best = sqp(*arguments, **start)
    return best._replace(w=-best.w)
sphere.sqp = wrong
""",
}
PLANNED_BY = {fault: "nspace-sqp" if fault in ("null-space step", "J1's weight") else "baseline" for fault in FAULTS}


def plan(place: Path, method: str, out: str, fault: str = "") -> Path:
    """Plan the sweep in a separate process, with a fault or without; return its run folder."""
    command = ["sweep", "grid.yaml", "--methods", method, "--out", out]
    program = f"{fault}\nfrom htcp_jax.cli.main import main\nraise SystemExit(main({command}))"
    environment = os.environ | {"PYTHONPATH": str(Path(htcp_jax.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", program], cwd=place, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return place / out


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with nine of the gated poses under the gated settings, and their baselines."""
    place = tmp_path_factory.mktemp("faults")
    (place / "grid.yaml").write_text(GRID)
    for method in dict.fromkeys(PLANNED_BY.values()):
        assert main(["gate", str(plan(place, method, method)), *baseline(place, method), "--update"]) == 0
        file = place / f"{method}.yaml"
        file.write_text(file.read_text().replace("    more_targets: null\n", "    more_targets: 0\n"))
    return place


def baseline(place: Path, method: str) -> list[str]:
    return ["--baseline", str(place / f"{method}.yaml")]


@pytest.mark.slow
@pytest.mark.parametrize("method", dict.fromkeys(PLANNED_BY.values()))
def test_without_a_fault_the_gate_passes(place, method):
    again = plan(place, method, f"{method}-again")
    assert main(["gate", str(again), *baseline(place, method)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_does_not_pass_the_gate(place, fault, capsys):
    run = plan(place, PLANNED_BY[fault], f"fault-{list(FAULTS).index(fault)}", FAULTS[fault])
    capsys.readouterr()
    assert main(["gate", str(run), *baseline(place, PLANNED_BY[fault])]) == 1
    reported = capsys.readouterr().out
    print(reported)
    assert reported.endswith("FAILED\n")
