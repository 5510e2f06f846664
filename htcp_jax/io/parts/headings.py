"""Names of a table's columns in its header, and the units that the header states."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from htcp_jax.errors import InputError
from htcp_jax.io.parts.lengths import LENGTHS, OTHER_LENGTHS

XYZ = ("x", "y", "z")
# Names of coordinates in common exports; x, y, z take precedence.
COORDINATES = (XYZ, *(tuple(form.format(axis) for axis in XYZ) for form in (
    "p{}", "pos{}", "pos_{}", "position_{}", "point_{}", "point{}", "{}_pos", "{}pos", "{}_position", "{}_coord",
    "{}_coordinate", "coord_{}", "coord{}", "tcp_{}", "target_{}", "translation_{}",
)), *(tuple(form.format(k) for k in range(3)) for form in (  # of ParaView; of Universal Robots' RTDE
    "points_{}", "coordinates_{}", "actual_tcp_pose_{}", "target_tcp_pose_{}",
)), ("east", "north", "up"), ("easting", "northing", "elevation"))  # fmt: skip
NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), ("normals_0", "normals_1", "normals_2"),
           ("i", "j", "k"))  # fmt: skip # i, j, k: of tool paths
TANGENTS = (("tx", "ty", "tz"), ("tangent_x", "tangent_y", "tangent_z"))
QUATERNIONS = tuple(
    tuple(f"{name}{part}" for part in "wxyz")
    for name in ("q", "q_", "quat_", "quaternion_", "orientation_", "rotation_")
)
PLATES = (("n1x", "n1y", "n1z", "n2x", "n2y", "n2z"),)  # normals of both plates of a fillet
DIRECTIONS = (*NORMALS, *PLATES, *TANGENTS, *QUATERNIONS)
COORDINATE_NAMES = frozenset(name for family in COORDINATES for name in family)
DIRECTION_NAMES = frozenset(name for family in DIRECTIONS for name in family)
ANGLES = {"deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", "rad": "rad", "radian": "rad", "radians": "rad"}
NAMES = {**LENGTHS, **ANGLES}  # units by their names
OTHER_UNITS = ("ft", "um", "µm", "km", "s", "sec", "seconds", "si", "ms", "us", "ns", "min", "m/s", "mm/s", "mm/min",
               "m/min", "cm/min", "rad/s", "deg/s", "%", "a", "v", "w", "n", "nm", "hz", "1/min", "rpm", "k", "°c", "-",
               "1", "")  # fmt: skip
BRACKETS = re.compile(r"\s*(?:\[([^\]]*)\]|\(([^)]*)\))")  # x [m], y (mm)
SEPARATORS = re.compile(r"[\s,;]+")
SUFFIX = re.compile(rf"(.+?)(?:_in)?_({'|'.join((*NAMES, *OTHER_LENGTHS))})")  # x_mm, X in mm, x/mm, a_deg
FIELD = re.compile(r".*_((?:position|orientation|translation|rotation)_[wxyz])")  # /arm/pose/position/x, of ROS
UNIT_KEY = re.compile(r"(?:units?|einheit(?:en)?)[\"']?\s*[:=](.*)", re.IGNORECASE)  # "# unit: mm"
UNIT_WORDS = re.compile(r"[\s,;()\[\]{}\"']+")
NUMBER = re.compile(r"(?!1$)[\d.]+")
LENGTH_NAMES = "|".join((*LENGTHS, *OTHER_LENGTHS))
SUBJECTS = "units?|einheit(?:en)?|lengths|coordinates|positions|points|dimensions|xyz"
STATED_LENGTHS = tuple(re.compile(rf"{form}(?![\w/²³^-])", re.IGNORECASE) for form in (
    rf"\b(?:{SUBJECTS}|distances|values|[xyz])\b[^,;:]*?\bin\s+[\[(]?({LENGTH_NAMES})",  # "# all lengths in mm"
    rf"\b(?:{SUBJECTS})\s*:?\s*[\[(]({LENGTH_NAMES})[\])]",  # "# coordinates [mm]"
    rf"\b(?:{SUBJECTS})\s*:?\s+((?!in\b)(?:{LENGTH_NAMES}))\W*$",  # "# units mm"
    rf"^\W*({LENGTH_NAMES})\W*$",
))  # fmt: skip
QUOTED = re.compile(r'"[^"]*"')
HIDDEN = {ord(letter): chr(0xE000 + k) for k, letter in enumerate(",; \t")}  # of a text between quotes
SHOWN = {ord(hidden): chr(letter) for letter, hidden in HIDDEN.items()}
MOST_NAMES = 200  # maximum number of a header's characters in a message


class Heading(NamedTuple):
    """A column's name in the header."""

    text: str  # as in the file
    name: str  # in lower case, without the unit
    unit: str | None  # in lower case; None if the text contains no unit


def headings(line: str, width: int | None = None) -> list[Heading]:
    """Split a header line into the names of its columns.

    Args:
        line: The line.
        width: Number of columns in the rows; None: unknown. It decides if the names between tabs contain blanks.
    """
    marked = _marked(line.strip())
    found = [heading(cell) for cell in cells_of(marked)]
    if is_blank_separated(marked):
        found = [head for head in found if head.name]
        between_tabs = [cell for cell in marked.split("\t") if cell.strip()]
        if len(found) != width == len(between_tabs):
            return [heading(cell) for cell in between_tabs]
    return found


def heading(cell: str) -> Heading:
    """Read one name of a header, with its unit."""
    text = _marked(cell).strip(" \t\"'")
    if text.startswith("[") and text.endswith("]"):  # [x], (x)
        text = text[1:-1]
    name, _, inside = text.partition("[")
    unit = inside.rstrip("]\"' ").lower()
    name = re.sub(r"[.:/\s]+", "_", name.strip(" \t\"'").lower()).strip("_")
    if not unit and (found := SUFFIX.fullmatch(name)):
        name, unit = found.groups()
    if found := FIELD.fullmatch(name):
        name = found[1]
    return Heading(text.replace("[", " [") if inside else text, name, NAMES.get(unit, unit) or None)


def _marked(line: str) -> str:
    """Remove the blanks and separators between names and texts in brackets, as in "x [m]"."""
    return BRACKETS.sub(lambda found: f"[{SEPARATORS.sub('_', found[1] or found[2] or '')}]", line)


def cells_of(line: str) -> list[str]:
    """Split a line into cells at semicolons, commas or blanks; a text between quotes is not split."""
    if '"' in line:
        hidden = QUOTED.sub(lambda found: found[0].translate(HIDDEN), line)
        return [cell.translate(SHOWN) for cell in _split(hidden)]
    return _split(line)


def _split(line: str) -> list[str]:
    for separator in (";", ","):
        if separator in line:
            return line.split(separator)
    return line.split()


def is_blank_separated(line: str) -> bool:
    """Return True if blanks separate the cells of a line."""
    bare = QUOTED.sub("", line)
    return "," not in bare and ";" not in bare


def listed(header: Sequence[Heading]) -> str:
    """Return the names of a header as text."""
    text = ", ".join(head.text for head in header)
    return text if len(text) <= MOST_NAMES else f"{text[:MOST_NAMES]}..."


def coordinates_in(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the families of COORDINATES whose names are all in a header; only x, y, z if that family is found.

    Without any, tx, ty, tz next to a quaternion are coordinates, as in trajectories of the TUM format.
    """
    found = [family for family in COORDINATES if all(name in names for name in family)]
    if not found and all(name in names for name in TANGENTS[0]):
        return [TANGENTS[0]] if any(all(name in names for name in family) for family in QUATERNIONS) else []
    return found[:1] if XYZ in found else found


def header_of_comments(comments: Sequence[str], width: int, blank_separated: bool) -> list[Heading] | None:
    """Return the header in the comments before the first row; None if no comment names columns.

    The last comment that names all coordinates decides. Otherwise the last one that looks like a header does: it has a
    name for each column, separated as the rows are, and, if blanks separate them, at least two names are known; or it
    has at least three names, all of them known.

    Args:
        comments: The comments.
        width: Number of columns.
        blank_separated: True if blanks separate the cells of the rows.
    """
    candidates = []
    for comment in reversed(comments):
        header = headings(comment, width)
        known = sum(head.name in COORDINATE_NAMES | DIRECTION_NAMES for head in header)
        fits, is_known = len(header) == width, known == len(header) >= len(XYZ)
        if coordinates_in([head.name for head in header]) and (fits or (len(header) == width - 1 and is_known)):
            return header
        alike = fits and is_blank_separated(comment) == blank_separated and units_in(cells_of(comment)) is None
        if is_known or (alike and (known >= 2 or not blank_separated)):
            candidates.append(header)
    return candidates[0] if candidates else None


def units_in(cells: Sequence[str]) -> list[str] | None:
    """Return the units in a row of units, such as mm,mm,mm or [s] [m] [m] [m]; None if it is no such row."""
    units = [cell.strip("[](){}<>\"' \t").lower() for cell in cells]
    if NAMES.keys().isdisjoint(units):
        return None
    return [NAMES.get(unit, unit) for unit in units] if set(units) <= {*NAMES, *OTHER_UNITS} else None


def with_units(header: Sequence[Heading], units: Sequence[str], source: str) -> list[Heading]:
    """Return the header with the units of the row below it.

    Raises:
        InputError: For a unit that contradicts the header's.
    """
    for head, unit in zip(header, units, strict=True):
        if head.unit and unit and head.unit != unit:
            raise InputError(f"{source}: the unit of {head.text} is {unit} in the row below the header")
    return [head._replace(unit=head.unit or unit or None) for head, unit in zip(header, units, strict=True)]


def stated_unit(text: str) -> str | None:
    """Return the unit of length that a comment states, as in "units: mm" or "all lengths in mm"; None if none.

    A unit that is not known, or several, are returned as in the text, so that they can be refused.
    """
    key = UNIT_KEY.search(text)
    if key is None:
        found = next(filter(None, (form.search(text) for form in STATED_LENGTHS)), None)
        return None if found is None else LENGTHS.get(found[1].lower(), found[1].lower())
    words = [word for cell in UNIT_WORDS.split(key[1].lower()) if (word := cell.strip(".:*"))]
    lengths = {LENGTHS.get(word, word) for k, word in enumerate(words)
               if word in LENGTHS.keys() | OTHER_LENGTHS and (k == 0 or word != "in")}  # fmt: skip
    if set(words) <= {*ANGLES, *OTHER_UNITS} - OTHER_LENGTHS:
        return None
    is_scaled = NUMBER.fullmatch(words[0]) is not None  # "0.001 m"
    return lengths.pop() if len(lengths) == 1 and not is_scaled else key[1].strip()[:30]
