"""Formats of robot programs, each read back by a reader written from the format's description."""

import csv
import datetime
import json
import re

import mujoco
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as of_numpy
from scipy.spatial.transform import Rotation

from htcp_jax.errors import InputError
from htcp_jax.io.motions import EncoderScale
from htcp_jax.spec import GP50
from htcp_jax.status import Kind
from htcp_jax.trajectory import FORMATS, TimedMotion
from htcp_jax.trajectory.controller_data import (
    ControllerData,
    JointGroups,
    PlannedTcp,
    ProcessOutputs,
    SeamSpan,
    UserFrame,
)
from htcp_jax.trajectory.formats.writers import program_text

STEP_S = 0.002
HALF_NANO = 0.5001e-9
FULL_SPEED = 1e4  # [rad/s], so high that no motion of these tests exceeds it
ALL = st.floats(-3.2, 3.2) | st.floats(-1e-4, 1e-4)
NAMES = st.text("abcXYZ019_-: #,'\"é", min_size=1, max_size=8)
FEW = settings(max_examples=25)


def states(n: int, joints: int):
    return of_numpy.arrays(float, (n, joints), elements=ALL)


@st.composite
def motions(draw, joints=None):
    """Motions of one to six configurations, at multiples of a controller's step."""
    n, N = draw(st.integers(1, 6)), joints or draw(st.integers(1, 8))
    steps = draw(st.lists(st.integers(1, 700), min_size=n, max_size=n))
    return TimedMotion(
        time_s=STEP_S * (np.cumsum(steps) - steps[0]),
        x=draw(states(n, N)),
        velocity=draw(states(n, N)),
        acceleration=draw(states(n, N)),
        kind=np.array(draw(st.lists(st.sampled_from(Kind), min_size=n, max_size=n)), np.int8),
        target=np.array(draw(st.lists(st.integers(0, 99), min_size=n, max_size=n))),
        joint_names=tuple(draw(st.lists(NAMES, min_size=N, max_size=N, unique=True))),
    )


def controller(timed: TimedMotion, **given) -> ControllerData:
    N = len(timed.joint_names)
    return ControllerData("WELD", (False,) * N, speed=np.full(N, FULL_SPEED))._replace(**given)


def a_motion(joints=6) -> TimedMotion:
    rows = np.arange(3.0)
    x = rows[:, None] * np.linspace(-0.02, 0.01, joints)
    kind = np.array([Kind.TRANSFER, Kind.PROCESS, Kind.RETRACT], np.int8)
    return TimedMotion(0.1 * rows, x, x, x, kind, rows.astype(int), tuple(f"j{k}" for k in range(joints)))


# --- tables


@FEW
@given(motions())
def test_a_table_reads_back_to_half_a_nanoradian(timed):
    slides = tuple(k % 2 == 1 for k in range(len(timed.joint_names)))
    text = program_text("csv", timed, controller(timed, slides=slides))
    head, *rows = csv.reader(line for line in text.splitlines() if not line.startswith("#"))
    names = [name + ("_m" if slide else "_rad") for name, slide in zip(timed.joint_names, slides, strict=True)]
    assert head == ["time_s", "kind", "target", *names, *(f"{n}_s" for n in names), *(f"{n}_s2" for n in names)]
    assert [Kind[row[1]] for row in rows] == timed.kind.tolist() and [
        int(row[2]) for row in rows
    ] == timed.target.tolist()
    numbers = np.array([[row[0], *row[3:]] for row in rows], float)
    written = np.column_stack([timed.time_s, timed.x, timed.velocity, timed.acceleration])
    np.testing.assert_allclose(numbers, written, rtol=1e-15, atol=HALF_NANO)
    assert all(len(cell.partition(".")[2]) <= 9 for row in rows for cell in row if "e" not in cell)


# --- ROS: the messages' definitions, field by field

MESSAGES = {
    "JointTrajectory": {"header": "Header", "joint_names": "string[]", "points": "JointTrajectoryPoint[]"},
    "Header": {"stamp": "Time", "frame_id": "string"},
    "Time": {"sec": "int32", "nanosec": "uint32"},
    "Duration": {"sec": "int32", "nanosec": "uint32"},
    "JointTrajectoryPoint": {
        **dict.fromkeys(("positions", "velocities", "accelerations", "effort"), "float64[]"),
        "time_from_start": "Duration",
    },
}
PLAIN = {"string": str, "int32": int, "uint32": int, "float64": float}


def check_message(value, kind: str) -> None:
    if kind.endswith("[]"):
        assert isinstance(value, list)
        for each in value:
            check_message(each, kind[:-2])
    elif kind in MESSAGES:
        assert value.keys() == MESSAGES[kind].keys()
        for name, inner in MESSAGES[kind].items():
            check_message(value[name], inner)
    else:
        assert type(value) is PLAIN[kind]
        assert kind != "uint32" or 0 <= value < 10**9


@pytest.mark.parametrize("format", ["ros", "ros-json"])
@FEW
@given(motions())
def test_a_ros_message_is_as_defined_and_reads_back_to_half_a_nanoradian_and_half_a_nanosecond(format, timed):
    text = program_text(format, timed, controller(timed))
    message = yaml.safe_load(text) if format == "ros" else json.loads(text)["message"]
    check_message(message, "JointTrajectory")
    assert tuple(message["joint_names"]) == timed.joint_names
    for name, array in zip(("positions", "velocities", "accelerations"), timed[1:4], strict=True):
        found = np.array([point[name] for point in message["points"]])
        np.testing.assert_allclose(found, array, rtol=1e-15, atol=HALF_NANO)
    times = [point["time_from_start"] for point in message["points"]]
    nanoseconds = np.array([10**9 * time["sec"] + time["nanosec"] for time in times])
    assert np.abs(nanoseconds - 1e9 * timed.time_s).max() <= 0.5 + 1e-6


# --- JBI: pseudo instructions before //INST, instructions after it


class Job:
    """A job in INFORM, parsed from its text."""

    def __init__(self, text: str):
        assert text.endswith("\r\n") and text.isascii()
        lines = text.split("\r\n")[:-1]
        assert lines[0] == "/JOB" and lines[-1] == "END"
        at = lines.index("//INST")
        begin = lines.index("NOP")
        self.positions, self.forms, self.fields, flags = {}, [], {}, None
        for line in lines[1:at] + lines[at + 1 : begin]:
            if found := re.fullmatch(r"(C|BC|EC)(\d{5})=(.*)", line):
                assert int(found[2]) == sum(key.rstrip("0123456789") == found[1] for key in self.positions)
                self.positions[found[1] + found[2]] = [float(cell) for cell in found[3].split(",")]
                self.forms.append(flags)
            elif line.startswith("///RCONF "):
                flags = [int(cell) for cell in line[9:].split(",")]
                assert len(flags) == 24
            else:
                key, _, value = line.lstrip("/").partition(" ")
                self.fields[key] = value
        kinds = [key.rstrip("0123456789") for key in self.positions]
        assert self.fields["NPOS"] == ",".join(str(kinds.count(kind)) for kind in ("C", "BC", "EC", "P", "BP", "EX"))
        self.remarks = [line[1:] for line in lines[begin:-1] if line.startswith("'")]
        assert not any(re.search(r"-0(\.0+)?(,|$)", line) for line in lines if "=" in line)  # no minus zero
        self.moves = [line.split() for line in lines[begin + 1 : -1] if not line.startswith("'")]
        assert all(len(remark) <= 32 for remark in self.remarks)

    def array(self, kind: str = "C") -> np.ndarray:
        """Positions of a kind in the order of their instructions."""
        names = [name for move in self.moves for name in move if re.fullmatch(rf"{kind}\d{{5}}", name)]
        assert len(names) == len(self.moves)
        return np.array([self.positions[name] for name in names])


@FEW
@given(motions(), st.data())
def test_pulses_read_back_to_half_a_pulse(timed, data):
    N = len(timed.joint_names)
    table = np.array(data.draw(st.lists(st.sampled_from([85000.5, -73000.0, 1e6]), min_size=N, max_size=N)))
    zero = np.linspace(-1, 1, N)
    pulses = EncoderScale(table, zero, "a drawing")
    job = Job(program_text("jbi-pulses", timed, controller(timed, pulses=pulses, tool=4)))
    assert (job.fields["TOOL"], job.fields["POSTYPE"], job.fields["NAME"]) == ("4", "PULSE", "WELD")
    assert (np.abs(job.array() / table + zero - timed.x) <= 0.5 / np.abs(table) + 1e-15).all()
    assert {move[0] for move in job.moves} == {"MOVJ"}


GROUPS = JointGroups(robot=(7, 3, 4, 5, 6, 2), base=(8,), station=(1, 0))


def test_a_job_holds_each_joint_in_its_group_and_each_group_at_its_own_speed():
    timed = a_motion(9)
    pulses = EncoderScale(np.linspace(1e5, 2e5, 9), np.zeros(9), "a drawing")
    job = Job(program_text("jbi-pulses", timed, controller(timed, pulses=pulses, groups=GROUPS, speed=np.full(9, 2.0))))
    assert (job.fields["GROUP1"], job.fields["GROUP2"]) == ("RB1,BS1", "ST1")
    for kind, columns in zip(("C", "BC", "EC"), map(list, GROUPS), strict=True):
        read = job.array(kind) / pulses.per_unit[columns]
        assert (np.abs(read - timed.x[:, columns]) <= 0.5 / pulses.per_unit[columns] + 1e-15).all()
    # the station's |dx| = 0.02 rad in 0.1 s: a tenth of 2 rad/s; the robot's is that of column 2 or 8
    assert job.moves[0] == ["MOVJ", "C00000", "BC00000", "VJ=1.00", "+MOVJ", "EC00000", "VJ=1.00"]
    assert job.moves[2] == ["MOVJ", "C00002", "BC00002", "VJ=6.25", "PL=0", "+MOVJ", "EC00002", "VJ=10.00"]


# --- RAPID: MoveAbsJ ToJointPos \NoEOffs, Speed \T, Zone, Tool; ToJointPos is [robax, extax] of six axes each


def read_rapid(text: str) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Robot axes, connected external axes, and times from configuration to configuration."""
    number, lines = r"(-?\d+\.\d+|9E9)", [line.strip() for line in text.splitlines()]
    name = re.fullmatch(r"MODULE ([A-Za-z]\w{0,25})Module", lines[0])[1]
    lines = [line for line in lines if not line.startswith("!")]
    assert lines[1] == f"PROC {name}()" and lines[-2:] == ["ENDPROC", "ENDMODULE"]
    axes = r"\[" + ",".join([number] * 6) + r"\]"
    call = re.compile(rf"MoveAbsJ \[{axes},{axes}\]\\NoEOffs,v\d+(?:\\T:=(\d+\.\d+))?,(z0|fine),(\w+);")
    found = [call.fullmatch(line).groups() for line in lines[2:-2]]
    assert found[0][13] == found[-1][13] == "fine"
    values = np.array([each[:12] for each in found], float)
    external = values[:, 6:][:, values[0, 6:] != 9e9]
    assert (values[:, 6 + external.shape[1] :] == 9e9).all() and found[0][12] is None
    return values[:, :6], external, [float(each[12]) for each in found[1:]]


@FEW
@given(motions(joints=9))
def test_rapid_reads_back_to_half_a_microdegree_and_half_a_nanometre_with_its_times(timed):
    slides = tuple(k == 8 for k in range(9))
    x, external, seconds = read_rapid(program_text("rapid", timed, controller(timed, groups=GROUPS, slides=slides)))
    assert np.abs(x - np.degrees(timed.x[:, list(GROUPS.robot)])).max() <= 0.5e-6 + 1e-12
    assert np.abs(external[:, 0] - 1e3 * timed.x[:, 8]).max() <= 0.5e-6 + 1e-12
    assert np.abs(external[:, 1:] - np.degrees(timed.x[:, [1, 0]])).max() <= 0.5e-6 + 1e-12
    assert np.abs(np.array(seconds) - np.diff(timed.time_s)).max(initial=0.0) <= 0.5e-6 + 1e-12


def test_rapid_stops_where_the_motion_stops_and_passes_its_other_configurations():
    for speed, zone in ((0.1, "z0"), (0.0, "fine")):
        timed = a_motion()
        timed = timed._replace(velocity=np.full_like(timed.x, speed))
        text = program_text("rapid", timed, controller(timed))
        assert re.findall(",(z0|fine),", text) == ["fine", zone, "fine"]


def test_a_coupled_axis_of_rapid_is_the_sum_of_both_joints():
    timed = a_motion()
    x, _, _ = read_rapid(program_text("rapid", timed, controller(timed, coupled=((2, 1),))))
    summed = timed.x.copy()
    summed[:, 2] += summed[:, 1]
    assert np.abs(x - np.degrees(summed)).max() <= 0.5e-6 + 1e-12


def test_rapid_gives_the_planned_tcp_as_a_pose_and_asks_for_a_tool_that_can_be_set():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    T[:3, 3] = 0.0, 0.01, 0.5
    timed = a_motion()
    predefined, named = (
        program_text("rapid", timed, controller(timed, tcp=PlannedTcp("the flange", T), tool_name=name))
        for name in (None, "torch")
    )
    for text in (predefined, named):
        numbers = re.search(r"planned TCP is \[(\[.*?\]),(\[.*?\])\] in the frame of the flange", text).groups()
        position_mm, quaternion = map(json.loads, numbers)
        assert position_mm == [0, 10, 500] and np.allclose(quaternion, [0.5**0.5, 0.5**0.5, 0, 0], atol=1e-6)
    assert "tool0 is at the flange and cannot be set" in predefined
    assert "torch must have it" in named and ",fine,torch;" in named and "tool0" not in named


@FEW
@given(motions(joints=6), st.data())
def test_rectan_reads_back_to_half_of_its_last_digits(timed, data):
    n = len(timed.x)
    angles = data.draw(of_numpy.arrays(float, (n, 3), elements=st.floats(-180, 180) | st.sampled_from([90.0, -90.0])))
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    T[:, :3, 3] = data.draw(of_numpy.arrays(float, (n, 3), elements=st.floats(-4, 4)))
    flags = np.array(data.draw(st.lists(st.tuples(*[st.integers(0, 1)] * 6), min_size=n, max_size=n)))
    job = Job(program_text("jbi", timed, controller(timed, user_frame=UserFrame(7, T, flags), tool=2)))
    assert [job.fields[key] for key in ("USER", "TOOL", "POSTYPE", "FRAME")] == ["7", "2", "USER", "USER 7"]
    assert job.forms == [[*row, *[0] * 18] for row in flags.tolist()]
    read = job.array()
    assert np.abs(read[:, :3] - 1e3 * T[:, :3, 3]).max() <= 0.5e-3 + 1e-9
    turned = Rotation.from_matrix(T[:, :3, :3]).inv() * Rotation.from_euler("xyz", read[:, 3:], degrees=True)
    assert np.degrees(turned.magnitude()).max() <= 3 * 0.5e-4 + 1e-6  # three angles, half a digit each


def test_a_jobs_speeds_are_those_of_the_motion():
    timed = a_motion()
    T = np.tile(np.eye(4), (3, 1, 1))
    T[1, 0, 3] = 0.002  # 2 mm in 0.1 s
    frame = UserFrame(1, T, np.zeros((3, 6), int))
    given = controller(timed, user_frame=frame, speed=np.full(6, 2.0), date=datetime.datetime(2024, 5, 6, 7, 8))
    job = Job(program_text("jbi", timed, given))
    # |dx| = 0.02 rad in 0.1 s: a tenth of 2 rad/s
    assert job.moves == [
        ["MOVJ", "C00000", "VJ=1.00"],
        ["MOVL", "C00001", "V=20.0"],
        ["MOVJ", "C00002", "VJ=10.00", "PL=0"],
    ]
    assert job.fields["DATE"] == "2024/05/06 07:08"


# --- URScript: calls of one function


def read_urscript(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and times from the first: movej(q, a, v), then servoj(q, a, v, t, lookahead_time, gain)."""
    lines = [line.strip() for line in text.splitlines() if not line.startswith("#")]
    name = re.fullmatch(r"def (\w+)\(\):", lines[0])[1]
    assert lines[-3:] == ["stopj(1.0)", "end", f"{name}()"]
    configurations, times = [], [0.0]
    for line in lines[1:-3]:
        call, inside, rest = re.fullmatch(r"(\w+)\(\[(.*)\], (.*)\)", line).groups()
        numbers = [float(cell) for cell in rest.split(",")]
        assert (call, len(numbers)) == (("servoj", 5) if configurations else ("movej", 2))
        configurations.append([float(cell) for cell in inside.split(",")])
        if call == "servoj":
            _, _, t, lookahead, gain = numbers
            assert 0.03 <= lookahead <= 0.2 and 100 <= gain <= 2000  # the manual's ranges
            times.append(times[-1] + t)
    return np.array(configurations), np.array(times)


@FEW
@given(motions(joints=6))
def test_urscript_reads_back_to_half_a_microradian_at_the_same_times(timed):
    x, times = read_urscript(program_text("urscript", timed, controller(timed)))
    assert np.abs(x - timed.x).max() <= 0.5e-6 + 1e-15
    assert np.abs(times - timed.time_s).max() <= 1e-9


# --- MuJoCo reads its own


def test_mujoco_reads_the_keyframes_to_half_a_nanoradian_with_the_built_in_arm():
    timed = a_motion()._replace(x=np.random.default_rng(0).uniform(-1, 1, (3, 6)))
    model = GP50.read_text().replace("</mujoco>", '<include file="weld.xml"/></mujoco>')
    model = mujoco.MjModel.from_xml_string(
        model, {"weld.xml": program_text("keyframes", timed, controller(timed)).encode()}
    )
    for found, written in ((model.key_time, timed.time_s), (model.key_qpos, timed.x), (model.key_qvel, timed.velocity)):
        np.testing.assert_allclose(found, written, rtol=0, atol=HALF_NANO)
    assert [model.key(k).name for k in range(3)] == ["0_transfer", "1_process", "2_retract"]


# --- all of them


def table_of(joints: int) -> EncoderScale:
    return EncoderScale(np.full(joints, 1e4), np.zeros(joints), "a drawing")


def whole(timed: TimedMotion) -> ControllerData:
    """Controller data with all that any format needs."""
    frame = UserFrame(1, np.tile(np.eye(4), (len(timed.x), 1, 1)), np.zeros((len(timed.x), 6), int))
    return controller(timed, user_frame=frame, pulses=table_of(timed.x.shape[1]))


@pytest.mark.parametrize("format", FORMATS)
def test_every_file_says_what_it_does_not_hold(format):
    text = program_text(format, a_motion(), whole(a_motion()))
    said = re.sub(r"\s+", " ", re.sub(r"( ;)?\r\n *(\d+: +!|[';])", " ", text))
    for what in ("tool data", "frames", "signals", "safety", "not proven clear"):
        assert what in said, what


@pytest.mark.parametrize("format", ["jbi-pulses", "rapid", "krl", "ls", "urscript"])
def test_joint_values_for_a_controller_come_with_the_advice_to_check_its_axes(format):
    text = program_text(format, a_motion(), whole(a_motion()))
    assert "check signs, zeros and coupled axes (parallel linkages)" in re.sub(
        r"\s+", " ", re.sub(r"( ;)?\r\n *(\d+: +!|[';])", " ", text)
    )


@pytest.mark.parametrize("format", FORMATS)
def test_a_file_depends_on_its_motion_alone(format):
    assert program_text(format, a_motion(), whole(a_motion())) == program_text(format, a_motion(), whole(a_motion()))


SEAMS = (SeamSpan("rib", 0, 1), SeamSpan("boss", 2, 2))
OUTPUTS = ProcessOutputs(on=((5, True), (6, False)), off=((5, False),))


@pytest.mark.parametrize(
    ("format", "words"),
    [
        ("jbi", ("DOUT OT#(5) ON", "DOUT OT#(6) OFF", "DOUT OT#(5) OFF")),
        ("jbi-pulses", ("DOUT OT#(5) ON", "DOUT OT#(6) OFF", "DOUT OT#(5) OFF")),
        ("rapid", ("SetDO do5,1;", "SetDO do6,0;", "SetDO do5,0;")),
        ("krl", ("$OUT[5]=TRUE", "$OUT[6]=FALSE", "$OUT[5]=FALSE")),
        ("ls", ("DO[5]=ON", "DO[6]=OFF", "DO[5]=OFF")),
        ("urscript", tuple(f"set_standard_digital_out({k}, {v})" for k, v in ((5, True), (6, False), (5, False)))),
    ],
)
def test_outputs_are_off_before_any_motion_and_set_after_the_moves_to_both_ends_of_a_seam(format, words):
    """A seam of one point sets both."""
    text = program_text(format, a_motion(), whole(a_motion())._replace(seams=SEAMS, process=OUTPUTS))
    lines = [re.sub(r"^ *\d+: *| ;$", "", line).strip() for line in text.splitlines()]
    moves = ("MOVJ", "MOVL", "MoveAbsJ", "PTP", "J P", "movej", "servoj")
    short = ["move" if line.startswith(moves) else line for line in lines if line.startswith((*moves, *words))]
    on, off = list(words[:2]), [words[2]]
    assert short == [*off, "move", *on, "move", *off, "move", *on, *off]
    assert "other signals than those of program.process" in re.sub(
        r"\s+", " ", re.sub(r"( ;)?\r\n *(\d+: +!|[';])", " ", text)
    )


NO_CONFIGURATION = TimedMotion(*(column[:0] for column in a_motion()[:6]), a_motion().joint_names)
RAPID, URSCRIPT = ("ENDPROC", "endproc", "Proc", "TEST", "MoveAbsJ", "v50", "fine"), ("end", "sec", "True", "movej")
SHORT = a_motion()._replace(time_s=np.array([0.0, 1e-9, 0.2]))
STILL = a_motion()._replace(time_s=np.array([0.0, 0.2, 0.2]))
OFF_STEP = a_motion()._replace(time_s=np.array([0.0, 0.1, 0.2013]))
FRAME_0 = whole(a_motion()).user_frame._replace(number=0)
MANY = TimedMotion(*(np.repeat(column, 4000, axis=0) for column in a_motion()[:6]), a_motion().joint_names)
MANY = MANY._replace(time_s=np.arange(12000.0))


@pytest.mark.parametrize(
    ("format", "timed", "given", "said"),
    [
        ("gcode", a_motion(), {}, "'gcode' is not a program format; valid: csv, ros, ros-json, jbi, jbi-pulses"),
        ("csv", NO_CONFIGURATION, {}, "the motion has no configurations"),
        ("csv", STILL, {}, "the time of configuration 2 is not later"),
        ("jbi", a_motion(), {"user_frame": None}, "set program.user_frame"),
        ("jbi", a_motion(), {"user_frame": FRAME_0}, "user frame 0; valid: 1 to 63"),
        ("jbi", a_motion(7), {}, "an arm of 7 joints; RECTAN positions need 6"),
        ("jbi", a_motion(), {"name": "Größe"}, "job name 'Größe' is not valid"),
        ("jbi", a_motion(), {"speed": None}, "set program.velocity"),
        (
            "jbi-pulses",
            a_motion(),
            {"speed": np.array([1, 1, 1, 1, 1, np.inf])},
            "set program.velocity",
        ),
        ("jbi-pulses", a_motion(), {"speed": np.full(6, 0.1)}, "j0 at 200.0 % of its full speed"),
        ("jbi-pulses", a_motion(), {"pulses": None}, "the encoder scale is missing; set program.pulses"),
        ("jbi-pulses", a_motion(), {"pulses": table_of(5)}, "5 values for 6 joints"),
        ("jbi-pulses", a_motion(9), {}, "an arm of 9 joints"),
        ("rapid", a_motion(7), {}, "a robot of 7 joints; robjoint needs 6"),
        ("rapid", a_motion(), {"slides": (True, *[False] * 5)}, "j0 is a slide joint; put it into program.groups.base"),
        ("rapid", a_motion(13), {"groups": JointGroups(GROUPS.robot, (0, 1, 8), (9, 10, 11, 12))}, "7 external axes"),
        ("rapid", a_motion(), {"tool_name": "2 tools"}, "program.tool_name '2 tools' is not valid"),
        ("rapid", a_motion(), {"name": "2 welds"}, "procedure name '2 welds' is not valid"),
        *(("rapid", a_motion(), {"name": word}, f"name {word!r} is a word of the language") for word in RAPID),
        (
            "rapid",
            a_motion(),
            {"name": "torch", "tool_name": "Torch"},
            "name 'torch' is a word of the language, or used",
        ),
        ("rapid", a_motion(), {"tool_name": "Pers"}, "program.tool_name 'Pers' is a word of the language"),
        ("krl", a_motion(7), {}, "a robot of 7 joints; E6AXIS has 6; set program.groups for external axes"),
        ("krl", a_motion(), {"slides": (True, *[False] * 5)}, "j0 is a slide joint; put it into program.groups.base"),
        ("krl", a_motion(13), {"groups": JointGroups(GROUPS.robot, (0, 1, 8), (9, 10, 11, 12))}, "7 external axes"),
        ("krl", a_motion(), {"name": "2 welds"}, "procedure name '2 welds' is not valid"),
        ("krl", a_motion(), {"name": "EndFor"}, "name 'EndFor' is a word of the language"),
        ("krl", a_motion(), {"speed": None}, "krl: the full joint speeds are missing; set program.velocity"),
        ("krl", a_motion(), {"speed": np.full(6, 0.1)}, "j0 at 200.0 % of its full speed"),
        *(
            (format, a_motion(), {"seams": SEAMS, "process": ProcessOutputs((("gun", True),))}, said)
            for format, said in (
                ("krl", "krl: program.process names the output 'gun'; valid: its number"),
                ("ls", "ls: program.process names the output 'gun'; valid: its number"),
                ("jbi-pulses", "jbi-pulses: program.process names the output 'gun'"),
                ("urscript", "urscript: program.process names the output 'gun'"),
            )
        ),
        (
            "urscript",
            a_motion(),
            {"seams": SEAMS, "process": ProcessOutputs(((9, True),))},
            "urscript: output 9; the standard digital outputs are 0 to 7",
        ),
        (
            "rapid",
            a_motion(),
            {"seams": SEAMS, "process": ProcessOutputs((("2 guns", True),))},
            "rapid: output '2 guns' is not valid",
        ),
        *(("urscript", a_motion(), {"name": word}, f"name {word!r} is a word of the language") for word in URSCRIPT),
        ("jbi-pulses", MANY, {}, "but a job has at most 9,999; use a path with fewer points"),
        ("urscript", a_motion(7), {}, "an arm of 7 joints, 0 of which slide"),
        ("urscript", a_motion(), {"slides": (True, *[False] * 5)}, "1 of which slide"),
        ("urscript", a_motion(), {"name": "2 welds"}, "function name '2 welds' is not valid"),
        ("urscript", OFF_STEP, {}, "a configuration at 0.2013 s; times must be multiples of the controller's 0.002 s"),
    ],
)
def test_what_a_format_cannot_hold_is_one_line_that_names_it(format, timed, given, said):
    with pytest.raises(InputError) as caught:
        program_text(format, timed, whole(timed)._replace(**given))
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_no_move_of_a_rapid_program_has_a_time_of_0():
    found = re.findall(r"T:=([0-9.]+)", program_text("rapid", SHORT, whole(SHORT)))
    assert found == ["0.000001", "0.200000"]
