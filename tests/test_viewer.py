"""The viewer in a real browser: the page loads, the slider moves the arm, the view is not blank.

Needs a Chromium of the system and Playwright (of the extra `test`); without either, the tests in the browser skip.
"""

import http.server
import io
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import REBOUND
from made_plan import STATUSES, driven, made_plan, made_plans, with_a_dwell
from PIL import Image

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.model.convex_piece import body_pieces, make_piece
from htcp_jax.model.kinematics import body_poses, capsule_segments
from htcp_jax.status import SegmentStatus
from htcp_jax.system.process_exit import INTERRUPTED
from htcp_jax.trajectory.plan_program import program_of_plans
from htcp_jax.viewer.colours import FAILED
from htcp_jax.viewer.playback import poses_along
from htcp_jax.viewer.replay import Replays, replays_of
from htcp_jax.viewer.timed_play import Curves
from htcp_jax.viewer.viewpoints import View
from htcp_jax.viewer.workcell import GivenCell, Workcell

pytest.importorskip("viser", reason="the extra `view` is not installed")

import viser
import websockets.sync.client
import websockets.sync.server

from htcp_jax.viewer import Viewer
from htcp_jax.viewer.browser.display import grazing
from htcp_jax.viewer.browser.scene import compensated, label_groups, rotations_to
from htcp_jax.viewer.browser.texts import describe
from htcp_jax.viewer.browser.timeline import ByTarget


def arm_positions(stage) -> np.ndarray:
    """Centres of the capsules and of the bare tip, and origins of the convex pieces' links, as drawn."""
    return np.array([node.position for node in stage._arm])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a plan made by hand."""
    folder = tmp_path_factory.mktemp("made")
    made_plan(folder).save(folder / "plan")
    return folder / "plan"


@pytest.fixture(scope="module")
def replays(tmp_path_factory) -> Replays:
    """Two scenarios by three methods: one fails in scenario 1, the others in none; the last has a dwell."""
    plan = made_plan(tmp_path_factory.mktemp("shelf"))
    plans = {
        "baseline": made_plans(plan.scenario.targets, STATUSES[::-1]),  # scenario 1 fails
        "hybrid": made_plans(plan.scenario.targets, [STATUSES[1], STATUSES[1]]),
        "beam": with_a_dwell(made_plans(plan.scenario.targets, [STATUSES[1], STATUSES[1]])),
    }
    cell = GivenCell(Workcell(plan.job, plan.robot, plan.workpiece), plan.scenario)
    return Replays("two", tuple(plans), plans.__getitem__, cell)


@pytest.fixture
def viewer(replays):
    viewer = Viewer(replays, port=0)
    yield viewer
    viewer.stop()


@pytest.fixture
def page(browser, viewer):
    """The viewer's page."""
    page, problems = opened(browser, viewer)
    yield page
    page.close()
    assert not problems


# Viser's note where a slow page gets an update of a plot and its removal at once: it removes first. Nothing is lost.
LATE = "Tried to update non-existent component"


def opened(browser, viewer, width: int = 900):
    """Open the page; return it, drawn, and a list of its errors and foreign requests."""
    page, problems = browser.new_page(viewport={"width": width, "height": 560}), []
    page.set_default_timeout(180_000)  # a busy machine without a GPU draws slowly
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on(
        "console",
        lambda message: message.type == "error" and LATE not in message.text and problems.append(message.text),
    )
    own = viewer.address.partition("/?")[0]
    page.on("request", lambda request: own in request.url or problems.append(request.url))
    page.goto(viewer.address)
    page.get_by_role("slider").first.wait_for()
    until(lambda: spread(seen(page)) > 15)
    return page, problems


def until(done: Callable[[], bool], seconds: float = 180.0) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it did not come to be so"
        time.sleep(0.1)


def step_to(page, viewer, slider, place: float) -> None:
    """Press arrow keys on the slider one by one until viewer and page are at a place of the timeline.

    The server moves the slider, too: keys that are pressed faster than the page is drawn are lost.
    """
    slider.focus()

    def arrived() -> bool:
        settled = slider.get_attribute("aria-valuenow") == f"{viewer.place:g}"
        if settled and viewer.place != place:
            page.keyboard.press("ArrowRight" if viewer.place < place else "ArrowLeft")
        return settled and viewer.place == place

    until(arrived)


def seen(page) -> np.ndarray:
    """Screenshot left of the panel, without the notice at the top, as soon as it is stable.

    Single pixels may change: where two surfaces meet, some flicker all the time.
    """
    box = {"x": 0, "y": 160, "width": 560, "height": 400}
    shots = []

    def at_rest() -> bool:
        shots.append(np.asarray(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB")).astype(int))
        return len(shots) > 1 and (np.abs(shots[-1] - shots[-2]).max(axis=2) > 8).mean() < 1e-4

    until(at_rest)
    return shots[-1]


def spread(picture: np.ndarray) -> float:
    return float(picture.std())


def test_in_a_narrow_window_everything_is_in_view_from_a_camera_farther_away(browser, viewer):
    page, _ = opened(browser, viewer, width=640)
    given = viewer.server.initial_camera

    def distance(camera) -> float:
        return float(np.linalg.norm(np.subtract(camera.position, camera.look_at)))

    until(lambda: any(distance(c.camera) > 1.3 * distance(given) for c in viewer.server.get_clients().values()))
    page.close()


def test_the_slider_moves_the_arm_in_the_browser(page, viewer, replays):
    assert viewer.target == 0 and page.get_by_text("Target 0").is_visible()
    before, start = seen(page), arm_positions(viewer.stage)
    slider = page.get_by_role("slider").first
    step_to(page, viewer, slider, 6)
    replay = replays.replay(1, "baseline")
    np.testing.assert_allclose(arm_positions(viewer.stage)[:8], (replay.shape.p[6] + replay.shape.q[6]) / 2, atol=1e-6)
    assert np.abs(arm_positions(viewer.stage) - start).max() > 0.1
    page.get_by_text("tracked after a recovery.").wait_for()
    clearance = f"{1e3 * replay.clearance[6]:.4g} mm"
    page.get_by_text(clearance, exact=True).wait_for()
    assert viewer.stage.label == f"{clearance} at target 6"
    after = seen(page)
    assert (np.abs(after - before).max(axis=2) > 40).mean() > 0.01  # the arm, and not a pixel here and there


def test_the_pickers_show_failed_scenarios_first_and_other_methods(page, viewer):
    method, scenario = page.get_by_role("combobox").nth(0), page.get_by_role("combobox").nth(1)
    assert (method.input_value(), scenario.input_value()) == ("baseline", "1: failed at 8 of 10")
    scenario.click()
    assert page.get_by_role("option").all_inner_texts() == ["1: failed at 8 of 10", "0: all 10 tracked"]
    page.get_by_role("option").nth(1).click()
    until(lambda: viewer.shown == (0, "baseline"))
    method.click()
    page.get_by_role("option", name="hybrid").click()
    until(lambda: viewer.shown == (0, "hybrid") and scenario.input_value() == "0: all 10 tracked")


def test_the_picker_names_scenarios_by_what_sets_them_apart(replays):
    """Scenarios in the picker, named by the parameters that vary (regression)."""
    labels = {0: "rotation y 0.2 rad", 1: "rotation y 0.4 rad"}
    named = Replays("two", replays.methods, replays.plans, replays.cells, labels)
    names = [describe(outcome, named) for outcome in named.outcomes("baseline")]
    assert names == ["1: failed at 8 of 10; rotation y 0.4 rad", "0: all 10 tracked; rotation y 0.2 rad"]


def test_at_the_failed_target_the_body_in_collision_is_red_and_named(viewer, replays):
    """Colliding body at the failed target: red and named (regression)."""
    replay = replays.replay(*viewer.shown)
    body = replay.robot.capsule_names.index(replay.obstruction.body)
    viewer.go_to(replay.failed)
    colours = viewer.stage.arm_colours
    assert colours[body] == tuple(compensated(FAILED).tolist()) and colours.count(colours[body]) == 1
    assert viewer.stage.label == replay.obstruction.description in viewer.facts
    viewer.go_to(replay.failed - 1)
    assert tuple(compensated(FAILED).tolist()) not in viewer.stage.arm_colours


@pytest.fixture
def slowly(monkeypatch):
    """Playback that stays at each target for 50 s: it does not end before a busy machine has drawn the page."""
    monkeypatch.setattr(ByTarget, "rates", ("0.02",))
    monkeypatch.setattr(ByTarget, "usual_rate", "0.02")


def test_arrow_keys_step_and_the_space_bar_plays_and_pauses(slowly, page, viewer):
    page.locator("canvas").first.wait_for()
    for key, target in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1)):
        page.keyboard.press(key)
        until(lambda target=target: viewer.target == target)
    slider = page.get_by_role("slider").first
    until(lambda: slider.get_attribute("aria-valuenow") == "1")  # drawn, too: its keys count from there
    slider.focus()  # a slider with the focus reacts to the arrow keys, too
    page.keyboard.press("ArrowRight")
    time.sleep(1)
    assert viewer.target == 2
    play, pause = (page.get_by_role("button", name=name) for name in ("Play", "Pause"))
    icon = play.locator("svg").inner_html()
    page.keyboard.press("Space")
    pause.wait_for()
    until(lambda: pause.locator("svg").inner_html() != icon)
    page.keyboard.press("Space")
    play.wait_for()
    until(lambda: play.locator("svg").inner_html() == icon)
    play.click()  # a button with the focus reacts to the space bar, too
    pause.wait_for()
    page.keyboard.press("Space")
    play.wait_for()


def test_play_stops_at_the_last_target_that_is_tracked(page, viewer, replays):
    """Playback: it stops at the last tracked target (regression: it went past the failed one)."""
    page.get_by_role("button", name="Play").click()
    last = replays.replay(1, "baseline").failed - 1
    until(lambda: viewer.target >= last)
    time.sleep(1)
    assert viewer.target == last == 7
    page.get_by_role("button", name="Play").wait_for()


def test_play_passes_the_configurations_between_targets(page, viewer, replays):
    """Playback through a dwell: the arm is shown between targets, and the dwell is marked at target 4."""
    seen_at: list[np.ndarray] = []
    move = viewer.stage.move
    viewer.stage.move = lambda pose: (seen_at.append(pose.arm.tcp), move(pose))
    page.get_by_role("combobox").nth(0).click()
    page.get_by_role("option", name="beam").click()
    until(lambda: viewer.shown == (1, "beam"))
    reported = " ".join(getattr(mark, "text", "") for mark in viewer.stage._marks)
    assert (
        "dwell at 4" in reported and "minimum clearance, on the segment to target 5: at least 0.2 mm proven" in reported
    )
    page.get_by_role("button", name="Play").click()
    until(lambda: viewer.target >= 6)
    replay = replays.replay(1, "beam")
    turning = [pose.arm.tcp for pose in poses_along(replay) if pose.dwells]
    assert turning and all(np.abs(np.array(seen_at) - tcp).max(axis=1).min() < 1e-12 for tcp in turning)


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    """Two scenarios, of which the second fails, with the program of the first."""
    plan = made_plan(tmp_path_factory.mktemp("timed"))
    plans = driven(made_plans(plan.scenario.targets, STATUSES[::-1]))
    cell = GivenCell(Workcell(plan.job, plan.robot, plan.workpiece), plan.scenario)
    replays = Replays("timed", ("baseline",), lambda _: plans, cell)
    return replays, lambda number, method: program_of_plans("timed", plans, number, plan.job, 0.2, method)


def test_a_convex_piece_is_placed_like_its_link(tmp_path):
    plan = made_plan(tmp_path)
    pieces = body_pieces([make_piece(np.eye(3))] * 8, np.array([1.0] * 7 + [0.0]))
    viewer = Viewer(replays_of("pieces", replace(plan, robot=replace(plan.robot, pieces=pieces))), port=0)
    viewer.stage.pose(6)
    x, placed = jnp.asarray(plan.plans.x[0, 6]), arm_positions(viewer.stage)
    viewer.stop()
    np.testing.assert_allclose(placed[:7], body_poses(plan.robot, x)[:7, :3, 3], atol=1e-6)
    np.testing.assert_allclose(placed[7], np.mean(capsule_segments(plan.robot, x), axis=0)[7], atol=1e-6)


def test_a_program_is_played_at_its_own_time_over_plots_of_its_speeds(browser, timed):
    replays, programs = timed
    made = programs(0, "baseline")
    viewer = Viewer(replays, port=0, programs=programs)
    page, problems = opened(browser, viewer)
    slider = page.get_by_role("slider").first
    assert viewer.shown == (0, "baseline") and page.get_by_text("Time [s]").first.is_visible()
    until(lambda: page.locator(".uplot canvas").count() == 3)
    step_to(page, viewer, slider, 0.3)
    p, q = capsule_segments(made.robot, jnp.asarray(made.program.at(np.array([viewer.place])).x[0]))
    middle = (np.asarray(p) + np.asarray(q)) / 2
    np.testing.assert_allclose(arm_positions(viewer.stage)[: len(middle)], middle, atol=1e-6)
    page.get_by_text("0.30 s: approach, TCP").wait_for()
    began, from_s = time.monotonic(), viewer.place
    page.get_by_role("button", name="Play").click()
    until(lambda: viewer.place >= made.program.duration_s)
    assert time.monotonic() - began >= made.program.duration_s - from_s  # never faster than real time
    page.get_by_role("button", name="Play").wait_for()
    page.get_by_role("combobox").nth(1).click()
    page.get_by_role("option", name="1: failed at 8 of 10").click()
    page.get_by_text("Not timed: timed: the motion leads to only 8 of 10 targets").wait_for()
    until(lambda: page.locator(".uplot canvas").count() == 1)
    page.close()
    viewer.stop()
    assert not problems


def test_the_page_holds_the_times_and_the_speeds_of_the_program(timed):
    replays, programs = timed
    viewer, made = Viewer(replays, port=0, programs=programs), programs(0, "baseline")
    curves, tcp, joints = Curves.of(made), viewer.plots.tcp, viewer.plots.joints
    viewer.go_to(1.5)
    assert tcp.data[0][0] == 0 and tcp.data[0][-1] == pytest.approx(made.program.duration_s)
    for plot, own in ((tcp, curves.tcp_mm_s.values()), (joints, curves.share_percent.values())):
        first = len(plot.data) - 1 - len(own)
        for column, row in zip(plot.data[first:-1], own, strict=True):
            np.testing.assert_allclose(column, np.maximum(row, 0.1) if plot is joints else row)
        line = np.flatnonzero(~np.isnan(plot.data[-1]))
        np.testing.assert_allclose(plot.data[0][line], 1.5, atol=made.program.duration_s / 500)
        assert len(plot.series) == len(plot.data)
    assert (tcp.data[1] == 200).all()  # requested
    viewer.stop()


def test_dwells_side_by_side_share_a_label():
    assert label_groups(()) == [] and label_groups((3, 5, 9, 30, 40, 41)) == [[3, 5, 9], [30], [40, 41]]


def test_the_facts_of_a_target_tell_of_the_segment_there(replays):
    viewer = Viewer(replays, port=0, scenario=0, method="beam")
    viewer.go_to(4)
    assert "The arm changes its configuration here." in viewer.facts
    viewer.go_to(5)
    assert "proven: 0.2 mm clear at least. It is the minimum of the motion." in viewer.facts
    viewer.go_to(7)
    assert SegmentStatus.NOT_CHECKED.message in viewer.facts
    viewer.stop()


def test_the_cut_the_points_and_the_closer_look_change_the_picture(page):
    before = seen(page)
    sliders = page.get_by_role("slider")
    sliders.nth(1).focus()
    page.keyboard.press("Home")  # nothing is cut off
    until(lambda: sliders.nth(1).get_attribute("aria-valuenow") == "0")
    until(lambda: (np.abs(seen(page) - before).max(axis=2) > 20).mean() > 0.01)
    whole = seen(page)
    page.get_by_role("button", name="Look at the minimum distance").click()
    until(lambda: (np.abs(seen(page) - whole).max(axis=2) > 20).mean() > 0.1)


HOSTILE = '<img src=x onerror="window.owned=1">', "[x](javascript:window.owned=1)", "![x](/etc/hostname)"
HOSTILE += (
    "</span><script>window.owned=1</script>",
    "`<svg/onload=window.owned=1>`",
    "<iframe srcdoc='<script>top.owned=1'>",
)


def test_no_script_in_a_name_runs(browser, tmp_path):
    """Names of joints and bodies as text: JavaScript in them does not run (regression)."""
    plan, name = made_plan(tmp_path / "plan"), "".join(HOSTILE)
    bodies = tuple(f"{k} {HOSTILE[k % len(HOSTILE)]}" for k in range(len(plan.robot.capsule_names)))
    robot = replace(plan.robot, joint_names=HOSTILE, capsule_names=bodies)
    plans = driven(made_plans(plan.scenario.targets, STATUSES[::-1]))
    cell = GivenCell(Workcell(plan.job, robot, plan.workpiece), plan.scenario)
    replays = Replays(name, (name,), lambda _: plans, cell, dict.fromkeys(range(2), name))
    made = program_of_plans(name, plans, 0, plan.job, 0.2, name)._replace(robot=robot)

    def programs(number: int, method: str):
        if number:
            raise InputError(name)
        return made

    viewer = Viewer(replays, port=0, programs=programs)
    page, problems = opened(browser, viewer)
    page.get_by_text(re.compile(rf"^. {re.escape(HOSTILE[0])}$")).wait_for()  # a joint in the legend
    page.get_by_role("combobox").nth(1).click()
    page.get_by_role("option", name="1: ").click()
    page.get_by_text(f"Not timed: {name}.").wait_for()
    replay = replays.replay(*viewer.shown)
    for target in range(9):  # near each a body, for the last the blocking obstacle
        viewer.go_to(target)
        known = replay.obstruction.body if target == 8 else replay.witness.body[target]
        page.locator("p", has_text=known).first.wait_for()
    assert page.locator("[src=x], [src*=hostname], iframe, [onload], [onerror], a[href], p script").count() == 0
    assert page.evaluate("window.owned") is None
    page.close()
    viewer.stop()
    assert not problems


FOREIGN = """<script>
const got = window.got = [];
const ask = (url) => {
  fetch("http://" + url).then((r) => r.text()).then((t) => got.push(t), () => got.push(null));
  const socket = new WebSocket("ws://" + url, ["viser-v%s"]);
  socket.onmessage = (event) => got.push(event.data);
  socket.onopen = () => got.push("open");
  socket.onerror = () => got.push(null);
};
ask("%s");
</script>"""


@pytest.fixture
def elsewhere(viewer):
    """Address of a foreign page, which tries to read the viewer."""

    class Page(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write((FOREIGN % (viser.__version__, viewer.address.removeprefix("http://"))).encode())

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://localhost:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_page_of_somebody_else_gets_nothing(browser, viewer, elsewhere):
    """Requests of a foreign page: refused (regression: it read the whole scene and could move the slider)."""
    page = browser.new_page()
    page.goto(elsewhere)
    page.wait_for_function("window.got.length >= 2")
    assert page.evaluate("window.got") == [None, None]
    page.close()
    assert viewer.server.get_clients() == {}


def test_a_name_that_was_pointed_to_this_machine_gets_nothing(browser, viewer):
    """Unknown host names for this machine: refused (regression: pages could come to share the viewer's origin)."""
    page, port = browser.new_page(), viewer.address.rpartition(":")[2]
    answer = page.goto(f"http://{REBOUND}:{port}")
    assert (answer.status, answer.text()) == (403, "htcp view: unknown host\n")
    page.close()


def test_the_page_does_not_take_another_server_from_its_address(browser, viewer):
    """Server address in the page's own address: ignored.

    A link to the viewer's page that names a foreign server would let that server write the page.
    """
    requested = threading.Event()
    with websockets.sync.server.serve(lambda _: requested.set(), "127.0.0.1", 0) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        page = browser.new_page()
        with page.expect_console_message(lambda message: "is not connected" in message.text):
            page.goto(f"{viewer.address}/?websocket=ws://127.0.0.1:{other.socket.getsockname()[1]}")
        page.close()
        other.shutdown()
    assert not requested.is_set()


def ask(address: str, **headers: str) -> int:
    """Status of the answer to a request."""
    try:
        return urllib.request.urlopen(urllib.request.Request(address, headers=headers)).status
    except urllib.error.HTTPError as error:
        return error.code


SOCKET = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
SOCKET |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}


def test_a_server_for_other_machines_shows_nothing_without_the_token(browser, replays):
    viewer = Viewer(replays, host="0.0.0.0", port=0)
    own, _, token = viewer.address.partition("/?token=")
    port = own.rpartition(":")[2]
    own = f"http://127.0.0.1:{port}"  # independent of this machine's name
    assert len(token) > 40 and ask(own) == ask(f"{own}/?token=") == ask(f"{own}/?token={token[:-1]}") == 403
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
        websockets.sync.client.connect(f"ws://127.0.0.1:{port}", origin=own)
    given = {"Cookie": f"htcp-view-{token[:6]}={token}"}
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):  # a page on this machine, at another port
        websockets.sync.client.connect(f"ws://127.0.0.1:{port}", origin="http://127.0.0.1:1", additional_headers=given)
    viewer.address = f"{own}/?token={token}"
    page, problems = opened(browser, viewer)
    page.get_by_text("Target 0").wait_for()
    page.goto(own)  # the browser has the token now
    page.get_by_role("slider").first.focus()
    page.keyboard.press("ArrowRight")
    until(lambda: viewer.target == 1)
    page.close()
    viewer.stop()
    assert not problems


def test_two_servers_of_one_machine_do_not_take_each_others_token(browser, replays):
    """Tokens of two servers on one machine: kept apart, although browsers share cookies between the ports of a host."""
    viewers = [Viewer(replays, host="0.0.0.0", port=0) for _ in range(2)]
    context = browser.new_context()
    for viewer in viewers:
        address = viewer.address.replace(f"//{socket.gethostname()}:", "//127.0.0.1:")
        assert context.new_page().goto(address).status == 200
    for viewer in viewers:
        port = viewer.address.partition("/?")[0].rpartition(":")[2]
        assert context.new_page().goto(f"http://127.0.0.1:{port}").status == 200
    context.close()
    for viewer in viewers:
        viewer.stop()


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "[::1]", "LOCALHOST:9000"])
def test_own_names_of_this_machine_show_the_page_at_any_port(viewer, host):
    """Names of this machine: accepted at any port, as an SSH tunnel may lead to the viewer from another one."""
    assert ask(viewer.address, Host=host) == ask(viewer.address, Host=host, Origin=f"http://{host}") == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.test"},
        {"Host": "127.0.0.1.evil.test"},
        {"Host": "localhost@evil.test"},
        {"Host": "["},
        {"Origin": "null"},
        {"Origin": "http://localhost"},
        {"Origin": "http://evil.test"},
        SOCKET,
        SOCKET | {"Origin": "http://evil.test"},
    ],
)
def test_requests_of_others_are_refused(viewer, headers):
    assert ask(viewer.address, **headers) == 403


def test_a_viser_that_cannot_be_guarded_is_not_served(replays, monkeypatch):
    """A viser that cannot be protected: not served.

    An update of viser may serve by another function; then there is no page rather than an open one.
    """
    stopped = []

    class AnotherServer:
        def __init__(self, **_):
            pass

        def stop(self):
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", AnotherServer)  # the library itself, as no such version exists
    with pytest.raises(InputError, match="cannot protect its page with viser"):
        Viewer(replays, port=0)
    assert len(stopped) == 1


def test_only_this_machine_can_connect(viewer):
    port = int(viewer.address.rpartition(":")[2])
    assert b"viser" in urllib.request.urlopen(viewer.address).read().lower()
    with pytest.raises(OSError):  # another loopback address, equivalent to an external one
        socket.create_connection(("127.0.0.2", port), timeout=5)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["{plan}", "--scenario", "7"], "has no scenario 7 by baseline; it has 0"),
        (["{plan}", "--method", "hybrid"], "has no results of 'hybrid'; it has baseline"),
        (["{plan}", "--set", "margin_m=0"], "--set and --seed change a job, and"),
        (["{plan}", "--host", "no such host"], "cannot listen on no such host, port 8080"),
        (["{plan}/.."], "contains neither a run of htcp sweep"),
        (["nowhere"], "nowhere: no such run folder or job"),
        (["{plan}/plan.png"], "plan.png"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(folder, capsys, arguments, line):
    assert main(["view", *(word.format(plan=folder) for word in arguments)]) == 2
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.out == ""


def test_a_port_in_use_is_refused_and_not_replaced_by_another(viewer, replays):
    port = viewer.address.rpartition(":")[2]
    with pytest.raises(InputError, match=f"cannot listen on 127.0.0.1, port {port}: Address already in use"):
        Viewer(replays, port=int(port))


@pytest.mark.slow
def test_the_command_serves_a_job_that_it_plans_until_it_is_reported_to_stop(tmp_path):
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    (tmp_path / "job.yaml").write_text("workpiece: {path: path.csv}\nmethod: baseline\n")
    command = [sys.executable, "-m", "htcp_jax", "view", "job.yaml", "--port", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        assert urllib.request.urlopen(line.split()[1]).status == 200
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "htcp: closed\n") and "Ctrl-C" in line


def test_ctrl_c_before_the_page_is_up_ends_with_the_code_of_one_after_it(folder, capsys, monkeypatch):
    def interrupted(name, *rest, open_file=os.open):
        if str(name).endswith("summary.json"):
            raise KeyboardInterrupt
        return open_file(name, *rest)

    class Terminal(io.StringIO):
        def write(self, text: str) -> int:
            if "http://" in text:  # the page is up
                raise KeyboardInterrupt
            return super().write(text)

    for module, name, other, line in ((os, "open", interrupted, INTERRUPTED), (sys, "stdout", Terminal(), "closed")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, other)
            assert main(["view", str(folder), "--port", "0"]) == 130
        assert capsys.readouterr().err == f"htcp: {line}\n"


def test_capsules_are_turned_to_their_axes():
    axes = np.vstack([np.random.default_rng(0).normal(size=(50, 3)), np.eye(3), -np.eye(3), np.zeros((1, 3))])
    w, x, y, z = rotations_to(axes).T
    turned = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    length = np.linalg.norm(axes, axis=1, keepdims=True)
    np.testing.assert_allclose(turned, np.where(length > 0, axes / np.maximum(length, 1e-300), [0, 0, 1]), atol=1e-12)


@pytest.mark.parametrize("gap", [[0, 0, 1e-5], [0, 1e-5, 0], [0, -1, 1e-9], [1, 1, 1], [0, 0, 0]])
def test_the_smallest_distance_is_looked_at_from_the_side(gap):
    gap, side = np.array(gap, float), View(np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0]))
    direction = grazing(gap, side)
    assert np.isclose(np.linalg.norm(direction), 1) and abs(direction @ gap) <= 1e-12 * max(1, np.linalg.norm(gap))
    assert max(direction @ side.near, direction @ side.up) > 0.5


def test_what_plays_shows_nothing_once_it_is_stopped(replays):
    """Stopped playback: nothing is shown any more (regression: its thread went on and failed without the server)."""
    viewer, stopped, late = Viewer(replays, port=0), threading.Event(), threading.Event()
    move, shown = viewer.stage.move, threading.Event()

    def slow(arm):
        shown.set()
        time.sleep(0.5)
        move(arm)
        if stopped.is_set():
            late.set()

    viewer.stage.move = slow
    viewer.toggle()
    shown.clear()
    assert shown.wait(60)
    viewer.stop()
    stopped.set()
    time.sleep(1.5)
    assert not late.is_set()


def test_nothing_is_left_running(replays):
    before = {thread.name for thread in threading.enumerate() if thread.name.startswith("htcp")}
    Viewer(replays, port=0).stop()
    until(lambda: {t.name for t in threading.enumerate() if t.name.startswith("htcp")} == before, 10)
