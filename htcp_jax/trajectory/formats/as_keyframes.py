"""MuJoCo keyframes: a file that a model includes.

    <include file="weld.xml"/>

Each `key` has a time, qpos and qvel (MJCF reference, keyframe/key). The model must have these joints and no others, in
their order. Numbers round-trip exactly.
"""

from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import ControllerData, header
from htcp_jax.trajectory.timed_motion import TimedMotion


def keyframes_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return the file's text, one key per sample, named by its number and `status.Kind`."""
    about = header(timed, f"qpos and qvel are those of {', '.join(timed.joint_names)}, in this order.")
    root = Element("mujoco")
    root.append(Comment("\n  " + "\n  ".join(about).replace("--", "- -") + "\n"))
    keys = SubElement(root, "keyframe")
    rows = zip(timed.time_s.tolist(), timed.kind.tolist(), timed.x.tolist(), timed.velocity.tolist(), strict=True)
    for number, (time_s, kind, x, velocity) in enumerate(rows):
        name = f"{number}_{Kind(kind).words}"
        SubElement(keys, "key", name=name, time=repr(time_s), qpos=_spaced(x), qvel=_spaced(velocity))
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _spaced(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))
