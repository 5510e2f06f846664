"""Charts of a part of a run, by the stems of their file names; each is drawn on demand."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from htcp_jax.motion import Plans
from htcp_jax.report import charts, tables
from htcp_jax.report.document import Picture
from htcp_jax.report.groups import Part
from htcp_jax.report.timing import feed_targets, timing_charts
from htcp_jax.runs import columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_SLICES = 9  # maximum number of maps side by side
SUCCESS, MAP = "success", "map"  # names of the charts of all scenarios, and over the grid
OF_TASK = "task."  # prefix of task parameters; success and reachability are drawn over each of them


class Chart(NamedTuple):
    """A chart that is not drawn yet."""

    draw: "Callable[[], Figure]"
    alt: str  # alternative text
    over_grid: bool = False  # True for charts of the number of targets over the grid of scenarios

    def picture(self, name: str) -> Picture:
        """Draw the chart; `name` is the stem of its file."""
        return Picture(name, self.draw(), self.alt)


def charts_of(part: Part, over: str | None = None) -> dict[str, Chart]:
    """Return the charts of a part by name, without the prefix of the part.

    Args:
        part: The part of the run.
        over: Name of the parameter over which the chart "map" is drawn, see `Part.column_of`; None: by the grid.

    Raises:
        InputError: If the part has no parameter with this name.
    """
    status = {method: plans.status for method, plans in part.plans.items()}
    executable = {method: plans.executable for method, plans in part.plans.items()}
    survival = partial(charts.survival, status, executable=executable, reachability=part.reachability)
    found = {
        SUCCESS: Chart(partial(_success, part), f"Targets tracked and scenarios complete, by method, on {part.name}"),
        **(_over_grid(part) if over is None else {MAP: _rates(part, [part.column_of(over)])}),
        "survival": Chart(survival, "Number of scenarios that execute each target, by method"),
    }
    if any(map(tables.reasons, part.plans.values())):
        found["stops"] = Chart(partial(charts.stops, status), "Where and why scenarios end")
    clearance = {method: plans.clearance for method, plans in part.plans.items()}
    alt = "Clearance along the path: median, band and minimum, by method"
    found["clearance"] = Chart(partial(charts.clearance_along, clearance), alt)
    known = {method: values for method, values in part.manipulability.items() if np.isfinite(values).any()}
    if known:
        lowest = feed_targets(part)  # empty if the run is not timed
        alt = "Manipulability along the path: median, band and minimum, by method"
        alt += ", and where the feed is lowest" if lowest else ""
        found["manipulability"] = Chart(partial(charts.manipulability_along, known, lowest), alt)
    names, units = zip(*(joint.rsplit("_", 1) for joint in part.run.manifest.joints), strict=True)
    unit, x = " or ".join(sorted(set(units), reverse=True)), {method: plans.x for method, plans in part.plans.items()}
    steps = partial(charts.joint_motion, {method: plans.joint_step for method, plans in part.plans.items()})
    joints = partial(charts.joint_motion_by_joint, x, names, unit=unit)
    timed = {name: Chart(draw, alt) for name, (draw, alt) in timing_charts(part).items()}
    return (
        found
        | timed
        | {
            "joint-motion": Chart(steps, "Length of the joint steps, by method and along the path"),
            "joints": Chart(joints, "Length of the steps of every joint, by method"),
        }
    )


def numbered_values(part: Part) -> list[str]:
    """Return sentences with the values that the charts over the grid number; empty if there are none."""
    return [
        f"In the charts, {axis.label} {', '.join(f'{name}: {value}' for name, value in axis.numbered.items())}."
        for axis in _axes(part).values()
        if axis.numbered
    ]


def _success(part: Part) -> "Figure":
    rows = tables.results(part).records()
    theirs = {row["method"]: row["paper_tracked_percent"] for row in tables.paper(part).records()}
    whole = all(row["scenarios"] == len(part.numbers) for row in rows)
    return charts.success(
        {row["method"]: row["tracked"] for row in rows},
        {row["method"]: row["targets"] for row in rows},
        executable={row["method"]: row["executable"] for row in rows},
        complete={row["method"]: (row["complete"], row["scenarios"]) for row in rows},
        paper=theirs or None,
        reachability=int(part.reachability.sum()) if part.reachability is not None and whole else None,
    )


def success_of_parts(parts: Sequence[Part]) -> Chart:
    """Return the chart of the results of several parts, with a bar for each method and part, next to each other."""
    methods = dict.fromkeys(method for part in parts for method in part.plans)
    rows = {
        f"{method}, {part.name}": row | {"run": part.name}
        for method in methods
        for part in parts
        for row in tables.results(part).records()
        if row["method"] == method
    }
    keys = "tracked", "targets", "executable", "method", "run"
    tracked, targets, executable, of, runs = ({name: row[key] for name, row in rows.items()} for key in keys)
    complete = {name: (row["complete"], row["scenarios"]) for name, row in rows.items()}
    draw = partial(charts.success, tracked, targets, executable=executable, complete=complete, methods=of, runs=runs)
    return Chart(draw, f"Targets tracked and scenarios complete, by method, in {', '.join(p.name for p in parts)}")


def _axes(part: Part) -> dict[str, charts.Axis]:
    return {name: charts.Axis(columns.column(name).title, values.tolist()) for name, values in part.axes.items()}


def _over_grid(part: Part) -> dict[str, Chart]:
    """Return charts of the results over the grid of parameters.

    If values are drawn at random, all parameters are drawn as rates in bins. Else one parameter is drawn as a line, two
    as a map, three as a map for each value of the first, and more as maps of means. Each parameter of the task is also
    drawn as a line.
    """
    names, axes = list(part.axes), _axes(part)

    def cells(count, chosen):
        values = {m: _count_or_nan(plans, getattr(plans.outcomes, count)) for m, plans in part.plans.items()}
        return {method: part.cells(own, chosen) for method, own in values.items()}

    def chart(draw, chosen, **options):
        def drawn():
            given = cells("tracked", chosen), *(axes[each] for each in chosen), part.targets
            return draw(*given, executable=cells("executable", chosen), **options)

        return Chart(drawn, "Tracked targets of every scenario over the grid, by method", over_grid=True)

    def means(chosen):
        name = f"map-{'-'.join(str(names.index(each) + 1) for each in chosen)}"
        return {name: chart(charts.success_map, chosen, note="Mean over the other axes.")}

    def line(name):
        known = part.reachability
        options = {"reachability": None if known is None else part.cells(known.astype(float), [name])}
        if len(names) == 1:
            return {MAP: chart(charts.success_line, [name], **options)}
        options["title"] = f"Success over {axes[name].label}, means over the other axes"
        return {f"along-{name.replace('.', '-')}": chart(charts.success_line, [name], **options)}

    if any(map(part.is_drawn, names)):
        return {MAP: _rates(part, list(part.varied))}
    if len(names) < 2:
        return line(names[0]) if names else {}
    along = {}
    for name in filter(lambda name: name.startswith(OF_TASK), names):
        along |= line(name)
    if len(names) == 2:
        return along | {MAP: chart(charts.success_map, names)}
    if len(names) == 3 and len(part.axes[names[0]]) <= MOST_SLICES:
        return along | {MAP: chart(charts.success_slices, names)}
    return along | means(names[:2]) | (means(names[-2:]) if len(names) > 3 else {})


def _rates(part: Part, names: Sequence[str]) -> Chart:
    """Return the chart of scenarios that are executable to the last target, over some parameters."""
    done = {m: _count_or_nan(plans, plans.outcomes.can_be_driven) for m, plans in part.plans.items()}
    given = {columns.column(name).title: part.varied[name] for name in names}
    what = f"Share of scenarios executable to the last target, by method, over {', '.join(given)}"
    return Chart(partial(charts.success_rates, done, given), what, over_grid=True)


def _count_or_nan(plans: Plans, count: np.ndarray) -> np.ndarray:
    """Return `count` (S,) with NaN for the scenarios that are not planned."""
    return np.where(plans.outcomes.planned, count, np.nan)
