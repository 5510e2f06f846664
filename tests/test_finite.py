"""Not finite is never valid: each number of a small run and of a plan is set to NaN, infinity and 1e308 in turn."""

import json
import shutil
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_plan import made_plan
from small_run import METHODS, toy_run

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.report.validation import read_validation
from htcp_jax.runs import columns, open_plans, open_run
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.plan_folder import TRAJECTORY, VALIDATION
from htcp_jax.runs.reachability_file import REACHABILITY, read_reachability
from htcp_jax.spec import TCP_ON_PATH
from htcp_jax.validation import task_check

WRONG = np.nan, np.inf, -np.inf, 1e308
ROW = 5  # of scenario 0, tracked


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """Folder with a run that is timed and has reachability bounds, and with a plan."""
    place = shutil.copytree(toy_run(), tmp_path_factory.mktemp("finite") / "place")
    (place / "run" / REACHABILITY).write_text(
        json.dumps({"prefix": [1] * 4, "most": [9] * 4, "resolution_rad": 0.1, "seed": 0})
    )
    assert main(["program", str(place / "run"), "--all", "--feed", "20mm/s"]) == 0
    assert main(["validate", str(place / "run"), "--between", "0"]) == 0
    made_plan(place / "job").save(place / "plan")
    return place


@pytest.fixture
def run(place, tmp_path) -> Path:
    return shutil.copytree(place / "run", tmp_path / "run")


def read_all(folder: Path) -> None:
    """Read all that commands read of a run."""
    run = open_run(folder)
    run.scenarios(), run.timing(METHODS[0]), run.plans(METHODS[0]), read_reachability(run)


def with_value(rows: pa.Table, name: str, value: float) -> pa.Table:
    """Table with another value in ROW of a column; a list gets it as its first number."""
    place, field, values = rows.schema.get_field_index(name), rows.schema.field(name), rows[name].to_pylist()
    row = min(ROW, len(rows) - 1)
    values[row] = [value, *(values[row] or [0.0])[1:]] if pa.types.is_list(field.type) else value
    return rows.set_column(place, field, pa.array(values, field.type, from_pandas=False))


def written(file: Path, rows: pa.Table) -> None:
    """Write a table, and make the manifest agree with it."""
    pq.write_table(rows, file)
    folder = file.parents[1]
    manifest = json.loads((folder / MANIFEST).read_text())
    for shard in manifest["shards"]:
        if file.name.startswith(f"{shard['method']}-{shard['first']:06d}") and file.parent.name in shard:
            shard[file.parent.name] |= {"bytes": file.stat().st_size, "sha256": sha256(file.read_bytes()).hexdigest()}
    (folder / MANIFEST).write_text(json.dumps(manifest))


@pytest.mark.parametrize("table", ["targets", "scenarios", "timing"])
def test_a_number_of_a_table_that_is_not_finite_is_an_error_with_its_place(run, table):
    file, joints = next(iter(sorted((run / table).glob("*.parquet")))), open_run(run).manifest.joints
    good, count = pq.read_table(file), 0
    names = [f.name for f in good.schema if pa.types.is_floating(f.type) or pa.types.is_list(f.type)]
    for name in names:
        needed = columns.needed_in(name, table, joints)
        row = min(ROW, len(good) - 1)
        for value in WRONG:
            written(file, with_value(good, name, value))
            if np.isnan(value) and needed is None and not pa.types.is_list(good.schema.field(name).type):
                read_all(run)  # an unknown value, as null
                continue
            with pytest.raises(InputError) as error:
                read_all(run)
            assert all(part in str(error.value) for part in (str(file), name, f"row {row} (scenario")), error.value
            count += 1
    written(file, good)
    read_all(run)
    assert count > 3 * len(names) - 1


def test_an_array_of_a_plan_that_is_not_finite_is_an_error_with_its_place(place, tmp_path):
    folder = shutil.copytree(place / "plan", tmp_path / "plan")
    with np.load(folder / TRAJECTORY) as file:
        good = {name: file[name] for name in file}
    good |= {"via_point_target": np.ones(1, np.int32), "via_point_x": good["x"][:1], "via_point_share": np.zeros(1)}
    nullable = "orientation_error", "segment_clearance"  # no angles in the task, and no proof in this plan
    for name, array in good.items():
        if name == "joint_names":
            continue
        for value in WRONG:
            wrong = array.astype(float)
            wrong.reshape(len(wrong), -1)[0, -1] = value
            np.savez(folder / TRAJECTORY, **good | {name: wrong})
            if np.isnan(value) and name in nullable:
                open_plans(folder)
                continue
            with pytest.raises(InputError, match=rf"{TRAJECTORY}.*({name}|via point)"):
                open_plans(folder)


def leaves(value, path: tuple = ()) -> Iterator[tuple]:
    """Paths of all numbers in a JSON value."""
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*path, key))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


@pytest.mark.parametrize(
    ("name", "read"),
    [(MANIFEST, open_run), (VALIDATION, lambda folder: read_validation(open_run(folder))), (REACHABILITY, read_all)],
)
def test_a_number_of_a_json_file_that_is_not_finite_is_an_error_that_names_the_file(run, name, read: Callable):
    good = json.loads((run / name).read_text())
    for path in leaves(good):
        for value in ("NaN", "Infinity", "1e308"):
            wrong = json.loads(json.dumps(good))
            inner = wrong
            for key in path[:-1]:
                inner = inner[key]
            inner[path[-1]] = "here"
            (run / name).write_text(json.dumps(wrong).replace('"here"', value, 1))
            with pytest.raises(InputError, match=f"{name} is damaged.*{value}"):
                read(run)


@pytest.mark.parametrize("command", ["report", "validate", "view", "render", "program"])
def test_a_command_refuses_a_run_with_a_number_that_is_not_finite_in_a_line(run, tmp_path, capsys, command):
    file = next(iter(sorted((run / "targets").glob("*.parquet"))))
    written(file, with_value(pq.read_table(file), "clearance_m", np.inf))
    out = {"view": ["--port", "0"], "validate": []}.get(command, ["--out", str(tmp_path / "out.csv")])
    assert main([command, str(run), *out, *(["--feed", "20mm/s"] if command == "program" else [])]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1 and f"{file}: clearance_m is inf in row {ROW} (scenario 0, target {ROW})" in said[0]
    assert not (tmp_path / "out.csv").exists()


def test_a_deviation_that_is_no_number_violates_its_row():
    row = task_check.RowCheck(TCP_ON_PATH, np.array([np.nan, 0.0]), np.full(2, 1e-3))
    assert "deviates by nan mm" in row.reason(0) and row.reason(1) is None and not row.unchecked
