"""`htcp place`: bad input gives one line, exit code 2 and no file; no complete mounting gives exit code 3."""

import json
import re

import pytest
from test_place import TOY_BEAM, make_toy

from htcp_jax.cli import main

HEAD = "config: job.yaml\nwithin: {scenarios: 4}\n"
SEAMS = "seams=[{name: path, path: path.csv}, {name: behind, path: behind.csv}]"
PLACE = "place: {workpiece.shift_m: [[0.4, 0.6], 0.02, 0.0]}\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The toy arm and shelf; the folder is the working folder."""
    make_toy(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def place(text: str, *words: str) -> int:
    with open("place.yaml", "w", encoding="utf-8") as file:
        file.write(HEAD + text)
    beam = [word for change in TOY_BEAM for word in ("--set", change)]
    return main(["place", "place.yaml", "--out", "out", *beam, *words])


@pytest.mark.parametrize(
    ("text", "words", "says"),
    [
        ("place: {workpiece.rotation_y_rad: [1, 0]}", (), "the range [1, 0] is reversed"),
        ("place: {workpiece.rotation_y: [0, 1]}", (), "unknown parameter workpiece.rotation_y; did you mean"),
        ("place: {method: [0, 1]}", (), "method cannot vary in a search"),
        ("place: {task.1.cone_deg: [10, 40]}", (), "task.1.cone_deg: the task has 0 rows"),
        ("place: {cell.shift_m.z: [0, 1]}", (), "cell.shift_m is set, but cell.model is missing"),
        (PLACE, ("--scenarios", "4", "--seconds", "5"), "--scenarios and --seconds exclude each other"),
        (PLACE, ("--scenarios", "0"), "within.scenarios is 0"),
        (PLACE, ("--on", "moon"), "on is 'moon'; valid: here, ray"),
        (PLACE + "feed: '20'", (), "feed '20' is not a speed above 0 with a unit"),
        (PLACE + "seams: [path.csv]", (), "place.yaml: seams has moved to the job: list them there, each"),
        (PLACE, ("--set", SEAMS.replace("behind", "empty")), "empty.csv: the tool path is empty"),
        (PLACE + "objective: speed", (), "unknown objective 'speed'; valid: clearance, cycle time, joint motion"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(here, capsys, text, words, says):
    (here / "empty.csv").write_text("x,y,z\n")
    assert place(text, *words) == 2
    output = capsys.readouterr()
    assert says in output.err and output.err.count("\n") == 1 and not output.out
    assert not (here / "out").exists()


def test_where_every_start_collides_the_body_is_named_and_nothing_is_left(here, capsys):
    assert place("place: {workpiece.shift_m: [[-0.35, -0.3], 0.0, 0.3]}") == 2  # the shelf is in the forearm
    output = capsys.readouterr()
    assert "no motion can start in any of 4 mountings: " in output.err and " mm inside the workpiece" in output.err
    assert output.err.count("\n") == 1 and not (here / "out").exists()


def test_without_a_mounting_it_exits_with_3_and_says_which_seam_prevents_the_best(here, capsys):
    (here / "behind.csv").write_text("1.2,0,0.3\n1.22,0,0.3\n")
    text, seams = "place: {workpiece.shift_m.x: [0.4, 0.5]}", ("--set", SEAMS)
    assert place(text, *seams) == 3
    output = " ".join(capsys.readouterr().out.split())
    assert "1 of 2 seams; prevented by behind (" in output and "path: 2, behind: 0" in output
    assert place(text, *seams, "--json") == 3
    reported = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert reported["ranked"] == [] and reported["seams"]["path"] == {"complete": 2, "in_the_best": 1.0}


def test_the_number_of_plans_is_printed_first_and_the_command_that_plans_the_best_last(here, capsys):
    """Number of plans, printed first, and the command that plans the best placement, printed last (regression)."""
    assert place("place: {workpiece.shift_m.x: [0.4, 0.5]}\nbest: 1", "--scenarios", "2") == 0
    output = capsys.readouterr().out
    most = int(re.match(r"up to ([\d,]+) plans: 8 to search, 7 to confirm, ", output)[1].replace(",", ""))
    made = [json.loads(file.read_text())["shards"] for file in (here / "out").rglob("manifest.json")]
    assert sum(shard["last"] - shard["first"] + 1 for shards in made for shard in shards) <= most + 1  # the ranked
    (command,) = (line.split()[1:] for line in output.splitlines() if line.startswith("plan "))
    clearance = re.search(r"\n +1 +\S+ +(\S+)", output)[1]
    assert main([*command[1:], "--json"]) == 0
    assert clearance == f"{json.loads(capsys.readouterr().out)['motion']['clearance_m'] * 1e3:.3g}"


def test_another_search_is_kept_out_of_a_folder(here, capsys):
    assert place("place: {workpiece.shift_m.x: [5, 6]}\nbest: 1") == 3
    capsys.readouterr()
    before = {file: file.read_bytes() for file in (here / "out").rglob("*") if file.is_file() and file.name != ".lock"}
    assert place("place: {workpiece.shift_m.x: [5, 7]}\nbest: 1") == 2
    output = capsys.readouterr()
    assert "out contains another search: place is " in output.err and output.err.count("\n") == 1
    assert all(file.read_bytes() == data for file, data in before.items())
