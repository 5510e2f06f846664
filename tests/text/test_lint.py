"""Checks of `make lint`: they find each kind of fault in hand-made packages and cover the public names here."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from lint import faults, public

import htcp_jax


@pytest.fixture
def package(tmp_path):
    """Checkout with `made.f` as public name, but without the module."""
    (tmp_path / "htcp_jax").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "htcp_jax/__init__.pyi").write_text("from .made import f\n")
    return tmp_path


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (
            ["model/a.py: from htcp_jax.planning.b import f", "planning/b.py:"],
            "model.a imports planning.b, which lies above",
        ),
        (
            ["model/a.py: def f(): import htcp_jax.planning.b", "planning/b.py:"],
            "model.a imports planning.b",
        ),
        (["types.py: from htcp_jax.model import a", "model/a.py:"], "types imports model.a, which lies above it"),
        (
            ["model/a.py: from htcp_jax.model import b", "model/b.py: import htcp_jax.model.a"],
            "imports run in a circle",
        ),
        (
            ["model/a.py: import_module('htcp_jax.model.b')", "model/b.py: from htcp_jax.model import a"],
            "imports run in a circle",
        ),
        (["odd/a.py:"], "odd: no package in PACKAGES"),
    ],
)
def test_an_import_that_runs_the_wrong_way_is_found(package, files, message):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    assert not faults(package)
    for file in files:
        name, _, text = file.partition(":")
        (package / "htcp_jax" / name).parent.mkdir(exist_ok=True)
        (package / "htcp_jax" / name).write_text(text.strip() + "\n")
    assert [message in fault for fault in faults(package)] == [True]


@pytest.mark.parametrize(
    "line",
    [
        "from htcp_jax.clearance.obstacles.tip_guard import make_tip_guard",
        "from htcp_jax.clearance import make_tip_guard",
        "from htcp_jax.model import kinematics",
        "from htcp_jax.model.kinematics import tcp_pose",
        "import htcp_jax.numerics",
        "from htcp_jax import numerics",
        "def f(): from htcp_jax.motion.motion_check import check",
    ],
)
def test_validation_that_imports_the_planners_mathematics_is_found(package, line):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    (package / "htcp_jax/validation").mkdir()
    (package / "htcp_jax/validation/a.py").write_text(
        "from htcp_jax.motion import Plans\nfrom htcp_jax.jobs.build import robot_key\n"
        "from htcp_jax.validation.b import c"
    )
    assert not faults(package)
    (package / "htcp_jax/validation/a.py").write_text(line)
    assert ["which is not in TO_VALIDATION" in fault for fault in faults(package)] == [True]


@pytest.mark.parametrize(
    ("source", "refused"),
    [
        ("from htcp_jax.system import files\nfiles.read_json('a')", []),
        ("from htcp_jax.system import files as io_files\nio_files.read_json('a')", []),
        ("from htcp_jax.model import robot\nrobot.TOUCHING_M", []),
        ("from htcp_jax.model import robot\nrobot.TOUCHING_M, robot.lengthen_tool", ["lengthen_tool of model"]),
        ("from htcp_jax.model import robot as r\ndef f(): return r.kinematics.tcp_pose", ["kinematics of model"]),
        ("from htcp_jax.model import robot\nf(robot, robot.TOUCHING_M)", ["robot of model"]),
        ("from htcp_jax.model import robot", ["robot of model"]),
    ],
)
def test_of_a_module_validation_uses_only_the_names_that_are_listed(package, source, refused):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    for folder, module in (("system", "files"), ("model", "robot"), ("validation", "a")):
        (package / "htcp_jax" / folder).mkdir()
        (package / "htcp_jax" / folder / f"{module}.py").write_text("")
        (package / "htcp_jax" / folder / "__init__.pyi").write_text(f"from . import {module}\n")
    (package / "htcp_jax/validation/a.py").write_text(source)
    found = [fault for fault in faults(package) if "TO_VALIDATION" in fault]
    assert found == [f"validation.a imports {name}, which is not in TO_VALIDATION" for name in refused]


NAMES = "a = b = c = 0\nD: int = 1\nclass E: ...\n"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("from htcp_jax.model import x\nfrom htcp_jax.model import a", ""),
        ("from htcp_jax.solvers.deep import anything", ""),
        ("from htcp_jax.model.x import a", "solvers.y imports a of model.x, which is not public there"),
        ("def f():\n    from htcp_jax.model.x import a", "solvers.y imports a of model.x, which is not public there"),
        ("from htcp_jax.model import other", "solvers.y imports other of model, which is not public there"),
        ("import htcp_jax.model.x", "solvers.y imports all of model.x, which is not public there"),
    ],
)
def test_an_import_across_packages_takes_public_names(package, line, message):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    (package / "htcp_jax/solvers").mkdir()
    (package / "htcp_jax/solvers/y.py").write_text(line)
    (package / "htcp_jax/model").mkdir()
    (package / "htcp_jax/model/x.py").write_text(NAMES)
    (package / "htcp_jax/model/__init__.pyi").write_text("from . import x\nfrom .x import D, E, a, b\n")
    assert faults(package) == ([message] if message else [])


@pytest.mark.parametrize(
    ("stub", "message"),
    [
        ("from . import x\nfrom .x import D, E, a, b", ""),
        ("from . import x\nfrom .x import E, F, a, b, c", "solvers: solvers.x.F does not exist, but F is public"),
        ("from . import y\nfrom .x import D, E, a, b, c", "solvers: solvers.y does not exist, but y is public"),
        ("from .x import D, E, a, b", "solvers: 4 public names; 5 to 15 are allowed, or a reason in SIZES"),
    ],
)
def test_public_names_exist_and_are_not_too_many(package, stub, message):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    (package / "htcp_jax/solvers").mkdir()
    (package / "htcp_jax/solvers/__init__.py").write_text("")
    (package / "htcp_jax/solvers/x.py").write_text(NAMES)
    assert faults(package) == ["solvers: no __init__.pyi with its public names"]
    (package / "htcp_jax/solvers/__init__.pyi").write_text(stub + "\n")
    assert faults(package) == ([message] if message else [])


@pytest.mark.parametrize(
    ("folder", "line"),
    [
        ("motion", "import yaml"),
        ("motion", "def f():\n    from matplotlib.figure import Figure"),
        ("motion", "import rich.text"),
        ("spec", "def f():\n    import jax.numpy as jnp"),
        ("system", "import numpy as np"),
    ],
)
def test_a_library_that_a_package_must_not_import_is_found(package, folder, line):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    for name in (folder, "viewer"):
        (package / "htcp_jax" / name).mkdir()
        (package / "htcp_jax" / name / "a.py").write_text(line)
    assert [fault.startswith(f"{folder}.a imports ") for fault in faults(package)] == [True]


@pytest.mark.parametrize(
    "call",
    ["open('a')", "a.read_text()", "a.write_bytes(b'')", "np.load('a')", "pq.read_table('a')", "a.open('w')"],
)
def test_a_file_opened_by_other_means_than_the_one_reader_is_found(package, call):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    (package / "htcp_jax/runs").mkdir()
    (package / "htcp_jax/runs/a.py").write_text(f"def g(a):\n    return {call}\n")
    assert [fault.startswith("runs.a, line 2: ") for fault in faults(package)] == [True]


@pytest.mark.parametrize(
    ("source", "lacks"),
    [
        ("def f(length_m: float) -> int:\n    '''The count.'''", ""),
        ("def f(length: float) -> int:\n    '''The count.'''", "length has no unit"),
        ("def f(length: float) -> int:\n    '''The count of a length [m].'''", ""),
        ("def f(length) -> int:\n    '''The count of a length [m].'''", "length has no type"),
        ("def f(x: Joints) -> Pose:\n    '''The pose.'''", ""),
        ("def f(x: Joints) -> Pose:\n    pass", "no docstring"),
        ("def f(n: np.ndarray) -> None:\n    '''Of n.'''", "n has no shape"),
        ("def f(n: np.ndarray) -> None:\n    '''Of n (S,).'''", ""),
        ("def f() -> Float[Array, 'N']:\n    '''A number.'''", "return has no unit"),
        ("def f():\n    '''Says no.'''\n    raise InputError", "raises InputError without mentioning it"),
        (
            "def f():\n    '''Says no.'''\n    _g()\ndef _g():\n    raise InputError",
            "raises InputError without mentioning it",
        ),
        ("def f():\n    '''Says no. Raises InputError.'''\n    raise InputError", ""),
        ("class f:\n    '''Of one field.'''\n    x: float", "x has no unit"),
        ("class f:\n    '''Of one field.'''\n    x: float  # [m]", ""),
    ],
)
def test_a_public_name_that_lacks_something_is_found(package, source, lacks):
    (package / "htcp_jax/made.py").write_text(source + "\n")
    assert faults(package) == ([f"made.f: {lacks}"] if lacks else [])


def test_a_name_that_a_page_shows_exists(package):
    (package / "htcp_jax/made.py").write_text('def f():\n    """Nothing."""\n')
    (package / "docs/page.md").write_text("::: htcp_jax.made.g\n")
    assert faults(package) == ["made.g: is not where a page or a stub refers to"]


@pytest.mark.parametrize("text", ["The tool.", "The tool, equation (7)."])
def test_mathematics_names_its_source(package, text):
    (package / "docs/equations.md").write_text("::: htcp_jax.made.f\n")
    (package / "htcp_jax/made.py").write_text(f'def f(x: Joints) -> Pose:\n    """{text}"""\n')
    assert faults(package) == ([] if "equation" in text else ["made.f: names no source"])


def test_what_all_names_and_what_the_pages_show_is_public():
    found = public(Path(__file__).parents[2])
    assert set(htcp_jax.__all__) - {"charts", "clearance"} <= {name.rpartition(".")[2] for name in found}
    assert {"model.scenario.Scenario", "solvers.sphere.sqp", "runs.run_folder.open_run"} <= found.keys()
    assert found["solvers.sphere.sqp"].is_mathematics and not found["runs.run_folder.open_run"].is_mathematics


CALLS = {  # a call of the public interface -> the checker's code of its fault
    'htcp_jax.plan("job.yaml", {"margin_m": 0.001}, method="beam").complete': "",
    'htcp_jax.sweep("sweeps/workpiece", "baseline,hybrid").frame()': "",
    "htcp_jax.plan(method=3)": "arg-type",
    'htcp_jax.plan(metod="beam")': "call-arg",
    "htcp_jax.plan().completed": "attr-defined",
    "htcp_jax.lengthen_tools": "attr-defined",
    "htcp_jax.load_robot(0.1)": "arg-type",
    "htcp_jax.plan(obstacles=[htcp_jax.PointCloud])": "list-item",
}


def test_a_wrong_call_of_the_public_interface_is_found_by_the_type_checker(tmp_path):
    (tmp_path / "calls.py").write_text("\n".join(["import htcp_jax", *CALLS, ""]))
    command = [sys.executable, "-m", "mypy", "--no-pretty", "--no-error-summary", tmp_path / "calls.py"]
    result = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    found = {int(line): code for line, code in re.findall(r"^\S+:(\d+): error: .*\[(\S+)\]$", result.stdout, re.M)}
    expected = {line: code for line, code in enumerate(CALLS.values(), start=2) if code}
    assert found == expected, result.stdout + result.stderr
