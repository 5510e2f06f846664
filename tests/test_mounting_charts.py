"""Results of a mounting search: the map shows every mounting, the Pareto front the best, and the folder opens."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.placement.ranges import parameter
from htcp_jax.report.charts.placement import MARKS, place_map, place_pareto_front
from htcp_jax.report.place_tables import read_search
from htcp_jax.runs import open_plans

NAMES = [
    *("workpiece.rotation_y_rad", "workpiece.shift_m.x", "workpiece.shift_m.y", "robot.tool_extension_m"),
    *("robot.base_m.x", "robot.base_m.y", "robot.base_m.z", "task.2.cone_deg", "cell.1.height_m"),
]
LOST = ["iteration limit"] * 20 + ["QP infeasible"] * 10 + ["path blocked"] * 5
COMPLETE, NEARLY = 25, 4


def write_search(folder, d, objectives=("clearance",), ranked=3, complete=COMPLETE):
    """Folder of a finished search: `complete` mountings complete the path, NEARLY others nearly do."""
    rng, n = np.random.default_rng(d), complete + len(LOST)
    values = rng.random((n, d))
    columns = {"round": np.zeros(n, int)} | {name: values[:, k] for k, name in enumerate(NAMES[:d])}
    columns["done"] = np.concatenate([np.ones(complete), np.full(NEARLY, 0.95), np.full(n - complete - NEARLY, 0.4)])
    columns["complete"] = np.arange(n) < complete
    for objective_name in objectives:
        columns[objective_name.replace(" ", "_")] = pa.array(rng.random(n) * 1e-2, mask=np.arange(n) >= complete)
    columns["lost"] = [None] * complete + LOST
    folder.mkdir()
    pq.write_table(pa.table(columns), folder / "mountings.parquet")
    rows = [
        {
            "parameters": dict(zip(NAMES, values[k].tolist(), strict=False)),
            "objective": {objective_name: (k + 1) * (-1) ** j for j, objective_name in enumerate(objectives)},
            "worst_objective": dict.fromkeys(objectives),
            "pareto_front": k != 1,
            "margin_m": 5e-4,
        }
        for k in range(ranked)
    ]
    seams = {"weld": {"complete": complete, "in_the_best": 1.0}}
    reported = {
        "name": "made",
        "scenarios": n,
        "complete": complete,
        "seams": seams,
        "objective": list(objectives),
        "ranked": rows,
    }
    reported["finished"] = True
    (folder / "ranked.json").write_text(json.dumps(reported))
    (folder / "place.json").write_text(json.dumps({"seams": [], "perturbation": {"mm": 3.0, "deg": 0.5}}))
    return folder


def written(axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize(("d", "panels"), [(1, 1), (2, 1), (3, 3), (6, 15), (9, 28)])
def test_each_panel_of_the_map_shows_every_mounting_once(tmp_path, d, panels):
    found = read_search(write_search(tmp_path / "made", d))
    figure = place_map(found)
    figure.canvas.draw()
    maps = [axes for axes in figure.axes if len(axes.collections) == len(set(LOST)) + 3]
    assert len(maps) == panels
    for axes in maps:
        *scores, ranked = [len(dots.get_offsets()) for dots in axes.collections]
        assert sum(scores) == COMPLETE + len(LOST) and ranked == 3 and written(axes)[0] == "1"


@pytest.mark.parametrize("d", (1, 3, 6, 9))
def test_no_heading_of_the_map_is_cut_next_to_long_names_of_bodies(tmp_path, d):
    bodies = {"link_6_t (tool.torch_3)": 41, "upper_arm_and_counterweight (tool.torch_10)": 23}
    figure = place_map(read_search(write_search(tmp_path / "made", d)), bodies)
    figure.canvas.draw()
    width, height = figure.canvas.get_width_height()
    headings = [text for axes in figure.axes for text in (axes.title, axes._left_title, axes._right_title)]
    shown = [text.get_window_extent() for text in (*headings, *figure.texts) if text.get_text()]
    assert len(shown) == 4 and all(box.x0 >= 0 and box.x1 <= width and box.y1 <= height for box in shown)


def test_the_map_counts_what_works_what_nearly_does_and_what_blocks_elsewhere(tmp_path):
    figure = place_map(read_search(write_search(tmp_path / "made", 3)), {"forearm": 7, "tool": 2})
    bars = {axes.get_title(loc="right"): axes for axes in figure.axes if axes.patches}
    words = [label.get_text() for label in bars["mountings"].get_yticklabels()]
    counts = [int(text) for text in written(bars["mountings"])]
    assert words == [
        "complete",
        "nearly complete: 90 % of the targets",
        "iteration limit",
        "QP infeasible",
        "path blocked",
    ]
    assert counts == [COMPLETE, NEARLY, 20 - NEARLY, 10, 5]
    assert [int(text) for text in written(bars["colliding body (9 failed)"])] == [7, 2]


def test_the_map_is_drawn_where_nothing_works(tmp_path):
    found = read_search(write_search(tmp_path / "made", 2, ranked=0, complete=0))
    figure = place_map(found)
    figure.canvas.draw()
    assert len(found.ranked) == 0 and len(figure.axes[0].collections) == len(set(LOST)) + 3


def test_mountings_are_drawn_of_which_nobody_knows_yet_the_objective(tmp_path):
    found = read_search(write_search(tmp_path / "made", 2))
    (axes, *_) = place_map(found._replace(left=np.full_like(found.left, np.nan))).axes
    works = axes.collections[-2]
    axes.figure.canvas.draw()
    assert len(works.get_offsets()) == COMPLETE and (works.get_facecolors()[:, 3] == 1).all()


def test_more_reasons_than_marks_share_the_last(tmp_path):
    found = read_search(write_search(tmp_path / "made", 2))
    many = found._replace(lost=tuple(f"reason {k}" if words else "" for k, words in enumerate(found.lost)))
    place_map(many).canvas.draw()
    assert len(set(filter(None, many.lost))) > len(MARKS)


def test_the_pareto_front_joins_what_none_beats_and_every_axis_has_its_unit(tmp_path):
    found = read_search(write_search(tmp_path / "made", 2, ("clearance", "joint motion")))
    (axes,) = place_pareto_front(found).axes
    (line,) = [line for line in axes.lines if line.get_marker() == "o"]
    assert line.get_xydata().tolist() == [
        [1000.0, 1.0],
        [3000.0, 3.0],
    ]  # in display units: mm, and rad with a positive sign
    assert written(axes) == ["1", "2", "3"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("clearance [mm]", "joint motion [rad]")


def test_parameters_are_reported_as_a_person_reads_them():
    reported = [parameter(name).label for name in NAMES]
    assert reported[:2] == ["rotation y [°]", "shift x [mm]"] and reported[3] == "tool extension [mm]"
    assert reported[7:] == ["task 2 cone [°]", "cell 1 height [mm]"]
    assert np.isclose(parameter(NAMES[0]).scale, 180 / np.pi) and parameter(NAMES[1]).scale == 1000


def test_what_is_no_search_is_refused_in_a_line(tmp_path, capsys):
    folder = write_search(tmp_path / "made", 2)
    with pytest.raises(InputError, match="contains no search of htcp place"):
        read_search(tmp_path)
    (folder / "mountings.parquet").write_bytes(b"no table")
    with pytest.raises(InputError, match="damaged search"):
        read_search(folder)
    (folder / "ranked.json").unlink()
    with pytest.raises(InputError, match="is not finished"):
        read_search(folder)
    with pytest.raises(InputError, match="without a ranked mounting"):
        open_plans(folder)
    assert main(["program", str(folder), "--feed", "20mm/s", "--out", str(tmp_path / "out.csv")]) == 2
    assert "without a ranked mounting" in capsys.readouterr().err


def test_a_search_opens_as_the_run_of_its_best_and_says_their_rank(tmp_path, planned):
    folder = write_search(tmp_path / "made", 2)
    shutil.copytree(planned / "run", folder / "ranked")
    plain, found = open_plans(folder / "ranked"), open_plans(folder)
    assert found.count == plain.count and found.files == plain.files
    assert found.labels == {number: f"rank {number + 1}, {text}" for number, text in plain.labels.items()}
    (folder / "place.json").write_text(json.dumps({"seams": ["left", "right"]}))
    ranks = [text.partition(",")[0] for text in open_plans(folder).labels.values()]
    assert ranks == ["rank 1", "rank 1", "rank 2", "rank 2"]
