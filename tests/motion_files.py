"""Arms, random motions and their files, for the tests of readers."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.motions import EncoderScale, MotionFile, read_motion
from htcp_jax.io.robots.loading import gp50, load_robot
from htcp_jax.model import Robot
from htcp_jax.status import Kind
from htcp_jax.trajectory import TimedMotion
from htcp_jax.trajectory.controller_data import ControllerData, JointGroups
from htcp_jax.trajectory.formats.writers import program_text

STEP_S = 0.002
ENDINGS = {
    "csv": "csv", "ros": "yaml", "ros-json": "json", "jbi-pulses": "jbi", "rapid": "mod", "urscript": "script",
    "keyframes": "xml", "krl": "src", "ls": "ls",
}  # fmt: skip
NAMES = ["weld", "A1", "seam_2", "w"]  # of programs
# A rail, six hinges, and a hinge of a positioner at the end of the chain.
JOINTS = ("rail", "s", "l", "u", "r", "b", "t", "turn")
GROUPS = JointGroups(robot=(1, 2, 3, 4, 5, 6), base=(0,), station=(7,))
BODY = '<body pos="0 0 0.2"><joint name="{}" {}/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.1"/>'
# b follows a, c follows b; d is a slide with a follower e.
FOLLOWED = """
<mujoco model="followed"><compiler angle="radian"/><worldbody>
<body><joint name="a" axis="0 0 1" range="-3 3"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.1"/>
<body pos="0 0 0.2"><joint name="b" axis="0 1 0" range="-9 9"/><geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.1"/>
<body pos="0 0 0.2"><joint name="d" type="slide" axis="0 0 1" range="-3 3"/><geom type="sphere" size="0.03"/>
<body pos="0 0 0.2"><joint name="e" type="slide" axis="0 0 1" range="-9 9"/><geom type="sphere" size="0.03"/>
<body pos="0 0 0.2"><joint name="c" axis="0 1 0" range="-3 3"/><geom type="sphere" size="0.03"/>
<site name="tcp" pos="0 0 0.1"/></body></body></body></body></body></worldbody>
<equality><joint joint1="b" joint2="a" polycoef="0.25 -1.5 0 0 0"/>
<joint joint1="e" joint2="d" polycoef="0.1 0.5 0 0 0"/></equality></mujoco>
"""


def _loaded(text: str) -> Robot:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(text)
        return load_robot(file)


@cache
def railed() -> Robot:
    """The arm with the JOINTS."""
    kinds = (
        'type="slide" axis="1 0 0" range="-3 3"',
        *(f'axis="0 {k % 2} {1 - k % 2}" range="-170 170"' for k in range(7)),
    )
    bodies = "".join(BODY.format(name, kind) for name, kind in zip(JOINTS, kinds, strict=True))
    end = '<site name="tcp" pos="0 0 0.1"/>' + "</body>" * len(JOINTS)
    return _loaded(f'<mujoco model="railed"><worldbody>{bodies}{end}</worldbody></mujoco>')


@cache
def followed() -> Robot:
    """The arm with followers."""
    return _loaded(FOLLOWED)


@cache
def hinged() -> Robot:
    """An arm of six hinges."""
    return gp50()


def random_motion(robot: Robot, seed: int, most: int = 9) -> TimedMotion:
    """Random states at multiples of a controller's step, with the values that a writer finds hard."""
    draw = np.random.default_rng(seed)
    n, N = int(draw.integers(1, most)), robot.dof
    x, velocity, acceleration = draw.uniform(-3, 3, (3, n, N)) * 10.0 ** draw.choice([0, 0, 0, -5, -9], (3, n, N))
    steps = np.cumsum(draw.integers(1, 700, n))
    kind = draw.choice(list(Kind), n).astype(np.int8)
    return TimedMotion(
        STEP_S * (steps - steps[0]), x, velocity, acceleration, kind, draw.integers(0, 99, n), robot.joint_names
    )


def controller(robot: Robot, name: str = "weld", **given) -> ControllerData:
    """Controller data with pulses, and with groups if the arm has other than six joints."""
    N = robot.dof
    pulses = EncoderScale(np.where(np.arange(N) % 2, -73000.0, 85000.5), np.linspace(-1, 1, N), "a drawing")
    groups = GROUPS if robot.joint_names == JOINTS else None
    slides = (*robot.sliding, *(robot.slides[j] for j in robot.followers))
    own = ControllerData(name, slides, speed=np.full(N, 1e6), pulses=pulses, groups=groups)
    return own._replace(**given)


def with_followers(robot: Robot, timed: TimedMotion) -> TimedMotion:
    """The motion with the followers after the other joints, as `program.axes: all` writes it."""
    if robot.coupling is None:
        return timed
    rows = list(robot.followers)
    states = [robot.coupling.positions(timed.x), *map(robot.coupling.rates, (timed.velocity, timed.acceleration))]
    x, velocity, acceleration = (
        np.hstack([own, every[:, rows]]) for own, every in zip(timed[1:4], states, strict=True)
    )
    names = (*timed.joint_names, *(robot.all_joint_names[j] for j in rows))
    return timed._replace(x=x, velocity=velocity, acceleration=acceleration, joint_names=names)


def write(folder: Path, format: str, timed: TimedMotion, given: ControllerData) -> Path:
    """The file of a motion."""
    name = given.name.upper() if format.startswith("jbi") or format == "ls" else given.name
    file = folder / f"{name}.{ENDINGS[format]}"
    slides = given.slides[: len(timed.joint_names)]
    file.write_bytes(program_text(format, timed, given._replace(name=name, slides=slides)).encode())
    return file


def read_text(folder: Path, name: str, text: str, robot: Robot | None = None, given=None, **how) -> MotionFile:
    """The motion in a text."""
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return read_motion(file, robot or hinged(), given or controller(robot or hinged()), **how)


def refusal(folder: Path, name: str, text: str, robot: Robot | None = None, given=None, **how) -> str:
    """The message by which a text is refused, without the file's folder; "" if it is read."""
    try:
        read_text(folder, name, text, robot, given, **how)
    except InputError as error:
        message = str(error)
        assert "\n" not in message and message.startswith(str(folder / name))
        return message.removeprefix(f"{folder}/")
    return ""
