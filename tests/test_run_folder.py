"""The run folder: its files read back; a damaged, foreign or locked one is reported in one line."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hand_made import plans_with

from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import gp50
from htcp_jax.jobs import load_config
from htcp_jax.jobs.grid_axes import ScenarioPoint
from htcp_jax.motion.plans import ARRAYS, NO_TARGET
from htcp_jax.motion.sparse_columns import DeadEnds, Tried
from htcp_jax.runs import Run, open_run, tables, writer
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.manifest import Manifest
from htcp_jax.runs.provenance import planned_by
from htcp_jax.spec.config import PlanConfig
from htcp_jax.status import Exclusion, Status
from htcp_jax.system.lock import locked

A, E, LIMIT, NOT = Status.TRACKED, Status.TRACKED_AFTER_RECOVERY, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED
STATUS = [[A, A, A], [A, E, LIMIT], [A, LIMIT, NOT], [A, A, NO_TARGET]]  # the last scenario has one target fewer
JOINTS = tables.joint_columns(gp50())
TRIED = DeadEnds.of({(1, 2): Tried(2, 300, 5, 1), (2, 1): Tried(excluded=Exclusion.TOOL)})
PLANS = plans_with(STATUS, joints=6)._replace(start=np.arange(24.0).reshape(4, 6) / 7, dead_ends=TRIED)
POINTS = tuple(ScenarioPoint(k, "starts", load_config(None, [f"margin_m={k / 10}"])) for k in range(4))
SPANS = range(2), range(2, 4)
BY = planned_by()


def manifest(**changes) -> Manifest:
    requested = {
        "name": "four", "config": load_config().model_dump(mode="json"), "grid": (), "dtype": "float64", "files": {},
        "seed": 0, "joints": JOINTS, "targets": 11, "full": 4, "limit": None, "count": 4,
        "methods": ("baseline",),
    }  # fmt: skip
    requested |= changes
    same = identity(requested["config"], requested["grid"], requested["dtype"], requested["files"])
    return Manifest(**requested | {"config_hash": config_hash(same)})


def rows(method: str, span: range) -> tuple:
    """Tables and plans of a shard."""
    part = slice(span.start, span.stop)
    plans = PLANS.rows(part)
    numbers = np.array(span)
    written = {
        "targets": tables.target_table(method, numbers, plans, JOINTS),
        "scenarios": tables.scenario_table(method, POINTS[part], plans, JOINTS),
    }
    return written, plans


def completed(folder: Path, by: dict = BY) -> Run:
    folder.mkdir(exist_ok=True)
    run = writer.begin(folder, manifest())
    for span in SPANS:
        run = writer.add(run, "baseline", span, *rows("baseline", span), by)
    return run


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.glob("*/*"))}


def test_what_is_written_reads_back_to_the_last_bit(tmp_path):
    completed(tmp_path)
    plans = open_run(tmp_path).plans("baseline")
    np.testing.assert_array_equal(plans.start, PLANS.start)
    for name in set(ARRAYS) - {"start"}:
        value, written = getattr(plans, name), getattr(PLANS, name)
        np.testing.assert_array_equal(value[plans.exists], written[plans.exists], err_msg=name)
    np.testing.assert_array_equal(plans.exists, PLANS.exists)
    assert [column.tolist() for column in plans.dead_ends] == [column.tolist() for column in TRIED]
    assert (plans.compile_s, plans.run_s) == (6.0, 2.0)  # the sums over two shards


def test_a_scenario_s_row_tells_what_became_of_it_and_its_parameters(tmp_path):
    table = completed(tmp_path).scenarios().to_pydict()
    assert (table["tracked"], table["targets"]) == ([3, 2, 1, 2], [3, 3, 3, 2])
    assert table["complete"] == [True, False, False, True]
    assert table["failed_target"] == [None, 2, 1, None]
    assert table["failure"] == [None, "ITERATION_LIMIT", "ITERATION_LIMIT", None]
    assert table["reason"][1] == LIMIT.message
    assert table["after_recovery"] == [0, 1, 0, 0] and table["blocked_paths"] == table["tracked"]
    assert (table["margin_m"], table["group"], table["path"]) == ([0, 0.1, 0.2, 0.3], ["starts"] * 4, ["weld"] * 4)
    assert table["start_joint2_rad"] == PLANS.start[:, 1].tolist()  # that the plans start from, not the job's


def test_what_is_not_known_is_null_not_nan(tmp_path):
    table = completed(tmp_path).targets()
    missed = [not tracked for tracked in table["tracked"].to_pylist()]
    for name in ("clearance_m", "residual_m", "joint_step_rad", "path_clear", "joint1_rad", "tcp_x_m"):
        assert table[name].is_null().to_pylist() == missed, name
    assert table["target_x_m"].null_count == 0
    assert table["dead_end_found"].drop_null().to_pylist() == [5, 0]
    assert table["dead_end_excluded"].drop_null().to_pylist() == ["tool"]


def test_the_parquet_files_are_plain_and_the_same_each_time(tmp_path):
    first, second = completed(tmp_path / "a"), completed(tmp_path / "b")
    assert contents(first.folder) == contents(second.folder) and len(contents(first.folder)) == 4
    read = [pq.read_table(first.folder / "targets" / f"baseline-{s[0]:06d}-{s[-1]:06d}.parquet") for s in SPANS]
    assert sum(table.num_rows for table in read) == PLANS.exists.sum()


def truncate(file: Path):
    file.write_bytes(file.read_bytes()[:-7])


def empty(file: Path):
    file.write_bytes(b"")


def flip_a_bit(file: Path):
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)


def replace_by_another(file: Path):
    other = file.with_name(file.name.replace("000000-000001", "000002-000003"))
    file.write_bytes(other.read_bytes())


DAMAGES = [truncate, empty, flip_a_bit, replace_by_another, Path.unlink]


@pytest.mark.parametrize("table", ["targets", "scenarios"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_named_its_shard_planned_again_and_the_rest_kept(tmp_path, damage, table):
    before = contents(completed(tmp_path).folder)
    damage(tmp_path / table / "baseline-000000-000001.parquet")
    with pytest.raises(InputError, match=rf"{table}.baseline-000000-000001\.parquet .*; run the same sweep again"):
        getattr(open_run(tmp_path), table)()
    with pytest.warns(UserWarning, match="baseline-000000-000001.* scenarios 0 to 1 are planned again by baseline"):
        run = writer.begin(tmp_path, manifest())
    assert run.missing("baseline") == [SPANS[0]] and not run.complete
    run = writer.add(run, "baseline", SPANS[0], *rows("baseline", SPANS[0]), BY)
    assert run.complete and contents(tmp_path) == before


def test_lost_files_are_one_line_a_method_and_only_those_asked_for_are_planned_again(tmp_path):
    """Lost files: one line per method; only the requested methods are planned again (regression)."""
    both = manifest(methods=("baseline", "hybrid"))
    run = writer.begin(tmp_path, both)
    for method in both.methods:
        for span in SPANS:
            run = writer.add(run, method, span, *rows(method, span), BY)
    for file in tmp_path.glob("*/*.parquet"):
        file.unlink()
    with pytest.warns(UserWarning) as warned:
        run = writer.begin(tmp_path, manifest())
    first, second = (str(warning.message) for warning in warned)
    assert "baseline-000000-000001.parquet cannot be read" in first
    assert first.endswith("(and 1 more shards); scenarios 0 to 1, 2 to 3 are planned again by baseline")
    assert second.endswith("scenarios 0 to 1, 2 to 3 of hybrid are now unfinished")
    assert run.unfinished() == {"baseline": 4, "hybrid": 4}


def test_the_folder_of_a_plan_is_reported_from_one_that_holds_nothing(tmp_path):
    """Error for a plan's folder opened as a run: it names the commands for plans (regression: no manifest.json)."""
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(
        InputError,
        match="contains a plan of htcp plan, not a run; open it with htcp view, htcp render or htcp validate",
    ):
        open_run(tmp_path)


def test_a_stranger_among_the_results_is_named_and_left_alone(tmp_path):
    completed(tmp_path)
    (tmp_path / "targets" / "mine.parquet").write_bytes(b"mine")
    with pytest.warns(UserWarning, match=r"mine\.parquet does not belong to this run and is left unchanged"):
        assert writer.begin(tmp_path, manifest()).complete
    (tmp_path / "manifest.json").unlink()
    with pytest.raises(InputError, match=r"results without a manifest\.json"):
        writer.begin(tmp_path, manifest())


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"{}", b"\xff\xfe", b"null"])
def test_a_damaged_manifest_is_one_line(tmp_path, data):
    completed(tmp_path)
    (tmp_path / "manifest.json").write_bytes(data)
    with pytest.raises(InputError, match=r"manifest\.json is damaged or not a manifest of a run") as error:
        open_run(tmp_path)
    assert "\n" not in str(error.value)
    assert str(error.value).count("manifest.json") == str(error.value).count(" is damaged") == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"method": "baseline"', '"method": "../../outside"'),
        ('"planned_by": 0', '"planned_by": 5'),
        ('"last": 1', '"last": "x"'),
        ('"last": 1', '"last": 2'),
        ('"first": 2', '"first": 1'),
    ],
)
def test_a_manifest_cannot_lead_out_of_its_folder_or_contradict_itself(tmp_path, old, new):
    text = (completed(tmp_path).folder / "manifest.json").read_text()
    assert old in text
    (tmp_path / "manifest.json").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=r"is damaged or not a manifest of a run: (shards|Value error)"):
        open_run(tmp_path)


def test_a_folder_without_a_run_and_a_method_that_a_run_lacks_are_named(tmp_path):
    with pytest.raises(InputError, match=r"contains no run: cannot read manifest\.json"):
        open_run(tmp_path)
    with pytest.raises(InputError, match="has no results of 'hybrid'; it has baseline"):
        completed(tmp_path).targets("hybrid")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_a_full_or_read_only_disk_is_one_line_and_leaves_the_run_as_it_was(tmp_path, monkeypatch, code):
    run = writer.begin(tmp_path, manifest())

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(InputError, match=f"cannot write to .*: {os.strerror(code)}"):
        writer.add(run, "baseline", SPANS[0], *rows("baseline", SPANS[0]), BY)
    assert not contents(tmp_path) and not list(tmp_path.glob(".part-*"))
    assert open_run(tmp_path).missing("baseline") == [range(4)]


def test_other_software_is_warned_of(tmp_path):
    completed(tmp_path, BY | {"commit": "another"})
    with pytest.warns(UserWarning, match="and its plans are kept: commit was another, now "):
        writer.begin(tmp_path, manifest())


def test_two_sweeps_on_one_folder_are_refused(tmp_path):
    with locked(tmp_path):
        with pytest.raises(InputError, match=f"in use by another command: process {os.getpid()} on "):
            with locked(tmp_path):
                pass
    with locked(tmp_path):
        pass


def test_the_lock_of_a_dead_process_is_taken_over(tmp_path):
    holder = "import sys, time; from htcp_jax.system.lock import locked; from pathlib import Path\n"
    holder += "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", holder, str(tmp_path)], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match=f"process {process.pid} on "), locked(tmp_path):
            pass
        process.kill()
        process.wait()
        with locked(tmp_path):
            pass


def test_a_job_without_a_task_is_the_same_run_whatever_its_tolerance_of_angles():
    def of(**changed):
        config = PlanConfig().model_dump(mode="json") | changed
        return identity(config, [], "float64", {})

    settings = PlanConfig().model_dump(mode="json")["settings"]
    finer, row = settings | {"tolerance_rad": 1e-4}, {"point": "tcp", "on": "path"}
    assert of() == of(settings=finer) and "task" not in of()
    assert of(task=[row]) != of() and of(task=[row], settings=finer) != of(task=[row])
