"""Options of the commands that time a plan."""

from typing import Annotated

import typer

from htcp_jax.errors import InputError
from htcp_jax.jobs.feed import UNITS, feed_of

_OF_PATH = f"Of the TCP on the path, 20mm/s say; in {', '.join(UNITS)}."
Feed = Annotated[str | None, typer.Option(metavar="SPEED", help=f"{_OF_PATH} Else the job's.")]
PlayedFeed = Annotated[
    str | None, typer.Option("--feed", metavar="SPEED", help=f"Play the program at its own time. {_OF_PATH}")
]
OneWay = Annotated[bool, typer.Option("--one-way", help="End at the last target, without the way back.")]
ProgramKeys = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key of program; may be repeated.")
]


def played_feed(feed: str | None, **others: object) -> float | None:
    """Parse the feed [m/s]; None if a plan is played by its targets. others: given options, by their names.

    Raises InputError as `feed_of` does, and for one of the others without a feed.
    """
    if feed is not None:
        return feed_of(feed)
    for name in (name for name, given in others.items() if given):
        raise InputError(f"--{name.replace('_', '-')} is of a program, which --feed gives its time; there is no --feed")
    return None
