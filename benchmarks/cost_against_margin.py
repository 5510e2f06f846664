"""Cost of equation (3) over the required margin.

    python -m benchmarks.cost_against_margin OUT.png [--set KEY=VALUE]...

Plans the default job by `beam` with several margins, with and without smoothing, and draws the cost of motions that
lead to the last target. The numbers are written to OUT.csv. It takes about a minute on two cores. For the docs' figure:

    python -m benchmarks.cost_against_margin docs/figures/cost_against_margin.png \\
        --set workpiece.rotation_y_rad=0.4 --set workpiece.rotation_z_rad=-0.1
"""

import argparse
import csv
from pathlib import Path

import numpy as np

import htcp_jax
from htcp_jax.caching import cache_folder
from htcp_jax.report.charts.style import LINES, new_figure, plain_axes
from htcp_jax.solvers.path_qp import path_cost

MARGINS_MM = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0)
SMOOTH = {True: "smoothed", False: "as the search found it"}
LOOKS = {True: LINES["nspace-sqp"], False: LINES["baseline"]}  # colour and line style, with and without smoothing


def cost(plan: htcp_jax.Plan) -> float:
    """Return the cost (3) of a plan with weights of 1 [rad2]; NaN if no motion leads to the last target."""
    plans = plan.plans
    if not plans.executable[plans.exists].all():
        return np.nan
    segments = [[*plans.via_points.on_segment(0, t), plans.x[0, t]] for t in range(plans.x.shape[1])]
    x = np.array([plans.start[0], *(configuration for segment_status in segments for configuration in segment_status)])
    return path_cost(x, np.ones(x.shape[1]))


def main() -> None:
    """Plan with every margin, write the CSV file, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    arguments = parser.parse_args()
    cache_folder.enable()
    costs = {smooth: [] for smooth in SMOOTH}
    for margin_mm in MARGINS_MM:
        for smooth, row in costs.items():
            own = [f"margin_m={1e-3 * margin_mm}", "method=beam", f"settings.smooth={str(smooth).lower()}"]
            row.append(cost(htcp_jax.plan(overrides=[*arguments.overrides, *own])))
        print(f"margin {margin_mm:g} mm: " + ", ".join(f"{costs[s][-1]:.4f} {name}" for s, name in SMOOTH.items()))
    with arguments.out.with_suffix(".csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["margin_mm", *SMOOTH.values()])
        rows.writerows([f"{m:g}", *(f"{row[k]:.6f}" for row in costs.values())] for k, m in enumerate(MARGINS_MM))
    draw(costs).savefig(arguments.out, dpi=150)


def draw(costs: dict[bool, list[float]]):
    """Return a figure of the cost over the margin, with a line for each kind of plan."""
    figure = new_figure(3.6, "Cost of equation (3) against the margin", "beam, one pose; complete motions alone")
    axes = figure.subplots()
    for smooth, row in costs.items():
        colour, style = LOOKS[smooth]
        axes.plot(MARGINS_MM, row, color=colour, linestyle=style, marker="o", markersize=4, label=SMOOTH[smooth])
    axes.set_xlabel("required margin at the targets [mm]")
    axes.set_ylabel("cost [rad²]")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    plain_axes(axes)
    return figure


if __name__ == "__main__":
    main()
