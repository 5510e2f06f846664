"""Random axes of a sweep's grid."""

import numpy as np
import pytest
import toy

from htcp_jax.errors import InputError
from htcp_jax.jobs.draws import normal, uniform
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.runs import open_run
from htcp_jax.runs.input_files import recorded_inputs
from htcp_jax.runs.sweep import sweep

DRAWN = {"uniform": [-0.1, 0.1], "count": 4}


@pytest.fixture
def job(tmp_path, monkeypatch):
    """The keys of a sweep of the toy arm's job, without a grid."""
    monkeypatch.chdir(tmp_path)
    toy.write_job(tmp_path, 3, shift_m=(0.45, 0.02, 0.0))
    return {"config": "job.yaml"}


def values(job: dict, name: str, *axes: dict, seed: int = 0) -> tuple:
    """Return the values of one parameter of a grid."""
    spec = load_sweep({**job, "grid": list(axes)}, overrides={"settings.seed": seed})
    columns = (column for axis in spec.groups[0].axes for column in axis)
    return next(column.values for column in columns if column.parameter.name == name)


def test_draws_depend_on_seed_and_key_and_not_on_other_axes(job):
    one, name = {"workpiece.rotation_y_rad": DRAWN}, "workpiece.rotation_y_rad"
    alone = values(job, name, one)
    assert len(alone) == 4 and all(-0.1 < value < 0.1 for value in alone)
    assert values(job, name, {"workpiece.rotation_z_rad": DRAWN}, one) == alone
    assert values(job, name, one | {"workpiece.rotation_z_rad": DRAWN}) == alone
    assert values(job, name, {name: DRAWN | {"count": 9}})[:4] == alone
    assert values(job, name, one, seed=1) != alone
    assert values(job, "workpiece.rotation_z_rad", {"workpiece.rotation_z_rad": DRAWN}) != alone
    assert values(job, "start_rad.j3", {"start_rad.3": {"offsets": DRAWN}}) == values(
        job, "start_rad.j3", {"start_rad.j3": DRAWN}
    )


def test_draws_have_the_stated_distribution():
    flat, bell = np.array(uniform(3, "a", 2.0, 4.0, 4000)), np.array(normal(3, "a", 2.0, 0.5, 4000))
    np.testing.assert_allclose([flat.mean(), flat.std()], [3.0, 2 / 12**0.5], atol=0.03)
    np.testing.assert_allclose([bell.mean(), bell.std(), np.mean(abs(bell - 2) < 0.5)], [2.0, 0.5, 0.683], atol=0.03)


def test_drawn_values_are_in_the_table_and_the_run_is_continued(job, tmp_path):
    grid = {**job, "grid": [{"start_rad.j3": {"offsets": DRAWN}, "start_rad.j2": {"offsets": DRAWN}}]}
    run = sweep(grid, "baseline", tmp_path / "run", limit=2)
    run = sweep(grid, "baseline", tmp_path / "run")
    base = load_sweep(grid)
    offsets = values(job, "start_rad.j3", *grid["grid"])
    found = run.scenarios()["start_j3_rad"].to_numpy()
    np.testing.assert_allclose(found - base.config.start_rad[2], offsets, atol=1e-12)
    assert [point.config.start_rad[2] for point in run.points()] == found.tolist()
    with pytest.raises(InputError, match=r"settings\.seed was 0, now 1"):
        sweep(grid, "baseline", tmp_path / "run", seed=1)


def test_the_manifest_states_the_distribution_of_a_random_axis(job, tmp_path):
    axes = [{"start_rad.3": {"offsets": DRAWN}, "margin_m": {"normal": [0.001, 1e-5], "count": 4}}]
    sweep({**job, "grid": axes}, "baseline", tmp_path / "run", limit=1, seed=11)
    manifest = open_run(tmp_path / "run").manifest
    assert [axis.text(manifest.seed) for axis in manifest.drawn] == [
        "start_rad.j3: offsets uniform in [-0.1, 0.1], 4 values, seed 11",
        "margin_m: normal, mean 0.001, standard deviation 1e-05, 4 values, seed 11",
    ]
    assert manifest.drawn[0].distribution_text == "drawn, offsets uniform in [-0.1, 0.1]"


def test_a_run_with_drawn_values_is_that_with_the_same_values_in_a_list(job):
    name = "workpiece.rotation_y_rad"
    drawn, listed = ({**job, "grid": [{name: each}]} for each in (DRAWN, [*values(job, name, {name: DRAWN})]))
    a, b = (recorded_inputs(load_sweep(each)) for each in (drawn, listed))
    assert a == b


def test_a_drawn_start_outside_the_limits_is_refused_with_a_remedy(job):
    spec = load_sweep({**job, "grid": [{"start_rad.3": {"normal": [0.5, 30], "count": 4}}]})
    line = r"start: j3 at \S+ is outside its limits .*; its values are drawn: choose a smaller SIGMA, or uniform"
    with pytest.raises(InputError, match=line):
        spec.batch()


def test_a_joint_zero_is_refused_as_joints_are_counted_from_1(job):
    with pytest.raises(InputError, match=r"counted from 1; valid: start_rad\.1 to start_rad\.4"):
        load_sweep({**job, "grid": [{"start_rad.0": [0.1]}]})


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("margin_m", {"uniform": [0.2, 0.1], "count": 3}, "LOW must be less than HIGH in uniform"),
        ("margin_m", {"normal": [0.2, 0.0], "count": 3}, "SIGMA must be positive in normal"),
        ("margin_m", {"uniform": [0.1], "count": 3}, r"uniform needs two numbers, \[LOW, HIGH\], not \[0.1\]"),
        ("margin_m", {"uniform": [0.1, 0.2]}, "a random axis has one of uniform and normal, and count; no other key"),
        ("margin_m", {"uniform": [0.1, 0.2], "normal": [0, 1], "count": 3}, "a random axis has one of uniform and"),
        ("margin_m", {"uniform": [0.1, 0.2], "count": 0}, "count is 0; valid: 1 to 1,000,000"),
        (
            "margin_m",
            {"gaussian": [0.1, 0.2], "count": 2},
            r"count: N\}, \{offsets: \{uniform: \.\.\.\}\} or",
        ),
        ("start_rad", {"uniform": [0.1, 0.2], "count": 2}, "start_rad cannot be drawn: only single numbers"),
        ("settings.beam_width", {"uniform": [1, 9], "count": 2}, "settings.beam_width cannot be drawn"),
        ("workpiece.cloud", {"uniform": [1, 9], "count": 2}, "workpiece.cloud cannot be drawn"),
    ],
)
def test_a_wrong_random_axis_is_refused_in_one_line(job, key, value, text):
    with pytest.raises(InputError, match=text) as refused:
        load_sweep({**job, "grid": [{key: value}]})
    assert "\n" not in str(refused.value)
