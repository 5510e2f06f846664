"""Plans in the browser: a stage in three dimensions and a panel to find one's way, served by viser.

Callbacks of the panel come in threads of their own; one lock lets them act one after another.
"""

import contextlib
import io
import socket
import threading

import numpy as np
import viser
from jaxtyping import Float
from viser import uplot

from htcp_jax.errors import InputError
from htcp_jax.planner.plans import Outcome
from htcp_jax.status import Status, Way
from htcp_jax.viewer.browser_scene import HERE, Stage
from htcp_jax.viewer.camera import open_side, sight
from htcp_jax.viewer.colours import INK, TargetStyle, target_styles
from htcp_jax.viewer.playback import Playback
from htcp_jax.viewer.replay import Replay, Replays
from htcp_jax.viewer.sides import View

FOVY_RAD, ASPECT = np.radians(40.0), 1.05  # of the first sight
CLOSER_M = 0.25  # how far away the smallest distance is looked at from
WAITING_S = 0.1  # between looks at the play button
RATES = "5", "10", "20", "40"  # targets a second
SIDES = "open side", "above", "front", "nothing"  # that the workpiece is cut from


class Viewer:
    """A running viewer of plans; `stop` ends it.

    host, port: to listen on; port 0 takes any that is free. scenario, method: what is shown first; by default the first
    method's first scenario that failed. Raises InputError for a scenario or method that is not there, and for an
    address that cannot be had.
    """

    def __init__(
        self,
        replays: Replays,
        host: str = "127.0.0.1",
        port: int = 8080,
        scenario: int | None = None,
        method: str | None = None,
    ):
        method = method or replays.methods[0]
        self._replays, self._lock = replays, threading.RLock()
        outcomes = replays.outcomes(method)
        replay = replays.replay(outcomes[0].scenario if scenario is None else scenario, method)
        self._server = _serve(host, port)
        self.address = f"http://{host}:{self._server.get_port()}"
        self._ended = threading.Event()
        self._stage = Stage(self._server)
        self._build(replay)
        self._show(replay)
        threading.Thread(target=self._play, name="htcp view: play", daemon=True).start()

    @property
    def target(self) -> int:
        """The target that is shown."""
        return self._target

    @property
    def shown(self) -> tuple[int, str]:
        """The scenario's number and the method."""
        return self._replay.number, self._replay.method

    @property
    def stage(self) -> Stage:
        """What is shown."""
        return self._stage

    def wait(self) -> None:
        """Return when the viewer is stopped."""
        self._ended.wait()

    def stop(self) -> None:
        """End the server."""
        self._ended.set()
        with _silent():
            self._server.stop()

    # The panel

    def _build(self, replay: Replay) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(31, 111, 180))
        gui.set_panel_label(f"htcp view {self._replays.name}")
        gui.main_panel.dock_right()
        self._method = gui.add_dropdown("Method", self._replays.methods, initial_value=replay.method)
        names = self._names(replay.method)
        self._scenario = gui.add_dropdown("Scenario", tuple(names), initial_value=_name_of(names, replay.number))
        self._slider = gui.add_slider("Target", 0, max(len(replay.target) - 1, 1), 1, 0)
        self._facts = gui.add_markdown("")
        self._playing = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._rate = gui.add_dropdown("Targets a second", RATES, initial_value="10")
        self._plot = None
        self._legend = gui.add_html("", order=self._rate.order + 0.7)
        self._build_looks()
        self._method.on_update(lambda _: self._pick_method())
        self._scenario.on_update(lambda _: self._pick_scenario())
        self._slider.on_update(lambda _: self.go_to(int(self._slider.value)))
        self._playing.on_click(lambda _: self._toggle())
        self._running = False

    def _build_looks(self) -> None:
        gui = self._server.gui
        closer = gui.add_button("Look at the smallest distance", icon=viser.Icon.ZOOM_IN)
        closer.on_click(self._look_closer)
        back = gui.add_button("Look at everything", icon=viser.Icon.ZOOM_OUT)
        back.on_click(self._look_back)
        with gui.add_folder("Workpiece"):
            self._side = gui.add_dropdown("Cut from", SIDES, initial_value=SIDES[0])
            self._share = gui.add_slider("Cut off [%]", 0, 100, 1, 50)
            self._size = gui.add_slider("Point size [mm]", 1.0, 20.0, 0.5, 7.0)
        for element in (self._side, self._share, self._size):
            element.on_update(lambda _: self._cut())
        with gui.add_folder("Arm"):
            self._opacity = gui.add_slider("Opacity [%]", 5, 100, 5, 100)
            self._pair = gui.add_checkbox("Smallest distance", True)
            self._marks = gui.add_checkbox("Dwells, tightest place", True)
        self._opacity.on_update(lambda _: self._stage.fade(self._opacity.value / 100))
        self._marks.on_update(lambda _: self._stage.show_marks(self._marks.value))
        self._pair.on_update(lambda _: self._stage.show_smallest_distance(self._pair.value))

    def _names(self, method: str) -> dict[str, int]:
        """The scenarios as the picker lists them, failed first, with their numbers."""
        return {_describe(outcome, self._replays): outcome.scenario for outcome in self._replays.outcomes(method)}

    def _pick_method(self) -> None:
        """The same scenario by another method, or that method's first."""
        with self._lock:
            names = self._names(self._method.value)
            kept = _name_of(names, self._replay.number) or next(iter(names))
            self._scenario.options = tuple(names)
            self._scenario.value = kept
            self._pick_scenario()

    def _pick_scenario(self) -> None:
        with self._lock:
            number = self._names(self._method.value).get(self._scenario.value)
            if number is not None and (number, self._method.value) != self.shown:
                self._show(self._replays.replay(number, self._method.value))

    # What is shown

    def _show(self, replay: Replay) -> None:
        with self._lock, self._server.atomic():
            self._replay, self._target = replay, -1
            self._running, self._playing.label = False, "Play"
            self._stage.show(replay, self._opacity.value / 100)
            self._stage.show_smallest_distance(self._pair.value)
            self._stage.show_marks(self._marks.value)
            self._playback = Playback(replay)
            self._cut()
            self._aim()
            if self._plot is not None:
                self._plot.remove()
            self._plot = self._server.gui.add_uplot(
                _curves(replay, 0), _series(replay), height=210, order=self._rate.order + 0.5,
                scales={"x": {"time": False}, "y": {"distr": 3}}, legend={"show": False}, title="Clearance [mm]",
                axes=({"label": "target", "labelSize": 18, "size": 28}, {"size": 52, "ticks": {"show": False}}),
                padding=(4, 12, 0, 0),
            )  # fmt: skip
            self._legend.content = _legend(replay)
            self._slider.max = max(len(replay.target) - 1, 1)
            self.go_to(0)
            self._slider.value = 0

    def go_to(self, target: int) -> None:
        """Show a target."""
        with self._lock:
            target = min(target, len(self._replay.target) - 1)
            if target == self._target:
                return
            self._target = target
            self._playback.stand(target)
            with self._server.atomic():
                self._stage.pose(target)
                self._plot.data = _curves(self._replay, target)
                self._facts.content = _facts(self._replay, target)

    def _cut(self) -> None:
        with self._lock:
            directions = {"open side": None, "above": np.array([0.0, 0, 1]), "front": -ahead(self._replay)}
            share = 0.0 if self._side.value == "nothing" else self._share.value / 100
            self._stage.cut(share, directions.get(self._side.value), self._size.value / 1e3)

    def _toggle(self) -> None:
        with self._lock:
            self._running = not self._running
            self._playing.label = "Pause" if self._running else "Play"
            if self._running and self._target in (0, len(self._replay.target) - 1):
                self._slider.value = 0
                self._playback.begin()

    def _play(self) -> None:
        """Move on along the way while the play button says so."""
        pause = 0.0
        while not self._ended.wait(pause):
            with self._lock:
                pause = self._move_on() if self._running else WAITING_S

    def _move_on(self) -> float:
        """Show the next posture on the way to the next target, or that target; returns for how long [s]."""
        if (arm := self._playback.next()) is not None:
            self._stage.move(arm)
        elif self._target < len(self._replay.target) - 1:
            self._slider.value = self._target + 1
        else:
            self._toggle()
        return 1 / int(self._rate.value) / (1 + self._playback.between)

    # The camera

    def _aim(self) -> None:
        """Let new browsers, and everyone's reset of the view, see all of the arm and the workpiece."""
        eye, look_at = sight(self._replay, slice(None), FOVY_RAD, ASPECT)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = eye, look_at, FOVY_RAD

    def _look_closer(self, event: viser.GuiEvent) -> None:
        with self._lock:
            arm, cloud = self._replay.witness.arm[self._target], self._replay.witness.cloud[self._target]
            side = open_side(self._replay)
        _stand(event, cloud + CLOSER_M * grazing(arm - cloud, side), cloud)

    def _look_back(self, event: viser.GuiEvent) -> None:
        _stand(event, self._server.initial_camera.position, self._server.initial_camera.look_at)


def _stand(event: viser.GuiEvent, position: np.ndarray, look_at: np.ndarray) -> None:
    """Put the camera of the browser that asked; viser lets a new position take what is looked at along."""
    if event.client is not None:
        with event.client.atomic():
            event.client.camera.position = position
            event.client.camera.look_at = look_at


def grazing(gap: Float[np.ndarray, "3"], side: View) -> Float[np.ndarray, "3"]:
    """The unit direction square to a gap, so that it is seen from beside, that is nearest to the open side."""
    length = np.linalg.norm(gap)
    across = gap / length if length > 0 else side.up
    for wish in (side.near, side.up):
        direction = wish - (wish @ across) * across
        if np.linalg.norm(direction) > 0.1:
            break
    return direction / np.linalg.norm(direction)


def _serve(host: str, port: int) -> viser.ViserServer:
    """A server on that very port: viser alone would take the next one that is free."""
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(address)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot listen on {host}, port {port}: {reason}; choose another with --port") from None
    with _silent():
        return viser.ViserServer(host=host, port=port, verbose=False)


def ahead(replay: Replay) -> np.ndarray:
    """To the side of what is seen from the open side."""
    side = open_side(replay)
    return np.cross(side.near, side.up) * -1


def _silent():
    """viser tells of itself on stdout."""
    return contextlib.redirect_stdout(io.StringIO())


def _describe(outcome: Outcome, replays: Replays) -> str:
    label = replays.label(outcome.scenario)
    if outcome.complete:
        return f"{label}: all {outcome.targets} tracked"
    return f"{label}: failed at {outcome.tracked} of {outcome.targets}"


def _name_of(names: dict[str, int], number: int) -> str | None:
    return next((name for name, known in names.items() if known == number), None)


def _facts(replay: Replay, target: int) -> str:
    """What is known of a target, in a few lines."""
    status = Status(int(replay.status[target]))
    what = f"**Target {target}** {status.message}"
    if target == replay.failed and replay.obstruction is not None:
        return f"{what}.\n\nBrought there all the same, as shown: {replay.obstruction.description}."
    if not status.tracked:
        return f"{what}.\n\nThe arm is shown where it came to before."
    clearance, error = 1e3 * replay.clearance[target], 1e3 * replay.residual[target]
    here = f"Clearance **{clearance:.4g} mm** at {replay.witness.body[target]}, TCP error {error:.2f} mm."
    return f"{what}.\n\n{here}\n\n{_motion(replay, target)}"


def _motion(replay: Replay, target: int) -> str:
    """What is known of the way to a target, and whether the arm dwells there."""
    known = Way(int(replay.way[target]))
    text = f"The way here: {known.message}"
    if known == Way.PROVEN:
        text = f"The way here is proven: {1e3 * replay.way_clearance[target]:.3g} mm clear at least"
    tightest = " It is the tightest of the proof." if target == replay.summary.tightest else ""
    dwells = " **The arm changes its posture here.**" if target in replay.summary.dwells else ""
    return f"{text}.{tightest}{dwells}"


def _curves(replay: Replay, target: int) -> tuple[np.ndarray, ...]:
    """Clearance over the targets: in all, of each style, and at the target that is shown; a failed one at the least."""
    index = np.arange(len(replay.target), dtype=float)
    clearance = 1e3 * replay.clearance
    least = np.nanmin(clearance, initial=np.inf)
    known = np.where(np.isnan(clearance), least if np.isfinite(least) else 1.0, clearance)
    parts = [np.where(style.where, known, np.nan) for style in _plotted(replay)]
    return index, clearance, *parts, np.where(index == target, known, np.nan)


def _series(replay: Replay) -> tuple[uplot.Series, ...]:
    def points(colour: str, size: int) -> uplot.Series:
        return {"stroke": colour, "width": 0, "points": {"show": True, "size": size, "fill": colour, "space": 0}}

    sizes = {"tracked": 3, "tracked after an escape": 6, "failed": 11}
    parts = [{"label": style.name, **points(style.colour, sizes[style.name])} for style in _plotted(replay)]
    here = {"label": "shown", "stroke": INK, "width": 0}
    here["points"] = {"show": True, "size": 12, "fill": HERE, "stroke": INK, "width": 1.5, "space": 0}
    return {"label": "target"}, {"label": "clearance", "stroke": "#9fb3c2", "width": 1}, *parts, here


def _legend(replay: Replay) -> str:
    """What became of the targets, each behind a dot of its colour."""
    dots = (
        f'<span style="white-space:nowrap;margin-right:1em"><span style="color:{style.colour}">&#9679;</span> '
        f"{style.name}</span>"
        for style in target_styles(replay.status)
        if style.where.any()
    )
    return f'<div style="font-size:0.8em;padding:0 0.9em 0.5em">{" ".join(dots)}</div>'


def _plotted(replay: Replay) -> list[TargetStyle]:
    return [style for style in target_styles(replay.status) if style.name != "not attempted"]
