"""Values of options with a unit, such as 5mm, and lists of them."""

import math
import re
from collections.abc import Mapping

import numpy as np

from htcp_jax.errors import InputError

LENGTHS, ANGLES = {"mm": 1e-3, "m": 1.0, "um": 1e-6}, {"deg": math.pi / 180, "rad": 1.0}
_LIST = re.compile(r"(.*[0-9.])\s*([a-z]*)\s*", re.IGNORECASE)
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


def vector(option: str, text: str, units: Mapping[str, float], unit: str, count: int, example: str) -> np.ndarray:
    """Return the numbers of an option such as 106.1,0,366.1mm, in the SI unit.

    Args:
        option: Name of the option, for messages.
        text: Its value: numbers with commas, and at most one unit behind them.
        units: Valid units, each in the SI unit.
        unit: The unit of numbers without one.
        count: How many numbers there must be.
        example: A valid value, for messages.

    Raises:
        InputError: For other numbers, or another unit.
    """
    found = _LIST.fullmatch(text)
    try:
        numbers = np.array([float(each) for each in found[1].split(",")]) * units[found[2].lower() or unit]
    except (KeyError, ValueError, TypeError):
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        named = f"; units: {', '.join(filter(None, units))}" if len(units) > 1 else ""
        raise InputError(f"{option} {text}: it must be {count} numbers with commas, such as {example}{named}")
    return numbers
