"""Protects the JSON schemas of the documentation: output has the values that they list, and no others."""

import json
from pathlib import Path

import jsonschema
import pytest
import toy
import trimesh

from htcp_jax.cli import main

SCHEMAS = Path(__file__).parents[1] / "docs" / "schemas"
INTO_THE_WALL = "0.1857,-0.1737,0.1708\n0.1857,-0.25,0.1708\n"
SHORT = "0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n"


def strict(schema: dict) -> dict:
    """The schema without room for values that it does not list."""
    made = dict(schema)
    if "properties" in schema:
        made |= {"additionalProperties": False}
        made["properties"] = {key: strict(each) for key, each in schema["properties"].items()}
    elif isinstance(schema.get("additionalProperties"), dict):
        made["additionalProperties"] = strict(schema["additionalProperties"])
    return made | ({"items": strict(schema["items"])} if "items" in schema else {})


def fits(name: str, record: dict) -> None:
    schema = json.loads((SCHEMAS / f"{name}-1.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(record, strict(schema))


@pytest.fixture
def printed(capsys):
    """Function that runs a command with --json and returns what it prints."""

    def run(*words) -> dict:
        main([*map(str, words), "--json"])
        return json.loads(capsys.readouterr().out)

    return run


@pytest.fixture(scope="module")
def plans(tmp_path_factory):
    """A folder with a complete plan, one that fails, and one that cannot begin."""
    folder = tmp_path_factory.mktemp("plans")
    (folder / "short.csv").write_text(SHORT)
    (folder / "wall.csv").write_text(INTO_THE_WALL)
    for name, path, method in (("good", "short", "beam"), ("bad", "wall", "baseline")):
        words = ["--set", f"workpiece.path={folder / path}.csv", "--method", method, "--out", str(folder / name)]
        main(["plan", *words])
    return folder


@pytest.mark.parametrize("name", ["good", "bad"])
def test_a_plan_s_summary_fits(plans, name):
    fits("plan", json.loads((plans / name / "summary.json").read_text()))


def test_a_program_and_the_check_of_its_plan_fit(plans, printed, tmp_path):
    made = printed("program", plans / "good", "--feed", "20mm/s", "--out", tmp_path / "weld.csv")
    assert made["feed_drops"]
    fits("program", made)
    fits("validation", printed("validate", plans / "good", "--between", 0))


def test_a_sweep_its_times_its_check_and_its_gate_fit(plans, printed, tmp_path):
    run, baseline, grid = tmp_path / "run", tmp_path / "baseline.yaml", tmp_path / "grid.yaml"
    (tmp_path / "job.yaml").write_text(f"workpiece: {{path: {plans / 'short.csv'}}}\n")
    grid.write_text("config: job.yaml\ngrid:\n  - workpiece.rotation_y_rad: [0.3, 0.4]\n")
    fits("sweep", printed("sweep", grid, "--methods", "baseline", "--out", run, "--limit", 1))
    fits("sweep", printed("sweep", grid, "--methods", "baseline", "--out", run, "--feed", "20mm/s"))
    fits("timing", printed("program", run, "--all", "--feed", "20mm/s"))
    fits("validation", printed("validate", run))
    printed("gate", run, "--baseline", baseline, "--update")
    fits("gate", printed("gate", run, "--baseline", baseline))


def test_bounds_of_reachability_fit(plans, printed, tmp_path):
    (tmp_path / "job.yaml").write_text(f"workpiece: {{path: {plans / 'short.csv'}}}\n")
    words = "--proof-cells", 0, "--resolution", 0.5, "--out", tmp_path / "out"
    fits("reachability", printed("reachability", tmp_path / "job.yaml", *words))


@pytest.mark.slow
def test_a_search_for_mountings_fits(printed, tmp_path):
    (tmp_path / "place.yaml").write_text("place: {workpiece.rotation_y_rad: [0.3, 0.4]}\nbest: 1\nscreen: baseline\n")
    found = printed("place", tmp_path / "place.yaml", "--scenarios", 2, "--out", tmp_path / "out")
    assert found["ranked"][0]["tolerance"]
    fits("place", found)
    fits("place", json.loads((tmp_path / "out" / "ranked.json").read_text()))


def test_an_imported_arm_and_a_cell_fit(printed, tmp_path):
    arm = SCHEMAS.parents[1] / "configs" / "pipe" / "arm.xml"
    fits("robot", printed("robot", arm, "--fix", "a3=0.2", "--out", tmp_path / "arm.xml"))
    fits("robot", printed("cell", arm, "--tool", "tcp", "--part", "link1", "--out", tmp_path / "cell.xml"))


def test_a_tool_and_its_check_fit(printed, tmp_path):
    trimesh.creation.cylinder(radius=0.01, segment=[[0, 0, 0], [0, 0, 0.08]]).export(tmp_path / "pen.stl")
    fits("tool", printed("tool", tmp_path / "pen.stl", "--tip", "0,0,0.1", "--out", tmp_path / "pen.xml"))
    fits("tool", printed("tool", toy.write_job(tmp_path, 3, shift_m=(0.45, 0.02, 0.0))))


def test_each_schema_describes_every_value_and_is_listed(monkeypatch):
    monkeypatch.syspath_prepend(SCHEMAS.parent / "hooks")
    tables = pytest.importorskip("tables")
    page = (SCHEMAS.parent / "reference" / "json.md").read_text()
    for file in SCHEMAS.glob("*.json"):
        name = file.stem.removesuffix("-1")
        assert f"(../schemas/{file.name})" in page and f"<!-- generated: json {name} -->" in page
        assert all(row.split("|")[3].strip() for row in tables.json_table(name).splitlines()[2:]), name
