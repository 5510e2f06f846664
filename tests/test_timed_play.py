"""Playback of a robot program: frames at true speed, plots of the timed curve, and one line for each error."""

import json
import subprocess
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from made_plan import STATUSES, driven, made_plan, made_plans
from PIL import Image

from htcp_jax.cli import main
from htcp_jax.model.kinematics import capsule_segments, tcp_position
from htcp_jax.runs import open_plans
from htcp_jax.status import Kind
from htcp_jax.trajectory.plan_program import program_of
from htcp_jax.viewer import Studio
from htcp_jax.viewer.browser.timeline import ByTarget, ByTime
from htcp_jax.viewer.movie import RATE
from htcp_jax.viewer.plot_strip import PlotStrip
from htcp_jax.viewer.replay import open_replays
from htcp_jax.viewer.timed_play import Curves, arms_of, frame_times, sample_program

FEED, SIZE = "200mm/s", (320, 220)
DARK, STEP_S = 90, 1e-5  # of a line's pixels; of a finite difference


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A plan made by hand whose motion leads to its last target, next to one whose motion does not."""
    folder = tmp_path_factory.mktemp("driven")
    plan = made_plan(folder)
    plan.save(folder / "bad")
    replace(plan, plans=driven(made_plans(plan.scenario.targets, STATUSES[1:]))).save(folder / "plan")
    return folder / "plan"


@pytest.fixture(scope="module")
def made(folder):
    return program_of(open_plans(folder), 0.2)


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.3])
def test_the_arm_in_each_frame_is_where_the_timed_curve_has_it_then(made, speed):
    times = frame_times(made.program.duration_s, speed)
    np.testing.assert_allclose(np.diff(times), speed / RATE, rtol=1e-9)
    assert 0 <= len(times) / RATE - made.program.duration_s / speed <= 1 / RATE
    row = arms_of(made, sample_program(made, times))
    for k in (0, len(times) // 3, len(times) - 1):
        x = made.program.at(np.array([k * speed / RATE])).x
        np.testing.assert_allclose(
            row[k].arm.p, np.asarray(capsule_segments(made.robot, jnp.asarray(x[0]))[0]), atol=1e-9
        )


def test_the_targets_are_come_to_when_the_tool_passes_them(made, folder):
    passed = made.program.at_configurations()
    on_path = np.flatnonzero(passed.kind == Kind.PROCESS)
    for k in on_path.tolist():
        before, after = (sample_program(made, passed.time_s[k : k + 1] + d).target[0] for d in (-0.01, 0.01))
        assert (before, after) == (passed.target[k] - 1, passed.target[k])
    back = np.flatnonzero(passed.kind == Kind.RETRACT)
    for k in back[:-1].tolist():
        before, after = (sample_program(made, passed.time_s[k : k + 1] + d).target[0] for d in (-0.01, 0.01))
        assert (before, after) == (passed.target[k - 1], passed.target[k])
    whole = sample_program(made, np.linspace(0, made.program.duration_s, 200))
    assert whole.target[0] == 0 and whole.target.max() == 9 and whole.target[-1] == 0  # the plan starts at target 0
    there = program_of(open_plans(folder), 0.2, retract=False)
    assert sample_program(there, np.array([there.program.duration_s])).target.tolist() == [9]


def test_what_is_plotted_is_how_fast_the_timed_curve_is(made):
    """Plotted speeds, by central differences of the joints and the TCP."""
    curves, limits = Curves.of(made, 40), made.limits.velocity
    inner = slice(1, -1)  # at its ends the arm is at rest
    before, after = (made.program.at(curves.time_s[inner] + d).x for d in (-STEP_S, STEP_S))
    rates = np.abs(after - before) / (2 * STEP_S)
    np.testing.assert_allclose(
        np.stack(list(curves.share_percent.values()))[:, inner].T, 100 * rates / limits, atol=0.01
    )
    tcp = [np.asarray(jax.vmap(partial(tcp_position, made.robot))(jnp.asarray(x))) for x in (before, after)]
    speed = 1e3 * np.linalg.norm(tcp[1] - tcp[0], axis=1) / (2 * STEP_S)
    plotted = np.stack(list(curves.tcp_mm_s.values()))
    assert ((~np.isnan(plotted)).sum(axis=0) == 1).all()  # each instant has one kind
    np.testing.assert_allclose(np.nansum(plotted, axis=0)[inner], speed, atol=0.05)
    kinds = made.program.at(curves.time_s).kind
    assert {kind: (~np.isnan(row)).tolist() for kind, row in curves.tcp_mm_s.items()} == {
        Kind(kind): (kinds == kind).tolist() for kind in np.unique(kinds).tolist()
    }
    assert curves.feed_mm_s == pytest.approx(200) and list(curves.share_percent) == list(made.robot.joint_names)


def test_the_line_in_the_strip_is_at_the_present_time_and_the_curves_are_beneath(made):
    times = frame_times(made.program.duration_s)
    strip = PlotStrip(made, sample_program(made, times), 640)
    above, below = strip.figure.axes
    curves = Curves.of(made)
    drawn = [line for line in above.lines if line.get_label() in ("approach", "process", "retract")]
    for line, kind in zip(drawn, (Kind.APPROACH, Kind.PROCESS, Kind.RETRACT), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), curves.tcp_mm_s[kind])
    drawn = {line.get_label(): line.get_ydata() for line in below.lines}
    assert all(np.array_equal(drawn[name], share) for name, share in curves.share_percent.items())
    pictures = [strip.at(k).astype(int) for k in range(len(times))]
    height, width = pictures[0].shape[:2]
    assert width == 640 and height % 2 == 0 and len(np.unique(pictures[0].reshape(-1, 3), axis=0)) > 100
    for k in (10, 40, len(times) - 2):
        column = round(below.transData.transform((times[k], 1.0))[0])
        box = below.get_window_extent()
        rows = slice(height - int(box.y1) + 3, height - int(box.y0) - 3)
        dark = (pictures[k][rows].max(axis=2) < DARK).mean(axis=0)
        assert abs(int(dark[int(box.x0) + 3 :].argmax()) + int(box.x0) + 3 - column) <= 1 and dark.max() > 0.9


def test_the_picture_says_at_which_speed_it_is_shown(made):
    def words(speed: float) -> list[str]:
        return [text.get_text() for text in PlotStrip(made, sample_program(made, np.zeros(1)), 320, speed).figure.texts]

    assert "in real time" in words(1.0) and "at 4 times real time" in words(4.0)


def test_the_film_is_the_scene_over_the_strip_and_sees_all_of_the_arm(made, folder, screenless):
    replay = open_replays(folder).replay(0, "baseline")
    play = sample_program(made, frame_times(made.program.duration_s, 4.0))
    with Studio(replay, *SIZE, fine=False) as studio:
        alone = studio.film(arms_of(made, play))
        film = alone.over(PlotStrip(made, play, studio.width, 4.0).at)
        first, last, scene = film[0], film[len(film) - 1], alone[0]
    np.testing.assert_array_equal(first[: SIZE[1]], scene)
    edges = np.concatenate([scene[0], scene[:, 0], scene[:, -1]]).astype(int)
    grey = np.abs(edges - edges.mean(axis=1, keepdims=True)).max(axis=1) < 12
    assert grey.all()  # sky and floor, no part of the arm
    assert len(film) == len(play.time_s) and film.last_repeats == 0
    assert first.shape == last.shape and first.shape[0] > SIZE[1] and first.shape[1] == SIZE[0]
    with pytest.raises(IndexError):
        film[len(film)]


def run(folder, *words: str) -> int:
    return main(["render", str(folder), "--feed", FEED, "--width", "160", *words])


def test_an_mp4_takes_as_long_as_the_program_to_within_a_frame(made, folder, screenless, tmp_path, capsys):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `movie` is not installed")
    assert run(folder, "--out", str(tmp_path / "weld.mp4"), "--json") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["program"] == {"duration_s": made.program.duration_s, "feed_mm_s": 200.0, "speed": 1.0}
    assert record["files"] == [str(tmp_path / "weld.mp4")] == [str(file) for file in tmp_path.iterdir()]
    decode = [ffmpeg.get_ffmpeg_exe(), "-i", tmp_path / "weld.mp4", "-f", "rawvideo", "-pix_fmt", "gray", "-"]
    said = subprocess.run(decode, capture_output=True, check=True)
    frames = len(said.stdout) // (80 * (56 + 30))
    assert abs(frames / RATE - made.program.duration_s) <= 1 / RATE and f"{RATE} fps" in said.stderr.decode()


def test_a_gif_takes_its_time_too_and_the_way_back_can_be_left_out(folder, screenless, tmp_path, capsys):
    assert run(folder, "--out", str(tmp_path), "--one-way", "--speed", "2") == 0
    there = program_of(open_plans(folder), 0.2, retract=False).program.duration_s
    assert f"  {there:.2f} s at 200 mm/s, shown at 2 times real time" in capsys.readouterr().out
    with Image.open(tmp_path / "scenario-0-baseline.gif") as gif:
        assert abs(gif.n_frames / RATE - there / 2) <= 1 / RATE
        shown_s = []
        for k in range(gif.n_frames):
            gif.seek(k)
            shown_s.append(gif.info["duration"] / 1000)
    assert sum(shown_s) == pytest.approx(gif.n_frames / RATE)
    assert (tmp_path / "scenario-0-baseline.png").exists()


def test_play_by_time_goes_on_with_the_clock_and_ends_with_the_program(made):
    timeline = ByTime(made)
    assert timeline.after(1.0, 0.25, 1.0) == 1.25 and timeline.after(1.0, 0.25, 4.0) == 2.0
    assert timeline.after(1.0, 1e3, 1.0) == timeline.last and 0 <= timeline.last - made.program.duration_s <= 0.01
    pose, said = timeline.look(1.234)
    now = sample_program(made, np.array([1.234]))
    np.testing.assert_array_equal(pose.arm.tcp, arms_of(made, now)[0].arm.tcp)
    assert "1.23 s" in said and f"{1e3 * now.tcp_m_s[0]:.1f} mm/s" in said and Kind(now.kind[0]).words in said


def test_play_by_targets_leaves_no_configuration_out_and_stands_where_nothing_is_tracked(folder):
    replay = open_replays(folder.parent / "bad").replay(0, "baseline")
    timeline = ByTarget(replay, "Not timed.")
    places = [timeline.begin]
    while places[-1] < timeline.last:
        places.append(timeline.after(places[-1], 1e3, 40.0))
    assert len(places) == len(timeline.passed) and places == sorted(set(places))
    for target in range(10):
        pose, said = timeline.look(float(target))
        assert timeline.on_slider(float(target)) == target == pose.target and said == "Not timed."
        np.testing.assert_allclose(pose.arm.tcp, replay.shape.tcp[target], atol=1e-12)


NO_FEED = "applies to a timed motion only: pass --feed, too"
FEEDS = "20mm/s"
WRONG = [
    (["--speed", "2"], f"--speed {NO_FEED}"),
    (["--one-way"], f"--one-way {NO_FEED}"),
    (["--set", "program.full_speed_s=0.4"], f"--set {NO_FEED}"),
    (["--feed", "20"], "feed '20' is not a speed above 0 with a unit, such as 20mm/s"),
    (["--feed", "0mm/s"], "feed '0mm/s' is not a speed above 0"),
    (["--feed", FEEDS, "--speed", "0"], "--speed is 0; valid: 0.1 to 100"),
    (["--feed", FEEDS, "--movie", "none"], "--feed applies to the movie, but --movie none writes no movie"),
    (["--feed", FEEDS, "--set", "margin_m=0"], "only keys of program.* can be changed"),
    (["--movie", "gif", "--out", "weld.mp4"], "--out weld.mp4 is a mp4 file, but --movie is gif; omit"),
]


@pytest.mark.parametrize(("words", "says"), WRONG)
def test_what_is_wrong_is_one_line_exit_2_and_no_file(folder, screenless, tmp_path, monkeypatch, capsys, words, says):
    monkeypatch.chdir(tmp_path)
    assert main(["render", str(folder), *words]) == 2
    output = capsys.readouterr()
    assert says in output.err and output.err.count("\n") == 1 and output.out == "" and not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["render", "view"])
def test_a_plan_that_is_not_executable_says_how_far_it_is(folder, screenless, tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    assert main([command, str(folder.parent / "bad"), "--feed", FEEDS]) == 2
    output = capsys.readouterr()
    assert "the motion leads to only 0 of 10 targets" in output.err and output.err.count("\n") == 1
    assert output.out == "" and not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [["--one-way"], ["--feed", "fast"], ["--feed", FEEDS, "--set", "margin_m=0"]])
def test_the_page_refuses_the_same(folder, capsys, words):
    pytest.importorskip("viser", reason="the extra `view` is not installed")
    assert main(["view", str(folder), "--port", "0", *words]) == 2
    assert capsys.readouterr().err.count("\n") == 1
