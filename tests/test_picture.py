"""The picture: exact outlines, the side that shows the inside, and a drawing for every plan."""

from itertools import combinations

import jax.numpy as jnp
import numpy as np
import pytest
import toy
from hand_made import plans_with
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from test_validate_pieces import arm_file

from htcp_jax.device.executor import EXECUTABLES
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import ArmShape, capsule_segments, tip_segment
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.reachability import Obstruction
from htcp_jax.status import Status
from htcp_jax.viewer import draw_plan
from htcp_jax.viewer.arm_pose import arms_at, pieces_at
from htcp_jax.viewer.picture import ALONG, AXIS_PT, LEGEND, draw_scale, draw_triad, shown_targets, stadium
from htcp_jax.viewer.viewpoints import View

COORDINATE = st.floats(-3, 3)
POINT = st.tuples(COORDINATE, COORDINATE).map(np.array)


@given(POINT, POINT, st.floats(1e-3, 1))
def test_every_point_of_a_stadium_is_one_radius_from_its_segment(p, q, radius):
    outline = stadium(p, q, radius)
    along = q - p
    share = np.clip((outline - p) @ along / max(along @ along, 1e-300), 0, 1)
    distance = np.linalg.norm(outline - p - share[:, None] * along, axis=1)
    np.testing.assert_allclose(distance, radius, rtol=1e-9, atol=1e-9)


def test_the_last_tracked_configuration_is_the_last_drawn():
    status = [[Status.TRACKED] * 5 + [Status.ITERATION_LIMIT] + [Status.NOT_ATTEMPTED] * 2]
    assert shown_targets(plans_with(status), 0)[-1] == 4
    assert shown_targets(plans_with([[Status.ITERATION_LIMIT]]), 0) == []


def test_the_shape_of_the_arm_is_that_of_its_kinematics_with_one_rule_for_the_bare_tip():
    x = np.random.default_rng(0).uniform(-1, 1, (3, 6))
    shape = arms_at(gp50(), x)
    for w in range(len(x)):
        one = jnp.asarray(x[w])
        alone = (*capsule_segments(gp50(), one), *tip_segment(gp50(), one))
        for mine, theirs in zip(shape, alone, strict=True):
            np.testing.assert_allclose(mine[w], theirs, atol=1e-12)
        p, q = ArmShape(*(part[w] for part in shape)).axes()
        assert p.shape == q.shape == (len(gp50().capsule_names) + 1, 3)
        np.testing.assert_allclose(np.stack([p[-1], q[-1]]), tip_segment(gp50(), one), atol=1e-12)


def test_pictures_of_other_numbers_of_configurations_compile_nothing():
    """Regression: each picture was compiled anew, later each number of configurations."""
    arms_at(gp50(), np.zeros((4, 6)))
    before = len(EXECUTABLES)
    longer = arms_at(gp50(), np.full((300, 6), 0.1))
    assert len(EXECUTABLES) == before and longer.p.shape == (300, len(gp50().capsule_names), 3)


@pytest.mark.parametrize("tracked", [0, 1, 60, 105])
def test_complete_partial_and_empty_plans_are_drawn(tracked, tmp_path):
    robot, workpiece = gp50(), load_workpiece()
    scenario = make_scenario(robot, workpiece, (0.0, -2.3, 0.5, 0.0, 0.5, -2.0))
    status = [Status.TRACKED] * tracked + [Status.PATH_BLOCKED] + [Status.NOT_ATTEMPTED] * 105
    plans = plans_with([status[:105]], joints=6)._replace(target=np.asarray(scenario.targets)[None])
    figure = draw_plan(robot, workpiece, scenario, plans, title="a plan")
    figure.savefig(tmp_path / "plan.png", dpi=30)
    texts = [text.get_text() for text in figure.axes[-1].texts]
    assert any(text.startswith(f"target {tracked}: ") for text in texts) == (tracked < 105)


def test_a_path_of_one_point_without_a_part_is_drawn_in_a_view_of_some_width():
    point, origin = np.array([[0.5, 0.0, 0.4]]), (0.0,) * 3
    part = Workpiece("point", np.empty((0, 3)), point, interior="none", pivot=origin, neutral_translation=origin)
    scenario = make_scenario(toy.robot(), part, toy.START, approach=(0, 1))
    plans = plans_with([[Status.TRACKED] * int(scenario.count)], joints=4)
    plans = plans._replace(target=np.asarray(scenario.targets)[None])
    figure = draw_plan(toy.robot(), part, scenario, plans, title="a point")
    assert all(np.ptp(axes.get_xlim()) > 0.005 for axes in figure.axes)


def test_without_a_start_the_nearest_attempt_is_drawn_with_its_colliding_body(tmp_path):
    point, origin = np.array([[0.5, 0.0, 0.4]]), (0.0,) * 3
    part = Workpiece("point", np.empty((0, 3)), point, interior="none", pivot=origin, neutral_translation=origin)
    scenario = make_scenario(toy.robot(), part, toy.START, approach=(0, 1))
    plans = plans_with([[Status.NO_START] * int(scenario.count)], joints=4)
    plans = plans._replace(target=np.asarray(scenario.targets)[None])
    attempt = Obstruction("tool", point[0], 0.02, 0.0, True, np.array([0.3, 0.5, 0.8, 0.2]))
    figures = [draw_plan(toy.robot(), part, scenario, plans, obstruction=each) for each in (attempt, None)]
    figures[0].savefig(tmp_path / "plan.png")
    drawn = [figure.axes[0].collections[0].get_paths()[-1].vertices for figure in figures]
    assert not np.allclose(*drawn)
    headings = [figure.axes[0].get_title("left").partition(",")[0] for figure in figures]
    assert headings == ["The arm in the clearest attempt at target 0", "The arm without a start"]
    assert any("tool is 20 mm inside the workpiece" in text.get_text() for text in figures[0].axes[-1].texts)


@pytest.mark.parametrize("above", (False, True))
def test_the_scale_bar_has_a_strip_of_its_own_and_is_1_2_or_5_long(above):
    axes = Figure().subplots()
    axes.set(xlim=(0, 1.2), ylim=(0, 1))
    draw_scale(axes, above)
    (x, y), limits = axes.lines[-1].get_data(), axes.get_ylim()
    assert x[1] - x[0] == 0.5 and (1 < y[0] < limits[1] if above else limits[0] < y[0] < 0)


def toy_figure(clearance_m: float = 0.01) -> Figure:
    plans = plans_with([[Status.TRACKED] * int(toy.scenario().count)], joints=4)
    plans = plans._replace(target=np.asarray(toy.scenario().targets)[None])
    plans = plans._replace(clearance=np.linspace(6e-4, clearance_m, plans.status.size)[None])
    return draw_plan(toy.robot(), toy.workpiece(), toy.scenario(), plans)


@pytest.mark.parametrize(("most_m", "labels"), [(0.05, {"1", "2", "5", "10", "20", "50"}), (9e-4, {"0.6", "0.8"})])
def test_the_clearance_axis_has_plain_numbers_only(most_m, labels):
    axis = toy_figure(most_m).axes[-1].yaxis
    axis.figure.canvas.draw()
    shown = {text.get_text() for text in axis.get_ticklabels()}
    assert labels <= shown and all(float(text) for text in shown)
    assert not any(text.get_text() for text in axis.get_ticklabels(minor=True))


def test_a_legend_with_every_kind_of_target_lies_between_the_heading_and_the_edge():
    count = int(toy.scenario().count)
    kinds = [Status.TRACKED_AFTER_RECOVERY, *[Status.TRACKED] * (count - 3), Status.PATH_BLOCKED, Status.NOT_ATTEMPTED]
    plans = plans_with([kinds], joints=4)._replace(target=np.asarray(toy.scenario().targets)[None])
    figure = draw_plan(toy.robot(), toy.workpiece(), toy.scenario(), plans)
    axes = figure.axes[-1]
    axes.axvline(1, label="dwell")
    axes.legend(**LEGEND)
    figure.canvas.draw()
    legend, heading = axes.get_legend().get_window_extent(), axes._left_title.get_window_extent()
    assert len(axes.get_legend().get_texts()) == 6
    assert heading.x1 < legend.x0 and legend.x1 <= figure.bbox.x1


def test_each_view_has_the_axes_x_y_and_z_and_the_azimuth_of_the_eye():
    for axes in toy_figure().axes[:-1]:
        ends = {text.get_text(): text.get_position() for text in axes.texts}
        assert ends["z"][1] > 0 == pytest.approx(ends["z"][0])
        azimuth = np.radians(float(axes.get_title("left").partition("seen from azimuth ")[2].rstrip("°")))
        to_the_right = np.array([-np.sin(azimuth), np.cos(azimuth)])
        drawn = np.array([ends["x"][0], ends["y"][0]])
        is_circle = np.abs([np.cos(azimuth), np.sin(azimuth)]) > ALONG
        np.testing.assert_allclose(drawn, np.where(is_circle, 0, AXIS_PT * to_the_right), atol=0.3)


@pytest.mark.parametrize("azimuth_deg", range(-180, 180, 15))
def test_no_name_of_an_axis_overlaps_another_or_the_upward_arrow_from_any_azimuth(azimuth_deg):
    azimuth = np.radians(azimuth_deg)
    near, right = np.array([[np.cos(azimuth), np.sin(azimuth), 0], [-np.sin(azimuth), np.cos(azimuth), 0]])
    figure = Figure(dpi=100)
    canvas, axes = FigureCanvasAgg(figure), figure.subplots()
    draw_triad(axes, View(right, np.array([0.0, 0.0, 1.0]), near))
    canvas.draw()
    boxes = {text.get_text(): Text.get_window_extent(text) for text in axes.texts}
    middle, top = boxes["z"].x0 + boxes["z"].width / 2, boxes["z"].y0
    upward = Bbox([[middle, top - AXIS_PT * figure.dpi / 72], [middle, top]])
    shown = [boxes["x"], boxes["y"], Bbox.union([boxes["z"], upward])]
    assert not any(one.overlaps(other) for one, other in combinations(shown, 2))


@pytest.mark.parametrize("tracked", [3, 10])
def test_no_text_lies_over_the_curve_of_a_plan_that_fails(tracked):
    count = int(toy.scenario().count)
    status = [Status.TRACKED] * tracked + [Status.PATH_BLOCKED] + [Status.NOT_ATTEMPTED] * (count - tracked - 1)
    plans = plans_with([status], joints=4)._replace(target=np.asarray(toy.scenario().targets)[None])
    colliding = Obstruction("tool", np.zeros(3), 0.02, 0.0, True, np.array(toy.START), "the fixture " + 50 * "'top' ")
    figure = draw_plan(toy.robot(), toy.workpiece(), toy.scenario(), plans, obstruction=colliding)
    figure.canvas.draw()
    axes = figure.axes[-1]
    highest = axes.transData.transform([0, np.nanmax(1e3 * plans.clearance)])[1]
    texts = [Text.get_window_extent(text) for text in axes.texts]
    assert texts and min(text.y0 for text in texts) > highest


def test_a_convex_piece_is_drawn_in_place_of_its_capsule(tmp_path):
    robot = load_robot(arm_file(tmp_path))
    k, x = robot.capsule_names.index("fore"), np.array([[0.1, -1.2, 1.4, 0.3, 0.5, 0.2]])
    scenario = make_scenario(robot, toy.workpiece(), x[0])
    plans = plans_with([[Status.TRACKED]], joints=6)._replace(x=x[None], target=np.asarray(scenario.targets)[None, :1])
    vertices, radius = pieces_at(robot, x)[0][k]
    for axes in draw_plan(robot, toy.workpiece(), scenario, plans).axes[:-1]:
        bodies = next(each for each in axes.collections if len(each.get_paths()) == len(robot.capsule_names))
        sizes = [np.ptp(path.vertices, axis=0)[1] for path in bodies.get_paths()]  # z is up
        assert min(abs(np.array(sizes) - np.ptp(vertices[:, 2]) - 2 * radius)) < 1e-6
