"""`make test-changed` runs the tests that a change can break, in hand-made checkouts and in this one."""

import subprocess
import sys
from pathlib import Path

import pytest
from changed import files_to_test, graph_of, reached

ROOT = Path(__file__).parents[2]
CHECKOUT = {
    "htcp_jax/__init__.pyi": "from .api import plan\n",
    "htcp_jax/api.py": "def plan():\n    from htcp_jax.model import arm\n",
    "htcp_jax/model/__init__.pyi": "from . import arm\n",
    "htcp_jax/model/arm.py": "from htcp_jax import errors\n",
    "htcp_jax/errors.py": "",
    "htcp_jax/report/table.py": "",
    "htcp_jax/report/registry.py": 'NAME = "htcp_jax.report.table"\n',
    "htcp_jax/cli/main.py": "",
    "htcp_jax/cli/report.py": "from htcp_jax.report import table\n",
    "htcp_jax/cli/plan.py": "from htcp_jax.api import plan\n",
    "tests/conftest.py": "def planned():\n    from helper import run\n",
    "tests/helper.py": "from htcp_jax.report.table import rows\n",
    "tests/test_arm.py": "from htcp_jax.model import arm\n",
    "tests/test_api.py": "import htcp_jax\nhtcp_jax.plan()\n",
    "tests/test_helper.py": "import helper\n",
    "tests/test_fixture.py": "def test_rows(planned): ...\n",
    "tests/test_registry.py": "from htcp_jax.report import registry\n",
    "tests/test_command.py": 'from htcp_jax.cli import main\nmain(["plan"])\n',
    "tests/test_pages.py": 'from htcp_jax.cli import main\nPAGES = "docs"\n',
}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    root = tmp_path_factory.mktemp("checkout")
    for name, text in CHECKOUT.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


@pytest.mark.parametrize(
    ("changed", "tests"),
    [
        ("htcp_jax/errors.py", "api arm command pages"),  # through modules, and public names of packages
        ("htcp_jax/report/table.py", "fixture helper pages registry"),  # a helper, a fixture, a name in a string
        ("htcp_jax/cli/plan.py", "command pages"),  # the command whose name occurs, or any
        ("tests/helper.py", "fixture helper"),
        ("tests/test_arm.py", "arm"),
        ("docs/page.md", "pages"),
        ("benchmarks/speed.py", ""),
        ("CHANGELOG.md", ""),
    ],
)
def test_a_change_concerns_the_tests_whose_imports_reach_it(checkout, changed, tests):
    assert files_to_test(checkout, [changed]) == [f"tests/test_{name}.py" for name in tests.split()]


@pytest.mark.parametrize("changed", ["pyproject.toml", "tests/conftest.py", "tests/data/table.npz", "Makefile", "new"])
def test_a_change_of_what_any_test_may_use_concerns_all_tests(checkout, changed):
    assert len(files_to_test(checkout, ["tests/test_arm.py", changed])) == sum("/test_" in name for name in CHECKOUT)


def test_every_module_that_a_test_file_imports_concerns_it():
    code = "import sys, test_timed_run; print(*(name for name in sys.modules if name.startswith('htcp_jax.')))"
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT / "tests", capture_output=True, text=True, check=True)
    graph = dict(graph_of(ROOT))
    imported = graph.keys() & set(found.stdout.split())
    assert len(imported) > 20 and imported <= reached("tests/test_timed_run.py", graph)
