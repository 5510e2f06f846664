"""`htcp cell`: convert the URDF or MJCF of a cell in which the part moves, on a positioner or held by the arm."""

from pathlib import Path
from typing import Annotated

import typer

from htcp_jax.cli.output import Json
from htcp_jax.cli.robot import FitTolerance, Fix, Limits, Model, Most, Omit, Replace, Srdf, Visual, convert

Tool = Annotated[
    str | None,
    typer.Option(
        "--tool",
        metavar="NAME",
        help="Site or link at the TCP. Omit it only if the model is a positioner or rail without an arm.",
    ),
]
Part = Annotated[str, typer.Option("--part", metavar="LINK", help="Link that carries the workpiece.")]
Out = Annotated[Path, typer.Option(metavar="CELL.xml", help="Output file; a picture is written next to it.")]


def cell(
    model: Model,
    part: Part,
    out: Out,
    tool: Tool = None,
    omit: Omit = None,
    most: Most = None,
    fit_tolerance: FitTolerance = None,
    visual: Visual = False,
    srdf: Srdf = None,
    fix: Fix = None,
    limits: Limits = None,
    replace: Replace = False,
    as_json: Json = False,
) -> int:
    """Convert the URDF or MJCF model of a cell in which the part moves.

    The model contains the complete cell: positioner or rail, arm and tool. The joints between the link that carries the
    workpiece and the TCP stay movable, with those that follow them. All others are frozen; --fix freezes further ones.
    Capsules enclose the bodies, as with htcp robot. Writes CELL.xml and CELL.png. In a job, set robot.model to
    CELL.xml, and give the workpiece's file and its pose in the frame of --part. If the model contains the workpiece,
    too, exclude that link with --omit. With --part world the workpiece is fixed, as with htcp robot.

    Omit --tool if the model is only a positioner or a rail, and set a job's positioner.model or rail.model to CELL.xml.
    Then the joints from the world to the link of --part stay movable.

    Exit codes: 0, 2 on bad input or if CELL.xml exists.

    \b
    Examples:
      htcp cell cell.urdf --tool torch_tip --part table --out cell.xml
      htcp cell cell.urdf --tool grinder_tip --part part --omit part --out held.xml     a fixed tool, the part in hand
      htcp cell cell.urdf --tool torch_tip --part table --fix tilt=0.3 --out flat.xml
      htcp cell positioner.urdf --part table --out positioner.xml
    """
    options = {"most": most, "visual": visual, "srdf": srdf, "omit": omit or (), "limits": limits}
    options |= {"tcp": part, "fewest": 1} if tool is None else {"tcp": tool, "part": part}
    return convert(model, out, fix or (), fit_tolerance, replace, as_json, **options)
