"""URScript: a list of `servoj` commands, each of which blocks the controller for its time.

`servoj` takes times and passes every configuration without a stop. `movej` with a time stops at each configuration, or
blends it with a radius along a path that is not proven. The drawback of `servoj` is that the controller follows with a
lag and smooths its inputs (`lookahead_time`, `gain`). The samples must therefore be dense, at the controller's own
steps. Source: the script manual of Universal Robots, module motion.
"""

import re

import numpy as np
from jaxtyping import Int

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import BEGIN, CHECK_AXES, ControllerData, header
from htcp_jax.trajectory.formats.names import URSCRIPT_WORDS, check_name, output_number
from htcp_jax.trajectory.timed_motion import TimedMotion

JOINTS = 6
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
USED = frozenset(("movej", "servoj", "stopj", "set_standard_digital_out"))  # functions that a program calls
LOOKAHEAD_S, GAIN = 0.1, 300  # the manual's defaults
SLOW_RAD_S, SLOW_RAD_S2 = 0.1, 0.1  # velocity and acceleration of the move to the first configuration
STOP_RAD_S2 = 1.0
ONE_TIME_S = 1e-7
OUTPUTS = 8  # standard digital outputs, counted from 0
MORE = (
    "The arm first goes slowly from wherever it stands to the first configuration.",
    "servoj follows with a lag and smooths; radians, to 6 digits.",
    CHECK_AXES,
)


def urscript_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a script that defines a function with the program's name, and calls it.

    Raises:
        InputError: For an arm without exactly six revolute joints, an invalid function name, and times that are not
            multiples of the controller's step.
    """
    if len(timed.joint_names) != JOINTS or any(controller.slides):
        raise InputError(f"urscript: {_arm_description(controller)}; UR arms have {JOINTS} hinge joints")
    rule = "letters, digits and _, a letter first"
    check_name("urscript: function name", controller.name, NAME, rule, URSCRIPT_WORDS | USED)
    hold_s = _controller_steps(timed, controller.control_step_s) * controller.control_step_s
    about = header(timed, *MORE, outputs=bool(controller.rows_with_outputs))
    configurations = [", ".join(f"{value:.6f}" for value in row) for row in (np.round(timed.x, 6) + 0.0).tolist()]
    lines = [f"# {line}" for line in about] + [f"def {controller.name}():"]
    lines += _output_lines(controller, BEGIN)
    lines.append(f"  movej([{configurations[0]}], {SLOW_RAD_S2}, {SLOW_RAD_S})")
    lines += _output_lines(controller, 0)
    for row, (configuration, seconds) in enumerate(zip(configurations[1:], hold_s.tolist(), strict=True), start=1):
        lines.append(f"  servoj([{configuration}], 0, 0, {seconds:.6f}, {LOOKAHEAD_S}, {GAIN})")
        lines += _output_lines(controller, row)
    return "\n".join([*lines, f"  stopj({STOP_RAD_S2})", "end", f"{controller.name}()"]) + "\n"


def _output_lines(controller: ControllerData, row: int) -> list[str]:
    found = [(output_number("urscript", output), value) for output, value in controller.outputs_after(row)]
    if wrong := [number for number, _ in found if number >= OUTPUTS]:
        raise InputError(f"urscript: output {wrong[0]}; the standard digital outputs are 0 to {OUTPUTS - 1}")
    return [f"  set_standard_digital_out({number}, {value})" for number, value in found]


def _controller_steps(timed: TimedMotion, step_s: float) -> Int[np.ndarray, "m"]:
    """Return the number of controller steps from each sample to the next."""
    elapsed_s = timed.time_s - timed.time_s[0]
    steps = np.round(elapsed_s / step_s)
    wrong = np.abs(steps * step_s - elapsed_s) > ONE_TIME_S
    if wrong.any():
        at = timed.time_s[wrong.argmax()]
        raise InputError(
            f"urscript: a configuration at {at:.6g} s; times must be multiples of the controller's {step_s:g} s"
        )
    return np.diff(steps).astype(int)


def _arm_description(controller: ControllerData) -> str:
    return f"an arm of {len(controller.slides)} joints, {sum(controller.slides)} of which slide"
