"""Yaskawa's INFORM job format (JBI): positions first, then one instruction for each.

Positions are poses of the TCP in a numbered user frame with a numbered tool (RECTAN: mm, and degrees about fixed x,
then y, then z), or pulses of the joints. A job contains speeds instead of times: `MOVJ` has them in percent of the
joints' full speed, and `MOVL`, which moves the TCP along the path, in mm/s. Pulse jobs use only `MOVJ`, whose straight
joint paths are proven. Axes that carry the robot belong to group `BC`; axes of a positioner belong to group `EC`, which
moves together with the robot (`+MOVJ`).

Sources: Yaskawa's knowledge base, INFORM header fields; NX100 and DX100 manuals, job data format; FS100 manual, INFORM
structure. Groups follow jobs in public repositories, of robots on tracks with positioners. The order of the angles
follows Basler's and Balluff's pages on Yaskawa's pose format.
"""

import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import BEGIN, CHECK_AXES, ControllerData, JointGroups, UserFrame, header
from htcp_jax.trajectory.formats.controller_limits import INFORM_LINES
from htcp_jax.trajectory.formats.names import check_name, output_number
from htcp_jax.trajectory.formats.parts import ProgramFile, split
from htcp_jax.trajectory.timed_motion import TimedMotion

NAME = re.compile(r"[A-Z0-9_-]{1,32}")
WIDTH = 32  # maximum number of characters of a comment
POSITIONS = "C", "BC", "EC"  # position variables of the robot, of the axes that carry it, and of the positioner
MOST_LINES = INFORM_LINES.most  # of a job, NOP and END included
PART_REMARKS = 8  # lines for the remark at the beginning of a part
RECTAN_JOINTS, MOST_JOINTS = 6, 8
USER_FRAMES = range(1, 64)
UNUSED = (0,) * 18  # unused numbers of RCONF's 24
FIRST_PERCENT, LEAST_PERCENT, LEAST_MM_S = 1.0, 0.01, 0.1
MORE = (
    "No times: speeds stand for them, and corners are rounded as the controller does it.",
    "The arm first goes slowly from wherever it stands to the first configuration.",
)


class _Content(NamedTuple):
    """Content of a job, for any of its rows."""

    format: str
    names: list[str]  # lines before the positions
    attributes: list[str]
    about: list[str]
    used: tuple[int, ...]  # 1 for each group of POSITIONS that the job moves, else 0
    positions: Callable[[slice], list[str]]
    moves: Callable[[slice], Iterable[str]]


def jbi_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a relative job with RECTAN positions in the user frame.

    Raises:
        InputError: If the user frame or the joint speeds are missing, for an invalid frame number, for velocities above
            the joint speeds, for an arm without exactly six joints, for too many lines, and for an invalid job name.
    """
    return _one_job(_rectan_content(timed, controller), len(timed.x), controller)


def jbi_files(timed: TimedMotion, controller: ControllerData) -> list[ProgramFile]:
    """Return what `jbi_text` returns, or several jobs if one would have too many lines, as `jbi_pulses_files`."""
    return _jobs(_rectan_content(timed, controller), len(timed.x), controller)


def jbi_pulses_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a job with joint pulses, converted by the controller's encoder scale.

    Raises:
        InputError: If the encoder scale or the joint speeds are missing, for velocities above the joint speeds, for too
            many joints or lines, and for an invalid job name.
    """
    return _one_job(_pulse_content(timed, controller), len(timed.x), controller)


def jbi_pulses_files(timed: TimedMotion, controller: ControllerData) -> list[ProgramFile]:
    """Return what `jbi_pulses_text` returns, or several jobs if one would have too many lines.

    The main job then calls the others in order, by `CALL JOB:NAME-1` and so on.
    """
    return _jobs(_pulse_content(timed, controller), len(timed.x), controller)


def _rectan_content(timed: TimedMotion, controller: ControllerData) -> _Content:
    if (frame := controller.user_frame) is None:
        raise InputError(
            "jbi: the user frame of RECTAN positions is missing; set program.user_frame: {number: 1 to 63}"
        )
    if len(timed.joint_names) != RECTAN_JOINTS:
        joints = f"an arm of {len(timed.joint_names)} joints"
        raise InputError(
            f"jbi: {joints}; RECTAN positions need {RECTAN_JOINTS} joints; jbi-pulses supports up to {MOST_JOINTS}"
        )
    if frame.number not in USER_FRAMES:
        raise InputError(f"jbi: user frame {frame.number}; valid: {USER_FRAMES[0]} to {USER_FRAMES[-1]}")
    names = [f"///USER {frame.number}", f"///TOOL {controller.tool}", "///POSTYPE USER", "///RECTAN"]
    attributes = ["///ATTR SC,RW,RJ", f"///FRAME USER {frame.number}"]
    percent, feed = _percents(timed, controller, "jbi").max(axis=1), _feed_mm_s(timed, frame)
    frames = f"Tool {controller.tool} and user frame {frame.number} must be set as they were planned."
    about = header(timed, *MORE, frames, outputs=bool(controller.rows_with_outputs))

    def positions(rows: slice) -> list[str]:
        return [*_position_lines(frame._replace(T_frame_tcp=frame.T_frame_tcp[rows], flags=frame.flags[rows]))]

    def moves(rows: slice) -> Iterable[str]:
        return _with_outputs(_move_lines(percent[rows], feed[rows], rows.stop == len(percent)), rows, controller, "jbi")

    return _Content("jbi", names, attributes, about, (1, 0, 0), positions, moves)


def _pulse_content(timed: TimedMotion, controller: ControllerData) -> _Content:
    if (pulses := controller.pulses) is None:
        raise InputError("jbi-pulses: the encoder scale is missing; set program.pulses: {per_rad: [...], source: ...}")
    groups = controller.joint_groups
    if len(groups.robot) > MOST_JOINTS:
        raise InputError(f"jbi-pulses: an arm of {len(groups.robot)} joints; at most {MOST_JOINTS} are supported")
    if np.shape(pulses.per_unit) != timed.x.shape[1:]:
        raise InputError(
            f"jbi-pulses: program.pulses.per_rad has {np.size(pulses.per_unit)} values for {timed.x.shape[1]} joints"
        )
    counts = np.round((timed.x - pulses.zero) * pulses.per_unit).astype(int)
    by = f"Tool {controller.tool}. Pulses by {pulses.source}."
    about = header(timed, *MORE, CHECK_AXES, by, outputs=bool(controller.rows_with_outputs))
    percents = _percents(timed, controller, "jbi-pulses")
    names = [f"///TOOL {controller.tool}", "///POSTYPE PULSE", "///PULSE"]

    def positions(rows: slice) -> list[str]:
        return [
            f"{kind}{k:05d}={','.join(map(str, row))}"
            for kind, columns in zip(POSITIONS, groups, strict=True)
            if columns
            for k, row in enumerate(counts[rows, list(columns)].tolist())
        ]

    def moves(rows: slice) -> Iterable[str]:
        lines = _pulse_move_lines(percents[rows], groups, rows.stop == len(percents))
        return _with_outputs(lines, rows, controller, "jbi-pulses")

    used = tuple(int(len(columns) > 0) for columns in groups)
    return _Content("jbi-pulses", names, ["///ATTR SC,RW"], about, used, positions, moves)


def _with_outputs(lines: Iterable[str], rows: slice, controller: ControllerData, format: str) -> Iterator[str]:
    """Yield the moves to some rows, with the outputs that are set there after a full stop, and before any motion."""
    yield from _outputs(controller, BEGIN, format) if rows.start == 0 else ()
    for row, line in enumerate(lines, start=rows.start):
        if row not in controller.rows_with_outputs:
            yield line
            continue
        move, plus, station = line.partition(" +")
        yield (move if move.endswith(" PL=0") else f"{move} PL=0") + plus + station
        yield from _outputs(controller, row, format)


def _outputs(controller: ControllerData, row: int, format: str) -> Iterator[str]:
    for output, value in controller.outputs_after(row):
        yield f"DOUT OT#({output_number(format, output)}) {'ON' if value else 'OFF'}"


def _one_job(content: _Content, count: int, controller: ControllerData) -> str:
    rows = slice(0, count)
    instructions = [*_remarks(content.about), *content.moves(rows)]
    if (lines := len(instructions) + 2) > MOST_LINES:
        raise InputError(
            f"{content.format}: {lines:,} lines, but a job has at most {MOST_LINES:,}; use a path with fewer points"
        )
    counts = [count * used for used in content.used]
    return _job(content, controller, [*content.names, *content.positions(rows)], counts, instructions)


def _jobs(content: _Content, count: int, controller: ControllerData) -> list[ProgramFile]:
    remarks = [*_remarks(content.about)]
    outputs = sum(len(controller.outputs_after(row)) for row in (BEGIN, *controller.rows_with_outputs))
    if len(remarks) + count + outputs + 2 <= MOST_LINES:
        return [ProgramFile("", _one_job(content, count, controller), range(count))]
    parts = split(count, MOST_LINES - 2 - PART_REMARKS - outputs)
    found, main = [], content._replace(attributes=["///ATTR SC,RW"])
    calls = [f"CALL JOB:{controller.name}-{k}" for k in range(1, len(parts) + 1)]
    text = _job(main, controller, [], [0, 0, 0], [*remarks, *calls])
    for k, part in enumerate(parts, start=1):
        own, rows = controller._replace(name=f"{controller.name}-{k}"), slice(part.start, part.stop)
        said = [*_remarks([f"Part {k} of {len(parts)} of {controller.name}."])]
        counts = [len(part) * used for used in content.used]
        lines = [*content.names, *content.positions(rows)]
        found.append(ProgramFile(f"-{k}", _job(content, own, lines, counts, [*said, *content.moves(rows)]), part))
    return [ProgramFile("", text, range(0)), *found]


def _job(
    content: _Content, controller: ControllerData, positions: list[str], counts: list[int], instructions: list[str]
) -> str:
    check_name(f"{content.format}: job name", controller.name, NAME, "up to 32 of A to Z, 0 to 9, - and _")
    head = ["/JOB", f"//NAME {controller.name}", "//POS", f"///NPOS {','.join(map(str, counts))},0,0,0", *positions]
    date = [] if controller.date is None else [f"///DATE {controller.date:%Y/%m/%d %H:%M}"]
    _, base, station = content.used
    groups = ["///GROUP1 RB1,BS1" if base else "///GROUP1 RB1", *(["///GROUP2 ST1"] if station else [])]
    return "\r\n".join([*head, "//INST", *date, *content.attributes, *groups, "NOP", *instructions, "END"]) + "\r\n"


def _remarks(about: list[str]) -> Iterator[str]:
    for sentence in about:
        plain = sentence.encode("ascii", "replace").decode()
        yield from (f"'{line}" for line in textwrap.wrap(plain, WIDTH))


def _position_lines(frame: UserFrame) -> Iterator[str]:
    """Yield the lines of the positions; a line with the arm configuration flags precedes a position if they change."""
    at_mm = _without_negative_zeros(1e3 * frame.T_frame_tcp[:, :3, 3], 3)
    turn_deg = _without_negative_zeros(np.degrees(_fixed_xyz_rad(frame.T_frame_tcp[:, :3, :3])), 4)
    last = None
    for k, (xyz, angles, flags) in enumerate(zip(at_mm.tolist(), turn_deg.tolist(), frame.flags.tolist(), strict=True)):
        if flags != last:
            yield f"///RCONF {','.join(map(str, (*flags, *UNUSED)))}"
        last = flags
        yield f"C{k:05d}={','.join([f'{v:.3f}' for v in xyz] + [f'{v:.4f}' for v in angles])}"


def _without_negative_zeros(values: np.ndarray, digits: int) -> np.ndarray:
    """Return the values rounded to `digits` decimals, without negative zeros."""
    return np.round(values, digits) + 0.0


def _fixed_xyz_rad(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the angles Rx, Ry, Rz [rad] of rotation matrices R = Rz Ry Rx.

    If Ry is a right angle, only the sum or difference of Rx and Rz is determined; Rz is then 0.
    """
    flat = np.hypot(R[:, 0, 0], R[:, 1, 0])
    locked = flat < 1e-9
    about_x = np.where(locked, np.arctan2(-R[:, 1, 2], R[:, 1, 1]), np.arctan2(R[:, 2, 1], R[:, 2, 2]))
    about_z = np.where(locked, 0.0, np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    return np.stack([about_x, np.arctan2(-R[:, 2, 0], flat), about_z], axis=1)


def _move_lines(percent: Float[np.ndarray, "n"], feed_mm_s: Float[np.ndarray, "n"], is_last: bool) -> Iterator[str]:
    for k, (joint, feed) in enumerate(zip(percent.tolist(), feed_mm_s.tolist(), strict=True)):
        end = " PL=0" if is_last and k == len(percent) - 1 else ""
        yield f"MOVL C{k:05d} V={feed:.1f}{end}" if feed >= LEAST_MM_S else f"MOVJ C{k:05d} VJ={joint:.2f}{end}"


def _pulse_move_lines(percents: Float[np.ndarray, "n N"], groups: JointGroups, is_last: bool) -> Iterator[str]:
    of_robot = percents[:, [*groups.robot, *groups.base]].max(axis=1)
    of_station = percents[:, list(groups.station)].max(axis=1, initial=LEAST_PERCENT)
    for k, (robot, station) in enumerate(zip(of_robot.tolist(), of_station.tolist(), strict=True)):
        base = f" BC{k:05d}" if groups.base else ""
        with_station = f" +MOVJ EC{k:05d} VJ={station:.2f}" if groups.station else ""
        end = " PL=0" if is_last and k == len(percents) - 1 else ""
        yield f"MOVJ C{k:05d}{base} VJ={robot:.2f}{end}{with_station}"


def _feed_mm_s(timed: TimedMotion, frame: UserFrame) -> Float[np.ndarray, "n"]:
    """Return the TCP's speed on the segment to each row [mm/s]; 0 if the segment is not on the path."""
    length_m = np.linalg.norm(np.diff(frame.T_frame_tcp[:, :3, 3], axis=0), axis=1)
    return np.where(timed.kind == Kind.PROCESS, np.append(0.0, 1e3 * length_m / np.diff(timed.time_s)), 0.0)


def _percents(timed: TimedMotion, controller: ControllerData, format: str) -> Float[np.ndarray, "n N"]:
    """Return the percentage of each joint's full speed on the segment to each row; a low one for the first row.

    Raises:
        InputError: If the joint speeds are missing, and for more than 100 %.
    """
    if controller.speed is None or not np.isfinite(controller.speed).all():
        raise InputError(f"{format}: the full joint speeds are missing; set program.velocity")
    share = 100 * np.abs(np.diff(timed.x, axis=0)) / (np.diff(timed.time_s)[:, None] * controller.speed)
    if (share > 100 + LEAST_PERCENT / 2).any():
        row, joint = np.unravel_index(share.argmax(), share.shape)
        fast = f"{timed.joint_names[joint]} at {share[row, joint]:.1f} % of its full speed"
        raise InputError(f"{format}: {fast}, {timed.time_s[row]:.6g} s from the start; at most 100 %")
    return np.concatenate([np.full((1, share.shape[1]), FIRST_PERCENT), np.maximum(share, LEAST_PERCENT)])
