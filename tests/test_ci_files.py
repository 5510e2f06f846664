"""GitHub Actions workflows, ours and the documented one: every command and target that they call exists."""

import re
import shlex
import shutil
import subprocess
import tomllib

import page_package
import pytest
import yaml
from documented import ROOT

from htcp_jax.cli import main

WORKFLOW, NIGHTLY = ((ROOT / ".github" / "workflows" / name).read_text() for name in ("ci.yml", "nightly.yml"))
DOCUMENTED = re.search(r"^```yaml\n(name: gate\n.*?)^```$", (ROOT / "docs" / "gate.md").read_text(), re.M | re.S)[1]
BASELINE = re.findall(r"^\$ (.*)$", (ROOT / "docs" / "gate.md").read_text(), re.M)  # commands that write the baseline


def commands(workflow: str) -> list[str]:
    """Command lines of all steps; those of a matrix once per target."""
    found = []
    for job in yaml.safe_load(workflow)["jobs"].values():
        for target in job.get("strategy", {}).get("matrix", {}).get("target", [""]):
            lines = [line for step in job["steps"] for line in step.get("run", "").splitlines()]
            found += [line.replace("${{ matrix.target }}", target) for line in lines]
    return found


def targets(lines: list[str]) -> list[str]:
    return [words[1] for words in map(str.split, lines) if words[:1] == ["make"]]


@pytest.mark.parametrize("target", targets(commands(WORKFLOW) + commands(NIGHTLY)))
def test_every_make_target_of_the_workflows_is_in_the_makefile(target):
    known = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True)
    assert known.returncode == 0, known.stderr


def test_the_workflow_calls_every_make_target_of_ci_run():
    called = targets((ROOT / ".ci" / "run").read_text().splitlines())
    assert set(called) - {"install"} <= set(targets(commands(WORKFLOW)))  # each target installs what it needs


def test_the_documented_workflow_is_short_and_its_commands_have_these_options():
    assert len(DOCUMENTED.splitlines()) <= 30
    lines = [line for line in commands(DOCUMENTED) if line.startswith("htcp ")]
    assert [line.split()[1] for line in lines] == ["sweep", "gate"]
    assert all(main([*shlex.split(line)[1:], "--help"]) == 0 for line in lines)


def test_the_documented_workflow_installs_this_version_by_its_tag_with_the_own_package():
    """No package index has htcp_jax, so that a name alone cannot be installed."""
    (installed,) = (shlex.split(line) for line in commands(DOCUMENTED) if line.startswith("pip "))
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert installed[:2] == ["pip", "install"] and installed[3:] == ["."]
    assert re.fullmatch(rf"git\+https://\S+/htcp_jax@v{re.escape(version)}", installed[2])
    assert shlex.join(installed) in map(shlex.join, map(shlex.split, BASELINE)), "the baseline is of other code"


@pytest.mark.slow
def test_the_documented_workflow_passes_with_an_own_planner_and_fails_when_it_loses_targets(tmp_path):
    place = page_package.Place("docs/add-a-planner.md", tmp_path)
    summary = tmp_path / "summary.md"
    place.environment["GITHUB_ACTIONS"] = "true"

    def run(line: str) -> int:
        return place.htcp(*shlex.split(line.replace("$GITHUB_STEP_SUMMARY", str(summary)))[1:])[0]

    assert [run(line) for line in BASELINE if line.startswith("htcp ")] == [0, 0]
    sweep, gate = (line for line in commands(DOCUMENTED) if line.startswith("htcp "))
    shutil.rmtree(place.folder / "out")
    assert (run(sweep), run(gate)) == (0, 0) and (place.folder / "out" / "gate.xml").exists()
    planner = tmp_path / "packages" / "my_planner.py"
    planner.write_text(planner.read_text().replace("MANY, SPREAD_RAD = 64", "MANY, SPREAD_RAD = 2"))
    shutil.rmtree(place.folder / "out")
    assert (run(sweep), run(gate)) == (0, 1)
    assert "random-neighbours | FAILED" in summary.read_text()
