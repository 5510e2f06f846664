"""`htcp plan`: one job from a configuration to a table and five files."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax import api
from htcp_jax.api import Plan, forget_validation
from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import Device, Json, Overrides, print_facts, print_json, progress_bar, stdout
from htcp_jax.runs.plan_folder import written_whole

COMPLETE, INCOMPLETE = 0, 3


Config = Annotated[Path | None, typer.Argument(metavar="CONFIG.yaml", help="The job or an example; else the default.")]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="A method; htcp methods lists them.", autocompletion=complete_method),
]
Retract = Annotated[bool, typer.Option("--retract", help="Let motion.csv lead back to home or the start, too.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")]


def plan(
    config: Config = None,
    method: Method = None,
    overrides: Overrides = None,
    out: Out = Path("out/plan"),
    retract: Retract = False,
    device: Device = None,
    as_json: Json = False,
) -> int:
    """Plan one job: track every target of the path while every capsule keeps clear of the workpiece.

    Writes motion.csv, which is what an arm may follow, trajectory.csv, trajectory.npz, summary.json and plan.png.
    Exits with 0 when a proven motion leads to the last target, else with 3 (what was tracked is saved), with 2 on bad
    input.

    \b
    htcp plan                                 the default job, which is the example duct
    htcp plan pipe                            another example; htcp example lists them
    htcp plan cone --method hybrid            a third one, by another method
    htcp plan --set settings.alpha_rad=0.05 --set "start_rad=[0, -2.3, 0.5, 0, 0.5, 0]"
    """
    with written_whole(out) as folder:
        made = plan_with_progress(config, overrides, method, device)
        made.write(folder, retract=retract)
    forget_validation(out)
    if as_json:
        print_json(made.record())
    else:
        print_facts(str(made), made.facts() | {"files": str(out)})
        for where, why in made.failure().items():
            stdout().print(Text.assemble((f"{where}: ", "red"), why))
    return COMPLETE if made.complete else INCOMPLETE


def plan_with_progress(
    config: Path | None, overrides: list[str] | None, method: str | None, device: str | None = None
) -> Plan:
    """Plan a job, with a bar of tracked targets on a terminal. Raises InputError as `api.plan` does."""
    with progress_bar("targets") as progress:
        return api.plan(
            config,
            overrides or (),
            method=method,
            device=device,
            progress=lambda now: progress(now.targets_tracked, now.targets),
        )
