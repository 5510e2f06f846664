"""Scenarios by the scene's rules: its own figures for start, pose and targets, and the rejected inputs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest

from htcp_jax.errors import InputError
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import tcp_position
from htcp_jax.model.robot import lengthen_tool
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario, path_targets

POSE = (0.4, 0.1)


def scenario(**changes):
    return make_scenario(made_once.robot(), made_once.duct(), changes.pop("start", made_once.START), **changes)


def test_the_nominal_scenario_has_105_targets_from_the_start_tcp_to_the_welds_end():
    nominal = scenario()
    assert nominal.targets.shape == (105, 3) and nominal.count == 105
    np.testing.assert_allclose(nominal.targets[0], (1.1213389, -0.0983330, 1.4193919), rtol=0, atol=3e-7)
    inlet, weld = nominal.targets[5], nominal.targets[11:]
    T = nominal.T_world_workpiece
    np.testing.assert_allclose(inlet, T[:3, :3] @ made_once.duct().inlet + T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(weld, made_once.duct().path @ T[:3, :3].T + T[:3, 3], atol=1e-12)
    np.testing.assert_allclose(nominal.targets[10], weld[0], atol=1e-12)  # the first weld point is met twice


def test_the_approach_goes_in_equal_steps():
    targets = scenario().targets
    for leg in (targets[0:6], targets[5:11]):
        steps = np.diff(leg, axis=0)
        np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-12)


def test_the_measured_weld_is_where_the_scene_says():
    """Measured weld in the world frame, to 1e-5 m.

    The scene's own figures are 5.4 um farther apart than the weld's ends (see test_workpiece.py).
    """
    weld = make_scenario(made_once.robot(), made_once.measured_duct(), made_once.START, rotation=POSE).targets[11:]
    np.testing.assert_allclose(weld[0], (1.6560575, -0.1859774, 1.1261086), rtol=0, atol=1e-5)
    np.testing.assert_allclose(weld[-1], (2.3518327, -0.1180665, 0.8345056), rtol=0, atol=1e-5)


def test_without_an_inlet_the_steps_go_straight_to_the_path():
    tcp, path = np.array([0.0, 0.0, 1.0]), np.array([[1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    targets = path_targets(tcp, None, path, (2, 2))
    np.testing.assert_allclose(targets[:, 0], [0, 0.25, 0.5, 0.75, 1, 1, 1])
    via = path_targets(tcp, np.array([0.0, 1.0, 1.0]), path, (1, 3))
    np.testing.assert_allclose(via[1], [0, 1, 1])
    assert len(via) == 1 + 1 + 3 + 2


def test_the_pose_turns_about_the_pivot_first_by_wy_then_by_wz():
    """Pose of the workpiece: about the pivot, first by wy, then by wz; the pivot stays where it is."""
    duct = made_once.duct()
    home = duct.T_world(0.0, 0.0)
    np.testing.assert_allclose(home[:3, 3], duct.neutral_translation)
    for wy, wz in ((0.4, 0.1), (-0.2, 0.5)):
        T = scenario(rotation=(wy, wz)).T_world_workpiece
        pivot = np.asarray(duct.pivot) - home[:3, 3]
        np.testing.assert_allclose(T[:3, :3] @ pivot + T[:3, 3], duct.pivot, atol=1e-12)
        y = np.array([[np.cos(wy), 0, np.sin(wy)], [0, 1, 0], [-np.sin(wy), 0, np.cos(wy)]])
        z = np.array([[np.cos(wz), -np.sin(wz), 0], [np.sin(wz), np.cos(wz), 0], [0, 0, 1]])
        np.testing.assert_allclose(T[:3, :3], z @ y, atol=1e-12)


def test_a_shift_moves_the_workpiece_its_gate_and_its_targets_but_not_the_start():
    still, moved = scenario(), scenario(shift=(0.05, -0.02, 0.01))
    step = moved.targets - still.targets
    np.testing.assert_allclose(step[5:], np.tile((0.05, -0.02, 0.01), (100, 1)), atol=1e-12)
    np.testing.assert_allclose(moved.interior_plane[3] - still.interior_plane[3], 0.05, atol=1e-12)
    np.testing.assert_allclose(moved.targets[0], still.targets[0], atol=1e-12)


def test_the_gate_is_20_cm_behind_the_clouds_nearest_x():
    s = scenario(rotation=(0.7, -0.2))
    x = made_once.duct().cloud @ s.T_world_workpiece[0, :3] + s.T_world_workpiece[0, 3]
    np.testing.assert_allclose(s.interior_plane, [1, 0, 0, x.min() + 0.2], atol=1e-12)


def test_a_longer_tool_starts_its_path_at_its_own_tip():
    s = scenario(tool_extension_m=0.05)
    longer = lengthen_tool(made_once.robot(), 0.05)
    np.testing.assert_allclose(s.targets[0], tcp_position(longer, jnp.asarray(made_once.START)), atol=1e-12)
    assert np.linalg.norm(s.targets[0] - scenario().targets[0]) > 0.049


def test_stacked_scenarios_keep_their_own_numbers_and_pad_their_targets_with_the_last():
    short, long = scenario(approach=(2, 3), number=7, margin_m=1e-3), scenario(number=8, margin_m=0.0)
    both = stack([short, long])
    np.testing.assert_array_equal(both.count, [100, 105])
    np.testing.assert_array_equal(both.number, [7, 8])
    np.testing.assert_array_equal(both.margin_m, [1e-3, 0.0])
    np.testing.assert_array_equal(both.targets[0, :100], short.targets)
    np.testing.assert_array_equal(both.targets[0, 100:], np.tile(short.targets[-1], (5, 1)))
    np.testing.assert_array_equal(both.targets[1], long.targets)
    assert both.task_goals is None and all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(both))
    goals = [np.arange(2.0 * len(one.targets)).reshape(-1, 2) for one in (short, long)]
    both = stack([replace(one, task_goals=own) for one, own in zip((short, long), goals, strict=True)])
    np.testing.assert_array_equal(both.goals[0, 98:], [[196, 197], *[[198, 199]] * 6])


def test_no_scenarios_are_refused():
    with pytest.raises(InputError, match="no scenarios"):
        stack([])


def test_a_start_of_the_wrong_length_or_outside_the_limits_is_refused_by_name():
    with pytest.raises(InputError, match=r"5 joint positions.*6 joints"):
        scenario(start=made_once.START[:5])
    with pytest.raises(InputError, match=r"joint3 at 3.5 is outside"):
        scenario(start=(0.0, 0.0, 3.5, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="joint1"):
        scenario(start=(np.nan, 0.0, 0.0, 0.0, 0.0, 0.0))


def test_a_target_beyond_reach_is_refused_by_number():
    duct = made_once.duct()
    path = duct.path.copy()
    path[40] += 9.0
    far = Workpiece("far", duct.cloud, path, duct.inlet, hull_tolerance_m=5e-4)
    with pytest.raises(InputError, match=r"target 51 is .* reaches"):
        make_scenario(made_once.robot(), far, made_once.START)
