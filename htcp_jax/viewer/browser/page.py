"""Viewer of plans in the browser: a 3D scene and a control panel, served by viser.

The panel's callbacks run in separate threads, which one lock serialises. The properties of `Viewer` use the same lock,
so they describe a consistent page.
"""

import threading
import time
from collections.abc import Callable

import viser

from htcp_jax.errors import InputError
from htcp_jax.markup import escaped
from htcp_jax.trajectory import PlanProgram
from htcp_jax.viewer.browser.access import serve, silent
from htcp_jax.viewer.browser.display import DisplayOptions
from htcp_jax.viewer.browser.plots import Plots
from htcp_jax.viewer.browser.scene import BrowserScene
from htcp_jax.viewer.browser.texts import describe, name_of, target_facts
from htcp_jax.viewer.browser.timeline import ByTarget, ByTime, Timeline
from htcp_jax.viewer.replay import Replay, Replays

WAITING_S = 0.1  # polling interval while paused
KEY_S = 0.5  # time after a move of the slider in which the page ignores arrow keys, as the slider handles them

# Function that returns the robot program for a scenario's number and a method.
PlanPrograms = Callable[[int, str], PlanProgram]


class Viewer:
    """A running viewer of plans; call `stop` to end it.

    `address` is the page's address, `server` the viser server, to which a caller can add scene nodes and panel
    elements, `stage` the 3D scene, and `plots` the plots of the panel.

    Args:
        replays: The plans.
        host: The address to listen on.
        port: The port; 0: any free port.
        scenario: The number of the scenario to show first. None: the first failed scenario, if any; with `programs`,
            the first executable one.
        method: The method whose plan is shown first; None: the first method.
        programs: Function that returns the robot program of a scenario and method; None: play without timing.

    Raises:
        InputError: If the scenario or method is unknown, if the address is not available, or if `programs` raises it
            for the first scenario.
    """

    def __init__(
        self,
        replays: Replays,
        host: str = "127.0.0.1",
        port: int = 8080,
        scenario: int | None = None,
        method: str | None = None,
        programs: PlanPrograms | None = None,
    ):
        method = method or replays.methods[0]
        self._replays, self._programs, self._lock = replays, programs, threading.RLock()
        outcomes = replays.outcomes(method)
        first = next((end for end in outcomes if programs and end.can_be_driven), outcomes[0])
        replay = replays.replay(first.scenario if scenario is None else scenario, method)
        timeline = ByTime(programs(replay.number, method)) if programs else ByTarget(replay)
        self.server, self.address = serve(host, port)
        self._ended = threading.Event()
        self.stage = BrowserScene(self.server)
        self._build(replay)
        self._show(replay, timeline)
        threading.Thread(target=self._play, name="htcp view: play", daemon=True).start()

    @property
    def target(self) -> int:
        """The displayed target."""
        with self._lock:
            return self._target

    @property
    def place(self) -> float:
        """Position on the timeline: a target index, or a time [s] for a robot program."""
        with self._lock:
            return self._place

    @property
    def shown(self) -> tuple[int, str]:
        """Number of the displayed scenario, and its method."""
        with self._lock:
            return self._replay.number, self._replay.method

    @property
    def facts(self) -> str:
        """Text on the displayed target, in Markdown."""
        with self._lock:
            return self._facts.content

    def wait(self) -> None:
        """Block until the viewer is stopped."""
        self._ended.wait()

    def stop(self) -> None:
        """Stop the server after the current frame."""
        with self._lock:
            self._ended.set()
        with silent():
            self.server.stop()

    # The panel

    def _build(self, replay: Replay) -> None:
        gui = self.server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(31, 111, 180))
        gui.set_panel_label(f"htcp view {self._replays.name}")
        gui.main_panel.dock_right()
        self._method = gui.add_dropdown("Method", self._replays.methods, initial_value=replay.method)
        names = self._names(replay.method)
        self._scenario = gui.add_dropdown("Scenario", tuple(names), initial_value=name_of(names, replay.number))
        if replay.file is not None:
            self._method.visible = self._scenario.visible = False
            verdict, _, reason = replay.file.headline.partition(": ")
            gui.add_markdown(f"**{verdict}**: {escaped(reason)}")
        self._slider: viser.GuiSliderHandle | None = None
        self._facts = gui.add_markdown("")
        self._playing = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self._rate: viser.GuiDropdownHandle | None = None
        self.plots = Plots(gui, self._playing.order + 0.2)
        self._display = DisplayOptions(self.server, self.stage, self._lock)
        self._method.on_update(lambda _: self._pick_method())
        self._scenario.on_update(lambda _: self._pick_scenario())
        self._playing.on_click(lambda _: self.toggle())
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: self.toggle())
        gui.add_command("Step forward", hotkey="arrowright").on_trigger(lambda _: self.step(1))
        gui.add_command("Step back", hotkey="arrowleft").on_trigger(lambda _: self.step(-1))
        self._running, self._moved_s = False, -KEY_S

    def _names(self, method: str) -> dict[str, int]:
        """Return the scenarios' numbers by their labels in the drop-down list, failed scenarios first."""
        return {describe(outcome, self._replays): outcome.scenario for outcome in self._replays.outcomes(method)}

    def _pick_method(self) -> None:
        """Show the same scenario by the selected method, or the method's first scenario if that one is not planned."""
        with self._lock:
            names = self._names(self._method.value)
            kept = name_of(names, self._replay.number) or next(iter(names))
            self._scenario.options = tuple(names)
            self._scenario.value = kept
            self._pick_scenario()

    def _pick_scenario(self) -> None:
        with self._lock:
            number = self._names(self._method.value).get(self._scenario.value)
            if number is not None and (number, self._method.value) != self.shown:
                replay = self._replays.replay(number, self._method.value)
                self._show(replay, self._timeline_of(replay))

    def _timeline_of(self, replay: Replay) -> Timeline:
        """Return the timeline of a replay: by time if there is a robot program, else by target."""
        try:
            return ByTime(self._programs(replay.number, replay.method)) if self._programs else ByTarget(replay)
        except InputError as refused:
            return ByTarget(replay, f"Not timed: {escaped(str(refused))}.")

    # The displayed plan

    def _show(self, replay: Replay, timeline: Timeline) -> None:
        with self._lock, self.server.atomic():
            self._replay, self._timeline, self._target = replay, timeline, -1
            self._play_or_pause(False)
            self._display.show(replay, timeline.passed)
            self.plots.show(replay, timeline.curves)
            self._show_timeline()
            self.go_to(0 if replay.file is None else replay.file.first)

    def _show_timeline(self) -> None:
        """Replace the slider and the list of playback rates by those of the current timeline."""
        gui, timeline, order = self.server.gui, self._timeline, self._facts.order
        for each in (self._slider, self._rate):
            if each is not None:
                each.remove()
        last = max(timeline.last, timeline.step)
        self._slider = gui.add_slider(timeline.name, 0, last, timeline.step, 0, order=order - 0.5)
        self._rate = gui.add_dropdown(
            timeline.rate_name, timeline.rates, initial_value=timeline.usual_rate, order=self._playing.order + 0.1
        )
        self._slider.on_update(self._slide)

    def _slide(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._moved_s = time.monotonic()
        with self._lock:
            if self._slider.value != self._timeline.on_slider(self._place):
                self.go_to(self._slider.value)

    def go_to(self, place: int | float) -> None:
        """Show a position on the timeline.

        Args:
            place: A target index, fractional between two targets; for a robot program, a time [s].
        """
        with self._lock, self.server.atomic():
            self._place = float(min(place, self._timeline.last))
            pose, reported = self._timeline.look(self._place)
            if (target := max(pose.target, 0)) != self._target:
                self._target = target
                self.stage.pose(target)
                self.plots.at_target(target)
            self.stage.move(pose)
            self.plots.at_time(self._place)
            self._facts.content = "\n\n".join(filter(None, (reported, target_facts(self._replay, target))))
            self._slider.value = self._timeline.on_slider(self._place)

    def toggle(self) -> None:
        """Start or pause playback; at the end, start from the beginning."""
        with self._lock:
            self._play_or_pause(not self._running)
            if self._running and (self._place == 0 or self._place >= self._timeline.end):
                self.go_to(self._timeline.begin)
            self._looked_s = time.monotonic()

    def step(self, count: int) -> None:
        """Pause, and move by `count` targets or, for a robot program, by `count` tenths of a second.

        Nothing happens within KEY_S after the slider was moved in a browser, because the slider then has the focus and
        handles the arrow keys itself.
        """
        if time.monotonic() - self._moved_s < KEY_S:
            self._moved_s = time.monotonic()
            return
        with self._lock:
            self._play_or_pause(False)
            here = self._timeline.on_slider(self._place)
            self.go_to(max(here + count * self._timeline.stride, 0))

    def _play_or_pause(self, running: bool) -> None:
        """Start or pause playback, and show the opposite action on the button."""
        self._running = running
        self._playing.label = "Pause" if running else "Play"
        self._playing.icon = viser.Icon.PLAYER_PAUSE if running else viser.Icon.PLAYER_PLAY

    def _play(self) -> None:
        """Advance the timeline while playing, until the viewer is stopped."""
        pause = 0.0
        while not self._ended.wait(pause):
            with self._lock:
                if not self._ended.is_set():
                    pause = self._move_on() if self._running else WAITING_S

    def _move_on(self) -> float:
        """Show the next position, and return the pause until the one after [s]."""
        now, rate = time.monotonic(), float(self._rate.value)
        passed, self._looked_s = now - self._looked_s, now
        if self._place >= self._timeline.end:
            self.toggle()
        else:
            self.go_to(self._timeline.after(self._place, passed, rate))
        return self._timeline.pause_s(self._place, rate)
