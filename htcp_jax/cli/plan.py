"""`htcp plan`: one job from a configuration to a table and four files."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from htcp_jax.api import Plan, checked_scene, forget_validation, plan_job
from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import Device, Json, Overrides, print_facts, print_json, stdout
from htcp_jax.jobs.config import PlanConfig
from htcp_jax.jobs.load_config import load_config
from htcp_jax.planner import batch, devices
from htcp_jax.runs.plan_folder import written_whole
from htcp_jax.scene.robot import Robot
from htcp_jax.scene.scenario import Scenario
from htcp_jax.scene.workpiece import Workpiece

COMPLETE, INCOMPLETE = 0, 3


Config = Annotated[Path | None, typer.Argument(metavar="CONFIG.yaml", help="The job; else the default.")]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="A planner; htcp methods lists them.", autocompletion=complete_method),
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")]


def plan(
    config: Config = None,
    method: Method = None,
    overrides: Overrides = None,
    out: Out = Path("out/plan"),
    device: Device = None,
    as_json: Json = False,
) -> int:
    """Plan one job: track every target of the path while every capsule keeps clear of the workpiece.

    Writes trajectory.csv, trajectory.npz, summary.json and plan.png. Exits with 0 when every target is tracked and
    no joint path between them collides, else with 3 (what was tracked is saved), with 2 on bad input.

    \b
    htcp plan                                 the default job, which is configs/duct.yaml
    htcp plan job.yaml --method baseline      a job of your own by another method
    htcp plan --set settings.alpha_rad=0.05 --set "start_rad=[0, -2.3, 0.5, 0, 0.5, 0]"
    """
    devices.use(device)
    chosen = [*(overrides or []), *([f"method={method}"] if method is not None else [])]
    job = load_config(config, chosen)
    parts = checked_scene(job)  # before a folder is made
    with written_whole(out) as folder:
        made = plan_with_progress(job, parts)
        made.write(folder)
    forget_validation(out)
    if as_json:
        print_json(made.record())
    else:
        print_facts(str(made), made.facts() | {"files": str(out)})
        for where, why in made.failure().items():
            stdout().print(Text.assemble((f"{where}: ", "red"), why))
    return COMPLETE if made.complete else INCOMPLETE


def plan_with_progress(job: PlanConfig, parts: tuple[Robot, Workpiece, Scenario]) -> Plan:
    """The plan, with a bar of tracked targets on a terminal and nothing elsewhere."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(job.method, total=None)

        def tell(now: batch.Progress) -> None:
            bar.update(task, completed=now.targets_tracked, total=now.targets)

        return plan_job(job, *parts, tell)
