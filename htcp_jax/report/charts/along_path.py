"""Charts along the path: survival, failures, clearance, manipulability, joint motion. See `charts`."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int, Int8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from htcp_jax.motion import plans
from htcp_jax.report.charts.style import (
    INK,
    PAPER,
    QUIET,
    decimal,
    heading,
    line_of,
    name_lines,
    new_figure,
    number_targets,
    outer_labels,
    panels_by_method,
    plain_axes,
)
from htcp_jax.report.charts.success import dashed_note, has_not_executable
from htcp_jax.status import Status

BANDS = "Line: median over the scenarios that track the target. Band: 10 to 90 %. Dots: minimum."
LOW_FEED = "#d55e00"
LEAST_MM, LEAST_STEP = 1e-3, 1e-5  # smaller clearances [mm] and joint steps [rad or m] are drawn at these values
REASONS = {
    Status.QP_INFEASIBLE: ("#e69f00", "s"),
    Status.ITERATION_LIMIT: ("#0072b2", "o"),
    Status.RECOVERY_EXHAUSTED: ("#d55e00", "D"),
    Status.PATH_BLOCKED: ("#aa4499", "^"),
    Status.QP_FAILED: ("#000000", "X"),
    Status.START_IN_COLLISION: ("#7f7f7f", "*"),
    Status.OUT_OF_REACH: ("#009e73", "v"),
    Status.TIP_BLOCKED: ("#56b4e9", "P"),
    Status.NO_NULL_SPACE: ("#999999", "h"),
    Status.HOME_IN_COLLISION: ("#8c564b", "<"),
    Status.HOME_NOT_JOINED: ("#f0e442", "p"),
    Status.NO_START: ("#332288", "d"),
    Status.NO_SOLUTION: ("#66a61e", ">"),
    Status.BUDGET_EXHAUSTED: ("#a6761d", "H"),
}


def survival(
    status: Mapping[str, Int8[np.ndarray, "S T"]],
    *,
    executable: Mapping[str, Bool[np.ndarray, "S T"]] | None = None,
    reachability: Int[np.ndarray, "S"] | None = None,
    title: str = "Survival: scenarios by target",
) -> Figure:
    """Draw the number of scenarios that execute or track each target, over the target's index.

    A scenario ends at its first failure.

    Args:
        status: Results of the targets by method, as `Plans.status`.
        executable: Targets to which a proven motion leads, by method; if there are fewer than tracked ones, these are
            the lines, and all tracked ones are faint.
        reachability: Number of consecutive targets known to be reachable, for each scenario; drawn as a dashed line.
        title: The title of the figure.
    """
    tracked = {method: plans.is_tracked(table).sum(axis=0) for method, table in status.items()}
    shown = tracked if executable is None else {method: table.sum(axis=0) for method, table in executable.items()}
    cut = has_not_executable(tracked, shown)
    note = (
        "Line: a proven motion from the start leads to the target (executable); faint: tracked."
        if cut
        else "Scenarios that track the target; a scenario ends at its first failure."
    )
    figure = new_figure(4.6, title, " ".join([note, *dashed_note(reachability)]))
    axes = figure.subplots()
    scenarios, targets = next(iter(status.values())).shape
    if reachability is not None:
        reachable = (reachability[:, None] > np.arange(targets)[None, :]).sum(axis=0)
        axes.step(range(targets), reachable, where="mid", color=INK, linewidth=1.1, linestyle=(0, (4, 2)))
    ends = {}
    for method, alive in shown.items():
        colour, style = line_of(method)
        if (alive != tracked[method]).any():
            look = {"color": colour, "linestyle": ":", "linewidth": 1.2, "alpha": 0.6}
            axes.step(range(targets), tracked[method], where="mid", **look)
        axes.step(range(targets), alive, where="mid", color=colour, linestyle=style, linewidth=2)
        ends[method] = float(alive[-1])
    axes.set_ylim(0, 1.03 * scenarios)
    axes.set_xlabel("target")
    number_targets(axes, targets)
    axes.set_ylabel(f"scenarios that {'execute' if cut else 'track'} it, of {scenarios}")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    name_lines(axes, ends, targets - 1, "{:.0f}")
    plain_axes(axes)
    return figure


def stops(status: Mapping[str, Int8[np.ndarray, "S T"]], *, title: str = "Where and why scenarios end") -> Figure:
    """Draw a marker for each method, reason and target at which scenarios fail.

    Shape and colour of a marker show the reason of failure, its area the number of scenarios.

    Args:
        status: Results of the targets by method, as `Plans.status`.
        title: The title of the figure.
    """
    figure = new_figure(0.55 * len(status) + 1.9, title, "A marker's area is the number of scenarios that end there.")
    axes = figure.subplots()
    targets = next(iter(status.values())).shape[1]
    found = {reason for table in status.values() for reason in REASONS if (table == reason).any()}
    shown = [reason for reason in REASONS if reason in found]
    most = max((int((table == reason).sum(axis=0).max()) for table in status.values() for reason in shown), default=1)
    area = min(22.0, 420.0 / most)  # a marker's area for one scenario [points^2]
    for y, table in enumerate(status.values()):
        lanes = [reason for reason in shown if (table == reason).any()]
        for lane, reason in enumerate(lanes):
            counts = (table == reason).sum(axis=0)
            at = np.flatnonzero(counts)
            colour, marker = REASONS[reason]
            style = {"color": colour, "marker": marker, "alpha": 0.75, "edgecolors": PAPER, "linewidths": 0.6}
            height = y + 0.6 * ((lane + 0.5) / len(lanes) - 0.5)
            axes.scatter(at, np.full(len(at), height), s=area * counts[at] + 14, zorder=3, clip_on=False, **style)
        where = {"xycoords": ("axes fraction", "data"), "va": "center"}
        axes.annotate(_ended(table), (1.015, y), color=QUIET, fontsize=9, **where)
    for reason in shown:
        colour, marker = REASONS[reason]
        axes.scatter([], [], color=colour, marker=marker, s=46, label=reason.words)
    if shown:
        axes.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=len(shown), frameon=False, labelcolor=INK)
    axes.set_yticks(range(len(status)), list(status))
    axes.set_ylim(len(status) - 0.5, -0.5)
    axes.set_xlabel("target")
    number_targets(axes, targets)
    plain_axes(axes, grid="x")
    return figure


def clearance_along(
    clearance_m: Mapping[str, Float[np.ndarray, "S T"]],
    *,
    title: str = "Clearance along the path",
) -> Figure:
    """Draw the clearance over the target's index, one panel per method.

    Each panel shows the minimum, the median and the band from 10 to 90 % over the scenarios that track the target.

    Args:
        clearance_m: Clearance D at the targets [m], by method; NaN where not tracked.
        title: The title of the figure.
    """
    exact = {method: 1e3 * own for method, own in clearance_m.items()}
    means = {method: f"mean {np.nanmean(own):.3g} mm" for method, own in exact.items() if np.isfinite(own).any()}
    values = {method: np.maximum(own, LEAST_MM) for method, own in exact.items()}  # NaN stays NaN
    cut = any((own < LEAST_MM).any() for own in exact.values())
    note = f"{BANDS} Less than {LEAST_MM:g} mm: at the lower edge." if cut else BANDS
    figure, panels = _bands(values, title, note, means, "clearance [mm]")
    for axes in panels.flat[: len(values)]:
        axes.set_yscale("log")
    decimal(panels[0, 0].yaxis)
    return figure


def manipulability_along(
    manipulability_m_rad: Mapping[str, Float[np.ndarray, "S T"]],
    feed_targets: Mapping[str, Int[np.ndarray, "S"]] = MappingProxyType({}),
    *,
    title: str = "Manipulability along the path",
) -> Figure:
    """Draw the manipulability over the target's index, one panel per method, and mark the lowest feeds.

    Each panel shows the minimum, the median and the band from 10 to 90 % over the scenarios that track the target.

    Args:
        manipulability_m_rad: Smallest singular value of the task's Jacobian [m/rad], by method; NaN where not tracked.
        feed_targets: Target at which each scenario's feed is lowest, by timed method; negative if the feed is held or
            the scenario is not timed.
        title: The title of the figure.
    """
    least = {m: f"minimum {np.nanmin(v):.3g} m/rad" for m, v in manipulability_m_rad.items() if np.isfinite(v).any()}
    note = f"{BANDS} Triangles: where the feed is lowest." if feed_targets else BANDS
    figure, panels = _bands(manipulability_m_rad, title, note, least, "manipulability [m/rad]")
    for axes, (method, values) in zip(panels.flat, manipulability_m_rad.items(), strict=False):
        rows = np.flatnonzero(feed_targets.get(method, np.empty(0, int)) >= 0)
        at = feed_targets[method][rows] if len(rows) else rows
        style = {"color": LOW_FEED, "marker": "v", "edgecolors": PAPER, "linewidths": 0.6}
        axes.scatter(at, values[rows, at], s=36, zorder=4, clip_on=False, **style)
    panels[0, 0].set_ylim(bottom=0)  # 0: the arm is singular
    return figure


def _bands(
    values: Mapping[str, Float[np.ndarray, "S T"]], title: str, note: str, merits: Mapping[str, str], label: str
) -> tuple[Figure, np.ndarray]:
    """Draw values over the target's index, one panel per method; return the figure and its panels."""
    figure, panels = panels_by_method(len(values), 2.35, 1.1, title, note)
    for axes, (method, own) in zip(panels.flat, values.items(), strict=False):
        colour = line_of(method)[0]
        low, middle, high, least = _over_scenarios(own)
        index = np.arange(len(middle))
        axes.fill_between(index, low, high, color=colour, alpha=0.22, linewidth=0)
        axes.plot(index, middle, color=colour, linewidth=1.9)
        axes.plot(index, least, color=INK, linestyle="none", marker=".", markersize=3)
        heading(axes, method, merits.get(method, ""))
        plain_axes(axes)
    number_targets(panels[0, 0], len(middle))
    outer_labels(panels, len(values), "target", label)
    return figure, panels


def joint_motion(
    joint_step_rad: Mapping[str, Float[np.ndarray, "S T"]],
    *,
    title: str = "Joint motion",
) -> Figure:
    """Draw the joint steps |x_t - x_{t-1}| between targets.

    The left panel shows each method's distribution over all accepted steps, the right panel the median over scenarios
    at each target.

    Args:
        joint_step_rad: Length of the steps [rad], by method; NaN where a target is not tracked.
        title: The title of the figure.
    """
    note = "Left: median, middle half, middle nine tenths and longest of all steps. Right: median by target"
    medians = {method: _over_scenarios(values)[1] for method, values in joint_step_rad.items()}
    cut = any((values < LEAST_STEP).any() for values in medians.values())
    note += f", at least {LEAST_STEP:g} rad." if cut else "."
    figure = new_figure(max(3.4, 0.42 * len(joint_step_rad) + 1.6), title, note)
    spread, along = figure.subplots(1, 2, width_ratios=(1, 1.1))
    for y, (method, values) in enumerate(joint_step_rad.items()):
        _distribution(spread, y, values, method)
        colour, style = line_of(method)
        along.plot(np.maximum(medians[method], LEAST_STEP), color=colour, linestyle=style, linewidth=1.4)
    spread.set_yticks(range(len(joint_step_rad)), list(joint_step_rad))
    spread.set(ylim=(len(joint_step_rad) - 0.5, -0.5), xscale="log", xlabel="joint step [rad]")
    along.set(yscale="log", xlabel="target", ylabel="joint step [rad]")
    spread.set_xlim(left=max(spread.get_xlim()[0], LEAST_STEP))
    number_targets(along, next(iter(joint_step_rad.values())).shape[1])
    ends = {method: np.flatnonzero(np.isfinite(values)) for method, values in medians.items()}
    ends = {method: max(medians[method][at[-1]], LEAST_STEP) for method, at in ends.items() if at.size}
    name_lines(along, ends, along.get_xlim()[1], "{:.2g}")
    decimal(spread.xaxis)
    decimal(along.yaxis)
    plain_axes(spread, grid="x")
    plain_axes(along)
    return figure


def joint_motion_by_joint(
    x: Mapping[str, Float[np.ndarray, "S T N"]],
    joints: Sequence[str],
    *,
    unit: str = "rad",
    title: str = "Motion of each joint",
) -> Figure:
    """Draw the distribution of each joint's steps between targets, one panel per method.

    Args:
        x: Configurations by method, in `unit`; NaN where a target is not tracked.
        joints: Names of the joints.
        unit: The unit of the joints, for the label.
        title: The title of the figure.
    """
    note = "Median, middle half, middle nine tenths and longest of all steps from one target to the next."
    figure, panels = panels_by_method(len(x), 0.3 * len(joints) + 0.75, 1.0, title, note)
    for axes, (method, values) in zip(panels.flat, x.items(), strict=False):
        for y, steps in enumerate(np.abs(np.diff(values, axis=1)).transpose(2, 0, 1)):
            _distribution(axes, y, steps, method)
        axes.set_yticks(range(len(joints)), list(joints))
        axes.set(ylim=(len(joints) - 0.5, -0.5), xscale="log")
        heading(axes, method, "")
        plain_axes(axes, grid="x")
    low = min((axes.get_xlim()[0] for axes in panels.flat[: len(x)]), default=1e-4)
    panels[0, 0].set_xlim(left=max(low, LEAST_STEP))
    decimal(panels[0, 0].xaxis)
    outer_labels(panels, len(x), f"joint step [{unit}]", "joint")
    return figure


def _distribution(axes: Axes, y: int, values: Float[np.ndarray, "S T"], method: str) -> None:
    """Draw median, middle half, middle nine tenths and maximum of the finite values above 0, at the height `y`."""
    known = values[np.isfinite(values) & (values > 0)]
    if not known.size:
        return
    colour, style = line_of(method)
    low, first, middle, third, high = np.quantile(known, (0.05, 0.25, 0.5, 0.75, 0.95))
    axes.plot([low, high], [y, y], color=colour, linewidth=1.5, linestyle=style)
    axes.plot([first, third], [y, y], color=colour, linewidth=8, solid_capstyle="butt", alpha=0.75)
    axes.plot(middle, y, marker="o", color=PAPER, markeredgecolor=INK, markersize=6)
    axes.plot(known.max(), y, marker="|", color=INK, markersize=11, markeredgewidth=1.6)


def _over_scenarios(values: Float[np.ndarray, "S T"]) -> Float[np.ndarray, "4 T"]:
    """Return 10th percentile, median, 90th percentile and minimum of each column's finite values; NaN without any."""
    summary = np.full((4, values.shape[1]), np.nan)
    for column in range(values.shape[1]):
        known = values[np.isfinite(values[:, column]), column]
        if known.size:
            summary[:, column] = *np.quantile(known, (0.1, 0.5, 0.9)), known.min()
    return summary


def _ended(table: Int8[np.ndarray, "S T"]) -> str:
    ends = plans.outcomes(table)
    return f"{int(ends.complete.sum())} of {int(ends.planned.sum())} complete"
