"""Options of commands that read a motion from a file."""

import csv
from typing import Annotated

import typer

Format = Annotated[
    str | None, typer.Option(metavar="NAME", help="Format of the file; by default by its ending and content.")
]
Unit = Annotated[
    str | None, typer.Option(metavar="deg|rad", help="Unit of angles; by default as the file or its format states.")
]
Joints = Annotated[
    str | None,
    typer.Option(
        metavar="NAME,NAME,...",
        help="Columns or names of the file that are the robot's joints, in the robot's order, such as J1,J2,J3; by "
        "default those with the joints' names.",
    ),
]
Interpolation = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Motion between two configurations: linear, cubic (the file has velocities) or quintic (also "
        "accelerations); by default as the format's controller moves.",
    ),
]


def joint_names(text: str | None) -> tuple[str, ...]:
    """Return the names in the option --joints; a name with a comma stands in quotation marks."""
    return () if text is None else tuple(name.strip() for name in next(csv.reader([text], skipinitialspace=True), []))
