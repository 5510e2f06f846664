"""`htcp plan`: one job from a configuration to a table and four files."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from htcp_jax import planner
from htcp_jax.config import PlanConfig, load_config
from htcp_jax.escape import METHODS
from htcp_jax.job import scene
from htcp_jax.metrics import Summary, summarise
from htcp_jax.picture import draw_plan
from htcp_jax.plans import Plans
from htcp_jax.results import (
    provenance,
    summary_record,
    write_json,
    write_trajectory_csv,
    write_trajectory_npz,
    written_whole,
)
from htcp_jax.robot import Robot, lengthen_tool
from htcp_jax.scenario import Scenario
from htcp_jax.validate import VALIDATION
from htcp_jax.workpiece import Workpiece

COMPLETE, INCOMPLETE = 0, 3

Config = Annotated[Path | None, typer.Argument(metavar="CONFIG.yaml", help="The job; else the default.")]
Method = Annotated[str | None, typer.Option(metavar="NAME", help=f"One of {', '.join(METHODS)}.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key; may be repeated.")
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")]


def plan(
    config: Config = None, method: Method = None, overrides: Overrides = None, out: Out = Path("out/plan")
) -> int:
    """Plan one job: track every target of the path while every capsule keeps clear of the workpiece.

    Writes trajectory.csv, trajectory.npz, summary.json and plan.png. Exits with 0 when every target is
    tracked, with 3 when some are not (what was tracked is saved), with 2 on bad input.

    \b
    htcp plan                                 the default job, which is configs/duct.yaml
    htcp plan job.yaml --method baseline      a job of your own by another method
    htcp plan --set settings.alpha_rad=0.05 --set "start_rad=[0, -2.3, 0.5, 0, 0.5, 0]"
    """
    chosen = [*(overrides or []), *([f"method={method}"] if method is not None else [])]
    job = load_config(config, chosen)
    robot, workpiece, scenario = scene(job)
    planner.check_start(robot, workpiece, scenario)
    with written_whole(out) as folder:
        plans = _plan_with_progress(job, robot, workpiece, scenario)
        summary = summarise(plans)
        longer = lengthen_tool(robot, job.robot.tool_extension_m)
        title = f"{job.method}: {summary.tracked} of {summary.targets} targets"
        write_trajectory_csv(folder / "trajectory.csv", robot, plans)
        write_trajectory_npz(folder / "trajectory.npz", robot, plans)
        draw_plan(longer, workpiece, scenario, plans, title=title).savefig(folder / "plan.png")
        known = {"method": job.method, "validated": None, **summary_record(summary)}
        record = {**known, **provenance(), "config": job.model_dump()}
        write_json(folder / "summary.json", record)
    (out / VALIDATION).unlink(missing_ok=True)  # it spoke of the plan before
    _print_table(job, robot, workpiece, summary, out)
    return INCOMPLETE if summary.failures else COMPLETE


def _plan_with_progress(job: PlanConfig, robot: Robot, workpiece: Workpiece, scenario: Scenario) -> Plans:
    """The plan, with a bar of tracked targets on a terminal and nothing elsewhere."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(job.method, total=len(scenario.targets))
        return planner.plan(
            robot,
            workpiece,
            scenario,
            method=job.method,
            settings=job.settings,
            progress=lambda so_far: bar.update(task, completed=so_far.targets_tracked),
        )


def _print_table(job: PlanConfig, robot: Robot, workpiece: Workpiece, summary: Summary, out: Path) -> None:
    s = summary
    rows = {
        "targets tracked": f"{s.tracked} of {s.targets}",
        "success rate": f"{100 * s.success_rate:.2f} %",
        "time per step": f"{s.step_ms:.2f} ms",
        "run, compile time": f"{s.run_s:.2f} s, {s.compile_s:.2f} s",
        "TCP distance": f"{s.tcp_distance_mean_mm:.3g} mm mean, {s.tcp_distance_max_mm:.3g} mm largest",
        "clearance": f"{s.clearance_min_mm:.3g} mm smallest, {s.clearance_mean_mm:.3g} mm mean",
        "escapes": str(s.after_escape),
        "files": str(out),
    }
    console = Console(highlight=False, soft_wrap=True)
    console.print(Text(f"{job.method}: {robot.name}, {workpiece.name}", style="bold"))
    for name, value in rows.items():
        console.print(Text.assemble((f"{name:<20}", "cyan"), value))
    for failure in summary.failures:
        console.print(Text.assemble((f"failed at target {failure.target}: ", "red"), failure.status.message))
