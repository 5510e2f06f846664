"""Success of the baseline over the margin of the clearance rows and the tolerance of the QP solver.

    python benchmarks/baseline_margin.py OUT.png [--set KEY=VALUE]...

Plans sweeps/workpiece.yaml with configs/paper.yaml by the baseline, for every pair of margin and tolerance, and draws
the success rate. The numbers are written to OUT.csv. It takes about three minutes on two cores.
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Problem
from htcp_jax.planning.batch import plan
from htcp_jax.report.charts.style import new_figure
from htcp_jax.runs.summary import summarise

MARGINS_M = (0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 5e-4, 1e-3, 2e-3, 5e-3)
TOLERANCES = (1e-6, 1e-8, 1e-10)
ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Plan the sweep for every pair of values, write the CSV file, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    arguments = parser.parse_args()
    cache_folder.enable()
    spec = load_sweep(ROOT / "sweeps/workpiece.yaml", ROOT / "configs/paper.yaml", arguments.overrides)
    batch = spec.batch()
    success = np.zeros((len(TOLERANCES), len(MARGINS_M)))
    for i, tolerance in enumerate(TOLERANCES):
        for j, margin in enumerate(MARGINS_M):
            settings = replace(spec.config.settings, qp_tolerance=tolerance, aim_above_m=margin)
            plans = plan(
                Problem.of(batch.robot, batch.workpiece, batch.scenarios, settings, check_paths=False), "baseline"
            )
            success[i, j] = 100 * summarise(plans).success_rate
            print(f"tolerance {tolerance:.0e}  margin {margin:.0e} m  success {success[i, j]:.2f} %", flush=True)
    with arguments.out.with_suffix(".csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["margin_m", *(f"success_percent_at_tolerance_{t:.0e}" for t in TOLERANCES)])
        for margin, column in zip(MARGINS_M, success.T, strict=True):
            rows.writerow([f"{margin:g}", *(f"{s:.2f}" for s in column)])
    draw(success, batch.workpiece.name).savefig(arguments.out, dpi=150)


def draw(success: np.ndarray, workpiece: str):
    """Return a figure of the success over the margin, one line per tolerance, on a logarithmic axis."""
    figure = new_figure(3.6, "Baseline: success against margin and QP tolerance", f"49 poses, {workpiece}, one row")
    axes = figure.subplots()
    x = [1e-10, *MARGINS_M[1:]]
    for tolerance, line in zip(TOLERANCES, success, strict=True):
        axes.plot(x, line, marker="o", markersize=4, label=f"QP tolerance {tolerance:.0e}")
    axes.set_xscale("log")
    axes.set_xticks(x[::2], ["0", *(f"{m:g}" for m in MARGINS_M[2::2])])
    axes.minorticks_off()
    axes.set_xlabel("margin of the clearance rows [m]")
    axes.set_ylabel("targets tracked [%]")
    axes.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
