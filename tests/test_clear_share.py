"""Shares of configurations in which an imported arm is clear, and pieces that are cut closer where they differ."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from enclosed import are_enclosed

from htcp_jax.clearance import is_clear
from htcp_jax.clearance.obstacles import make_self_collision, self_exclusions
from htcp_jax.cli import main
from htcp_jax.io.robots import ImportedArm, LinkMeshes, arm_xml, check_arm, import_robot, load_robot
from htcp_jax.io.robots.clear_share import NEARLY, SAMPLES, CheckedArm, ClearShares
from htcp_jax.model import Robot

# A forked wrist: the rod turns in the throat of the fork, and always overlaps the fork's hull. In some configurations
# it touches a prong or the bridge.
ARM = """<mujoco model="forked"><compiler angle="radian"/><worldbody>
  <body name="base"><joint name="j1" axis="0 0 1" range="-2 2"/><geom type="box" size="0.1 0.1 0.05"/>
    <body name="fork" pos="0.3 0 0.4"><joint name="j2" axis="1 0 0" range="-2 2"/>
      <geom type="box" size="0.03 0.12 0.04" pos="-0.05 0 0"/>
      <geom type="box" size="0.12 0.01 0.04" pos="0.1 0.11 0"/>
      <geom type="box" size="0.12 0.01 0.04" pos="0.1 -0.11 0"/>
      <body name="pin" pos="0.12 0 0"><joint name="j3" axis="0 1 0" range="-1.2 1.2"/>
        <geom type="box" size="0.01 0.02 0.01"/>
        <body name="rod"><joint name="j4" axis="0 0 1" range="-{range} {range}"/>
          <geom type="box" size="0.06 0.008 0.008" pos="0.06 0 0"/><site name="tcp" pos="0.12 0 0"/>
</body></body></body></body></worldbody></mujoco>"""


class Nowhere(NamedTuple):
    """The pose that `is_clear` needs for a workpiece; there is none."""

    T_world_workpiece: jax.Array
    interior_plane: jax.Array


class Forked(NamedTuple):
    """The model's file, its first import, the import that was checked, and the output of `htcp robot --json`."""

    file: Path
    first: ImportedArm
    checked: CheckedArm
    printed: dict


@pytest.fixture(scope="module")
def forked(tmp_path_factory) -> Forked:
    folder = tmp_path_factory.mktemp("forked")
    file, out = folder / "forked.xml", folder / "arm.xml"
    file.write_text(ARM.format(range=1.8))
    with redirect_stdout(StringIO()) as printed:
        assert main(["robot", str(file), "--out", str(out), "--most", "1", "--json"]) == 0
    first = import_robot(file, most=1)
    return Forked(file, first, check_arm(first, loader(folder / "again.xml")), json.loads(printed.getvalue()))


def loader(file: Path):
    def load(arm: ImportedArm) -> Robot:
        file.write_text(arm_xml(arm, "forked.xml"))
        return load_robot(file)

    return load


def clear_in(robot: Robot, x: np.ndarray) -> np.ndarray:
    own, nowhere = make_self_collision(robot), Nowhere(jnp.eye(4), jnp.zeros(4))
    return np.asarray(jax.jit(lambda x: jax.lax.map(lambda x: is_clear(robot, (own,), nowhere, x), x))(x))


def touching(file: Path, x: np.ndarray) -> np.ndarray:
    """Configurations in which MuJoCo finds a contact of the model's own boxes, except between adjacent bodies."""
    model = mujoco.MjModel.from_xml_path(str(file))
    data, found = mujoco.MjData(model), []
    for row in x:
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        found.append(any(data.contact.dist[: data.ncon] < -1e-6))
    return np.array(found)


def test_pieces_are_cut_until_an_arm_that_is_never_clear_is_so_as_often_as_by_its_meshes(forked):
    found = forked.printed["clear"]
    assert 0.2 < found["meshes"] < 1.0 and found["pieces"] >= NEARLY * found["meshes"] and not found["differing"]
    assert forked.printed["cut closer"] == list(forked.checked.closer_than(forked.first))
    uncut = LinkMeshes.convex(forked.first)
    at = uncut.poses(self_exclusions.samples(load_robot(forked.file.with_name("arm.xml")))[:SAMPLES])
    assert all(uncut.overlap("rod", "fork", at, k) for k in range(SAMPLES))


def test_no_contact_of_the_meshes_is_missed_after_cuts(forked):
    robot = load_robot(forked.file.with_name("arm.xml"))
    x = self_exclusions.samples(robot)[:2000]
    is_clear, touches = clear_in(robot, x), touching(forked.file, x)
    assert touches.sum() > 100 and is_clear.sum() > 100 and not (is_clear & touches).any()


def test_the_shares_are_those_of_the_planner_and_of_mujoco(forked):
    robot = load_robot(forked.file.with_name("arm.xml"))
    x = self_exclusions.samples(robot)[:SAMPLES]
    assert forked.printed["clear"]["pieces"] == pytest.approx(clear_in(robot, x).mean(), abs=1e-9)
    assert forked.printed["clear"]["meshes"] == pytest.approx(1 - touching(forked.file, x).mean(), abs=0.01)


def test_only_bodies_of_pairs_that_make_the_difference_are_cut_and_their_capsules_hold_every_triangle(forked):
    names = {b: forked.first.model.body(b).name for b in forked.first.covers}
    changed = {names[b] for b, cover in forked.checked.arm.covers.items() if cover is not forked.first.covers[b]}
    assert "fork" in changed and changed <= {"fork", "rod"}
    for cover in forked.checked.arm.covers.values():
        assert are_enclosed(cover.enclosed, list(cover.fitted.values()))
        for name, piece in cover.pieces.items():
            assert cover.hulls[name].missed_m(piece.triangles.reshape(-1, 3)) == 0.0


def test_an_arm_whose_pieces_are_as_clear_as_its_meshes_stays_as_it_was(tmp_path):
    """The rod of a fork with a short range never touches; rule c excludes the pair."""
    (tmp_path / "forked.xml").write_text(ARM.format(range=0.2))
    arm = import_robot(tmp_path / "forked.xml", most=1)
    checked = check_arm(arm, loader(tmp_path / "arm.xml"))
    assert checked.arm is arm and checked.closer_than(arm) == ()
    assert checked.shares.pieces == checked.shares.meshes == 1.0


def test_pairs_are_named_until_the_rest_makes_no_difference():
    """Four pairs in 100 configurations, of which meshes leave 80 clear; 0 to 79 are clear by them."""
    k = np.arange(100)
    by_pieces = {("a", "b"): k < 60, ("a", "c"): (k > 40) & (k < 70), ("d", "e"): k == 75, ("f", "g"): k >= 80}
    none = np.zeros(100, bool)
    shares = ClearShares(by_pieces, dict.fromkeys(by_pieces, none) | {("f", "g"): k >= 80}, 100)
    assert (shares.pieces, shares.meshes) == (pytest.approx(0.09), pytest.approx(0.8))
    assert list(map(str, shares.differing)) == ["a and b (60.0%)", "a and c (29.0%)"]
    assert shares.described() == (
        "9% of 100 random configurations, 80% by the meshes; the difference: a and b (60.0%), a and c (29.0%)"
    )
    often = ClearShares({("a", "b"): k < 60}, {("a", "b"): k < 60}, 100)
    assert often.differing == () and often.described().endswith("; meshes that overlap often: a and b (60.0%)")
