"""`htcp plan`: plan one job, print a table and write five files."""

import importlib
import threading
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax import api
from htcp_jax.api import Plan, forget_validation
from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import (
    Device,
    Json,
    Overrides,
    Seed,
    claim_device,
    print_facts,
    print_json,
    progress_bar,
    stdout,
)
from htcp_jax.runs import plan_folder
from htcp_jax.runs import sweep as sweeps

COMPLETE, INCOMPLETE = 0, 3
MATPLOTLIB = "matplotlib.figure", "matplotlib.backends.backend_agg"


Config = Annotated[
    Path | None, typer.Argument(metavar="CONFIG.yaml", help="A job file or an example; the default job without one.")
]
Method = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Planning method; htcp methods lists them.", autocompletion=complete_method),
]
Retract = Annotated[
    bool, typer.Option("--retract", help="Append the motion back to the start, or to home, to motion.csv.")
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print more rows: smoothness, joint paths, clearance.")]


def plan(
    config: Config = None,
    method: Method = None,
    overrides: Overrides = None,
    out: Out = Path("out/plan"),
    seed: Seed = None,
    retract: Retract = False,
    device: Device = None,
    verbose: Verbose = False,
    as_json: Json = False,
) -> int:
    """Plan one job: a collision-free motion that moves the tool along the path.

    Writes motion.csv (the configurations to execute), trajectory.csv and trajectory.npz (one row per target),
    summary.json and plan.png.

    Exit codes: 0 if a proven motion leads to the last target, 3 if not (what was tracked is saved), 2 on bad input.

    A key of the job has the value that --set gives it, else that of the job file (or of a file that it builds on), else
    the default for the job's arm and part: a part of your own lies at the world's origin, not turned.

    \b
    Examples:
      htcp plan                                 the default job, the generated duct
      htcp plan pipe                            another example; htcp example lists them
      htcp plan cone --method hybrid            a third one, by another method
      htcp plan --set settings.alpha_rad=0.05 --set "start_rad=[0, -2.3, 0.5, 0, 0.5, 0]"
    """
    claim_device(device)  # before anything is read
    threading.Thread(target=_load_matplotlib, daemon=True).start()
    overrides = [*sweeps.seeded(overrides or (), seed)]
    with plan_folder.written_whole(out) as folder:
        made = plan_with_progress(config, overrides, method, device)
        made.write(folder, retract=retract)
    forget_validation(out)
    if as_json:
        print_json(made.record())
    else:
        print_facts(str(made), made.facts(verbose=verbose) | {"files": str(out)})
        for where, why in made.failure().items():
            stdout().print(Text.assemble((f"{where}: ", "red"), why))
    return COMPLETE if made.complete else INCOMPLETE


def _load_matplotlib() -> None:
    """Import what the picture needs while the plan computes: compiled code does not hold the interpreter's lock."""
    for module in MATPLOTLIB:
        importlib.import_module(module)


def plan_with_progress(
    config: Path | None, overrides: list[str] | None, method: str | None, device: str | None = None
) -> Plan:
    """Plan a job, with a bar of tracked targets on a terminal.

    Args:
        config: The job file or example; None: the default job.
        overrides: Changes of the job, "dotted.key=value" each.
        method: The planning method; None: the job's.
        device: The device; None: a GPU if there is one.

    Raises:
        InputError: As `api.plan`.
    """
    with progress_bar("targets") as progress:
        return api.plan(
            config,
            overrides or (),
            method=method,
            device=device,
            progress=lambda now: progress(now.targets_tracked, now.targets),
        )
