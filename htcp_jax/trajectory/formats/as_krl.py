r"""KRL of KUKA: one `PTP` to axis values for each configuration.

`PTP` moves all axes, including external axes, along straight joint paths, which are proven. At a corner, `C_PTP` leaves
the path at most `$APO.CPTP` percent of half a leg before it; where the motion stops, the position is exact. Speeds are
percents: `$VEL_AXIS` of the axes' full speeds, and `$RED_VEL` of it for each move, because `$VEL_AXIS` has no less than
1 percent. That `$RED_VEL` scales the axes' speeds is an assumption, for which no public source was found.

Sources: KUKA, mxAutomation Logix 1.0, page 25 (CPTP: at most half of the distance from the start to the end point);
KUKA, System Variables, KSS 8.1 to 8.4 ($APO, $VEL_AXIS, $VEL_EXTAX); the KRL grammar in
github.com/antlr/grammars-v4.
"""

import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import BEGIN, CHECK_AXES, ControllerData, header
from htcp_jax.trajectory.formats.axis_moves import ROBOT_AXES, check_robot, exact_rows, section_names, tcp_sentences
from htcp_jax.trajectory.formats.names import KRL_WORDS, check_name, comment, output_number
from htcp_jax.trajectory.timed_motion import TimedMotion

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,23}")
RULE = "up to 24 letters, digits and _, a letter first"
USED = frozenset(("bas", "e6axis"))
EXTERNAL_AXES = 6
FIRST_PERCENT = 5
MOST_ABOVE = 1e-3  # rounding of shares [%]
DIGITS = 5  # decimals of degrees and mm
FARTHEST = 5 / 32  # distance of the program's blend from its corner, in its length times the change of slope
WIDTH = 100  # maximum number of characters of a comment
MORE = (
    "No times: speeds stand for them, in percent of the axes' full speeds.",
    "The arm first goes slowly from wherever it stands to the first configuration.",
    "Corners are rounded by C_PTP, at most $APO.CPTP percent of half a leg before them.",
    "Check that $RED_VEL scales speeds at this controller; if it is ignored, moves are up to ten times faster.",
)


def krl_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a module with one procedure.

    Raises:
        InputError: For a robot without exactly six revolute joints, more than six external axes, an invalid name of the
            procedure, missing joint speeds, and velocities above them.
    """
    groups, name = controller.joint_groups, controller.name
    check_robot("krl", timed, controller, f"E6AXIS has {ROBOT_AXES}; set program.groups for external axes")
    if len(groups.external) > EXTERNAL_AXES:
        raise InputError(f"krl: {len(groups.external)} external axes; E6AXIS supports at most {EXTERNAL_AXES}")
    check_name("krl: procedure name", name, NAME, RULE, KRL_WORDS | USED)
    tool = f"TOOL_DATA[{controller.tool}]" if controller.tool else "$NULLFRAME"
    lines = ["&ACCESS RVP", "&REL 1", f"DEF {name}()"]
    outputs, stated = bool(controller.rows_with_outputs), (*_speed_sentences(timed, controller), CHECK_AXES)
    for sentence in header(timed, *MORE, *stated, *tcp_sentences(controller, "$TOOL", "ABC"), outputs=outputs):
        lines += [f"; {line}" for line in textwrap.wrap(comment(sentence), WIDTH)]
    lines += ["BAS(#INITMOV,0)", f"$TOOL={tool}", "$BASE=$NULLFRAME", *_moves(timed, controller)]
    lines += [*_velocities(100, controller), "$RED_VEL=100", "END"]
    return "\r\n".join(lines) + "\r\n"


def _speed_sentences(timed: TimedMotion, controller: ControllerData) -> Iterator[str]:
    """Yield a sentence with the full speeds to which percents refer, and one with the time of the first seam."""
    if controller.speed is not None:
        speeds = np.where(controller.slides, 1e3 * controller.speed, np.degrees(controller.speed))
        units = "deg/s, of slides mm/s" if any(controller.slides) else "deg/s"
        yield f"Full speeds of {', '.join(timed.joint_names)}: {', '.join(f'{each:.5g}' for each in speeds)} {units}."
    if controller.seams:
        first = controller.seams[0]
        seconds = float(timed.time_s[first.last] - timed.time_s[first.first])
        yield f"The first seam, {first.name}, takes {seconds:.2f} s at 100 % override."


def _moves(timed: TimedMotion, controller: ControllerData) -> Iterator[str]:
    """Yield the statements of the motion."""
    exact, sections = exact_rows(timed, controller), section_names(timed)
    velocity, factor = _percents(timed, controller, sections)
    corner = _corner_percents(timed)
    begins = {seam.first: seam.name for seam in controller.seams}
    last: tuple[int, int, int] = (0, 0, 0)  # values of $VEL_AXIS, $RED_VEL and $APO.CPTP
    yield from _outputs(controller, BEGIN)
    for row in range(len(timed.x)):
        if sections[row]:
            yield f"; {sections[row]}"
        now = int(velocity[row]), int(factor[row]), last[2] if exact[row] else int(corner[row])
        if now[0] != last[0]:
            yield from _velocities(now[0], controller)
        if now[1] != last[1]:
            yield f"$RED_VEL={now[1]}"
        if now[2] != last[2]:
            yield f"$APO.CPTP={now[2]}"
        last = now
        yield f"PTP {_axes(timed.x[row], controller)}{'' if exact[row] else ' C_PTP'}"
        if row in begins:
            yield f"; seam {comment(begins[row])}"
        yield from _outputs(controller, row)


def _velocities(percent: int, controller: ControllerData) -> Iterator[str]:
    yield from (f"$VEL_AXIS[{k + 1}]={percent}" for k in range(ROBOT_AXES))
    yield from (f"$VEL_EXTAX[{k + 1}]={percent}" for k in range(len(controller.joint_groups.external)))


def _outputs(controller: ControllerData, row: int) -> Iterator[str]:
    for output, value in controller.outputs_after(row):
        yield f"$OUT[{output_number('krl', output)}]={'TRUE' if value else 'FALSE'}"


def _percents(
    timed: TimedMotion, controller: ControllerData, sections: Sequence[str]
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Return $VEL_AXIS and $RED_VEL for the move to each row; $VEL_AXIS changes where process and air moves begin.

    Raises:
        InputError: If the joint speeds are missing, and for more than 100 %.
    """
    if controller.speed is None or not np.isfinite(controller.speed).all():
        raise InputError("krl: the full joint speeds are missing; set program.velocity")
    count = len(timed.x)
    velocity, factor = np.full(count, FIRST_PERCENT), np.full(count, 100)
    if count < 2:
        return velocity, factor
    shares = 100 * np.abs(np.diff(timed.x, axis=0)) / (np.diff(timed.time_s)[:, None] * controller.speed)
    if (shares > 100 + MOST_ABOVE).any():
        row, joint = np.unravel_index(shares.argmax(), shares.shape)
        fast = f"{timed.joint_names[joint]} at {shares[row, joint]:.1f} % of its full speed"
        raise InputError(f"krl: {fast}, {timed.time_s[row]:.6g} s from the start; at most 100 %")
    share = shares.max(axis=1)
    begins = [*(k for k, section in enumerate(sections) if section), count]
    for first, stop in pairwise(begins):
        velocity[first:stop] = np.clip(np.ceil(share[first - 1 : stop - 1].max() - MOST_ABOVE), 1, 100)
    factor[1:] = np.clip(np.round(100 * share / velocity[1:]), 1, 100)
    return velocity, factor


def _corner_percents(timed: TimedMotion) -> Int[np.ndarray, "n"]:
    """Return $APO.CPTP at each row: what the program's blend, which is within the proof, displaces; at least 1.

    A path within a length d of the corner is at most d times the change of slope away from the corner's legs.
    """
    if timed.blended is None:
        return np.ones(len(timed.x), int)
    return np.clip(np.floor(200 * FARTHEST * timed.blended), 1, 100).astype(int)


def _axes(x: Float[np.ndarray, "N"], controller: ControllerData) -> str:
    """Return axis values as text, in degrees, or in mm for slides."""
    groups = controller.joint_groups
    values = np.where(controller.slides, 1e3 * x, np.degrees(x))
    numbers = (np.round(values, DIGITS) + 0.0).tolist()
    robot = [f"A{k + 1} {numbers[j]:.{DIGITS}f}" for k, j in enumerate(groups.robot)]
    external = [f"E{k + 1} {numbers[j]:.{DIGITS}f}" for k, j in enumerate(groups.external)]
    return f"{{E6AXIS: {', '.join([*robot, *external])}}}"
