"""Sweeps of some scenarios of a grid: chosen by number, or drawn."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
import toy
from small_run import edit_manifest

from htcp_jax.cli import main
from htcp_jax.device import devices
from htcp_jax.errors import InputError
from htcp_jax.jobs.draws import drawn_numbers
from htcp_jax.report.chapter import part_facts
from htcp_jax.report.groups import read_parts
from htcp_jax.report.report import _provenance
from htcp_jax.runs import open_run
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.sweep import sweep
from htcp_jax.validation.baseline import read_baseline, update_baseline
from htcp_jax.validation.gate import compare

GRID = {
    "config": "job.yaml",
    "grid": [{"start_rad.j3": {"offsets": [-0.1, 0, 0.1]}}, {"start_rad.j2": {"offsets": [-0.05, 0, 0.05]}}],
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder with a job of the toy arm; the grid has nine starts, 8 targets each."""
    monkeypatch.chdir(tmp_path)
    toy.write_job(tmp_path, 3, shift_m=(0.45, 0.02, 0.0))
    return tmp_path


@pytest.fixture
def full(here):
    """The run of the complete grid."""
    return sweep(GRID, "baseline", here / "full")


def same_rows(run, full, numbers) -> bool:
    """Return True if both tables have the rows of these scenarios of the complete run, and no others."""

    def of_numbers(table):
        return table.filter(pc.is_in(table["scenario"], pa.array(numbers, pa.int32())))

    parts = (run.targets(), full.targets()), (run.scenarios(), full.scenarios())
    return all(part.equals(of_numbers(whole)) and len(part) for part, whole in parts)


def test_chosen_scenarios_keep_their_numbers_and_results(here, full):
    run = sweep(GRID, "baseline", here / "some", scenarios=[7, 1, 3])
    assert run.complete and run.manifest.count == 3 and same_rows(run, full, [1, 3, 7])
    assert run.plans("baseline").outcomes.planned.tolist() == [k in (1, 3, 7) for k in range(8)]


def test_a_run_of_chosen_scenarios_grows_to_more_of_them_and_to_the_complete_grid(here, full):
    sweep(GRID, "baseline", here / "run", scenarios=[1, 3, 7])
    before = {file.name: file.read_bytes() for file in (here / "run" / "targets").iterdir()}
    assert same_rows(sweep(GRID, "baseline", here / "run", scenarios=[1, 2, 3, 5, 7, 8]), full, [1, 2, 3, 5, 7, 8])
    run = open_run(sweep(GRID, "baseline", here / "run").folder)
    assert run.complete and run.targets().equals(full.targets()) and run.scenarios().equals(full.scenarios())
    assert all((run.folder / "targets" / name).read_bytes() == data for name, data in before.items())
    assert [len(shard.scenario_numbers) for shard in run.manifest.shards] == [3, 3, 3]
    with pytest.raises(InputError, match="contains scenario 0 of this sweep, which is not requested"):
        sweep(GRID, "baseline", here / "run", scenarios=[1, 3])


def test_a_run_has_a_table_of_its_shards_with_their_times(here, full):
    run = sweep(GRID, "baseline", here / "run", scenarios=[1, 3, 7], shard_scenarios=2)
    shards = run.frame("shards")
    assert shards[["first", "last", "scenarios", "targets", "tracked"]].values.tolist() == [
        [1, 3, 2, 16, 16],
        [7, 7, 1, 8, 8],
    ]
    assert (shards.run_s > 0).all() and shards.run_s.sum() == run.manifest.seconds["baseline"].run_s
    assert shards.device[0].startswith("cpu") and shards.package.isna().all()


def test_the_times_of_scenarios_are_shares_of_their_shard_s_by_attempted_targets(here, full):
    def stated(run):
        return run.frame("times"), run.frame("shards"), run.plans("baseline")

    times, shards, plans = stated(full)
    assert times.attempted.tolist() == plans.attempted.sum(axis=1).tolist() and {*times.together} == {9}
    for name in ("run_s", "cpu_s"):
        assert times[name].sum() == pytest.approx(shards[name].sum()) and (times[name] > 0).all()
        assert (times[name] / times.attempted).values == pytest.approx(shards[name].sum() / times.attempted.sum())
    assert plans.cpu_s == shards.cpu_s.sum() and {*times.seed} == {full.manifest.seed}
    alone, shards, _ = stated(sweep(GRID, "baseline", here / "alone", shard_scenarios=1))
    assert {*alone.together} == {1} and alone.run_s.tolist() == shards.run_s.tolist()
    assert open_run(here / "alone").scenarios().equals(full.scenarios())


def test_a_seed_that_varies_is_a_column_of_the_times(here):
    run = sweep(GRID | {"grid": [{"settings.seed": [4, 7]}]}, "baseline", here / "run")
    assert run.frame("times").seed.tolist() == [4, 7]


def test_the_times_name_the_package_of_the_method(here, full):
    edit_manifest(full.folder, lambda manifest: manifest.update(plugins={"method baseline": "theirs 1.2"}))
    assert {*open_run(full.folder).frame("times").package} == {"theirs 1.2"}


def test_a_run_states_when_it_began_also_after_it_is_continued(here):
    began = sweep(GRID, "baseline", here / "run", limit=1).manifest.started
    edit_manifest(here / "run", lambda manifest: manifest.update(started="2001-02-03T04:05:06+00:00"))
    assert datetime.now(UTC) - datetime.fromisoformat(began) < timedelta(hours=1)
    assert sweep(GRID, "baseline", here / "run").manifest.started == "2001-02-03T04:05:06+00:00"


def test_a_run_states_the_cores_that_planned_each_shard(here, full):
    assert {*full.frame("shards").cores} == {devices.cores()}


def test_a_report_states_the_package_of_a_method_and_when_the_run_began(here, full):
    edit_manifest(full.folder, lambda manifest: manifest.update(plugins={"method baseline": "theirs 1.2"}))
    run = open_run(full.folder)
    assert f"method baseline from theirs 1.2; on {devices.cores()} core" in _provenance(run)
    assert f"started {run.manifest.started}" in _provenance(run)


def test_a_run_of_an_older_version_has_no_processor_time(here, full):
    def drop(manifest):
        for record in (*manifest["shards"], *manifest["seconds"].values()):
            del record["cpu_s"]

    edit_manifest(full.folder, drop)
    run = open_run(full.folder)
    assert run.frame("times").cpu_s.isna().all() and np.isnan(run.plans("baseline").cpu_s)


def test_a_stopped_sample_is_resumed(here, full):
    def stop(shard):
        raise KeyboardInterrupt

    how = {"sample": 6, "seed": 0, "shard_scenarios": 2}
    with pytest.raises(KeyboardInterrupt):
        sweep(GRID, "baseline", here / "run", finished=stop, **how)
    done = sum(shard.scenarios.rows for shard in open_run(here / "run").manifest.shards)
    assert 0 < done < 6
    assert same_rows(sweep(GRID, "baseline", here / "run", **how), full, drawn_numbers(0, 6, 9))


def test_a_larger_sample_includes_a_smaller_one_and_another_seed_draws_others():
    assert {*drawn_numbers(4, 10, 500)} < {*drawn_numbers(4, 30, 500)}
    assert drawn_numbers(4, 30, 500) != drawn_numbers(5, 30, 500)
    assert drawn_numbers(4, 7, 7) == tuple(range(7))
    drawn = drawn_numbers(0, 1000, 3000)
    assert len({*drawn}) == 1000 and abs(sum(drawn) / 1000 - 1500) < 3 * 3000 / (12 * 1000) ** 0.5


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ("--scenarios 3,17", "the grid has no scenario 17; valid: 0 to 8"),
        ("--scenarios 3,3", "scenario 3 is given twice"),
        ("--scenarios 3,x", "'x' is no number of a scenario"),
        ("--scenarios 3,-1", "'-1' is no number of a scenario"),
        ("--sample 10", "sample is 10; the grid has 9 scenarios; valid: 1 to 9"),
        ("--sample 2 --scenarios 3", "scenarios and sample are given; valid: one of limit, scenarios, sample"),
        ("--limit 2 --sample 2", "limit and sample are given"),
        ("--limit 2 --scenarios 2", "limit and scenarios are given"),
    ],
)
def test_a_wrong_selection_is_refused_in_one_line(here, capsys, options, text):
    (here / "grid.yaml").write_text(json.dumps(GRID))
    assert main(["sweep", "grid.yaml", "--methods", "baseline", "--out", "run", *options.split()]) == 2
    said = capsys.readouterr().err.strip()
    assert text in said and "\n" not in said and not (here / "run").exists()


def test_the_gate_compares_the_chosen_scenarios_and_no_part_becomes_a_baseline(here, full):
    update_baseline(full, here / "baseline.yaml")
    baseline = read_baseline(here / "baseline.yaml")
    run = sweep(GRID, "baseline", here / "run", scenarios=[1, 3, 7])
    found = compare(run, baseline)
    assert found.passed and "3 of 9 scenarios, by number: 1, 3, 7" in found.notes[0]
    assert (found.rows[0].was_tracked, found.rows[0].tracked, found.rows[0].targets) == (24, 24, 24)
    with pytest.raises(InputError, match="limited to 3 of 9 scenarios"):
        update_baseline(run, here / "baseline.yaml")
    better = baseline.model_copy(deep=True)
    better.methods["baseline"].scenarios[0] = "0 NO_START"  # not among the chosen ones
    assert compare(run, better).passed
    sample = sweep(GRID, "baseline", here / "sample", sample=4)
    assert compare(sample, baseline).passed
    forged = json.loads((sample.folder / MANIFEST).read_text())
    forged["is_sample"] = True
    forged["scenarios"][-1] = next(k for k in (8, 7, 6) if k not in forged["scenarios"])
    forged["scenarios"].sort()
    forged["shards"] = []
    (sample.folder / MANIFEST).write_text(json.dumps(forged))
    assert not compare(open_run(sample.folder), baseline).passed


def test_a_report_states_which_part_of_the_grid_was_planned(here, full):
    run = sweep(GRID, "baseline", here / "run", sample=4, seed=0)
    text = " ".join(part_facts(read_parts(run, "run")[0]))
    assert "Planned part of the grid: a random sample of 4 of 9 scenarios, seed 0." in text
    assert text.startswith("4 of 9 scenarios, with ")
