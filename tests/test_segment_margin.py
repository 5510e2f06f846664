"""Margins between targets: what is proven is measured again by brute force, and by MuJoCo."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import toy

import htcp_jax
from htcp_jax.clearance.proof import margin
from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.motion import joint_search
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.motion_check import segments_of
from htcp_jax.status import SegmentStatus
from htcp_jax.validation import validate_results

PLACES = 200  # on each joint path
MARGIN_M = 0.01
TRANSFER_M, FALLOFF_M = 0.09, 0.2


def along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Configurations at PLACES + 1 places on joint paths (n, PLACES + 1, N), both ends included."""
    return a[:, None] + np.linspace(0, 1, PLACES + 1)[:, None] * (b - a)[:, None]


def least(one, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Clearance at places on joint paths (n, PLACES + 1) [m]."""
    x = along(a, b)
    return toy.measured(one, x.reshape(-1, x.shape[2]))[0].reshape(x.shape[:2])


@cache
def one():
    return toy.scenario(margin_m=MARGIN_M, segment_margin_m=MARGIN_M)


@cache
def proven():
    """Random short joint paths near the shelf with random margins, and their proofs."""
    rng, problem = np.random.default_rng(0), toy.problem(one())
    near = toy.plans_by().x[0, toy.plans_by().tracked[0]]
    a = near[rng.integers(len(near), size=200)] + 0.1 * rng.standard_normal((200, near.shape[1]))
    b, margin_m = a + 0.1 * rng.standard_normal(a.shape), rng.uniform(0, 0.05, len(a))
    zero = np.zeros(len(a), int)
    anywhere = Tube(np.zeros((200, 3)), np.zeros((200, 3)), np.full(200, np.inf), margin=margin.constant(margin_m))
    inputs = lane_inputs(problem.scenarios, zero, zero)
    return a, b, margin_m, problem.checkers[0].edges(inputs, a, b, anywhere, kept=0.5)


def test_a_proven_path_has_the_margin_everywhere_and_a_refuted_one_lacks_it_at_its_place():
    a, b, margin_m, proof = proven()
    D = least(one(), a, b).min(axis=1)
    valid, below = (proof.verdict == status for status in (SegmentStatus.VALID, SegmentStatus.BELOW_MARGIN))
    assert valid.sum() > 40 and below.sum() > 40
    assert (D >= margin_m)[valid].all() and (proof.clearance >= margin_m)[valid].all()
    at = a + proof.place[:, None] * (b - a)
    D, _ = toy.measured(one(), at[below])
    assert ((D > 0) & (D < margin_m[below])).all()


def test_a_path_that_step_qps_accept_has_the_margin():
    a, b, margin_m, _ = proven()
    zero = np.zeros(len(a), int)
    problem = toy.problem(one())
    clear = problem.checkers[0].path_clear(lane_inputs(problem.scenarios, zero, zero), a, b, margin_m)
    D = least(one(), a, b).min(axis=1)
    assert 40 < clear.sum() < 160 and (D >= margin_m)[clear].all()


def test_no_segment_of_the_path_is_below_the_margin():
    poses = {}, {"shift": (0.0, 0.05, 0.03)}, {"shift": (0.03, 0.0, -0.05)}, {"rotation": (-0.1, -0.3)}
    each = tuple(toy.scenario(k, margin_m=MARGIN_M, segment_margin_m=MARGIN_M, **p) for k, p in enumerate(poses))
    plans, count = toy.planned(each), 0
    on_path = plans.executable & (np.arange(plans.x.shape[1]) > each[0].on_path)
    paths = segments_of(plans, on_path)
    for s, scenario in enumerate(each):
        own = paths.scenario == s
        count += own.sum()
        assert not own.any() or least(scenario, paths.a[own], paths.b[own]).min() >= MARGIN_M
    assert count > 5


def test_mujoco_refutes_a_plan_whose_segments_lack_the_margin(tmp_path):
    job = toy.write_job(tmp_path, 4, shift_m=(0.4, 0.02, -0.03), margin_m=MARGIN_M, cell={"self_collision": False})
    htcp_jax.plan(job).save(tmp_path / "plan")
    assert validate_results(tmp_path / "plan").validated
    file = tmp_path / "plan" / "summary.json"
    summary = json.loads(file.read_text())
    summary["config"]["margin_m"] = 0.9
    file.write_text(json.dumps(summary))
    refuted = validate_results(tmp_path / "plan").refuted
    assert [one.target for one in refuted] == [6, 7, 8] and all("less than margin_m" in one.reason for one in refuted)
    summary["config"]["margin_on"] = "targets"
    file.write_text(json.dumps(summary))
    assert not validate_results(tmp_path / "plan").refuted


@cache
def from_home():
    """A scenario with a home on the other side of the shelf, its plans, and the plans without a transfer margin."""
    home = np.radians([150.0, -60.0, 100.0, 30.0])
    found = []
    for transfer_margin_m in (TRANSFER_M, 0.0):
        where = {"transfer_margin_m": transfer_margin_m, "transfer_falloff_m": FALLOFF_M, "rotation": (0.1, 0.3)}
        scenario = toy.scenario(home=home, start=None, **where)
        found.append((scenario, toy.planned((scenario,))))
    return found


def lacking(scenario, plans) -> np.ndarray:
    """What the arm lacks of the rule at places on segments before the path (n, PLACES + 1) [m], in plain NumPy."""
    paths = segments_of(plans, plans.executable & (np.arange(plans.x.shape[1]) <= scenario.on_path))
    ends = np.array([plans.start[0], plans.x[0, 0], plans.x[0, int(scenario.on_path)]])
    clearance, place = toy.measured(scenario, ends)
    x = along(paths.a, paths.b)
    D, tcp = (found.reshape(*x.shape[:2], -1) for found in toy.measured(scenario, x.reshape(-1, x.shape[2])))
    required = np.full(x.shape[:2], TRANSFER_M)
    for k, own in enumerate((paths.target == 0, paths.target > 0)):
        for end in (k, k + 1):
            d = min(clearance[end], TRANSFER_M)
            falls = d + (TRANSFER_M - d) * np.linalg.norm(tcp - place[end], axis=2) / FALLOFF_M
            required[own] = np.minimum(required, falls)[own]
    return required - D[..., 0]


def test_a_transfer_has_its_margin_which_falls_off_towards_its_ends():
    (scenario, plans), (_, free) = from_home()
    before = np.arange(plans.x.shape[1]) <= scenario.on_path
    assert (plans.segment_status[0, before] == SegmentStatus.VALID).all()
    assert lacking(scenario, plans).max() <= 2e-6
    assert lacking(scenario, free).max() > 0.005


def test_a_transfer_without_enough_room_is_kept_and_marked(monkeypatch):
    monkeypatch.setattr(joint_search, "MARGIN_ROUNDS", 2)
    (scenario, _), (_, free) = from_home()
    plans = toy.planned((replace(scenario, transfer_margin_m=np.array(1.0), transfer_falloff_m=np.array(1e-3)),))
    assert plans.segment_status[0, 0] == SegmentStatus.REDUCED_MARGIN
    assert plans.executable.sum() == free.executable.sum() > 1
    paths = segments_of(plans, plans.executable & (np.arange(plans.x.shape[1]) == 0))
    assert least(scenario, paths.a, paths.b).min() >= plans.segment_clearance[0, 0] > 0
