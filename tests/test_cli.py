"""Command line interface: exit codes, table, files, and one-line errors."""

import csv
import gc
import importlib
import json
import re

import numpy as np
import pytest

from htcp_jax.cli import main, plan
from htcp_jax.cli.main import COMMANDS
from htcp_jax.motion import Plans, Problem
from htcp_jax.planning import registry
from htcp_jax.planning.method import Method
from htcp_jax.system.process_exit import INTERRUPTED

SHORT = ["--set", "workpiece.path=path.csv"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Working folder with only a short path: two points of the generated duct's weld, 13 targets."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    return tmp_path


def test_a_complete_plan_exits_0_with_a_table_and_five_files(here, capsys):
    assert main(["plan", *SHORT, "--out", "out"]) == 0
    output = capsys.readouterr()
    first, second, *_ = output.out.splitlines()[1:]
    assert first == "can be run            yes: all 13 targets" and second.startswith("guaranteed clearance  at least ")
    assert "targets tracked       13 of 13 (100.00 %)\n" in output.out and "dwells" not in output.out
    assert output.err == ""  # quiet when piped
    names = {"motion.csv", "trajectory.csv", "trajectory.npz", "summary.json", "plan.png"}
    assert {path.name for path in (here / "out").iterdir()} == names
    summary = json.loads((here / "out" / "summary.json").read_text())
    assert summary["tracked"] == 13 and summary["failures"] == []
    with open(here / "out" / "trajectory.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert all(float(row["clearance_m"]) > 0 and float(row["residual_m"]) <= 1e-3 for row in rows)
    with np.load(here / "out" / "trajectory.npz") as arrays:
        assert arrays["x"].shape == (13, 6)
    motion, reported = summary["motion"], output.out
    assert (motion["executable"], motion["segment_status"], motion["dwells"]) == (13, "VALID", [])
    assert f" mm; minimum on the segment to target {motion['clearance_target']} (" in reported
    with open(here / "out" / "motion.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["kind"] for row in rows] == ["APPROACH"] * 13 + ["PROCESS"]
    assert [int(row["target"]) for row in rows] == [0, *range(13)]


def test_the_motion_leads_back_where_required(here, capsys):
    assert main(["plan", *SHORT, "--out", "out", "--retract", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["motion"]["executable"] == 13
    with open(here / "out" / "motion.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    joints = [tuple(row[f"joint{k + 1}_rad"] for k in range(6)) for row in rows]
    assert joints == joints[::-1] and [row["kind"] for row in rows[14:]] == ["RETRACT"] * 13


def test_an_incomplete_plan_exits_3_saves_what_it_has_and_names_the_failure(here, capsys):
    (here / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.1857,-0.25,0.1708\n")  # the second point lies in the wall
    assert main(["plan", *SHORT, "--method", "baseline", "--out", "out"]) == 3
    output = capsys.readouterr().out
    first = output.splitlines()[1]
    assert first.startswith("can be run            to target 11, the first 12 of 13; target 12: ")
    assert "failed at target 12: " in output
    (failure,) = json.loads((here / "out" / "summary.json").read_text())["failures"]
    assert failure["target"] == 12 and failure["reason"]
    assert (here / "out" / "plan.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["plan", "nowhere.yaml"], "cannot read nowhere.yaml: No such file"),
        (["plan", "--method", "rrt"], "'rrt' is not a method; valid: baseline, cspace-sample"),
        (["plan", "--set", "margin=1"], "unknown key margin; did you mean margin_m?"),
        (["plan", "--set", "settings.tolerance_m=0"], "settings.tolerance_m is 0: at least 1e-15 is needed"),
        (["plan", "--set", "workpiece.path=none.csv"], "none.csv: no such file"),
        (["plan", "--set", "workpiece.cloud=none.xyz", *SHORT], "none.xyz: no such file"),
        (["plan", "--set", "robot.model=none.urdf"], "none.urdf"),
        (["plan", "--set", "start_rad=[0, 0]"], "start has 2 joint positions, the robot gp50 has 6 joints"),
        (["plan", "--set", "start_rad=[9, -2.3, 0.5, 0, 0.5, -2]"], "outside its limits"),
        (["plan", "--set", "start_rad=[0, -1.2, -0.5, 0, 0.5, -2]"], "start is in collision: "),
        (["plan", "--set", "workpiece.shift_m=[9, 0, 0]"], "target 1 is "),
        (["plan", "--out", "path.csv"], "cannot write to path.csv"),
        (["plan", "--fast"], "No such option: --fast"),
        (["plam"], "No such command 'plam'"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_file(here, capsys, arguments, line):
    before = sorted(here.iterdir())
    assert main(arguments) == 2
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.err.startswith("htcp: ")
    assert output.out == "" and sorted(here.iterdir()) == before


def test_a_cloud_of_an_odd_size_is_warned_of_in_one_line(here, capsys):
    (here / "hall.xyz").write_text("0 0 0\n9 0 0\n0 9 0\n0 0 9\n")
    quick = ["--method", "baseline", "--set", "settings.path_check=none"]
    main(["plan", *SHORT, *quick, "--set", "workpiece.cloud=hall.xyz", "--out", "out"])
    assert capsys.readouterr().err.startswith("htcp: warning: hall extends over 9 m, gp50 reaches 3.07 m; ")


class InterruptedMethod(Method):
    """A planner during which Ctrl-C is pressed."""

    name, title, description = "interrupted", "Interrupted", "interrupted at once"

    def plan(self, problem: Problem) -> Plans:
        raise KeyboardInterrupt


def test_ctrl_c_leaves_nothing_behind(here, capsys):
    registry.METHODS.register(InterruptedMethod())
    try:
        assert main(["plan", *SHORT, "--method", "interrupted", "--out", "out"]) == 130
    finally:
        registry.METHODS._own.pop("interrupted")
    assert capsys.readouterr().err == f"htcp: {INTERRUPTED}\n"
    assert not (here / "out").exists()


def test_garbage_is_collected_only_after_matplotlib_is_loaded(monkeypatch):
    seen = []
    monkeypatch.setattr(importlib, "import_module", lambda _: seen.append(gc.isenabled()))
    plan.load_matplotlib().join()
    assert seen == [False] * len(plan.MATPLOTLIB) and gc.isenabled()


def test_help_and_version_are_answers(capsys):
    for arguments in ([], ["--help"], ["-h"], ["--version"], ["plan", "--help"], ["plan", "-h"]):
        assert main(arguments) == 0
    assert "htcp plan pipe" in capsys.readouterr().out


def options(command: str, capsys) -> dict[str, str]:
    """Options of a command with their placeholders, as its help lists them."""
    assert main([command, "-h"]) == 0
    text = capsys.readouterr().out
    assert "Exit code" in text, command
    return dict(
        re.findall(r"^  (?:-\w, )?(--[a-z-]+)(?: ([A-Za-z|,.=:\[\]_]+))?", text.split("\nOptions:\n")[1], re.MULTILINE)
    )


def test_each_command_lists_its_exit_codes_and_each_option_has_one_spelling(capsys):
    found = {command: options(command, capsys) for command in COMMANDS}
    several = "--out", "--unit", "--scenarios"  # units of angles and of lengths; a count, and numbers of a grid
    spellings = {(name, form) for each in found.values() for name, form in each.items() if name not in several}
    assert sorted({name for name, _ in spellings}) == sorted(name for name, _ in spellings)
    seeded = {"plan", "sweep", "place", "reachability", "view"}  # as everything else is decided by what they read
    assert {command for command, each in found.items() if "--seed" in each} == seeded
    for one in ("--feed-mm-s", "--output", "--force", "--overwrite", "--random-seed"):
        assert not any(one in each for each in found.values())
