"""Robot programs of complete runs: scenarios that hold the feed rate, largest shares of the limits, CPU times.

    htcp sweep sweeps/workpiece.yaml --methods beam --out out/workpiece
    htcp sweep sweeps/robot.yaml --methods beam --out out/robot
    python -m benchmarks programs out/workpiece out/robot [--feed 20mm/s] [--checked N] [--json FILE]

The table has one row per run, for the scenarios whose motion leads to the last target: the number that holds the feed
rate within 1 % over 99 % of the path; the largest share of any limit, by finite differences of the CSV's configurations
at 1 ms; the median CPU times of a program, without reading the plan, and of its configurations; and the number of
configurations of the first N scenarios that MuJoCo refutes, at 1 ms.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from benchmarks import hardware
from benchmarks.figures import Figure, save
from htcp_jax.jobs import tasks_of_targets
from htcp_jax.jobs.build import scene
from htcp_jax.runs import open_plans
from htcp_jax.spec.feed import feed_of
from htcp_jax.trajectory import PlanProgram
from htcp_jax.trajectory.blends import MotionSlack, motion_slack
from htcp_jax.trajectory.figures import ProgramFigures, program_figures
from htcp_jax.trajectory.plan_program import program_of
from htcp_jax.trajectory.program import time_motion
from htcp_jax.trajectory.task_slack import with_rows
from htcp_jax.validation import check_timed

HELD, STEP_S = 0.99, 1e-3


class Found(NamedTuple):
    """Results of one scenario."""

    scenario: int
    figures: ProgramFigures
    largest: float  # share of any limit
    made_ms: float
    written_ms: float
    refuted: int | None  # number of configurations
    configurations: int


def main() -> None:
    """Print the table, and below each row the reasons of feed drops."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", help="that htcp sweep or htcp plan wrote")
    parser.add_argument("--feed", default="20mm/s")
    parser.add_argument("--checked", type=int, default=1, help="number of scenarios that MuJoCo checks")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the times and counts as JSON, too")
    chosen = parser.parse_args()
    print(hardware.line())
    print(
        "| run | executable | hold the feed | largest share of a limit | CPU ms | configurations ms | "
        "refuted by MuJoCo |"
    )
    print("|---|---|---|---|---|---|---|")
    rows = []
    for folder in chosen.folders:
        found = list(of_run(folder, feed_of(chosen.feed), chosen.checked))
        print(row(folder, found), flush=True)
        if found:
            made_ms, written_ms = medians(found)
            rows += [Figure(f"{Path(folder).name}, program", made_ms, "ms", len(found))]
            rows += [Figure(f"{Path(folder).name}, configurations", written_ms, "ms")]
        for one in found:
            if one.figures.held_share < HELD:
                reasons = ", ".join(sorted({drop.reason for drop in one.figures.drops}))
                print(f"    scenario {one.scenario}: {100 * one.figures.held_share:.2f} %: {reasons}")
    save(chosen.json, rows)


def of_run(folder: str, feed_m_s: float, checked: int) -> Iterator[Found]:
    """Time every scenario of a run whose motion leads to its last target, by the run's first method."""
    opened = open_plans(folder)
    plans = opened.plans(opened.methods[0])
    driven = [k for k in range(len(plans.status)) if plans.outcome(k).can_be_driven]
    for count, scenario in enumerate(driven):
        made = program_of(opened, feed_m_s, scenario=scenario)
        left = motion_slack(plans, scenario, made.program.motion, made.job.settings.tube_m)
        if made.job.task_rows:
            tasks = tasks_of_targets(made.job, made.robot, plans.seam_of_targets)
            left = with_rows(left, tasks, made.robot, made.program.motion, scene(made.job)[2].goals)
        _, made_ms = timed(lambda made=made, left=left: time_motion(made.robot, *made_of(made, left)))
        configurations, written_ms = timed(lambda made=made: made.program.timed(STEP_S))
        refuted = check_timed(folder, configurations, made.method, scenario).refuted if count < checked else None
        found = program_figures(made.program, made.limits)
        yield Found(
            scenario, found, largest(configurations.x, made), made_ms, written_ms, refuted, len(configurations.x)
        )


def made_of(made: PlanProgram, left: MotionSlack) -> tuple:
    """Return the arguments of `time_motion` after the robot."""
    return made.program.motion, left, made.limits, made.program.feed_m_s


def timed(function: Callable) -> tuple[Any, float]:
    """Return a function's result, and its CPU time [ms]."""
    begin = time.process_time()
    found = function()
    return found, 1e3 * (time.process_time() - begin)


def largest(x: Float[np.ndarray, "n N"], made: PlanProgram) -> float:
    """Return the largest share of any limit, by finite differences of configurations at 1 ms."""
    rates = (np.diff(x, n=n, axis=0) / STEP_S**n for n in (1, 2, 3))
    return max(float((np.abs(rate) / limit).max()) for rate, limit in zip(rates, made.limits, strict=True))


def medians(found: list[Found]) -> tuple[float, float]:
    """Return the median CPU times of a program and of its configurations [ms]."""
    return statistics.median(one.made_ms for one in found), statistics.median(one.written_ms for one in found)


def row(folder: str, found: list[Found]) -> str:
    """Format a row of the table."""
    if not found:
        return f"| {folder} | 0 | | | | | |"
    held = sum(one.figures.held_share >= HELD for one in found)
    most = max(one.largest for one in found)
    made, written = medians(found)
    looked = [one for one in found if one.refuted is not None]
    refuted = f"{sum(one.refuted for one in looked)} of {sum(one.configurations for one in looked):,}"
    return f"| {folder} | {len(found)} | {held} | {most:.3f} | {made:.0f} | {written:.0f} | {refuted} |"


if __name__ == "__main__":
    main()
