"""A run whose scenarios are timed: the same columns as for single programs; report and gate know them."""

import json
import os
import shutil
import signal

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from small_run import rewrite
from sweep_process import JOB, PLATE

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.report import make_report
from htcp_jax.runs import open_plans, open_run
from htcp_jax.runs.sweep import sweep
from htcp_jax.runs.timing_file import COLUMNS, timing_file
from htcp_jax.trajectory import time_run
from htcp_jax.trajectory.figures import program_figures
from htcp_jax.trajectory.plan_program import program_of

WELD = "0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n0.195,-0.1739,0.1703\n"
METHOD, LOST = "baseline", 3  # the scenario that has no motion
GRID = {"grid": [{"workpiece.shift_m.x": [0.0, 0.01, 0.02, 3.0]}]}
SLOW = "program.velocity=[1, 1, 1, 1, 1, 1]"


def job_in(place):
    """Job with the files in this folder."""
    part = yaml.safe_load(JOB)["workpiece"]
    return {"workpiece": part | {name: str(place / part[name]) for name in ("cloud", "path")}}


@pytest.fixture(scope="module")
def untimed(tmp_path_factory):
    """Three points behind a plate in three poses, and in one where they are out of reach."""
    place = tmp_path_factory.mktemp("untimed")
    (place / "path.csv").write_text(WELD)
    (place / "plate.xyz").write_text(PLATE)
    job = job_in(place)
    run = sweep(GRID, METHOD, place / "run", config=job, shard_scenarios=2)
    assert (run.plans(METHOD).outcomes.executable == run.plans(METHOD).outcomes.targets).tolist() == [1, 1, 1, 0]
    return place / "run"


@pytest.fixture(scope="module")
def timed(untimed, tmp_path_factory):
    """A timed copy of the run; not to be changed."""
    folder = shutil.copytree(untimed, tmp_path_factory.mktemp("timed") / "run")
    assert main(["program", str(folder), "--all", "--feed", "20mm/s"]) == 0
    return folder


@pytest.fixture
def run(untimed, tmp_path):
    """A copy without times."""
    return shutil.copytree(untimed, tmp_path / "run")


@pytest.fixture
def timed_copy(timed, tmp_path):
    """A copy with times."""
    return shutil.copytree(timed, tmp_path / "timed")


def rows(folder):
    return open_run(folder).scenarios().to_pylist()


def content(folder):
    return timing_file(folder, METHOD).read_bytes()


def test_the_columns_are_the_figures_of_the_single_programs(timed):
    plans = open_plans(timed)
    for number, row in enumerate(rows(timed)):
        if number == LOST:
            assert row["feed_m_s"] == 0.02 and not any(row[name] is not None for name in COLUMNS[1:])
            continue
        made = program_of(plans, 0.02, METHOD, number)
        found = program_figures(made.program, made.limits)
        assert row["cycle_time_s"] == found.duration_s and row["path_time_s"] == found.seconds["process"]
        assert row["feed_held_share"] == found.held_share and row["feed_reached_m_s"] == found.reached_m_s
        for share in found.path_shares:
            assert (row[f"{share.limit}_share"], row[f"{share.limit}_joint"]) == (share.share, share.joint)
            (whole,) = (each for each in found.shares if each.limit == share.limit)
            assert 0 < share.share <= whole.share <= 1
        assert row["torque_share"] is None  # the GP50 has no inertias


def test_a_run_that_is_not_timed_has_none_of_the_columns_and_its_report_is_quiet(untimed):
    assert not set(COLUMNS) & set(rows(untimed)[0])
    report = make_report(untimed)
    assert "cycle-time" not in report.figures and "timing" not in [table.name for table in report.tables]
    assert not any("ycle time" in str(block) for block in report.blocks)


def test_a_sweep_with_a_feed_leaves_the_same_file_as_timing_it_afterwards(timed, untimed, tmp_path, capsys):
    sweep_file = tmp_path / "sweep.yaml"
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job_in(untimed.parent)))
    sweep_file.write_text(yaml.safe_dump(GRID | {"config": "job.yaml"}))
    words = ["sweep", str(sweep_file), "--methods", METHOD, "--shard", "2", "--out", str(tmp_path / "run"), "--json"]
    assert main([*words, "--set", "program.feed=20mm/s"]) == 0
    assert content(tmp_path / "run") == content(timed)
    record = json.loads(capsys.readouterr().out)["methods"][METHOD]["timing"]
    assert (record["feed_m_s"], record["timed"], record["scenarios"]) == (0.02, 3, 4)
    assert record["cycle_median_s"] == pytest.approx(np.median([r["cycle_time_s"] for r in rows(timed)[:LOST]]))
    assert main([*words[:-1], "--feed", "30mm/s"]) == 0
    reported = capsys.readouterr().out
    assert (
        "Timed at 30 mm/s; limits: velocity by the model, full speed in 0.2 s" in reported and "cycle time" in reported
    )


@pytest.mark.slow
def test_neither_the_number_of_processes_nor_what_is_timed_together_has_any_influence(timed, run):
    time_run(open_run(run), "20mm/s", workers=2, block=2)
    assert pq.read_table(timing_file(run, METHOD)).equals(pq.read_table(timing_file(timed, METHOD)))


def test_a_run_with_a_motion_outside_the_ranges_of_a_file_is_not_timed(run, tmp_path, capsys):
    largest = open_plans(run).plans(METHOD).x[:LOST].max(axis=1)
    farther = largest[2] - largest[:2].max(axis=0)
    joint = int(farther.argmax())
    assert farther[joint] > 1e-3, "scenario 2 moves this joint farther than the others"
    entry = {"max_position": float(largest[2, joint] - farther[joint] / 2)}
    (tmp_path / "joint_limits.yaml").write_text(yaml.safe_dump({"joint_limits": {f"joint{joint + 1}": entry}}))
    words = ["program", str(run), "--all", "--feed", "20mm/s", "--limits", str(tmp_path / "joint_limits.yaml")]
    assert main(words) == 2
    assert "of scenario 2, " in capsys.readouterr().err and not timing_file(run, METHOD).exists()


def test_what_a_signal_leaves_is_whole_and_the_same_call_does_the_rest(timed, run):
    done = []

    def interrupt(method, finished, of):
        done.append(finished)
        if finished == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(Interrupted, match="2 of 4 scenarios of baseline are timed"):
        time_run(open_run(run), "20mm/s", progress=interrupt, block=1)
    assert [row["cycle_time_s"] is not None for row in rows(run)] == [True, True, False, False]
    done.clear()
    time_run(open_run(run), "20mm/s", progress=lambda method, finished, of: done.append(finished), block=1)
    assert done == [2, 3, 4]
    assert content(run) == content(timed)


def test_the_same_again_does_nothing_and_another_feed_or_other_limits_replace_it(timed_copy):
    before = timing_file(timed_copy, METHOD).stat()
    time_run(open_run(timed_copy), "1.2m/min")  # which is 20 mm/s
    assert timing_file(timed_copy, METHOD).stat().st_mtime_ns == before.st_mtime_ns
    first = rows(timed_copy)
    time_run(open_run(timed_copy), "10mm/s")
    second = rows(timed_copy)
    assert all(b["path_time_s"] > 1.5 * a["path_time_s"] for a, b in zip(first[:LOST], second[:LOST], strict=True))
    time_run(open_run(timed_copy), "10mm/s", overrides=[SLOW])
    third = rows(timed_copy)
    assert all(b["cycle_time_s"] > a["cycle_time_s"] for a, b in zip(second[:LOST], third[:LOST], strict=True))
    assert "velocity by the job" in open_run(timed_copy).timing(METHOD).words


def test_times_of_results_that_are_not_the_runs_any_more_do_not_count(timed_copy):
    rewrite(timed_copy, METHOD, 2, lambda table: table.set_column(0, "method", table["method"]).combine_chunks())
    rewrite(timed_copy, METHOD, 2, lambda table: table.slice(0).replace_schema_metadata({"by": "somebody"}))
    assert [row["feed_m_s"] for row in rows(timed_copy)] == [0.02, 0.02, None, None]


def test_a_damaged_file_is_named_and_made_again(timed, timed_copy):
    file = timing_file(timed_copy, METHOD)
    file.write_bytes(content(timed)[:-40])
    with pytest.raises(InputError, match=r"baseline\.parquet is damaged: .*delete it and run htcp program --all again"):
        open_run(timed_copy).scenarios()
    time_run(open_run(timed_copy), "20mm/s")
    assert content(timed_copy) == content(timed)


def test_the_report_has_a_table_charts_and_columns(timed):
    report = make_report(timed)
    (row,) = report.frame("timing").to_dict("records")
    assert (row["timed"], row["scenarios"], row["held"]) == (3, 4, 0)  # much of 9 mm is run-up
    assert row["cycle_max_s"] == max(each["cycle_time_s"] for each in rows(timed)[:LOST])
    assert {"cycle-time", "feed-held"} <= set(report.figures)
    drawn = [line.get_ydata() for line in report.figures["cycle-time"].axes[0].lines]
    np.testing.assert_array_equal(drawn[0][:LOST], [each["cycle_time_s"] for each in rows(timed)[:LOST]])
    assert np.isnan(drawn[0][LOST])
    scenarios = report.frame("scenarios")
    assert scenarios["cycle_time_s"].notna().tolist() == [True, True, True, False]
    assert any("Timed at 20 mm/s" in str(block) for block in report.blocks)


@pytest.fixture(scope="module")
def baseline(timed, tmp_path_factory):
    file = tmp_path_factory.mktemp("baseline") / "baseline.yaml"
    assert main(["gate", str(timed), "--baseline", str(file), "--update"]) == 0
    return file


def verdict(run, baseline, capsys):
    capsys.readouterr()
    code = main(["gate", str(run), "--baseline", str(baseline), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert code == (0 if found["passed"] else 1)
    return found


def edited(baseline, tmp_path, change):
    raw = yaml.safe_load(baseline.read_text())
    change(raw["methods"][METHOD]["times"])
    (tmp_path / "edited.yaml").write_text(yaml.safe_dump(raw))
    return tmp_path / "edited.yaml"


def test_a_run_passes_the_baseline_of_its_own_times_and_the_gate_shows_them(timed, baseline, capsys):
    assert main(["gate", str(timed), "--baseline", str(baseline)]) == 0
    assert "cycle time" in capsys.readouterr().out
    (row,) = verdict(timed, baseline, capsys)["rows"]
    assert row["was_cycle_mean_s"] == row["cycle_mean_s"] and row["held"] == 0


def test_a_run_without_times_or_with_others_fails_where_the_baseline_has_some(untimed, timed_copy, baseline, capsys):
    (failure,) = verdict(untimed, baseline, capsys)["failures"]
    assert "its times are missing; run htcp program --all" in failure
    time_run(open_run(timed_copy), "10mm/s")
    (failure,) = verdict(timed_copy, baseline, capsys)["failures"]
    assert "timed with another feed or other limits" in failure


def test_a_run_that_takes_longer_holds_its_feed_less_or_has_fewer_times_fails(timed, baseline, tmp_path, capsys):
    def faster(times):
        times["cycle_time_s"][1] /= 1.02

    def barely(times):
        times["cycle_time_s"][1] /= 1.009

    def more_held(times):
        times["held"] += 1

    def one_more(times):
        times["cycle_time_s"][LOST] = 1.0

    for change, says in (
        (faster, "1 scenario over 1 % longer, most of all scenario 1"),
        (more_held, "1 scenario fewer with the feed held, 0 of 3"),
        (one_more, "1 scenario without a time, the first is 3"),
    ):
        (failure,) = verdict(timed, edited(baseline, tmp_path, change), capsys)["failures"]
        assert says in failure
    assert verdict(timed, edited(baseline, tmp_path, barely), capsys)["passed"]


WRONG = [
    (["--all", "--feed", "20"], "feed '20' is not a speed above 0 with a unit, such as 20mm/s"),
    (["--all"], "the feed rate is missing: pass --feed 20mm/s, or set program.feed in the job"),
    (["--all", "--feed", "20mm/s", "--out", "x.csv"], "--out applies to one program, and --all times every scenario"),
    (["--all", "--feed", "20mm/s", "--one-way"], "--one-way applies to one program"),
    (["--all", "--feed", "20mm/s", "--method", "hybrid"], "has no plans by 'hybrid'; valid: baseline"),
    (["--all", "--feed", "20mm/s", "--set", "margin_m=0"], "only keys of program.* can be changed"),
    (["--all", "--set", "program.feed=5"], "program.feed: feed '5' is not a speed above 0 with a unit"),
    (
        ["--all", "--feed", "20mm/s", "--set", "program.velocity=[1, 2]"],
        "program.velocity has 2 values, but the robot gp50",
    ),
    (["--feed", "20mm/s"], "--out is missing: pass --out FILE, or --all"),
]


@pytest.mark.parametrize(("words", "says"), WRONG)
def test_what_is_wrong_is_one_line_exit_2_and_leaves_the_run_as_it_is(run, capsys, words, says):
    assert main(["program", str(run), *words]) == 2
    output = capsys.readouterr()
    assert says in output.err and output.err.count("\n") == 1 and output.out == ""
    assert not timing_file(run, METHOD).exists()


def test_a_run_without_any_motion_to_the_end_says_so(planned, tmp_path, capsys):
    folder = shutil.copytree(planned / "run", tmp_path / "run")  # its methods check no joint path
    assert main(["program", str(folder), "--all", "--feed", "20mm/s"]) == 2
    assert "there is nothing to time" in capsys.readouterr().err


def test_a_sweep_with_a_feed_of_an_arm_without_velocity_limits_is_refused_before_it_is_planned(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "path.csv").write_text("1,0,0\n1,0,0.01\n")
    job = {"robot": {"model": "arm.xml"}, "start_rad": [0, 0, 0], "workpiece": {"cloud": "none", "path": "path.csv"}}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    (tmp_path / "grid.yaml").write_text(yaml.safe_dump({"config": "job.yaml", "grid": [{"margin_m": [0.001]}]}))
    out = tmp_path / "run"
    assert main(["sweep", str(tmp_path / "grid.yaml"), "--feed", "20mm/s", "--out", str(out)]) == 2
    assert (
        "has no velocity limit for joint j1; set program.velocity, with one value per joint" in capsys.readouterr().err
    )
    assert not out.exists()


ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="a"><joint name="j1" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .6 0 0"/>
<body name="b" pos=".6 0 0"><joint name="j2" axis="0 1 0"/><geom type="capsule" size=".03" fromto="0 0 0 .5 0 0"/>
<body name="c" pos=".5 0 0"><joint name="j3" axis="0 0 1"/><geom type="capsule" size=".02" fromto="0 0 0 .1 0 0"/>
<site name="tcp" pos=".1 0 0"/></body></body></body></worldbody></mujoco>"""
