"""Pictures, movies and the viewer show the world at rest and the part in motion, or all of it from the part."""

import mujoco
import numpy as np
import pytest
from test_moving_part import CELLS, job, planned  # noqa: F401

from htcp_jax.cli import main
from htcp_jax.io.robots import load_robot
from htcp_jax.viewer import Studio
from htcp_jax.viewer.arm_pose import AT_REST, arms_at, moved, roots_at, seen
from htcp_jax.viewer.playback import poses_along
from htcp_jax.viewer.replay import Replay, replays_of

SIZE = 320, 220


@pytest.fixture
def replay(planned) -> Replay:  # noqa: F811
    """A plan on a turntable, next to a pillar in the world."""
    return replays_of("turntable", planned).replay(0, "beam")


def body(replay: Replay, name: str) -> int:
    return replay.robot.capsule_names.index(name)


def spread(points: list[np.ndarray]) -> float:
    """Largest extent of a point's places [m]."""
    return float(np.ptp(points, axis=0).max())


@pytest.mark.parametrize("name", CELLS)
def test_the_parts_link_is_where_mujocos_tree_has_it(name, tmp_path):
    (tmp_path / "cell.xml").write_text(CELLS[name])
    robot = load_robot(tmp_path / "cell.xml")
    if not robot.part_moves:
        pytest.skip("the part stands still")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data, x = mujoco.MjData(model), np.random.default_rng(0).uniform(-0.3, 0.3, (5, len(robot.joint_names)))
    for T, one, tcp in zip(roots_at(robot, x), x, arms_at(robot, x).tcp, strict=True):
        for joint, value in zip(robot.joint_names, one, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(model, data)
        part = data.body(robot.part_link)
        np.testing.assert_allclose(T[:3, 3], part.xpos, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3], part.xmat.reshape(3, 3), atol=1e-9)
        np.testing.assert_allclose(moved(tcp, T), data.site("tcp").xpos, atol=1e-9)


def test_the_world_rests_in_the_world_and_the_part_from_the_part(replay):
    pillar, poses = body(replay, "pillar"), poses_along(replay)
    assert spread([seen(pose, False).arm.p[pillar] for pose in poses]) < 1e-9
    assert spread([seen(pose, False).T_root for pose in poses]) > 0.05
    assert spread([seen(pose, True).arm.p[pillar] for pose in poses]) > 0.05
    assert all(seen(pose, True).T_root is AT_REST for pose in poses)


def test_a_tool_on_the_part_is_on_the_drawn_part(replay):
    for target in np.flatnonzero(replay.status > 0):
        pose = seen(poses_along(replay)[0]._replace(arm=replay.arm_at(target), T_root=replay.T_root[target]), False)
        np.testing.assert_allclose(pose.arm.tcp, moved(replay.target[target], replay.T_root[target]), atol=1e-3)


def test_a_movie_from_the_part_shows_the_pillar_move_and_one_of_the_world_does_not(replay, screenless):
    moves = {}
    for from_part in (False, True):
        with Studio(replay, *SIZE, fine=False, from_part=from_part) as studio:
            film = studio.movie()
            first, last = film[0].astype(int), film[len(film) - 2].astype(int)
        moves[from_part] = (np.abs(first - last).max(axis=2) > 30).mean()
        assert first.std() > 10
    assert 0 < moves[False] < moves[True]


def test_the_command_has_the_option(planned, screenless, tmp_path):  # noqa: F811
    planned.save(tmp_path / "plan")
    pictures = []
    for more in ([], ["--from-part"]):
        out = tmp_path / f"render{len(more)}"
        words = ["render", str(tmp_path / "plan"), "--movie", "none", "--width", "160", "--out", str(out)]
        assert main([*words, *more]) == 0
        pictures.append((out / "scenario-0-beam.png").read_bytes())
    assert pictures[0] != pictures[1]


def test_the_viewer_has_a_toggle_for_a_part_that_moves(planned, replay):  # noqa: F811
    pytest.importorskip("viser")
    from htcp_jax.viewer import Viewer

    viewer = Viewer(replays_of("turntable", planned), port=0)
    try:
        stage, pillar = viewer.stage, body(replay, "pillar")

        def places() -> float:
            found = []
            for target in range(len(replay.target)):
                viewer.go_to(target)
                found.append(np.array(stage._arm[pillar].position))
            return spread(found)

        assert places() < 1e-9 and not np.allclose(stage.T_part, AT_REST)
        stage.look_from(True)
        assert places() > 0.05 and stage.T_part is AT_REST
        stage.look_from(False)
        assert places() < 1e-9
    finally:
        viewer.stop()
