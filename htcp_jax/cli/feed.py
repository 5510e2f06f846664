"""Options of the commands that time a plan or play a timed plan: --feed, --one-way, and --set for its limits."""

from typing import Annotated

import typer

from htcp_jax.errors import InputError
from htcp_jax.spec import feed as feed_rates

_FEED = f"Feed rate of the TCP along the path, for example 20mm/s; units: {', '.join(feed_rates.UNITS)}."
Feed = Annotated[str | None, typer.Option(metavar="SPEED", help=f"{_FEED} By default the seam's or the job's.")]
PlayedFeed = Annotated[str | None, typer.Option("--feed", metavar="SPEED", help=f"Play the timed motion. {_FEED}")]
OneWay = Annotated[bool, typer.Option("--one-way", help="Stop at the last target; do not return to home or the start.")]
ProgramKeys = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the job's section program; may be repeated."),
]


def played_feed(feed: str | None, **others: object) -> float | None:
    """Return the value of --feed [m/s]; None if --feed is not set and the plan is shown target by target.

    Args:
        feed: The feed rate as text, such as 20mm/s; None if the option is not set.
        **others: Values of the options that require --feed, by their names.

    Raises:
        InputError: If the feed rate is invalid, or if one of `others` is set without a feed rate.
    """
    if feed is not None:
        return feed_rates.feed_of(feed)
    for name in (name for name, given in others.items() if given):
        raise InputError(f"--{name.replace('_', '-')} applies to a timed motion only: pass --feed, too")
    return None
