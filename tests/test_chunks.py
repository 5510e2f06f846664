"""Proofs of paths in chunks, in parallel: the same results as from one end to the other."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from test_motion_proof import motions

from htcp_jax.clearance.proof.bisection import Bisection, PathVerdict, Proof, initial_state, moved_on, proven_result
from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.device import Executor, Loop, by_chunks
from htcp_jax.device.batching import chunked
from htcp_jax.device.lane_function import BatchSize, DeviceSizes
from htcp_jax.device.tables import gather
from htcp_jax.model.scenario import stack
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import PROVE, ProofResolution
from htcp_jax.settings import Settings
from htcp_jax.status import SegmentStatus


@cache
def checker():
    return CollisionChecker(Executor(made_once.scene(), Settings()), Settings())


@cache
def requested():
    """Inputs of the proofs, each path with its tube and without. (inputs, a, b, tube), and its resolution."""
    nominal = jax.tree.map(np.asarray, made_once.nominal())
    segments, a, b, tubes = zip(*motions(), strict=True)
    poses = [replace(nominal, **jax.tree.map(np.asarray, where)._asdict()) for where in segments]
    which = np.tile(np.arange(len(poses)), 2)
    inputs = lane_inputs(stack(poses), which, np.zeros_like(which))
    free = [Tube(np.zeros(3), np.zeros(3), np.array(np.inf))] * len(poses)
    tube = jax.tree.map(lambda *leaves: np.stack(leaves), *tubes, *free)
    rng = np.random.default_rng(0)
    kept, deepest = rng.choice([0.0, 0.5, 0.99], len(which)), rng.choice([3, 20, 30], len(which))
    resolution_m = rng.choice([-1e-9, 1e-5], len(which))
    return (inputs, np.stack(a + a), np.stack(b + b), tube), ProofResolution(kept, resolution_m, deepest)


@cache
def unbroken():
    segments, closely = requested()
    return checker().edges(*segments, **closely._asdict())


@pytest.mark.parametrize("table", [BatchSize(16, 1, True), BatchSize(64, 8, True), BatchSize(512, 300, True)])
def test_proofs_in_chunks_are_unbroken_ones(table):
    """Proofs in chunks, equal to unbroken ones.

    Verdicts, places, queries and depths are equal; clearances up to rounding, as lanes computed in parallel round
    differently. Other paths and the number of slots have no influence.
    """
    expected = unbroken()
    assert np.unique(expected.verdict).tolist() == [
        SegmentStatus.VALID,
        SegmentStatus.IN_COLLISION,
        SegmentStatus.OFF_PATH,
        SegmentStatus.REVERSES,
        SegmentStatus.UNDECIDED,
    ]
    in_chunks = replace(PROVE, sizes=DeviceSizes(table, table))
    executor = Executor(made_once.scene(), Settings())
    for rows in (slice(None), slice(7, None, 20), [int(np.argmax(expected.queries))]):
        (segments, closely), own = gather(requested(), rows), gather(expected, rows)
        found = executor(in_chunks, *segments, closely)
        for name, value in found._asdict().items():
            rounds = 1e-14 * (name == "clearance")
            np.testing.assert_allclose(value, getattr(own, name), rtol=0, atol=rounds, err_msg=name)
            assert value.dtype == getattr(own, name).dtype


def test_of_a_path_that_is_not_proven_nothing_else_is_reported():
    """Result of a path that is not proven: its verdict and place only.

    The queries made before its refutation depend on the order.
    """
    found = gather(unbroken(), unbroken().verdict != SegmentStatus.VALID)
    assert not found.queries.any() and not found.depth.any() and np.isinf(found.clearance).all()
    assert (found.place < 1).all()


def made_up(scene, free_radius, place, bad, kind) -> Loop:
    """A bisection without an arm.

    An interval holds if it is shorter than the slack at its middle, and is otherwise divided into two, four or eight
    parts; a middle near one of the bad places is refuted, whether its interval holds or not.
    """

    def look(far: Bisection) -> Bisection:
        half = 0.5 * jnp.ldexp(1.0, -far.depth)
        middle = (2 * far.index + 1).astype(float) * half
        left = free_radius + jnp.abs(middle - place) - 2 * half
        verdict = jnp.where(jnp.min(jnp.abs(middle - bad)) < 0.02, kind, int(PathVerdict.VALID))
        is_open = (verdict == PathVerdict.VALID) & (left < 0) & (far.depth >= 14)
        verdict = jnp.where(is_open, int(PathVerdict.UNDECIDED), verdict).astype(jnp.int32)
        proof = Proof(
            verdict,
            jnp.where(verdict == PathVerdict.VALID, 1.0, middle),
            jnp.where(left >= 0, jnp.minimum(far.proof.clearance, left), far.proof.clearance),
            far.proof.queries + 1,
            jnp.maximum(far.proof.depth, far.depth.astype(jnp.int32)),
        )
        halvings = 1 + (left + half < 0).astype(int) + (left + 1.5 * half < 0).astype(int)
        return moved_on(far, left >= 0, jnp.clip(halvings, 1, jnp.maximum(14 - far.depth, 1)), proof)

    begin = jax.tree.map(jnp.asarray, initial_state())
    return Loop(begin, lambda far: far.going, look, lambda far: proven_result(far.proof))


@pytest.mark.parametrize(("capacity", "width"), [(300, 16), (64, 64), (40, 100), (5, 3), (1, 8)])
def test_made_up_paths_come_out_as_from_end_to_end(capacity, width):
    """Made-up paths, bitwise as from end to end, for any number of paths and slots.

    Including two chunks that refute their path at once, and a refuting query that has moved on.
    """
    rng = np.random.default_rng([capacity, width])
    free_radius, place = 10.0 ** rng.uniform(-5, 0, capacity), rng.uniform(0, 1, capacity)
    bad = rng.uniform(-4, 1, (capacity, 3))
    # both halves are refuted, and the first one holds
    free_radius[::3], place[::3], bad[::3, :2] = 0.2, 0.9, (0.25, 0.75)
    kinds = [verdict for verdict in PathVerdict if verdict not in (PathVerdict.VALID, PathVerdict.UNDECIDED)]
    paths = free_radius, place, bad, rng.choice(kinds, capacity)
    end_to_end, in_chunks = chunked(made_up, 1), by_chunks(made_up, width)
    for lanes in {1, capacity // 2 + 1, capacity}:
        expected = jax.tree.map(lambda rows, lanes=lanes: np.asarray(rows)[:lanes], end_to_end(None, lanes, *paths))
        found = jax.tree.map(lambda rows, lanes=lanes: np.asarray(rows)[:lanes], in_chunks(None, lanes, *paths))
        for name, value in found._asdict().items():
            np.testing.assert_array_equal(value, getattr(expected, name), name)
    assert capacity < 300 or np.unique(expected.verdict).tolist() == list(PathVerdict)
