"""Package metadata: the command, the version, the commit that runs record, and the imports of the core."""

import importlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import htcp_jax
from htcp_jax.runs.provenance import commit_of, installed_commit
from htcp_jax.viewer import offscreen

ROOT = Path(__file__).parents[1]
PACKAGE = Path(htcp_jax.__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_the_command_is_where_the_project_says():
    module, _, function = PROJECT["project"]["scripts"]["htcp"].partition(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_the_citation_and_the_newest_section_of_the_changes_name_the_version_of_the_project():
    version = PROJECT["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(r"^## \[(\d.*)\] - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert (version, citation["date-released"]) == released[0] and citation["version"] == version


@pytest.mark.parametrize("edited", ["planning/tracking/lanes.py", "model/robots/gp50.xml", "numerics.py"])
def test_a_run_records_whether_anything_of_the_package_was_edited(edited, tmp_path):
    copy = tmp_path / "htcp_jax"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "notes.txt").write_text("next to the package\n")
    _git(tmp_path, "init", "--quiet")
    _git(tmp_path, "add", "htcp_jax")
    _git(tmp_path, "-c", "user.name=n", "-c", "user.email=e", "commit", "--quiet", "--message", "all of it")
    clean = commit_of(copy)
    assert clean == _git(tmp_path, "rev-parse", "HEAD").strip()
    (copy / edited).write_text((copy / edited).read_text() + "\n")
    assert commit_of(copy) == f"{clean}+changes"


def test_a_run_of_a_package_that_pip_installed_from_a_repository_records_the_commit(tmp_path, monkeypatch):
    copy, info = tmp_path / "htcp_jax", tmp_path / "htcp_jax-9.dist-info"
    copy.mkdir()
    info.mkdir()
    (copy / "__init__.py").touch()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: htcp_jax\nVersion: 9\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert installed_commit("htcp_jax", copy / "__init__.py") is None
    direct = {"url": "https://host/htcp_jax", "vcs_info": {"vcs": "git", "commit_id": "0a901608"}}
    (info / "direct_url.json").write_text(json.dumps(direct))
    assert installed_commit("htcp_jax", copy / "__init__.py") == "0a901608"
    assert installed_commit("htcp_jax", PACKAGE / "__init__.py") is None  # runs from another folder


def test_the_image_installs_the_libraries_that_a_message_and_the_documentation_name_for_pictures():
    named = set(re.findall(r"lib(?:egl|opengl|gl)[\w-]+", offscreen.NEEDED))
    assert named == {"libegl1", "libopengl0", "libgl1-mesa-dri"}
    for file in "Dockerfile", "docs/installation.md":
        assert named <= set(re.findall(r"lib[\w-]+", (ROOT / file).read_text())), file


def test_the_core_imports_no_library_of_files_charts_tables_or_simulation():
    core = "model", "solvers", "clearance", "device", "motion", "planning", "reachability", "sequencing"
    names = [".".join(("htcp_jax", *file.relative_to(PACKAGE).with_suffix("").parts)) for file in PACKAGE.rglob("*.py")]
    imports = "\n".join(f"import {name}" for name in sorted(names) if name.split(".")[1] in core)
    assert imports.count("\n") > 90
    loaded = "{name.partition('.')[0] for name in sys.modules}"
    script = f"import sys\n{imports}\nprint({loaded} & {{'yaml', 'pyarrow', 'matplotlib', 'rich', 'mujoco'}})"
    found = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout
    assert found == "set()\n"


@pytest.mark.parametrize(
    "words",
    [
        ["--set", "nokey=3"],
        ["--set", "margin_m=wide"],
        ["--set", "robot.model=no-such-file.xml", "--set", "start_rad=none"],
        ["--set", "task=[{point: tcp, on: nowhere}]"],
        ["--set", "cell.obstacles=[{kind: none-of-them}]"],
        ["--method", "none-of-them"],
        ["no-such-file.yaml"],
    ],
)
def test_a_bad_job_is_refused_before_jax_and_scipy_are_imported(words):
    script = (
        f"import sys; from htcp_jax.cli.main import main; code = main(['plan', *{words}]); "
        "print(code, {'jax', 'scipy', 'pandas', 'mujoco', 'matplotlib'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert found.stdout == "2 set()\n" and found.stderr.count("\n") == 1


def test_the_help_of_the_gate_does_not_import_jax():
    script = (
        "import sys; from htcp_jax.cli.main import main; code = main(['gate', '--help']); "
        "print(code, {'jax', 'scipy', 'pandas', 'mujoco', 'matplotlib'} & set(sys.modules))"
    )
    found = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert found.stdout.splitlines()[-1] == "0 set()"


def _git(folder: Path, *words: str) -> str:
    return subprocess.run(["git", "-C", str(folder), *words], check=True, capture_output=True, text=True).stdout
