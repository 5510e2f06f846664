"""Joint paths: those proven clear are clear everywhere, and the bounds on the motion of the arm hold."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from sphere_references import place

from htcp_jax.clearance import Scene
from htcp_jax.clearance.proof.motion_bound import JointSweep, motion_bound, travel_bound
from htcp_jax.clearance.proof.motion_proof import RESOLUTION_M
from htcp_jax.device import Executor
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.settings import Settings

SAMPLES = Settings(path_test="samples")
START = jnp.asarray(made_once.START)


@cache
def _checker(settings):
    return CollisionChecker(Executor(Scene(*made_once.scene()), settings), settings)


def smallest_D(where, a, b, places):
    """Smallest D at samples of the path, without its ends."""
    a, b = np.asarray(a), np.asarray(b)
    return made_once.measured(where, a + np.linspace(0, 1, places + 2)[1:-1, None] * (b - a))[0].min()


def clear(where, a, b, settings=Settings()):  # noqa: B008 - frozen
    one = lane_inputs(stack([replace(made_once.nominal(), **where._asdict())]), *np.zeros((2, 1), int))
    return bool(_checker(settings).path_clear(one, np.asarray(a)[None], np.asarray(b)[None])[0])


@cache
def paths():
    """Joint paths (where, a, b) near recorded configurations at which the baseline got stuck.

    From the start towards them, some ending inside the wall; short steps from them; and long swings past them.
    """
    rng, found = np.random.default_rng(0), []
    for k in range(0, 200, 8):
        where, x = place(k)
        found.append((where, START, START + rng.uniform(0.3, 1.0) * (x - START)))
        found.append((where, x, x + 0.03 * rng.normal(size=6)))
        found.append((where, START, x + 0.5 * rng.normal(size=6)))
    return found


def test_what_bisection_calls_clear_is_clear_at_a_thousand_places():
    """Check by fine sampling, also that blocked paths nearly touch."""
    verdicts = []
    for where, a, b in paths():
        smallest, verdict = smallest_D(where, a, b, 999), clear(where, a, b)
        assert smallest > -RESOLUTION_M if verdict else smallest < 1e-3
        verdicts.append(verdict)
    assert 10 <= sum(verdicts) <= len(verdicts) - 10


def test_bisection_finds_what_twenty_samples_miss():
    """Check paths that cross the wall between two samples, which the sampled test accepts."""
    missed = [p for p in paths() if clear(*p, settings=Settings(path_test="samples", path_steps=2)) and not clear(*p)]
    assert missed
    for where, a, b in missed:
        assert smallest_D(where, a, b, 1999) <= 0


def test_a_path_of_no_length_is_as_clear_as_its_ends():
    where, x = place(0)
    assert clear(where, START, START)
    assert clear(where, x, x) == (made_once.measured(where, np.asarray(x)[None])[0][0] > 0)


@pytest.mark.parametrize("model", ["gp50", "rail"])
def test_no_point_of_a_body_moves_further_than_the_bound(model, tmp_path):
    """Check random configurations, steps up to 0.5 rad, and random points on the axes, for hinges and a slide."""
    robot = made_once.robot() if model == "gp50" else load_robot(rail(tmp_path), limits="model")
    rng, n = np.random.default_rng(1), len(robot.slides)
    bound, ends = made_once.quick_jit(motion_bound), made_once.quick_jit(capsule_segments)
    tightest = 0.0
    for _ in range(200):
        x, turns = jnp.asarray(rng.uniform(-1, 1, n)), jnp.asarray(rng.uniform(0, 0.5, n) * rng.integers(0, 2, n))
        most = np.asarray(bound(robot, x, turns))
        there = x + turns * rng.choice([-1.0, 1.0], n) * rng.choice([1.0, 1.0, rng.uniform()], n)
        s = rng.uniform(size=(len(most), 1))
        (p, q), (p2, q2) = (map(np.asarray, ends(robot, y)) for y in (x, there))
        moved = np.linalg.norm((1 - s) * (p2 - p) + s * (q2 - q), axis=1)
        assert (moved <= most + 1e-12).all()
        tightest = max(tightest, float((moved / np.maximum(most, 1e-9)).max()))
    assert tightest > 0.9  # and the bound is tight


@pytest.mark.parametrize("model", ["gp50", "rail"])
def test_no_point_of_a_body_travels_further_on_a_joint_path_than_the_bound(model, tmp_path):
    """Check random samples on random joint paths.

    The bound never exceeds the one by joint angles alone, and is less than half of it where joints compensate.
    """
    robot = made_once.robot() if model == "gp50" else load_robot(rail(tmp_path), limits="model")
    rng, n = np.random.default_rng(3), len(robot.slides)
    bound, by_turns, ends = (
        made_once.quick_jit(travel_bound),
        made_once.quick_jit(motion_bound),
        made_once.quick_jit(capsule_segments),
    )
    tightest, gain = 0.0, 1.0
    for _ in range(200):
        x, rates, half = rng.uniform(-1, 1, n), rng.normal(size=n) * rng.integers(0, 2, n), rng.choice([0.01, 0.1, 0.5])
        most = np.asarray(bound(robot, jnp.asarray(x), JointSweep(jnp.asarray(rates), half)))
        turns = np.asarray(by_turns(robot, jnp.asarray(x), jnp.asarray(half * abs(rates))))
        assert (most <= turns).all()
        (p, q), (p2, q2) = (
            map(np.asarray, ends(robot, jnp.asarray(y))) for y in (x, x + rng.uniform(-1, 1) * half * rates)
        )
        s = rng.uniform(size=(len(most), 1))
        moved = np.linalg.norm((1 - s) * (p2 - p) + s * (q2 - q), axis=1)
        assert (moved <= most + 1e-12).all()
        tightest = max(tightest, float((moved / np.maximum(most, 1e-9)).max()))
        gain = min(gain, float((most / np.maximum(turns, 1e-9))[turns > 0].min(initial=1.0)))
    assert tightest > 0.9 and gain < 0.5


def rail(folder):
    file = folder / "rail.xml"
    file.write_text("""<mujoco><worldbody><body><joint name="rail" type="slide" axis="0 1 0" range="-2 2"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.1"/>
        <body pos="0 0 0.4"><joint name="a" axis="0 1 0" range="-2 2"/>
          <geom type="capsule" fromto="0 0 0 0.5 0 0.1" size="0.08"/>
          <body pos="0.5 0 0"><joint name="b" axis="0 0 1" range="-2 2"/>
            <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05"/><site name="tcp" pos="0.5 0 0"/>
    </body></body></body></worldbody></mujoco>""")
    return file


def test_samples_look_at_their_inner_steps_and_nowhere_else():
    verdicts = []
    for where, a, b in paths():
        inner = np.stack([np.asarray(a + k / 20 * (b - a)) for k in range(1, 20)])
        between = made_once.measured(where, inner)[0] > 0
        assert clear(where, a, b, SAMPLES) == clear(where, b, a, SAMPLES) == all(between)
        assert clear(where, a, b, Settings(path_test="samples", path_steps=1))
        verdicts.append(all(between))
    assert 10 <= sum(verdicts) <= len(verdicts) - 10
