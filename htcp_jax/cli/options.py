"""Arguments and options that several commands take."""

from pathlib import Path
from typing import Annotated

import typer

SweepFile = Annotated[Path, typer.Argument(metavar="SWEEP.yaml", help="The grid, sweeps/robot.yaml for example.")]
Limit = Annotated[int | None, typer.Option(metavar="N", help="Plan only the first N scenarios.")]
Config = Annotated[Path | None, typer.Option(metavar="CONFIG.yaml", help="In place of the sweep file's own.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key; may be repeated.")
]
