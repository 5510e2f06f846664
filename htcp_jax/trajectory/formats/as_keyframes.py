"""MuJoCo keyframes of a robot program, in a file that a model can include.

    <include file="weld.xml"/>

Each `key` has a time, qpos and qvel (MJCF reference, keyframe/key). The model must have exactly these joints, in the
same order, which is that of the arm's model file. Numbers have nine decimals.
"""

from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import ControllerData, header
from htcp_jax.trajectory.timed_motion import TimedMotion


def keyframes_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return the file's text, one key per sample, named by its number and `status.Kind`."""
    timed = timed.rounded
    order = list(range(len(timed.joint_names)) if controller.in_file is None else controller.in_file)
    names = ", ".join((*timed.joint_names, *controller.locked)[k] for k in order)
    about = header(timed, f"qpos and qvel are those of {names}, in this order.")
    root = Element("mujoco")
    root.append(Comment("\n  " + "\n  ".join(about).replace("--", "- -") + "\n"))
    keys = SubElement(root, "keyframe")
    still = np.tile([*controller.locked.values()], (len(timed.x), 1))
    x, velocity = np.hstack([timed.x, still])[:, order], np.hstack([timed.velocity, 0 * still])[:, order]
    rows = zip(timed.time_s.tolist(), timed.kind.tolist(), x.tolist(), velocity.tolist(), strict=True)
    for number, (time_s, kind, x, velocity) in enumerate(rows):
        name = f"{number}_{Kind(kind).words}"
        SubElement(keys, "key", name=name, time=repr(time_s), qpos=_spaced(x), qvel=_spaced(velocity))
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _spaced(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))
