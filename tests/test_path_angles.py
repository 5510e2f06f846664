"""Orientations that a path's file states by angles, in the orders of robot makers."""

import warnings

import numpy as np
import pytest

from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.path_file import read_path_points

RNG = np.random.default_rng(3)
ANGLES = RNG.uniform(-80.0, 80.0, (4, 3))
POINTS = RNG.uniform(-0.5, 0.5, (4, 3))


def about(axis: str, degrees: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    k = "xyz".index(axis)
    turned = np.eye(3)
    i, j = (k + 1) % 3, (k + 2) % 3
    turned[i, i], turned[i, j], turned[j, i], turned[j, j] = c, -s, s, c
    return turned


def product(axes: str, angles: np.ndarray) -> np.ndarray:
    """Product of the rotations about these axes, from left to right."""
    found = np.eye(3)
    for axis, degrees in zip(axes, angles, strict=True):
        found = found @ about(axis, degrees)
    return found


def vector(values: np.ndarray) -> np.ndarray:
    """Rodrigues' formula."""
    turn = np.linalg.norm(values)
    x, y, z = values / turn
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(turn) * K + (1 - np.cos(turn)) * K @ K


def write(folder, names, angles=ANGLES):
    rows = np.concatenate([POINTS, angles], axis=1)
    lines = [",".join(f"{value:.17g}" for value in row) for row in rows]
    file = folder / "path.csv"
    file.write_text("\n".join([f"x,y,z,{names}", *lines, ""]))
    return file


def read(file, maker=None, **chosen):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = read_path_points(file, chosen, maker=maker)
    assert all(one.category is Note for one in said)
    return found.frames.rotations, [str(one.message).removeprefix(f"{file}: ") for one in said]


@pytest.mark.parametrize("maker, names, axes, order", [
    ("kuka", "A,B,C", "zyx", [0, 1, 2]), ("mitsubishi", "A,B,C", "zyx", [2, 1, 0]),
    ("doosan", "a,b,c", "zyz", [0, 1, 2]), (None, "W,P,R", "zyx", [2, 1, 0]),
    ("fanuc", "w,p,r", "zyx", [2, 1, 0]), (None, "O,A,T", "zyz", [0, 1, 2]),
    ("comau", "A,E,R", "zyz", [0, 1, 2]), ("abb", "rx,ry,rz", "zyx", [2, 1, 0]),
    ("denso", "RX,RY,RZ", "zyx", [2, 1, 0]),
    ("yaskawa", "Rx,Ry,Rz", "zyx", [2, 1, 0]), ("staubli", "rx,ry,rz", "xyz", [0, 1, 2]),
])  # fmt: skip
def test_angles_are_read_in_the_maker_s_order_in_degrees(tmp_path, maker, names, axes, order):
    found, said = read(write(tmp_path, names), maker)
    expected = [product(axes, row[order]) for row in ANGLES]
    assert np.allclose(found, expected, atol=1e-12) and said == []


@pytest.mark.parametrize(
    "names, maker", [("rx,ry,rz", "ur"), (",".join(f"actual_TCP_pose_{k}" for k in (3, 4, 5)), None)]
)
def test_a_rotation_vector_is_in_radians(tmp_path, names, maker):
    vectors = np.radians(ANGLES)
    found, said = read(write(tmp_path, names, vectors), maker)
    assert np.allclose(found, [vector(row) for row in vectors], atol=1e-12) and said == []


@pytest.mark.parametrize("names, scale", [("A [rad],B [rad],C [rad]", np.pi / 180), ("a_deg,b_deg,c_deg", 1.0),
                                          ("A (°),B (°),C (°)", 1.0)])  # fmt: skip
def test_the_header_s_unit_of_angles_decides(tmp_path, names, scale):
    found, _ = read(write(tmp_path, names, scale * ANGLES), "kuka")
    assert np.allclose(found, [product("zyx", row) for row in ANGLES], atol=1e-12)


def test_roll_pitch_yaw_of_ros_are_in_radians(tmp_path):
    found, _ = read(write(tmp_path, "roll,pitch,yaw", np.radians(ANGLES)), "ros")
    assert np.allclose(found, [product("zyx", row[::-1]) for row in ANGLES], atol=1e-12)


@pytest.mark.parametrize("names, makers", [("A,B,C", "doosan, kuka, mitsubishi"),
                                           ("rx,ry,rz", "abb, denso, staubli, ur, yaskawa")])  # fmt: skip
def test_angles_whose_order_the_header_does_not_state_are_named_and_not_guessed(tmp_path, names, makers):
    found, said = read(write(tmp_path, names))
    assert (
        found is None and len(said) == 1 and said[0].endswith(f"for orientations, set workpiece.path_angles: {makers}")
    )


@pytest.mark.parametrize("names, text", [
    ("W [kg],P,R", "the unit of w, p, r is deg and kg; valid: deg, rad"), ("W,P,R", "w,p,r of point 1 is 'left,"),
])  # fmt: skip
def test_columns_with_the_names_of_angles_that_hold_something_else_are_named(tmp_path, names, text):
    file = write(tmp_path, names)
    if "left" in text:
        head, first, *rest = file.read_text().splitlines()
        first = ",".join([*first.split(",")[:3], "left", *first.split(",")[4:]])
        file.write_text("\n".join([head, first, *rest, ""]))
    found, said = read(file)
    assert found is None and text in said[0] and said[0].endswith("; the columns are not read as angles")


def test_angles_may_be_chosen_without_a_header(tmp_path):
    file = write(tmp_path, "A,B,C")
    file.write_text(file.read_text().partition("\n")[2])
    chosen = {"x": 1, "y": 2, "z": 3, "angle_1": 4, "angle_2": 5, "angle_3": 6}
    found, _ = read(file, "kuka", **chosen)
    assert np.allclose(found, [product("zyx", row) for row in ANGLES], atol=1e-12)


@pytest.mark.parametrize("names, maker, words", [
    ("rx,ry,rz", "kuka", "workpiece.path_angles is kuka, whose angles are a, b, c, but the path has no such columns"),
    ("A [grad],B [grad],C [grad]", "kuka", "the unit of a, b, c is grad; valid: deg, rad"),
    ("A [deg],B [deg],C [rad]", "kuka", "the unit of a, b, c is deg and rad; valid: deg, rad"),
    ("w,p,p", "fanuc", "but the path has no such columns"),
])  # fmt: skip
def test_angles_that_do_not_fit_are_refused(tmp_path, names, maker, words):
    with pytest.raises(InputError, match=words):
        read(write(tmp_path, names), maker)


def test_a_maker_and_quaternions_contradict_each_other(tmp_path):
    file = write(tmp_path, "qw,qx,qy,qz", np.tile([1.0, 0, 0, 0], (4, 1)))
    with pytest.raises(InputError, match="path_angles is kuka, but the path has quaternions; omit the key"):
        read(file, "kuka")


def test_an_unknown_maker_is_refused_with_the_known_ones(capsys):
    assert main(["plan", "--set", "workpiece.path_angles=acme"]) == 2
    assert "workpiece.path_angles is 'acme': input should be 'abb', 'comau'" in capsys.readouterr().err
