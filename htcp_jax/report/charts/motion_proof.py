"""Chart of a proof: guaranteed clearance along a motion, segments by verdict, and the deepest contacts."""

from textwrap import fill

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from htcp_jax.proving import FileProof, proof_record
from htcp_jax.report.charts.style import INK, QUIET, decimal, new_figure, plain_axes
from htcp_jax.status import SegmentStatus

PROVEN, REFUTED, UNDECIDED = "#009e73", "#d55e00", "#e69f00"
COLOURS = {SegmentStatus.VALID: PROVEN, SegmentStatus.UNDECIDED: UNDECIDED}  # else REFUTED
MARKS = "o", "s", "^", "D"  # markers of the first pairs of a link and an obstacle; that of all others is OTHER
OTHER = "."
BOUND = "guaranteed lower bound (proven)"
AT_POINTS = "measured distance at single configurations"
MEASURED = "#4a6fa5"
LINE = 110  # maximum number of characters in a line of the note
DECADES = 30.0  # ratio of the largest clearance to the smallest from which the axis is logarithmic
LOWEST_MM, TOP_MM = 1e-4, 1e4  # clearances are drawn between these


def proof_chart(found: FileProof) -> Figure:
    """Draw the proof of a file's motion.

    The upper panel shows the lower bound of the clearance that is proven for each segment, and the clearance that is
    measured at single configurations, over time, or over the segments' numbers if the file has no times; segments
    that are not proven are shaded. The lower panel shows the bodies' distance, or depth in collision, there.

    Args:
        found: The proof; its file has joint values.
    """
    proof, times = found.proof, found.motion.time_s
    assert proof is not None
    edges = np.arange(len(proof.verdict) + 1, dtype=float) if times is None else times
    groups = proof_record.unproven_groups(found)
    figure = new_figure(6.2 if groups else 4.0, found.file.name, fill(proof_record.headline(found), LINE))
    panels = figure.subplots(
        2 if groups else 1, 1, squeeze=False, sharex=True, height_ratios=(3, 2)[: 2 if groups else 1]
    )
    _draw_clearance(panels[0, 0], found, edges)
    if groups:
        _draw_contacts(panels[1, 0], found, edges)
    below = panels[-1, 0]
    numbered = f"segment; 0 is {proof_record.lines_of(found, 0)}"
    below.set_xlabel(numbered if times is None else "time [s]")
    below.set_xlim(edges[0], edges[-1])
    if times is None:
        below.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def _draw_clearance(axes: Axes, found: FileProof, edges: Float[np.ndarray, "m+1"]) -> None:
    proof = found.proof
    assert proof is not None
    clearance = np.clip(1e3 * proof.clearance_m, LOWEST_MM, TOP_MM)
    for group in proof_record.unproven_groups(found):
        colour = COLOURS.get(group.verdict, REFUTED)
        axes.axvspan(edges[group.first], edges[group.last + 1], color=colour, alpha=0.3, linewidth=0)
    axes.hlines(clearance, edges[:-1], edges[1:], color=PROVEN, linewidth=2.2)
    assert found.curves is not None and found.measured_m is not None
    drawn = np.flatnonzero(found.measured_m > 0)
    measured = np.clip(1e3 * found.measured_m[drawn], LOWEST_MM, TOP_MM)
    segment, span = found.curves.segment, found.curves.span
    segment, share = np.append(segment, segment[-1])[drawn], np.append(span[:, 0], span[-1, 1])[drawn]
    at = edges[segment] + share * (edges[segment + 1] - edges[segment])
    axes.plot(at, measured, color=MEASURED, linewidth=1.1, marker=".", markersize=3)
    known = np.concatenate([clearance, measured])
    known = known[np.isfinite(known)]
    if known.size:
        low, high = max(float(known.min()), LOWEST_MM), float(known.max())
        if high > DECADES * low:
            axes.set_yscale("log")
            axes.set_ylim(0.6 * min(low, 1e3 * found.margin_m or low), 1.7 * high)
            decimal(axes.yaxis)
        else:
            axes.set_ylim(0, 1.15 * max(high, 1e3 * found.margin_m))
    if found.margin_m:
        axes.axhline(1e3 * found.margin_m, color=INK, linewidth=1.1, linestyle=(0, (4, 2)))
    axes.set_ylabel("clearance [mm]")
    plain_axes(axes)
    verdicts = {SegmentStatus(int(each)) for each in proof.verdict}
    marks = [Line2D([], [], color=PROVEN, linewidth=2.2, label=BOUND)] if SegmentStatus.VALID in verdicts else []
    most = "" if found.most_recorded_m is None else f"; pieces up to {1e3 * found.most_recorded_m:g} mm"
    marks.append(Line2D([], [], color=MEASURED, linewidth=1.1, marker=".", label=AT_POINTS + most))
    marks += [
        Patch(color=COLOURS.get(each, REFUTED), alpha=0.3, linewidth=0, label=each.words)
        for each in sorted(verdicts - {SegmentStatus.VALID})
    ]
    if found.margin_m:
        marks.append(Line2D([], [], color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="required margin"))
    look = {"ncols": 2, "frameon": False, "fontsize": 9.5}  # more would not fit side by side
    legend = axes.legend(handles=marks, loc="lower left", bbox_to_anchor=(0, 1), **look)
    for label in legend.get_texts():
        label.set_color(QUIET)


def _draw_contacts(axes: Axes, found: FileProof, edges: Float[np.ndarray, "m+1"]) -> None:
    """Draw the distances at the deepest contacts, below 0 in collision, with a marker for each pair of bodies."""
    assert found.proof is not None
    contacts = [
        each for group in proof_record.unproven_groups(found) for each in proof_record.worst_pairs(found, group)
    ]
    marks = dict(zip(dict.fromkeys((each.body, each.other) for each in contacts), MARKS, strict=False))
    distances = [0.0]
    for contact in (*found.contacts.values(), *contacts):
        begin, end = edges[contact.segment : contact.segment + 2]
        at, distance = begin + contact.place * (end - begin), 1e3 * contact.clearance_m
        colour = COLOURS.get(SegmentStatus(int(found.proof.verdict[contact.segment])), REFUTED)
        axes.vlines(at, 0, distance, color=colour, linewidth=1.4)
        mark = marks.get((contact.body, contact.other), OTHER)
        axes.scatter(at, distance, c=colour, marker=mark, s=26, zorder=3, clip_on=False)
        distances.append(distance)
    axes.axhline(0, color=QUIET, linewidth=0.9)
    axes.set_ylabel("distance [mm]\nbelow 0: depth")
    plain_axes(axes)
    low, high = min(distances), max(distances)
    room = 0.12 * (high - low or 1.0)
    axes.set_ylim(low - room, high + room)
    handles = [
        Line2D([], [], color=QUIET, linestyle="", marker=mark, markersize=5, label=f"{body} and {other}")
        for (body, other), mark in marks.items()
    ]
    look = {"ncols": 2, "frameon": False, "fontsize": 9, "labelcolor": INK, "borderaxespad": 0.2}
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), **look)
