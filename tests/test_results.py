"""Files of a plan: they read back exactly, and none is ever half-written."""

import csv
import json

import numpy as np
import pytest
from hand_made import plans_with

from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import gp50
from htcp_jax.runs.plan_folder import (
    summary_record,
    write_trajectory_csv,
    write_trajectory_npz,
)
from htcp_jax.runs.provenance import provenance
from htcp_jax.runs.summary import summarise
from htcp_jax.status import Status
from htcp_jax.system.output_files import write_json, written_whole

PLANS = plans_with([[Status.TRACKED, Status.RECOVERY_EXHAUSTED, Status.NOT_ATTEMPTED]], joints=6)


def test_the_csv_reads_back_exactly_and_leaves_the_unknown_empty(tmp_path):
    plans = PLANS._replace(x=PLANS.x + np.pi / 7)
    write_trajectory_csv(tmp_path / "t.csv", gp50(), plans, plans.residual[0])
    with open(tmp_path / "t.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["status"] for row in rows] == ["TRACKED", "RECOVERY_EXHAUSTED", "NOT_ATTEMPTED"]
    joints = [f"{name}_rad" for name in gp50().joint_names]
    assert [float(rows[0][joint]) for joint in joints] == plans.x[0, 0].tolist()
    assert float(rows[0]["clearance_m"]) == plans.clearance[0, 0]
    assert rows[1]["clearance_m"] == rows[1][joints[0]] == "" != rows[1]["target_x_m"]


def test_the_npz_holds_every_array_without_pickles(tmp_path):
    write_trajectory_npz(tmp_path / "t.npz", gp50(), PLANS)
    with np.load(tmp_path / "t.npz", allow_pickle=False) as arrays:
        assert tuple(arrays["joint_names"]) == gp50().joint_names
        for name, value in PLANS._asdict().items():
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(arrays[name], value[0])


def test_the_summary_is_strict_json_with_reasons_in_words(tmp_path):
    nothing = summarise(plans_with([[Status.QP_FAILED]]))
    write_json(tmp_path / "s.json", {**summary_record(nothing), **provenance()})
    record = json.loads((tmp_path / "s.json").read_text(), parse_constant=pytest.fail)
    assert record["clearance_min_mm"] is None
    assert record["failures"][0]["reason"] == Status.QP_FAILED.message
    assert record["dtype"] == "float64" and record["versions"]["jax"]


def test_files_move_into_place_together_and_others_there_stay(tmp_path):
    out = tmp_path / "a" / "out"
    for text in ("old", "new"):
        with written_whole(out) as scratch:
            (scratch / "file").write_text(text)
    (out / "mine").write_text("kept")
    assert sorted(path.name for path in out.iterdir()) == ["file", "mine"]
    assert (out / "file").read_text() == "new"


def test_a_failure_leaves_no_trace(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(ZeroDivisionError), written_whole(out) as scratch:
        (scratch / "file").write_text("half")
        raise ZeroDivisionError
    assert not out.exists()


def test_a_folder_that_cannot_be_written_is_named_before_the_work_begins(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot write to .*file: "), written_whole(tmp_path / "file"):
        pytest.fail("the block must not be entered")
