"""Cost of equation (3) over the required margin.

    python -m benchmarks.cost_against_margin OUT.png [--set KEY=VALUE]...

Plans the default job by `beam` with every margin below, with and without smoothing, and draws the cost of its
motion if it leads to the last target; the numbers go to OUT.csv. About a minute on two cores. The figure of the docs:

    python -m benchmarks.cost_against_margin docs/figures/cost_against_margin.png \\
        --set workpiece.rotation_y_rad=0.4 --set workpiece.rotation_z_rad=-0.1
"""

import argparse
import csv
from pathlib import Path

import numpy as np

import htcp_jax
from htcp_jax.device import compile_cache
from htcp_jax.report.charts.style import new_figure
from htcp_jax.solvers.path_qp import path_cost

MARGINS_MM = (0.0, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0)
SMOOTH = {True: "smoothed", False: "as the search found it"}


def cost(plan: htcp_jax.Plan) -> float:
    """Cost (3) over all configurations, with weights of 1 [rad2]; NaN if no motion leads to the last target."""
    plans = plan.plans
    if not plans.executable[plans.exists].all():
        return np.nan
    segments = [[*plans.via_points.on_segment(0, t), plans.x[0, t]] for t in range(plans.x.shape[1])]
    x = np.array([plans.start[0], *(configuration for segment_status in segments for configuration in segment_status)])
    return path_cost(x, np.ones(x.shape[1]))


def main() -> None:
    """Plan, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    arguments = parser.parse_args()
    compile_cache.enable()
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
    """Draw two lines over the margin."""
    figure = new_figure(3.6, "Cost of equation (3) against the margin", "beam, one pose; complete motions alone")
    axes = figure.subplots()
    for smooth, row in costs.items():
        axes.plot(MARGINS_MM, row, marker="o", markersize=4, label=SMOOTH[smooth])
    axes.set_xlabel("required margin at the targets [mm]")
    axes.set_ylabel("cost [rad²]")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
