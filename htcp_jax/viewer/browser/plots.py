"""Plots of the page: clearance over targets, or for a robot program the speeds of the TCP and the joints over time."""

from html import escape

import numpy as np
import viser
from viser import uplot

from htcp_jax.viewer.colours import HERE, INK, KINDS, TargetStyle, joint_colour
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.timed_play import BOUNDS, Curves

Columns = tuple[np.ndarray, ...]
LOG, HEIGHT = 3, 210


class Plots:
    """Plots of one page.

    Args:
        gui: The panel.
        order: The position of the first element on the panel; each next element's is 0.1 larger.
    """

    def __init__(self, gui: viser.GuiApi, order: float):
        self._gui, self._order, self._shown = gui, order, list[viser.GuiUplotHandle | viser.GuiHtmlHandle]()

    def show(self, replay: Replay, curves: Curves | None) -> None:
        """Replace the plots by a replay's; with `curves`, a robot program's plots are shown."""
        for each in self._shown:
            each.remove()
        self._replay, self._curves, self._shown, self._row = replay, curves, [], -1
        if curves is not None:
            over = {"y": {"range": (0.0, curves.top_mm_s)}}, "time [s]"
            self.tcp = self._plot("TCP [mm/s]", _tcp_columns(curves, 0), _tcp_series(curves), *over)
            self._legend({kind.words: KINDS[kind] for kind in curves.tcp_mm_s} | {"required feed": INK})
            over = {"y": {"distr": LOG, "range": BOUNDS}}, "time [s]"
            self.joints = self._plot(
                "Joint speeds [% of the limit]", _joint_columns_of(curves, 0), _joint_series(curves), *over
            )
            self._legend({name: joint_colour(k) for k, name in enumerate(curves.share_percent)})
        scales = {"x": {"time": False}, "y": {"distr": LOG}}
        self.clearance = self._plot("Clearance [mm]", _curves(replay, 0), _series(replay), scales, _across(replay))
        self._legend({style.name: style.colour for style in replay.styles if style.where.any()})

    def at_target(self, target: int) -> None:
        """Mark the displayed target in the clearance plot."""
        self.clearance.data = _curves(self._replay, target)

    def at_time(self, time_s: float) -> None:
        """Move the line at the current time, if there is a robot program."""
        if self._curves is None:
            return
        row = int(np.searchsorted(self._curves.time_s, time_s, side="right")) - 1
        if row != self._row:
            self._row = row
            self.tcp.data, self.joints.data = _tcp_columns(self._curves, row), _joint_columns_of(self._curves, row)

    def _plot(
        self, title: str, data: Columns, series: tuple[uplot.Series, ...], scales: dict, across: str
    ) -> viser.GuiUplotHandle:
        axes = {"label": across, "labelSize": 18, "size": 28}, {"size": 52, "ticks": {"show": False}}
        self._shown.append(
            self._gui.add_uplot(
                data, series, height=HEIGHT, order=self._next(), scales={"x": {"time": False}} | scales,
                legend={"show": False}, title=title, axes=axes, padding=(8, 12, 0, 0),
            )
        )  # fmt: skip
        return self._shown[-1]

    def _legend(self, colours: dict[str, str]) -> None:
        """Add a legend: the names, each next to a dot in its colour."""
        one = '<span style="white-space:nowrap;margin-right:1em"><span style="color:{}">&#9679;</span> {}</span>'
        dots = (one.format(colour, escape(name)) for name, colour in colours.items())
        content = f'<div style="font-size:0.8em;padding:0 0.9em 0.5em">{" ".join(dots)}</div>'
        self._shown.append(self._gui.add_html(content, order=self._next()))

    def _next(self) -> float:
        return self._order + 0.1 * (1 + len(self._shown))


def _now(curves: Curves, row: int, bottom: float, top: float) -> np.ndarray:
    """Return the data of a line from `bottom` to `top` at a row of the curves, NaN at all other rows.

    uPlot draws the line between this row and the next one.
    """
    line = np.full(len(curves.time_s), np.nan)
    row = min(row, len(line) - 2)
    line[row], line[row + 1] = bottom, top
    return line


def _tcp_columns(curves: Curves, row: int) -> Columns:
    requested = np.full(len(curves.time_s), curves.feed_mm_s)
    return curves.time_s, requested, *curves.tcp_mm_s.values(), _now(curves, row, 0.0, curves.top_mm_s)


def _joint_columns_of(curves: Curves, row: int) -> Columns:
    shares = (np.maximum(share, BOUNDS[0]) for share in curves.share_percent.values())
    return curves.time_s, *shares, _now(curves, row, *BOUNDS)


def _tcp_series(curves: Curves) -> tuple[uplot.Series, ...]:
    requested = {"label": "required feed", "stroke": INK, "width": 1, "dash": (4, 4)}
    return (
        {"label": "time"},
        requested,
        *(_line(kind.words, KINDS[kind]) for kind in curves.tcp_mm_s),
        _line("now", INK),
    )


def _joint_series(curves: Curves) -> tuple[uplot.Series, ...]:
    lines = [_line(name, joint_colour(k)) for k, name in enumerate(curves.share_percent)]
    return {"label": "time"}, *lines, _line("now", INK)


def _line(label: str, colour: str) -> uplot.Series:
    return {"label": label, "stroke": colour, "width": 1.5, "points": {"show": False}}


def _curves(replay: Replay, target: int) -> tuple[np.ndarray, ...]:
    """Return the columns of the clearance plot: index, all clearances, those of each style, and the displayed target's.

    A failed target, and a configuration in collision, is drawn at the minimum clearance.
    """
    index = np.arange(len(replay.target), dtype=float)
    clearance = np.where(replay.clearance > 0, 1e3 * replay.clearance, np.nan)
    least = np.nanmin(clearance, initial=np.inf)
    known = np.where(np.isnan(clearance), least if np.isfinite(least) else 1.0, clearance)
    parts = [np.where(style.where, known, np.nan) for style in _plotted(replay)]
    return index, clearance if replay.file is None else known, *parts, np.where(index == target, known, np.nan)


def _series(replay: Replay) -> tuple[uplot.Series, ...]:
    def points(colour: str, size: int) -> uplot.Series:
        return {"stroke": colour, "width": 0, "points": {"show": True, "size": size, "fill": colour, "space": 0}}

    sizes = {"tracked": 3, "proven": 3, "failed": 11}
    parts = [{"label": style.name, **points(style.colour, sizes.get(style.name, 6))} for style in _plotted(replay)]
    here = {"label": "shown", "stroke": INK, "width": 0}
    here["points"] = {"show": True, "size": 12, "fill": HERE, "stroke": INK, "width": 1.5, "space": 0}
    return {"label": _across(replay)}, {"label": "clearance", "stroke": "#9fb3c2", "width": 1}, *parts, here


def _plotted(replay: Replay) -> list[TargetStyle]:
    return [style for style in replay.styles if style.name != "not attempted"]


def _across(replay: Replay) -> str:
    return "target" if replay.file is None else "configuration"
