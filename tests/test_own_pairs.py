"""Pairs of an arm's capsules that the validation does not check, as in a bearing: a toy arm of spheres."""

import numpy as np
import pytest

from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.own_pairs import own_pairs

# The link "hub" turns about z in the link "base". Its sphere "shaft" is in the sphere "ring" of the base, its sphere
# "crank" meets the sphere "stop" of the base at some angles. So do the spheres "core" and "tip" of the third link.
ARM = """<mujoco model="bearing"><compiler angle="radian"/><worldbody>
  <body name="base"><joint name="j1" axis="0 0 1" range="-1 1"/>
    <geom name="ring" size="0.05"/><geom name="stop" size="0.05" pos="0.2 0 0"/>
    <body name="hub"><joint name="j2" axis="0 0 1" range="-2 2"/>
      <geom name="shaft" size="0.04" pos="0 0 {height}"/><geom name="crank" size="0.04" pos="0.2 0 0.01"/>
      <body name="third"><joint name="j3" axis="0 0 1" range="-2 2"/>
        <geom name="core" size="0.03"/><geom name="tip" size="0.04" pos="0.2 0 -0.01"/><site name="tcp" pos="0 0 0.5"/>
  </body></body></body></worldbody>
  <custom><text name="self_collision" data="listed"/>{pairs}</custom></mujoco>"""
GEOM = '<element objtype="geom" objname="{}"/>'
EXCLUDED = f'<tuple name="excluded {{}}, rule {{}}">{GEOM}{GEOM}</tuple>'


@pytest.fixture
def not_checked(tmp_path):
    """A function of the shaft's height [m] and of pairs with rules: the names of the pairs that are not checked."""

    def found(height: float, *listed: tuple[str, str, str]) -> set[frozenset[str]]:
        pairs = "".join(EXCLUDED.format(k, *each) for k, each in enumerate(listed))
        (tmp_path / "arm.xml").write_text(ARM.format(height=height, pairs=pairs))
        arm = MujocoArm(tmp_path / "arm.xml")

        def measured(poses, wanted):
            a, b = np.array(wanted).T
            return np.linalg.norm(poses.p[:, a] - poses.p[:, b], axis=2) - arm.radius[a] - arm.radius[b]

        kinds = own_pairs(arm, measured)
        assert sorted([*kinds.checked, *kinds.excluded]) == sorted(arm.apart) and not kinds.by_mesh
        return {frozenset(arm.names[k] for k in pair) for pair in kinds.excluded}

    return found


IN_BEARING = ("b", "shaft", "ring"), ("b", "crank", "stop")
ALWAYS, SOMETIMES = frozenset(["shaft", "ring"]), frozenset(["crank", "stop"])


def test_all_listed_pairs_of_a_bearing_are_excluded_if_some_capsules_of_its_links_always_overlap(not_checked):
    """The crank meets the stop at a few angles only."""
    assert not_checked(0.0, *IN_BEARING) == {ALWAYS, SOMETIMES}


def test_a_pair_is_checked_in_spite_of_a_list_that_calls_it_a_bearing_if_its_links_come_apart(not_checked):
    """The shaft is 0.1 m above the ring: no capsules of the two links overlap in every configuration."""
    assert not_checked(0.19, *IN_BEARING) == set()


def test_a_pair_of_a_bearing_that_no_list_excludes_is_checked(not_checked):
    """The meshes in the crank and the stop were found to touch, so that the list names the other pair alone."""
    assert not_checked(0.0, IN_BEARING[0]) == {ALWAYS}


def test_links_with_another_joint_between_them_are_no_bearing(not_checked):
    """The core is always in the ring, and the tip meets the stop as the crank does, but two joints move them."""
    assert not_checked(0.0, ("b", "core", "ring"), ("b", "tip", "stop")) == {frozenset(["core", "ring"])}
