"""Pictures and movies: not blank, moving, all in view, targets coloured by status; and one line for each error."""

import json
import subprocess
from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_once import seven_joints
from made_plan import STATUSES, made_plan, with_a_dwell
from PIL import Image

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.model import Workpiece
from htcp_jax.model.convex_piece import body_pieces, make_piece
from htcp_jax.model.kinematics import ArmShape, tcp_position
from htcp_jax.spec.config import PlanConfig
from htcp_jax.status import Kind
from htcp_jax.viewer import Studio, offscreen
from htcp_jax.viewer.camera import kept_points, nearest_camera
from htcp_jax.viewer.colours import DWELL, FAILED, NEAREST, TargetStyle, rgb, target_styles
from htcp_jax.viewer.movie import LAST_REPEATS, RATE, Film, write_movie
from htcp_jax.viewer.playback import STRIDE_M, poses_along
from htcp_jax.viewer.replay import replays_of
from htcp_jax.viewer.workcell import Workcell

SIZE = 320, 220


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A plan made by hand, and the folder it is saved in."""
    folder = tmp_path_factory.mktemp("made")
    plan = made_plan(folder)
    plan.save(folder / "plan")
    return plan, folder / "plan"


@pytest.fixture(scope="module")
def replay(made):
    return replays_of("by hand", made[0]).replay(0, "baseline")


@pytest.fixture(scope="module")
def frames(replay, screenless):
    """Frames of a small movie."""
    with Studio(replay, *SIZE, fine=False) as studio:
        movie = studio.movie()
        return [movie[k] for k in range(len(movie))]


def film_of(frames: list[np.ndarray]) -> Film:
    return Film(len(frames), frames.__getitem__)


def near(frame: np.ndarray, colour: str) -> int:
    """Number of pixels with the colour's hue: light and shade change a colour's length more than its direction."""
    pixels, wanted = frame.reshape(-1, 3) - frame.reshape(-1, 3).mean(axis=1, keepdims=True), np.array(rgb(colour))
    wanted = (wanted - wanted.mean()) / np.linalg.norm(wanted - wanted.mean())
    return int(((pixels @ wanted) > np.maximum(40, 0.97 * np.linalg.norm(pixels, axis=1))).sum())


def colour_of(name: str) -> str:
    (style,) = [style for style in target_styles(np.zeros(1, np.int8)) if style.name == name]
    return style.colour


def test_a_picture_is_not_blank_and_shows_the_failed_target(replay, screenless):
    with Studio(replay, *SIZE, close=True, fine=False) as studio:
        picture = studio.still(7)
    assert picture.shape == (SIZE[1], SIZE[0], 3) and picture.std() > 20
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
    assert near(picture, FAILED) > 20


def test_a_movie_moves_and_the_targets_take_their_colours_as_they_are_met(replay, frames):
    assert len(frames) == len(poses_along(replay)) + 1
    changes = [np.abs(a.astype(int) - b).max(axis=2) > 30 for a, b in pairwise(frames)]
    assert all(change.any() for change in changes)
    assert (np.abs(frames[0].astype(int) - frames[-1]).max(axis=2) > 30).mean() > 0.02
    assert not any(change[:10, :10].any() for change in changes)  # the far corner is the sky
    assert not any(near(frame, FAILED) for frame in frames[:-1]) and near(frames[-1], FAILED)
    assert near(frames[0], colour_of("tracked")) < near(frames[-1], colour_of("tracked"))


def test_the_way_passes_every_tracked_target_in_small_strides(replay):
    poses = poses_along(replay)
    met = [pose.target for pose in poses]
    assert met == sorted(met) and set(met) == set(range(8))
    for t in range(8):
        first = poses[met.index(t)].arm
        np.testing.assert_allclose(first.p, replay.shape.p[t], atol=1e-12)
        np.testing.assert_allclose(first.tcp, replay.shape.tcp[t], atol=1e-12)
    points = np.array([np.vstack([arm.p, arm.q, arm.tcp]) for arm, *_ in poses])
    # Along an arc a point moves a little further than along its chord.
    assert np.linalg.norm(np.diff(points, axis=0), axis=2).max() < 1.3 * STRIDE_M


@pytest.fixture(scope="module")
def dwelling(made):
    """The plan, with a change of configuration at target 4."""
    return replays_of("by hand", replace(made[0], plans=with_a_dwell(made[0].plans))).replay(0, "baseline")


def test_the_way_passes_the_configurations_between_targets_and_knows_where_the_arm_dwells(dwelling):
    """Frames of a motion with a dwell: they pass all its configurations, and mark where the arm dwells.

    Joint values are not part of a frame, so configurations are identified by the arm's shape.
    """
    poses = poses_along(dwelling)
    at_target = [k for k, pose in enumerate(poses) if pose.target == 4]
    turning = [k for k, pose in enumerate(poses) if pose.dwells]
    assert set(turning) < set(at_target) and turning == list(range(turning[0], turning[-1] + 1))
    passed = dwelling.motion.x[dwelling.motion.kind == Kind.DWELL]
    assert len(passed) == 2
    tips = np.array([pose.arm.tcp for pose in poses])
    for x in passed:
        tcp = np.asarray(tcp_position(dwelling.robot, jnp.asarray(x)))
        assert np.abs(tips[turning] - tcp).max(axis=1).min() < 1e-12
    points = np.array([np.vstack([pose.arm.p, pose.arm.q, pose.arm.tcp]) for pose in poses])
    assert np.linalg.norm(np.diff(points, axis=0), axis=2).max() < 1.3 * STRIDE_M
    assert [pose.target for pose in poses] == sorted(pose.target for pose in poses)


def test_a_picture_marks_the_dwells_and_the_minimum_clearance(replay, dwelling, screenless):
    with Studio(dwelling, *SIZE, close=True, fine=False) as studio:
        marked = studio.still(0)
    with Studio(replay, *SIZE, close=True, fine=False) as studio:
        plain = studio.still(0)
    assert near(marked, DWELL) > near(plain, DWELL) + 10
    assert near(marked, NEAREST) > near(plain, NEAREST)


def test_the_command_tells_of_the_motion(made, screenless, tmp_path, capsys):
    words = ["--movie", "none", "--width", "160", "--out", str(tmp_path), "--json"]
    replace(made[0], plans=with_a_dwell(made[0].plans)).save(tmp_path / "plan")
    assert main(["render", str(tmp_path / "plan"), *words]) == 0
    motion = json.loads(capsys.readouterr().out)["motion"]
    assert (motion["executable"], motion["dwells"], motion["clearance_target"], motion["clearance_m"]) == (
        7,
        [4],
        5,
        2e-4,
    )


def test_the_open_side_s_half_is_cut_off(replay):
    left = kept_points(replay)
    near_side = replay.sides[0].axis.direction
    assert (replay.cloud[~left] @ near_side).min() >= (replay.cloud[left] @ near_side).max()
    assert 0.2 < left.mean() < 0.8 and kept_points(replay, 0.0).all() and kept_points(replay, 1.0).sum() <= 1


SPHERES = st.lists(st.tuples(*[st.floats(-2, 2)] * 3, st.floats(0.01, 0.5)), min_size=1, max_size=6)


@given(SPHERES, st.floats(-3, 3), st.floats(0.5, 2))
def test_every_sphere_is_seen_whole_and_one_touches_the_edge(spheres, azimuth, aspect):
    fovy = np.radians(40.0)
    spheres = np.array(spheres)
    given_ahead = np.array([np.cos(azimuth), np.sin(azimuth), -0.5]) / np.hypot(1, 0.5)
    eye, look_at = nearest_camera(spheres[:, :3], spheres[:, 3], given_ahead, fovy, aspect)
    ahead = (look_at - eye) / np.linalg.norm(look_at - eye)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    seen = (spheres[:, :3] - eye) @ np.stack([right, np.cross(right, ahead), ahead], axis=1)
    slope = 0.94 * np.tan(fovy / 2) * np.array([aspect, 1.0])
    # Distance to each of the four planes through the eye that bound the view, less the radius.
    free_radius = [
        (seen[:, 2] * s - sign * seen[:, k]) / np.hypot(1, s) - spheres[:, 3]
        for k, s in enumerate(slope)
        for sign in (1, -1)
    ]
    assert np.min(free_radius) > -1e-9 and np.min(free_radius) < 1e-9


def test_a_gif_holds_all_frames_and_runs_for_ever(frames, tmp_path):
    write_movie(tmp_path / "a.gif", film_of(frames))
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (len(frames), SIZE, 0)
        gif.seek(gif.n_frames - 1)
        assert gif.info["duration"] == 1000 * LAST_REPEATS / RATE
        shown = np.asarray(gif.convert("RGB")).astype(int)
    assert np.abs(shown - frames[-1]).mean() < 6


def test_a_gif_keeps_a_colour_that_its_last_frame_has_lost(tmp_path):
    """Colours of a GIF whose last frame lacks them.

    A tracked path is blue until, in the last frame, the tool hides it among a thousand other colours.
    """
    noise = np.random.default_rng(0).integers(60, 200, (24, 32, 3), dtype=np.uint8)
    blue = noise.copy()
    blue[8:16] = 30, 60, 250
    write_movie(tmp_path / "a.gif", film_of([blue, blue, blue, noise]))
    with Image.open(tmp_path / "a.gif") as gif:
        shown = np.asarray(gif.convert("RGB"), int)
    assert np.abs(shown[8:16] - (30, 60, 250)).max() < 30


def test_an_mp4_can_be_read_again(frames, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `movie` is not installed")
    write_movie(tmp_path / "a.mp4", film_of(frames))
    decode = [ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    pixels = np.frombuffer(subprocess.run(decode, capture_output=True, check=True).stdout, np.uint8)
    film = pixels.reshape(-1, SIZE[1], SIZE[0], 3).astype(int)
    assert len(film) == len(frames) + LAST_REPEATS
    assert np.abs(film[0] - frames[0]).mean() < 6 and np.abs(film[-1] - frames[-1]).mean() < 6


def test_the_command_leaves_a_picture_and_a_movie(made, screenless, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["render", str(made[1]), "--width", "200", "--out", str(out), "--json"]) == 0
    output = capsys.readouterr()
    record = json.loads(output.out)
    assert output.err == "" and (record["tracked"], record["failed"], record["shown"]) == (8, 8, 7)
    assert record["files"] == [str(out / "scenario-0-baseline.png"), str(out / "scenario-0-baseline.gif")]
    for file, size in zip(record["files"], [(200, 138), (100, 68)], strict=True):
        with Image.open(file) as image:
            assert image.size == size
    assert len(list(out.iterdir())) == 2


def test_any_arm_is_drawn(made, screenless, tmp_path):
    plan = made[0]
    replay = replays_of("by hand", plan).replay(0, "baseline")
    arm = seven_joints(tmp_path)
    ends = np.tile(np.linspace([0, 0, 0.0], [1.2, 0, 1.0], 8), (len(replay.target), 1, 1))
    shape = ArmShape(ends, ends + 0.1, tip=ends[:, -1] + 0.1, tcp=ends[:, -1] + 0.3)
    other = replay._replace(robot=arm, shape=shape, obstruction=None)
    with Studio(other, *SIZE, fine=False) as studio:
        assert studio.still(3).std() > 20


def test_at_the_failed_target_the_body_in_collision_stands_out(replay, screenless):
    """Colliding body at the failed target: coloured as failed (regression: it was not marked)."""
    assert replay.obstruction is not None
    with Studio(replay, *SIZE, close=True, fine=False) as studio:
        failed, before = studio.still(replay.failed), studio.still(replay.failed - 1)
    assert near(failed, FAILED) > near(before, FAILED) + 20


def test_a_convex_piece_is_drawn_in_place_of_its_capsule(made, replay, screenless):
    """Pieces as large as their capsules give the same picture; pieces that are the capsules' axes a thin arm."""
    pictures, plan = [], made[0]
    for share in (1.0, 0.0):
        ends = zip(plan.robot.capsule_p, plan.robot.capsule_q, plan.robot.capsule_radius, strict=True)
        shapes = [make_piece(np.stack([p, q]), share * float(radius)) for p, q, radius in ends]
        robot = replace(plan.robot, pieces=body_pieces(shapes, np.full(len(shapes), 1.0)))
        with Studio(replays_of("pieces", replace(plan, robot=robot)).replay(0, "baseline"), *SIZE) as studio:
            pictures.append(studio.still(6).astype(int))
    with Studio(replay, *SIZE) as studio:
        capsules = studio.still(6)
    same, thin = ((np.abs(picture - capsules).max(axis=2) > 40).mean() for picture in pictures)
    assert same < 0.02 < 0.2 < thin


def test_a_path_without_a_cloud_is_drawn_as_dots_and_not_as_a_wall():
    path = np.linspace([0.5, 0, 0], [0.5, 0.6, 0], 13)
    surface = Workcell(PlanConfig(), made_once.robot(), Workpiece("air", np.empty((0, 3)), path)).surface
    assert np.array_equal(surface.points, path) and surface.radius.max() < 1e-3


def test_a_file_that_is_a_picture_is_the_only_file_written(made, screenless, tmp_path):
    assert main(["render", str(made[1]), "--width", "160", "--out", str(tmp_path / "new" / "arm.PNG")]) == 0
    assert [file.name for file in tmp_path.rglob("*")] == ["new", "arm.PNG"]


def test_the_command_says_what_is_in_collision_and_which_scenario_it_is(made, planned, screenless, tmp_path, capsys):
    """Colliding body and scenario parameters in the output of the command (regression: only the scenario's number)."""
    words = ["--movie", "none", "--width", "160", "--out", str(tmp_path)]
    assert main(["render", str(made[1]), *words]) == 0
    obstruction = replays_of("by hand", made[0]).replay(0, "baseline").obstruction
    assert f"{obstruction.description}\n" in capsys.readouterr().out
    assert main(["render", str(planned / "run"), "--scenario", "1", *words]) == 0
    assert "baseline, scenario 1: rotation y 0.5 rad, tool extension 0 m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--scenario", "3"], "has no scenario 3 by baseline; it has 0"),
        (["--method", "hybrid"], "has no results of 'hybrid'; it has baseline"),
        (["--target", "10"], "scenario 0 has no target 10; it has 0 to 9"),
        (["--movie", "avi"], "'avi' is not a kind of movie; valid: gif, mp4"),
        (["--width", "5"], "--width is 5; valid: 160 to 3840 pixels"),
        (["--out", "arm.png", "--movie", "gif"], "--out arm.png is a picture, but --movie is gif; omit --movie"),
        (["--out", "arm.png", "--feed", "9mm/s"], "--feed applies to the movie, but --out arm.png writes no movie"),
    ],
)
def test_bad_input_is_one_line_exit_2_and_no_file(made, screenless, tmp_path, monkeypatch, capsys, arguments, line):
    monkeypatch.chdir(tmp_path)
    assert main(["render", str(made[1]), *arguments]) == 2
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.err.startswith("htcp: ")
    assert output.out == "" and not list(tmp_path.iterdir())


def test_no_such_run_is_one_line(screenless, tmp_path, capsys):
    assert main(["render", str(tmp_path / "nowhere")]) == 2
    assert "nowhere contains neither a run of htcp sweep" in capsys.readouterr().err


def test_without_opengl_the_packages_are_named(made, opengl, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    opengl()
    assert main(["render", str(made[1])]) == 2
    error = capsys.readouterr().err
    assert "libegl1, libopengl0 and libgl1-mesa-dri (EGL), or libosmesa6 (OSMesa)" in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_osmesa_stands_in_where_egl_fails(opengl, monkeypatch):
    opengl("osmesa")
    assert offscreen.platform() == "osmesa"
    monkeypatch.setenv("MUJOCO_GL", "egl")
    offscreen.platform.cache_clear()
    with pytest.raises(InputError, match=r"no off-screen OpenGL \(egl\)"):
        offscreen.platform()


def test_the_statuses_are_all_distinguished():
    found = target_styles(np.array(STATUSES[0], np.int8))
    assert sum(style.where for style in found).tolist() == [1] * 10
    assert all(isinstance(style, TargetStyle) for style in found) and len({style.colour for style in found}) == 4
