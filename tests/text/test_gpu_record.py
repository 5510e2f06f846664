"""The record of the GPU benchmark: README quotes it, it names its commit, and old ones are noticed."""

import shutil
import subprocess
import sys
from itertools import takewhile

import pytest
from changed import graph_of, reached

from benchmarks import gpu

RECORD = gpu.loaded(gpu.RECORD)
FACTS = {"device": "1 NVIDIA H200", "part": "generated duct", "scenarios": None, "here": "abc1234", "digest": "0"}


def run(cache, shell_s, planning_s, tracked):
    return {"cache": cache, "shell_s": shell_s, "planning_s": planning_s, "tracked": tracked}


@pytest.fixture
def record():
    """Record of a sweep, with two runs of each revision."""
    made = FACTS | {"sweeps": {}}
    for side, cache, shell_s, beam_s in (
        ("against", "empty", 400.0, 300.0),
        ("here", "empty", 80.0, 31.0),
        ("against", "full", 350.0, 340.0),
        ("here", "full", 50.0, 33.0),
    ):
        tracked = {"beam": 510_745 if side == "here" else 509_531}
        gpu._add(made, "beam unsmoothed", side, run(cache, shell_s, {"beam": beam_s}, tracked))
    return made


def test_a_record_has_ratios_of_planning_targets_and_complete_commands(record):
    assert record["sweeps"]["beam unsmoothed"]["ratios"] == {
        "planning": 0.1,
        "targets": 1.0024,
        "from the shell, empty cache": 0.2,
        "from the shell, full cache": 0.1429,
    }


def test_rows_name_device_part_and_commit(record):
    assert gpu.rows(record) == [
        "| 6,125 scenarios of 105 targets by `beam`, without smoothing | 32.0 s for 510,745 targets; "
        "50 s from the shell, full cache | 1 NVIDIA H200, workpiece generated duct, commit abc1234 |"
    ]


def test_trials_and_missing_records_have_no_rows(record):
    assert gpu.rows(record | {"device": "cpu"}) == gpu.rows(record | {"scenarios": 8}) == gpu.rows({}) == []
    record["sweeps"]["baseline,beam"] = record["sweeps"].pop("beam unsmoothed")  # not a complete sweep
    assert gpu.rows(record) == []


def test_rows_replace_those_of_an_older_record_and_leave_the_others(record):
    kept = "| work |\n|---|\n| both tables of the paper | 30 s |\n", "| last |\n"
    page = "| 6,125 scenarios | 1 s | old |\n| one H200 | x |\n".join(kept)
    new = gpu.with_rows(page, record)
    assert gpu.quoted(new) == gpu.rows(record) and gpu.with_rows(new, record) == new
    assert new == f"{gpu.rows(record)[0]}\n".join(kept)


def test_the_rows_of_readme_on_gpus_are_those_of_the_record():
    """If this fails: python -m benchmarks gpu --readme."""
    assert gpu.quoted(gpu.README.read_text(encoding="utf-8")) == gpu.rows(RECORD)


def test_the_record_describes_the_commit_that_it_names(tmp_path):
    named = RECORD.get("here", "").partition(" ")[0]  # "abc1234 and changes": the changes must not be of planning code
    if not gpu._git("rev-parse", "--verify", "--quiet", f"{named or 'no record'}^{{commit}}"):
        pytest.skip("no record, or this clone does not have its commit")
    gpu.unpacked(named, tmp_path)
    assert gpu.digest(tmp_path) == RECORD["digest"]


@pytest.fixture
def tree(tmp_path):
    shutil.copytree(gpu.ROOT / "htcp_jax", tmp_path / "htcp_jax", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_a_change_of_the_planning_code_is_noticed_and_one_of_other_code_is_not(tree, record, capsys):
    record["digest"] = gpu.digest(gpu.ROOT)
    (tree / "htcp_jax/report/new.py").touch()
    assert gpu.check(tree, record) == 0 and capsys.readouterr().out == ""
    (tree / "htcp_jax/planning/new.py").touch()
    assert gpu.check(tree, record) == 1
    assert "gpu.json describes abc1234, and the planning code has changed" in capsys.readouterr().out
    assert gpu.check(tree, {}) == 1 and "gpu.json does not exist" in capsys.readouterr().out


def test_the_planning_code_has_every_module_that_planning_imports_except_those_for_files_and_signals():
    of_package = takewhile(lambda item: item[0].startswith("htcp_jax"), graph_of(gpu.ROOT))
    modules = reached("htcp_jax.planning.batch", dict(of_package))
    names = [name.replace(".", "/") for name in modules if not name.startswith("htcp_jax.system")]
    files = [gpu.ROOT / f"{name}{end}" for name in names for end in (".py", "/__init__.py")]
    assert len(names) > 60 and {file for file in files if file.is_file()} <= {*gpu.planning_code(gpu.ROOT)}


def test_make_refuses_a_tag_that_is_not_the_version():
    installed = "-o", f"{sys.prefix}/.installed", f"VENV={sys.prefix}"  # make installs nothing
    command = "make", "-s", *installed, "release-check", "TAG=v9.9.9"
    done = subprocess.run(command, cwd=gpu.ROOT, capture_output=True, text=True)
    assert done.returncode and "TAG=v9.9.9 is not the version in pyproject.toml" in done.stdout
