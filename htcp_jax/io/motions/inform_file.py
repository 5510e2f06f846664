"""Yaskawa's INFORM jobs: pulses of the joints with MOVJ, or poses of the TCP.

MOVJ moves all joints in proportion. A corner's radius (position level PL, or the controller's own) is not in a job. In
jobs with poses the controller selects the configurations, so only the poses are read.

Sources: see `trajectory.formats.as_jbi`.
"""

import re
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.io.motions.source import Rows, Source, listed

POSITION = re.compile(r"([A-Z]{1,2})(\d{1,5})\s*=(.*)")
VARIABLE = re.compile(r"\b(C|BC|EC|P|BP|EX)(\d{1,5})")
NUMBER = re.compile(r"\s*[-+]?(?:\d+\.?\d*|\.\d+)\s*")
HEADER = "NPOS", "USER", "TOOL", "POSTYPE", "PULSE", "RECTAN", "RCONF"  # among positions
MOVE = re.compile(
    r"\+?MOV[JLCS](?: +(?:C|BC|EC|P|BP|EX)\d{1,5})+(?: +(?:V|VJ|VR|VE|PL|CR|ACC|DEC)=[\w.#()]+| +NWAIT)* *"
)
KINDS = "C", "BC", "EC"  # position variables of robot, base and station, which belong to the job
MOVES = "MOVJ", "MOVL", "MOVC", "MOVS"
# Instructions that do not move the arm.
STILL = {
    "NOP", "END", "TIMER", "DOUT", "PULSE", "WAIT", "SET", "SETE", "CLEAR", "INC", "DEC", "AOUT", "ARATION", "ARATIOF",
    "ARCON", "ARCOF", "ARCSET", "AWELD", "VWELD", "ARCCTS", "ARCCTE", "MSG", "SPEED", "PAUSE", "DIN", "GETE", "ADD",
    "SUB", "MUL", "DIV", "CNVRT", "GETS", "ABORT", "HAND", "SPYON", "SPYOF", "TSYNC", "DIALOG", "CLOSE", "OPEN",
    "ADVINIT", "ADVSTOP", "COMM", "VELOON", "VELOOF",
}  # fmt: skip
CONTROL = {"JUMP", "CALL", "IF", "IFTHEN", "ELSE", "ELSEIF", "ELSEIFTHEN", "ENDIF", "WHILE", "ENDWHILE", "FOR", "NEXT",
           "RET", "SWITCH", "CASE", "DEFAULT", "ENDSWITCH", "PSTART", "PWAIT", "CWAIT", "UNTIL"}  # fmt: skip
POSE_VALUES = 6
FROM_HERE = "The motion to the first position is not in the file."


class _Position(NamedTuple):
    line: int
    pulses: bool
    values: list[float]


class _Job(NamedTuple):
    positions: dict[tuple[str, int], _Position]  # by kind and number
    instructions: list[tuple[int, str]]
    about: dict[str, str]  # USER, TOOL, POSTYPE


def read_jbi_pulses(source: Source) -> Rows:
    """Return the configurations of a job's MOVJ instructions, by the encoder scale and the groups of the controller.

    Raises:
        InputError: If the encoder scale is missing, for a position with another number of values than its group has
            joints, and for instructions that move in another way than MOVJ or that control the flow.
    """
    source.check_unit("a job with pulses", "pulses")
    source.check_uncoupled("jbi-pulses")
    job, robot = _job(source), source.robot
    if (scale := source.controller.pulses) is None:
        raise InputError(
            f"{source.file}: the encoder scale is missing; set program.pulses: {{per_rad: [...], source: ...}}"
        )
    columns = dict(zip(KINDS, source.groups, strict=True))
    values, lines, rounded = [], [], False
    for line, instruction, is_last in _moves(source, job, ("MOVJ",)):
        used = [(kind, int(number)) for kind, number in VARIABLE.findall(instruction)]
        kinds = [kind for kind, _ in used]
        _check_complete(source, line, instruction)
        if wrong := [kind for kind in kinds if kind not in KINDS]:
            source.fail(line, f"position {wrong[0]} belongs to the controller; only C, BC and EC of the job are read")
        if sorted(kinds) != sorted(kind for kind in KINDS if columns[kind]):
            needed = " ".join(kind for kind in KINDS if columns[kind])
            source.fail(line, f"it moves {' '.join(kinds) or 'no position'}; program.groups needs {needed}")
        row = np.full(robot.dof, np.nan)
        for key in used:
            position = _position(source, job, line, key)
            if not position.pulses:
                source.fail(position.line, "a pose; only pulses have a configuration")
            own = list(columns[key[0]])
            if len(position.values) < len(own) or any(position.values[len(own) :]):
                group = listed([robot.joint_names[k] for k in own])
                source.fail(position.line, f"{len(position.values)} values for {len(own)} joints: {group}")
            row[own] = position.values[: len(own)]
        rounded |= not re.search(r"\bPL=0\b", instruction) and not is_last
        values.append(row)
        lines.append(line)
    per_unit, zero = np.asarray(scale.per_unit, float), np.asarray(scale.zero, float)
    notes = [
        "INFORM: MOVJ moves the joints in proportion, linear between configurations.",
        FROM_HERE,
        *_notes(job),
    ]
    if rounded:
        notes.append(
            "Corners without PL=0 are rounded by the controller; the file has no radius, so they are read as sharp."
        )
    pulses = np.array(values) if values else np.zeros((0, robot.dof))
    # to radians here, as pulses are counted from `zero`; the scale is only for the rounding
    return Rows(
        robot.joint_names, pulses + zero * per_unit, np.array(lines, int), scale=1 / per_unit, notes=tuple(notes)
    )


def read_jbi(source: Source) -> Rows:
    """Return the poses of a job's positions (n, 4, 4), in the order of its instructions.

    Raises:
        InputError: For positions that are not poses, instructions that move by increments, and control flow.
    """
    job = _job(source)
    poses, lines = [], []
    for line, instruction, _ in _moves(source, job, MOVES):
        used = [(kind, int(number)) for kind, number in VARIABLE.findall(instruction)]
        _check_complete(source, line, instruction)
        if [kind for kind, _ in used] != ["C"]:
            source.fail(line, "only one position C of the job can be read as a pose")
        position = _position(source, job, line, used[0])
        if position.pulses:
            source.fail(position.line, "pulses among poses; valid: a job with poses only, or with pulses only")
        if len(position.values) < POSE_VALUES or any(position.values[POSE_VALUES:]):
            source.fail(position.line, f"{len(position.values)} values; a pose has X, Y, Z, Rx, Ry, Rz")
        poses.append(_pose(np.array(position.values[:POSE_VALUES])))
        lines.append(line)
    notes = [
        "jbi: poses of the TCP; the configurations and the motion between the poses are the controller's own.",
        f"Frame: {job.about.get('POSTYPE', 'unknown')} {job.about.get('USER', '')}".rstrip()
        + f", tool {job.about.get('TOOL', 'unknown')}; RCONF is not used.",
        *_notes(job),
    ]
    empty = np.zeros((0, source.robot.dof))
    found = np.array(poses) if poses else np.zeros((0, 4, 4))
    return Rows(source.robot.joint_names, empty, np.array(lines, int), notes=tuple(notes), poses=found)


def _pose(values: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose [m] of X, Y, Z [mm] and angles about fixed axes x, then y, then z [deg]."""
    T = np.eye(4)
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(values[3:])), np.sin(np.radians(values[3:]))
    T[:3, :3] = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    T[:3, 3] = 1e-3 * values[:3]
    return T


def _job(source: Source) -> _Job:
    """Split a job into its positions and instructions."""
    lines = [line.rstrip() for line in source.text.splitlines()]
    at = next((k for k, line in enumerate(lines) if line.strip() == "//INST"), None)
    if at is None:
        raise InputError(f"{source.file}: no //INST; an INFORM job has //POS and //INST")
    positions: dict[tuple[str, int], _Position] = {}
    about: dict[str, str] = {}
    pulses = False
    for k, line in enumerate(lines[:at], start=1):
        if (found := POSITION.fullmatch(line.strip())) is not None:
            kind, number, text = found.groups()
            cells = text.rstrip(", ").split(",")
            if not all(NUMBER.fullmatch(cell) for cell in cells):
                source.fail(k, f"position {kind}{number} holds a value that is not a number")
            if (kind, int(number)) in positions:
                source.fail(k, f"position {kind}{number} is given twice")
            positions[kind, int(number)] = _Position(k, pulses, [float(cell) for cell in cells])
        elif line.startswith("///"):
            key, _, value = line[3:].partition(" ")
            if key not in HEADER:
                source.fail(k, f"{line[:40]} is not known among positions; valid: {', '.join(HEADER)}")
            about[key] = value.strip()
            pulses = (pulses or key == "PULSE") and key not in ("RECTAN", "POSTYPE")
            if key in ("PULSE", "RECTAN") and about[key]:
                source.fail(k, f"{line[:60]} has a value")
            if key in ("PULSE", "RECTAN") and (about.get("POSTYPE") == "PULSE") != pulses:
                source.fail(k, f"{line} after ///POSTYPE {about.get('POSTYPE', '')}")
        elif line.strip() and line.split()[0] not in ("/JOB", "//NAME", "//POS"):
            source.fail(k, f"{line.strip()[:40]!r} is not a position")
    body = [(k, line.strip()) for k, line in enumerate(lines[at + 1 :], start=at + 2) if line.strip()]
    ends = [k for k, line in body if line == "END"]
    if not ends:
        source.fail(len(lines), "END is missing")
    if body[-1][0] > ends[0]:
        source.fail(ends[0], "END before the last line")
    job = _Job(positions, [(k, line) for k, line in body if not line.startswith("///")], about)
    _check_counts(source, job)
    return job


def _moves(source: Source, job: _Job, readable: tuple[str, ...]) -> list[tuple[int, str, bool]]:
    """Return the line and the text of each move, and True for the last one."""
    found = []
    for k, line in job.instructions:
        word = line.split(maxsplit=1)[0]
        if line.startswith("'") or word in STILL or word.startswith("//"):
            continue
        if word in readable:
            second = re.search(r"\+\s*([A-Z]+)", line)
            if second is not None and second[1] not in readable:
                source.fail(k, f"+{second[1]} moves in a way that cannot be read; only {' and '.join(readable)}")
            found.append((k, line))
        elif word.startswith("*"):
            continue  # a label alone does nothing, a jump to it is refused
        elif word in CONTROL:
            source.fail(k, f"{word} controls the flow, which cannot be read")
        elif re.match(r"[A-Z]*MOV|SMOV|REFP|SVON", word):
            source.fail(k, f"{word} moves in a way that cannot be read; only {' and '.join(readable)} can be read")
        else:
            source.fail(k, f"{word[:40]} is not known, it may move; only {' and '.join(readable)} can be read")
    return [(k, line, n == len(found) - 1) for n, (k, line) in enumerate(found)]


def _notes(job: _Job) -> list[str]:
    still = sorted({line.split(maxsplit=1)[0] for _, line in job.instructions} & STILL - {"NOP", "END"})
    notes = [f"Instructions that do not move are not read: {listed(still)}."] if still else []
    text = " ".join(line for _, line in job.instructions)
    used = {(kind, int(number)) for kind, number in VARIABLE.findall(text)}
    if unused := [f"{kind}{number:05d}" for kind, number in job.positions if (kind, number) not in used]:
        notes.append(f"Positions that no instruction uses: {listed(unused)}.")
    return notes


def _check_complete(source: Source, line: int, instruction: str) -> None:
    """Check that an instruction has no condition that ends its move early, and nothing that is not known.

    Raises:
        InputError: If it has one.
    """
    if (found := re.search(r"\b(UNTIL|SRCH)\b", instruction)) is not None:
        source.fail(line, f"{found[1]} ends a move early, which cannot be read")
    for part in re.split(r"\s+(?=\+)", instruction):
        keys = re.findall(r" ([A-Z]+)=", part)
        if MOVE.fullmatch(part) is None or len({*keys}) < len(keys):
            source.fail(line, f"{part[:60]!r} cannot be read; valid: a move, its positions, and then speeds and PL")


def _check_counts(source: Source, job: _Job) -> None:
    """Check the number of positions that the job states.

    Raises:
        InputError: If it has another number of them.
    """
    stated = job.about.get("NPOS")
    counts = [sum(kind == each for kind, _ in job.positions) for each in ("C", "BC", "EC", "P", "BP", "EX")]
    if stated is not None and [cell.strip() for cell in stated.split(",")] != [str(count) for count in counts]:
        raise InputError(f"{source.file}: ///NPOS {stated}, but the job has {','.join(map(str, counts))} positions")


def _position(source: Source, job: _Job, line: int, key: tuple[str, int]) -> _Position:
    if key not in job.positions:
        source.fail(line, f"position {key[0]}{key[1]:05d} is not in the job")
    return job.positions[key]
