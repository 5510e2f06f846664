"""Planners in a separate package: known to commands, to Ray's workers and in files like a built-in one."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import page_package
import pyarrow.parquet as pq
import pytest
import toy

import htcp_jax
from htcp_jax.device.executor import EXECUTABLES
from htcp_jax.errors import InputError
from htcp_jax.motion import Plans, Problem
from htcp_jax.planning import registry
from htcp_jax.planning.tracking import StepQPs
from htcp_jax.status import Status

ROOT = Path(__file__).parents[1]
NAME = "random-neighbours"
HTCP = "from htcp_jax.cli.main import main; raise SystemExit(main())"
TWO_WORKERS = "import ray; ray.init('local', num_cpus=2, include_dashboard=False, log_to_driver=False); "
JOB = "workpiece: {path: path.csv}\n"
GRID = "config: job.yaml\ngrid:\n  - workpiece.rotation_z_rad: [0.1, 0.2]\n  - robot.tool_extension_m: [0.0, 0.01]\n"


def install(target: Path, points: dict[str, str], package: str, *modules: Path) -> Path:
    """Write into the folder `target` what an installer leaves of a package with entry points."""
    target.mkdir(exist_ok=True)
    for module in modules:
        shutil.copy(module, target)
    info = target / f"{package.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = "\n".join(f"{name} = {value}" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[{registry.METHODS.group}]\n{lines}\n")
    return target


class Place:
    """A working folder, and commands run in it by a Python with additional packages."""

    def __init__(self, folder: Path, *packages: Path):
        self.folder = folder
        (folder / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
        (folder / "job.yaml").write_text(JOB)
        (folder / "grid.yaml").write_text(GRID)
        self._environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (*packages, ROOT)))}

    def start(self, *words: str, before: str = "") -> subprocess.Popen:
        command = [sys.executable, "-c", before + HTCP, *words]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, cwd=self.folder, env=self._environment, stdout=pipe, stderr=pipe, text=True)

    def run(self, *words: str, before: str = "") -> tuple[int, str, str]:
        """Return the exit code, stdout and stderr."""
        process = self.start(*words, before=before)
        out, err = process.communicate()
        return process.returncode, out, err


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Place:
    folder = tmp_path_factory.mktemp("own")
    return Place(folder, page_package.install("docs/add-a-planner.md", folder / "page"))


@pytest.mark.slow
def test_it_is_listed_planned_checked_drawn_and_shown(place):
    code, out, err = place.run("methods", "--json")
    assert code == 0, err
    assert NAME in [row["method"] for row in json.loads(out)]
    assert place.run("plan", "job.yaml", "--method", NAME, "--out", "plan", "--json")[0] in (0, 3)
    code, out, err = place.run("validate", "plan", "--json")
    assert code == 0, err
    assert json.loads((place.folder / "plan" / "summary.json").read_text())["tracked"] > 5
    code, _, err = place.run("render", "plan", "--movie", "none", "--width", "320", "--out", "pictures")
    assert code == 0, err
    assert list((place.folder / "pictures").glob(f"*{NAME}*"))


@pytest.mark.slow
def test_the_files_of_its_plan_and_of_its_run_name_its_package(place):
    place.run("plan", "job.yaml", "--method", NAME, "--out", "packaged", "--set", "margin_m=0")
    written = json.loads((place.folder / "packaged" / "summary.json").read_text())["plugins"]
    assert list(written) == [f"method {NAME}"]
    assert place.run("sweep", "grid.yaml", "--methods", f"baseline,{NAME}", "--limit", "1", "--out", "one")[0] == 0
    made = {
        file.name.partition("-0")[0]: json.loads(pq.read_schema(file).metadata[b"htcp_jax"]).get("plugins")
        for file in (place.folder / "one" / "targets").glob("*.parquet")
    }
    assert made == {"baseline": None, NAME: written}


@pytest.mark.slow
def test_it_is_shown_in_the_browser(place):
    pytest.importorskip("viser", reason="the extra `view` is not installed")
    process = place.start("view", "job.yaml", "--method", NAME, "--port", "0")
    try:
        assert "viewer  http" in process.stdout.readline()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_it_sweeps_on_ray_as_it_does_here(place):
    pytest.importorskip("ray", reason="Ray is an extra")
    words = "sweep", "grid.yaml", "--methods", f"baseline,{NAME}", "--shard", "1"
    assert place.run(*words, "--out", "here")[0] == 0
    code, _, err = place.run(*words, "--out", "ray", "--on", "ray", before=TWO_WORKERS)
    assert code == 0, err
    here, ray = (
        {file.name: file.read_bytes() for file in (place.folder / out / "targets").glob("*.parquet")}
        for out in ("here", "ray")
    )
    assert here == ray and len(here) == 2 * 4
    code, _, err = place.run("validate", "ray")
    assert code == 0, err
    assert place.run("report", "ray", "--out", "report")[0] == 0
    assert "Random neighbours" in (place.folder / "report" / "report.html").read_text()
    # Without the package, its plans can still be viewed.
    assert htcp_jax.open_run(place.folder / "ray").plans(NAME).status.shape[0] == 4


@pytest.mark.slow
def test_what_cannot_be_imported_is_one_line_and_breaks_nothing_else(tmp_path):
    (tmp_path / "broken_planner.py").write_text("import no_such_module\n")
    points = {"broken": "broken_planner:PLANNER", "baseline": "broken_planner:OTHER"}
    place = Place(tmp_path, install(tmp_path / "packages", points, "broken-package", tmp_path / "broken_planner.py"))
    code, out, err = place.run("methods")
    assert code == 0 and "hybrid" in out
    line = "the method 'broken' (entry point broken_planner:PLANNER of package broken-package) cannot be imported"
    assert line in " ".join(err.split())
    assert "'baseline' (entry point broken_planner:OTHER of package broken-package) is ignored" in " ".join(err.split())
    code, _, err = place.run("plan", "job.yaml", "--method", "broken")
    assert code == 2 and line in err and "No module named 'no_such_module'" in err and "Traceback" not in err
    assert place.run("plan", "job.yaml", "--method", "baseline", "--out", "out")[0] == 0


# Registered in this process


class Standstill(htcp_jax.Method):
    """A planner that finds nothing."""

    name, title, description = "standstill", "Standstill", "nothing at all"

    def plan(self, problem: Problem) -> Plans:
        plans = problem.empty_plans()
        plans.status[:, 0] = Status.NO_SOLUTION
        return plans


class Forgetful(Standstill):
    """A planner that leaves a required column empty."""

    name = "forgetful"

    def plan(self, problem: Problem) -> Plans:
        plans = problem.empty_plans()
        plans.status[:, 0], plans.x[:, 0], plans.tcp[:, 0] = Status.TRACKED, problem.scenarios.x_start, 0.0
        return plans


class Silent(Standstill):
    """A planner that states no reason."""

    name = "silent"

    def plan(self, problem: Problem) -> Plans:
        return problem.empty_plans()


class Empty(Standstill):
    """A planner that returns nothing."""

    name = "empty"

    def plan(self, problem: Problem) -> None:
        return None


@pytest.fixture
def standstill():
    yield htcp_jax.register(Standstill())
    registry.METHODS._own.pop("standstill")


def test_a_method_of_this_process_plans_and_is_listed(standstill, tmp_path):
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n")
    job = {"workpiece": {"path": str(tmp_path / "path.csv")}}
    plan = htcp_jax.plan(job, method="standstill")
    assert plan.summary.tracked == 0 and np.isnan(plan.plans.x).all()
    assert "standstill" in htcp_jax.methods().index
    htcp_jax.register(standstill)  # again, as a notebook does
    with pytest.raises(InputError, match="method 'standstill' is registered only in this process"):
        htcp_jax.sweep({"grid": [{"margin_m": [0.0]}]}, "standstill", config=job, on="ray")


def test_a_name_in_use_is_refused_with_the_place_that_it_comes_from(standstill, monkeypatch):
    with pytest.raises(InputError, match=r"exists: <.*Standstill object at \w+>, registered in this process"):
        htcp_jax.register(Standstill())
    point = EntryPoint("theirs", "their_planner:PLANNER", registry.METHODS.group)
    monkeypatch.setitem(registry.METHODS._entry_points, "theirs", point)
    with pytest.raises(InputError, match="exists: the entry point their_planner:PLANNER of the installed package"):
        htcp_jax.register(StepQPs("theirs", "Mine", "the same name"))


CHANGING = """
import htcp_jax
from htcp_jax.status import Status

class Changing(htcp_jax.Method):
    name, title, description = "changing", "Changing", "tracks the start alone"

    def plan(self, problem):
        plans = problem.empty_plans()
        plans.status[:, 0], plans.x[:, 0], plans.tcp[:, 0] = Status.TRACKED, problem.scenarios.x_start, 0.0
        plans.clearance[:, 0], plans.residual[:, 0] = 0.0, 0.0
        return plans
"""


def test_a_run_is_not_continued_by_a_method_whose_code_has_changed(tmp_path, monkeypatch):
    """Resuming a sweep after an edit of the planner: refused, as its finished scenarios are of the old code."""
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n")
    (tmp_path / "changing_method.py").write_text(CHANGING)
    monkeypatch.syspath_prepend(tmp_path)
    job, grid = {"workpiece": {"path": str(tmp_path / "path.csv")}}, {"grid": [{"margin_m": [0.0]}]}
    method = htcp_jax.register(importlib.import_module("changing_method").Changing())
    try:
        first = htcp_jax.sweep(grid, "changing", config=job, out=tmp_path / "run")
        again = htcp_jax.sweep(grid, "changing", config=job, out=tmp_path / "run")
        assert first.manifest == again.manifest and list(first.manifest.code) == ["method changing"]
        (tmp_path / "changing_method.py").write_text(CHANGING + "# edited\n")
        with pytest.raises(InputError, match="the code of method changing has changed since"):
            htcp_jax.sweep(grid, "changing", config=job, out=tmp_path / "run")
        htcp_jax.sweep(grid, "baseline", config=job, out=tmp_path / "run")  # one that ships may be added
    finally:
        registry.METHODS._own.pop(method.name)


@pytest.mark.parametrize(
    ("method", "line"),
    [
        (StepQPs("baseline", "Mine", "the same name"), "'baseline': a method with this name exists: it is built in"),
        (StepQPs("My_planner", "Mine", "a name that no file has"), "lower-case letters, digits and hyphens"),
        (StepQPs("mine", "", "no title"), "its attribute title is missing"),
        (Standstill, "it must be an instance, not a class"),
        (object(), "its attribute name is missing"),
    ],
)
def test_what_is_no_method_is_not_registered(method, line):
    with pytest.raises(InputError, match=line):
        htcp_jax.register(method)


@pytest.mark.parametrize(
    ("method", "line"),
    [
        (Forgetful(), "method 'forgetful' returned NaN in clearance of a tracked target"),
        (Silent(), "method 'silent' did not set the status of target 0"),
        (Empty(), "method 'empty' must return Plans of 1 scenarios with 12 targets"),
    ],
)
def test_plans_with_an_empty_required_column_or_of_other_scenarios_are_refused(method, line, tmp_path):
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n")
    with pytest.raises(InputError, match=line):
        htcp_jax.plan({"workpiece": {"path": str(tmp_path / "path.csv")}}, method=method)


def test_nothing_is_imported_before_a_name_is_looked_up():
    """Imports for reading a configuration: no planner is loaded."""
    code = (
        "import sys, htcp_jax.spec.config, htcp_jax.planning.registry; "
        "own = tuple(f'htcp_jax.{package}.' for package in ('device', 'motion', 'planning')); "
        "loaded = [name for name in sys.modules if name.startswith(own)]; "
        "assert loaded == ['htcp_jax.planning.method', 'htcp_jax.planning.registry'], loaded"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})


# The page's method with a lane function, in this process


@pytest.fixture(scope="module")
def climber():
    """The page's module `my_climber`."""
    names = {"__name__": "my_climber"}
    exec(page_package.files("docs/add-a-planner.md")["my_climber.py"], names)
    return names


def test_a_lane_function_of_a_stranger_is_compiled_once_and_gives_each_scenario_its_plan_alone(climber):
    """Scenarios planned side by side and in two threads, and one by one: the same plans, from one executable."""
    method = climber["ClearNeighbours"]()
    together = toy.planned(method=method, threads=2)
    assert together.tracked.sum() > len(toy.scenarios()) and (together.clearance[together.tracked] > 0).all()
    before = len(EXECUTABLES)
    for s, one in enumerate(toy.scenarios()):
        toy.same(together, s, toy.planned(one, method, threads=1), 0, int(one.count))
    assert len(EXECUTABLES) == before


def test_a_lane_function_of_a_stranger_moves_away_from_the_obstacles(climber):
    problem = toy.problem(threads=1)
    checker, inputs = problem.checkers[0], problem.inputs(problem.to_plan, 0)
    x = problem.scenarios.x_start
    clearer = checker.states(inputs, checker.executor(climber["CLIMB"], inputs, x))
    assert (clearer.clearance > checker.states(inputs, x).clearance).any()
    assert (clearer.residual <= problem.task.tolerance_m).all()


def test_inputs_of_several_scenarios_follow_each_other():
    problem = toy.problem(threads=1)
    found = problem.inputs(np.array([3, 1]), np.array([2, 4]), 2)
    assert found.row.tolist() == [2, 2, 4, 4] and found.number.tolist() == [3, 3, 1, 1]
    np.testing.assert_array_equal(found.target[2], problem.scenarios.targets[1, 4])
