"""Plot strip below a robot program's movie: speeds of the TCP and the joints, with a line at the current time."""

import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from htcp_jax.trajectory import PlanProgram
from htcp_jax.viewer.colours import INK, KINDS, PAPER, QUIET, RULE, joint_colour
from htcp_jax.viewer.timed_play import BOUNDS, Curves, PlaybackStates

INCHES, ASPECT = 6.4, 0.38  # nominal width of the plot strip, and height / width
SMALL, WORDS = 7, 8.5  # font sizes [points]
EDGE = 0.25  # [pixels] added to a size, so that rounding down does not lose a pixel


class PlotStrip:
    """Plot strip of a robot program, drawn once; only the line and the text change between frames.

    Args:
        made: The robot program.
        play: The states at the frames.
        width: Width [pixels].
        speed: Playback rate; 1 is real time.
    """

    def __init__(self, made: PlanProgram, play: PlaybackStates, width: int, speed: float = 1.0):
        self._play, height = play, 2 * round(width * ASPECT / 2)
        dpi = width / INCHES
        size = (width + EDGE) / dpi, (height + EDGE) / dpi
        self.figure = Figure(figsize=size, dpi=dpi, facecolor=PAPER, layout="constrained")
        self._canvas = FigureCanvasAgg(self.figure)
        self.figure.get_layout_engine().set(rect=(0, 0, 1, 0.9), w_pad=0.06, h_pad=0.03, hspace=0.04)
        curves = Curves.of(made)
        above, below = self.figure.subplots(2, sharex=True)
        _draw_feed(above, curves)
        _draw_joints(below, curves)
        self.figure.text(0.99, 0.975, shown_as(speed), color=QUIET, fontsize=WORDS, ha="right", va="top")
        look = {"color": INK, "fontsize": WORDS, "va": "top", "animated": True}
        self._now = self.figure.text(0.012, 0.975, "", **look)
        self._lines = [axes.axvline(0, color=INK, linewidth=1, animated=True) for axes in (above, below)]
        self._canvas.draw()
        self._empty = self._canvas.copy_from_bbox(self.figure.bbox)

    def at(self, frame: int) -> UInt8[np.ndarray, "H W 3"]:
        """Return the picture of the plot strip for a frame."""
        self._canvas.restore_region(self._empty)
        self._now.set_text(self._play.words(frame))
        self.figure.draw_artist(self._now)
        for line in self._lines:
            line.set_xdata([self._play.time_s[frame]] * 2)
            line.axes.draw_artist(line)
        return np.array(self._canvas.buffer_rgba())[..., :3]


def shown_as(speed: float) -> str:
    """Return the playback rate as text."""
    return "in real time" if speed == 1 else f"at {speed:g} times real time"


def _draw_feed(axes: Axes, curves: Curves) -> None:
    for kind, speed in curves.tcp_mm_s.items():
        axes.plot(curves.time_s, speed, color=KINDS[kind], linewidth=1.2, label=kind.words)
    axes.axhline(curves.feed_mm_s, color=INK, linewidth=0.9, linestyle="--", label="required feed", zorder=1)
    axes.set_ylim(0, curves.top_mm_s)
    _plain_axes(axes, "TCP [mm/s]")


def _draw_joints(axes: Axes, curves: Curves) -> None:
    for joint, (name, share) in enumerate(curves.share_percent.items()):
        axes.plot(curves.time_s, share, color=joint_colour(joint), linewidth=1, label=name)
    axes.set_yscale("log")
    axes.set_ylim(*BOUNDS)
    axes.yaxis.set_major_locator(LogLocator(10))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.set_xlim(0, curves.time_s[-1])
    axes.set_xlabel("time [s]", color=INK, fontsize=SMALL, labelpad=1)
    _plain_axes(axes, "joints [% of limit]")


def _plain_axes(axes: Axes, label: str) -> None:
    axes.set_ylabel(label, color=INK, fontsize=SMALL)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.tick_params(colors=INK, labelsize=SMALL, length=2, pad=2)
    axes.grid(axis="y", color=RULE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    how = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "labelspacing": 0.15, "handlelength": 1.2}
    axes.legend(frameon=False, fontsize=SMALL, labelcolor=INK, borderaxespad=0.3, **how)
