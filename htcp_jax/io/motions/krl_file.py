"""KUKA's KRL: PTP to axis values, exact or with C_PTP.

PTP moves all axes along straight joint paths. With C_PTP the controller leaves this path at most `$APO.CPTP` percent of
half a leg before the corner, and is back on it at the middle of the next leg at the latest. Sources: see
`trajectory.formats.as_krl`.
"""

import re
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.motions.source import DEG, ROBOT_AXES, Rows, Source, listed

HALF = 0.5  # largest share of a leg in which a corner is rounded
ROUTINE = re.compile(r"(?:GLOBAL\s+)?DEF(?:FCT\s+\w+)?\s+(\w+)\s*\([^()]*\)", re.IGNORECASE)
DECLARED = re.compile(
    r"(?:DECL\s+)?(?:GLOBAL\s+)?(?:CONST\s+)?(\w+)\s+(\w+)\s*(\[[^\]]*\])?\s*(?:=\s*(.*))?", re.IGNORECASE
)
ASSIGNED = re.compile(r"(\$?\w+)\s*((?:\.\w+|\[[^\]]*\])*)\s*=(?!=)\s*(.*)")
MOVE = re.compile(r"PTP\b\s*(\{[^}]*\}|\$?\w+)\s*(C_PTP)?(?:\s+C_(?:DIS|ORI|VEL))?", re.IGNORECASE)
LITERAL = re.compile(r"\{\s*(?:(\w+)\s*:)?\s*(.*?)\s*\}")
ELEMENT = re.compile(r"([A-Za-z]\w*)\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
APPROXIMATIONS = ".cptp", ".cdis", ".cori", ".cvel"
TYPES = {"int", "real", "bool", "char", "axis", "e6axis", "pos", "e6pos", "frame", "fdat", "pdat", "ldat", "load"}
CALLS = {"bas", "pulse", "ir_stopm"}  # standard routines that do not move with these arguments
MOVES = {"lin", "circ", "ptp_rel", "lin_rel", "circ_rel", "sptp", "slin", "scirc", "sptp_rel", "slin_rel", "scirc_rel",
         "spline", "ptp_spline", "spl", "spl_rel", "asyptp", "asycont"}  # fmt: skip
STILL_BAS = re.compile(r"#(?:INITMOV|VEL_PTP|ACC_PTP|VEL_CP|ACC_CP|TOOL|BASE|FRAMES|PTP_DAT|CP_DAT|PTP_PARAMS)\b", re.I)
STILL = {"wait", "anout", "anin", "interrupt", "ext", "extfct", "import", "signal", "struc", "enum", "halt", "continue"}
FLOW = {"if", "else", "endif", "loop", "endloop", "while", "endwhile", "repeat", "until", "switch", "case", "default",
        "endswitch", "goto", "exit", "return", "trigger", "brake"}  # fmt: skip
FROM_HERE = "The motion to the first configuration is not in the file."
WHOLE_CORNERS = "$APO.CPTP is not in the file before the first C_PTP; corners are read as if it were 100."


class _Statement(NamedTuple):
    line: int
    text: str
    word: str  # in lower case


class _Move(NamedTuple):
    line: int
    values: dict[str, float]  # by axis: A1 to A6, E1 to E6; degrees or mm
    corner: float | None  # $APO.CPTP [%]; None: exact


def read_krl(source: Source) -> Rows:
    """Return the configurations of a procedure's PTP instructions with axis values.

    Raises:
        InputError: For other instructions that move, control flow, poses, targets that cannot be read, and another
            number of axes than the job's groups have.
    """
    source.check_unit("KRL", "deg")
    source.check_uncoupled("krl")
    robot_group, base, station = source.groups
    external = (*base, *station)
    source.check_robot("E6AXIS")
    moves, notes = _moves(source)
    names = [*(f"A{k + 1}" for k in range(ROBOT_AXES)), *(f"E{k + 1}" for k in range(len(external)))]
    values = np.zeros((len(moves), source.robot.dof))
    for n, move in enumerate(moves):
        if lacking := [name for name in names if name not in move.values]:
            source.fail(move.line, f"{lacking[0]} is missing; the job's groups have {listed(names)}")
        if extra := [name for name, value in move.values.items() if name not in names and value]:
            source.fail(move.line, f"{extra[0]} is an axis that the job's groups do not have: {listed(names)}")
        values[n, [*robot_group, *external]] = [move.values[name] for name in names]
    shares = np.array([[0.0, 0.0] if m.corner is None else [HALF * m.corner / 100, HALF] for m in moves])
    return Rows(
        source.robot.joint_names,
        values,
        np.array([move.line for move in moves], int),
        scale=np.where(source.robot.sliding, 1e-3, DEG),
        notes=("KRL: PTP moves the axes in proportion, linear between configurations.", FROM_HERE, *notes),
        corner_share=shares if any(move.corner is not None for move in moves) else None,
    )


def _moves(source: Source) -> tuple[list[_Move], list[str]]:
    statements, known = _main(source)
    apo: float | None = None
    still: set[str] = set()
    moves, assumed = [], False
    for each in statements:
        if each.word == "ptp":
            found = MOVE.fullmatch(each.text)
            if found is None:
                source.fail(each.line, f"{each.text[:60]!r} cannot be read; valid: PTP, axis values, and C_PTP")
            assumed |= found[2] is not None and apo is None
            corner = None if found[2] is None else 100.0 if apo is None else apo
            moves.append(_Move(each.line, _target(source, each.line, found[1], known), corner))
        elif (assigned := ASSIGNED.fullmatch(each.text)) is not None:
            name, part, value = assigned.groups()
            if name.lower() == "$apo":
                apo = _approximation(source, each, part, value, apo)
            elif name.lower() in known:
                known[name.lower()] = None if part else _literal(value)
            still.add(name)
        elif each.word == "bas":
            if not STILL_BAS.search(each.text):
                source.fail(each.line, f"{each.text[:60]!r} is not known, it may move; only PTP can be read")
            apo = None if "initmov" in each.text.lower() else apo
            still.add("BAS")
        elif each.word in STILL or each.word in CALLS:
            still.add(each.text.split("(")[0].split()[0])
        elif each.word in FLOW:
            source.fail(each.line, f"{each.word.upper()} controls the flow, which cannot be read")
        elif each.word in MOVES:
            source.fail(each.line, f"{each.word.upper()} moves in a way that cannot be read; only PTP can be")
        elif not re.fullmatch(r"\w+\s*:", each.text):  # a label; a jump to it is refused
            source.fail(each.line, f"{each.text.split()[0][:40]} is not known, it may move; only PTP can be read")
    notes = [f"Statements that do not move are not read: {listed(sorted(still))}."] if still else []
    return moves, [*([WHOLE_CORNERS] if assumed else []), *notes]


def _approximation(source: Source, each: _Statement, part: str, value: str, before: float | None) -> float | None:
    """Return $APO.CPTP after an assignment [%]; None if it is unknown."""
    if part and part.lower() not in APPROXIMATIONS:
        source.fail(each.line, f"$APO{part} is not known; valid: {', '.join(APPROXIMATIONS).upper()}")
    if part.lower() != ".cptp":
        cptp = None if part else {key.upper(): number for key, number in (_literal(value) or {}).items()}.get("CPTP")
        return before if part else cptp
    if not NUMBER.fullmatch(value) or not 0 <= float(value) <= 100:
        source.fail(each.line, f"$APO.CPTP={value[:40]} cannot be read; valid: a number from 0 to 100")
    return float(value)


def _target(source: Source, line: int, text: str, known: dict[str, dict[str, float] | None]) -> dict[str, float]:
    value = _literal(text) if text.startswith("{") else known.get(text.lower())
    if value is None:
        what = f"the target {text[:60]} cannot be read"
        source.fail(line, f"{what}; valid: axis values {{A1 0, A2 -90, ...}}, or a variable of the file with them")
    value = {key.upper(): number for key, number in value.items()}
    if "A1" not in value:
        source.fail(line, f"the target {text[:60]} is a pose; only axis values A1 to A6 have a configuration")
    return value


def _literal(text: str) -> dict[str, float] | None:
    """Return the numbers of a structure by name; None if it is not one, or has elements that are not numbers."""
    found = LITERAL.fullmatch(text.strip())
    if found is None or (found[1] is not None and found[1].lower() not in TYPES):
        return None
    elements = [ELEMENT.fullmatch(each.strip()) for each in found[2].split(",")]
    if not all(elements) or len({each[1].upper() for each in elements if each}) < len(elements):
        return None
    return {each[1]: float(each[2]) for each in elements if each}


def _main(source: Source) -> tuple[list[_Statement], dict[str, dict[str, float] | None]]:
    """Return the statements of the file's first procedure, and the structures that it declares, by name.

    Raises:
        InputError: If there is no procedure, if its end is missing, or if another routine moves.
    """
    routine = ""
    bodies: dict[str, list[_Statement]] = {}
    known: dict[str, dict[str, float] | None] = {}
    for each in _without_loops(source, _statements(source)):
        if (begun := ROUTINE.fullmatch(each.text)) is not None:
            if routine:
                source.fail(each.line, f"a routine in the routine {routine}; END is missing")
            routine = begun[1]
            bodies.setdefault(routine.lower(), [])
        elif each.word in ("end", "endfct"):
            if not routine or each.text.lower() != each.word:
                source.fail(each.line, f"{each.text[:40]!r} does not end a routine")
            routine = ""
        elif each.word in ("defdat", "enddat"):
            continue
        elif _declares(each, known):
            continue
        elif not routine:
            source.fail(each.line, f"{each.text[:40]!r} is outside of a routine")
        else:
            bodies[routine.lower()].append(each)
    if not bodies:
        raise InputError(f"{source.file}: no DEF; a KRL program has DEF name() and END")
    if routine:
        source.fail(source.text.count("\n") + 1, f"the END of {routine} is missing")
    main, *others = bodies
    for name in others:
        for each in bodies[name]:
            if MOVE.match(each.text) or re.match(r"S?(?:LIN|CIRC|PTP|SPL)", each.text, re.IGNORECASE):
                source.fail(each.line, f"a move in {name}, which cannot be read; only those of {main} can be")
    return bodies[main], known


def _without_loops(source: Source, statements: list[_Statement]) -> list[_Statement]:
    """Return the statements without FOR and ENDFOR, between which only assignments are allowed."""
    found, loop = [], 0  # line of the FOR; 0 outside
    for each in statements:
        if each.word in ("for", "endfor"):
            loop = each.line if each.word == "for" else 0
            continue
        if loop and (ASSIGNED.fullmatch(each.text) is None or each.text.lower().startswith("$apo")):
            source.fail(loop, "FOR controls the flow, which cannot be read; only loops of assignments can be")
        found.append(each)
    return found


def _declares(each: _Statement, known: dict[str, dict[str, float] | None]) -> bool:
    """Return True if a statement declares a variable; one with axis values or $APO is added to `known`."""
    found = DECLARED.fullmatch(each.text)
    if found is None or (each.word != "decl" and found[1].lower() not in TYPES):
        return False
    _, name, dimension, value = found.groups()
    known[name.lower()] = None if value is None or dimension else _literal(value)
    return True


def _statements(source: Source) -> list[_Statement]:
    """Return the file's lines without comments and header lines."""
    found = []
    for number, full in enumerate(source.text.splitlines(), start=1):
        text = re.sub(r'"[^"]*"', '""', full).partition(";")[0].strip()
        if text and not text.startswith("&"):
            found.append(_Statement(number, text, re.split(r"\W", text.lower(), maxsplit=1)[0]))
    return found
