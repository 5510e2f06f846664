"""Options of the commands that time a plan."""

from typing import Annotated

import typer

from htcp_jax.errors import InputError
from htcp_jax.jobs import feed as feed_rates

_FEED = f"Feed rate of the TCP along the path, for example 20mm/s; units: {', '.join(feed_rates.UNITS)}."
Feed = Annotated[str | None, typer.Option(metavar="SPEED", help=f"{_FEED} By default the job's.")]
PlayedFeed = Annotated[str | None, typer.Option("--feed", metavar="SPEED", help=f"Show the timed motion. {_FEED}")]
OneWay = Annotated[bool, typer.Option("--one-way", help="Stop at the last target; do not return to the start.")]
ProgramKeys = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the job's section program; may be repeated."),
]


def played_feed(feed: str | None, **others: object) -> float | None:
    """Parse the feed rate [m/s]; None if a plan is played by its targets.

    Args:
        feed: The feed rate as text, such as 20mm/s; None without one.
        **others: Values of options that need a feed rate, by their names.

    Raises:
        InputError: As `feed_of`, and for one of these options without a feed rate.
    """
    if feed is not None:
        return feed_rates.feed_of(feed)
    for name in (name for name, given in others.items() if given):
        raise InputError(f"--{name.replace('_', '-')} needs --feed: it belongs to a timed motion")
    return None
