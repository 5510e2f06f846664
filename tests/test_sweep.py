"""Sweeps by the public call and by the command: results, resumption, and rejected inputs."""

import itertools
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import toy

from htcp_jax.cli import main
from htcp_jax.cli.sweep import not_tried
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Plans, Problem
from htcp_jax.planning import batch, methods, registry
from htcp_jax.planning.method import Method
from htcp_jax.runs import Run, RunningSummary, open_run
from htcp_jax.runs.summary import Summary, summarise
from htcp_jax.runs.sweep import sweep
from htcp_jax.status import Status

GRID = """
config: job.yaml
grid:
  - start_rad.joint3: {offsets: [-0.1, 0, 0.1]}
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder with a grid of three starts of the GP50 in the duct, 13 targets each."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    (tmp_path / "job.yaml").write_text("workpiece: {path: path.csv}\n")
    (tmp_path / "grid.yaml").write_text(GRID)
    return tmp_path


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A working folder with a grid of three starts of the toy arm, 8 targets each."""
    monkeypatch.chdir(tmp_path)
    toy.write_job(tmp_path, 3, shift_m=(0.45, 0.02, 0.0))
    (tmp_path / "grid.yaml").write_text(GRID.replace("joint3", "j3"))
    return tmp_path


@pytest.fixture
def shards():
    """List of the finished (method, first scenario, last scenario), and the callback of `sweep` that fills it."""
    found = []
    return found, lambda shard: found.append((shard.method, *shard.span))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.glob("*/*"))}


def test_each_scenario_is_planned_as_it_would_be_alone_however_the_grid_is_cut(here):
    whole = sweep("grid.yaml", "baseline,keep-clear", "whole")
    cut = sweep("grid.yaml", ["baseline"], "cut", shard_scenarios=2)
    assert whole.complete and whole.methods == ("baseline", "keep-clear")
    assert cut.targets().equals(whole.targets("baseline")) and cut.scenarios().equals(whole.scenarios("baseline"))
    requested = load_sweep("grid.yaml").batch()
    settings = load_sweep("grid.yaml").config.settings
    problem = Problem.of(requested.robot, requested.workpiece, requested.scenarios, settings)
    alone = batch.plan(problem, "baseline")
    for name, value in whole.plans("baseline")._asdict().items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(value, getattr(alone, name), err_msg=name)


def test_the_programs_of_all_methods_are_compiled_before_the_first_one_plans(small):
    """The step length has a value of its own, so that no program of the second method is compiled yet."""
    waited, overrides = {}, {"settings.alpha_rad": 0.0123}
    sweep(
        "grid.yaml",
        "baseline,nspace-sqp",
        "run",
        overrides=overrides,
        finished=lambda shard: waited.update({shard.method: shard.plans.compile_s}),
    )
    assert waited["baseline"] > 0 == waited["nspace-sqp"]


def test_the_command_prints_a_table_that_lines_up_and_nothing_else_when_piped(here, capsys):
    assert main(["sweep", "grid.yaml", "--methods", "baseline,keep-clear", "--limit", "2", "--out", "run"]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    title, *lines, files = output.out.splitlines()
    assert title == "grid, the first 2 of 3 scenarios" and files.split() == ["files", "run"]
    for table in (lines[:4], lines[5:9]):
        assert [row.split()[0] for row in table[2:]] == ["baseline", "keep-clear"]
        assert len({len(line) for line in table}) == 1 and len(table[0]) <= 80
    assert lines[2].split()[1:5] == ["100.00", "26", "26", "26"]
    assert lines[-1] == "Tracked: reached with the required clearance of 0.5 mm or more."


def test_the_command_prints_no_row_and_no_column_without_a_value(here, capsys):
    assert main(["sweep", "grid.yaml", "--methods", "baseline", "--limit", "1", "--out", "run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    cells = [line.split() for line in lines if line.startswith("baseline ")]
    assert (
        cells and not [row for row in cells if "-" in row[1:]] and not [row for row in lines if "all methods  " in row]
    )
    assert any(line.startswith("Compiling for all methods took ") for line in lines)


def test_a_run_names_the_solver_that_auto_selected_so_that_another_device_does_not_continue_it(small):
    run = sweep("grid.yaml", "baseline", "run", limit=1)
    assert load_sweep("grid.yaml").config.settings.qp == "auto" and run.config.settings.qp == "clarabel"
    asked = {"grid": [{"settings.qp": ["auto", "clarabel"]}]}
    used = [point.config.settings.qp for point in load_sweep(asked, "job.yaml").on("gpu").points()]
    assert used == ["device", "clarabel"] and load_sweep("grid.yaml").on("gpu").config.settings.qp == "device"
    with pytest.raises(
        InputError, match=r"settings\.qp was clarabel, now device; delete the folder, or choose another"
    ):
        sweep(load_sweep("grid.yaml").on("gpu"), "baseline", "run")


def test_what_is_finished_is_not_planned_again(small, shards):
    planned, note = shards
    sweep("grid.yaml", "baseline", "run", shard_scenarios=2, finished=note)
    assert planned == [("baseline", 0, 1), ("baseline", 2, 2)]
    run = sweep("grid.yaml", "baseline,keep-clear", "run", finished=note)
    assert planned[2:] == [("keep-clear", 0, 2)]
    assert run.methods == ("baseline", "keep-clear") and run.complete


def test_a_run_is_continued_with_shards_of_another_size(small, shards):
    """A file of a shard that a killed process did not list in the manifest is removed."""
    planned, note = shards
    whole = sweep("grid.yaml", "baseline", "whole")
    sweep("grid.yaml", "baseline", "run", limit=1)
    (small / "run/targets/baseline-000001-000001.parquet").write_bytes(b"unfinished")
    run = sweep("grid.yaml", "baseline", "run", shard_scenarios=2, finished=note)
    assert planned == [("baseline", 1, 2)] and run.complete
    assert run.targets().equals(whole.targets()) and run.scenarios().equals(whole.scenarios())
    assert sorted(file.name for file in Path("run/targets").iterdir()) == [
        "baseline-000000-000000.parquet",
        "baseline-000001-000002.parquet",
    ]


def test_a_limit_may_grow_but_not_shrink(small, shards):
    planned, note = shards
    sweep("grid.yaml", "baseline", "run", limit=1, finished=note)
    run = sweep("grid.yaml", "baseline", "run", limit=3, finished=note)
    assert planned == [("baseline", 0, 0), ("baseline", 1, 2)]
    assert run.manifest.count == 3 and run.complete
    with pytest.raises(
        InputError,
        match="run contains this sweep with 3 scenarios, more than 2; delete the folder",
    ):
        sweep("grid.yaml", "baseline", "run", limit=2)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"overrides": ["settings.alpha_rad=0.05"]},
            "settings.alpha_rad was 0.1, now 0.05; delete the folder",
        ),
        ({"overrides": ["margin_m=0"]}, "margin_m was 0.0005, now 0.0"),
        ({"seed": 1}, "settings.seed was 0, now 1"),
        ({"spec": "other.yaml"}, "its grid differs"),
        ({"overrides": ["workpiece.cloud=moved.xyz"]}, "workpiece.cloud was shelf.xyz, SHA-256 "),
    ],
)
def test_another_sweep_never_mixes_with_the_old_rows(small, change, line):
    (small / "other.yaml").write_text((small / "grid.yaml").read_text().replace("-0.1", "-0.2"))
    (small / "moved.xyz").write_text((small / "shelf.xyz").read_text() + "0.43 0 0.36\n")
    sweep("grid.yaml", "baseline", "run")
    before = contents(small / "run"), (small / "run" / "manifest.json").read_bytes()
    with pytest.raises(InputError) as error:
        sweep(**{"spec": "grid.yaml", "methods": "baseline", "out": "run", **change})
    assert line in str(error.value) and "run contains another sweep: " in str(error.value)
    assert (contents(small / "run"), (small / "run" / "manifest.json").read_bytes()) == before


def test_the_same_files_elsewhere_are_the_same_sweep(small, shards):
    planned, note = shards
    sweep("grid.yaml", "baseline", "run", finished=note)
    os.rename(small / "grid.yaml", small / "renamed.yaml")
    os.chdir("/")
    assert sweep(small / "renamed.yaml", "baseline", small / "run", finished=note).complete and len(planned) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_sweep_that_the_same_call_completes(small, number):
    sweep("grid.yaml", "baseline", "undisturbed", shard_scenarios=1)
    handler = signal.getsignal(number)

    def interrupt(now):
        if now.scenarios_done == 2:
            os.kill(os.getpid(), number)

    with pytest.raises(Interrupted, match=r"stopped; 1 of 3 plans are finished in run; run the same command") as stop:
        sweep("grid.yaml", "baseline", "run", shard_scenarios=1, progress=interrupt)
    assert stop.value.code == 128 + number
    assert signal.getsignal(number) is handler
    sweep("grid.yaml", "baseline", "run", shard_scenarios=1)
    assert contents(small / "run") == contents(small / "undisturbed")


def test_a_sweep_continued_with_fewer_methods_tells_what_it_planned_and_what_is_left(small, capsys):
    """Sweep resumed with fewer methods: its output lists the planned ones and the remaining ones (regression)."""

    def interrupt(now):
        if now.method == "baseline" and now.scenarios_done == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(Interrupted):
        sweep("grid.yaml", "baseline,hybrid", "run", shard_scenarios=1, progress=interrupt)
    words = ["sweep", "grid.yaml", "--methods", "baseline", "--out", "run"]
    assert main(words) == 0
    shown = capsys.readouterr()
    reported = "unfinished  hybrid: 3 of 3 scenarios left; run again with --methods hybrid to plan them"
    assert shown.err == "" and reported in shown.out and "baseline" in shown.out
    assert main([*words, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (list(record["methods"]), record["unfinished"], record["complete"]) == (["baseline"], {"hybrid": 3}, False)
    assert {shard.method for shard in open_run("run").manifest.shards} == {"baseline"}


def test_a_signal_stops_the_planner_in_the_middle_of_a_shard_and_leaves_nothing(small):
    reported = []

    def interrupt(now):
        reported.append(now)
        os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted, match="stopped before anything was finished; nothing was written"):
        sweep("grid.yaml", "baseline", "run", progress=interrupt)
    assert reported[-1].targets_tracked < reported[-1].targets and not (small / "run").exists()


def test_a_signal_while_starts_are_joined_to_home_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    toy.write_sweep(tmp_path, start_rad="auto", home_rad=list(toy.START))
    (tmp_path / "grid.yaml").write_text("config: job.yaml\ngrid: [{workpiece.shift_m.y: [0.0, 0.01, 0.02]}]\n")
    reported = []

    def interrupt(now):
        reported.append(now)
        if now.starts is not None:
            os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Interrupted, match="stopped before anything was finished; nothing was written"):
        sweep("grid.yaml", "baseline", "run", progress=interrupt)
    assert reported[-1].starts == 0 and not reported[-1].targets_tracked and not (tmp_path / "run").exists()


class Stopped(Method):
    """The baseline, during whose second shard a SIGTERM arrives."""

    name, title, description = "stopped", "Stopped", "stopped in its second shard"
    shards = 0

    def plan(self, problem: Problem) -> Plans:
        self.shards += 1
        if self.shards == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return methods.find("baseline").plan(problem)


def test_the_command_says_how_to_go_on_after_a_signal(small, capsys):
    registry.METHODS.register(Stopped())
    try:
        assert main(["sweep", "grid.yaml", "--methods", "stopped", "--shard", "1", "--out", "run"]) == 143
    finally:
        registry.METHODS._own.pop("stopped")
    reported = "htcp: stopped; 1 of 3 plans are finished in run; run the same command to resume\n"
    assert capsys.readouterr().err == reported


class Killed(BaseException):
    """Stand-in for kill -9: no cleanup may run after it."""


def test_killed_at_any_write_a_sweep_continues_to_the_same_bytes(small, monkeypatch):
    sweep("grid.yaml", "baseline", "undisturbed", shard_scenarios=2)
    replace, calls = os.replace, []

    def dying(source, target):
        calls.append(target)
        if after or len(calls) != moment:
            replace(source, target)
        if len(calls) == moment:
            raise Killed

    monkeypatch.setattr(os, "replace", dying)
    writes = 1 + 2 * 3  # the manifest at first; two tables and the manifest a shard
    for moment, after in itertools.product(range(1, writes + 1), (False, True)):
        calls.clear()
        folder = small / f"run-{moment}-{after}"
        with pytest.raises(Killed):
            sweep("grid.yaml", "baseline", folder, shard_scenarios=2)
        folder.mkdir(exist_ok=True)
        run = sweep("grid.yaml", "baseline", folder, shard_scenarios=2)
        assert run.complete and contents(folder) == contents(small / "undisturbed")
        assert not list(folder.glob(".part-*"))


def test_progress_counts_what_was_kept(small):
    sweep("grid.yaml", "baseline", "run", limit=2, shard_scenarios=2)
    reported = []
    sweep("grid.yaml", "baseline", "run", progress=reported.append)
    assert reported[0][:5] == ("baseline", 2, 3, 16, 24) and reported[-1][:5] == ("baseline", 3, 3, 24, 24)


def test_without_a_folder_the_results_live_as_long_as_the_run(small):
    run = sweep("grid.yaml", "baseline")
    folder = run.folder
    assert isinstance(run, Run) and run.scenarios().num_rows == 3
    assert run.scenarios()["tracked"].to_pylist() == [8, 8, 8]
    del run
    assert not folder.exists()


def test_a_run_can_be_read_while_it_is_planned(small):
    seen = []

    def look(now):
        if (run := open_run("run")).manifest.shards and not run.complete:
            seen.append((run, run.scenarios().num_rows))

    sweep("grid.yaml", "baseline", "run", shard_scenarios=1, progress=look)
    run, written = seen[0]  # while a shard is planned, the one before it may be being written
    assert 1 <= written < 3 and (run.plans("baseline").status[written:] == -1).all()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["nowhere.yaml"], "cannot read nowhere.yaml: No such file"),
        (["grid.yaml", "--methods", "baseline,baseline"], "method baseline is given twice"),
        (["grid.yaml", "--methods", "baseline,rrt"], "; the package of a method of your own may not be installed"),
        (["grid.yaml", "--methods", ""], "--methods is empty; give a value, or omit it"),
        (["grid.yaml", "--limit", "0"], "Invalid value for '--limit': Input should be greater than or equal to 1"),
        (["grid.yaml", "--seed", "-1"], "settings.seed is -1: at least 0 is needed"),
        (["grid.yaml", "--set", "margin=1"], "unknown key margin; did you mean margin_m?"),
        (["grid.yaml", "--config", "none.yaml"], "cannot read none.yaml"),
        (["bad.yaml"], "bad.yaml: grid, axis 1: unknown parameter margin; did you mean margin_m or margin_on?"),
        (["empty.yaml"], "empty.yaml: grid is empty"),
        (["grid.yaml", "--out", "path.csv"], "cannot write to path.csv"),
        (["grid.yaml", "--set", "settings.q_weights=[1]"], "q_weights has 1 values, but the robot gp50 has 6 joints"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_file(here, capsys, arguments, line):
    (here / "bad.yaml").write_text("grid: [margin: [1]]\n")
    (here / "empty.yaml").write_text("grid: []\n")
    before = sorted(here.iterdir())
    assert main(["sweep", *arguments]) == 2
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.err.startswith("htcp: ")
    assert output.out == "" and sorted(path for path in here.iterdir() if path.name != "out") == before
    assert not list(here.glob("out/*"))


def same(a: Summary, b: Summary) -> bool:
    """Return True if both are bitwise equal, NaN being NaN."""
    return all(one == other or (one != one and other != other) for one, other in zip(a, b, strict=True))


def test_what_was_just_planned_is_summed_up_without_reading_it_again(small):
    running = RunningSummary()
    run = sweep("grid.yaml", "baseline,keep-clear", "out", shard_scenarios=2, finished=running.add)
    read = {method: summarise(run.plans(method)) for method in run.methods}
    margins = np.unique(run.scenarios()["margin_m"].to_numpy())
    for file in Path("out").glob("*/*.parquet"):
        file.unlink()
    fresh = open_run("out")
    assert all(same(summarise(running.plans(fresh, method)), read[method]) for method in run.methods)
    np.testing.assert_array_equal(running.margins_m(fresh, *run.methods), margins)


def test_what_was_planned_before_is_read_from_the_folder(small):
    sweep("grid.yaml", "baseline", "out", limit=2, shard_scenarios=1)
    running = RunningSummary()
    run = sweep("grid.yaml", "baseline", "out", shard_scenarios=1, finished=running.add)
    assert same(summarise(running.plans(run, "baseline")), summarise(run.plans("baseline")))
    np.testing.assert_array_equal(running.margins_m(run, "baseline"), [load_sweep("grid.yaml").config.margin_m])


def test_the_command_s_table_needs_none_of_the_files_that_it_wrote(small, monkeypatch, capsys):
    def damaging(source, target, replace=os.replace):
        replace(source, target)
        if target.suffix == ".parquet":
            target.write_bytes(b"")

    monkeypatch.setattr(os, "replace", damaging)
    assert main(["sweep", "grid.yaml", "--methods", "baseline", "--out", "out"]) == 0
    assert "24" in capsys.readouterr().out  # targets: three scenarios of 8


def test_scenarios_that_were_not_tried_are_counted_by_reason():
    first = [Status.NO_START] * 4 + [Status.HOME_IN_COLLISION, Status.TRACKED]
    status = np.stack([first, [Status.NOT_ATTEMPTED] * 5 + [Status.TRACKED]], axis=1)
    assert not_tried(status) == "home in collision: 1 scenario, no start: 4 scenarios"
    assert not_tried(status[-1:]) == ""
