"""Sweep files: the scenarios of a grid, and one-line errors for mistakes."""

from pathlib import Path

import numpy as np
import pytest

from htcp_jax.errors import InputError
from htcp_jax.jobs.build import scene
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.jobs.load_config import load_config

SWEEPS = Path(__file__).parents[1] / "sweeps"
HUGE = "grid:\n" + "".join(f"  - start_rad.{k}: {[0.1] * 11}\n" for k in range(1, 7))
START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)


def written(tmp_path, text: str) -> Path:
    file = tmp_path / "grid.yaml"
    file.write_text(text)
    return file


@pytest.mark.parametrize(("name", "size"), [("robot", 125), ("workpiece", 49), ("cross", 6125), ("measuring", 174)])
def test_the_shipped_sweeps_have_the_sizes_of_the_scene_and_no_scenario_twice(name, size):
    points = load_sweep(SWEEPS / f"{name}.yaml").points()
    assert len(points) == size and [point.number for point in points] == list(range(size))
    parts = [point.config.workpiece for point in points]
    poses = [(part.rotation_y_rad, part.rotation_z_rad) for part in parts]
    assert len({(point.group, point.config.start_rad, pose) for point, pose in zip(points, poses, strict=True)}) == size


def test_the_robot_sweep_moves_joints_3_4_5_about_the_paper_s_start():
    starts = np.array([point.config.start_rad for point in load_sweep(SWEEPS / "robot.yaml").points()])
    np.testing.assert_allclose(starts.mean(axis=0), START, atol=1e-12)
    np.testing.assert_allclose(starts[-1] - START, [0, 0, 0.2, 0.2, 0.2, 0], atol=1e-12)


def test_the_workpiece_sweep_turns_about_y_around_a_half_and_about_z_around_nothing():
    parts = [point.config.workpiece for point in load_sweep(SWEEPS / "workpiece.yaml").points()]
    poses = np.array([(part.rotation_y_rad, part.rotation_z_rad) for part in parts])
    np.testing.assert_allclose(
        (poses.mean(axis=0), poses[0], poses[1]), [(0.5, 0), (0.2, -0.3), (0.2, -0.2)], atol=1e-12
    )


def test_the_measuring_sweep_is_both_grids_with_joint_6_at_0():
    points = load_sweep(SWEEPS / "measuring.yaml").points()
    assert [point.group for point in points] == ["poses"] * 49 + ["starts"] * 125
    assert {point.config.start_rad[5] for point in points} == {0.0}


def test_axes_multiply_columns_go_together_and_later_axes_act_on_what_earlier_ones_left(tmp_path):
    text = """
    grid:
      - start_rad: [[0, -2, 0, 0, 0, 0], [0, -1, 0, 0, 0, 0]]
      - start_rad.2: {offsets: [0.25, 0.5]}
        workpiece.shift_m.z: {values: [1, 2]}
        margin_m: [0, 0.001]
    """
    jobs = [point.config for point in load_sweep(written(tmp_path, text)).points()]
    assert [job.start_rad[1] for job in jobs] == [-1.75, -1.5, -0.75, -0.5]
    assert [job.workpiece.shift_m for job in jobs] == [(0, 0, 1), (0, 0, 2)] * 2
    assert [job.margin_m for job in jobs] == [0, 0.001] * 2


def test_offsets_are_from_the_configuration_which_the_command_line_may_change(tmp_path):
    (tmp_path / "job.yaml").write_text("margin_m: 0.25\n")
    file = written(tmp_path, "config: job.yaml\ngrid: [{margin_m: {offsets: [0.5]}, start_rad.joint1: [1]}]")
    assert [load_sweep(file, None, change).points()[0].config.margin_m for change in ((), ["margin_m=0.5"])] == [
        0.75,
        1.0,
    ]
    assert load_sweep(file, SWEEPS.parent / "configs" / "paper.yaml").points()[0].config.margin_m == 0.5


def test_a_base_file_may_be_an_example(tmp_path):
    (tmp_path / "pipe").mkdir()  # as `htcp example pipe pipe` leaves it: a folder is no base file
    (tmp_path / "mine.yaml").write_text("config: pipe\nmargin_m: 0.25\n")
    sweeps = [written(tmp_path, f"config: {name}\ngrid: [{{margin_m: [0.125]}}]") for name in ("pipe", "mine.yaml")]
    by_example, by_file = (load_sweep(sweep).points()[0].config for sweep in sweeps)
    assert by_example == by_file == load_config("pipe", ["margin_m=0.125"])


def test_scenarios_of_one_batch_may_differ_in_path_tool_and_pose(tmp_path):
    (tmp_path / "path.csv").write_text("0.2,-0.17,0.17\n")
    text = """
    grid:
      - workpiece.path: [weld, path.csv]
        robot.tool_extension_m: [0, 0.01]
        workpiece.shift_m: [[0, 0, 0], [0, 0, 0.01]]
    """
    batch = load_sweep(written(tmp_path, text)).batch()
    assert batch.scenarios.count.tolist() == [105, 12] and batch.scenarios.number.tolist() == [0, 1]
    assert batch.scenarios.tool_extension_m.tolist() == [0, 0.01]
    np.testing.assert_allclose(
        batch.scenarios.T_world_workpiece[1, 2, 3] - batch.scenarios.T_world_workpiece[0, 2, 3], 0.01
    )


def test_scenarios_with_one_start_begin_where_their_own_arm_tool_and_task_have_them_begin(tmp_path):
    """Compare with single scenarios: shared parts are computed once, and each scenario is the same as alone."""
    file = written(
        tmp_path,
        "grid:\n"
        "  - workpiece.rotation_z_rad: [0.1, -0.1]\n"
        "  - robot.tool_extension_m: [0.0, 0.02]\n"
        "  - robot.base_m.z: [0.0, 0.05]\n"
        "  - task.1.offset_m: [[0.01, 0, 0], [0.02, 0, 0]]\n"
        "  - start_rad.3: [0.5, 0.4]\n",
    )
    (tmp_path / "path.csv").write_text("1.0,-0.2,1.0\n1.01,-0.2,1.0\n")
    part = {"cloud": "none", "path": str(tmp_path / "path.csv")}
    batch = load_sweep(file, {"workpiece": part, "task": [{"point": "tcp", "on": "path"}]}).batch()
    assert len({row.tobytes() for row in batch.scenarios.targets[:, 0]}) == 16  # of 32 scenarios
    for point in batch.points:
        _, _, alone = scene(point.config)
        np.testing.assert_array_equal(batch.scenarios.targets[point.number], alone.targets)


def test_a_limit_takes_the_first_scenarios():
    sweep = load_sweep(SWEEPS / "workpiece.yaml")
    assert sweep.points(3) == sweep.points()[:3] and len(sweep.batch(2).scenarios.number) == 2


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("{}", "a sweep must have either `grid`"),
        ("grid: []", "grid is empty"),
        ("groups: {}", "groups is empty"),
        ("groups: {a: []}", "groups.a is empty"),
        ("grid: [{}]", "axis 1 is empty"),
        ("grid: [margin_m: []]", "grid, axis 1: margin_m has no values"),
        ("grid: [margin_m: 1]", "margin_m needs a list of values"),
        ("grid: [margin_m: {offset: [1]}]", "margin_m needs a list of values"),
        ("grid: [margin: [1]]", "grid, axis 1: unknown parameter margin; did you mean margin_m or margin_on?"),
        (
            "grid: [start_rad.7: [1]]",
            "unknown parameter start_rad.7; joints are counted from 1; valid: start_rad.1 to",
        ),
        (
            "grid: [cell.obstacles: [[], []]]",
            "cell.obstacles is a list, which cannot vary; write one job file per list",
        ),
        ("grid: [settings.zzz: [1]]", "valid: any key of the configuration but method, program and ray"),
        ("grid: [{margin_m: [0, 1], start_rad.1: [0]}]", "margin_m has 2 values, start_rad.joint1 has 1 values"),
        ("grid: [{start_rad.3: [0]}, {start_rad.joint3: [0]}]", "start_rad.joint3 is repeated"),
        ("grid: [margin_m: [true]]", "margin_m takes finite numbers, not True"),
        ("grid: [margin_m: [.nan]]", "margin_m takes finite numbers, not nan"),
        ("grid: [start_rad: [0]]", "start_rad takes lists of numbers, not 0"),
        ("grid: [workpiece.path: {offsets: [a]}]", "workpiece.path takes names of files"),
        ("grid: [margin_m: [-1]]", "scenario 0: margin_m is -1"),
        ("grid: [start_rad: [[0, 0]]]", "scenario 0: start has 2 joint positions"),
        ("grid: [start_rad.1: [0, 9]]", "scenario 1: start: joint1 at 9 is outside its limits"),
        ("grid: [workpiece.path: [none.csv]]", "none.csv: no such file"),
        ("gird: []", "unknown key gird; did you mean grid?"),
        ("grid: 3", "grid is 3: "),
        (HUGE, "the grid has 1,771,561 scenarios; at most 1,000,000"),
    ],
)
def test_what_is_wrong_in_a_sweep_file_is_one_line(tmp_path, text, line):
    with pytest.raises(InputError) as error:
        load_sweep(written(tmp_path, text)).batch()
    assert line in str(error.value) and "\n" not in str(error.value)
