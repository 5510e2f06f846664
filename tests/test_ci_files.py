"""GitHub Actions workflows, ours and the documented one: every command and target that they call exists."""

import re
import shlex
import subprocess

import pytest
import yaml
from documented import ROOT

from htcp_jax.cli import main

WORKFLOW, NIGHTLY = ((ROOT / ".github" / "workflows" / name).read_text() for name in ("ci.yml", "nightly.yml"))
DOCUMENTED = re.search(r"^```yaml\n(name: gate\n.*?)^```$", (ROOT / "docs" / "gate.md").read_text(), re.M | re.S)[1]


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
