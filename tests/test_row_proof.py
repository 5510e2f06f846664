"""Proof of a task's rows between targets: at a thousand points by MuJoCo proven rows hold, refuted ones do not."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from made_once import prove

from htcp_jax.clearance import Scene
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.clearance.proof.motion_proof import Tube
from htcp_jax.clearance.proof.row_proof import between, row_slacks
from htcp_jax.model import PathFrames, Task, Workpiece
from htcp_jax.model.goals import task_of, with_goals
from htcp_jax.model.kinematics import link_poses, tcp_pose
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.settings import Settings
from htcp_jax.spec import GP50, AxisRow, BuiltInRow, OrientationRow, PointRow, ToolAxisRow
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.records import data_of
from htcp_jax.validation.task_check import PartPose, hold_between

PATHS, PLACES, INTERVALS = 32, 1000, 128
TOLERANCE_M, TOLERANCE_RAD = 1e-3, 2e-3
SETTINGS = Settings(tolerance_m=TOLERANCE_M, tolerance_rad=TOLERANCE_RAD)
NOWHERE = jnp.zeros(3)


@cache
def configurations() -> np.ndarray:
    """Steps of all lengths, there and back, from the start (WAYS + 1, 6)."""
    segment_status = np.zeros((PATHS + 1, 6))
    segment_status[1::2] = (
        np.random.default_rng(0).normal(size=(PATHS // 2, 6)) * np.geomspace(2e-4, 0.1, PATHS // 2)[:, None]
    )
    return np.array(made_once.START) + segment_status


@cache
def segments() -> tuple[np.ndarray, np.ndarray]:
    """Ends of the segments, twice (WAYS, 6): the configurations, each with a displacement of random size."""
    rng = np.random.default_rng(1)
    beside = rng.normal(size=(2, PATHS, 6)) * rng.permutation(np.geomspace(1e-5, 0.05, PATHS))[:, None]
    return configurations()[:-1] + beside[0], configurations()[1:] + beside[1]


class CachedArm(MujocoArm):
    """An arm that caches the frames of each configuration."""

    def frames(self, x, name):
        known = self.__dict__.setdefault("known", {})
        key = name, x.tobytes()
        if key not in known:
            known[key] = super().frames(x, name)
        return known[key]


def tool() -> np.ndarray:
    poses = made_once.quick_jit(jax.vmap(partial(tcp_pose, made_once.robot())))
    return np.asarray(poses(jnp.asarray(configurations())))


@cache
def rows() -> tuple[BuiltInRow, ...]:
    """One row of each kind, which hold at the configurations, at least approximately."""
    T, fourth = tool()[0], np.asarray(link_poses(made_once.robot(), jnp.asarray(made_once.START)))[3]
    ahead, elbow = tuple(T[:3, 3] + 0.4 * T[:3, 2]), tuple(fourth[:3, 3])
    return (
        PointRow(point="tcp", on="path", axes="z"),
        PointRow(point="tcp", on="path", axes="yz", frame="path"),
        PointRow(point="tcp", on="path", within_m=0.004),
        PointRow(point="link4", on="plane", through_m=elbow, normal=(1.0, 2.0, 0.5), within_m=0.01),
        PointRow(point="link4", on="line", through_m=elbow, direction=(1.0, 2.0, 0.5), offset_m=(0.0, 0.0, 0.0)),
        PointRow(point="link4", on=elbow),
        AxisRow(axis="tcp.z", towards="-path.normal"),
        AxisRow(axis="tcp.z", towards="-path.normal", cone_deg=2.0),
        AxisRow(axis="link4.y", towards=tuple(fourth[:3, 1])),
        AxisRow(axis="tcp.z", looks_at_m=ahead, cone_deg=4.0),
        AxisRow(axis="tcp.z", looks_at_m=ahead),
        OrientationRow(orientation="path"),
        OrientationRow(orientation="path", within_deg=3.0),
        ToolAxisRow(tool_axis="tcp.z", work_angle_deg=(-2.0, 3.0), travel_angle_deg=(-1.0, 1.0)),
        ToolAxisRow(tool_axis="tcp.z", travel_angle_deg=0.0, spin_deg=(-1.0, 2.0)),
        ToolAxisRow(tool_axis="tcp.z", work_angle_deg=0.0, travel_angle_deg=0.0, spin_deg=0.0),
        ToolAxisRow(tool_axis="tcp.z", work_angle_deg=(43.0, 47.0), work_angle_from="plate_2"),
    )


@cache
def held():
    """The task, its goals at the configurations, and the part whose path the tool follows with them."""
    T, parts = tool(), [task_of([row], made_once.robot()).parts[0] for row in rows()]
    plates = np.stack([-T[:, :3, 2] + T[:, :3, 1], -T[:, :3, 2] - T[:, :3, 1]], axis=1) / np.sqrt(2)
    frames = PathFrames(-T[:, :3, 2], T[:, :3, 0], T[:, :3, :3], plates)
    here = {"pivot": np.zeros(3), "neutral_translation": np.zeros(3)}
    part = Workpiece("path", made_once.duct().cloud[::1000], T[:, :3, 3], interior="none", frames=frames, **here)
    scenario = make_scenario(made_once.robot(), part, made_once.START, rotation=(0.0, 0.0))
    task = Task(tuple(parts), TOLERANCE_M, TOLERANCE_RAD)
    return task, with_goals(scenario, rows(), task, made_once.robot(), part).goals[int(scenario.on_path) :], part


@cache
def bounded():
    """Rows proven on each segment, and rows refuted at the middles of its intervals.

    Shapes (WAYS, rows) and (WAYS, INTERVALS, rows).
    """
    task, goals, _ = held()
    half = jnp.asarray(0.5 / INTERVALS)

    def on(goals, a, b, place):
        found = row_slacks(made_once.robot(), task.parts, between(task, goals), a + place * (b - a), b - a, half)
        return found.left >= 0, found.broken

    pairs = jnp.asarray(np.stack([goals[:-1], goals[1:]], axis=1))
    places = jnp.linspace(half, 1.0 - half, INTERVALS)
    each = made_once.quick_jit(jax.vmap(jax.vmap(on, in_axes=(None, None, None, 0)), in_axes=(0, 0, 0, None)))
    inside, broken = each(pairs, *map(jnp.asarray, segments()), places)
    return np.asarray(inside).all(axis=1), np.asarray(broken)


@cache
def arm() -> CachedArm:
    return CachedArm(GP50, limits="simulation")


def by_mujoco(segment_status: int, share: np.ndarray) -> np.ndarray:
    """Rows that hold at these points of a segment, by MuJoCo (rows, n)."""
    _, _, part = held()
    a, b = (end[segment_status] for end in segments())
    points = [np.full(len(share), t) for t in (segment_status, segment_status + 1)]
    places = [PartPose(np.eye(3), np.zeros(3), data_of(part), point) for point in points]
    x = a + share[:, None] * (b - a)
    return hold_between(rows(), arm(), x, *places, SETTINGS)


def test_a_row_that_is_proven_to_hold_does_so_at_a_thousand_places_and_one_that_is_broken_does_not():
    inside, broken = bounded()
    middles = (np.arange(INTERVALS) + 0.5) / INTERVALS
    for segment_status in range(PATHS):
        good = by_mujoco(segment_status, np.linspace(0, 1, PLACES)).all(axis=1)
        assert good[inside[segment_status]].all(), [
            str(rows()[k]) for k in np.flatnonzero(inside[segment_status] & ~good)
        ]
        assert not (by_mujoco(segment_status, middles).T & broken[segment_status]).any()
    # For every kind some segments are proven, some are not, and nearly all are decided.
    assert ((inside.sum(axis=0) >= 3) & (broken.any(axis=1).sum(axis=0) >= 3)).all(), inside.sum(axis=0)
    assert ((inside | broken.any(axis=1)).mean(axis=0) > 0.8).all()


@pytest.mark.slow
def test_the_proof_of_a_motion_respects_them_where_they_are_asked_for():
    """Proof of a motion with the task's rows: it implies them by MuJoCo; without rows the verdict is as before."""
    task, goals, _ = held()
    scene, proven = Scene(*made_once.scene()[:2], task), made_once.quick_jit(prove)
    inside, broken = bounded()
    for segment_status in range(0, PATHS, 3):
        a, b = (end[segment_status] for end in segments())
        pair = jnp.asarray(goals[segment_status : segment_status + 2])
        tubes = [Tube(NOWHERE, NOWHERE, jnp.asarray(jnp.inf), pair, jnp.asarray(held)) for held in (True, False)]
        heeding, free = (proven(scene, made_once.nominal(), a, b, tube) for tube in tubes)
        assert free.verdict == proven(scene, made_once.nominal(), a, b).verdict
        if free.verdict == PathVerdict.VALID:
            assert (
                heeding.verdict == PathVerdict.VALID or broken[segment_status].any() or not inside[segment_status].all()
            )
            assert heeding.verdict != PathVerdict.VALID or by_mujoco(segment_status, np.linspace(0, 1, PLACES)).all()
