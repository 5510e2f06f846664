"""Joint limits in files such as MoveIt's joint_limits.yaml: what is used, refused, and named in one line."""

import math

import numpy as np
import pytest
import toy

from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import load_robot, read_joint_limits
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import robot_of
from htcp_jax.motion import Motion
from htcp_jax.status import Kind
from htcp_jax.trajectory import check_ranges, limits_of_job
from htcp_jax.trajectory.limits import joint_limits
from htcp_jax.validation.mujoco_arm import MujocoArm

JOINTS = "j1", "j2", "j3", "j4"
NARROW = """
joint_limits:
  j1: {has_position_limits: true, min_position: -0.2, max_position: 0.3, max_velocity: 1.5, max_jerk: 40}
  j2: {has_velocity_limits: true, max_velocity: 2.0}
  j3: {has_position_limits: false, min_position: -1, max_position: 1, max_velocity: 1.0}
  j4: {min_position: -1.0, max_velocity: 3}
"""


@pytest.fixture
def folder(tmp_path):
    """Folder with the model file of the toy arm."""
    (tmp_path / "toy.xml").write_text(toy.ARM)
    return tmp_path


def read(folder, text: str, joints=JOINTS):
    (folder / "joint_limits.yaml").write_text(text)
    return read_joint_limits(folder / "joint_limits.yaml", joints, "toy")


def ranges(folder, text: str):
    """Ranges of the toy arm's joints by a file (4, 2)."""
    robot = toy.robot()
    return np.stack(read(folder, text).ranges(robot.slides, np.asarray(robot.lower), np.asarray(robot.upper)), axis=1)


def test_a_range_in_the_file_replaces_the_model_s_and_without_one_the_model_s_remains(folder):
    model = np.stack([toy.robot().lower, toy.robot().upper], axis=1)
    expected = [[-0.2, 0.3], model[1], model[2], [-1.0, model[3, 1]]]
    np.testing.assert_array_equal(ranges(folder, NARROW), expected)


@pytest.mark.parametrize(
    "wrapped",
    [
        "/**: {ros__parameters: {robot_description_planning: {joint_limits: {j1: {max_velocity: 1.5}}}}}",
        "move_group:\n  ros__parameters:\n    joint_limits:\n      j1: {max_velocity: 1.5}\n",
        "robot_description_planning: {joint_limits: {j1: {max_velocity: 1.5}}}",
    ],
)
def test_the_section_may_be_inside_those_of_ros(folder, wrapped):
    np.testing.assert_array_equal(read(folder, wrapped).rates("velocity"), [1.5, np.nan, np.nan, np.nan])


@pytest.mark.parametrize(
    "angle", ["!degrees -90", "!radians -1.5707963267948966", "deg(-90)", "rad(-1.5707963267948966)"]
)
def test_an_angle_may_have_a_unit(folder, angle):
    stated = read(folder, f"joint_limits:\n  j1: {{min_position: {angle}}}\n").stated[0]
    assert stated.lower == pytest.approx(-math.pi / 2, abs=1e-15)


def test_a_position_far_beyond_a_million_is_no_limit(folder):
    found = ranges(folder, "joint_limits: {j1: {min_position: -1.0e16, max_position: .inf}}")
    assert found[0].tolist() == [-np.inf, np.inf]


REFUSED = {
    "another file": ("a: 1", "the mapping joint_limits is missing"),
    "two sections": ("a: {joint_limits: {j1: {}}, b: {joint_limits: {}}}", "joint_limits occurs 2 times"),
    "a joint twice": ("joint_limits: {j1: {max_velocity: 1}, j1: {max_velocity: 2}}", "key 'j1' is repeated"),
    "no such joint": ("joint_limits: {a1: {max_velocity: 1}}", "no joint of toy is listed; valid: j1, j2, j3, j4"),
    "no limit": ("joint_limits: {j1: {}}", "limits no joint of toy; add min_position"),
    "no mapping": ("joint_limits: {j1: 3}", "joint j1 must be a mapping"),
    "yes": ("joint_limits: {j1: {has_position_limits: yes, min_position: 1}}", "is 'yes'; valid: true, false"),
    "a missing end": (
        "joint_limits: {j1: {has_position_limits: true, min_position: 1}}",
        "has_position_limits of joint j1 is true, but max_position is missing",
    ),
    "a missing rate": ("joint_limits: {j1: {has_jerk_limits: true}}", "max_jerk is missing"),
    "no value": ("joint_limits: {j1: {max_velocity: }}", "max_velocity of joint j1 is None"),
    "not a number": ("joint_limits: {j1: {min_position: .nan}}", "min_position of joint j1 is nan; write a number"),
    "an expression": ("joint_limits: {j1: {min_position: rad(pi/2)}}", "is 'rad(pi/2)'; write a number"),
    "another unit": ("joint_limits: {j1: {min_position: !foot 2}}", "tag !foot is not allowed"),
    "a word with a unit": ("joint_limits: {j1: {min_position: !degrees x}}", "!degrees x is not a number"),
    "an underscore": ("joint_limits: {j1: {min_position: !degrees 1_0}}", "!degrees 1_0 is not a number"),
    "degrees": (
        "joint_limits: {j1: {min_position: -170, max_position: 170}}",
        "min_position of joint j1 is -170 rad, which seems to be in degrees; write !degrees -170, or -2.96706",
    ),
    "descending": ("joint_limits: {j1: {min_position: 1, max_position: 0.5}}", "joint j1 has range 1 to 0.5"),
    "empty": ("joint_limits: {j1: {min_position: 1, max_position: 1}}", "min_position must be less than max_position"),
    "outside the model": ("joint_limits: {j1: {min_position: 3}}", "joint j1 has range 3 to 2.96706"),
    "cut": ("joint_limits: {j1: {max_velocity: 1}", "expected ',' or '}'"),
}


@pytest.mark.parametrize(("text", "line"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_meant_is_refused_in_one_line(folder, text, line):
    with pytest.raises(InputError) as caught:
        ranges(folder, text)
    assert line in str(caught.value) and str(caught.value).count("\n") == 0 and "joint_limits.yaml" in str(caught.value)


def test_a_slide_in_millimetres_is_refused(folder):
    stated = read(folder, "joint_limits: {rail: {min_position: 0, max_position: 4000}}", ("rail",))
    with pytest.raises(InputError, match="4000 m, which seems to be in millimetres; write 4"):
        stated.ranges([True], np.array([0.0]), np.array([3.0]))


NAMED = {
    "a scaling factor": ("default_velocity_scaling_factor: 0.1\n", "", "not used: default_velocity_scaling_factor"),
    "a mistyped key": ("", ", max_postion: 1", "not used: max_postion of j1"),
    "an effort": ("", ", has_effort_limits: true, max_effort: 80", "not used: max_effort of j1"),
    "a limit that is off": ("", ", has_jerk_limits: false, max_jerk: 9", "not used: max_jerk of j1"),
    "other joints": ("", "}, gripper: {max_velocity: 0", "not joints of the arm: gripper"),
    "a wider range": ("", ", max_position: 3.1", "wider than the model: j1 -2.96706 to 3.1 (the model's: -2.96706 to"),
    "joints without a range": ("", "", "the model's ranges apply to j1, j2"),
    "joints that are not listed": ("", "", "all limits of the model apply to j3, j4"),
    "degrees per second": ("", "}, j2: {max_velocity: 180", "velocities are up to 180; write !degrees 180 if"),
}


@pytest.mark.parametrize(("limit", "slide", "line"), [
    ("!degrees 50", True, "limits of joint j1 are degrees or radians, but it moves in m"),
    ("rad(0.5)", True, "limits of joint j1 are degrees or radians, but it moves in m"),
    ("!millimeters 50", False, "limits of joint j1 are lengths, but it moves in rad"),
])  # fmt: skip
def test_a_unit_of_another_kind_of_joint_is_refused(folder, limit, slide, line):
    stated = read(folder, f"joint_limits: {{j1: {{max_velocity: {limit}}}}}\n")
    with pytest.raises(InputError, match=line):
        stated.ranges([slide] * 4, np.full(4, -1.0), np.ones(4))


@pytest.mark.parametrize(("above", "entry", "line"), NAMED.values(), ids=NAMED)
def test_what_is_not_used_or_remains_the_model_s_is_named_in_one_line(folder, above, entry, line):
    second = "" if "j2" in entry else ", j2: {max_velocity: 1}"
    text = f"{above}joint_limits: {{j1: {{max_velocity: 1{entry}}}{second}}}\n"
    note = read(folder, text).note((np.asarray(toy.robot().lower), np.asarray(toy.robot().upper)))
    assert line in note and "\n" not in note


def test_a_limit_faster_than_the_model_s_is_named(folder):
    text = "joint_limits: {j1: {max_velocity: 2}, j2: {max_velocity: 1}, j3: {}, j4: {}}\n"
    assert read(folder, text).note(speed=np.array([1.5, 1.5, 1.5, 1.5])) == (
        f"{folder / 'joint_limits.yaml'}: faster than the model: j1 2 (the model's: 1.5)"
    )


def test_a_complete_file_within_the_model_needs_no_line(folder):
    entries = "".join(f"  {name}: {{min_position: -1, max_position: 1, max_velocity: 1}}\n" for name in JOINTS)
    robot = toy.robot()
    note = read(folder, f"joint_limits:\n{entries}").note((np.asarray(robot.lower), np.asarray(robot.upper)))
    assert note is None


def test_a_last_line_without_an_end_is_named(folder):
    text = "joint_limits:\n  j1:\n    max_velocity: 2."
    assert "the last line has no line end" in read(folder, text).note()


def test_motions_may_leave_a_range_that_the_file_does_not_state(folder):
    robot, stated = toy.robot(), read(folder, "joint_limits: {j1: {max_position: 1}, j2: {max_velocity: 1}}\n")
    kind = np.array([Kind.PROCESS] * 2)
    wider = Motion(np.array([np.asarray(robot.lower) - 0.1, np.zeros(4)]), np.arange(2), kind)
    check_ranges(stated, robot, wider, "plan")
    with pytest.raises(InputError, match=r"joint j1 reaches 1\.1 rad at target 1, .* allows 1; "):
        check_ranges(stated, robot, wider._replace(x=np.array([np.zeros(4), [1.1, 0, 0, 0]])), "plan")


def test_planner_and_validator_have_the_same_ranges(folder):
    (folder / "joint_limits.yaml").write_text(NARROW)
    file = str(folder / "joint_limits.yaml")
    with pytest.warns(Note, match="the model's ranges apply to j2, j3"):
        robot = load_robot(folder / "toy.xml", limits=file)
    arm = MujocoArm(folder / "toy.xml", limits=file)
    np.testing.assert_array_equal([arm.lower, arm.upper], [robot.lower, robot.upper])
    assert robot.lower[0] == -0.2


@pytest.fixture
def job(folder):
    """Job whose limits are in a file next to it."""
    (folder / "joint_limits.yaml").write_text(NARROW)
    (folder / "job.yaml").write_text(
        "robot: {model: toy.xml, limits: joint_limits.yaml}\nstart_rad: [0, 0, 1.7, 0.5]\n"
    )
    return load_config(folder / "job.yaml")


def test_a_job_names_the_file_relative_to_its_own_folder(job, folder):
    assert job.robot.limits == str(folder / "joint_limits.yaml")
    with pytest.warns(Note):
        assert float(robot_of(job.robot).upper[0]) == 0.3


def test_programs_of_the_job_keep_the_file_s_rates_but_its_own_section_precedes_them(job, folder):
    with pytest.warns(Note):
        robot = robot_of(job.robot)
    stated = limits_of_job(job, robot)
    limits = joint_limits(robot, job.program, stated)
    assert limits.velocity.tolist() == [1.5, 2.0, 1.0, 3.0] and limits.jerk[0] == 40
    own = load_config(folder / "job.yaml", ["program.velocity=[0.1, 0.2, 0.3, 0.4]"]).program
    assert joint_limits(robot, own, stated).velocity.tolist() == [0.1, 0.2, 0.3, 0.4]


@pytest.mark.parametrize("name", ["arm.urdf", "simulaton", "arm.srdf", "limits.txt"])
def test_another_source_of_limits_is_refused_with_the_valid_ones(folder, name):
    (folder / "job.yaml").write_text(f"robot: {{model: toy.xml, limits: {name}}}\nstart_rad: [0, 0, 1.7, 0.5]\n")
    valid = "valid: simulation, datasheet, model, or a YAML file such as MoveIt's joint_limits.yaml"
    with pytest.raises(InputError, match=f"'{name}' is not a source of joint limits; {valid}"):
        load_config(folder / "job.yaml")


def test_a_file_with_another_ending_is_refused_wherever_it_is_named(folder):
    (folder / "limits.txt").write_text(NARROW)
    with pytest.raises(InputError, match=r"limits\.txt is not a file with joint limits; valid: a YAML file such as"):
        read_joint_limits(folder / "limits.txt", JOINTS, "toy")
