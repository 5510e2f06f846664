"""Conversion of feed rates with a unit, such as "20mm/s", to m/s."""

import re
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from htcp_jax.errors import InputError

UNITS = {"mm/s": 1e-3, "m/s": 1.0, "mm/min": 1e-3 / 60, "m/min": 1 / 60}  # each unit in m/s
SLOWEST_M_S, FASTEST_M_S = 1e-9, 100.0
_FEED = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(\S+)\s*", re.IGNORECASE)


def feed_of(text: str) -> float:
    """Return a feed rate, such as "20mm/s", in m/s.

    Raises:
        InputError: If the feed rate is not above 0, has no unit, or is out of range.
    """
    found = _FEED.fullmatch(text)
    unit = UNITS.get(found[2]) if found else None
    try:
        feed = float(found[1]) * unit if unit else 0.0
    except ValueError:
        feed = 0.0
    if not 0 < feed < np.inf:
        raise InputError(f"feed {text!r} is not a speed above 0 with a unit, such as 20mm/s; units: {', '.join(UNITS)}")
    if not SLOWEST_M_S <= feed <= FASTEST_M_S:
        raise InputError(f"feed {text!r} is {feed:g} m/s; valid: {SLOWEST_M_S:g} to {FASTEST_M_S:g} m/s")
    return feed


def _checked(feed: Any) -> Any:
    if feed is not None:
        feed_of(str(feed))
    return feed


Feed = Annotated[str, BeforeValidator(_checked)]  # feed rate in a file, with its unit
