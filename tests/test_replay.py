"""Plans prepared for viewing: the same from a run, a folder and memory; failed ones first; minimum clearance."""

import json
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from hand_made import plans_with
from made_once import seven_joints

from htcp_jax import api
from htcp_jax.errors import InputError
from htcp_jax.jobs.build import task_of_job
from htcp_jax.model import Workpiece
from htcp_jax.model.duct import duct_cloud
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.reachability.obstruction import obstruction
from htcp_jax.runs.sweep import sweep
from htcp_jax.status import Status
from htcp_jax.viewer.replay import Replays, open_replays, replays_of

A, E, LIMIT, NOT = Status.TRACKED, Status.TRACKED_AFTER_RECOVERY, Status.ITERATION_LIMIT, Status.NOT_ATTEMPTED
DUCT = Path(__file__).parents[1] / "configs" / "duct.yaml"  # the pose of the cloud
GRID = "config: job.yaml\ngrid:\n  - start_rad.joint3: {offsets: [-0.1, 0, 0.1]}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of three scenarios with 13 targets, the last of which lies in the wall, and the plan of the second."""
    folder = tmp_path_factory.mktemp("shelf")
    (folder / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.1857,-0.3,0.1708\n")
    np.save(folder / "cloud.npy", duct_cloud(3000))
    (folder / "job.yaml").write_text(
        f"config: {DUCT}\nworkpiece: {{cloud: cloud.npy, path: path.csv, inlet_m: [0, 0, 0.19138]}}\nmethod: baseline\n"
    )
    (folder / "grid.yaml").write_text(GRID)
    sweep(folder / "grid.yaml", "baseline", folder / "run")
    api.plan(folder / "job.yaml").save(folder / "plan")
    return folder


@pytest.fixture(scope="module")
def replay(folder):
    """The run's second scenario."""
    return open_replays(folder / "run").replay(1, "baseline")


def test_a_run_a_plan_s_folder_and_a_plan_in_memory_show_the_same(folder, replay):
    replays = [
        replay,
        open_replays(folder / "plan").replay(0, "baseline"),
        replays_of("memory", api.plan(folder / "job.yaml")).replay(0, "baseline"),
    ]
    for name in ("target", "status", "clearance", "x", "shape.p", "shape.q", "shape.tcp", "cloud"):
        first, *others = map(attrgetter(name), replays)
        for other in others:
            np.testing.assert_allclose(other, first, atol=1e-12, err_msg=name)
    assert [(replay.tracked, replay.failed, replay.path) for replay in replays] == [(12, 12, 11)] * 3


def test_the_witnesses_are_as_far_apart_as_the_clearance_says(replay):
    apart = np.linalg.norm(replay.witness.arm - replay.witness.cloud, axis=1)
    np.testing.assert_allclose(apart[:12], replay.clearance[:12], atol=1e-12)
    to_cloud = np.linalg.norm(replay.cloud[None] - replay.witness.cloud[:, None], axis=2).min(axis=1)
    assert to_cloud.max() < 1e-9  # it is a point of the cloud
    k = replay.robot.capsule_names.index(replay.witness.body[5])
    p, q, at = replay.shape.p[5, k], replay.shape.q[5, k], replay.witness.arm[5]
    s = np.clip((at - p) @ (q - p) / max((q - p) @ (q - p), 1e-300), 0, 1)
    assert np.isclose(np.linalg.norm(p + s * (q - p) - at), replay.robot.capsule_radius[k])  # on the capsule's surface


def test_at_the_failed_target_the_arm_is_brought_into_what_is_in_collision(replay):
    """Configuration at the failed target: in collision with the blocking obstacle (regression: it was unknown)."""
    found = replay.obstruction
    assert np.isnan(replay.clearance[12]) and replay.failed == 12
    np.testing.assert_array_equal(replay.x[12], found.x)
    assert replay.witness.body[12] == found.body
    np.testing.assert_allclose(replay.witness.cloud[12], found.point, atol=1e-9)
    np.testing.assert_allclose(replay.shape.tcp[12], replay.target[12], atol=1e-3)
    assert found.reached and found.depth_m > 0  # the last target lies in the wall


def by_hand(status: list[list[Status]], folder) -> Replays:
    """Replays of an arm other than the GP50, at rest at zero, with a tool 0.1 m longer."""
    robot = seven_joints(folder)
    rng = np.random.default_rng(0)
    workpiece = Workpiece("ball", rng.normal(size=(200, 3)) * 0.2, np.zeros((3, 3)))
    scenario = make_scenario(robot, workpiece, np.zeros(7), rotation=(0.0, 0.0), approach=(0, 0), tool_extension_m=0.1)
    plan = api.Plan(api.load_config(), robot, workpiece, scenario, plans_with(status, joints=7))
    return replays_of("ball", plan)


def test_failed_scenarios_come_first_and_what_is_not_planned_does_not(tmp_path):
    replays = by_hand([[A, A, A], [A, LIMIT, NOT], [-1, -1, -1], [E, A, LIMIT], [A, A, -1]], tmp_path)
    outcomes = replays.outcomes("beam")
    assert [outcome.scenario for outcome in outcomes] == [1, 3, 0, 4]
    assert [(outcome.tracked, outcome.targets) for outcome in outcomes] == [(1, 3), (2, 3), (3, 3), (2, 2)]
    with pytest.raises(InputError, match="ball has no scenario 2 by beam; it has 0 to 1, 3 to 4"):
        replays.replay(2, "beam")
    with pytest.raises(InputError, match="ball has no results of 'hybrid'; it has beam"):
        replays.replay(0, "hybrid")


def test_any_arm_is_shown_with_its_scenario_s_tool(tmp_path):
    replays = by_hand([[LIMIT, NOT, NOT]], tmp_path)
    replay = replays.replay(0, "beam")
    assert replay.shape.p.shape == (3, 8, 3) and replay.tracked == 0
    held = replay.shape.tcp[1:]  # at the failed target the arm is moved there
    # The seven links of 0.3 m stand upright; the TCP is offset 0.05 m and 0.35 m above the last, z axis up.
    np.testing.assert_allclose(held, [[0.05, 0, 7 * 0.3 + 0.35 + 0.1]] * 2, atol=1e-12)


@pytest.mark.parametrize("name", ["summary.json", "trajectory.npz"])
@pytest.mark.parametrize("data", [b"", b"{}", b"not this"])
def test_damage_is_one_line(folder, tmp_path, name, data):
    for file in (folder / "plan").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=r"damaged|cannot read|another version|JSON") as error:
        open_replays(tmp_path)
    assert "\n" not in str(error.value)


def test_a_plan_next_to_another_configuration_is_refused(folder, tmp_path):
    for file in (folder / "plan").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    summary = json.loads((tmp_path / "summary.json").read_text())
    summary["config"]["workpiece"]["approach_to_path"] += 1
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(
        InputError, match=r"trajectory\.npz contains \d+ targets and \d+ joints, but summary\.json describes"
    ):
        open_replays(tmp_path)


def test_a_folder_of_neither_and_a_changed_file_are_named(folder, tmp_path):
    with pytest.raises(InputError, match="contains neither a run of htcp sweep"):
        open_replays(tmp_path)
    text = (folder / "path.csv").read_text()
    (folder / "path.csv").write_text(text + "0.2,-0.17,0.17\n")
    with pytest.raises(InputError, match=r"path\.csv has changed since .*run was planned"):
        open_replays(folder / "run")
    (folder / "path.csv").write_text(text)


def test_with_a_task_each_scenario_s_colliding_body_is_that_at_its_own_goal(folder):
    task = "task:\n  - {point: tcp, on: path}\n  - {axis: tcp.z, towards: [1, 0, 0], cone_deg: 85}\n"
    (folder / "cone.yaml").write_text(f"config: job.yaml\n{task}")
    (folder / "cones.yaml").write_text("config: cone.yaml\ngrid:\n  - task.2.cone_deg: [85, 60]\n")
    sweep(folder / "cones.yaml", "baseline", folder / "cones")
    api.plan(folder / "cone.yaml").save(folder / "cone")
    found = open_replays(folder / "cones").obstructions("baseline")
    assert sorted(found) == [0, 1]
    for number, cone_deg in enumerate((85, 60)):
        plan = api.plan(folder / "cone.yaml", {"task.2.cone_deg": cone_deg})
        lost, known = plan.outcome.failed, (plan.robot, plan.workpiece, plan.scenario)
        task = task_of_job(plan.job, plan.robot)
        alone = obstruction(*known, plan.plans.before(0, lost), lost, plan.job.settings, task=task)
        assert found[number].body == alone.body
        np.testing.assert_allclose(found[number].x, alone.x, atol=1e-9)
    (one,) = open_replays(folder / "cone").obstructions("baseline").values()
    np.testing.assert_allclose(one.x, found[0].x, atol=1e-9)
