r"""RAPID of ABB: one `MoveAbsJ` for each configuration, with its time.

`MoveAbsJ` moves all axes, including external axes, along straight joint paths, which are proven. `\T` sets the duration
of each move. Zone z0 passes a configuration without a stop; where the motion stops, the zone is fine. Source: ABB,
Technical reference manual, RAPID Instructions, Functions and Data types, 3HAC050917: MoveAbsJ, jointtarget, robjoint,
extjoint, zonedata.
"""

import re

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import BEGIN, CHECK_AXES, ControllerData, header
from htcp_jax.trajectory.formats.axis_moves import ROBOT_AXES, at_rest, check_robot
from htcp_jax.trajectory.formats.controller_limits import RAPID_LINES
from htcp_jax.trajectory.formats.names import RAPID_WORDS, check_name
from htcp_jax.trajectory.formats.parts import ProgramFile, split
from htcp_jax.trajectory.timed_motion import TimedMotion

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,25}")  # name of the procedure; identifiers have up to 32 characters
TOOL_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
USED = frozenset(("moveabsj", "noeoffs", "v50", "v1000", "z0", "fine"))  # names in a program, in lower case
RULE = "up to {} letters, digits and _, a letter first"
FRAME_LINES = 4  # lines of a module other than comments and moves
FLANGE_TOOL = "tool0"  # predefined; its TCP is at the flange
EXTERNAL_AXES = 6
LEAST_S = 1e-6  # last digit of a time; a time of 0 is not valid
NOT_CONNECTED = "9E9"
MORE = (
    "The arm first goes slowly from wherever it stands to the first configuration.",
    "At configurations the controller rounds corners by zone z0, except where the motion stops.",
)


def rapid_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a module with one procedure.

    Raises:
        InputError: For a robot without exactly six revolute joints, for more than six external axes, and for an invalid
            name of the program or the tool.
    """
    return _module(controller.name, *_comments_and_moves(timed, controller))


def rapid_files(timed: TimedMotion, controller: ControllerData) -> list[ProgramFile]:
    """Return what `rapid_text` returns, or several modules if one would have too many lines, see `controller_limits`.

    The main module's procedure then calls those of the other modules in order.
    """
    name, count, (about, moves) = controller.name, len(timed.x), _comments_and_moves(timed, controller)
    if count + sum(each.count("\n") for each in moves) + len(about) + FRAME_LINES <= RAPID_LINES.most:
        return [ProgramFile("", _module(name, about, moves), range(count))]
    parts = split(count, RAPID_LINES.most - FRAME_LINES - 1 - sum(each.count("\n") for each in moves))
    names = [f"{name}_{k}" for k in range(1, len(parts) + 1)]
    check_name("rapid: procedure name", names[-1], NAME, RULE.format(26))
    found = [ProgramFile("", _module(name, about, [f"{each};" for each in names]), range(0))]
    for k, (part, own) in enumerate(zip(parts, names, strict=True), start=1):
        text = _module(own, [f"Part {k} of {len(parts)} of {name}."], moves[part.start : part.stop])
        found.append(ProgramFile(f"_{k}", text, part))
    return found


def _comments_and_moves(timed: TimedMotion, controller: ControllerData) -> tuple[list[str], list[str]]:
    groups = controller.joint_groups
    check_robot("rapid", timed, controller, f"robjoint needs {ROBOT_AXES}", ", as robjoint has only hinges")
    if len(groups.external) > EXTERNAL_AXES:
        raise InputError(f"rapid: {len(groups.external)} external axes; extjoint supports at most {EXTERNAL_AXES}")
    name, tool = controller.name, controller.tool_name or f"tool{controller.tool}"
    reserved = RAPID_WORDS | USED
    check_name("rapid: procedure name", name, NAME, RULE.format(26), reserved | {tool.lower()})
    check_name("rapid: program.tool_name", tool, TOOL_NAME, RULE.format(32), reserved)
    x = _controller_values(timed.x, controller)
    places = [f"[{_axes(row, controller, groups.robot)},{_axes(row, controller, groups.external)}]" for row in x]
    sums = [f"{timed.joint_names[k]} is written as its sum with {timed.joint_names[j]}." for k, j in controller.coupled]
    units = f"Degrees and mm. {_tool_line(tool, controller)}"
    about = header(timed, *MORE, CHECK_AXES, *sums, units, outputs=bool(controller.rows_with_outputs))
    moves = [f"MoveAbsJ {places[0]}\\NoEOffs,v50,fine,{tool};"]
    stops = at_rest(timed.velocity)
    stops[[-1, *controller.rows_with_outputs]] = True
    for place, seconds, is_stop in zip(places[1:], np.diff(timed.time_s).tolist(), stops[1:].tolist(), strict=True):
        zone = "fine" if is_stop else "z0"
        moves.append(f"MoveAbsJ {place}\\NoEOffs,v1000\\T:={max(seconds, LEAST_S):.6f},{zone},{tool};")
    for row in controller.rows_with_outputs:
        moves[row] = "\n    ".join([moves[row], *map(_set_output, controller.outputs_after(row))])
    moves[0] = "\n    ".join([*map(_set_output, controller.outputs_after(BEGIN)), moves[0]])
    return about, moves


def _set_output(output: tuple[int | str, bool]) -> str:
    signal, value = output
    name = f"do{signal}" if isinstance(signal, int) else signal
    check_name("rapid: output", name, TOOL_NAME, RULE.format(32), RAPID_WORDS | USED)
    return f"SetDO {name},{int(value)};"


def _module(name: str, about: list[str], statements: list[str]) -> str:
    lines = [*(f"  ! {line}" for line in about), f"  PROC {name}()", *(f"    {each}" for each in statements)]
    return "\n".join([f"MODULE {name}Module", *lines, "  ENDPROC", "ENDMODULE"]) + "\n"


def _controller_values(x: Float[np.ndarray, "n N"], controller: ControllerData) -> Float[np.ndarray, "n N"]:
    """Return the joint values for the controller, with the coupled joint's value added to each coupled axis."""
    values = x.copy()
    for axis, joint in controller.coupled:
        values[:, axis] += x[:, joint]
    return values


def _tool_line(tool: str, controller: ControllerData) -> str:
    """Return a sentence with the planned TCP as a RAPID pose in mm, and with how to set it."""
    if (tcp := controller.tcp) is None:
        return f"{tool} must have the planned TCP."
    w_last = Rotation.from_matrix(tcp.T_frame_tcp[:3, :3]).as_quat(canonical=True)
    numbers = [1e3 * tcp.T_frame_tcp[:3, 3], np.roll(w_last, 1)]
    pose = ",".join(f"[{','.join(f'{v:.6f}' for v in (np.round(part, 6) + 0.0).tolist())}]" for part in numbers)
    said = f"The planned TCP is [{pose}] in the frame of {tcp.frame}"
    if tool == FLANGE_TOOL:
        return f"{said}; {tool} is at the flange and cannot be set: declare a tool, and name it in program.tool_name."
    return f"{said}; {tool} must have it."


def _axes(x: Float[np.ndarray, "N"], controller: ControllerData, columns: tuple[int, ...]) -> str:
    """Return six axes as text, in degrees, or in mm for slides."""
    of = list(columns)
    values = np.where(np.array(controller.slides)[of], 1e3 * x[of], np.degrees(x[of])) if of else np.zeros(0)
    numbers = [f"{value:.6f}" for value in (np.round(values, 6) + 0.0).tolist()]
    return f"[{','.join(numbers + [NOT_CONNECTED] * (ROBOT_AXES - len(numbers)))}]"
