"""Timed motions keep every limit at 1 ms and the feed rate on the weld, as near to the plan as its proof allows.

All is measured on the result, by finite differences and by MuJoCo, not taken from the time scaling itself.
"""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
import toy
from made_plan import STATUSES, made_plans, with_a_dwell
from test_joint_path import rail

from htcp_jax import api
from htcp_jax.errors import InputError
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model import Task
from htcp_jax.motion import Motion
from htcp_jax.motion.manipulability import manipulability
from htcp_jax.motion.motion import motion as motion_of
from htcp_jax.spec import GP50
from htcp_jax.spec.config import ProgramConfig
from htcp_jax.spec.feed import feed_of
from htcp_jax.status import Kind
from htcp_jax.trajectory.blends import SHARE, MotionSlack, motion_slack
from htcp_jax.trajectory.curve import FARTHEST, Blend, Curve
from htcp_jax.trajectory.displacement import arm_at, displacement_bound
from htcp_jax.trajectory.figures import program_figures
from htcp_jax.trajectory.limits import joint_limits
from htcp_jax.trajectory.path import path_of_blend
from htcp_jax.trajectory.program import time_motion
from htcp_jax.trajectory.time_scaling import time_scaling
from htcp_jax.viewer.arm_pose import arms_at

_, A, F, D, R = Kind
STEP_S = 1e-3
ROUNDING = 1e-6  # of a limit: third differences of doubles over 1 ms


@cache
def mujoco_model():
    return mujoco.MjModel.from_xml_path(str(GP50))


def tcp_by_mujoco(x):
    """TCP of the GP50 in the world frame [m]."""
    model = mujoco_model()
    data, found = mujoco.MjData(model), []
    for configuration in x:
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        found.append(data.site("tcp").xpos.copy())
    return np.array(found)


def weld(count=40, seed=0, rough=0.0, length=0.3):
    """Configurations of the GP50 with the TCP on a line of `count` points along y, by Gauss-Newton in MuJoCo.

    `rough`: random displacement of each configuration in the null space [rad].
    """
    model, rng = mujoco_model(), np.random.default_rng(seed)
    data, x, found = mujoco.MjData(model), np.array([0.1, -2.0, 0.6, 0.2, 0.6, -1.0]), []
    begin = tcp_by_mujoco([x])[0]
    jacobian = np.zeros((3, model.nv))
    for k in range(count):
        aim = begin + np.array([0.0, length * k / (count - 1), 0.0])
        x = x + rough * rng.normal(size=6)
        for _ in range(20):
            data.qpos[:] = x
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian, None, data.site("tcp").id)
            x = x + np.linalg.pinv(jacobian) @ (aim - data.site("tcp").xpos)
        found.append(x)
    return np.array(found)


def whole_motion(seed=0, rough=0.002):
    """Home, an approach with corners, a weld with a dwell and a repeated point, and the way back."""
    line = weld(seed=seed, rough=rough)
    home = np.array([0.0, -1.5, 0.3, 0.0, 0.3, 0.0])
    turned = line[20] + np.array([[0, 0, 0, 0, 0, 0.2], [0, 0, 0, 0, 0, 0.4]])
    rest = line[20:] + np.array([0, 0, 0, 0, 0, 0.4])
    there = [
        home,
        home + 0.4,
        line[0] - 0.1,
        line[0],
        *line[1:21],
        *turned[:1],
        rest[0],
        *rest[1:10],
        rest[9],
        *rest[10:],
    ]
    kind = [A] * 4 + [F] * 20 + [D, D] + [F] * (len(there) - 26)
    x, target = np.array(there), np.arange(len(there))
    back = len(x) - 1
    return Motion(
        np.concatenate([x, x[-2::-1]]),
        np.concatenate([target, target[-2::-1]]),
        np.array(kind + [R] * back, np.int8),
    )


def free_radius(motion, clearance=5e-3, tube=1e-3):
    """Equal slack for every segment."""
    kept = np.isin(motion.kind[1:], (F, D))
    return MotionSlack(np.full(len(kept), clearance), np.where(kept, tube, np.inf))


@cache
def made(feed=0.02, seed=0, rough=0.002):
    motion, robot = whole_motion(seed, rough), made_once.robot()
    return time_motion(robot, motion, free_radius(motion), joint_limits(robot), feed)


def shares(timed, limits):
    """Largest shares of the limits on velocity, acceleration and jerk, by finite differences over 1 ms."""
    differences = [np.diff(timed.x, n=n, axis=0) / STEP_S**n for n in (1, 2, 3)]
    return [float((np.abs(part) / limit).max()) for part, limit in zip(differences, limits, strict=True)]


@pytest.mark.parametrize(
    ("feed", "seed", "rough"), [(0.02, 0, 0.002), (0.1, 1, 0.002), (0.3, 2, 0.01), (0.02, 3, 0.02)]
)
def test_no_limit_is_exceeded_by_finite_differences_at_1_ms(feed, seed, rough):
    one = made(feed, seed, rough)
    assert max(shares(one.timed(STEP_S), joint_limits(made_once.robot()))) <= 1 + ROUNDING


@pytest.mark.parametrize("seed", range(8))
def test_legs_a_thousand_times_shorter_than_others_keep_the_limits_within_a_millisecond_too(seed):
    rng = np.random.default_rng(seed)
    step = rng.normal(size=(30, 6)) * 10 ** rng.uniform(-5, -0.5, size=(30, 1))
    x = np.array([0.0, -2.0, 0.5, 0.0, 0.5, -1.0]) + np.cumsum(step, axis=0)
    motion = Motion(x, np.zeros(30, int), np.full(30, A))
    one = time_motion(
        made_once.robot(), motion, free_radius(motion, clearance=2e-5), joint_limits(made_once.robot()), 0.02
    )
    assert max(scaling.speed.slower for scaling in one.scalings) < 1.005, (
        "one corner does not slow the complete motion down"
    )
    for k, limit in enumerate(joint_limits(made_once.robot()), 1):
        found = np.diff(one.timed(1e-4).x, n=k, axis=0) / 1e-4**k
        assert np.abs(found / limit).max() <= 1 + 100 * ROUNDING


def test_velocities_and_accelerations_are_the_differences_of_the_configurations():
    timed = made().timed(STEP_S)
    x, limits = timed.x, joint_limits(made_once.robot())
    middle = (x[2:] - x[:-2]) / (2 * STEP_S)
    assert np.abs(middle - timed.velocity[1:-1]).max() <= STEP_S**2 * limits.jerk.max()
    second = np.diff(x, n=2, axis=0) / STEP_S**2
    assert (np.abs(second - timed.acceleration[1:-1]) <= STEP_S * limits.jerk).all()


def test_times_rise_and_the_motion_goes_from_its_first_configuration_to_its_last_standing_at_both():
    one = made()
    timed = one.timed(STEP_S)
    assert (
        timed.time_s[0] == 0 and 0 <= timed.time_s[-1] - one.duration_s < STEP_S and (np.diff(timed.time_s) > 0).all()
    )
    np.testing.assert_allclose(timed.x[[0, -1]], one.motion.x[[0, -1]], atol=1e-9)
    assert np.abs(timed.velocity[[0, -1]]).max() < 1e-9
    passed = timed.target[np.append(True, np.diff(timed.target) != 0)]
    requested = one.motion.target[1:]
    assert set(passed.tolist()) <= set(requested.tolist()) and len(passed) >= len(set(requested.tolist()))
    kinds = timed.kind[np.append(True, np.diff(timed.kind) != 0)].tolist()
    assert kinds == [A, F, D, F, R]


def test_the_feed_is_held_by_mujoco_but_where_the_arm_stops():
    one = made()
    timed = one.timed(STEP_S)
    feeding = np.flatnonzero(timed.kind == F)
    tcp = tcp_by_mujoco(timed.x)
    speed = np.linalg.norm(np.diff(tcp, axis=0), axis=1)[:-1] / STEP_S
    feeding = feeding[feeding < len(speed)]
    drops = one.drops()
    assert [drop.reason for drop in drops].count("stop") >= 3  # at the start, the dwell and the end
    dipping = sum(drop.end_m - drop.begin_m for drop in drops)
    off = np.abs(speed[feeding] - 0.02) > 0.01 * 0.02
    assert speed[feeding].max() < 1.001 * 0.02
    assert speed[feeding][off].sum() * STEP_S == pytest.approx(dipping, abs=5e-4)
    assert dipping < 0.03 * 0.3


def test_the_table_of_drops_names_the_joint_whose_limit_is_reached():
    """Feed drops of a motion with one slow joint: each names that joint as its reason."""
    motion, robot = whole_motion(rough=0.0), made_once.robot()
    slopes = np.abs(np.diff(motion.x[3:24], axis=0)).max(axis=0) / (0.3 / 39)
    joint = int(slopes.argmax())
    slow = replace(robot, speed=robot.speed.at[joint].set(0.8 * 0.05 * slopes[joint]))
    drops = time_motion(slow, motion, free_radius(motion), joint_limits(slow), 0.05).drops()
    reasons = {drop.reason for drop in drops} - {"stop"}
    assert reasons and all(slow.joint_names[joint] in reason for reason in reasons)


def test_a_feed_drop_near_a_singularity_is_where_the_manipulability_is_lowest():
    """Line of the toy arm's TCP to 0.4 mm before the stretched arm, where the elbow cannot be as fast as needed."""
    r = np.linspace(0.7, 0.9996, 60)
    elbow = np.arccos((r**2 - 0.4**2 - 0.6**2) / (2 * 0.4 * 0.6))
    shoulder = 1.2 - np.arctan2(0.6 * np.sin(elbow), 0.4 + 0.6 * np.cos(elbow))
    x = np.stack([0 * r, shoulder, elbow, 0 * r], axis=1)
    robot = replace(toy.robot(), speed=jnp.full(4, 2.0), acceleration=jnp.full(4, 40.0))
    motion = Motion(x, np.arange(len(x)), np.full(len(x), F, np.int8))
    made = time_motion(robot, motion, free_radius(motion), joint_limits(robot), 0.1)
    values = manipulability(robot, Task(), x, np.zeros((len(x), 3)))
    drop = max((drop for drop in made.drops() if drop.reason != "stop"), key=lambda drop: drop.end_m)
    assert values[drop.target] < 0.2 * np.median(values) and values[drop.first_target] > values[drop.target]
    assert 40 < drop.first_target <= drop.target <= drop.last_target < len(x) and drop.feed_m_s < 0.1
    found = program_figures(made, joint_limits(robot))
    assert drop.first_target <= found.reached_target <= drop.last_target and found.reason == drop.reason
    assert found.reached_m_s < 0.09 and values[found.reached_target] < 0.5 * np.median(values)


def test_the_feed_reached_is_the_least_speed_by_mujoco_between_run_up_and_run_down_and_the_joint_is_named():
    """Reached feed rate of a weld with one slow joint.

    The minimum between run-up and run-down by MuJoCo, and the joint as the reason.
    """
    x, robot, limits = weld(rough=0.0), made_once.robot(), joint_limits(made_once.robot())
    motion = Motion(x, np.arange(len(x)), np.full(len(x), F, np.int8))
    slopes = np.abs(np.diff(x, axis=0)).max(axis=0) / (0.3 / 39)
    joint = int(slopes.argmax())
    slow = replace(robot, speed=robot.speed.at[joint].set(0.75 * 0.05 * slopes[joint]))
    held = program_figures(time_motion(robot, motion, free_radius(motion), limits, 0.05), limits)
    assert held.reason is None and held.reached_target is None and held.reached_m_s == pytest.approx(0.05, rel=0.01)
    made = time_motion(slow, motion, free_radius(motion), joint_limits(slow), 0.05)
    found = program_figures(made, joint_limits(slow))
    speed = np.linalg.norm(np.diff(tcp_by_mujoco(made.timed(STEP_S).x), axis=0), axis=1) / STEP_S
    middle = speed[len(speed) // 20 : -len(speed) // 20]
    assert 0.03 < found.reached_m_s < 0.045
    assert found.reached_m_s == pytest.approx(middle.min(), rel=2e-3)
    assert found.reason == f"velocity of {slow.joint_names[joint]}"
    assert found.held_share < held.held_share


def test_a_dwell_is_a_stop_and_the_feed_reached_is_0():
    found = program_figures(made(), joint_limits(made_once.robot()))
    assert (found.reached_m_s, found.reason) == (0.0, "stop")
    assert found.path_s == found.seconds["process"] + found.seconds["dwell"]


def test_shares_on_the_path_are_those_of_the_rows_that_feed():
    one, limits = made(0.1), joint_limits(made_once.robot())
    timed, found = one.timed(STEP_S), program_figures(one, limits)
    feeding = timed.kind == F
    for each, rates, limit in zip(found.path_shares, (timed.velocity, timed.acceleration), limits, strict=False):
        share = np.abs(rates[feeding]) / limit
        assert each.share == pytest.approx(share.max(), rel=0.02)
        assert one.joint_names.index(each.joint) == share.max(axis=0).argmax()
        assert timed.kind[np.searchsorted(timed.time_s, each.time_s)] == F
    assert [each.limit for each in found.path_shares] == ["velocity", "acceleration", "jerk"]


@pytest.mark.parametrize("tube", [1e-3, 5e-5])
def test_the_tool_stays_within_the_share_of_the_tolerance_by_mujoco(tube):
    motion, robot = whole_motion(rough=0.01), made_once.robot()
    timed = time_motion(robot, motion, free_radius(motion, tube=tube), joint_limits(robot), 0.02).timed(4 * STEP_S)
    weld_y = tcp_by_mujoco(motion.x[3:24])
    begin, end = weld_y[0], tcp_by_mujoco(motion.x[motion.kind == F][-1:])[0]
    along = (end - begin) / np.linalg.norm(end - begin)
    on = np.isin(timed.kind, (F, D))
    away = tcp_by_mujoco(timed.x[on]) - begin
    off = np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)
    between = np.concatenate(
        [a + np.linspace(0, 1, 21)[:, None] * (b - a) for a, b in zip(motion.x[3:47], motion.x[4:48], strict=True)]
    )
    polyline = tcp_by_mujoco(between) - begin
    chord_deviation = np.linalg.norm(polyline - (polyline @ along)[:, None] * along, axis=1).max()
    assert off.max() <= chord_deviation + SHARE * tube


@pytest.mark.parametrize("model", ["gp50", "rail"])
def test_no_point_of_the_arm_is_displaced_further_than_the_bound(model, tmp_path):
    """Bound on the displacement of the arm's points, by random configurations and displacements; also with a slide."""
    robot = made_once.robot() if model == "gp50" else load_robot(rail(tmp_path), limits="model")
    rng, n = np.random.default_rng(1), len(robot.slides)
    x = rng.uniform(-1, 1, (50, n))
    within, displacement = rng.uniform(0, 0.05, (50, n)), rng.normal(scale=0.02, size=(50, n))
    most, tightest = displacement_bound(arm_at(robot, x), within, displacement), 0.0
    for _ in range(20):
        near = x + within * rng.choice([-1.0, 1.0, 0.3], (50, n))
        moved = np.linalg.norm(_points(robot, near + displacement) - _points(robot, near), axis=2)
        assert (moved <= most + 1e-12).all()
        tightest = max(tightest, float((moved / np.maximum(most, 1e-9)).max()))
    assert tightest > 0.8


def _points(robot, x):
    shape = arms_at(robot, x)
    return np.concatenate([shape.p, shape.q, shape.tcp[:, None]], axis=1)


def test_no_body_is_further_from_the_polyline_than_the_share_of_its_clearance():
    motion, robot = whole_motion(rough=0.01), made_once.robot()
    one = time_motion(robot, motion, free_radius(motion, clearance=2e-3), joint_limits(robot), 0.02)
    pairs = []
    for curve in (blend.curve for blend in one.blends):
        u = curve.grid(9, 3)
        pairs.append((curve.at(u).x, np.stack([np.interp(u, curve.u, joint) for joint in curve.x.T], axis=1)))
    rounded, straight = (_points(robot, np.concatenate(part)) for part in zip(*pairs, strict=True))
    farthest = np.linalg.norm(rounded - straight, axis=2).max()
    assert 0.1 * SHARE * 2e-3 < farthest <= SHARE * 2e-3


def test_a_rounded_corner_has_the_derivatives_that_it_says_and_leaves_its_knot_by_no_more_than_it_says():
    rng = np.random.default_rng(2)
    x, u = rng.normal(size=(6, 3)), np.array([0.0, 1.0, 1.5, 3.0, 3.2, 4.0])
    reach = np.array([0.0, 0.25, 0.2, 0.1, 0.1, 0.0])
    curve, h = Curve(u, x, reach), 1e-5
    places = np.sort(np.concatenate([rng.uniform(0.01, 3.99, 300), u[1:-1]]))
    here, before, after = curve.at(places), curve.at(places - h), curve.at(places + h)
    for lower, upper in zip(range(3), range(1, 4), strict=True):
        slope = (after[lower] - before[lower]) / (2 * h)
        np.testing.assert_allclose(slope, here[upper], rtol=2e-3, atol=2e-3 * np.abs(here[upper]).max())
    off = np.linalg.norm(curve.at(u).x - x, axis=1)
    np.testing.assert_allclose(off, FARTHEST * reach * np.linalg.norm(curve.turns, axis=1), atol=1e-12)


def one_leg(robot, ends, kind=A):
    motion = Motion(np.array(ends, float), np.arange(2), np.array([A, kind], np.int8))
    return time_motion(robot, motion, free_radius(motion), joint_limits(robot), 0.02)


def test_a_single_leg_takes_as_long_as_the_double_s_of_the_joint_that_takes_longest():
    """Duration of a single segment at full speed.

    distance / v + v / a + a / j of the slowest joint (Biagiotti and Melchiorri, section 3.4).
    """
    robot, limits = made_once.robot(), joint_limits(made_once.robot())
    segment_status = np.array([0.1, -0.2, 1.5, 0.3, 0.0, 0.1])
    times = (
        np.abs(segment_status) / limits.velocity
        + limits.velocity / limits.acceleration
        + limits.acceleration / limits.jerk
    )
    assert one_leg(robot, [0 * segment_status, segment_status]).duration_s == pytest.approx(times.max(), rel=0.02)


def test_an_arm_on_a_rail_is_timed_in_metres_and_radians(tmp_path):
    robot = replace(load_robot(rail(tmp_path), limits="model"), speed=jnp.array([0.5, 2.0, 3.0]))
    x = np.array([[0, 0, 0], [1, 0.5, 0], [1, 1.0, 1.0], [-0.5, 1.0, 0]], float)
    motion = Motion(x, np.arange(4), np.full(4, A, np.int8))
    one = time_motion(robot, motion, free_radius(motion), joint_limits(robot), 0.02)
    assert max(shares(one.timed(STEP_S), joint_limits(robot))) <= 1 + ROUNDING
    np.testing.assert_allclose(one.timed().x[-1], x[-1], atol=1e-9)
    assert one.duration_s > (1 + 1.5) / 0.5


def test_a_corner_with_room_is_passed_faster_than_one_that_is_as_good_as_a_stop():
    robot = made_once.robot()
    x = np.array([[0, -1, 0, 0, 0, 0], [1, -1, 0, 0, 0, 0], [1, -1, 1, 0, 0, 0]], float)
    motion = Motion(x, np.arange(3), np.full(3, A, np.int8))
    tight, wide = (
        time_motion(robot, motion, free_radius(motion, clearance=c), joint_limits(robot), 0.02).duration_s
        for c in (1e-4, 1.0)
    )
    assert wide < 0.8 * tight


@pytest.mark.parametrize("count", [11, 101, 201, 1001])
def test_a_line_takes_as_long_in_fine_points_as_in_coarse_ones(count):
    """Legs that a joint passes within 1 ms (regression: the tool stopped at each target of a line in 0.5 mm steps)."""
    robot, x = made_once.robot(), weld(count, length=0.1)
    motion = Motion(x, np.arange(count), np.full(count, F, np.int8))
    program = time_motion(robot, motion, free_radius(motion), joint_limits(robot), 0.02)
    assert program.duration_s == pytest.approx(0.1 / 0.02, rel=0.1)
    y = tcp_by_mujoco(program.timed(STEP_S).x)[:, 1]
    middle = slice(len(y) // 5, -len(y) // 5)
    assert np.diff(y)[middle] == pytest.approx(0.02 * STEP_S, rel=0.02)


@pytest.mark.parametrize("off", [1e-9, 1e-7, 1e-6, 3e-6])
def test_corners_that_all_but_touch_do_not_slow_the_tool_down(off):
    """Duration with two wide corners that nearly touch: independent of the small distance between them."""
    robot, line, durations = made_once.robot(), weld(count=6, length=0.025, rough=1e-4), []
    for more in (0.0, off):
        u = np.cumsum([0.0, 0.005, 0.005, 0.005 + more, 0.005, 0.005])
        reach = np.array([0.0, 0.0025, 0.0025, 0.0025, 0.0025, 0.0])
        path = path_of_blend(robot, Blend(Curve(u, line, reach), np.arange(1, 6), True))
        durations.append(time_scaling(path, joint_limits(robot), 0.3).speed.duration_s)
    assert durations[1] == pytest.approx(durations[0], rel=0.05)


def test_the_arms_own_accelerations_count_where_it_has_any():
    robot = made_once.robot()
    own = replace(robot, acceleration=robot.speed.at[3].set(np.inf) * 2)
    limits = joint_limits(own, ProgramConfig(full_speed_s=0.1, full_acceleration_s=0.5))
    speed = np.asarray(robot.speed)
    np.testing.assert_array_equal(limits.acceleration, np.where(np.arange(6) == 3, speed / 0.1, 2 * speed))
    np.testing.assert_array_equal(limits.jerk, limits.acceleration / 0.5)


@pytest.mark.parametrize("feed", [0.0, -0.02, np.nan, np.inf])
def test_a_feed_that_is_not_above_0_is_refused(feed):
    motion = whole_motion()
    with pytest.raises(InputError, match="feed is"):
        time_motion(made_once.robot(), motion, free_radius(motion), joint_limits(made_once.robot()), feed)


def test_an_arm_without_velocity_limits_is_refused_by_the_joint(tmp_path):
    with pytest.raises(
        InputError, match=r"no velocity limit for joint rail; set program\.velocity, with one value per joint"
    ):
        joint_limits(load_robot(rail(tmp_path), limits="model"))


def test_a_jobs_own_limits_come_first_and_are_a_number_a_joint():
    robot, own = made_once.robot(), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    limits = joint_limits(robot, ProgramConfig(velocity=own, jerk=own))
    assert limits.velocity.tolist() == limits.jerk.tolist() == list(own)
    np.testing.assert_allclose(limits.acceleration, np.array(own) / 0.2)
    with pytest.raises(InputError, match=r"program\.acceleration has 2 values, but the robot gp50 has 6 joints"):
        joint_limits(robot, ProgramConfig(acceleration=(1.0, 2.0)))


def test_a_motion_without_configurations_is_refused():
    none = Motion(np.zeros((0, 6)), np.zeros(0, int), np.zeros(0, np.int8))
    with pytest.raises(InputError, match="no target is executable"):
        time_motion(
            made_once.robot(), none, MotionSlack(np.zeros(0), np.zeros(0)), joint_limits(made_once.robot()), 0.02
        )


def test_a_motion_in_which_nothing_moves_is_refused():
    with pytest.raises(InputError, match="the arm does not move"):
        one_leg(made_once.robot(), np.zeros((2, 6)))


def test_what_is_left_next_to_a_leg_is_that_of_its_way_there_and_back():
    """Slack of each segment there and back: the arm dwells at target 4; the three segments to target 5 are tight."""
    plans = with_a_dwell(made_plans(np.zeros((10, 3)), STATUSES[:1]))
    plans.residual[:] = 3e-4
    there_and_back = motion_of(plans, 0, 2, retract=True)
    left = motion_slack(plans, 0, there_and_back, tube_m=1e-3)
    tight = np.flatnonzero(left.clearance == 2e-4)
    assert tight.tolist() == [5, 6, 7, 10, 11, 12] and len(left.clearance) == len(there_and_back.x) - 1
    held = np.isfinite(left.tube)
    np.testing.assert_array_equal(held, np.isin(there_and_back.kind[1:], (F, D)))
    np.testing.assert_allclose(left.tube[held], 7e-4)


@pytest.mark.slow
def test_the_default_job_holds_its_feed_over_99_percent_of_the_weld():
    plan = api.plan()
    there_and_back, limits = plan.motion(retract=True), joint_limits(plan.robot)
    left = motion_slack(plan.plans, 0, there_and_back, plan.job.settings.tube_m)
    one = time_motion(plan.robot, there_and_back, left, limits, 0.02)
    timed = one.timed(STEP_S)
    assert max(shares(timed, limits)) <= 1 + ROUNDING
    speed = np.linalg.norm(np.diff(tcp_by_mujoco(timed.x), axis=0), axis=1)[:-1] / STEP_S
    speed = speed[timed.kind[:-2] == F]
    held = np.abs(speed - 0.02) <= 0.01 * 0.02
    assert speed[held].sum() >= 0.99 * speed.sum()


@pytest.mark.parametrize(("text", "m_s"), [("20mm/s", 0.02), (" 1.2 m/min", 0.02), ("2e1 mm/s", 0.02)])
def test_a_feed_is_read_with_its_unit(text, m_s):
    assert feed_of(text) == pytest.approx(m_s)


@pytest.mark.parametrize("text", ["0mm/s", "20", "mm/s", "-1mm/s", "20 in/s", "1.2.3mm/s", ""])
def test_a_feed_without_a_unit_or_not_above_0_is_refused(text):
    with pytest.raises(InputError, match="units: mm/s, m/s, mm/min, m/min"):
        feed_of(text)
