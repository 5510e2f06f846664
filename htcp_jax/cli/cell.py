"""`htcp cell`: convert the URDF or MJCF of a cell in which the part moves: on a positioner, or in the arm's hand."""

from pathlib import Path
from typing import Annotated

import typer

from htcp_jax.cli.output import Json
from htcp_jax.cli.robot import FitTolerance, Fix, Model, Most, Replace, Srdf, Visual, convert

Tool = Annotated[str, typer.Option("--tool", metavar="NAME", help="TCP: a site or link of the model.")]
Part = Annotated[str, typer.Option("--part", metavar="LINK", help="Link that carries the part.")]
Out = Annotated[Path, typer.Option(metavar="CELL.xml", help="Output file; a picture is written next to it.")]
Omit = Annotated[
    list[str] | None,
    typer.Option(metavar="LINK", help="Link without capsules: the part itself. May be repeated."),
]


def cell(
    model: Model,
    tool: Tool,
    part: Part,
    out: Out,
    omit: Omit = None,
    most: Most = None,
    fit_tolerance: FitTolerance = None,
    visual: Visual = False,
    srdf: Srdf = None,
    fix: Fix = None,
    replace: Replace = False,
    as_json: Json = False,
) -> int:
    """Convert the URDF or MJCF model of a cell in which the part moves.

    The model is the cell as it stands: world, positioner or rail, arm, tool. The joints between the link that carries
    the part and the TCP are kept, all others are frozen; --fix freezes further ones. Bodies are enclosed by capsules as
    by htcp robot. Writes CELL.xml, for robot.model of a job, and CELL.png. A workpiece is posed in the frame of the
    link that carries it; if its shape is in the model, --omit LINK leaves it to the job. With --part world the part
    stands still, as by htcp robot.

    Exit codes: 0, 2 on bad input or if CELL.xml exists.

    \b
    Examples:
      htcp cell cell.urdf --tool torch_tip --part table --out cell.xml
      htcp cell cell.urdf --tool grinder_tip --part part --omit part --out held.xml     a fixed tool, the part in hand
      htcp cell cell.urdf --tool torch_tip --part table --fix tilt=0.3 --out flat.xml
    """
    options = {"most": most, "visual": visual, "srdf": srdf, "omit": omit or ()}
    return convert(model, out, fix or (), fit_tolerance, replace, as_json, tcp=tool, part=part, **options)
