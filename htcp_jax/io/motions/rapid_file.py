"""ABB's RAPID: MoveAbsJ with joint targets in lists or constants, its times and zones.

MoveAbsJ moves all axes along straight joint paths. In a zone the controller leaves this path within a radius around the
TCP, at most half the distance to the next position. Source: ABB, Technical reference manual, RAPID Instructions,
Functions and Data types, 3HAC050917: MoveAbsJ, jointtarget, robjoint, extjoint, zonedata.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from htcp_jax.io.motions.rapid_order import executed
from htcp_jax.io.motions.rapid_statements import Statement, statements
from htcp_jax.io.motions.source import DEG, LARGEST, ROBOT_AXES, Rows, Source, corners, elapsed, listed

ZONES_MM = {"fine": 0.0, "z0": 0.3} | {f"z{k}": float(k) for k in (1, 5, 10, 15, 20, 30, 40, 50, 60, 80, 100, 150, 200)}
NOT_CONNECTED = 9e9  # an external axis with this value is not connected
ARGUMENTS = 4  # of MoveAbsJ, without switches
READ_TYPES = {"jointtarget", "robjoint", "extjoint", "zonedata", "num"}
DECLARATION = re.compile(
    r"(?:(?:LOCAL|TASK)\s+)?(CONST|PERS|VAR|ALIAS|RECORD)\s+(\w+)\s+(\w+)(\s*\{[^}]*\})?\s*(?::=\s*(.*))?",
    re.IGNORECASE | re.DOTALL,
)
ASSIGNMENT = re.compile(r"([A-Za-z_]\w*)((?:\{[^}]*\}|\.\w+)*)\s*:=\s*(.*)", re.DOTALL)
TOKEN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[\[\],]|[A-Za-z_]\w*)")
# Instructions that do not move the arm.
STILL = {
    "accset", "velset", "confj", "confl", "singarea", "setdo", "setgo", "setao", "set", "reset", "pulsedo", "invertdo",
    "waittime", "waitdi", "waitdo", "waituntil", "waitsynctask", "tpwrite", "tperase", "tpshow", "errwrite", "actunit",
    "deactunit", "gripload", "clkreset", "clkstart", "clkstop", "stop", "incr", "decr", "add", "clear", "idelete",
    "ienable", "idisable", "isignaldi", "isignaldo", "connect", "pathacclim", "worldacclim", "motionsup", "open",
    "close", "write", "socketsend", "socketcreate", "socketconnect", "socketclose", "waitrob", "return", "exit",
    "break", "speedrefresh", "corr_clear", "eoffsoff", "pdispoff", "uimsgbox",
}  # fmt: skip
ABOUT_ZONES = (
    "Zones are read as radii around the TCP; the manual says that they may differ somewhat in joint motions, and that "
    "the tool's orientation and external axes may leave the path earlier."
)
FROM_HERE = "The motion to the first configuration is not in the file."


class _Move(NamedTuple):
    line: int
    robot: list[float]  # degrees
    external: list[float]  # connected axes, degrees or mm
    time_s: float | None
    zone_mm: float


def read_rapid(source: Source) -> Rows:
    """Return the configurations of a module's MoveAbsJ instructions.

    Raises:
        InputError: For other instructions that move, control flow in the procedure that moves, more than one such
            procedure, joint targets that cannot be read, and another number of axes than the job's groups have.
    """
    source.check_unit("RAPID", "deg")
    robot_group, base, station = source.groups
    external = (*base, *station)
    source.check_robot("robjoint")
    moves, notes = _moves(source)
    values, corners_m = np.zeros((len(moves), source.robot.dof)), []
    for k, move in enumerate(moves):
        if len(move.external) != len(external):
            names = listed([source.robot.joint_names[j] for j in external]) or "none"
            source.fail(move.line, f"{len(move.external)} external axes are connected; the job's groups have {names}")
        values[k, [*robot_group, *external]] = [*move.robot, *move.external]
        corners_m.append(1e-3 * move.zone_mm)
    slides = np.array(source.robot.sliding)
    scale = np.where(slides, 1e-3, DEG)
    x, scale = _uncoupled(source, values, scale)
    if moves:
        corners_m[0] = corners_m[-1] = 0.0  # nothing is cut at the ends
    notes = [
        "RAPID: MoveAbsJ moves the axes in proportion, linear between configurations.",
        FROM_HERE,
        *([ABOUT_ZONES] if any(corners_m) else []),
        *notes,
    ]
    return Rows(
        source.robot.joint_names,
        x,
        np.array([move.line for move in moves], int),
        scale=scale,
        time_s=elapsed([move.time_s for move in moves]),
        corner_m=corners(corners_m),
        notes=tuple(notes),
    )


def _uncoupled(source: Source, values: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the joints of coupled axes, whose values are sums."""
    if not source.controller.coupled:
        return values, scale
    C = np.eye(values.shape[1])
    for axis, joint in source.controller.coupled:
        C[axis, joint] += 1.0
    return np.linalg.solve(C, (values * scale).T).T / scale, scale


def _moves(source: Source) -> tuple[list[_Move], list[str]]:
    every = list(statements(source))
    order = executed(source, every)
    known: dict[str, Any] = {}
    types: dict[str, str] = {}
    persistent: set[str] = set()
    still: set[str] = set()
    moves = []
    for statement in [each for each in every if not each.routine] + order:
        if (declared := DECLARATION.fullmatch(statement.text)) is not None:
            how, type_, name, dimensions, value = declared.groups()
            types[name.lower()] = type_.lower()
            if type_.lower() in READ_TYPES and value is not None and not dimensions:
                known[name.lower()] = _value(value, known)
                persistent |= {name} if how.upper() == "PERS" and type_.lower() == "jointtarget" else set()
        elif not statement.routine:
            continue
        elif statement.word == "moveabsj":
            moves.append(_move(source, statement, known))
        elif (assigned := ASSIGNMENT.fullmatch(statement.text)) is not None:
            name, part, value = assigned.groups()
            if types.get(name.lower()) in READ_TYPES:
                known[name.lower()] = None if part else _value(value, known)
            still.add(":=")
        elif statement.word in STILL:
            still.add(statement.text.split()[0])
        elif not re.fullmatch(r"\w+\s*:", statement.text):  # a label; a jump to it is refused
            text = f"{statement.text.split()[0][:40]} is not known, it may move"
            source.fail(statement.line, f"{text}; only MoveAbsJ can be read")
    notes = [f"Instructions that do not move are not read: {listed(sorted(still))}."] if still else []
    if persistent:
        notes.append(f"Persistent variables have the values of the file: {listed(sorted(persistent))}.")
    return moves, notes


def _move(source: Source, statement: Statement, known: dict[str, Any]) -> _Move:
    line, arguments = statement.line, _arguments(statement.text[len("MoveAbsJ") :])
    while arguments and re.fullmatch(r"\\conc", arguments[0].strip(), re.IGNORECASE):
        arguments = arguments[1:]
    if len(arguments) != ARGUMENTS:
        source.fail(
            line, f"MoveAbsJ with {len(arguments)} arguments; valid: a joint target, a speed, a zone and a tool"
        )
    target, *_ = _switches(arguments[0])
    value = _value(target, known)
    if not (isinstance(value, list) and len(value) == 2 and all(_are_numbers(part) for part in value)):
        text = f"the joint target {target[:60]} cannot be read"
        source.fail(line, f"{text}; valid: [[six axes],[six external axes]] or a constant with them")
    robot, external = value
    if max(external) > NOT_CONNECTED:
        source.fail(line, f"an external axis is {max(external):g}; an axis that is not connected is 9E9")
    _, *speed = _switches(arguments[1])
    zone, *of_zone = _switches(arguments[2])
    time_s = _switch(source, line, speed, "t", known)
    zone_mm = _switch(source, line, of_zone, "z", known)
    return _Move(
        line,
        robot,
        [v for v in external if v < NOT_CONNECTED],
        time_s,
        _zone(source, line, zone, known) if zone_mm is None else zone_mm,
    )


def _are_numbers(part: Any) -> bool:
    return isinstance(part, list) and len(part) == ROBOT_AXES and all(isinstance(v, float) for v in part)


def _zone(source: Source, line: int, text: str, known: dict[str, Any]) -> float:
    """Return the radius of a zone for the TCP [mm]."""
    value = _value(text, known)
    if isinstance(value, list) and len(value) == 7:
        fine, radius = value[0], value[1]
        if fine is True:
            return 0.0
        if fine is False and isinstance(radius, float) and 0 <= radius < LARGEST:
            return radius
    if text.lower() in known or text.lower() not in ZONES_MM:
        source.fail(line, f"the zone {text[:40]} cannot be read; valid: {', '.join(ZONES_MM)}, or a zonedata constant")
    return ZONES_MM[text.lower()]


def _switch(source: Source, line: int, switches: list[str], name: str, known: dict[str, Any]) -> float | None:
    for switch in switches:
        key, _, text = switch.partition(":=")
        if key.strip().lower() == name:
            value = _value(text, known)
            if not isinstance(value, float) or not 0 <= value < LARGEST:
                source.fail(line, f"\\{switch[:40]} cannot be read; a number is needed")
            return value
    return None


def _switches(argument: str) -> list[str]:
    """Split an argument at its optional ones: value, then NoEOffs, T:=1, ..."""
    return [each.strip() for each in argument.split("\\")]


def _arguments(text: str) -> list[str]:
    """Split at commas outside of brackets."""
    found, depth = [""], 0
    for letter in text:
        depth += (letter in "[({") - (letter in "])}")
        if letter == "," and not depth:
            found.append("")
        else:
            found[-1] += letter
    return [each.strip() for each in found]


def _value(text: str, known: dict[str, Any]) -> Any:
    """Return the value of a literal: a number, True, False, or lists of them, with names of constants; else None."""
    tokens, at, text = [], 0, text.strip()
    while at < len(text):
        if (found := TOKEN.match(text, at)) is None:
            return None
        tokens.append(found[1])
        at = found.end()
        if not text[at:].strip():
            break
    tokens.reverse()

    def parse() -> Any:
        token = tokens.pop()
        if token == "[":
            items = []
            while True:
                items.append(parse())
                if (mark := tokens.pop()) == "]":
                    return items
                if mark != ",":
                    raise ValueError
        if token[0].isalpha() or token[0] == "_":
            named = {"true": True, "false": False}.get(token.lower(), known.get(token.lower()))
            if named is None:
                raise ValueError
            return named
        return float(token)

    try:
        value = parse()
    except (ValueError, IndexError):
        return None
    return None if tokens else value
