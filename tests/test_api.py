"""Python API for notebooks: public names, data frames, figures, and the display of objects."""

import json
import subprocess
import sys
from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pyarrow as pa
import pytest
import toy
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import htcp_jax
from htcp_jax.clearance.obstacles import SelfCollision
from htcp_jax.cli import main
from htcp_jax.errors import Note
from htcp_jax.jobs import load_sweep
from htcp_jax.model.robot import Exclusion, lengthen_tool
from htcp_jax.motion import Problem
from htcp_jax.planning import batch, registry
from htcp_jax.planning.tracking import StepQPs
from htcp_jax.runs.tables import table_frame
from htcp_jax.viewer import draw_plan
from htcp_jax.viewer.replay import open_replays, replays_of

TURNS = {"grid": [{"workpiece.rotation_z_rad": [0.1, 0.2]}]}


@pytest.fixture
def short(tmp_path):
    """Overrides that shorten a job to a path of two points: 13 targets."""
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    return {"workpiece.path": str(tmp_path / "path.csv")}


def test_every_public_name_is_there_and_others_are_not():
    assert set(htcp_jax.__all__) <= set(dir(htcp_jax))
    for name in htcp_jax.__all__:
        assert callable(getattr(htcp_jax, name)) or name in ("charts", "clearance")
    with pytest.raises(
        AttributeError,
        match=r"no attribute 'plam'; did you mean plan\? public names: AxisRow, ",
    ):
        _ = htcp_jax.plam


def test_importing_the_package_is_cheap():
    code = "import htcp_jax, sys; print([m for m in sys.modules if m.startswith(('htcp_jax.', 'mujoco', 'pyarrow'))])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


def test_a_plan_is_a_frame_a_figure_and_a_table(short, tmp_path):
    plan = htcp_jax.plan(overrides=short, method="baseline")
    frame = plan.frame()
    assert plan.complete and len(frame) == 13 and frame.tracked.all()
    np.testing.assert_array_equal(frame.clearance_m, plan.plans.clearance[0])
    np.testing.assert_array_equal(frame.filter(regex="^joint._rad$"), plan.plans.x[0])
    assert isinstance(plan.figure(), Figure)
    assert repr(plan) == "Plan(baseline: gp50, duct, 13 of 13 targets tracked)"
    assert "13 of 13" in plan._repr_html_() and "failed" not in plan._repr_html_()
    assert "capsule_6c (30 mm)" in plan.robot._repr_html_() and "50,015 points" in plan.workpiece._repr_html_()
    plan.save(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["tracked"] == 13


def test_objects_with_long_arrays_have_short_texts(short):
    scene = load_sweep({"grid": [{"workpiece.rotation_y_rad": [0.4, 0.5]}]}, overrides=short).batch()
    cloud = htcp_jax.make_obstacle(scene.workpiece)[0]
    assert repr(scene.robot) == "Robot(gp50: 6 joints, 8 capsules)"
    assert repr(scene.workpiece).startswith("Workpiece(duct: 50,015 points, a path of ")
    assert repr(scene.scenarios) == "Scenario(2 scenarios, 13 targets)" and repr(cloud) == "Cloud(50015 points)"
    assert "Scenario" in repr(jax.tree.map(lambda _: None, scene.scenarios))  # as in messages of JAX


def test_a_misspelt_name_is_answered_with_a_similar_one():
    assert htcp_jax.__version__.count(".") == 2
    with pytest.raises(AttributeError, match=r"did you mean sweep\? public names: AxisRow, "):
        _ = htcp_jax.swep
    for call in (partial(htcp_jax.plan, method="baselin"), partial(htcp_jax.sweep, "sweeps/robot", "baselin")):
        with pytest.raises(htcp_jax.InputError, match=r"did you mean baseline\? valid: "):
            call()


def test_the_smallest_manipulability_is_that_of_the_path_without_its_approach(short):
    plan = htcp_jax.plan(overrides=short, method="baseline")
    values, first = plan.manipulability.copy(), int(plan.scenario.on_path)
    values[:first] = 1e-6 * np.arange(1, first + 1)
    plan.__dict__["manipulability"] = values
    at, record = first + int(np.argmin(values[first:])), plan.record()
    assert (record["manipulability_min_target"], record["manipulability_min_m_rad"]) == (at, values[at])
    middle = np.median(values[first:])
    expected = f"{values[at]:.3g} m/rad minimum, at target {at}; {middle:.3g} m/rad median"
    assert plan.facts()["manipulability"] == expected


def test_clearance_to_a_mesh_is_reported_with_and_without_the_covering_radius(short):
    """Clearance of a mesh: what is measured, and what is subtracted (regression: 0.5 mm were 1.88 mm by MuJoCo)."""
    plan = htcp_jax.plan(overrides=short, method="baseline")
    assert "clearance measured" not in plan.facts()
    mesh = replace(plan, workpiece=replace(plan.workpiece, covering_radius_m=0.001))
    least = plan.summary.clearance_min_mm + 1
    reported = f"at least {least:.3g} mm to points on the part; 1 mm are subtracted for the gaps between them"
    if least < 2:  # most of what was measured
        reported += ", at most 0.45 mm with --set workpiece.mesh_spacing_m=0.0009"
    assert mesh.facts()["clearance measured"] == reported


def test_a_plan_says_how_many_pairs_of_bodies_that_could_touch_are_not_checked(short):
    plan = htcp_jax.plan(overrides=short, method="baseline")
    assert "pairs not checked" not in plan.facts()
    excluded = tuple(Exclusion(4, other, rule, 1.0) for other, rule in enumerate("abcd"))
    own = replace(plan, obstacles=(SelfCollision(((5, 0),), excluded),))
    assert own.facts()["pairs not checked"].startswith("2 that could touch")  # by the rules b and d


def test_a_saved_plan_is_read_where_its_planner_is_not(short, tmp_path, capsys):
    """Regression: a saved plan of a user-defined planner was refused by every command: `is not a method`."""
    htcp_jax.register(StepQPs("of-ones-own", "Own", "the baseline by another name"))
    plan = htcp_jax.plan(overrides=short, method="of-ones-own")
    plan.save(tmp_path / "out")
    registry.METHODS._own.pop("of-ones-own")
    assert main(["validate", str(tmp_path / "out"), "--between", "0", "--verbose"]) == 0
    assert "of-ones-own" in capsys.readouterr().out
    replays = open_replays(tmp_path / "out")
    np.testing.assert_array_equal(replays.replay(0, "of-ones-own").x, plan.plans.x[0])
    with pytest.raises(htcp_jax.InputError, match="'of-ones-own' is not a method"):
        htcp_jax.plan(overrides=short, method="of-ones-own")


def test_a_failed_plan_says_where_and_why(short, tmp_path):
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.1857,-0.25,0.1708\n")  # the second is in the wall
    plan = htcp_jax.plan(overrides=short, method="baseline")
    reason, colliding_bodies = plan.failure().values()
    assert not plan.complete and "failed at target 12</td>" in plan._repr_html_() and reason in plan._repr_html_()
    assert "inside the workpiece" in colliding_bodies and colliding_bodies in plan._repr_html_()
    assert plan.frame().clearance_m.isna().sum() == 1 and plan.frame().path_clear.isna().sum() == 1


OMITTED = '<text name="moving links without capsules" data="rod&#10;lever"/>'  # as htcp robot --omit writes it


def test_shapes_for_contact_that_are_not_checked_are_named(tmp_path):
    job = toy.write_job(tmp_path)
    drawn = '<geom type="box" size="1 1 1" contype="0" conaffinity="0"/>'
    others = f'<geom name="wrist" type="cylinder" size=".01 .01"/>{drawn}'
    arm = (tmp_path / "arm.xml").read_text()
    assert "not checked" not in htcp_jax.plan(job, method="baseline").facts()
    (tmp_path / "arm.xml").write_text(arm.replace("<site ", f"{others}<site ", 1))
    facts = htcp_jax.plan(job, method="baseline").facts()
    assert facts["not checked"] == "wrist: no capsule or sphere; convert the arm with htcp robot"
    (tmp_path / "arm.xml").write_text(arm.replace("<worldbody>", f"<custom>{OMITTED}</custom><worldbody>", 1))
    with pytest.warns(Note, match=r"arm\.xml: not checked: rod, lever: omitted from the model$"):
        facts = htcp_jax.plan(job, method="baseline").facts()
    assert facts["not checked"] == "rod, lever: omitted from the model"


def test_overrides_are_words_or_values(short):
    words = [f"{key}={value}" for key, value in short.items()]
    a = htcp_jax.plan(overrides=[*words, "method=baseline", "margin_m=0.001"])
    b = htcp_jax.plan(overrides={**short, "method": "baseline", "margin_m": 0.001})
    assert a.job == b.job
    np.testing.assert_array_equal(a.plans.x, b.plans.x)


@pytest.mark.parametrize(
    ("how", "line"),
    [
        ({"method": "rrt"}, "'rrt' is not a method; valid: baseline"),
        ({"overrides": {"margin": 1}}, "unknown key margin; did you mean margin_m?"),
        ({"overrides": {"settings.alpha_rad": -1.0}}, "alpha_rad is -1.0: at least 1e-15 is needed"),
        ({"overrides": {"start_rad": [0, -1.2, -0.5, 0, 0.5, -2]}}, "start is in collision"),
    ],
)
def test_bad_input_is_an_input_error(how, line):
    with pytest.raises(htcp_jax.InputError, match=line):
        htcp_jax.plan(**how)


def test_a_sweep_of_a_mapping_has_frames_tables_and_charts(short):
    run = htcp_jax.sweep(TURNS, "baseline", overrides=short, seed=3)
    scenarios = run.frame()
    assert scenarios.rotation_z_rad.tolist() == [0.1, 0.2] and scenarios.complete.all() and run.manifest.seed == 3
    assert scenarios.failed_target.isna().all()
    assert len(run.frame("targets")) == 2 * 13 and run.frame("targets", "baseline").equals(run.frame("targets"))
    assert "100.00 %: 26 of 26 targets" in run._repr_html_()
    report = htcp_jax.make_report(run)
    assert report.frame().tracked_percent.tolist() == [100.0]
    assert isinstance(report.figures["success"], Figure) and "sweep" in repr(report)
    with pytest.raises(htcp_jax.InputError, match="no table 'result'; valid: results, "):
        report.frame("result")
    with pytest.raises(htcp_jax.InputError, match="no table 'target'; valid: scenarios, targets"):
        run.frame("target")


def test_a_sweep_of_a_mapping_names_what_is_wrong_with_it():
    with pytest.raises(htcp_jax.InputError, match="sweep: grid, axis 1: unknown parameter rotation_z"):
        htcp_jax.sweep({"grid": [{"rotation_z": [0.1]}]}, "baseline")


def test_methods_are_a_frame():
    assert htcp_jax.methods().title["nspace-sqp"] == "N-Space SQP"


def test_frames_keep_whole_numbers_and_truths_next_to_nulls(monkeypatch):
    frame = table_frame(pa.table({"k": pa.array([1, None], pa.int32()), "clear": pa.array([True, None])}))
    assert frame.k[0] == 1 and frame.k.dtype == "Int32" and frame.clear.dtype == "boolean"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(htcp_jax.InputError, match="frames need pandas"):
        table_frame(pa.table({}))


def test_a_job_is_a_mapping_as_a_sweep_is(short):
    """Regression: plan({...}) raised a TypeError."""
    job = {"workpiece": {"path": short["workpiece.path"], "rotation_z_rad": 0.05}, "method": "baseline", "ray": None}
    spelled = htcp_jax.plan(job)
    assert job["ray"] is None  # the caller's mapping is unchanged
    same = htcp_jax.plan(overrides=short | {"workpiece.rotation_z_rad": 0.05}, method="baseline")
    assert spelled.job == same.job
    np.testing.assert_array_equal(spelled.plans.x, same.plans.x)
    run = htcp_jax.sweep({"grid": [{"margin_m": [5e-4]}]}, "baseline", config=job)
    np.testing.assert_array_equal(run.plans("baseline").x, same.plans.x)
    with pytest.raises(htcp_jax.InputError, match=r"unknown key workpiece\.rotation; did you mean"):
        htcp_jax.plan({"workpiece": {"rotation": 0.1}})


def pixels(figure: Figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def test_a_plan_s_robot_is_the_one_with_its_tool(short, tmp_path):
    """Regression: plan.robot lacked the job's tool extension, so that distances measured with it were wrong."""
    plan = htcp_jax.plan(overrides=short | {"robot.tool_extension_m": 0.05}, method="baseline")
    obstacle = htcp_jax.make_obstacle(plan.workpiece)
    longer = lengthen_tool(htcp_jax.gp50(), 0.05)
    np.testing.assert_array_equal(plan.robot.T_link_tcp, longer.T_link_tcp)
    title = f"{plan.job.method}: {plan.summary.tracked} of 13 targets"
    once = draw_plan(longer, plan.workpiece, plan.scenario, plan.plans, title=title)
    assert (pixels(plan.figure()) == pixels(once)).all()
    plan.save(tmp_path)
    shelves = replays_of("memory", plan), open_replays(tmp_path)
    for t in np.flatnonzero(plan.frame().tracked)[::4]:
        x = jax.numpy.asarray(plan.plans.x[0, t])
        D = htcp_jax.minimum_clearance(plan.robot, obstacle, plan.scenario, x)
        np.testing.assert_allclose(D, plan.plans.clearance[0, t], atol=1e-12)
        np.testing.assert_allclose(htcp_jax.tcp_position(plan.robot, x), plan.plans.tcp[0, t], atol=1e-12)
        for replays in shelves:
            np.testing.assert_allclose(replays.replay(0, "baseline").shape.tcp[t], plan.plans.tcp[0, t], atol=1e-12)
    again = batch.plan(Problem.of(plan.robot, plan.workpiece, plan.scenario, plan.job.settings), "baseline")
    np.testing.assert_allclose(again.x, plan.plans.x, atol=1e-9)  # the tool extension is not applied twice


def test_a_plan_that_a_bound_on_joint_steps_ends_names_the_bound(short):
    plan = htcp_jax.plan(overrides={**short, "method": "baseline", "settings.max_joint_step_rad": 1e-5})
    assert plan.outcome.failed is not None and plan.outcome.failed > plan.scenario.on_path
    assert plan.failure()["joint steps"].startswith("settings.max_joint_step_rad allows 1e-05 from target to target; ")
    assert "joint steps" not in htcp_jax.plan(overrides={**short, "method": "baseline"}).failure()
