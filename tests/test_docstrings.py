"""Every public name says what it takes and gives: shapes, units, errors and, of mathematics, the source.

What is public and what is complete is defined in `benchmarks.docstrings`. Here every such name is held to it, and the
rule itself is held to hand-made docstrings that lack one thing each.
"""

import inspect
from pathlib import Path

import pytest

import htcp_jax
from benchmarks.docstrings import incomplete, public

ROOT = Path(__file__).parents[1]

PUBLIC = public(ROOT)
LACKING = incomplete(ROOT)


@pytest.mark.parametrize("name", LACKING)
def test_public_docstrings_are_complete(name):
    assert not LACKING[name], f"{name}: {'; '.join(LACKING[name])}"


def test_what_all_names_and_what_the_pages_show_is_public():
    own = {name.rpartition(".")[2] for name in PUBLIC}
    modules = {name for name in htcp_jax.__all__ if inspect.ismodule(getattr(htcp_jax, name))}
    assert modules == {"charts", "clearance"} and set(htcp_jax.__all__) - modules <= own
    assert {"scene.scenario.Scenario", "solvers.sphere.sqp", "runs.run_folder.open_run"} <= PUBLIC.keys()
    assert PUBLIC["solvers.sphere.sqp"].is_mathematics and not PUBLIC["runs.run_folder.open_run"].is_mathematics


@pytest.mark.parametrize(
    ("source", "lacks"),
    [
        ("def f(length_m: float) -> int:\n    '''The count.'''", []),
        ("def f(length: float) -> int:\n    '''The count.'''", ["length has no unit"]),
        ("def f(length: float) -> int:\n    '''The count of a length [m].'''", []),
        ("def f(x: Joints) -> Pose:\n    '''The pose.'''", []),
        ("def f(x: Joints) -> Pose:\n    pass", ["no docstring"]),
        ("def f(n: np.ndarray) -> None:\n    '''Of n.'''", ["n has no shape"]),
        ("def f(n: np.ndarray) -> None:\n    '''Of n (S,).'''", []),
        ("def f() -> Float[Array, 'N']:\n    '''A number.'''", ["return has no unit"]),
        ("def f():\n    '''Says no.'''\n    raise InputError", ["raises InputError and does not say so"]),
        (
            "def f():\n    '''Says no.'''\n    _g()\ndef _g():\n    raise InputError",
            ["raises InputError and does not say so"],
        ),
        ("def f():\n    '''Says no. Raises InputError.'''\n    raise InputError", []),
        ("class f:\n    '''Of one field.'''\n    x: float", ["x has no unit"]),
        ("class f:\n    '''Of one field.'''\n    x: float  # [m]", []),
    ],
)
def test_a_docstring_that_lacks_something_is_found(source, lacks, tmp_path):
    (tmp_path / "htcp_jax").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "htcp_jax/__init__.py").write_text('_HOME = {"f": "made"}\n')
    (tmp_path / "htcp_jax/made.py").write_text(source + "\n")
    assert incomplete(tmp_path) == {"made.f": lacks}


@pytest.mark.parametrize("told", ["The tool.", "The tool, equation (7)."])
def test_mathematics_names_its_source(told, tmp_path):
    (tmp_path / "htcp_jax").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/equations.md").write_text("::: htcp_jax.made.f\n")
    (tmp_path / "htcp_jax/__init__.py").write_text("")
    (tmp_path / "htcp_jax/made.py").write_text(f'def f(x: Joints) -> Pose:\n    """{told}"""\n')
    assert incomplete(tmp_path) == {"made.f": [] if "equation" in told else ["names no source"]}
