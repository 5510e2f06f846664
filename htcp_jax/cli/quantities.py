"""Values of options with a unit, such as 5mm."""

import math
import re
from collections.abc import Mapping

from htcp_jax.errors import InputError

LENGTHS, ANGLES = {"mm": 1e-3, "m": 1.0, "um": 1e-6}, {"deg": math.pi / 180, "rad": 1.0}
_QUANTITY = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*([a-z]*)\s*", re.IGNORECASE)


def quantity(
    option: str,
    text: str,
    units: Mapping[str, float],
    example: str,
    valid: str = "a number of 0 or more with a unit",
    least: float = 0.0,
    most: float = math.inf,
) -> float:
    """Return the value of an option with a unit, in the SI unit.

    Args:
        option: Name of the option, for messages.
        text: Its value, such as "1mm".
        units: Valid units, each in the SI unit; "" for a number without one.
        example: A valid value, for messages.
        valid: Description of valid values, for messages.
        least: Smallest valid value [SI unit].
        most: Largest valid value [SI unit].

    Raises:
        InputError: If the text is not such a number with one of the units.
    """
    found = _QUANTITY.fullmatch(text)
    try:
        value = float(found[1]) * units[found[2].lower()] if found else math.nan
    except (KeyError, ValueError):
        value = math.nan
    if not (least <= value <= most and math.isfinite(value)):
        named = ", ".join(filter(None, units))
        raise InputError(f"{option} {text}: it must be {valid}, such as {example}; units: {named}")
    return value
