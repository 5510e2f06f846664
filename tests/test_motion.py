"""Motions: start, via points and rows in the order of execution, with the same metrics as a plain loop computes."""

from itertools import pairwise

import numpy as np
import pytest
from hand_made import plans_with
from hypothesis import given
from hypothesis import strategies as st
from made_plan import STATUSES, made_plans, with_a_dwell

from htcp_jax.motion import Plans, ViaPoints
from htcp_jax.motion.motion import (
    ONE_POINT_M,
    cost,
    curvature,
    dwells,
    largest_step,
    motion,
    motion_figures,
    motions,
    narrowest_segment,
)
from htcp_jax.runs.motion_summary import summarise_motion
from htcp_jax.status import Kind, SegmentStatus, Status

TARGETS, ON_PATH, JOINTS = 8, 3, 2
T, A, F, D, R = Kind.TRANSFER, Kind.APPROACH, Kind.PROCESS, Kind.DWELL, Kind.RETRACT


SEEDS = st.integers(0, 2**32 - 1)


def some_plans(seed: int, scenarios: int = 3) -> Plans:
    """Random plans, executable up to some target, with via points on some segments and repeated path points."""
    rng = np.random.default_rng(seed)
    ends = rng.integers(0, TARGETS, scenarios, endpoint=True)
    tracked = np.arange(TARGETS) < TARGETS - 1 + (np.arange(scenarios) % 2)[:, None]
    status = np.where(tracked, Status.TRACKED, Status.QP_INFEASIBLE)
    status[rng.random(scenarios) < 0.25, 0] = Status.TRACKED_AFTER_RECOVERY
    plans = plans_with(status.tolist(), joints=JOINTS)
    ahead = rng.choice([0.0, 0.3 * ONE_POINT_M, 0.01, 0.02], (scenarios, TARGETS, 1)) * [1.0, 0.5, 0.0]
    segment_status = np.where(
        np.arange(TARGETS) < ends[:, None], SegmentStatus.VALID, SegmentStatus.NOT_CHECKED
    ).astype(np.int8)
    keys = [(s, t) for s in range(scenarios) for t in range(TARGETS) if rng.random() < 0.25]
    return plans._replace(
        start=rng.normal(size=(scenarios, JOINTS)),
        x=np.where(tracked[..., None], rng.normal(size=(scenarios, TARGETS, JOINTS)), np.nan),
        target=np.cumsum(ahead, axis=1),
        segment_status=segment_status,
        segment_clearance=np.where(
            segment_status == SegmentStatus.VALID, rng.choice([1e-3, 2e-3, 3e-3], segment_status.shape), np.nan
        ),
        via_points=ViaPoints.of([(*key, rng.normal(size=(rng.integers(1, 4), JOINTS))) for key in keys], JOINTS),
    )


def null_space_steps(plans: Plans, s: int) -> list[tuple[int, Kind, np.ndarray]]:
    """Target, kind and configuration of each point in the motion of scenario s, by a plain loop."""
    rows, count = [], int(plans.executable[s].sum())
    for t in range(count):
        via_points = plans.via_points.on_segment(s, t)
        transfer = t == 0 and (len(via_points) > 0 or plans.status[s, 0] == Status.TRACKED_AFTER_RECOVERY)
        if t == 0:
            rows.append((0, T if transfer else A, plans.start[s]))
        kind = D if t > ON_PATH else T if transfer else A
        rows += [(t - (kind == D), kind, x) for x in via_points]
        rows.append((t, F if t > ON_PATH else kind, plans.x[s, t]))
    return rows


@given(SEEDS)
def test_a_motion_is_the_start_the_via_points_and_the_rows_in_their_order(seed):
    plans = some_plans(seed)
    together = motions(plans, ON_PATH)
    for s in range(len(plans.x)):
        rows = null_space_steps(plans, s)
        for found in (motion(plans, s, ON_PATH), together.of(s)):
            assert [*zip(found.target, found.kind, strict=True)] == [row[:2] for row in rows]
            np.testing.assert_array_equal(found.x, np.array([x for *_, x in rows]).reshape(-1, JOINTS))


@given(SEEDS)
def test_the_way_back_is_the_way_there_reversed(seed):
    plans = some_plans(seed)
    there, back = (motion(plans, 0, ON_PATH, retract=retract) for retract in (False, True))
    np.testing.assert_array_equal(back.x, np.concatenate([there.x, there.x[::-1][1:]]))
    assert (back.kind[len(there.x) :] == R).all() and (back.kind[: len(there.x)] == there.kind).all()


def curved(plans: Plans, s: int) -> dict[int, float]:
    """Curvature |q''| at targets of scenario s, by a plain loop."""
    points: list[tuple[int, bool]] = []  # the last target of each, and True if the arm reconfigures before it
    turns = False
    for t in range(ON_PATH, int(plans.executable[s].sum())):
        turns |= bool(len(plans.via_points.on_segment(s, t))) and t > ON_PATH
        if points and t > ON_PATH and np.linalg.norm(plans.target[s, t] - plans.target[s, t - 1]) < ONE_POINT_M:
            points[-1] = t, points[-1][1] | turns
        else:
            points.append((t, turns))
        turns = False
    found = {}
    for (a, _), (b, turned), (c, turns) in zip(points, points[1:], points[2:], strict=False):
        if not turned and not turns:
            p, q, r = (plans.target[s, t] for t in (a, b, c))
            before, after = np.linalg.norm(q - p), np.linalg.norm(r - q)
            slopes = (plans.x[s, b] - plans.x[s, a]) / before, (plans.x[s, c] - plans.x[s, b]) / after
            found[b] = float(np.linalg.norm(slopes[1] - slopes[0]) / ((before + after) / 2))
    return found


@given(SEEDS)
def test_the_figures_are_those_of_a_plain_loop(seed):
    plans = some_plans(seed)
    found, bent, on_path = motion_figures(plans, ON_PATH), curvature(plans, ON_PATH), motions(plans, ON_PATH)
    turning, (least_at, least) = dwells(plans, ON_PATH), narrowest_segment(plans)
    costs, steps = cost(on_path, len(plans.x)), largest_step(on_path, len(plans.x))
    for s in range(len(plans.x)):
        rows, count = null_space_steps(plans, s), int(plans.executable[s].sum())
        x = np.array([x for *_, x in rows]).reshape(-1, JOINTS)
        V = np.kron(np.eye(max(len(x), 1))[1:] - np.eye(max(len(x), 1))[:-1], np.eye(JOINTS))  # of equation (3)
        assert costs[s] == pytest.approx(x.ravel() @ V.T @ V @ x.ravel() if len(x) else 0.0)
        own = [np.linalg.norm(b[2] - a[2]) for a, b in pairwise(rows) if b[1] in (F, D)]
        np.testing.assert_allclose(steps[s], max(own, default=np.nan))
        assert np.flatnonzero(turning[s]).tolist() == sorted({t for t, kind, _ in rows if kind == D})
        assert {t: v for t, v in enumerate(bent[s]) if v == v} == pytest.approx(curved(plans, s))
        np.testing.assert_allclose(found.curvature_max_rad_m2[s], max(curved(plans, s).values(), default=np.nan))
        clear = plans.segment_clearance[s, :count].tolist()
        assert least_at[s] == (clear.index(min(clear)) if count else -1)
        np.testing.assert_equal(least[s], min(clear, default=np.nan))
        np.testing.assert_equal(found.dwells[s], turning[s].sum() if count else np.nan)
        np.testing.assert_equal(found.motion_cost_rad2[s], costs[s] if count else np.nan)


def test_a_joint_that_follows_a_parabola_over_the_arc_length_has_its_curvature():
    """Check q = s^2 / 2 on a straight path with uneven steps: |q''| is 1 at every inner point."""
    plans = plans_with([[Status.TRACKED] * 9], joints=1)
    length = np.array([0.0, 0.1, 0.15, 0.3, 0.33, 0.5, 0.6, 0.8, 0.9])
    target = length[None, :, None] * np.array([0.6, 0.0, 0.8])
    segment_status = np.full_like(plans.segment_status, SegmentStatus.VALID)
    bent = curvature(plans._replace(x=length[None, :, None] ** 2 / 2, target=target, segment_status=segment_status), 0)
    assert np.isnan(bent[0, [0, -1]]).all()
    np.testing.assert_allclose(bent[0, 1:-1], 1.0)


def test_many_scenarios_are_as_each_alone():
    rng = np.random.default_rng(0)
    plans = plans_with([[Status.TRACKED] * TARGETS] * 50, joints=JOINTS)
    segment_status = np.where(
        rng.random(plans.segment_status.shape) < 0.9, SegmentStatus.VALID, SegmentStatus.OFF_PATH
    ).astype(np.int8)
    via_points = ViaPoints.of(
        [(s, t, rng.normal(size=(2, JOINTS))) for s in range(50) for t in range(0, TARGETS, 2)], JOINTS
    )
    plans = plans._replace(
        x=rng.normal(size=plans.x.shape), target=rng.normal(size=plans.target.shape), segment_status=segment_status
    )
    plans = plans._replace(segment_clearance=rng.random(segment_status.shape), via_points=via_points)
    on_path = rng.integers(0, 4, 50)
    together = motion_figures(plans, on_path)
    for s in range(50):
        alone = motion_figures(plans.rows([s]), int(on_path[s]))
        np.testing.assert_allclose([column[s] for column in together], [column[0] for column in alone], rtol=1e-12)


def test_the_table_of_a_plan_has_a_row_of_dwells_only_if_there_are_any():
    still = summarise_motion(with_a_dwell(made_plans(np.zeros((10, 3)), STATUSES[:1])), 0)
    assert still.facts()["dwells"] == "1, at target 4; the tool stands still there"
    assert "dwells" not in still.details()
    moving = still._replace(dwells=())
    assert "dwells" not in moving.facts() and moving.details()["dwells"].startswith("none ")


def test_the_guaranteed_clearance_of_a_transfer_is_given_apart_from_that_of_the_seam():
    plans = plans_with([[Status.TRACKED_AFTER_RECOVERY] + [Status.TRACKED] * 3])
    valid = np.full_like(plans.segment_status, SegmentStatus.VALID)
    plans = plans._replace(segment_status=valid, path_clear=np.ones_like(plans.path_clear))
    transfer = "more than 0 mm; minimum on the segment to target 0 (transfer); at least 2 mm after the transfer"
    seam = "at least 2 mm; minimum on the segment to target 2 (process)"
    for first_m, told in ((1e-6, transfer), (5e-3, seam)):
        own = plans._replace(segment_clearance=np.array([[first_m, 4e-3, 2e-3, 3e-3]]))
        assert summarise_motion(own, 0).facts()["guaranteed clearance"] == told
