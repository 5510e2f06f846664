"""What stands around the modules: files that are installed with them, the command, and the commit that runs record."""

import importlib
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

import htcp_jax
from htcp_jax.runs import provenance

ROOT = Path(__file__).parents[1]
PACKAGE = Path(htcp_jax.__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_command_is_where_the_project_says():
    module, _, function = PROJECT["project"]["scripts"]["htcp"].partition(":")
    assert callable(getattr(importlib.import_module(module), function))


@pytest.mark.parametrize("edited", ["planning/tracking/lanes.py", "model/robots/gp50.xml", "numerics.py"])
def test_a_run_records_whether_anything_of_the_package_was_edited(edited, tmp_path, monkeypatch):
    copy = tmp_path / "htcp_jax"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "notes.txt").write_text("beside the package\n")
    _git(tmp_path, "init", "--quiet")
    _git(tmp_path, "add", "htcp_jax")
    _git(tmp_path, "-c", "user.name=n", "-c", "user.email=e", "commit", "--quiet", "--message", "all of it")
    monkeypatch.setattr(htcp_jax, "__file__", str(copy / "__init__.py"))
    commit = provenance.commit.__wrapped__  # without its memory
    clean = commit()
    assert clean == _git(tmp_path, "rev-parse", "HEAD").strip()
    (copy / edited).write_text((copy / edited).read_text() + "\n")
    assert commit() == f"{clean}+changes"


def _git(folder: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(folder), *words], check=True, capture_output=True, text=True).stdout
