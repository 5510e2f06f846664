"""Kinds of obstacles and of task rows of other packages: the pages that explain them, and what the package promises."""

import json
import warnings
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from page_package import Place, files

import htcp_jax
from htcp_jax.clearance import clearances
from htcp_jax.clearance.obstacles.given_obstacle import GivenObstacle, given_obstacles, with_given
from htcp_jax.clearance.obstacles.obstacle import bodies_at
from htcp_jax.clearance.proof.row_proof import between, row_slacks
from htcp_jax.device.executor import EXECUTABLES
from htcp_jax.jobs import load_config, tasks_of_targets
from htcp_jax.jobs.build import scene, task_of_job
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Execution, Problem
from htcp_jax.placement.ranges import read_ranges
from htcp_jax.planning import batch
from htcp_jax.report.validation import notes
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.spec.kinds import numbers_of
from htcp_jax.spec.obstacle_kind import OBSTACLES
from htcp_jax.spec.task_list import TASK_ROWS
from htcp_jax.status import SegmentStatus, Status
from htcp_jax.trajectory.blends import MotionSlack
from htcp_jax.trajectory.task_slack import with_rows

PAGES = "docs/add-an-obstacle.md", "docs/add-a-task-row.md", "docs/add-a-planner.md"


@pytest.fixture(scope="module", params=PAGES)
def place(request, tmp_path_factory) -> Place:
    return Place(request.param, tmp_path_factory.mktemp("page"))


@pytest.mark.slow
def test_a_page_is_true_from_its_package_to_its_report(place):
    for words in place.commands:
        code, out, err = place.htcp(*words)
        valid = (0, 3) if "planner" in place.page and words[0] == "plan" else (0,)
        assert code in valid, f"{words}: {out}{err}"
    code, out, err = place.python("from_python.py")
    assert code == 0, err
    report = (place.folder / "report" / "report.html").read_text()
    swept = {"docs/add-an-obstacle.md": "cell.obstacles.1.centre", "docs/add-a-task-row.md": "task.2.height"}
    assert swept.get(place.page, "Clear neighbours") in report
    assert json.loads((place.folder / "plan" / "validation.json").read_text())["validated"]


# The examples, in this process


@pytest.fixture(scope="module", autouse=True)
def kinds():
    """The classes of the pages, and some others, registered."""
    space: dict = {}
    for page, name in zip(PAGES, ("my_ball.py", "my_row.py"), strict=False):
        exec(compile(files(page)[name], name, "exec", dont_inherit=True), space)

    @dataclass(frozen=True)
    class Ring(htcp_jax.ObstacleKind):
        centre_m: tuple[float, float, float]
        radius_m: float
        thick_m: float = 0.02
        name = "ring"

        def distance(self, point):
            off = point - self.centre_m
            aside = jnp.sqrt(off[0] ** 2 + off[1] ** 2 + 1e-18) - self.radius_m
            return jnp.sqrt(aside**2 + off[2] ** 2 + 1e-18) - self.thick_m

    @dataclass(frozen=True)
    class Sampled(space["StaysAbove"]):
        name = "stays-above-sampled"
        rate = None

        def deviation(self, frame):
            return None

    @dataclass(frozen=True)
    class Across(htcp_jax.TaskRowKind):
        """The tool's x axis is at right angles to the path."""

        axis: str = "tcp.x"
        name = "across"
        equalities, angular, rate, along = 1, True, 2.0, ("tangent",)

        def features(self, robot):
            return [htcp_jax.axis_of(robot, self.axis)]

        def error(self, value):
            return jnp.dot(value, self.tangent)[None]

    found = [htcp_jax.register(kind) for kind in (space["Ball"], Ring)]
    rows = [htcp_jax.register(kind) for kind in (space["StaysAbove"], Sampled, Across)]
    yield {kind.name: kind for kind in (*found, *rows)}
    for registry, own in ((OBSTACLES, found), (TASK_ROWS, rows)):
        for kind in own:
            registry._own.pop(kind.name)


BALL = {"kind": "ball", "centre_m": [0.9, 0.2, 0.9], "radius_m": 0.1}
RING = {"kind": "ring", "centre_m": [1.0, 0.0, 0.8], "radius_m": 0.3}
TRACK = {"point": "tcp", "on": "path"}
SHORT = {"method": "baseline", "workpiece.path": "girth-shallow"}


def scenario_with(obstacle: dict):
    job = load_config({"cell.obstacles": [obstacle]})
    robot, _, scenario = scene(job)
    return robot, given_obstacles(job.cell.obstacles), scenario


def sampled(obstacles, robot, scenario, bodies, count: int):
    """Distances of the capsules to the obstacle at equally spaced places of their axes, the smallest of each."""
    own = obstacles[0].template.with_numbers(scenario.obstacle_numbers)
    points = bodies.p[:, None] + np.linspace(0, 1, count)[None, :, None] * (bodies.q - bodies.p)[:, None]
    return jax.vmap(jax.vmap(own.distance))(points).min(axis=1) - robot.capsule_radius


@pytest.mark.parametrize("obstacle", [BALL, RING])
def test_distances_are_those_of_a_dense_look_and_gradients_those_of_differences(obstacle):
    robot, obstacles, scenario = scenario_with(obstacle)

    def at(x):
        return clearances(robot, obstacles, scenario, x)

    @made_once.quick_jit
    def seen(x, near):
        bodies = bodies_at(robot, scenario, x)
        dense = sampled(obstacles, robot, scenario, bodies, 4001)
        return at(x), jax.jacfwd(at)(x), dense, obstacles[0].free_radius(robot, scenario, bodies), jax.lax.map(at, near)

    x, h = scenario.x_start + 0.1, 1e-6
    near = np.concatenate([x + h * np.eye(len(x)), x - h * np.eye(len(x))])
    moving = np.array(robot.capsule_link) > 0
    found, gradient, dense, least, beside = (np.asarray(each) for each in seen(x, near))
    assert (found <= dense + 1e-9)[moving].all() and (found >= dense - 1e-3)[moving].all()
    assert (least <= found)[moving].all()
    ahead, behind = beside.reshape(2, len(x), -1)
    np.testing.assert_allclose(gradient.T[:, moving], ((ahead - behind) / (2 * h))[:, moving], atol=1e-4)


def test_the_bound_of_an_obstacle_that_is_not_convex_holds_along_every_axis(kinds):
    robot, obstacles, scenario = scenario_with(RING)

    @made_once.quick_jit
    @jax.vmap
    def seen(x):
        bodies = bodies_at(robot, scenario, x)
        return obstacles[0].free_radius(robot, scenario, bodies), sampled(obstacles, robot, scenario, bodies, 2001)

    least, dense = (np.asarray(each) for each in seen(np.random.default_rng(0).uniform(-1.5, 1.5, (8, 6))))
    assert (least <= dense + 1e-12)[:, np.array(robot.capsule_link) > 0].all()


def test_scenarios_that_differ_in_the_balls_position_share_one_call_and_one_compilation():
    axis = {"cell.obstacles.1.centre_m": [[0.9, 0.4, 0.9], [0.9, 0.25, 0.9], [0.9, 0.6, 0.7]]}
    base = {**SHORT, "cell.obstacles": [BALL]}
    sweep = load_sweep({"grid": [axis]}, base)
    found = sweep.batch()
    assert len(found.cells) == 1 and found.scenarios.obstacle_numbers.shape == (3, 4)
    cell = found.cells[0]
    how = cell.settings, cell.task, cell.obstacles, Execution(threads=1)

    def planned(scenarios):
        return batch.plan(Problem.of(cell.robot, cell.workpiece, scenarios, *how), "baseline")

    alone = [planned(jax.tree.map(lambda leaf, s=s: leaf[s : s + 1], found.scenarios)) for s in (0, 1)]
    before = len(EXECUTABLES)
    third = planned(jax.tree.map(lambda leaf: leaf[2:3], found.scenarios))
    assert len(EXECUTABLES) == before and third.tracked.any()
    assert not np.array_equal(alone[0].clearance, alone[1].clearance)


def test_the_identity_of_a_run_includes_what_a_kind_is_given():
    jobs = [load_config({"cell.obstacles": [BALL | {"radius_m": r}], "task": [TRACK, ABOVE]}) for r in (0.1, 0.2)]
    jobs.append(load_config({"cell.obstacles": [BALL], "task": [TRACK, ABOVE | {"height_m": 1.0}]}))
    hashes = {config_hash(identity(job.model_dump(mode="json"), [], "float64", {})) for job in jobs}
    assert len(hashes) == 3
    assert load_config(jobs[0].model_dump()) == jobs[0] == load_config(json.loads(jobs[0].model_dump_json()))


ABOVE = {"kind": "stays-above", "link": "link4", "height_m": 1.2}
SAMPLED = ABOVE | {"kind": "stays-above-sampled"}


@pytest.mark.parametrize("row", [ABOVE, SAMPLED], ids=["rate", "sampled"])
def test_the_slack_of_a_row_holds_on_all_of_an_interval(row):
    job = load_config({"task": [TRACK, row]})
    robot, _, scenario = scene(job)
    task = task_of_job(job, robot)
    regions, x = between(task, jnp.asarray(scenario.task_goals[[-2, -1]])), jnp.asarray(scenario.x_start)

    @made_once.quick_jit
    def seen(rates):
        found = row_slacks(robot, task.parts, regions, x, rates, jnp.asarray(0.5))
        return found.left[0], jax.vmap(lambda s: task.value(robot, x + s * rates)[5])(jnp.linspace(-0.5, 0.5, 101))

    rng = np.random.default_rng(1)
    for size in np.geomspace(1e-4, 0.5, 12):
        rates = size * rng.normal(size=6)
        left, height = (np.asarray(each) for each in seen(rates))
        if row is ABOVE:
            assert (height - row["height_m"] + task.tolerance_m >= float(left)).all()
        else:
            assert (left >= 0) == (0.5 * np.abs(rates).max() <= 0.01)


def test_a_row_without_a_rate_is_sampled_and_nowhere_called_proven():
    plan = htcp_jax.plan({"task": [TRACK, SAMPLED], "method": "baseline"})
    on_path = int(plan.scenario.on_path)
    there = plan.plans.executable[0]
    assert (
        there.any()
        and (plan.plans.segment_status[0, on_path + 1 :][there[on_path + 1 :]] == SegmentStatus.SAMPLED).all()
    )
    assert "proven" not in set(plan.frame()["segment_status"])
    with pytest.raises(htcp_jax.InputError, match="stays-above-sampled does not set `rate`"):
        motion = plan.motion()
        left = MotionSlack(*np.zeros((2, len(motion.x) - 1)))
        tasks = tasks_of_targets(plan.job, plan.robot, plan.plans.seam_of_targets)
        with_rows(left, tasks, plan.robot, motion, np.asarray(plan.scenario.goals))


def test_a_row_holds_where_it_is_planned_and_its_proof_is_one(kinds):
    on_path = htcp_jax.PointRow(point="tcp", on="path")
    plan = htcp_jax.plan({"method": "baseline"}, task=[on_path, kinds["stays-above"]("link4", 1.4)])
    x = plan.plans.x[0][plan.plans.tracked[0]]
    value = made_once.quick_jit(jax.vmap(task_of_job(plan.job, plan.robot).value, (None, 0)))
    height = np.asarray(value(plan.robot, x))[int(plan.scenario.on_path) :, 5]
    assert len(height) and (height >= 1.4 - 1e-9).all()
    assert (
        not (plan.plans.segment_status == SegmentStatus.SAMPLED).any()
        and (plan.plans.segment_status == SegmentStatus.VALID).sum() > 50
    )


def test_a_row_may_use_the_path_at_every_target():
    job = load_config({"task": [TRACK, {"kind": "across"}]})
    robot, workpiece, scenario = scene(job)
    task = task_of_job(job, robot)
    assert task.rows == 4 and scenario.task_goals.shape[1] == 3 + 3 + 1
    tangents = scenario.task_goals[int(scenario.on_path) :, 3:6]
    np.testing.assert_allclose(tangents, workpiece.tangents @ scenario.T_world_workpiece[:3, :3].T)
    value = task.value(robot, jnp.asarray(scenario.x_start))
    assert abs(float(task.error(value, jnp.asarray(scenario.task_goals[0]))[3])) < 1e-12  # the start satisfies its goal


def test_values_and_keys_of_a_job_plan_alike(kinds):
    ball = kinds["ball"](centre_m=(0.9, 0.2, 0.9))
    plans = [htcp_jax.plan(SHORT, obstacles=[given]) for given in (ball, BALL)]
    assert np.array_equal(plans[0].plans.x, plans[1].plans.x, equal_nan=True)
    assert "ball" in plans[0].facts()["fixtures"]
    job = plans[0].job
    robot, workpiece, scenario = scene(load_config(SHORT))
    again = batch.plan(Problem.of(robot, workpiece, scenario, job.settings, obstacles=[ball]), "baseline")
    assert np.array_equal(again.x, plans[0].plans.x, equal_nan=True)


@pytest.mark.parametrize(
    ("job", "line"),
    [
        (
            {"cell.obstacles": [{"kind": "bal"}]},
            "cell.obstacles.1: 'bal' is not a kind of obstacle; did you mean ball",
        ),
        ({"cell.obstacles": [{"centre_m": [0, 0, 0]}]}, "is not an obstacle; it must be {kind: NAME"),
        ({"cell.obstacles": [BALL | {"radius": 1}]}, "unknown key radius; did you mean radius_m"),
        ({"cell.obstacles": [BALL | {"radius_m": "x"}]}, "kind ball: radius_m is 'x'"),
        ({"cell.obstacles": [BALL | {"radius_m": float("inf")}]}, "radius_m is inf; it must be finite"),
        ({"cell.obstacles": [{"kind": "ball"}]}, "kind ball: centre_m"),
        (
            {"task": [TRACK, {"kind": "stays-abov"}]},
            "'stays-abov' is not a kind of task row; did you mean stays-above",
        ),
        ({"task": [TRACK, ABOVE | {"link": "elbow"}]}, "no point 'elbow' on gp50; valid: link1"),
    ],
)
def test_what_a_kind_does_not_take_is_refused_in_one_line(job, line):
    with pytest.raises(htcp_jax.InputError, match=line) as error:
        scene(load_config(job))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("axis", "line"),
    [
        ({"cell.obstacles.2.radius_m": [0.1]}, "the cell has 1 obstacles"),
        ({"cell.obstacles.1.size_m": [0.1]}, "has no key size_m that can vary; valid: centre_m, radius_m"),
        ({"task.1.on": ["path"]}, "has no key on that can vary"),
        ({"cell.obstacles.1.radius_m": ["x"]}, "radius_m is 'x'"),
    ],
)
def test_an_axis_that_a_kind_lacks_is_refused(axis, line):
    with pytest.raises(htcp_jax.InputError, match=line):
        load_sweep({"grid": [axis]}, {"cell.obstacles": [BALL], "task": [TRACK, ABOVE]}).batch()


def test_a_kind_of_this_process_alone_does_not_go_to_ray():
    with pytest.raises(htcp_jax.InputError, match="kind of obstacle 'ball' is registered only in this process"):
        htcp_jax.sweep({"grid": [{"margin_m": [0.0]}]}, "baseline", config={"cell.obstacles": [BALL]}, on="ray")


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        (type("A", (htcp_jax.ObstacleKind,), {"name": "a"}), "it is not a dataclass"),
        (dataclass(frozen=True)(type("B", (htcp_jax.ObstacleKind,), {"name": "b"})), "it does not define distance"),
        (dataclass(frozen=True)(type("C", (htcp_jax.TaskRowKind,), {"name": "c"})), "it does not define features"),
        (dataclass(frozen=True)(type("D", (htcp_jax.ObstacleKind,), {})), "it has no name"),
    ],
)
def test_an_incomplete_kind_is_not_registered(kind, line):
    with pytest.raises(htcp_jax.InputError, match=line):
        htcp_jax.register(kind)


def test_an_obstacle_without_shapes_plans_and_is_said_not_to_be_drawn_or_measured():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plan = htcp_jax.plan(SHORT, obstacles=[RING])
    assert isinstance(plan.obstacles[0], GivenObstacle) and plan.plans.tracked.any()
    with pytest.warns(UserWarning, match="the obstacle 'ring' is not drawn: it has no shapes"):
        plan.figure()
    assert "is not measured" in notes({"methods": {}, "between": 0, "unchecked": ["... is not measured ..."]})[0]


def test_scenarios_of_a_job_take_no_further_kinds(kinds):
    job = load_config({"cell.obstacles": [BALL]})
    _, _, scenario = scene(job)
    stacked = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scenario)
    with pytest.raises(htcp_jax.InputError, match=r"add further ones to cell\.obstacles"):
        with_given(job.cell.obstacles, stacked)
    assert numbers_of(job.cell.obstacles).tolist() == [0.9, 0.2, 0.9, 0.1]


def test_saved_numbers_of_statuses_stay():
    assert (Status.NO_START, Status.NO_SOLUTION, Status.BUDGET_EXHAUSTED, SegmentStatus.SAMPLED) == (14, 15, 16, 6)
    assert all(status.message and status.words for status in Status)


def test_numbers_of_kinds_are_ranges_of_a_search():
    base = load_config({"cell.obstacles": [BALL], "task": [TRACK, ABOVE]}).model_dump()
    raw = {"cell.obstacles.1.centre_m.y": [0.1, 0.4], "cell.obstacles.1.radius_m": [0.05, 0.1]}
    raw["task.2.height_m"] = [1.2, 1.3]
    found = read_ranges("ranges", raw, ("a",), base)
    low = {name: values[0] for name, values in found.columns(found.low[None]).items()}
    assert low == {
        "cell.obstacles.1.centre_m": [0.9, 0.1, 0.9], "cell.obstacles.1.radius_m": 0.05, "task.2.height_m": 1.2
    }  # fmt: skip
    with pytest.raises(htcp_jax.InputError, match="cannot vary in a search"):
        read_ranges("ranges", {"task.2.link": [0, 1]}, ("a",), base)
