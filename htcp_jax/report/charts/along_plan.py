"""Chart of one plan along its path: clearance, angles of the tool, and speed of the TCP over the targets."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from htcp_jax.model import Scenario
from htcp_jax.motion import Plans
from htcp_jax.report.charts.style import INK, RULE, new_figure
from htcp_jax.spec import ToolAxisRow
from htcp_jax.status import Kind
from htcp_jax.trajectory import PlanProgram
from htcp_jax.viewer import Curves, draw_angles, draw_clearance, reached_s, seam_marks

INSTANTS = 3000  # at which the speed is sampled
TOP = 1.25  # of the speed's axis / largest feed
PANEL = 2.3  # height of a panel [inch]
COLOURS = {Kind.PROCESS: "#1f6fb4", Kind.APPROACH: "#b8860b", Kind.DWELL: "#0b8f6a"}


class AlongPlan(NamedTuple):
    """Values of a plan along its path, for the chart."""

    plans: Plans
    scenario: Scenario
    seams: Sequence[str]  # names of several seams
    angles: tuple[Sequence[tuple[slice, ToolAxisRow]], Float[np.ndarray, "T 3"]] | None  # see `viewer.draw_angles`
    program: PlanProgram | None  # None: not timed


def along_plan(shown: AlongPlan) -> Figure:
    """Draw the clearance, the angles of the tool and the speed of the TCP over the targets."""
    count = 1 + (shown.angles is not None) + (shown.program is not None)
    drawn = ["clearance", *(["angles"] if shown.angles is not None else []), *(["speed"] if shown.program else [])]
    title = " and ".join(filter(None, (", ".join(drawn[:-1]), drawn[-1]))).capitalize()
    note = "Over the targets, which are the points of the path."
    note += " Thin vertical lines: where seams begin." if shown.plans.seam_begins else ""
    figure = new_figure(PANEL * count + 0.6, title, note)
    panels = list(figure.subplots(count, 1, squeeze=False)[:, 0])
    draw_clearance(panels[0], shown.plans, 0, shown.scenario)
    seam_marks.draw_begins(panels[0], shown.plans, shown.seams)
    if shown.angles is not None:
        draw_angles(panels[1], *shown.angles)
    if shown.program is not None:
        _draw_speed(panels[-1], shown.program)
    for axes in panels:
        axes.set_xlim(-1, shown.plans.status.shape[1])
    return figure


def _draw_speed(axes: Axes, made: PlanProgram) -> None:
    """Draw the speed of the TCP over the place on the path; above TOP times the feed it is cut off."""
    curves = Curves.of(made, INSTANTS)
    place = np.interp(curves.time_s, *reached_s(made.program))
    for kind, speed in curves.tcp_mm_s.items():
        if kind in COLOURS:
            axes.plot(place, speed, color=COLOURS[kind], linewidth=1.2, label=kind.words)
    ends = [0, *made.seam_begins, len(made.x)]
    feeds = list(made.seam_feeds.values()) or [made.program.feed_m_s] * (len(ends) - 1)
    for k, feed in enumerate(feeds):
        text = "required feed" if k == 0 else None
        axes.hlines(1e3 * feed, ends[k] - 0.5, ends[k + 1] - 0.5, INK, linewidth=0.9, linestyle="--", label=text)
    axes.set_ylim(0, TOP * curves.feed_mm_s)
    axes.set_xlabel("target", color=INK)
    axes.grid(axis="y", color=RULE, linewidth=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower left", frameon=False, ncols=4, bbox_to_anchor=(0.36, 1.0), borderaxespad=0.2)
    axes.set_title("Speed of the TCP [mm/s]", color=INK, fontsize=11, loc="left", y=1.0)
