"""Motions read back from files of this package, and the interpolation between their configurations."""

import itertools
import re

import numpy as np
import pytest
from motion_files import NAMES, controller, followed, hinged, railed, random_motion, read_text, with_followers, write
from scipy.interpolate import BPoly

from htcp_jax.errors import InputError
from htcp_jax.io.motions import MOTION_FORMATS, MotionFile, controller_of, polynomials, read_motion
from htcp_jax.jobs import load_config
from htcp_jax.motion import Motion
from htcp_jax.runs.plan_folder import write_motion_csv
from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import JointGroups

FILES = 50
DECIMAL = ("csv", "ros", "ros-json", "keyframes")  # joint values with nine decimals
HALF_NANO = 0.5001e-9
ROUNDING = {"rapid": np.radians(0.5e-6), "urscript": 0.5e-6}  # half of the last digit [rad]
SLACK = 1e-14  # rounding of the conversions of units


def read_back(format, robot, seed, folder, **given):
    """A random motion, and the motion in its file."""
    timed = random_motion(robot, seed)
    own = controller(robot, NAMES[seed % len(NAMES)], **given)
    every = with_followers(robot, timed) if format == "keyframes" or (format in DECIMAL and seed % 2) else timed
    return timed, read_motion(write(folder, format, every, own), robot, own)


# --- round trips


@pytest.mark.parametrize("arm", [hinged, railed, followed])
@pytest.mark.parametrize("format", DECIMAL)
def test_a_file_with_nine_decimals_reads_back_to_half_a_unit_of_the_last_one(format, arm, tmp_path):
    for seed in range(FILES):
        timed, found = read_back(format, arm(), seed, tmp_path)
        names = "time_s", "x", "velocity", *([] if format == "keyframes" else ["acceleration"])
        for name in names:
            np.testing.assert_allclose(getattr(found, name), getattr(timed, name), rtol=1e-15, atol=HALF_NANO)
        assert (found.format, found.corner_m) == (format, None)
        assert format != "keyframes" or found.acceleration is None
        if format in ("csv", "keyframes"):
            assert found.kind == tuple(Kind(kind).name for kind in timed.kind)


@pytest.mark.parametrize("arm", [hinged, railed, followed])
def test_pulses_read_back_to_half_a_pulse_in_all_groups(arm, tmp_path):
    for seed in range(FILES):
        timed, found = read_back("jbi-pulses", arm(), seed, tmp_path)
        allowed = 0.5 / np.abs(controller(arm()).pulses.per_unit)
        assert (found.format, found.time_s) == ("jbi-pulses", None)
        assert (np.abs(found.x - timed.x) <= allowed + SLACK).all()


@pytest.mark.parametrize(
    ("arm", "coupled"), [(hinged, ()), (railed, ()), (hinged, ((2, 1),)), (hinged, ((2, 1), (3, 2), (5, 0)))]
)
def test_rapid_reads_back_to_half_a_microdegree_and_half_a_nanometre_with_times_zones_and_sums(arm, coupled, tmp_path):
    robot = arm()
    allowed = np.where(robot.sliding, 0.5e-9, ROUNDING["rapid"])
    for axis, joint in coupled:
        allowed[axis] += allowed[joint]
    for seed in range(FILES):
        timed, found = read_back("rapid", robot, seed, tmp_path, coupled=coupled)
        assert (np.abs(found.x - timed.x) <= allowed + SLACK).all()
        if len(timed.x) > 1:
            assert np.abs(found.time_s - timed.time_s).max() <= 0.5e-6 * len(timed.x)
        if len(timed.x) > 2:
            assert found.corner_m.tolist() == [0.0, *[3e-4] * (len(timed.x) - 2), 0.0]
        else:
            assert found.corner_m is None


def test_urscript_reads_back_to_half_a_microradian_at_the_same_times(tmp_path):
    for seed in range(FILES):
        timed, found = read_back("urscript", hinged(), seed, tmp_path)
        assert np.abs(found.x - timed.x).max() <= ROUNDING["urscript"] + SLACK
        assert len(timed.x) == 1 or np.abs(found.time_s - timed.time_s).max() <= 1e-9
        assert any("tracking_rad" in note for note in found.notes) == (len(timed.x) > 1)


@pytest.mark.parametrize("arm", [hinged, followed])
def test_the_motion_in_a_plans_folder_reads_back_exactly_with_its_kinds_and_no_times(arm, tmp_path):
    for seed in range(FILES):
        timed = random_motion(arm(), seed)
        file = tmp_path / "motion.csv"
        write_motion_csv(file, arm(), Motion(timed.x, timed.target, timed.kind))
        found = read_motion(file, arm(), controller(arm()))
        assert found.x.tolist() == timed.x.tolist()
        assert (found.time_s, found.interpolation) == (None, "linear")
        assert found.kind == tuple(Kind(kind).name for kind in timed.kind)


@pytest.mark.parametrize("format", ["csv", "ros", "rapid", "krl", "ls", "urscript", "jbi-pulses", "keyframes"])
def test_each_configuration_has_its_line_in_the_file(format, tmp_path):
    timed, own = random_motion(hinged(), 3), controller(hinged())
    file = write(tmp_path, format, timed, own)
    lines = file.read_text().splitlines()
    found = [lines[k - 1] for k in read_motion(file, hinged(), own).line.tolist()]
    begin = {
        "ros": "- positions",
        "rapid": "MoveAbsJ",
        "krl": "PTP",
        "ls": "J",
        "jbi-pulses": "MOVJ",
        "keyframes": "<key",
    }.get(format)
    for line, x, time_s in zip(found, timed.x, timed.time_s, strict=True):
        if format == "csv":
            assert line.startswith(f"{round(time_s, 9)},")
        elif format == "urscript":
            assert f"[{x[0]:.6f}" in line.replace("-0.000000", "0.000000")
        elif format == "ls":
            assert re.match(r" *\d+:J P", line)
        else:
            assert line.strip().startswith(begin)


def test_joints_of_the_model_that_do_not_move_are_compared_with_the_job(tmp_path):
    timed = random_motion(hinged(), 1)
    own = controller(hinged(), locked={"gripper": 0.02}, in_file=(6, 0, 1, 2, 3, 4, 5))
    file = write(tmp_path, "keyframes", timed, own)
    assert read_motion(file, hinged(), own).x.tolist() == timed.rounded.x.tolist()
    with pytest.raises(InputError, match=r"weld\.xml, line \d+: gripper is 0\.02 where .* gives 0\.03"):
        read_motion(file, hinged(), own._replace(locked={"gripper": 0.03}))


def test_one_configuration_is_a_motion_without_segments(tmp_path):
    found = read_text(tmp_path, "a.csv", ",".join(hinged().joint_names) + "\n0,0,0,0,0,1\n")
    assert (found.x.shape, polynomials(found).shape) == ((1, 6), (0, 2, 6))


# --- interpolation


def motion_of(timed, interpolation: str) -> MotionFile:
    line = np.arange(len(timed.x))
    return MotionFile(
        timed.x, timed.time_s, timed.velocity, timed.acceleration, None, line, None, interpolation, "csv", ()
    )


@pytest.mark.parametrize(("interpolation", "derivatives"), [("linear", 1), ("cubic", 2), ("quintic", 3)])
def test_polynomials_are_the_splines_through_the_states(interpolation, derivatives):
    timed = next(motion for k in range(99) if len((motion := random_motion(hinged(), k)).x) > 4)
    coefficients = polynomials(motion_of(timed, interpolation))
    states = np.stack([timed.x, timed.velocity, timed.acceleration], axis=1)[:, :derivatives]
    spline = BPoly.from_derivatives(timed.time_s, states)
    s = np.linspace(0, 1, 11)[:-1]
    for k, (t0, t1) in enumerate(itertools.pairwise(timed.time_s.tolist())):
        powers = s[:, None] ** np.arange(coefficients.shape[1])
        expected = spline(t0 + s * (t1 - t0))
        assert np.abs(powers @ coefficients[k] - expected).max() <= 1e-9 * (1 + np.abs(expected).max())


@pytest.mark.parametrize(
    ("format", "default", "valid"),
    [
        ("csv", "linear", ["linear", "cubic", "quintic"]),
        ("ros", "quintic", ["linear", "cubic", "quintic"]),
        ("keyframes", "linear", ["linear", "cubic"]),
        ("jbi-pulses", "linear", ["linear"]),
        ("rapid", "linear", ["linear"]),
        ("krl", "linear", ["linear"]),
        ("ls", "linear", ["linear"]),
        ("urscript", "linear", ["linear"]),
    ],
)
def test_a_file_is_interpolated_as_its_controller_does_or_as_requested_if_it_holds_enough(
    format, default, valid, tmp_path
):
    own = controller(hinged())
    file = write(tmp_path, format, random_motion(hinged(), 2), own)
    assert read_motion(file, hinged(), own).interpolation == default
    for interpolation in ("linear", "cubic", "quintic"):
        if interpolation in valid:
            assert read_motion(file, hinged(), own, interpolation=interpolation).interpolation == interpolation
        else:
            with pytest.raises(InputError, match=rf"{interpolation} interpolation needs .*; valid: {', '.join(valid)}"):
                read_motion(file, hinged(), own, interpolation=interpolation)


# --- what is chosen


def test_unknown_choices_are_refused_with_the_valid_ones(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text(",".join(hinged().joint_names) + "\n0,0,0,0,0,1\n")
    for choice, message in (
        ({"format": "gcode"}, f"'gcode' is not a format of motions; valid: {', '.join(MOTION_FORMATS)}"),
        ({"unit": "grad"}, "'grad' is not a unit of angles; valid: rad, deg"),
        ({"interpolation": "spline"}, "'spline' is not an interpolation; valid: linear, cubic, quintic"),
    ):
        with pytest.raises(InputError) as caught:
            read_motion(file, hinged(), **choice)
        assert str(caught.value) == message


@pytest.mark.parametrize(
    "format", ["csv", "ros", "ros-json", "jbi-pulses", "rapid", "krl", "ls", "urscript", "keyframes"]
)
def test_a_format_is_found_by_content_if_the_ending_says_nothing(format, tmp_path):
    timed, own = random_motion(hinged(), 4), controller(hinged())
    file = write(tmp_path, format, timed, own).rename(tmp_path / "program.txt")
    assert read_motion(file, hinged(), own).format == format


def test_a_chosen_format_takes_precedence_over_the_ending(tmp_path):
    timed, own = random_motion(hinged(), 4), controller(hinged())
    file = write(tmp_path, "ros", timed, own).rename(tmp_path / "weld.csv")
    assert read_motion(file, hinged(), own, format="ros").x.tolist() == timed.rounded.x.tolist()


def test_missing_and_empty_files_are_refused(tmp_path):
    for name, content, message in (
        ("none.csv", None, "no such file"),
        ("a.csv", "", "is empty"),
        ("b.yaml", "\n", "is empty"),
    ):
        if content is not None:
            (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match=message):
            read_motion(tmp_path / name, hinged())


def test_a_jobs_section_program_names_the_joints_of_pulses_groups_and_sums(tmp_path):
    job = load_config(None, [
        "program.pulses={per_rad: [1, 2, 3, 4, 5, 6], source: here}",
        "program.coupled={joint3: joint2}",
        "program.groups={robot: [joint2, joint3, joint4, joint5, joint6], station: [joint1]}",
    ])  # fmt: skip
    found = controller_of(job, hinged())
    assert found.coupled == ((2, 1),)
    assert tuple(found.groups) == tuple(JointGroups((1, 2, 3, 4, 5), (), (0,)))
    assert (found.pulses.per_unit.tolist(), found.pulses.zero.tolist()) == ([1, 2, 3, 4, 5, 6], [0] * 6)
    assert (found.in_file, dict(found.locked)) == ((0, 1, 2, 3, 4, 5), {})


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "program.pulses={per_rad: [1], source: here}",
            "per_rad has 1 values, but the robot gp50 has 6 joints",
        ),
        ("program.pulses={per_rad: [1, 1, 0, 1, 1, 1], source: here}", "must not be 0"),
        ("program.coupled={joint3: elbow}", "program.coupled: 'elbow' is not a joint; valid: joint1"),
        ("program.groups={robot: [joint2]}", "program.groups has 'joint1' 0 times"),
    ],
)
def test_a_jobs_controller_data_that_do_not_fit_the_robot_are_refused(override, message):
    with pytest.raises(InputError, match=message):
        controller_of(load_config(None, [override]), hinged())
