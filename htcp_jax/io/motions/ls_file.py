"""FANUC's LS programs: J to joint positions, FINE or CNT, with its times.

J moves all axes along straight joint paths. FANUC publishes no distance for CNT, so a corner is read as all paths
inside it up to the middle of both legs. J3 is counted from the horizontal, see `program.j3_from`. Sources: see
`trajectory.formats.as_ls`.
"""

import re
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from htcp_jax.io.motions.source import DEG, Rows, Source, elapsed, listed

HALF = 0.5  # share of a leg in which a corner with CNT may be rounded
SECTION = re.compile(r"/(?:(PROG)\s+\w+(?:\s+\w+)?|(ATTR|APPL|MN|POS|END))")
ORDER = "PROG", "ATTR", "APPL", "MN", "POS", "END"
MOVE = re.compile(
    r"J\s*P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*(\d+(?:\.\d*)?|\.\d+)\s*(%|sec|msec)\s*(FINE|CNT\s*\d+|CNT\s*R\[\d+\])\s*(.*)"
)
OPTION = re.compile(r"(?:ACC\s*\d+|PTH)")
POSITION = re.compile(r"P\[\s*(\d+)\s*(?::[^\]]*)?\]\s*\{([^}]*)\}\s*;", re.DOTALL)
GROUP = re.compile(r"GP(\d)\s*:")
FRAME = re.compile(r"UF\s*:\s*(?:\d+|F)\s*,\s*UT\s*:\s*(?:\d+|F)\s*,?")
AXIS = re.compile(r"([JE]\d)\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*(deg|mm)")
# Beginnings of instructions that do not move the arm.
STILL = re.compile(
    r"(?:UFRAME_NUM|UTOOL_NUM|DO\[|RO\[|GO\[|AO\[|SO\[|UO\[|R\[|SR\[|AR\[|F\[|M\[|TIMER\[|PR\[|UFRAME\[|UTOOL\[|WAIT\b|"
    r"PAYLOAD\[|MESSAGE\[|OVERRIDE\s*=|LBL\[|UALM\[|PAUSE\b|COL DETECT\b|LOCK PREG\b|UNLOCK PREG\b|JOINT_MAX_SPEED\b|"
    r"LINEAR_MAX_SPEED\b|!|//|--eg:|END$)"
)
FLOW = re.compile(r"(?:IF|SELECT|JMP|CALL|RUN|FOR|ENDFOR|WHILE|ENDWHILE|ELSE|ENDIF|ABORT|SKIP|MONITOR)\b")
OTHER_MOVES = re.compile(r"[LCAS]\s*(?:P|PR)\[|J\s*PR\[")
FROM_HERE = "The motion to the first configuration is not in the file."
CORNERS = "CNT has no published distance: corners are read as all paths up to the middle of both legs."
COUNTED = {
    "upper_arm": "J3 is counted from the horizontal: J3 of the model is the file's J3 + J2 (program.j3_from).",
    "horizontal": "J3 is the model's (program.j3_from is horizontal).",
}


class _Position(NamedTuple):
    line: int
    text: str  # without its name


class _Move(NamedTuple):
    line: int
    position: int
    time_s: float | None
    exact: bool


def read_ls(source: Source) -> Rows:
    """Return the configurations of a program's J instructions.

    Raises:
        InputError: For other instructions that move, control flow, poses, registers as positions, and another number of
            axes than the job's groups have.
    """
    source.check_unit("LS", "deg")
    source.check_uncoupled("ls")
    robot_group, base, station = source.groups
    source.check_robot("group 1")
    instructions, positions = _sections(source)
    moves, still = _moves(source, instructions)
    columns = {f"1 J{k + 1}": j for k, j in enumerate(robot_group)} | {f"1 E{k + 1}": j for k, j in enumerate(base)}
    columns |= {f"2 J{k + 1}": j for k, j in enumerate(station)}
    known = {number: _values(source, position, columns) for number, position in positions.items()}
    values = np.zeros((len(moves), source.robot.dof))
    for n, move in enumerate(moves):
        if move.position not in known:
            source.fail(move.line, f"position P[{move.position}] is not in the program")
        values[n] = known[move.position]
    if source.controller.j3_from == "upper_arm":
        values[:, robot_group[2]] += values[:, robot_group[1]]
    shares = np.array([[0.0, 0.0] if move.exact else [HALF, HALF] for move in moves])
    is_rounded = not all(move.exact for move in moves)
    notes = ["LS: J moves the axes in proportion, linear between configurations.", FROM_HERE]
    notes += [COUNTED[source.controller.j3_from], *([CORNERS] if is_rounded else [])]
    if still:
        notes.append(f"Instructions that do not move are not read: {listed(sorted(still))}.")
    if unused := positions.keys() - {move.position for move in moves}:
        notes.append(f"Positions that no instruction uses: {listed([f'P[{k}]' for k in sorted(unused)])}.")
    return Rows(
        source.robot.joint_names,
        values,
        np.array([move.line for move in moves], int),
        scale=np.where(source.robot.sliding, 1e-3, DEG),
        time_s=elapsed([move.time_s for move in moves]) if moves else None,
        notes=tuple(notes),
        corner_share=shares if is_rounded else None,
    )


def _sections(source: Source) -> tuple[list[tuple[int, str]], dict[int, _Position]]:
    """Return the instructions with their lines, and the positions by number."""
    section, instructions, text, begin, positions_at = "", list[tuple[int, str]](), "", 0, 0
    pos: list[str] = []
    for number, full in enumerate(source.text.splitlines(), start=1):
        if (found := SECTION.fullmatch(full.strip())) is not None:
            after = found[1] or found[2]
            if (ORDER.index(section) if section else -1) >= ORDER.index(after):
                source.fail(
                    number, f"/{after} after /{section}; valid: {' '.join(f'/{each}' for each in ORDER)}, once each"
                )
            section = after
            positions_at = number if section == "POS" else positions_at
        elif section == "POS":
            pos.append(full)
        elif full.strip() and section in ("", "END"):
            source.fail(number, f"{full.strip()[:40]!r} is outside of /PROG and /END")
        elif section == "MN" and full.strip():
            begin = begin if text else number
            text = f"{text} {full.strip()}".strip()
            if text.endswith(";"):
                instructions.append((begin, re.sub(r"^\d*\s*:", "", text).removesuffix(";").strip()))
                text = ""
    if section != "END":
        source.fail(source.text.count("\n") + 1, "/END is missing")
    if text:
        source.fail(begin, f"{text[:40]!r} does not end with a semicolon")
    body = "\n".join(pos)
    positions, end = dict[int, _Position](), 0
    for found in POSITION.finditer(body):
        line = positions_at + 1 + body.count("\n", 0, found.start())
        if body[end : found.start()].strip():
            source.fail(line, f"{body[end : found.start()].strip()[:40]!r} is not a position")
        if int(found[1]) in positions:
            source.fail(line, f"position P[{found[1]}] is given twice")
        positions[int(found[1])], end = _Position(line, found[2]), found.end()
    if body[end:].strip():
        source.fail(positions_at + 1 + body.count("\n", 0, end), f"{body[end:].strip()[:40]!r} is not a position")
    return instructions, positions


def _moves(source: Source, instructions: list[tuple[int, str]]) -> tuple[list[_Move], set[str]]:
    moves, still = [], set()
    for line, text in instructions:
        if (found := MOVE.fullmatch(text)) is not None:
            number, speed, unit, end, options = found.groups()
            if options and not all(OPTION.fullmatch(each) for each in re.split(r"\s+(?=[A-Z])", options.strip())):
                source.fail(line, f"{options[:40]!r} after {end} cannot be read; valid: ACC and a number, PTH")
            scale = {"%": None, "sec": 1.0, "msec": 1e-3}[unit]
            moves.append(_Move(line, int(number), None if scale is None else scale * float(speed), end == "FINE"))
        elif not text or STILL.match(text):
            still |= {re.split(r"[\[=\s]", text)[0]} if text and not text.startswith(("!", "//", "--")) else set()
        elif FLOW.match(text):
            source.fail(line, f"{text.split()[0][:20]} controls the flow, which cannot be read")
        elif OTHER_MOVES.match(text) or text.startswith("J "):
            source.fail(
                line, f"{text[:40]!r} moves in a way that cannot be read; only J P[n] with a speed, FINE or CNT can"
            )
        else:
            source.fail(line, f"{text[:40]!r} is not known, it may move; only J can be read")
    return moves, still


def _values(source: Source, position: _Position, columns: dict[str, int]) -> np.ndarray:
    """Return the joint values of a position in degrees or mm, in the order of the robot's joints."""
    row, given = np.zeros(source.robot.dof), set()
    parts = GROUP.split(position.text)
    if parts[0].strip():
        source.fail(position.line, f"{parts[0].strip()[:40]!r} is not a group of a position")
    if len({*parts[1::2]}) < len(parts[1::2]):
        source.fail(position.line, f"a group is given twice: {', '.join(f'GP{number}' for number in parts[1::2])}")
    for number, text in zip(parts[1::2], parts[2::2], strict=True):
        rest = FRAME.sub("", text, count=1)
        if "CONFIG" in rest or re.search(r"\bX\s*=", rest):
            source.fail(position.line, "a pose; only joint values have a configuration")
        axes = AXIS.findall(rest)
        names = [name.replace("J", "A") for name, _, _ in axes]  # J1 to J9 come before E1
        if any(a >= b for a, b in pairwise(names)):
            source.fail(position.line, f"the axes of group {number} are not in order, each once")
        for name, value, unit in axes:
            key = f"{number} {name}"
            if key not in columns and float(value):
                names = listed(list(columns))
                source.fail(
                    position.line, f"{name} of group {number} is an axis that the job's groups do not have: {names}"
                )
            if key not in columns:
                continue
            if (unit == "mm") != bool(source.robot.sliding[columns[key]]):
                source.fail(position.line, f"{name} of group {number} is in {unit}, which is not the joint's unit")
            row[columns[key]] = float(value)
            given.add(key)
        if left := AXIS.sub("", rest).replace(",", "").strip():
            source.fail(position.line, f"{left[:40]!r} cannot be read in a position; valid: J1= 0.0 deg")
    if lacking := [key for key in columns if key not in given]:
        source.fail(position.line, f"{lacking[0].split()[1]} of group {lacking[0].split()[0]} is missing")
    return row
