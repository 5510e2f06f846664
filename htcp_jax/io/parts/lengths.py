"""Units of length that tables and jobs may state."""

from typing import get_args

from htcp_jax.spec import LengthUnit

PER_METRE: dict[str, float] = dict(zip(get_args(LengthUnit), (1.0, 1e3, 1e2, 1.0 / 0.0254), strict=True))
METRE = ("meter", "meters", "metre", "metres")
LENGTHS: dict[str, str] = {  # units by their names in a file, in lower case
    **{unit: unit for unit in PER_METRE},
    **{"inch": "in", "inches": "in"},
    **{f"{prefix}{name}": unit for prefix, unit in (("", "m"), ("milli", "mm"), ("centi", "cm")) for name in METRE},
}
OTHER_LENGTHS = frozenset((  # units of length that are not read
    "ft", "foot", "feet", "yd", "yard", "yards", "mil", "mils", "thou", "um", "µm", "μm", "micron", "microns", "dm",
    "km", "furlong", "furlongs", *(f"{prefix}{name}" for prefix in ("micro", "deci", "kilo") for name in METRE),
))  # fmt: skip
