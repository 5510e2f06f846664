"""Shipped notebooks: each `.ipynb` has the cells of its `.py` and the outputs of one run; none is executed here."""

import ast
import importlib
import re
from pathlib import Path

import jupytext
import pytest
from documented import ROOT

SCRIPTS = sorted((ROOT / "notebooks").glob("[0-9]*.py"))
MAKE = "make notebooks NOTEBOOKS={}"


def cells(path: Path) -> list:
    return jupytext.read(path).cells


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_notebook_has_the_cells_of_its_script(script):
    notebook = script.with_suffix(".ipynb")
    assert notebook.exists(), MAKE.format(script.stem)
    assert [(cell.cell_type, cell.source) for cell in cells(notebook)] == [
        (cell.cell_type, cell.source) for cell in cells(script)
    ], MAKE.format(script.stem)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_all_cells_of_a_notebook_were_executed_in_order_and_show_a_result(script):
    code = [cell for cell in cells(script.with_suffix(".ipynb")) if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error" or output.get("name") == "stderr"]
    empty = [text for output in outputs if "Empty DataFrame" in (text := str(output.get("data", {}).get("text/plain")))]
    assert not empty  # regression: a cell displayed an empty frame below a text that relied on its rows


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_notebook_imports_only_public_names(script):
    for node in ast.walk(ast.parse(script.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("htcp_jax"):
            package = importlib.import_module(node.module)
            assert package.__file__.endswith("__init__.py"), f"{node.module} is a module; use a package's public names"
            assert {each.name for each in node.names} <= {*package.__all__}, node.module


def test_a_notebook_contains_no_path_of_the_machine_that_executed_it():
    for script in SCRIPTS:
        assert not re.search(r"/(home|tmp|root|work|Users)/", script.with_suffix(".ipynb").read_text()), script.stem


def test_all_notebooks_are_smaller_than_5_mb():
    assert sum(script.with_suffix(".ipynb").stat().st_size for script in SCRIPTS) < 5e6


def test_the_page_lists_every_notebook():
    page = (ROOT / "docs" / "notebooks.md").read_text()
    assert re.findall(r"^\| `(\d\d_\w+)` \|", page, re.M) == [script.stem for script in SCRIPTS]
