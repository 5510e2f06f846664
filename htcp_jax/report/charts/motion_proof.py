"""Chart of a proof: guaranteed clearance along a motion, segments by verdict, and the deepest contacts."""

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
NAMED = 4  # number of contacts that are labelled
LONGEST = 110  # maximum number of characters of the note
DECADES = 30.0  # ratio of the largest clearance to the smallest from which the axis is logarithmic
LOWEST_MM, TOP_MM = 1e-4, 1e4  # clearances are drawn between these


def proof_chart(found: FileProof) -> Figure:
    """Draw the proof of a file's motion.

    The upper panel shows the guaranteed clearance of proven segments, over time, or over the segments' numbers if the
    file has no times; other segments are shaded. The lower panel shows how deep the bodies are in collision there.

    Args:
        found: The proof; its file has joint values.
    """
    proof, times = found.proof, found.motion.time_s
    assert proof is not None
    edges = np.arange(len(proof.verdict) + 1, dtype=float) if times is None else times
    groups, text = proof_record.unproven_groups(found), proof_record.headline(found)
    figure = new_figure(
        5.6 if groups else 3.6, found.file.name, text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
    )
    panels = figure.subplots(
        2 if groups else 1, 1, squeeze=False, sharex=True, height_ratios=(3, 2)[: 2 if groups else 1]
    )
    _draw_clearance(panels[0, 0], found, edges)
    if groups:
        _draw_contacts(panels[1, 0], found, edges)
    below = panels[-1, 0]
    below.set_xlabel("segment" if times is None else "time [s]")
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
    known = clearance[np.isfinite(clearance)]
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
    axes.set_ylabel("guaranteed clearance [mm]")
    plain_axes(axes)
    verdicts = {SegmentStatus(int(each)) for each in proof.verdict}
    marks = [Line2D([], [], color=PROVEN, linewidth=2.2, label="proven")] if SegmentStatus.VALID in verdicts else []
    marks += [
        Patch(color=COLOURS.get(each, REFUTED), alpha=0.3, linewidth=0, label=each.words)
        for each in sorted(verdicts - {SegmentStatus.VALID})
    ]
    if found.margin_m:
        marks.append(Line2D([], [], color=INK, linewidth=1.1, linestyle=(0, (4, 2)), label="required margin"))
    legend = axes.legend(
        handles=marks, loc="lower right", bbox_to_anchor=(1, 1), ncols=len(marks), frameon=False, fontsize=9.5
    )
    for label in legend.get_texts():
        label.set_color(QUIET)


def _draw_contacts(axes: Axes, found: FileProof, edges: Float[np.ndarray, "m+1"]) -> None:
    at, depth, colour = [], [], []
    assert found.proof is not None
    for segment, contact in found.contacts.items():
        at.append(edges[segment] + contact.place * (edges[segment + 1] - edges[segment]))
        depth.append(-1e3 * contact.clearance_m)
        colour.append(COLOURS.get(SegmentStatus(int(found.proof.verdict[segment])), REFUTED))
    axes.vlines(at, 0, depth, color=colour, linewidth=1.4)
    axes.scatter(at, depth, c=colour, s=26, zorder=3)
    axes.axhline(0, color=QUIET, linewidth=0.9)
    axes.set_ylabel("depth [mm]")
    plain_axes(axes)
    low, high = min(0.0, *depth), max(0.0, *depth)
    room = 0.12 * (high - low or 1.0)
    axes.set_ylim(low - room, high + 3 * room)
    for group in proof_record.unproven_groups(found)[:NAMED]:
        if group.deepest is None:
            continue
        contact = found.contacts[group.deepest]
        x = edges[group.deepest] + contact.place * (edges[group.deepest + 1] - edges[group.deepest])
        is_right = x > edges[0] + 0.6 * (edges[-1] - edges[0])
        axes.annotate(
            f"{contact.body}: {contact.other}",
            (x, -1e3 * contact.clearance_m),
            (-6 if is_right else 6, 5),
            textcoords="offset points",
            ha="right" if is_right else "left",
            color=INK,
            fontsize=9,
        )
