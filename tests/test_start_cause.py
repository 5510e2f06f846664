"""Reasons why a scenario cannot begin: standing overlaps, points out of reach, collisions in all attempts."""

import re

import numpy as np
import pytest
import toy
from test_cell_fixtures import ARM

import htcp_jax
from htcp_jax import api
from htcp_jax.clearance.obstacles.of_workpiece import KEEP_OUT
from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import scene
from htcp_jax.model import Task, Workpiece, surface
from htcp_jax.model.scenario import stack, without_pose
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Plans, Problem
from htcp_jax.motion.start_cause import NO_PROOF, check_starts, closest_bodies, start_causes
from htcp_jax.motion.start_check import check_start
from htcp_jax.runs.tables import CAUSE, STEPS, scenario_table, with_new_columns
from htcp_jax.status import Status

HOME = (0.0, 0.0, 0.0)
PLACE = without_pose(np.eye(4))
POINT = np.array([0.5, 0.0, 0.5])


def cause_of(
    cloud: np.ndarray, status: Status, path=POINT, start=None, task: Task | None = None, cover_m=0.0, **margin
):
    """Reason of one scenario of the toy arm with a cloud."""
    choices = {"interior": "none", "pivot": HOME, "neutral_translation": HOME, "covering_radius_m": cover_m}
    part = Workpiece("part", cloud, np.array([path, path + 1e-3]), **choices)
    scenarios = stack([make_scenario(toy.robot(), part, start, rotation=(0.0, 0.0), approach=(0, 0), **margin)])
    task = Task(tolerance_m=1e-3) if task is None else task
    found = start_causes(Problem(toy.robot(), part, scenarios, toy.SETTINGS, task), np.array([status]))[0]
    assert found.description.startswith(PLACE), "the part has no pose"
    return found._replace(description=found.description.removeprefix(PLACE))


def around(point: np.ndarray, radius_m: float, count: int = 400) -> np.ndarray:
    away = np.random.default_rng(0).normal(size=(count, 3))
    return point + radius_m * away / np.linalg.norm(away, axis=1)[:, None]


def test_a_start_in_collision_names_body_obstacle_and_depth():
    found = cause_of(np.array([[0.0, 0.01, 0.9]]).repeat(4, 0), Status.START_IN_COLLISION, start=(0.0, 0.0, 0.0, 0.0))
    assert (found.body, found.other, found.always) == ("forearm", "the workpiece", False)
    assert found.depth_m == pytest.approx(0.02) and found.description == "capsule forearm is 20 mm inside the workpiece"


def test_an_overlap_with_points_on_a_mesh_says_how_much_the_gaps_between_them_take():
    at = np.array([[0.0, 0.01, 0.9]]).repeat(4, 0)
    found = cause_of(at, Status.START_IN_COLLISION, start=(0.0, 0.0, 0.0, 0.0), cover_m=0.005)
    gaps = "this includes 5 mm for the gaps between the points on its mesh"
    assert found.description == f"capsule forearm is 25 mm inside the workpiece; {gaps}"
    found = cause_of(at + np.array([0, 0.025, 0]), Status.START_IN_COLLISION, start=(0.0, 0.0, 0.0, 0.0), cover_m=0.03)
    assert found.description.endswith("mm for the gaps between the points on its mesh, which itself may be clear")


def test_a_point_that_no_configuration_reaches_is_out_of_reach():
    """Only a straight arm would get there, and the second joint stops at 120 degrees."""
    found = cause_of(around(POINT, 3.0), Status.NO_START, path=np.array([0.0, 0.0, -0.65]))
    assert found.body is None
    said = (
        r"in 2048 random attempts the arm came only to within (\d+) mm of the point, with j2 at the joint limits; "
        f"{NO_PROOF}"
    )
    assert 50 < float(re.fullmatch(said, found.description)[1]) < 500


def test_a_point_that_is_reached_in_collision_alone_names_the_pairs():
    found = cause_of(around(POINT, 0.06), Status.NO_START)
    assert (found.body, found.other) == ("tool", "the workpiece") and found.depth_m > 0
    assert "of 2048 random attempts reached the point, all in collision, the least by" in found.description
    assert "capsule tool with the workpiece (" in found.description


def test_a_point_that_is_reached_with_less_than_the_margin_alone_names_the_largest_clearance():
    found = cause_of(around(POINT, 0.15), Status.NO_START, margin_m=0.2)
    said = (
        r"in \d+ of 2048 random attempts the arm .* with a clearance of at most ([\d.]+) mm, less than the margin of "
        f"200 mm; {NO_PROOF}"
    )
    assert 0 < float(re.fullmatch(said, found.description)[1]) < 150
    assert found.attempt.depth_m == found.depth_m and found.attempt.other == "the workpiece"


def test_a_start_that_lacks_less_than_the_points_on_the_mesh_cost_names_denser_points():
    choices = {"interior": "none", "pivot": HOME, "neutral_translation": HOME, "covering_radius_m": 0.01}
    part = Workpiece("part", around(POINT, 0.15), np.array([POINT, POINT + 1e-3]), **choices)
    scenario = make_scenario(toy.robot(), part, None, rotation=(0.0, 0.0), approach=(0, 0), margin_m=0.006)
    plans = Plans.empty(scenario.x_start[None], scenario.targets[None])
    plans.status[0, 0] = Status.NO_START
    job = load_config(None, {"margin_m": 0.006, "start_rad": "auto", "settings": toy.SETTINGS})
    found = api.Plan(job, toy.robot(), part, scenario, plans)
    assert 0 < found.start_cause.attempt.depth_m + 0.006 < 0.01
    facts = found.failure()
    assert "without collision, but with a clearance of at most" in facts["cause"]
    assert facts["points on the mesh"].endswith("are lacking here: denser points may suffice")
    assert f"--set {surface.KEY}=" in facts["next"]
    outside = found.start_cause.attempt._replace(other=KEEP_OUT)
    vars(found)["start_cause"] = found.start_cause._replace(attempt=outside)
    assert "points on the mesh" not in found.failure()  # the hull does not depend on their number


def test_the_pair_with_the_minimum_clearance_is_named():
    choices = {"interior": "none", "pivot": HOME, "neutral_translation": HOME}
    part = Workpiece("part", np.array([[0.0, 0.15, 0.9]]).repeat(4, 0), np.array([POINT, POINT + 1e-3]), **choices)
    scenario = make_scenario(toy.robot(), part, (0.0,) * 4, rotation=(0.0, 0.0), approach=(0, 0))
    problem = Problem(toy.robot(), part, stack([scenario]), toy.SETTINGS, Task(tolerance_m=1e-3))
    found = closest_bodies(problem, np.zeros(4))
    assert (found.body, found.other) == ("capsule forearm", "the workpiece")
    np.testing.assert_allclose(found.point, [0.0, 0.15, 0.9], atol=1e-12)
    text = f"capsule forearm comes within {-1e3 * found.depth_m:.3g} mm of the workpiece at (0.00, 0.15, 0.90) m"
    assert found.description == text


def test_the_attempt_with_the_least_overlap_is_kept():
    found = cause_of(around(POINT, 0.06), Status.NO_START)
    assert found.attempt is not None
    assert found.attempt.depth_m == found.depth_m and found.attempt.other == "the workpiece"
    assert np.linalg.norm(found.attempt.point - POINT) == pytest.approx(0.06)


def test_a_point_that_is_reached_is_never_called_out_of_reach():
    found = cause_of(around(POINT, 3.0), Status.NO_START).description
    assert found == f"no start was found in 2048 random attempts; {NO_PROOF}"


def test_bodies_that_overlap_in_every_random_configuration_are_named():
    """The forearm begins at the elbow, which moves on a sphere of points."""
    found = cause_of(around(np.array([0.0, 0.0, 0.3]), 0.4, 10_000), Status.NO_START)
    assert found.always and found.body == "forearm"
    assert found.description.startswith("the workpiece and capsule forearm overlap by at least ")
    assert found.description.endswith(" mm in all of 512 random configurations")


def test_a_start_in_collision_is_refused_with_a_clear_one_near_it():
    """The rod of the toy arm touches four equal points."""
    choices = {"interior": "none", "pivot": HOME, "neutral_translation": HOME}
    part = Workpiece("part", np.array([[0.0, 0.01, 0.9]]).repeat(4, 0), np.array([POINT, POINT + 1e-3]), **choices)

    def problem(start):
        scenario = make_scenario(toy.robot(), part, start, rotation=(0.0, 0.0), approach=(0, 0))
        return Problem(toy.robot(), part, stack([scenario]), toy.SETTINGS, Task(tolerance_m=1e-3))

    with pytest.raises(InputError, match=r"start is in collision: .* mm inside the workpiece; next: ") as refused:
        check_starts(problem((0.0,) * 4), ())
    advised = np.array(re.search(r"start_rad=\[(.*?)\]", str(refused.value))[1].split(","), float)
    assert 0 < np.abs(advised).max() < 0.5
    check_starts(problem(tuple(advised)), ())


@pytest.fixture
def job(tmp_path):
    """Job of the toy arm with a part, one of whose points is 30 mm inside the arm's foot."""
    (tmp_path / "arm.xml").write_text(ARM)
    np.savetxt(tmp_path / "part.xyz", np.vstack([[0, 0, -0.07], around(POINT, 0.15)]), delimiter=",")
    np.savetxt(tmp_path / "path.csv", [POINT, POINT + 0.01], delimiter=",")
    part = {"cloud": str(tmp_path / "part.xyz"), "path": str(tmp_path / "path.csv"), "interior": "none"}
    return {"robot": {"model": str(tmp_path / "arm.xml")}, "workpiece": part, "settings": toy.SETTINGS}


@pytest.mark.filterwarnings("ignore:.*have gaps of")
def test_a_standing_body_in_the_part_is_named_before_planning(job):
    with pytest.raises(InputError) as error:
        check_start(*scene(load_config({**job, "start_rad": toy.START})))
    inside = "capsule foot is 30.000 mm inside the workpiece"
    always = f"{inside}; neither of the two moves: move one of them"
    assert str(error.value) == f"{PLACE}no configuration is clear: {always}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*have gaps of")
def test_a_standing_body_in_the_part_is_named_where_a_start_is_searched(job):
    with pytest.raises(InputError) as error:
        htcp_jax.plan({**job, "start_rad": "auto"})
    found = "the workpiece and capsule foot overlap by 30 mm in every configuration"
    assert str(error.value) == f"{PLACE}no start exists: {found}"


@pytest.mark.slow
def test_a_sweep_and_its_report_name_what_a_start_collides_with(job, tmp_path, capsys):
    """Another scenario's start is clear: the part has no point in the foot."""
    np.savetxt(tmp_path / "part.xyz", around(POINT, 0.15), delimiter=",")
    clear = [2.5, *toy.START[1:]]
    grid = {"grid": [{"start_rad": [clear, list(toy.START)]}]}
    run = htcp_jax.sweep(grid, "baseline", tmp_path / "run", config={**job, "start_rad": clear})
    rows = run.scenarios().to_pylist()
    assert [rows[0][name] for name in CAUSE] == [None, None, None]
    assert rows[1]["failure"] == "START_IN_COLLISION" and rows[1]["colliding_with"] == "the workpiece"
    assert rows[1]["cause"].startswith(f"{PLACE}capsule {rows[1]['colliding_body']} is ")
    assert main(["report", str(tmp_path / "run"), "--out", str(tmp_path / "report")]) == 0
    (stops,) = (tmp_path / "report").rglob("*stops*.csv")
    assert f"{rows[1]['colliding_body']} with the workpiece (1)" in stops.read_text()


def test_runs_from_older_versions_have_no_causes():
    rows = scenario_table("", (), Plans.empty(np.zeros((0, 4)), np.zeros((0, 1, 3))), ("j",) * 0)
    before = rows.drop_columns([*CAUSE, *STEPS])
    assert with_new_columns(before, rows.schema).schema.equals(rows.schema)
    assert with_new_columns(rows, rows.schema) is rows
