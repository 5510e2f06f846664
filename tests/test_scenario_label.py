"""Labels of a run's scenarios name the parameters that vary, and only these."""

import pyarrow as pa
from small_run import LONGER

from htcp_jax.runs import open_run
from htcp_jax.runs.labels import labels_of, parameter_names, part
from htcp_jax.runs.tables import empty_tables
from htcp_jax.viewer.replay import open_replays


def test_scenarios_are_named_by_what_varies_in_their_run(planned):
    """Labels of scenarios by the parameters that vary (regression: only the data files had the values)."""
    labels = labels_of(open_run(planned / "run").scenarios())
    assert labels == {
        0: "rotation y 0.4 rad, tool extension 0 m",
        1: "rotation y 0.5 rad, tool extension 0 m",
        2: f"rotation y 0.4 rad, tool extension {LONGER} m",
        3: f"rotation y 0.5 rad, tool extension {LONGER} m",
    }


def test_a_shelf_knows_the_labels_of_its_run(planned):
    assert open_replays(planned / "run").label(3) == f"3: rotation y 0.5 rad, tool extension {LONGER} m"


def test_any_column_that_is_no_result_is_a_parameter():
    table = {
        "scenario": [0, 1],
        "group": ["a", "b"],
        "tracked": [3, 4],
        "cloud": ["x.npy", "y.npy"],
        "margin_m": [1, 1],
    }
    assert labels_of(pa.table(table)) == {0: "a: cloud x.npy", 1: "b: cloud y.npy"}


def test_no_result_of_a_sweep_is_a_parameter():
    """Parameters of a run: inputs only, no results such as executable targets or smoothness."""
    table = empty_tables(("joint1_rad",))["scenarios"]
    own = "rotation_x_rad rotation_y_rad rotation_z_rad shift_x_m shift_y_m shift_z_m tool_extension_m margin_m path"
    assert parameter_names(table) == ["start_joint1_rad", *own.split()]


def test_parameters_that_go_together_are_reported_once():
    table = {"scenario": [0, 1], "group": [None, None], "rotation_y_rad": [0.1, 0.2], "rotation_z_rad": [0.3, 0.4]}
    assert labels_of(pa.table(table)) == {0: "rotation y 0.1 rad", 1: "rotation y 0.2 rad"}


def test_numbers_are_short_and_carry_their_unit():
    assert part("shift_z_m", -0.1) == "shift z -0.1 m"
    assert part("start_joint3_rad", 0.1 + 0.2) == "start joint3 0.3 rad"
    assert part("path", "seam.csv") == "path seam.csv"
