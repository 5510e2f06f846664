"""Excluded capsule pairs: by an arm's meshes, by its SRDF, by hand; and the starts and plans they affect."""

import csv
import json
import re
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import jax.numpy as jnp
import numpy as np
import pytest
from published import path_of
from scipy.spatial import cKDTree

import htcp_jax
from htcp_jax.clearance.obstacles.self_collision import make_self_collision
from htcp_jax.clearance.obstacles.self_exclusions import NEAR_M, candidates, distances, overlaps, samples
from htcp_jax.cli import main
from htcp_jax.errors import InputError, Note
from htcp_jax.io.robots import LinkMeshes
from htcp_jax.io.robots.ledger import Ledger
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.io.robots.srdf import disabled_pairs
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.jobs import load_config
from htcp_jax.jobs.build import obstacles_of, resolved_scene, scene
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.motion import Problem
from htcp_jax.motion.start_check import check_start
from htcp_jax.planning import batch
from htcp_jax.status import Status

ARM = """<mujoco model="shelf"><compiler angle="radian"/><worldbody>
  <body name="a"><joint axis="0 0 1" range="-2.5 2.5"/>
    <geom name="plate" type="box" size="0.15 0.15 0.01" pos="0.15 0 {z}"/>
    <body name="b" pos="0.3 0 0"><joint axis="0 0 1" range="-2.5 2.5"/>
      <geom name="upper" type="box" size="0.15 0.02 0.02" pos="0.15 0 0"/>
      <body name="c" pos="0.3 0 0"><joint axis="0 0 1" range="-2.5 2.5"/>
        <geom name="lower" type="box" size="0.15 0.02 0.02" pos="0.15 0 0"/>
        <body name="d" pos="0.3 0 0"><joint axis="0 1 0" range="-1 1"/>
          <geom name="rod" type="box" size="0.03 0.01 0.01" pos="0.04 0 0"/><site name="tcp" pos="0.08 0 0"/>
  </body></body></body></body></worldbody></mujoco>"""
FOLDED = [0.0, 2.2, 2.2, 0.0]  # the lower arm over the plate
PANDA_START = [0, 0, 0, -0.0698, 0, 0.05, 0.785]


@pytest.fixture
def htcp(capsys):
    def run(*words, code: int = 0) -> str:
        """Return all that a command printed, in one line."""
        assert main([str(word) for word in words]) == code
        return " ".join("".join(capsys.readouterr()).split())

    return run


@cache
def arm_text(z: float, *words) -> str:
    """Text of the file that `htcp robot` writes for the arm with its plate at a height [m]."""
    with TemporaryDirectory() as folder:
        model, out = Path(folder) / "shelf.xml", Path(folder) / "arm.xml"
        model.write_text(ARM.format(z=z))
        with redirect_stdout(StringIO()):
            assert main([str(word) for word in ("robot", model, "--out", out, "--most", 1, *words)]) == 0
        return out.read_text()


@pytest.fixture
def imported(tmp_path):
    """A function that writes the model and the imported arm with its plate at a height [m]; see `arm_text`."""

    def made(z: float, *words):
        (tmp_path / "shelf.xml").write_text(ARM.format(z=z))
        (tmp_path / "arm.xml").write_text(arm_text(z, *words))
        return tmp_path / "arm.xml"

    return made


def rules(robot) -> dict[tuple[str, str], str]:
    names = robot.capsule_names
    return {tuple(sorted((names[a], names[b]))): rule for a, b, rule, _ in make_self_collision(robot).excluded}


def with_pair(arm, rule: str, one: str = "c", other: str = "a") -> None:
    """Add a pair to an arm's list by hand."""
    element = '<element objtype="geom" objname="{}"/>'
    pair = f'<tuple name="excluded 99, rule {rule}">{element.format(one)}{element.format(other)}</tuple></custom>'
    arm.write_text(arm.read_text().replace("</custom>", pair))


def job(arm, tmp_path, start) -> dict:
    """Job of two points, at the TCP and slightly below."""
    from htcp_jax.model.kinematics import tcp_pose

    x, y, z = np.asarray(tcp_pose(load_robot(arm), jnp.array(start, float)))[:3, 3].tolist()
    with (tmp_path / "path.csv").open("w", newline="") as file:
        csv.writer(file).writerows([(x, y, z), (x, y, z - 0.002)])
    part = {"cloud": "none", "path": str(tmp_path / "path.csv")}
    return {"robot": {"model": str(arm)}, "workpiece": part, "start_rad": start, "method": "baseline"}


def check(job: dict) -> None:
    """Check a job's start, as `plan` does."""
    config = load_config(job)
    robot, workpiece, scenario = scene(config)
    check_start(robot, workpiece, scenario, obstacles_of(config.cell, robot))


def test_capsules_whose_meshes_never_touch_are_not_checked_and_those_whose_meshes_do_are(imported):
    """Exclusion by meshes: only pairs whose meshes never touch.

    The capsule about the plate reaches 0.2 m up; the arm passes 0.1 m over the plate, or through it.
    """
    over = rules(load_robot(imported(-0.1)))
    assert over["a", "c"] == "c" and over["a", "d"] == "c"
    through = rules(load_robot(imported(0.0)))
    assert ("a", "c") not in through and ("a", "d") not in through


WRIST = """<mujoco model="wrist"><compiler angle="radian"/><worldbody>
  <body name="a"><joint axis="0 0 1" range="-1 1"/><geom type="box" size="0.15 0.15 0.01"/>
    <body name="b"><joint axis="0 0 1" range="-1 1"/><geom type="box" size="0.01 0.01 0.02"/>
      <body name="c" pos="0 0 {height}"><joint axis="0 1 0" range="-{range} {range}"/>
        <geom type="box" size="0.12 0.12 0.01"/><site name="tcp" pos="0 0 0.05"/>
  </body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("height", "range_rad", "rule"),
    [(0.1, 1.2, None), (0.1, 0.5, "c"), (0.0, 1.2, "b")],
    ids=["some", "never", "always"],
)
def test_meshes_decide_on_links_that_are_not_adjacent_where_capsules_always_overlap(
    htcp, tmp_path, height, range_rad, rule
):
    """Regression: a torch was not tested against the forearm, as their capsules overlap in every configuration.

    The capsules about the plates a and c have radii of 0.2 m. The plates touch if c turns by more than 0.85 rad.
    """
    (tmp_path / "wrist.xml").write_text(WRIST.format(height=height, range=range_rad))
    htcp("robot", tmp_path / "wrist.xml", "--out", tmp_path / "arm.xml", "--most", 1)
    arm = load_robot(tmp_path / "arm.xml")
    listed = {frozenset((arm.capsule_names[a], arm.capsule_names[b])): kind for a, b, kind, _ in arm.exclusions}
    assert listed.get(frozenset("ac")) == rule


@pytest.mark.parametrize(("range_rad", "rule"), [(1.2, None), (0.5, "c")], ids=["some", "never"])
def test_meshes_decide_on_a_pair_with_a_sphere_of_the_model(htcp, tmp_path, range_rad, rule):
    """Regression: FCL states depths of 0 for triangles in a sphere. A Baxter's arm was not tested against its head.

    The plate touches the sphere if it turns by more than 0.56 rad.
    """
    model = WRIST.replace('type="box" size="0.15 0.15 0.01"', 'size="0.1"').format(height=0.13, range=range_rad)
    (tmp_path / "wrist.xml").write_text(model)
    htcp("robot", tmp_path / "wrist.xml", "--out", tmp_path / "arm.xml", "--most", 1)
    arm = load_robot(tmp_path / "arm.xml")
    listed = {frozenset((arm.capsule_names[a], arm.capsule_names[b])): kind for a, b, kind, _ in arm.exclusions}
    assert listed.get(frozenset("ac")) == rule


PLATES = """<mujoco model="plates"><compiler angle="radian"/><worldbody>
  <body name="a"><joint axis="0 0 1" range="-1 1"/><geom type="box" size="0.2 0.2 0.01"/>
    <body name="b" pos="0 0 {height}"><joint axis="{axis}" range="-0.5 0.5"/><geom type="box" size="0.2 0.2 0.01"/>
      <body name="c" pos="0 0 1"><joint axis="0 1 0" range="-1 1"/><geom size="0.02"/><site name="tcp" pos="0 0 0.05"/>
  </body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("height", "axis", "always"), [(0.0, "0 0 1", True), (0.05, "1 0 0", False)], ids=["always", "some"]
)
def test_all_pieces_of_adjacent_links_are_excluded_if_the_meshes_of_some_overlap_in_every_configuration(
    htcp, tmp_path, height, axis, always
):
    """Regression: the base of a KR 120 and the link in its bearing had five capsules each. No start was found.

    The plates are covered by several capsules. The upper one turns in the lower one, or touches it if it tilts by 0.2.
    """
    (tmp_path / "plates.xml").write_text(PLATES.format(height=height, axis=axis))
    htcp("robot", tmp_path / "plates.xml", "--out", tmp_path / "arm.xml", "--most", 4)
    arm = load_robot(tmp_path / "arm.xml")
    rule, link = {(a, b): rule for a, b, rule, _ in arm.exclusions}, arm.capsule_link
    between = [(a, b) for a, b in candidates(arm) if (link[a], link[b]) == (1, 0)]
    overlap, near = (each.mean(axis=0) for each in overlaps(arm, between, samples(arm)))
    found = {rule.get(pair) for pair, share in zip(between, overlap, strict=True) if share}
    assert found == {"b"} and near.min() < 0.9 if always else None in found


def test_a_pair_that_is_always_nearer_than_any_margin_is_not_checked(tmp_path):
    """Regression: the UR5's wrist, whose capsules are 0.08 mm apart at every configuration, could not plan at all."""
    bodies = "".join(
        f'<body name="{name}" pos="{pos} 0 0"><joint axis="0 0 1" range="-1 1"/><geom name="{name}" size="0.02"/>'
        for name, pos in (("a", 0), ("b", 0.04008), ("c", 0.3), ("d", 0.3))
    )
    arm = tmp_path / "arm.xml"
    arm.write_text(f'<mujoco><worldbody>{bodies}<site name="tcp" pos="0.1 0 0"/>{4 * "</body>"}</worldbody></mujoco>')
    robot = load_robot(arm)
    own, names = make_self_collision(robot), robot.capsule_names
    assert {(names[a], names[b]): (rule, share) for a, b, rule, share in own.excluded} == {("b", "a"): ("b", 1.0)}
    assert len(own.pairs) == 5


def test_without_its_list_an_arm_checks_links_that_are_not_adjacent(imported, tmp_path):
    arm = imported(-0.1)
    arm.write_text(re.sub("<custom>.*</custom>", "", arm.read_text(), flags=re.DOTALL))
    found = rules(load_robot(arm))
    assert ("a", "c") not in found and found["a", "b"] in "bc"


def test_wider_joint_limits_than_those_of_the_list_do_without_it(imported):
    arm = imported(-0.1)
    assert load_robot(arm).listed and not load_robot(arm, limits="simulation").listed


def test_a_pair_that_overlaps_in_the_keyframe_or_at_zero_alone_is_checked(imported):
    arm = imported(0.0)
    keyframe = '<keyframe><key qpos="0 2.2 2.2 0"/></keyframe></mujoco>'
    arm.write_text(arm.read_text().replace("</mujoco>", keyframe))
    assert ("a", "c") not in rules(load_robot(arm))


def test_a_start_in_which_meshes_touch_is_refused_though_the_list_excludes_the_pair(imported, tmp_path):
    arm = imported(0.0)
    with_pair(arm, "c")
    with pytest.raises(
        InputError, match=r"start is in collision: the meshes in the capsules c and a overlap by [\d.]+ mm"
    ):
        htcp_jax.plan(job(arm, tmp_path, FOLDED))


def test_a_start_deeper_in_an_excluded_pair_than_random_configurations_is_refused(imported, tmp_path):
    arm = imported(0.0)
    with_pair(arm, "b")
    robot = load_robot(arm)
    pair = next(
        (each.first, each.second)
        for each in robot.exclusions
        if each.rule == "b" and {each.first, each.second} == {0, 2}
    )
    x = samples(robot)
    deep = x[int(distances(robot, [pair], x)[:, 0].argmin())].tolist()
    with pytest.raises(
        InputError, match=r"start is in collision: the capsules c and a overlap by .* more than in 99% of"
    ):
        htcp_jax.plan(job(arm, tmp_path, deep))


def test_a_sweep_records_such_a_start_and_goes_on(imported, tmp_path):
    arm = imported(0.0)
    with_pair(arm, "c")
    config, robot, workpiece, scenario = resolved_scene(load_config(job(arm, tmp_path, FOLDED)))
    obstacles = obstacles_of(config.cell, robot)
    plans = batch.plan(Problem.of(robot, workpiece, scenario, config.settings, obstacles=obstacles), "baseline")
    assert plans.status[0, 0] == Status.START_IN_COLLISION


def test_validate_works_out_that_an_excluded_pair_does_not_always_overlap_and_names_the_deepest_overlap(
    htcp, imported, tmp_path
):
    arm = imported(0.0)
    with_pair(arm, "b")
    robot = load_robot(arm)
    x = samples(robot)
    depth = -distances(robot, [(2, 0)], x)[:, 0]
    start = x[int(np.abs(depth - 0.01).argmin())].tolist()  # 10 mm deep, as many random configurations are
    plan = htcp_jax.plan(job(arm, tmp_path, start))
    plan.save(tmp_path / "plan")
    reported = htcp("validate", tmp_path / "plan", "--verbose", code=1)
    assert "refuted" in reported
    assert re.search(
        r"Deepest overlap of two capsules that are not checked against each other: \w+ and \w+, [\d.]+ mm", reported
    )


def test_the_deepest_overlap_is_named_where_the_model_excludes_all_pairs_that_overlap(htcp, imported, tmp_path):
    pairs = "".join(f'<disable_collisions link1="{a}" link2="{b}"/>' for a, b in ("ab", "ac", "bc", "cd"))
    (tmp_path / "shelf.srdf").write_text(f'<robot name="shelf">{pairs}</robot>')
    arm = imported(-0.1, "--srdf", tmp_path / "shelf.srdf")
    arm.write_text(re.sub("<tuple.*?</tuple>", "", arm.read_text(), flags=re.DOTALL))  # the other pairs are checked
    htcp_jax.plan(job(arm, tmp_path, [0.0, 0.1, 0.1, 0.1])).save(tmp_path / "plan")
    assert set(rules(load_robot(arm)).values()) == {"a"}
    found = json.loads(htcp("validate", tmp_path / "plan", "--json"))
    assert re.fullmatch(r"\w and \w, [\d.]+ mm", found["excluded"])


def test_a_message_about_a_self_collision_says_how_far_both_capsules_are_from_their_meshes_there(imported, tmp_path):
    """Message about a self-collision: the distances between both capsules and their meshes there.

    The capsules overlap so deeply that the meshes do, too; so no piece is measured, and the message does not say so.
    """
    arm = imported(0.0)
    with pytest.raises(InputError) as by_capsule:
        check(by_capsules(job(arm, tmp_path, FOLDED)))
    note = (
        r"capsule c is .* mm inside capsule a; the mesh itself is there "
        r"([\d.]+) mm below the capsule's surface in c and ([\d.]+) mm below the capsule's surface in a"
    )
    gaps = [float(gap) for gap in re.search(note, str(by_capsule.value)).groups()]
    robot = load_robot(arm)
    p, q = (np.asarray(ends)[[2, 0], None] for ends in capsule_segments(robot, jnp.array(FOLDED)))
    on_c, on_a = p + np.linspace(0, 1, 2001)[:, None] * (q - p)
    distance, nearest = cKDTree(on_a).query(on_c)
    axis_c, axis_a = on_c[distance.argmin()], on_a[nearest[distance.argmin()]]
    surface = axis_a + float(robot.capsule_radius[0]) * (axis_c - axis_a) / distance.min()
    outside = np.abs(surface - [0.15, 0, 0]) - [0.15, 0.15, 0.01]  # of the plate, which has its own frame at x = 0
    expected = [robot.capsule_radius[2] - 0.02, np.linalg.norm(np.maximum(outside, 0))]
    np.testing.assert_allclose(gaps, 1e3 * np.array(expected), rtol=0.01)
    with pytest.raises(InputError) as by_mesh:
        check(job(arm, tmp_path, FOLDED))
    assert str(by_mesh.value) == str(by_capsule.value).replace("capsule c is", "c is").replace("capsule a;", "a;")


def by_capsules(job: dict) -> dict:
    return job | {"robot": job["robot"] | {"bodies": "capsules"}}


def test_the_distance_from_a_mesh_is_that_of_the_box(imported):
    arm = imported(0.0)
    meshes, robot = LinkMeshes.read(arm), load_robot(arm, base_m=(1.0, 2.0, 3.0))
    point = np.array([1.0 + 0.15, 2.0, 3.0 + 0.06])
    assert meshes.outside_m("a", robot, np.zeros(4), point) == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("c", "'excluded 99, rule c': no capsule 'nobody'; valid: a, b, c, d"),
        ("x", "tuple 'excluded 99, rule x' must be named 'excluded NUMBER, rule a', or rule b or c"),
    ],
)
def test_a_pair_that_is_none_is_refused(pair, message, imported):
    arm = imported(0.0)
    with_pair(arm, pair, one="nobody")
    with pytest.raises(InputError, match=re.escape(message)):
        load_robot(arm)


def test_a_capsule_that_is_paired_with_itself_is_refused(imported):
    arm = imported(0.0)
    with_pair(arm, "c", one="a")
    with pytest.raises(InputError, match="'excluded 99, rule c' pairs 'a' with itself; name two different capsules"):
        load_robot(arm)


def test_a_pair_without_a_list_is_refused(imported):
    arm = imported(0.0)
    with_pair(arm, "c", one="nobody")
    arm.write_text(re.sub('<text name="self_collision".*?/>', "", arm.read_text()))
    with pytest.raises(
        InputError, match="tuple 'excluded 1, rule b' has no effect without <text name='self_collision'>"
    ):
        load_robot(arm)


SRDF = '<robot name="{}"><disable_collisions link1="{}" link2="{}" reason="Never"/></robot>'


def test_an_srdf_excludes_bodies(imported, tmp_path):
    (tmp_path / "shelf.srdf").write_text(SRDF.format("shelf", "a", "d"))
    assert rules(load_robot(imported(0.0, "--srdf", tmp_path / "shelf.srdf")))["a", "d"] == "a"


def test_elements_of_an_srdf_that_are_not_used_are_named(tmp_path):
    text = SRDF.format("shelf", "a", "d").replace("</", '<disable_default_collisions link="b"/></')
    (tmp_path / "shelf.srdf").write_text(text)
    with pytest.warns(Note, match="shelf.srdf: not used: <disable_default_collisions>$"):
        assert disabled_pairs(tmp_path / "shelf.srdf", "shelf", "abcd", Ledger()) == [("a", "d")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            SRDF.format("panda", "a", "d"),
            "the model is 'shelf'; if both are the same robot, write <robot name='shelf'> in the SRDF",
        ),
        ("<robot", "other.srdf: not an SRDF file: "),
        (SRDF.format("shelf", "a", "hand"), "a and hand: the model has no link hand; valid: a, b, c, d"),
        ('<robot name="shelf"/>', "<disable_collisions> is missing"),
        (
            SRDF.format("shelf", "a", "d").replace("<d", "<group><d").replace("</r", "</group></r"),
            "a <disable_collisions> is inside another element; it must be a child of <robot>",
        ),
        ("<mujoco/>", "the root is <mujoco>; in an SRDF file it must be <robot>"),
    ],
)
def test_the_srdf_of_another_robot_is_refused_before_capsules_are_fitted(htcp, text, message, tmp_path):
    model, other, fitted = tmp_path / "shelf.xml", tmp_path / "other.srdf", []
    model.write_text(ARM.format(z=0.0))
    other.write_text(text)
    reported = htcp("robot", model, "--srdf", other, "--out", tmp_path / "arm.xml", code=2)
    assert message in reported and not (tmp_path / "arm.xml").exists()
    with pytest.raises(InputError, match=re.escape(message)):
        import_robot(model, srdf=other, progress=lambda *numbers: fitted.append(numbers))
    assert not fitted


def test_a_list_that_leaves_nothing_to_check_is_refused(htcp, tmp_path):
    pairs = [f'<disable_collisions link1="{a}" link2="{b}"/>' for a, b in ("ab", "ac", "ad", "bc", "bd", "cd")]
    (tmp_path / "all.srdf").write_text(f'<robot name="shelf">{"".join(pairs)}</robot>')
    (tmp_path / "shelf.xml").write_text(ARM.format(z=0.0))
    reported = htcp(
        "robot",
        tmp_path / "shelf.xml",
        "--srdf",
        tmp_path / "all.srdf",
        "--most",
        1,
        "--out",
        tmp_path / "arm.xml",
        code=2,
    )
    assert (
        "all 6 pairs of capsules are excluded; remove exclusions to check some" in reported
        and not (tmp_path / "arm.xml").exists()
    )


def test_a_tool_that_passes_through_a_link_is_refused_at_a_start_outside_of_the_models_zero(htcp, tmp_path):
    """Tool through a link: refused at the start.

    The Panda's zero is outside its own limits; the shaft of a long tool passes through its links 3 and 4.
    """
    model = path_of("panda")
    htcp("robot", model, "--tcp", "panda_hand", "--out", tmp_path / "arm.xml")
    points = [(0.10486, 0, 0.52578 + 0.03 * k / 9) for k in range(10)]
    (tmp_path / "path.csv").write_text("".join(",".join(map(str, point)) + "\n" for point in points))
    holder = {"name": "holder", "p_m": [0, 0, 0.015], "q_m": [0, 0, 0.05], "radius_m": 0.02}
    shaft = {"name": "shaft", "p_m": [0, 0, 0.05], "q_m": [0, 0, 0.287], "radius_m": 0.008}
    robot = {"model": str(tmp_path / "arm.xml"), "tool": {"tip_m": [0, 0, 0.3], "bodies": [holder, shaft]}}
    part = {"cloud": "none", "path": str(tmp_path / "path.csv")}
    with pytest.raises(InputError, match=r"capsule shaft is .* mm inside panda_link"):
        check({"robot": robot, "workpiece": part, "start_rad": PANDA_START})


def test_spheres_about_the_capsules_leave_out_no_pair_that_overlaps_or_is_near():
    robot = load_robot()
    pairs, x = candidates(robot), samples(robot)[:1200]
    measured = distances(robot, pairs, x)
    overlap, near = overlaps(robot, pairs, x)
    assert np.array_equal(overlap, measured <= 0) and np.array_equal(near, measured <= NEAR_M)
    assert 0.01 < overlap.mean() < 0.5
