"""Options of commands that read a motion from a file."""

from typing import Annotated

import typer

Format = Annotated[
    str | None, typer.Option(metavar="NAME", help="Format of the file; by default by its ending and content.")
]
Unit = Annotated[
    str | None, typer.Option(metavar="deg|rad", help="Unit of angles; by default as the file or its format states.")
]
Interpolation = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Motion between two configurations: linear, cubic (the file has velocities) or quintic (also "
        "accelerations); by default as the format's controller moves.",
    ),
]
