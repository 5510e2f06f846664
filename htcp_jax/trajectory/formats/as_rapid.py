r"""RAPID of ABB: one `MoveAbsJ` for each configuration, with its time.

`MoveAbsJ` moves all axes, external ones included, along straight joint paths: those that are proven. `\T` gives each
its time, and zone z0 passes it without a stop. Source: ABB, Technical reference manual, RAPID Instructions, Functions
and Data types, 3HAC050917: MoveAbsJ, jointtarget, robjoint, extjoint, zonedata.
"""

import re

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.trajectory.controller_data import ControllerData, header
from htcp_jax.trajectory.timed_motion import TimedMotion

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,25}")  # of the procedure; identifiers have up to 32 characters
ROBOT_AXES, EXTERNAL_AXES = 6, 6
NOT_CONNECTED = "9E9"
MORE = (
    "The arm first goes slowly from wherever it stands to the first configuration.",
    "Between configurations the controller rounds corners by zone z0.",
)


def rapid_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a module with one procedure.

    Raises:
        InputError: For a robot without exactly six revolute joints, for more than six external axes, and for an invalid
            name.
    """
    groups = controller.joint_groups
    if len(groups.robot) != ROBOT_AXES:
        raise InputError(f"rapid: a robot of {len(groups.robot)} joints; robjoint holds {ROBOT_AXES}")
    if sliding := [timed.joint_names[k] for k in groups.robot if controller.slides[k]]:
        raise InputError(f"rapid: {sliding[0]} slides; robjoint holds revolute joints, program.groups.base others")
    if len(groups.external) > EXTERNAL_AXES:
        raise InputError(f"rapid: {len(groups.external)} external axes; extjoint holds {EXTERNAL_AXES}")
    if not NAME.fullmatch(controller.name):
        said = "up to 26 letters, digits and _, a letter first"
        raise InputError(f"rapid: {controller.name!r} is not a name of a procedure; {said}")
    tool = f"tool{controller.tool}"
    places = [f"[{_axes(row, controller, groups.robot)},{_axes(row, controller, groups.external)}]" for row in timed.x]
    about = header(timed, *MORE, f"Degrees and mm. {tool} must be set as it was planned.")
    lines = [*(f"  ! {line}" for line in about), f"  PROC {controller.name}()"]
    lines.append(f"    MoveAbsJ {places[0]}\\NoEOffs,v50,fine,{tool};")
    for k, (place, seconds) in enumerate(zip(places[1:], np.diff(timed.time_s).tolist(), strict=True), start=1):
        zone = "fine" if k == len(timed.x) - 1 else "z0"
        lines.append(f"    MoveAbsJ {place}\\NoEOffs,v1000\\T:={seconds:.6f},{zone},{tool};")
    return "\n".join([f"MODULE {controller.name}Module", *lines, "  ENDPROC", "ENDMODULE"]) + "\n"


def _axes(x: Float[np.ndarray, "N"], controller: ControllerData, columns: tuple[int, ...]) -> str:
    """Write six axes in degrees, or mm if they slide."""
    of = list(columns)
    values = np.where(np.array(controller.slides)[of], 1e3 * x[of], np.degrees(x[of])) if of else np.zeros(0)
    numbers = [f"{value:.6f}" for value in (np.round(values, 6) + 0.0).tolist()]
    return f"[{','.join(numbers + [NOT_CONNECTED] * (ROBOT_AXES - len(numbers)))}]"
