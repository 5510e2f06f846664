"""ROS 2's trajectory_msgs/msg/JointTrajectory, in YAML and in JSON.

Both contain the message's fields by name, so that a message can be filled from the file. Numbers have nine decimals,
and times the message's nanoseconds. Sources: the message definitions of trajectory_msgs (JointTrajectory,
JointTrajectoryPoint), std_msgs (Header) and builtin_interfaces (Time, Duration).
"""

import json
from collections.abc import Iterable, Iterator

from htcp_jax.trajectory.controller_data import ControllerData, header
from htcp_jax.trajectory.timed_motion import TimedMotion

TYPE = "trajectory_msgs/msg/JointTrajectory"
NO_FRAME = "The message's frame_id is empty: joint values need none."


def ros_yaml_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return the message in YAML, with the header as comments."""
    lines = [f"# {TYPE}", *(f"# {line}" for line in header(timed, NO_FRAME))]
    lines += ["header:", "  stamp: {sec: 0, nanosec: 0}", '  frame_id: ""']
    lines += [f"joint_names: [{', '.join(map(_quoted, timed.joint_names))}]", "points:"]
    for point in _trajectory_points(timed):
        time = point.pop("time_from_start")
        for name, values in point.items():
            lines.append(f"{'-' if name == 'positions' else ' '} {name}: [{', '.join(_number_texts(values))}]")
        lines.append("  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}".format(**time))
    return "\n".join(lines) + "\n"


def ros_json_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return a JSON object with the message, its type and the header.

    The keys are `message`, `type` and `about`. As JSON has no comments, `about` contains the header.
    """
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": timed.joint_names,
        "points": list(_trajectory_points(timed)),
    }
    return json.dumps({"type": TYPE, "about": header(timed, NO_FRAME), "message": message}, allow_nan=False) + "\n"


def _trajectory_points(timed: TimedMotion) -> Iterator[dict]:
    timed = timed.rounded
    states = (timed.x.tolist(), timed.velocity.tolist(), timed.acceleration.tolist())
    for time_s, *state in zip((timed.time_s - timed.time_s[0]).tolist(), *states, strict=True):
        point = dict(zip(("positions", "velocities", "accelerations"), state, strict=True))
        sec, nanosec = divmod(round(time_s * 1e9), 10**9)
        yield point | {"effort": [], "time_from_start": {"sec": sec, "nanosec": nanosec}}


def _number_texts(values: Iterable[float]) -> Iterator[str]:
    """Yield numbers as text that YAML 1.1 also reads as numbers, unlike 1e-05."""
    for text in map(repr, values):
        yield text.replace("e", ".0e") if "e" in text and "." not in text else text


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
