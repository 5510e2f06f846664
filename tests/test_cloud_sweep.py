"""Clearance bound of moving bodies to a cloud: valid, and tight for bodies that slide along the points."""

import contextlib
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from made_once import prove, quick_jit
from sphere_references import Where
from test_cloud_index import cloud
from test_motion_proof import motions

from htcp_jax.backend import Backend, compiled_for, triton
from htcp_jax.clearance import Scene, minimum_clearance
from htcp_jax.clearance.distance.cloud_sweep import clear_along
from htcp_jax.clearance.distance.cloud_tree import build_index
from htcp_jax.clearance.distance.sweep import BodySweep, RequiredClearance
from htcp_jax.clearance.obstacles.cloud import Cloud, cloud_of
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.clearance.proof.interval import on_interval
from htcp_jax.clearance.proof.motion_bound import JointSweep, travel_bound
from htcp_jax.pytree import register_pytree

BODIES = 6
STEP = 0.005  # between points on a circle [rad]
_FOUND = quick_jit(clear_along)


def swept(rng, points):
    """Random bodies near the points and their motions: (p, q, sweep, reach)."""
    centre = points[rng.integers(len(points), size=BODIES)] + rng.normal(0, 0.05, (BODIES, 3))
    half = rng.normal(0, 0.1, (BODIES, 3)) * rng.choice([0.0, 1e-3, 1.0], (BODIES, 1))
    moves = rng.normal(0, 1, (2, BODIES, 3)) * 10.0 ** rng.uniform(-4, -1, (BODIES, 1))
    bend = 0.3 * np.linalg.norm(moves, axis=2).max(axis=0) * rng.uniform(0, 1, BODIES)
    travel = np.linalg.norm(moves, axis=2).max(axis=0) + bend
    return centre - half, centre + half, BodySweep(*moves, bend, travel), rng.uniform(0.01, 0.05, BODIES)


def by_hand(points, p, q, sweep, reach):
    """Bound by its definition in the module, over all points."""
    d = (q - p)[:, None]
    s = np.einsum("kpi,kpi->kp", points[None] - p[:, None], np.broadcast_to(d, (len(p), len(points), 3)))
    s = np.clip(s / np.maximum(np.einsum("kpi,kpi->kp", d, d), 1e-30), 0, 1)
    away = p[:, None] + s[..., None] * d - points[None]
    far = np.linalg.norm(away, axis=2)
    n = away / far[..., None]
    ends = [
        np.einsum("kpi,kpi->kp", n, end[:, None] - points[None]) - np.abs(np.einsum("kpi,ki->kp", n, moves))
        for end, moves in ((p, sweep.p), (q, sweep.q))
    ]
    stays = np.maximum(np.minimum(*ends) - sweep.bend[:, None], far - sweep.travel[:, None])
    return stays.min(axis=1) - reach


@pytest.mark.parametrize("size", [7, 3000])
def test_the_search_finds_what_a_look_at_every_point_does(size):
    rng = np.random.default_rng(size)
    points = rng.uniform(-0.5, 0.5, (size, 3)) * [1, 1, 0.1]
    index, all_ = build_index(points), jnp.ones(BODIES, bool)
    for _ in range(20):
        p, q, sweep, reach = swept(rng, points)
        found = np.asarray(_FOUND(index, p, q, sweep, reach, RequiredClearance(all_, -jnp.inf, jnp.array(0.02))))
        np.testing.assert_allclose(found, np.minimum(by_hand(points, p, q, sweep, reach), 0.02), atol=1e-12)


def test_the_search_ends_at_the_first_body_that_will_not_do_and_leaves_out_what_is_not_asked_about():
    rng = np.random.default_rng(1)
    points, verdicts = rng.uniform(-0.5, 0.5, (3000, 3)) * [1, 1, 0.1], []
    index = build_index(points)
    for _ in range(40):
        p, q, sweep, reach = swept(rng, points)
        requested = rng.uniform(size=BODIES) < 0.5
        wanted = RequiredClearance(jnp.asarray(requested), jnp.array(-0.01), jnp.array(0.01))
        found = np.asarray(_FOUND(index, p, q, sweep, reach, wanted))
        by_points = by_hand(points, p, q, sweep, reach)
        will_do = (by_points[requested] >= -0.01).all()
        assert (found[requested] >= -0.01).all() == will_do and (found[~requested] == 0.01).all()
        if will_do:
            np.testing.assert_allclose(found[requested], np.minimum(by_points[requested], 0.01), atol=1e-12)
        verdicts.append(will_do)
    assert 5 < sum(verdicts) < 35


@pytest.fixture
def as_on_a_gpu():
    """Use the GPU kernels, interpreted, as there is no GPU here; `close` ends that."""
    with contextlib.ExitStack() as on_gpu:
        on_gpu.enter_context(compiled_for(Backend("gpu", has_kernels=True, interprets=True)))
        yield on_gpu


@pytest.mark.skipif(triton() is None, reason="this JAX has no Triton backend of Pallas")
@pytest.mark.parametrize("name", ["one", "seventeen", "three hundred", "on a plane", "as few as take four levels"])
def test_the_kernel_for_gpus_finds_the_same(name, as_on_a_gpu):
    """Compare a batch of lanes, each with some of its bodies requested, and the verdicts at a required clearance."""
    rng, points = np.random.default_rng(2), cloud(name)
    index, lanes = build_index(points), []
    for _ in range(10):
        p, q, sweep, reach = swept(rng, points)
        lanes.append((p, q, sweep, reach, rng.uniform(size=BODIES) < 0.7, 10.0 ** rng.uniform(-2, 0)))
    p, q, sweep, reach, requested, enough = jax.tree.map(lambda *each: np.stack(each), *lanes)

    def clear(least):
        required = jnp.asarray(least)
        bounds = lambda *lane: clear_along(index, *lane[:4], RequiredClearance(lane[4], required, lane[5]))  # noqa: E731
        found = quick_jit(jax.vmap(bounds))
        return np.asarray(found(p, q, sweep, reach, requested, enough))

    found, ended = clear(-jnp.inf), clear(0.01)
    np.testing.assert_array_equal(found, ended)  # none ends early
    as_on_a_gpu.close()
    np.testing.assert_allclose(found, clear(-jnp.inf), rtol=0, atol=1e-13)
    will_do = (clear(0.01) >= 0.01).all(axis=1)
    np.testing.assert_array_equal((ended >= 0.01).all(axis=1), will_do)
    assert (found < enough[:, None]).any() and (
        found[~requested] == enough.repeat(BODIES).reshape(-1, BODIES)[~requested]
    ).all()


@pytest.mark.skipif(triton() is None, reason="this JAX has no Triton backend of Pallas")
def test_a_proof_as_on_a_gpu_is_the_same_proof(as_on_a_gpu):
    """Compare proofs of a batch of motions by the GPU kernels, with points inside and outside the hull."""
    segments = jax.tree.map(lambda *leaves: jnp.stack(leaves), *motions()[:40])
    scene = Scene(*made_once.scene())
    proof = partial(prove, scene, kept=0.5)
    found = quick_jit(jax.vmap(proof))(*segments)
    as_on_a_gpu.close()
    expected = quick_jit(lambda segments: jax.lax.map(lambda segment_status: proof(*segment_status), segments))(
        segments
    )
    for name in ("verdict", "place", "queries", "depth"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
    np.testing.assert_allclose(found.clearance, expected.clearance, rtol=0, atol=1e-12)
    assert len(np.unique(found.verdict)) > 3


def test_the_arm_is_as_clear_on_an_interval_as_is_said_and_clearer_than_travel_alone_says():
    """Check 200 samples on joint paths of all lengths from recorded configurations."""
    scene, gained = Scene(*made_once.scene()), 0
    look, travel = quick_jit(lambda *given: on_interval(*given)[0]), quick_jit(travel_bound)
    everywhere = quick_jit(lambda where, xs: jax.lax.map(lambda x: minimum_clearance(*scene[:2], where, x), xs))
    for where, a, b, _ in motions():
        x, rates = (a + b) / 2, b - a
        near = float(
            look(*scene[:2], where, x, JointSweep(rates, 0.0), 0.0, 0.5, jnp.array(True), jnp.array(False)).middle
        )
        if near <= 0:
            continue
        reached = near / float(
            travel(scene.robot, x, JointSweep(rates, 1.0)).max()
        )  # where travel is about the clearance
        for half in (0.3 * reached, 0.6 * reached, 1.2 * reached):
            requested = *scene[:2], where, x, JointSweep(rates, half), 0.0, 0.5, jnp.array(True)
            there, by_travel = (look(*requested, jnp.array(closely)) for closely in (True, False))
            assert there.middle == by_travel.middle and (there.proven or not by_travel.proven)
            if there.proven:
                places = np.asarray(x) + np.linspace(-half, half, 200)[:, None] * np.asarray(rates)[None]
                assert np.asarray(everywhere(where, places)).min() >= float(there.clear) >= 0.5 * float(there.middle)
            gained += bool(there.proven & ~by_travel.proven)
    assert gained > 5


def floor_below(robot, where, x, gap_m):
    """Floor of points on circles about the first joint's axis, `gap_m` below the turning arm."""
    radius, angle = (each.ravel() for each in np.meshgrid(np.arange(0.6, 2.0, 0.01), np.arange(-0.5, 1.0, STEP)))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(len(angle), -2.0)], axis=1)
    turned = x[None] + jnp.linspace(0, STEP, 21)[:, None] * jnp.eye(6)[:1]
    least = quick_jit(
        lambda floor: jnp.min(jax.lax.map(lambda x: minimum_clearance(robot, (floor,), where, x), turned))
    )
    for _ in range(6):  # the nearest point is not straight below
        points[:, 2] += float(least(cloud_of(points, 0.0))) - gap_m
    return cloud_of(points, 0.0)


@register_pytree
@dataclass(frozen=True)
class TravelOnly(Cloud):
    """A cloud without a bound of its own for moving bodies: the bodies' travel decides."""

    sweeps = False


def test_a_segment_along_a_wall_takes_few_looks():
    """A turn about the vertical, 1 um above a floor: by travel alone it needs over 20 times as many queries."""
    robot, where, x = made_once.robot(), Where(jnp.eye(4), jnp.zeros(4)), jnp.array([0.0, 0.6, -0.3, 0.0, -0.6, 0.0])
    floor, turned = floor_below(robot, where, x, 1e-6), x.at[0].set(0.02)
    proof = quick_jit(prove)(Scene(robot, (floor,)), where, x, turned)
    assert proof.verdict == PathVerdict.VALID and proof.queries < 100
    again = quick_jit(prove)(Scene(robot, (TravelOnly(**vars(floor)),)), where, x, turned)
    assert again.verdict == PathVerdict.VALID and again.queries > 20 * proof.queries
