"""LS programs of FANUC: one `J` to a joint position for each configuration, with its time.

`J` moves all axes along straight joint paths, which are proven, in a stated time (msec or sec). `FINE` is exact. FANUC
publishes no distance for `CNT`, so all paths inside the corner up to the middle of both legs are proven. Axes that
carry the robot are extended axes E1 to E3 of group 1, those of a positioner are group 2.

The controller counts J3 from the horizontal: if J2 alone moves, the forearm keeps its attitude. Models such as those of
ROS-Industrial count it from the upper arm, so J3 of the program is J3 - J2 of the model; `program.j3_from` states it.

Sources: FANUC's motion instructions as in mh142.com/wiki/Motion_Instructions and
aleksandarhaber.com/fanuc-motion-instructions; ros-industrial/fanuc, issue 186 and J23_factor of its driver; joint
positions with groups in public programs (JuniorNatalin/VASC on GitHub).
"""

import re
import textwrap
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import BEGIN, CHECK_AXES, ControllerData, header
from htcp_jax.trajectory.formats.axis_moves import ROBOT_AXES, check_robot, exact_rows, section_names, tcp_sentences
from htcp_jax.trajectory.formats.names import check_name, comment, output_number
from htcp_jax.trajectory.timed_motion import TimedMotion

NAME = re.compile(r"[A-Z][A-Z0-9_]{0,35}")
RULE = "up to 36 of A to Z, 0 to 9 and _, a letter first"
WIDTH = 32  # maximum number of characters of a comment
EXTENDED_AXES, STATION_AXES = 3, 6
FIRST_PERCENT = 5
LONGEST_MS, LONGEST_S = 32_000, 3200.0
DIGITS = 6  # decimals of degrees and mm
CNT = 100
MORE = (
    "The arm first goes slowly from wherever it stands to the first configuration.",
    "Corners with CNT are rounded by the controller, at most from the middle of a leg to that of the next one.",
)
J3 = {
    "upper_arm": "J3 is counted from the horizontal: J3 - J2 of the model, which counts from the upper arm.",
    "horizontal": "J3 is counted from the horizontal, as in the model.",
}


def ls_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a program.

    Raises:
        InputError: For a robot without exactly six revolute joints, too many external axes, an invalid program name,
            and moves that take too long.
    """
    groups, name = controller.joint_groups, controller.name
    check_robot("ls", timed, controller, f"group 1 has {ROBOT_AXES}; set program.groups for external axes")
    for what, own, most in (("base", groups.base, EXTENDED_AXES), ("station", groups.station, STATION_AXES)):
        if len(own) > most:
            raise InputError(f"ls: {len(own)} axes in program.groups.{what}; at most {most} are supported")
    check_name("ls: program name", name, NAME, RULE)
    instructions = [
        *_remarks(timed, controller),
        "UFRAME_NUM=0",
        f"UTOOL_NUM={controller.tool}",
        *_moves(timed, controller),
    ]
    lines = [
        f"/PROG  {name}",
        *_attributes(len(instructions), len(groups.station)),
        "/MN",
        *(_line(k, text) for k, text in enumerate(instructions, start=1)),
        "/POS",
        *_positions(timed, controller),
        "/END",
    ]
    return "\r\n".join(lines) + "\r\n"


def _attributes(count: int, station: int) -> list[str]:
    return [
        "/ATTR",
        "OWNER\t\t= MNEDITOR;",
        'COMMENT\t\t= "";',
        "PROG_SIZE\t= 0;",
        "FILE_NAME\t= ;",
        "VERSION\t\t= 0;",
        f"LINE_COUNT\t= {count};",
        "MEMORY_SIZE\t= 0;",
        "PROTECT\t\t= READ_WRITE;",
        "TCD:  STACK_SIZE\t= 0,",
        "      TASK_PRIORITY\t= 50,",
        "      TIME_SLICE\t= 0,",
        "      BUSY_LAMP_OFF\t= 0,",
        "      ABORT_REQUEST\t= 0,",
        "      PAUSE_REQUEST\t= 0;",
        f"DEFAULT_GROUP\t= {'1,1,*,*,*' if station else '1,*,*,*,*'};",
        "CONTROL_CODE\t= 00000000 00000000;",
    ]


def _line(number: int, text: str) -> str:
    return f"{number:4d}:{text} ;" if text.startswith("J ") else f"{number:4d}:  {text} ;"


def _remarks(timed: TimedMotion, controller: ControllerData) -> Iterator[str]:
    more = (*MORE, CHECK_AXES, J3[controller.j3_from], *tcp_sentences(controller, "UTOOL", "RPW"))
    for sentence in header(timed, *more, outputs=bool(controller.rows_with_outputs)):
        yield from (_remark(line) for line in textwrap.wrap(comment(sentence).replace(";", ","), WIDTH))


def _remark(text: str) -> str:
    return f"!{comment(text).replace(';', ',')[:WIDTH]}"


def _moves(timed: TimedMotion, controller: ControllerData) -> Iterator[str]:
    exact, sections = exact_rows(timed, controller), section_names(timed)
    begins = {seam.first: seam.name for seam in controller.seams}
    seconds = np.append(0.0, np.diff(timed.time_s)).tolist()
    yield from _outputs(controller, BEGIN)
    for row, duration_s in enumerate(seconds):
        if sections[row]:
            yield _remark(sections[row])
        speed = _time(duration_s, timed.time_s[row]) if row else f"{FIRST_PERCENT}%"
        yield f"J P[{row + 1}] {speed} {'FINE' if exact[row] else f'CNT{CNT}'}"
        if row in begins:
            yield _remark(f"seam {begins[row]}")
        yield from _outputs(controller, row)


def _outputs(controller: ControllerData, row: int) -> Iterator[str]:
    for output, value in controller.outputs_after(row):
        yield f"DO[{output_number('ls', output)}]={'ON' if value else 'OFF'}"


def _time(duration_s: float, at_s: float) -> str:
    """Return the time of a move, rounded up, so that no limit is exceeded."""
    if (ms := max(1, int(np.ceil(1e3 * duration_s - 1e-6)))) <= LONGEST_MS:
        return f"{ms}msec"
    if (tenths := np.ceil(10 * duration_s - 1e-6) / 10) <= LONGEST_S:
        return f"{tenths:.1f}sec"
    raise InputError(f"ls: a move of {duration_s:.6g} s that ends {at_s:.6g} s from the start; at most {LONGEST_S:g} s")


def _positions(timed: TimedMotion, controller: ControllerData) -> Iterator[str]:
    values = controller_values(timed.x, controller)
    groups, unit = controller.joint_groups, np.where(controller.slides, " mm", "deg").tolist()
    for row, numbers in enumerate(values.tolist(), start=1):
        own = [
            *((f"J{k + 1}", j) for k, j in enumerate(groups.robot)),
            *((f"E{k + 1}", j) for k, j in enumerate(groups.base)),
        ]
        yield f"P[{row}]{{"
        yield from _group(1, controller.tool, [f"{name}={numbers[j]:14.{DIGITS}f} {unit[j]}" for name, j in own])
        if groups.station:
            axes = [f"J{k + 1}={numbers[j]:14.{DIGITS}f} {unit[j]}" for k, j in enumerate(groups.station)]
            yield from _group(2, controller.tool, axes)
        yield "};"


def _group(number: int, tool: int, axes: list[str]) -> Iterator[str]:
    yield f"   GP{number}:"
    yield f"\tUF : 0, UT : {tool},\t"
    rows = [",\t".join(axes[k : k + 3]) for k in range(0, len(axes), 3)]
    yield ",\r\n".join(f"\t{row}" for row in rows)


def controller_values(x: Float[np.ndarray, "n N"], controller: ControllerData) -> Float[np.ndarray, "n N"]:
    """Return the joint values for the controller, in degrees, or in mm for slides.

    Args:
        x: The configurations [rad or m].
        controller: The controller data.
    """
    own, robot = x.copy(), controller.joint_groups.robot
    if controller.j3_from == "upper_arm":
        own[:, robot[2]] -= x[:, robot[1]]
    return np.round(np.where(controller.slides, 1e3 * own, np.degrees(own)), DIGITS) + 0.0
