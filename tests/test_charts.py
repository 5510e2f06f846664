"""Charts: each draws any results, distinguishes its methods, and counts only what is planned."""

import itertools

import numpy as np
import pytest
from hand_made import plans_with
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from htcp_jax.report import charts
from htcp_jax.report.charts import style
from htcp_jax.report.charts.along_path import REASONS
from htcp_jax.report.charts.style import INK, LINES, PAPER, ink_on, line_of, spread_labels
from htcp_jax.report.document import png
from htcp_jax.status import Status

GOOD, LIMIT, LATER, NONE = Status.TRACKED, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED, -1
PLANS = {
    "baseline": plans_with([[GOOD, GOOD, LIMIT, LATER], [GOOD, LIMIT, LATER, LATER]]),
    "hybrid": plans_with([[GOOD] * 4, [GOOD] * 4]),
    "keep-clear": plans_with([[LIMIT, LATER, LATER, LATER]] * 2),  # nothing tracked
}
STATUS = {method: plans.status for method, plans in PLANS.items()}
TURN, TOOL = charts.Axis("turn [rad]", [0.1, 0.2, 0.30000000000000004]), charts.Axis("path", ["weld", "seam.csv"])


def texts(figure: Figure) -> str:
    """All texts of a figure."""
    figure.canvas.draw()
    return "\n".join(text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text")))


def drawings() -> dict[str, Figure]:
    cells = np.array([[0.0, 3.5, 4.0], [1.0, np.nan, 4.0]])
    maps = dict.fromkeys(STATUS, cells) | {"keep-clear": np.full((2, 3), np.nan)}
    return {
        "success": charts.success(
            dict.fromkeys(STATUS, 3),
            dict.fromkeys(STATUS, 8),
            paper={"baseline": 50.0},
            reachability=7,
            complete=dict.fromkeys(STATUS, (1, 2)),
        ),
        "success_map": charts.success_map(maps, TOOL, TURN, 4),
        "success_slices": charts.success_slices({m: np.stack([v, v, v]) for m, v in maps.items()}, TURN, TOOL, TURN, 4),
        "success_line": charts.success_line({m: v[:, 0] for m, v in maps.items()}, TOOL, 4),
        "success_rates": charts.success_rates(
            {method: plans.outcomes.can_be_driven.astype(float) for method, plans in PLANS.items()},
            {"turn [rad]": np.array([0.1, 0.2]), "path": np.array(["weld", "seam.csv"])},
        ),
        "survival": charts.survival(STATUS, reachability=np.array([4, 2])),
        "stops": charts.stops(STATUS),
        "clearance_along": charts.clearance_along({method: plans.clearance for method, plans in PLANS.items()}),
        "manipulability_along": charts.manipulability_along(
            {method: plans.clearance for method, plans in PLANS.items()}, {"hybrid": np.array([2, -1])}
        ),
        "joint_motion": charts.joint_motion({method: plans.joint_step for method, plans in PLANS.items()}),
        "joint_motion_by_joint": charts.joint_motion_by_joint({m: p.x for m, p in PLANS.items()}, ["elbow", "wrist"]),
    }


def test_every_chart_draws_a_figure_that_names_every_method_even_where_nothing_is_tracked():
    figures = drawings()
    assert set(figures) == set(charts.__all__) - {"Axis", "place_map", "proof_chart"}  # not of methods
    for name, figure in figures.items():
        written = texts(figure)
        assert isinstance(figure, Figure), name
        silent = {"keep-clear"} if name == "success_line" else set()  # it has no planned scenarios there
        assert all(method in written for method in PLANS.keys() - silent), name


def test_long_values_of_an_axis_are_numbered_and_no_two_labels_of_a_map_overlap():
    long = charts.Axis("path", [f"branch_seam_of_pipe_{k}.csv" for k in range(5)])
    assert long.numbered["no. 2"] == "branch_seam_of_pipe_1.csv" and not TOOL.numbered
    many = charts.Axis("tool [m]", [-0.1, -0.075, -0.05, -0.025, 0.0, 0.025, 0.05, 0.075, 0.1])
    for columns in (long, charts.Axis("path", [f"seam_{k}.csv" for k in range(5)]), many):
        cells = np.ones((2, len(columns.values)))
        figure = charts.success_map(dict.fromkeys(STATUS, cells), TOOL, columns, 4)
        figure.canvas.draw()
        boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
        assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_a_single_map_fills_its_picture_and_random_values_are_rounded():
    given = charts.Axis("turn [rad]", [0.0254539, 0.1234567, 0.3141592])
    figure = charts.success_map({"hybrid": np.ones((3, 3))}, given, given, 4)
    figure.canvas.draw()
    box = figure.axes[0].get_window_extent()
    assert box.x0 < 0.3 * figure.bbox.width and box.width > 0.45 * figure.bbox.width
    assert given.names == ["0.0255", "0.123", "0.314"]
    assert charts.Axis("turn [rad]", [0.1234567, 0.1234568]).names == ["0.123457", "0.123457"]


def test_the_note_of_a_line_over_the_grid_agrees_with_its_axis():
    values, fewer = {"hybrid": np.array([4.0, 3.0, 2.0])}, {"hybrid": np.array([3.0, 3.0, 2.0])}
    cut = charts.success_line(values, TURN, 4, executable=fewer)
    assert cut.axes[0].get_ylabel() == "executable targets" and "Tracked targets of" not in texts(cut)
    assert charts.success_line(values, TURN, 4).axes[0].get_ylabel() == "tracked targets"


@pytest.mark.parametrize(("scenarios", "bins"), [(7, 1), (12, 1), (35, 3), (400, 10)])
def test_a_bin_of_random_values_has_ten_scenarios_or_more_if_there_are_so_many(scenarios, bins):
    random = np.random.default_rng(0)
    given = {"turn [rad]": random.uniform(size=scenarios)}
    axes = charts.success_rates({"hybrid": random.integers(0, 2, scenarios).astype(float)}, given).axes[0]
    assert len(axes.lines[0].get_xdata()) == bins
    grid = charts.success_rates({"hybrid": np.ones(12)}, {"turn [rad]": np.repeat([0.1, 0.2, 0.3], 4)})
    assert grid.axes[0].lines[0].get_xdata() == pytest.approx([0.1, 0.2, 0.3]) and "a bin of 4 scen" in texts(grid)


def test_the_lines_of_joint_motion_are_named_and_within_their_frame():
    steps = {"hybrid": np.array([[0.0, 1e-4, 2.0]]), "baseline": np.array([[0.3, 0.2, np.nan]])}
    along = charts.joint_motion(steps).axes[1]
    assert {text.get_text().split("  ")[0] for text in along.texts} == set(steps)
    drawn = np.concatenate([line.get_ydata() for line in along.lines])
    low, high = along.get_ylim()
    assert low <= np.nanmin(drawn) and np.nanmax(drawn) <= high and "at least 1e-05" in texts(along.figure)


@pytest.mark.parametrize("name", ["survival", "stops", "clearance_along", "manipulability_along", "joint_motion"])
def test_the_ticks_of_targets_end_at_the_last_target(name):
    axes = drawings()[name].axes[1 if name == "joint_motion" else 0]
    assert axes.get_xticks().tolist() == [0, 1, 2, 3]


def test_survival_counts_executable_targets_with_all_tracked_ones_faint():
    known = {method: np.arange(4)[None] < np.ones((2, 1)) for method in STATUS}  # only target 0
    axes = charts.survival(STATUS, executable=known).axes[0]
    counted = [line.get_ydata().tolist() for line in axes.lines if line.get_linestyle() == LINES["hybrid"][1]]
    assert [2, 0, 0, 0] in counted and "execute" in axes.get_ylabel()
    assert "hybrid  0" in texts(axes.figure) and "faint: tracked" in texts(axes.figure)


def test_the_same_results_give_the_same_picture_byte_for_byte():
    assert png(charts.stops(STATUS)) == png(charts.stops(STATUS))


@pytest.mark.parametrize("name", ["success_line", "survival"])
def test_the_labels_of_lines_stand_at_the_right_of_them(name):
    figure = drawings()[name]
    labels = {text.get_text().split("  ")[0]: text for text in figure.axes[0].texts}
    assert set(labels) <= set(PLANS) and "hybrid" in labels
    assert all(text.get_color() == line_of(method)[0] for method, text in labels.items())


def test_what_is_not_planned_is_not_counted_as_tracked():
    partial = {"baseline": np.array([[GOOD, GOOD], [NONE, NONE]], np.int8)}
    assert "1 of 1 complete" in texts(charts.stops(partial))
    assert "baseline  1" in texts(charts.survival(partial))


def test_the_stops_show_each_reason_that_occurs_and_no_other():
    written = texts(charts.stops(STATUS))
    assert "iteration limit" in written and "recovery exhausted" not in written


def test_the_lowest_feed_of_each_scenario_that_has_one_is_marked():
    values = np.array([[0.3, 0.2, 0.1], [0.4, 0.5, 0.6]])
    figure = charts.manipulability_along({"hybrid": values}, {"hybrid": np.array([2, -1])})
    (marks,) = figure.axes[0].collections[1:]
    assert marks.get_offsets().tolist() == [[2.0, 0.1]] and "Triangles" in texts(figure)
    assert "Triangles" not in texts(charts.manipulability_along({"hybrid": values}))


def test_every_reason_to_fail_has_a_marker_of_its_own():
    failures = {status for status in Status if not status.tracked} - {LATER}
    assert set(REASONS) == failures
    assert len({marker for _, marker in REASONS.values()}) == len(REASONS)


def test_a_map_holds_the_number_of_every_cell_and_none_where_nothing_is_planned():
    figure = charts.success_map({"baseline": np.array([[0.0, 3.5], [4.0, np.nan]])}, TOOL, TOOL, 4)
    assert sorted(text.get_text() for text in figure.axes[0].texts) == ["0", "3.5", "4"]
    assert {text.get_text(): text.get_fontweight() for text in figure.axes[0].texts}["4"] == "bold"


def test_a_large_map_has_fewer_names_and_no_numbers():
    axis = charts.Axis("turn [rad]", list(range(40)))
    figure = charts.success_map({"baseline": np.zeros((40, 40))}, axis, axis, 4)
    assert not figure.axes[0].texts and len(figure.axes[0].get_xticks()) == 10


def test_values_of_an_axis_read_as_they_were_written():
    assert TURN.names == ["0.1", "0.2", "0.3"]


# Linear RGB as seen by dichromats: Vienot, Brettel, Mollon (1999)
VISIONS = {
    "all cones": np.eye(3),
    "protanopia": np.array([[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]]),
    "deuteranopia": np.array([[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]]),
}


@pytest.mark.parametrize("vision", VISIONS)
def test_methods_are_distinguished_by_colour_or_by_line_style(vision):
    for (a, (colour_a, style_a)), (b, (colour_b, style_b)) in itertools.combinations(LINES.items(), 2):
        seen = [VISIONS[vision] @ np.array(to_rgb(colour)) ** 2.2 for colour in (colour_a, colour_b)]
        apart = np.abs(np.subtract(*np.clip(seen, 0, 1) ** (1 / 2.2))).max()
        assert style_a != style_b or apart > 0.1, f"{a} and {b}"


def test_a_method_of_your_own_has_a_line_that_no_other_has():
    """Check distinct line styles, also for anagrams, which once shared one."""
    own = ["mine", "enim", "nime", *(f"planner-{k}" for k in range(60))]
    lines = {line_of(method) for method in own}
    assert len(lines) == len(own) and not lines & set(LINES.values())
    assert len({colour for colour, _ in lines}) == len(own) and line_of("mine") == line_of("mine")


def test_colours_of_methods_of_your_own_are_far_from_all_others(monkeypatch):
    """Distances of colours in CIELAB; 2.3 is just noticeable (regression: two methods with one colour)."""
    monkeypatch.setattr(style, "_OTHERS", {})
    for count, least in ((8, 20), (30, 8), (100, 2.3)):
        colours = [line_of(f"planner-{k}")[0] for k in range(count)]
        values = np.array([style._lab(each) for each in (*colours, *(colour for colour, _ in LINES.values()))])
        apart = np.linalg.norm(values[:count, None] - values[None], axis=-1)
        assert (apart[apart > 0].min() >= least) and (apart == 0).sum() == count


@pytest.mark.parametrize("least", [1e-10, 1e-3])
def test_a_clearance_of_nearly_zero_does_not_stretch_the_axis_and_the_note_names_the_edge(least):
    figure = charts.clearance_along({"baseline": np.array([[least, 0.01, np.nan]])})
    assert figure.axes[0].get_ylim()[0] > 5e-4 and ("at the lower edge" in texts(figure)) == (1e3 * least < 1e-3)
    steps = charts.joint_motion({"baseline": np.array([[1e-12, 1e-12, 0.01, 0.1]])})
    assert min(axes.get_ylim()[0] if axes.get_yscale() == "log" else axes.get_xlim()[0] for axes in steps.axes) > 5e-6


def test_labels_are_spread_in_their_order_and_stay_inside_where_there_is_room():
    placed = spread_labels({"a": 0.5, "b": 0.5, "c": 0.99, "d": 1.0, "e": 0.0}, 0.1)
    heights = sorted(placed.values())
    assert min(np.diff(heights)) >= 0.1 - 1e-12 and heights[0] >= 0 and heights[-1] <= 1
    assert sorted(placed, key=placed.get) == ["e", "a", "b", "c", "d"]


def test_numbers_are_light_on_dark_cells_and_dark_on_light_ones():
    assert ink_on(to_rgb("#3f82b5")) == ink_on((0.0, 0.0, 0.0)) == PAPER
    assert ink_on(to_rgb("#8fb8cf")) == ink_on((1.0, 1.0, 1.0)) == INK
