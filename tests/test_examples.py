"""`htcp example` lists and copies each example with its files, and its name works in place of its file."""

import json
from pathlib import Path

import pytest
import yaml

from htcp_jax.cli import main
from htcp_jax.jobs import load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.placement.place_file import Search, load_search
from htcp_jax.spec.config import PlanConfig
from htcp_jax.spec.config_file import named_files
from htcp_jax.spec.examples import ROOT, command, description, examples

LOAD = {"htcp plan": load_config, "htcp sweep": load_sweep, "htcp place": load_search}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_yaml_file_that_ships_is_an_example_or_a_baseline_of_one():
    shipped = {file for folder in ("configs", "sweeps") for file in (ROOT / folder).rglob("*.yaml")}
    known = set(examples().values())
    sweeps = {yaml.safe_load(file.read_text())["sweep"] for file in shipped - known}
    assert {f"sweeps/{name}" for name in sweeps} < set(examples())
    assert {"pipe", "place/duct", "sweeps/cone"} < set(examples())


def test_the_list_has_the_first_sentence_of_every_example(capsys):
    assert main(["example", "--json"]) == 0
    rows = {row["name"]: row["description"] for row in json.loads(capsys.readouterr().out)}
    assert rows == {name: description(file) for name, file in examples().items()}
    assert rows["sweeps/robot"] == "The paper's first sweep: 125 starts"


@pytest.mark.parametrize("name", examples())
def test_an_example_is_written_with_all_that_it_refers_to(here, capsys, name):
    (here / "empty").mkdir()
    assert main(["example", name, "empty", "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert {*written["files"]} == {str(file) for file in Path("empty").rglob("*") if file.is_file()}
    loaded = LOAD[command(name)](written["file"])  # refuses a file that refers to a missing one
    job = loaded if isinstance(loaded, PlanConfig) else loaded.job if isinstance(loaded, Search) else loaded.config
    for key, section, word in named_files(job.model_dump()):
        assert Path(section[word]).is_relative_to("empty") and Path(section[word]).is_file(), key


def test_a_gated_sweep_comes_with_its_baseline(here):
    assert main(["example", "sweeps/workpiece", "new"]) == 0
    name = "sweeps/baselines/workpiece.yaml"
    assert (here / "new" / name).read_bytes() == (ROOT / name).read_bytes()


def test_a_file_comes_before_the_example_of_its_name(here):
    (here / "cone").write_text("margin_m: 0.002\n")
    assert load_config("cone").margin_m == 0.002


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["pip", "new"], "unknown example 'pip'; valid: cone, duct, palletizer, paper, pipe, place/duct, "),
        (["pipe"], "the output folder is missing: pass htcp example pipe DIR"),
        (["pipe", "."], ". is not empty; name a new or an empty folder"),
        (["pipe", "file"], "cannot write to file"),
    ],
)
def test_a_wrong_example_or_folder_is_one_line_and_nothing_is_written(here, capsys, words, line):
    (here / "file").write_text("")
    assert main(["example", *words]) == 2
    output = capsys.readouterr()
    assert output.err.startswith(f"htcp: {line}") and output.err.count("\n") == 1 and output.out == ""
    assert [file.name for file in here.iterdir()] == ["file"]
