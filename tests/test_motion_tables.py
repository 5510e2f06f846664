"""Tables, ROS messages, arrays and key frames of others: headings, units, times, followers, and what is refused."""

import io
import json
import re

import numpy as np
import pytest
import yaml
from motion_files import (
    ENDINGS,
    controller,
    followed,
    hinged,
    railed,
    random_motion,
    read_text,
    refusal,
    with_followers,
    write,
)

from htcp_jax.errors import InputError
from htcp_jax.io.motions import read_motion

J = hinged().joint_names
ROW = "0,0.5,-1,0.25,2,3"
X = [0, 0.5, -1, 0.25, 2, 3]
DEG = np.pi / 180


def table(*header: str, row: str = ROW, separator: str = ",") -> str:
    return separator.join(header) + "\n" + row + "\n"


# --- tables


@pytest.mark.parametrize("heading", ["{}", "{}_deg", "{} [deg]", "/arm/{}/position", "axis {}"])
@pytest.mark.parametrize("is_whole", [True, False])
def test_joints_name_the_columns_in_the_robot_s_order(heading, is_whole, tmp_path):
    """By their headings, or by the names in these; velocities are found by the same names."""
    names = [f"A{k}" for k in range(1, 7)]
    headings = [heading.format(name) for name in names]
    rates = [f"{name}_vel" for name in names]
    text = table("t", *headings, *rates, "E1", row=f"0,{ROW},{ROW},9")
    given = (headings if is_whole else [each.replace("_deg", "").replace(" [deg]", "") for each in headings])[::-1]
    found = read_text(tmp_path, "a.csv", text, joints=given)
    scale = DEG if "deg" in heading else 1
    np.testing.assert_allclose(found.x, [np.array(X[::-1]) * scale])
    assert any(each.startswith("Columns that are not used: ") and "E1" in each for each in found.notes)
    if heading == "{}":
        np.testing.assert_allclose(found.velocity, [X[::-1]])


def test_joints_rename_those_of_messages_and_archives_and_are_refused_without_names(tmp_path):
    names = [f"A{k}" for k in range(1, 7)]
    text = json.dumps({"joint_names": names, "points": [{"positions": X}, {"positions": X}]})
    np.testing.assert_array_equal(read_text(tmp_path, "a.json", text, joints=names[::-1]).x, [X[::-1]] * 2)
    assert refusal(tmp_path, "a.json", text).endswith("pass --joints A1,A2,A3,A4,A5,A6")
    assert "--joints names A7" in refusal(tmp_path, "a.json", text, joints=[*names[:5], "A7"])
    np.savez(tmp_path / "a.npz", x=[X, X], joint_names=names)
    np.testing.assert_array_equal(read_motion(tmp_path / "a.npz", hinged(), joints=names[::-1]).x, [X[::-1]] * 2)
    np.savez(tmp_path / "b.npz", x=[X, X])
    with pytest.raises(InputError, match="has no joint_names"):
        read_motion(tmp_path / "b.npz", hinged(), joints=names)
    np.save(tmp_path / "a.npy", [X, X])
    with pytest.raises(InputError, match="npy has no names of joints"):
        read_motion(tmp_path / "a.npy", hinged(), joints=names)


@pytest.mark.parametrize(
    ("header", "advice"),
    [
        (["time_s", *(f"A{k}" for k in range(1, 7))], "pass --joints A1,A2,A3,A4,A5,A6"),
        ([f"q {k} [deg]" for k in range(6)], "pass --joints 'q 0,q 1,q 2,q 3,q 4,q 5'"),
        ([*(f"A{k}_deg" for k in range(6)), *(f"A{k}_deg_s" for k in range(6))], "pass --joints A0,A1,A2,A3,A4,A5"),
        (["base", "arm", "elbow", "roll", "bend", "turn"], "pass --joints base,arm,elbow,roll,bend,turn"),
        (["A1", "A2"], "pass --joints with the names of the joints' columns"),
    ],
)
def test_a_table_of_other_names_is_refused_with_the_option_that_reads_it(header, advice, tmp_path):
    text = table(*header, row=",".join(["0"] * len(header)))
    unit = (
        "" if "deg" in header[0] else "; the headings state no unit: pass --unit deg, too, if the angles are in degrees"
    )
    assert refusal(tmp_path, "a.csv", text).endswith(f"{advice}{unit}")


@pytest.mark.parametrize(
    ("heading", "scale", "note"),
    [
        ("{}", 1, "No unit is stated"),
        ("{}_rad", 1, None),
        ("{}_deg", DEG, None),
        ("{} [deg]", DEG, None),
        ("{} (rad)", 1, None),
        ("{} [°]", DEG, None),
        ("{}[degrees]", DEG, None),
        ("{}_position", 1, "No unit is stated"),
        ("position_{}", 1, "No unit is stated"),
        ("/joint_states/{}/position", 1, "No unit is stated"),
        ("{}.pos", 1, "No unit is stated"),
        ("{}_position [deg]", DEG, None),
        (" {} ", 1, "No unit is stated"),
    ],
)
def test_headings_name_joints_and_units(heading, scale, note, tmp_path):
    found = read_text(tmp_path, "a.csv", table(*(heading.format(name) for name in J)))
    assert np.abs(found.x - np.array([X]) * scale).max() < 1e-15
    assert any("No unit is stated" in each for each in found.notes) == (note is not None)
    upper = read_text(tmp_path, "b.csv", table(*(heading.format(name).upper() for name in J)))
    assert upper.x.tolist() == found.x.tolist()


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_columns_may_have_any_order_and_separator(separator, tmp_path):
    text = table(*J[::-1], row=ROW.replace(",", separator), separator=separator)
    assert read_text(tmp_path, "a.csv", text).x.tolist() == [X[::-1]]


def test_a_german_table_has_decimal_commas(tmp_path):
    found = read_text(tmp_path, "a.csv", table(*J, row="0;0,5;-1;0,25;2;3", separator=";"))
    assert found.x.tolist() == [X] and any("commas" in note for note in found.notes)


def test_a_header_in_a_comment_blank_lines_a_byte_order_mark_and_empty_last_cells_are_read(tmp_path):
    for text in (f"# exported\n# {', '.join(J)}\n{ROW}\n", f"\ufeff\n{table(*J)}\n\n", table(*J, "", row=f"{ROW},")):
        assert read_text(tmp_path, "a.csv", text).x.tolist() == [X]


@pytest.mark.parametrize(
    ("heading", "scale"), [("time", 1), ("time_s", 1), ("t", 1), ("Time [s]", 1), ("time_ms", 1e-3), ("t [ms]", 1e-3)]
)
def test_times_are_read_in_their_unit(heading, scale, tmp_path):
    found = read_text(tmp_path, "a.csv", table(*J, heading, row=f"{ROW},0\n{ROW},8"))
    assert found.time_s.tolist() == [0, 8 * scale] and found.line.tolist() == [2, 3]


@pytest.mark.parametrize(
    ("velocity", "acceleration", "scale"),
    [
        ("{}_rad_s", "{}_rad_s2", 1),
        ("{}_vel", "{}_acc", DEG),
        ("{}_deg_s", "{}_deg_s2", DEG),
        ("{} [deg/s]", "{} [deg/s^2]", DEG),
        ("velocity_{}", "acceleration_{}", DEG),
        ("{}/velocity [rad/s]", "{}/acceleration [rad/s²]", 1),
    ],
)
def test_velocities_and_accelerations_are_read_in_their_units_else_in_the_positions(
    velocity, acceleration, scale, tmp_path
):
    heads = [form.format(name) for form in ("{}_deg", velocity, acceleration) for name in J]
    row = ",".join([ROW] * 3)
    found = read_text(tmp_path, "a.csv", table("t", *heads, row=f"0,{row}\n1,{row}"), interpolation="quintic")
    assert np.allclose(found.x, np.array(X) * DEG, atol=1e-15)
    assert np.allclose(found.velocity, np.array(X) * scale, atol=1e-15)
    assert np.allclose(found.acceleration, np.array(X) * scale, atol=1e-15)


def test_a_slide_is_in_metres_or_millimetres(tmp_path):
    names = railed().joint_names
    row = "500,0,0,0,0,0,0,90"
    found = read_text(tmp_path, "a.csv", table("rail_mm", *(f"{n}_deg" for n in names[1:]), row=row), railed())
    assert np.allclose(found.x, [[0.5, 0, 0, 0, 0, 0, 0, np.pi / 2]], atol=1e-15)
    bare = read_text(tmp_path, "b.csv", table(*names, row="0.5,0,0,0,0,0,0,90"), railed(), unit="deg")
    assert np.allclose(bare.x, found.x, atol=1e-15) and any("rail: metres" in note for note in bare.notes)


def test_columns_that_are_not_used_are_named(tmp_path):
    found = read_text(tmp_path, "a.csv", table(*J, "gripper_force", "tcp_rx_deg", row=f"{ROW},1,2"))
    assert found.notes[-1] == "Columns that are not used: gripper_force, tcp_rx_deg."


BOTH = f"joints of gp50: {', '.join(J)}; of the file: "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table(*J[:5], row="0,0,0,0,0"), f": the file lacks joint6; {BOTH}{', '.join(J[:5])}"),
        (table(*J, "joint7", row=ROW + ",0"), f", line 1: the robot lacks joint7; {BOTH}{', '.join(J)}, joint7"),
        (table(*J, "up_deg", row=ROW + ",0"), f", line 1: the robot lacks up_deg; {BOTH}{', '.join(J)}, up_deg"),
        (table("x", "y", row="1,2"), f", line 1: no column is named as a joint of the robot; {BOTH}x, y"),
        (table(*J, "joint1_rad", row=ROW + ",0"), ", line 1: the columns 'joint1' and 'joint1_rad' both hold"),
        (table(*J, "t", "time", row=ROW + ",0,0"), ", line 1: the columns 't' and 'time' both hold times"),
        (table(*J, "joint1_vel", row=ROW + ",0"), ", line 1: velocities of some joints only; those of joint2, joint3,"),
        (table("joint1_deg", *J[1:]), f", line 1: {', '.join(J[1:])} has no unit, other joints are in deg"),
        (table("joint1_m", *J[1:]), ", line 1: joint1 is a hinge, but its column is in m; valid: rad, deg"),
        (table(*J, row="0,0,0,0,0,90"), ", line 2: an angle is 90, more than a turn in radians, and no"),
        (table(*J, row="0,0,0,0,0"), ", line 2: 5 cells, but the header has 6"),
        (table(*J, row="0,0,0,0,0,0,0"), ", line 2: 7 cells, but the header has 6"),
        (table(*J, row="0,0,,0,0,0"), ", line 2: the cell of joint3 is empty"),
        (table(*J, row="0,0,0,0,0,0\n0,0,nan,0,0,0"), ", line 3: the cell of joint3 holds 'nan', which is"),
        (table(*J, row="0,0,inf,0,0,0"), ", line 2: the cell of joint3 holds 'inf', which is not a finite number"),
        (table(*J, row="0,0,1e999,0,0,0"), ", line 2: the value of joint3 is inf; a finite number is needed"),
        (table(*J, row="0,0,x,0,0,0"), ", line 2: the cell of joint3 holds 'x', which is not a finite number"),
        (table(*J, row="0,0,1_0,0,0,0"), ", line 2: the cell of joint3 holds '1_0', which is not a finite number"),
        (table(*J, row='0,0,"0,0,0,0'), ", line 1: not a table"),
        (table(*J, row=""), " contains no configuration"),
        ("# only a comment\n", ", line 1: the file contains no table"),
        (f"{ROW}\n", ", line 1: the header with the joints' names is missing"),
        (table("t", *J, row=f"1,{ROW}\n1,{ROW}"), ", line 3: the time is 1 s after 1 s; times must increase"),
        (table("t", *J, row=f"0,{ROW}\n2,{ROW}\n1,{ROW}"), ", line 4: the time is 1 s after 2 s; times must increase"),
        ("target,segment_status,path_clear,residual_m\n", ", line 1: a plan's table with one row per target; its mo"),
    ],
)  # fmt: skip
def test_a_damaged_table_is_refused_with_its_line(text, message, tmp_path):
    found = refusal(tmp_path, "a.csv", text)
    assert found.startswith(f"a.csv{message}"), found


def test_a_unit_that_contradicts_the_header_is_refused(tmp_path):
    text = table(*(f"{name}_rad" for name in J))
    assert read_text(tmp_path, "a.csv", text, unit="rad").x.tolist() == [X]
    assert (
        refusal(tmp_path, "a.csv", text, unit="deg")
        == "a.csv, line 1: the header states rad; --unit deg contradicts that"
    )


def test_text_that_is_not_utf8_is_refused_with_its_line(tmp_path):
    (tmp_path / "a.csv").write_bytes(table(*J).encode() + b"\xff\n")
    with pytest.raises(InputError, match=r"a\.csv, line 3: it is not UTF-8 text"):
        read_motion(tmp_path / "a.csv", hinged())


# --- followers


def followed_table(follower: str, digits: int = 3) -> str:
    """A row of the arm with followers, b = 0.25 - 1.5 a and e = 0.1 + 0.5 d, with the value of b as text."""
    return table("a", "b", "d", "e", "c", row=f"{1 / 3:.{digits}f},{follower},0.2,0.2,0.1")


@pytest.mark.parametrize("follower", ["-0.250", "-0.249"])
def test_a_follower_within_the_files_rounding_is_accepted(follower, tmp_path):
    assert read_text(tmp_path, "a.csv", followed_table(follower), followed()).x.tolist() == [[0.333, 0.2, 0.1]]


@pytest.mark.parametrize(("follower", "digits"), [("-0.251", 3), ("-0.2501", 6), ("0.250", 3)])
def test_a_follower_beyond_the_files_rounding_is_refused_with_its_line(follower, digits, tmp_path):
    message = refusal(tmp_path, "a.csv", followed_table(follower, digits), followed())
    assert message.startswith(f"a.csv, line 2: b is {float(follower):g} where the robot's model gives -0.")
    assert message.endswith("as it follows a")


@pytest.mark.parametrize("format", ["csv", "ros", "ros-json", "keyframes"])
def test_one_changed_follower_in_a_file_is_refused(format, tmp_path):
    for seed in range(20):
        timed = with_followers(followed(), random_motion(followed(), seed))
        row, follower = seed % len(timed.x), 3 + seed % 2
        timed.x[row, follower] += 1e-3
        file = write(tmp_path, format, timed, controller(followed()))
        with pytest.raises(InputError, match=r"where the robot's model gives"):
            read_motion(file, followed(), controller(followed()))


def test_a_changed_rate_of_a_follower_is_refused(tmp_path):
    timed = with_followers(followed(), random_motion(followed(), 3))
    timed.velocity[-1, 3] += 0.01
    file = write(tmp_path, "csv", timed, controller(followed()))
    with pytest.raises(InputError, match="a rate of b is"):
        read_motion(file, followed(), controller(followed()))


# --- ROS


def points(*more: dict, names=J) -> dict:
    each = [{"positions": X, "time_from_start": {"sec": k, "nanosec": 500_000_000}} | own for k, own in enumerate(more)]
    return {"header": {"frame_id": ""}, "joint_names": list(names), "points": each}


def as_yaml(message: dict) -> str:
    return yaml.safe_dump(json.loads(json.dumps(message)), sort_keys=False)  # without aliases


RATES = {"velocities": [1.0] * 6}, {"velocities": [2.0] * 6}
BOTH_RATES = [rate | {"accelerations": [0.5] * 6} for rate in RATES]


@pytest.mark.parametrize("name", ["a.yaml", "a.json"])
@pytest.mark.parametrize(
    "wrap",
    [
        lambda message: message,
        lambda message: {"joint_trajectory": message, "multi_dof_joint_trajectory": {"joint_names": [], "points": []}},
        lambda message: {"trajectory": message, "goal_tolerance": []},
        lambda message: {"trajectory": [{"joint_trajectory": message}]},
        lambda message: {"goal": {"trajectory": message}},
    ],
)
def test_a_trajectory_is_found_in_the_messages_that_contain_it(wrap, name, tmp_path):
    message = wrap(points({}, {}))
    text = json.dumps(message) if name.endswith("json") else as_yaml(message)
    found = read_text(tmp_path, name, text)
    assert (found.x.tolist(), found.time_s.tolist(), found.interpolation) == ([X, X], [0.5, 1.5], "linear")
    assert found.line.tolist() == [1, 2]


def test_a_message_of_ros_1_an_echo_with_its_end_and_numbers_of_seconds_are_read(tmp_path):
    for time in ({"secs": 1, "nsecs": 250_000_000}, {"sec": 1, "nanosec": 250_000_000}, 1.25):
        text = as_yaml(points({"time_from_start": time})) + "---\n"
        assert read_text(tmp_path, "a.yaml", text).time_s.tolist() == [1.25]


def test_a_missing_part_of_a_duration_is_0_and_named(tmp_path):
    found = read_text(tmp_path, "a.yaml", as_yaml(points({"time_from_start": {"secs": 2}})))
    assert found.time_s.tolist() == [2.0]
    assert found.notes[-1] == "Parts of time_from_start that are missing are 0: point 1."


@pytest.mark.parametrize(("more", "expected"), [(({}, {}), "linear"), (RATES, "cubic"), (BOTH_RATES, "quintic")])
def test_points_are_interpolated_by_what_they_hold(more, expected, tmp_path):
    found = read_text(tmp_path, "a.json", json.dumps(points(*more)))
    assert found.interpolation == expected and expected in found.notes[0]


def test_joints_are_sorted_and_what_is_not_used_is_named(tmp_path):
    message = points({"effort": [1.0] * 6, "label": "a"}, names=J[::-1]) | {"speed": 1}
    found = read_text(tmp_path, "a.json", json.dumps(message))
    assert found.x.tolist() == [X[::-1]]
    assert found.notes[2:] == (
        "Keys that are not used: speed.", "Keys of points that are not used: label.", "The efforts are not used."
    )  # fmt: skip


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (points({}, {"positions": X[:5]}), ", point 2: positions has 5 values for 6 joints"),
        (points({}, {"positions": [*X[:5], None]}), ", point 2: positions must be a list of numbers"),
        (points({}, {"positions": [*X[:5], "1"]}), ", point 2: positions must be a list of numbers"),
        (points({}, {"positions": [*X[:5], float("nan")]}), ", point 2: the value of joint6 is nan; a finite number"),
        (points({}, {"positions": []}), ", point 2: it has no positions, which other points have"),
        (points({}, RATES[0]), ", point 1: it has no velocities, which other points have"),
        (
            points({}, {"time_from_start": {"sec": 0, "nanosec": 0}}),
            ", point 2: the time is 0 s after 0.5 s; times must",
        ),
        (
            points({}, {"time_from_start": {"sec": 0, "nanosec": 500_000_000}}),
            ", point 2: the time is 0.5 s after 0.5 s",
        ),
        (points({"time_from_start": {"sec": 1, "nsecs": 0}}), ", point 1: time_from_start must be"),
        (points({"time_from_start": {"sec": 1.5, "nanosec": 0}}), ", point 1: time_from_start must be"),
        (points({"time_from_start": "soon"}), ", point 1: time_from_start must be"),
        (points({"time_from_start": None} | RATES[0]), ", point 1: velocities without time_from_start"),
        (points({}, names=[*J[:5], "elbow"]), ": the file lacks joint6, and the robot lacks elbow; " + BOTH),
        (points({}, names=[*J[:5], "joint5"]), " has the joint joint5 2 times"),
        (points(), " contains no configuration"),
        ({"joint_names": [], "points": []}, ": joint_names must be"),
        ({"poses": []}, ": no JointTrajectory; valid: joint_names and points"),
        (
            {"joint_trajectory": points({}), "multi_dof_joint_trajectory": {"points": [1]}},
            ": multi_dof_joint_trajectory",
        ),
    ],
)
def test_a_damaged_message_is_refused(message, expected, tmp_path):
    found = refusal(tmp_path, "a.json", json.dumps(message))
    assert found.startswith(f"a.json{expected}"), found
    text = as_yaml(message)
    assert refusal(tmp_path, "a.yaml", text).startswith(f"a.yaml{expected}")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "{", ", line 1: not JSON"),
        ("a.json", '{"points": [], "points": []}', ": not JSON"),
        ("a.yaml", "points: [", ", line 2"),
        ("a.yaml", "joint_names: [a]\npoints: []\n---\npoints: []\n", ", line 3: a second message begins"),
        ("a.yaml", "a: &x 1\npoints: *x\n", ", line 2"),
    ],
)
def test_text_that_is_no_message_is_refused(name, text, message, tmp_path):
    assert refusal(tmp_path, name, text).startswith(f"{name}{message}")


def test_yaml_with_one_list_per_line_is_read_as_other_yaml_is(tmp_path):
    timed, own = random_motion(hinged(), 5), controller(hinged())
    file = write(tmp_path, "ros", timed, own)
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()), sort_keys=False))
    fast, slow = (read_motion(each, hinged(), own) for each in (file, other))
    for name in ("x", "time_s", "velocity", "acceleration"):
        assert getattr(fast, name).tolist() == getattr(slow, name).tolist()


# --- NumPy


def test_an_array_of_configurations_is_read_in_the_robots_order(tmp_path):
    np.save(tmp_path / "a.npy", np.array([X, X], np.float32))
    found = read_motion(tmp_path / "a.npy", hinged())
    assert (found.x.tolist(), found.line.tolist(), found.format) == ([X, X], [1, 2], "npy")
    assert found.notes[0] == "No unit is stated: angles are read in radians." and "joint1, joint2" in found.notes[1]
    assert np.allclose(read_motion(tmp_path / "a.npy", hinged(), unit="deg").x, np.array([X, X]) * DEG)


@pytest.mark.parametrize(
    "keys",
    [("x", "time_s", "velocity", "acceleration"), ("q", "t", "qd", "qdd"), ("positions", "time", "velocities", "a")],
)
def test_an_archive_holds_names_times_and_rates(keys, tmp_path):
    arrays = [[X, X], [0.0, 1.0], [X, X], [X, X]]
    np.savez(tmp_path / "a.npz", joint_names=np.array(J[::-1]), other=[1], **dict(zip(keys, arrays, strict=True)))
    found = read_motion(tmp_path / "a.npz", hinged(), interpolation="quintic")
    assert found.x.tolist() == found.velocity.tolist() == found.acceleration.tolist() == [X[::-1]] * 2
    assert found.time_s.tolist() == [0, 1] and "Arrays that are not used: other." in found.notes


def test_an_array_of_all_joints_has_the_followers_at_their_places(tmp_path):
    u = np.array([[0.3, 0.2, 0.1], [0.5, 0.1, -1.0]], np.float32).astype(float)
    q = followed().coupling.positions(u)
    np.save(tmp_path / "a.npy", q.astype(np.float32))
    assert np.allclose(read_motion(tmp_path / "a.npy", followed()).x, u, atol=1e-7)
    q[1, followed().followers[0]] += 1e-3
    np.save(tmp_path / "b.npy", q)
    with pytest.raises(InputError, match=r"b\.npy, row 2: b is"):
        read_motion(tmp_path / "b.npy", followed())


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"x": [X[:5]]}, r"configurations of shape \(1, 5\); needed: \(n, 6\), for 6 joints: joint1"),
        ({"x": X}, r"configurations of shape \(6,\); needed: \(n, 6\)"),
        ({"x": [X], "q": [X]}, "the arrays x and q both hold configurations"),
        ({"x": [X], "t": [0.0, 1.0]}, r"times of shape \(2,\); needed: \(1,\)"),
        ({"x": [X], "v": [X[:5]]}, r"velocities of shape \(1, 5\); needed: \(1, 6\)"),
        ({"y": [X]}, "has no array of configurations; valid: x, q, .*; there: y"),
        ({"x": [X], "joint_names": [1.0]}, "joint_names must be a list of texts"),
        ({"x": [[True] * 6]}, "the configurations must be numbers"),
        ({"x": [[*X[:5], np.nan]]}, "row 1: the value of joint6 is nan"),
        ({"x": [[*X[:5], 90.0]]}, "row 1: an angle is 90, more than a turn"),
        ({"x": [X, X], "t": [1.0, 1.0]}, "row 2: the time is 1 s after 1 s"),
        ({"x": [X], "segment_status": [1], "path_clear": [1]}, r"a plan's arrays .*; its motion is in motion\.csv"),
        ({"x": np.array([X], object)}, "a.npz"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arrays, message, tmp_path):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=message):
        read_motion(tmp_path / "a.npz", hinged())


# --- key frames


def key_file(*keys: str, more: str = "") -> str:
    return f"<mujoco>{more}\n<keyframe>\n" + "\n".join(keys) + "\n</keyframe></mujoco>\n"


QPOS = 'qpos="0 .5 -1 0.25 2 3"'


def test_keys_in_a_model_are_read_and_what_is_not_used_is_named(tmp_path):
    found = read_text(tmp_path, "a.xml", key_file(f'<key name="home" {QPOS} ctrl="1"/>', more="<worldbody/>"))
    assert (found.x.tolist(), found.time_s, found.kind, found.line.tolist()) == ([X], None, None, [3])
    assert found.notes[1:] == (
        "Attributes of keys that are not used: ctrl.", "Elements of the model that are not read: worldbody.",
        "The keys' names are not used.",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (key_file("<key/>"), ", line 3: the key has no qpos"),
        (key_file(f"<key {QPOS}/>", '<key time="1"/>'), ", line 4: the key has no qpos, which other keys have"),
        (key_file('<key qpos="0 0"/>'), ", line 3: qpos has 2 values; the robot's model has 6 joints: joint1"),
        (key_file('<key qpos="0 0 0 0 0 nan"/>'), ", line 3: qpos holds 'nan'"),
        (key_file(f'<key time="soon" {QPOS}/>'), ", line 3: time holds 'soon'"),
        (key_file(f'<key time="1" {QPOS}/>', f"<key {QPOS}/>"), ", line 4: the time is 0 s after 1 s"),
        (key_file(), " contains no configuration"),
        ("<mujoco><key/></mujoco>", ", line 1: <key> must be in <keyframe>"),
        ("<robot/>", ", line 1: <robot> is not a MuJoCo file"),
        ("<mujoco>", ", line 1: not XML"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><mujoco/>', ", line 1: a document type"),
    ],
)
def test_damaged_key_frames_are_refused_with_their_line(text, message, tmp_path):
    assert refusal(tmp_path, "a.xml", text).startswith(f"a.xml{message}")


# --- every format


PARTS = {  # of the file with the motion: what it begins with, and what follows it
    "csv": ("time_s,", ""), "ros": ("points:", ""), "ros-json": ('"points"', ""), "jbi-pulses": ("C00000", "//INST"),
    "rapid": ("MoveAbsJ", "ENDPROC"), "urscript": ("movej", "stopj"), "keyframes": ("<keyframe>", ""),
    "krl": ("PTP {", "END"), "ls": ("J P[1]", "/END"),
}  # fmt: skip
UNREAD = {  # speeds, tools, gains and targets, by the text of the line up to the digit
    "csv": r"[^,]*,[A-Z]+,\d*", "rapid": r".*(,v\d*|,tool\d*)", "urscript": r".*\](,[^,]*){1,2}|.*\](,[^,]*){4,5}",
    "ls": r" *\d*|.*:J P\[1\] \d*|.*CNT\d*|.*U[FT] : \d*|.*GP\d*",
    "keyframes": r'.*name="\d*', "krl": r"\$(?:RED_VEL|VEL_AXIS).*",
}  # fmt: skip


@pytest.mark.parametrize("format", ENDINGS)
def test_a_changed_digit_of_a_motion_changes_what_is_read_or_is_refused(format, tmp_path):
    draw = np.random.default_rng(0)
    own, timed = controller(hinged()), random_motion(hinged(), 6)
    file = write(tmp_path, format, timed, own)
    text, before = file.read_text(), read_motion(file, hinged(), own)
    first, after = PARTS[format]
    begin, end = text.index(first), text.index(after) if after else len(text)
    places = [k for k in range(begin, end) if text[k].isdigit()]
    changed, lost = 0, []
    for k in draw.choice(places, 200).tolist():
        other = text[:k] + str((int(text[k]) + int(draw.integers(1, 10))) % 10) + text[k + 1 :]
        file.write_text(other)
        is_unread = re.fullmatch(UNREAD.get(format, "-"), text[:k].rpartition("\n")[2]) is not None
        if is_unread or number_at(text, k) == number_at(other, k) is not None:
            continue
        changed += 1
        try:
            found = read_motion(file, hinged(), own)
        except InputError:
            continue
        if not any(map(different, before, found)):
            lost.append(f"{text[max(0, k - 40) : k]}[{text[k]}]{text[k + 1 : k + 5]}")
    assert lost == [] and changed > 100


def number_at(text: str, k: int) -> float | None:
    """The number of which a digit is a part; the last of 17 digits may not change it."""
    found = next(each for each in re.finditer(r"[-+.\deE]+", text) if each.start() <= k < each.end())
    try:
        return float(found[0])
    except ValueError:
        return None


def different(a, b) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.shape != b.shape or bool((a != b).any())
    return a is not b and a != b


def test_random_bytes_in_a_file_are_read_or_refused(tmp_path):
    draw = np.random.default_rng(1)
    own = controller(hinged())
    for format in ENDINGS:
        file = write(tmp_path, format, random_motion(hinged(), 7), own)
        data = file.read_bytes()
        for _ in range(60):
            changed = bytearray(data)
            for k in draw.integers(0, len(data), 1 + int(draw.integers(3))):
                changed[k] = int(draw.integers(256))
            file.write_bytes(bytes(changed[: int(draw.integers(1, len(data)))] if draw.random() < 0.3 else changed))
            try:
                read_motion(file, hinged(), own)
            except InputError as error:
                assert "\n" not in str(error)


def test_an_archive_in_memory_of_random_bytes_is_refused(tmp_path):
    draw, stream = np.random.default_rng(2), io.BytesIO()
    np.savez(stream, x=[X], joint_names=np.array(J))
    data = stream.getvalue()
    for _ in range(60):
        changed = bytearray(data)
        changed[int(draw.integers(4, len(data)))] = int(draw.integers(256))
        (tmp_path / "a.npz").write_bytes(bytes(changed))
        try:
            read_motion(tmp_path / "a.npz", hinged())
        except InputError as error:
            assert "\n" not in str(error)
