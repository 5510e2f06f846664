"""Protects the metadata of Parquet files: any library that reads them finds origin, units and descriptions."""

import json

import pyarrow.parquet as pq
import pytest

from htcp_jax.runs import columns, open_run
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
