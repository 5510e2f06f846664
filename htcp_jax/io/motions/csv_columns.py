"""Columns of a table with a motion: joints, rates and times by their headings."""

import re
from collections.abc import Sequence
from typing import NamedTuple

from htcp_jax.io.motions.source import ANGLES, LENGTHS, Source, listed

POSITION, VELOCITY, ACCELERATION = "position", "velocity", "acceleration"
QUANTITIES = POSITION, VELOCITY, ACCELERATION
WORDS = {
    POSITION: "positions?|pos|values?|angles?|actual|target",
    VELOCITY: "velocity|velocities|vel|speed|dot|rate",
    ACCELERATION: "accelerations?|acc|accel|ddot",
}
UNIT = "rad|radians?|deg|degrees?|mm|m"
PER = {"": POSITION, "_s": VELOCITY, "_s2": ACCELERATION}
TAIL = re.compile(rf"[\s_./:-]*(?:({')|('.join(WORDS.values())}))?[\s_./:-]*(?:({UNIT})(_s2?)?)?[\s_]*", re.IGNORECASE)
HEADS = re.compile(rf"(?:({')|('.join(WORDS.values())})|q)[\s_./:-]+(.+)", re.IGNORECASE)
PLAIN_TIMES = {"time", "times", "t", "time_from_start"}
SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
OF_TCP = re.compile(r"tcp|tool|pose|orient|(^|_)(r[xyz]|roll|pitch|yaw|tilt)(_|$)|error|deviation")  # no joints
BARE = re.compile(r"_(rad|deg|m|mm)(_s2?)?$")  # the unit at a heading's end
ROW_KIND = "kind"
PLAN_TABLE = {"segment_status", "path_clear", "residual_m"}  # columns of a plan's trajectory.csv


class Column(NamedTuple):
    """A column with values of one joint."""

    index: int
    unit: str | None  # rad, deg, m or mm; None: the heading contains none


class Columns(NamedTuple):
    """The columns of a table."""

    joints: tuple[str, ...]  # names of the joints with positions, in the file's order
    of: dict[str, dict[str, Column]]  # quantity -> joint -> column
    time: Column | None  # the unit is one of SECONDS
    kind: int | None
    unused: tuple[str, ...]  # headings of the other columns


def columns_of(source: Source, header: Sequence[str], line: int) -> Columns:
    """Return the columns of a table by its header.

    Args:
        source: The file.
        header: The headings.
        line: The header's line, for messages.

    Raises:
        InputError: For repeated columns, for columns of joints that the robot lacks, for velocities or accelerations of
            some joints only, and if no joint is named, or one in `source.joints` is not.
    """
    known = [*source.robot.all_joint_names, *source.controller.locked]
    own: dict[str, str] = {}
    if source.joints:
        own = dict(zip(source.joints, source.robot.joint_names, strict=True))
        known = [*own, *(name for name in known if name not in source.robot.joint_names and name not in own)]
    exact = {heading.strip() for heading in header} & own.keys()
    found: dict[str, dict[str, Column]] = {quantity: {} for quantity in QUANTITIES}
    time, kind, unused = None, None, []
    if PLAN_TABLE <= {*header}:
        source.fail(line, "a plan's table with one row per target; its motion is in motion.csv")
    for k, heading in enumerate(header):
        if (named := _joint_of(heading, known)) is not None:
            joint, quantity, unit = named
            if joint in exact and quantity == POSITION:  # this column alone is meant
                if heading.strip() != joint:
                    unused.append(heading.strip())
                    continue
                unit = _unit_at_end(heading)
            joint = own.get(joint, joint)
            if joint in found[quantity]:
                first = header[found[quantity][joint].index]
                source.fail(line, f"the columns {first!r} and {heading!r} both hold the {quantity} of {joint}")
            found[quantity][joint] = Column(k, unit)
        elif (unit := _time_unit(heading)) is not None:
            if time is not None:
                source.fail(line, f"the columns {header[time.index]!r} and {heading!r} both hold times")
            time = Column(k, unit)
        elif heading.strip() == ROW_KIND and kind is None:
            kind = k
        else:
            unused.append(heading.strip())
    columns = Columns(tuple(found[POSITION]), found, time, kind, tuple(unused))
    _check_columns(source, columns, header, line, known)
    return columns


def _check_columns(source: Source, columns: Columns, header: Sequence[str], line: int, known: Sequence[str]) -> None:
    """Check that the columns are those of the robot's joints.

    Raises:
        InputError: See `columns_of`.
    """
    given, robot_names, unused = source.joints, source.robot.joint_names, columns.unused
    missing = [name for name, joint in zip(given, robot_names, strict=False) if joint not in columns.joints]
    if missing:
        source.fail(line, f"no column is named {listed(missing)}, as --joints requires; columns: {listed(header)}")
    robot = f"joints of {source.robot.name}: {listed(robot_names)}; of the file: {listed(header)}"
    if not columns.joints:
        advice = source.advice(_numbered(unused, source.robot.dof))
        advice = advice or "; pass --joints with the names of the joints' columns"
        if source.unit is None and not any(map(_unit_at_end, unused)):
            advice += "; the headings state no unit: pass --unit deg, too, if the angles are in degrees"
        source.fail(line, f"no column is named as a joint of the robot; {robot}{advice}")
    if not given and (extra := [heading for heading in unused if _is_joint(heading, known)]):
        source.fail(line, f"the robot lacks {listed(extra)}; {robot}")
    for quantity, plural in ((VELOCITY, "velocities"), (ACCELERATION, "accelerations")):
        lacking = [name for name in robot_names if name not in columns.of[quantity]]
        if columns.of[quantity] and lacking:
            source.fail(line, f"{plural} of some joints only; those of {listed(lacking)} are missing")


def _joint_of(heading: str, known: Sequence[str]) -> tuple[str, str, str | None] | None:
    """Return the joint, the quantity and the unit that a heading names; None if it names no joint."""
    for name in known:
        for unit in ("rad", "m"):  # as this package writes them
            for per, quantity in PER.items():
                if heading == f"{name}_{unit}{per}":
                    return name, quantity, unit
    if heading in known:
        return heading, POSITION, None
    text = _without_brackets(heading.strip().strip("\"'"))
    for candidate in dict.fromkeys((text, text.rpartition("/")[2], *_joint_then_quantity(text))):
        for name in sorted(known, key=len, reverse=True):
            if candidate.lower().startswith(name.lower()) and (tail := TAIL.fullmatch(candidate[len(name) :])):
                return _read(name, tail.groups())
        if (head := HEADS.fullmatch(candidate)) is not None:
            *words, rest = head.groups()
            for name in sorted(known, key=len, reverse=True):
                if rest.lower().startswith(name.lower()) and (tail := TAIL.fullmatch(rest[len(name) :])):
                    _, quantity, unit = _read(name, tail.groups())
                    by_word = [each for each, word in zip(QUANTITIES, words, strict=True) if word]
                    return name, (by_word or [quantity])[0], unit
    return None


def _read(name: str, groups: tuple[str | None, ...]) -> tuple[str, str, str | None]:
    *words, unit, per = groups
    quantity = next((each for each, word in zip(QUANTITIES, words, strict=True) if word), PER[(per or "").lower()])
    short = None if unit is None else unit.lower()
    return name, quantity, short if short in (None, "m", "mm") else short[:3]


def _joint_then_quantity(text: str) -> tuple[str, ...]:
    """Return the last two parts of a path such as /joint_states/joint_1/position."""
    parts = text.split("/")
    return ("/".join(parts[-2:]),) if len(parts) > 1 else ()


def _without_brackets(text: str) -> str:
    """Return a heading with its unit after a _: "joint_1 [deg/s^2]" becomes "joint_1_deg_s2"."""
    if (found := re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", text)) is None:
        return text
    unit = found[2].replace("°", "deg").replace("²", "2").replace("^", "").replace("**", "").replace("/", "_")
    return f"{found[1]}_{unit.replace(' ', '')}" if unit else found[1]


def _unit_at_end(heading: str) -> str | None:
    """Return the unit at the end of a heading, as in "A1 [deg]"; None if there is none."""
    before, _, unit = _without_brackets(heading.strip().strip("\"'")).lower().rpartition("_")
    return unit if before and unit in {*ANGLES, *LENGTHS} else None


def _numbered(headings: Sequence[str], count: int) -> list[str]:
    """Return the names, without units, of `count` columns that may be those of the joints; [] if there are none.

    These are all headings, or the first ones that differ only by a number.
    """
    names = list(dict.fromkeys(BARE.sub("", _without_brackets(heading.strip("\"'"))) for heading in headings))
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    return next((each for each in (names, *groups.values()) if len(each) == count and all(each)), [])


def _time_unit(heading: str) -> str | None:
    """Return the unit of a column of times; None if the column holds none."""
    text = _without_brackets(heading.strip().strip("\"'")).lower()
    name, _, unit = text.rpartition("_")
    if text in PLAIN_TIMES:
        return "s"
    return unit if unit in SECONDS and name in {*PLAIN_TIMES, "timestamp", "elapsed"} else None


def _is_joint(heading: str, known: Sequence[str]) -> bool:
    """Return True if an unknown heading seems to be a joint's: numbered as the robot's joints are, or with an angle."""
    text = _without_brackets(heading.strip().strip("\"'")).lower()
    stems = {re.sub(r"\d+", "#", name.lower()) for name in known if re.search(r"\d", name)}
    bare = BARE.sub("", text)
    is_angle = re.search(r"_(rad|deg|degrees|radians)$", text) is not None and OF_TCP.search(text) is None
    return re.sub(r"\d+", "#", bare) in stems or is_angle


def scales(source: Source, columns: Columns, line: int) -> tuple[dict[tuple[str, str], float], list[str]]:
    """Return the factor of each column of joints to rad or m, by quantity and joint, and notes about units.

    Raises:
        InputError: For units that are unknown, contradict each other or `--unit`, or do not fit the joint.
    """
    slides = slides_of(source)
    stated = {
        column.unit
        for each in columns.of.values()
        for name, column in each.items()
        if column.unit is not None and not slides.get(name, False)
    }
    if source.unit is not None and (wrong := stated - {source.unit}):
        source.fail(line, f"the header states {listed(sorted(wrong))}; --unit {source.unit} contradicts that")
    factors, bare, bare_slides = {}, [], []
    for joint, column in columns.of[POSITION].items():
        if slides.get(joint, False):
            unit = column.unit or "m"
            bare_slides += [joint] * (column.unit is None)
        else:
            unit = column.unit or source.unit or "rad"
            bare += [joint] * (column.unit is None)
        for quantity in QUANTITIES:
            if joint in columns.of[quantity]:
                own = columns.of[quantity][joint].unit or unit
                factors[quantity, joint] = _factor(source, line, joint, own, slides.get(joint, False))
    notes = []
    if bare and source.unit is None:
        if stated:
            text = f"{listed(bare)} has no unit, other joints are in {listed(sorted(stated))}"
            source.fail(line, f"{text}; pass --unit, or name the unit in the header")
        notes.append("No unit is stated: angles are read in radians.")
    if bare_slides:
        notes.append(f"No unit is stated for {listed(bare_slides)}: metres.")
    return factors, notes


def slides_of(source: Source) -> dict[str, bool]:
    """Return True for the robot's joints that slide, by name."""
    robot = source.robot
    return dict(zip(robot.all_joint_names, robot.slides, strict=True)) | dict(
        zip(robot.joint_names, robot.sliding, strict=True)
    )


def _factor(source: Source, line: int, joint: str, unit: str, slides: bool) -> float:
    valid = LENGTHS if slides else ANGLES
    if unit not in valid:
        kind = "a sliding joint" if slides else "a hinge"
        source.fail(line, f"{joint} is {kind}, but its column is in {unit}; valid: {', '.join(valid)}")
    return valid[unit]
