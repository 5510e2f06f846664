"""At most N configurations of a program: placed where needed, with the deviation that is measured by MuJoCo."""

import numpy as np
import pytest
from made_once import robot
from test_program import made, tcp_by_mujoco

from htcp_jax.errors import InputError
from htcp_jax.status import Kind
from htcp_jax.trajectory.deviation import FileMotion, deviations, joined_configurations, worst_deviation
from htcp_jax.trajectory.fewer_points import fewer_points, fewest_points
from htcp_jax.trajectory.timed_motion import LINEAR, QUINTIC, STRAIGHT, TimedMotion

BOTH = LINEAR, QUINTIC


def by_mujoco(timed: TimedMotion, every_s=0.005) -> tuple[float, float]:
    """Largest TCP distance from the program, joined linearly: anywhere and on the path [m]."""
    time = np.arange(0.0, made().duration_s, every_s)
    motion = made().at(time)
    joined = np.stack([np.interp(time, timed.time_s, joint) for joint in timed.x.T], axis=1)
    far = np.linalg.norm(tcp_by_mujoco(joined) - tcp_by_mujoco(motion.x), axis=1)
    return far.max(), far[np.isin(motion.kind, (Kind.PROCESS, Kind.DWELL))].max()


@pytest.mark.parametrize("most", [20, 60, 200])
def test_at_most_n_configurations_are_chosen_among_them_both_ends_and_every_stop(most):
    timed = fewer_points(robot(), made(), most).timed
    assert 0.9 * most <= len(timed.x) <= most and (np.diff(timed.time_s) > 0).all()
    for stop in (0.0, *made().ends_s):
        nearest = np.abs(timed.time_s - stop).argmin()
        assert timed.time_s[nearest] == pytest.approx(stop, abs=1e-9)
        np.testing.assert_allclose(timed.velocity[nearest], 0.0, atol=1e-9)


def test_the_stated_deviation_is_that_measured_by_mujoco_and_falls_with_the_number():
    last = np.inf
    for most in (20, 60, 200):
        file = fewer_points(robot(), made(), most)
        (found,) = deviations(robot(), made(), file)
        anywhere, on_path = by_mujoco(file.timed)
        assert anywhere <= found.tcp_m * 1.001 and found.tcp_m <= 1.1 * anywhere + 1e-6
        assert on_path <= found.path_m * 1.001 and found.path_m <= 1.1 * on_path + 1e-6
        assert found.tcp_m < 0.5 * last
        last = found.tcp_m


def test_chosen_configurations_deviate_less_than_as_many_at_equal_times():
    file = fewer_points(robot(), made(), 60)
    equal = made().at(np.linspace(0, made().duration_s, len(file.timed.x)))
    (chosen,), (even,) = (deviations(robot(), made(), each) for each in (file, FileMotion(equal)))
    assert chosen.tcp_m < 0.5 * even.tcp_m


def test_a_player_that_joins_by_splines_counts_if_the_format_has_accelerations():
    """Configurations chosen for straight chords alone may be far off by splines, as accelerations there are large."""
    for_both = deviations(robot(), made(), fewer_points(robot(), made(), 100, BOTH))
    for_one = deviations(robot(), made(), fewer_points(robot(), made(), 100)._replace(joined=BOTH))
    assert [each.joined for each in for_both] == list(BOTH)
    assert for_both[1].tcp_m < for_one[1].tcp_m
    assert worst_deviation(for_both).path_m == max(each.path_m for each in for_both)


def test_each_configuration_has_the_kind_of_the_motion_that_leads_to_it():
    timed = fewer_points(robot(), made(), 60).timed
    begins = made().ends_s[:-1]
    dense = made().at(0.5 * (timed.time_s[1:] + timed.time_s[:-1]))
    np.testing.assert_array_equal(timed.kind[1:], dense.kind)
    assert np.isin(np.round(begins, 6), np.round(timed.time_s, 6)).all()


def test_the_smallest_number_keeps_the_tolerance_and_fewer_do_not():
    tolerance = 1e-3
    number = fewest_points(robot(), made(), tolerance, BOTH)
    far = [
        worst_deviation(deviations(robot(), made(), fewer_points(robot(), made(), most, BOTH))).path_m
        for most in (number, number - 1)
    ]
    assert far[0] <= tolerance < far[1]


def test_times_are_multiples_of_the_controllers_step():
    timed = fewer_points(robot(), made(), 50, control_step_s=0.008).timed
    steps = timed.time_s / 0.008
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert len(timed.x) <= 50 and 0 <= timed.time_s[-1] - made().duration_s < 0.008


def test_fewer_configurations_than_stops_are_refused():
    with pytest.raises(InputError, match=f"at least {1 + len(made().ends_s)} are needed"):
        fewer_points(robot(), made(), len(made().ends_s))


def test_more_configurations_than_candidates_are_all_of_them():
    file = fewer_points(robot(), made(), 10**6)
    assert np.diff(file.timed.time_s).max() <= 1e-3 + 1e-9
    (found,) = deviations(robot(), made(), file)
    assert found.tcp_m < 1e-5


def test_players_join_polynomials_of_their_degree_exactly():
    time, dense = np.array([0.0, 0.3, 1.0]), np.linspace(0, 1, 50)
    powers = np.random.default_rng(0).normal(size=(6, 2))
    polynomials = [np.polynomial.Polynomial(powers[:, k]) for k in range(2)]
    x, velocity, acceleration = (np.stack([p.deriv(k)(time) for p in polynomials], axis=1) for k in range(3))
    zeros = np.zeros(3, int)
    timed = TimedMotion(time, x, velocity, acceleration, zeros.astype(np.int8), zeros, ("a", "b"))
    found = joined_configurations(made(), timed, QUINTIC, dense)
    np.testing.assert_allclose(found, np.stack([p(dense) for p in polynomials], axis=1), atol=1e-12)
    np.testing.assert_allclose(
        joined_configurations(made(), timed, LINEAR, dense)[:, 0], np.interp(dense, time, x[:, 0]), atol=1e-12
    )


def test_the_motions_own_configurations_are_compared_with_the_straight_joint_paths_at_the_same_place():
    program = made()
    (found,) = deviations(robot(), program, FileMotion(program.at_configurations(), (STRAIGHT,)))
    time = np.linspace(0, program.duration_s, 5000)
    straight, rounded = program.straight_at(time), program.at(time).x
    assert found.path_m < 1e-3 and found.joint_deviation >= 0.99 * np.abs(straight - rounded).max() > 0
    x = program.motion.x
    for k in range(0, 5000, 500):  # on one of the motion's straight paths
        a, b = x[:-1], x[1:]
        length = np.maximum(((b - a) ** 2).sum(axis=1), 1e-30)
        w = np.clip(((straight[k] - a) * (b - a)).sum(axis=1) / length, 0, 1)[:, None]
        assert np.linalg.norm(a + w * (b - a) - straight[k], axis=1).min() < 1e-9
