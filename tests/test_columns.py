"""Protects the columns: one heading by key in all tables; origin, units and descriptions in Parquet files."""

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import htcp_jax
from htcp_jax.runs import Column, columns, open_run
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.timing_file import SCHEMA


@pytest.mark.parametrize("table", ["targets", "scenarios"])
def test_every_column_of_a_run_has_a_description_and_those_with_a_unit_state_it(planned, table):
    schema = pq.read_schema(next((planned / "run" / table).glob("*.parquet")))
    about = {field.name: {k.decode(): v.decode() for k, v in field.metadata.items()} for field in schema}
    varied = open_run(planned / "run").varied
    general = [name for name, each in about.items() if each["description"].startswith("value of the job's key")]
    assert general == [name for name in about if name in varied]
    assert about["tcp_x_m" if table == "targets" else "shift_y_m"]["unit"] == "m"
    assert "unit" not in about["method"]


def test_a_file_names_its_run_and_what_planned_it(planned):
    run = open_run(planned / "run")
    schema = pq.read_schema(next((planned / "run" / "targets").glob("*.parquet")))
    made = json.loads(schema.metadata[columns.WRITTEN_BY])
    assert made == {"run": run.manifest.name, **run.manifest.planned_by[0]}
    assert made["commit"] == planned_by()["commit"]


def test_every_column_of_times_has_a_description():
    assert set(SCHEMA.names) == set(columns.TIMING)


@pytest.mark.parametrize(
    ("column", "unit"),
    [("joint1_rad", "rad"), ("rail_m", "m"), ("feed_m_s", "m/s"), ("cycle_time_s", "s"), ("motion_cost_rad2", "rad2"),
     ("curvature_max_rad_m2", "rad/m2"), ("jerk_share", "1"), ("status", ""), ("via_points", "rad, m")],
)  # fmt: skip
def test_units_follow_the_names_of_columns(column, unit):
    assert columns.unit_of(column, ("joint1_rad", "rail_m")) == unit


@pytest.mark.parametrize(
    ("key", "title", "text"),
    [
        ("tracked", "tracked [targets]", "1,234"), ("step_ms", "time/target [ms]", "1234.00"),
        ("clearance_min_mm", "clearance [min mm]", "1.23e+03"), ("cycle_mean_s", "cycle time [mean s]", "1234.000"),
        ("tcp_distance_mean_mm", "TCP distance [mean mm]", "1.23e+03"),
        ("tracked_percent", "targets [tracked %]", "1234.00"),
        ("complete_percent", "scenarios [complete %]", "1234.00"),
        ("curvature_median_rad_m2", "curvature [median rad/m2]", "1,234"), ("reason", "reason", "1234"),
    ],
)  # fmt: skip
def test_heading_unit_and_format_follow_from_the_key(key, title, text):
    column = columns.column(key)
    assert (column.title, column.text(1234)) == (title, text)
    assert column.text(None) == column.text(float("nan")) == "-"


def test_the_statistics_of_a_quantity_have_the_heading_of_the_quantity():
    assert {columns.column(f"cycle_{name}_s").heading for name in columns.STATISTICS} == {"cycle time"}


def test_two_joint_steps_that_count_different_segments_have_different_headings():
    assert columns.column("path_step_max_rad").heading != columns.column("step_max_rad").heading


def test_short_forms_keep_the_heading():
    was, now = columns.before_and_now("clearance_min_mm")
    assert (was.key, was.title) == ("was_clearance_min_mm", "clearance [before min mm]")
    assert (now.key, now.title) == ("clearance_min_mm", "clearance [now min mm]")
    assert [one.title for one in columns.before_and_now("tracked")] == ["tracked [before]", "tracked [now]"]
    assert columns.listed("targets", "scenarios").heading == "targets" and columns.total("targets").heading == "of"


def test_no_other_module_gives_a_heading_to_a_key():
    """One heading by key, wherever it is shown (regression: 21 keys had several, such as time/step and time/target)."""
    package = Path(htcp_jax.__file__).parent
    others = [file for file in package.rglob("*.py") if file != Path(columns.__file__)]
    assert len(others) > 300 and not [f"{file}:{line}" for file in others for line in headings_in(file.read_text())]


def headings_in(source: str) -> Iterator[int]:
    """Lines that make a `Column` of a fixed key, or replace a column's heading by a fixed text."""
    for call in ast.walk(ast.parse(source)):
        if isinstance(call, ast.Call):
            named = {each.arg: each.value for each in call.keywords}
            given = call.args[:1] or [named.get("key")]
            makes = ast.unparse(call.func).rpartition(".")[2] == Column.__name__ and isinstance(given[0], ast.Constant)
            if makes or isinstance(named.get("heading"), ast.Constant):
                yield call.lineno


def test_a_second_heading_is_noticed():
    source = (
        'a = Column("tracked", "now")\nb = columns.Column(key="p")\nc = a._replace(heading="b")\nd = Column(name, name)'
    )
    assert list(headings_in(source)) == [1, 2, 3]
