"""Style checks of `lint`: they find each kind of fault in hand-made packages and cover the public names here."""

from pathlib import Path

import pytest
from lint import faults, public

import htcp_jax


@pytest.fixture
def package(tmp_path):
    """Checkout with `made.f` as public name, but without the module."""
    (tmp_path / "htcp_jax").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "htcp_jax/__init__.py").write_text('_HOME = {"f": "made"}\n')
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
        "from htcp_jax.motion import Plans\nfrom htcp_jax.jobs.build import arm_of\nfrom htcp_jax.validation.b import c"
    )
    assert not faults(package)
    (package / "htcp_jax/validation/a.py").write_text(line)
    assert ["which is not in TO_VALIDATION" in fault for fault in faults(package)] == [True]


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
        ("def g(x: Joints) -> Pose:\n    pass", "is not where a page or `__all__` says"),
        ("def f(n: np.ndarray) -> None:\n    '''Of n.'''", "n has no shape"),
        ("def f(n: np.ndarray) -> None:\n    '''Of n (S,).'''", ""),
        ("def f() -> Float[Array, 'N']:\n    '''A number.'''", "return has no unit"),
        ("def f():\n    '''Says no.'''\n    raise InputError", "raises InputError and does not say so"),
        (
            "def f():\n    '''Says no.'''\n    _g()\ndef _g():\n    raise InputError",
            "raises InputError and does not say so",
        ),
        ("def f():\n    '''Says no. Raises InputError.'''\n    raise InputError", ""),
        ("class f:\n    '''Of one field.'''\n    x: float", "x has no unit"),
        ("class f:\n    '''Of one field.'''\n    x: float  # [m]", ""),
    ],
)
def test_a_public_name_that_lacks_something_is_found(package, source, lacks):
    (package / "htcp_jax/made.py").write_text(source + "\n")
    assert faults(package) == ([f"made.f: {lacks}"] if lacks else [])


@pytest.mark.parametrize("text", ["The tool.", "The tool, equation (7)."])
def test_mathematics_names_its_source(package, text):
    (package / "docs/equations.md").write_text("::: htcp_jax.made.f\n")
    (package / "htcp_jax/made.py").write_text(f'def f(x: Joints) -> Pose:\n    """{text}"""\n')
    assert faults(package) == ([] if "equation" in text else ["made.f: names no source"])


def test_what_all_names_and_what_the_pages_show_is_public():
    found = public(Path(__file__).parents[1])
    assert set(htcp_jax.__all__) - {"charts", "clearance"} <= {name.rpartition(".")[2] for name in found}
    assert {"model.scenario.Scenario", "solvers.sphere.sqp", "runs.run_folder.open_run"} <= found.keys()
    assert found["solvers.sphere.sqp"].is_mathematics and not found["runs.run_folder.open_run"].is_mathematics
