"""Manipulability: the smallest singular value of the task's Jacobian, in results and next to feed drops."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pytest
import toy

from htcp_jax.model import Task, kinematics
from htcp_jax.motion.manipulability import manipulability
from htcp_jax.runs import timing_file
from htcp_jax.runs.tables import MANIPULABILITY, joint_columns, target_table, with_new_columns

POSITION = Task()
X = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 4))
GOALS = np.zeros((40, 3))


def slope(x: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Jacobian of the TCP's position by central differences."""

    def tcp(x: np.ndarray) -> np.ndarray:
        return np.asarray(kinematics.tcp_position(toy.robot(), jnp.asarray(x)))

    return np.stack([tcp(x + h * d) - tcp(x - h * d) for d in np.eye(4)], axis=1) / (2 * h)


def test_it_is_the_slowest_motion_of_the_tcp_for_joint_velocities_of_length_1():
    found = manipulability(toy.robot(), POSITION, X[:5], GOALS[:5])
    for x, value in zip(X[:5], found, strict=True):
        directions = np.random.default_rng(1).normal(size=(2000, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        pushed = np.linalg.norm(slope(x).T @ directions.T, axis=0)  # |J^T u|, smallest at the slowest direction u
        assert value <= pushed.min() + 1e-6 and value == pytest.approx(pushed.min(), rel=0.05)


def test_it_is_0_where_the_arm_is_stretched_and_where_the_tool_is_above_the_first_axis():
    straight = np.array([[0.3, 0.7, 0.0, 0.0], [0.3, 0.0, 0.0, 0.0]])
    assert np.allclose(manipulability(toy.robot(), POSITION, straight, GOALS[:2]), 0, atol=1e-9)


def test_it_does_not_depend_on_the_other_configurations():
    together = manipulability(toy.robot(), POSITION, X, GOALS)
    alone = [manipulability(toy.robot(), POSITION, X[k : k + 1], GOALS[:1])[0] for k in (0, 17, 39)]
    assert together[[0, 17, 39]].tolist() == alone


def test_a_tool_extension_counts_and_unknown_configurations_stay_unknown():
    x = np.where(np.arange(40)[:, None] == 3, np.nan, X)
    longer = manipulability(toy.robot(), POSITION, x, GOALS, np.where(np.arange(40) < 20, 0.1, 0.0))
    plain = manipulability(toy.robot(), POSITION, x, GOALS)
    assert np.isnan(longer[3]) and np.isfinite(np.delete(longer, 3)).all()
    assert np.array_equal(longer[20:], plain[20:]) and (np.delete(longer[:20], 3) != np.delete(plain[:20], 3)).all()


def test_a_task_without_equations_has_none():
    assert np.isnan(manipulability(toy.robot(), Task(()), X, np.zeros((40, 0)))).all()


def test_the_table_of_targets_has_it_where_a_target_is_tracked():
    plans = toy.planned(toy.scenarios()[:2])
    values = np.where(plans.tracked, 0.25, np.nan)
    joints = joint_columns(toy.robot())
    rows = target_table("beam", np.arange(2), plans, joints, values)
    assert MANIPULABILITY in rows.column_names
    assert {value for value in rows[MANIPULABILITY].to_pylist() if value is not None} == {0.25}
    assert rows[MANIPULABILITY].null_count == int((plans.exists & ~plans.tracked).sum())


def test_targets_and_times_of_older_versions_are_read_with_empty_columns(tmp_path):
    plans = toy.planned(toy.scenarios()[:1])
    rows = target_table("beam", np.arange(1), plans, joint_columns(toy.robot()), plans.residual)
    older = with_new_columns(rows.drop_columns([MANIPULABILITY]), rows.schema)
    assert older.schema.equals(rows.schema) and older[MANIPULABILITY].null_count == len(rows)
    shard = SimpleNamespace(method="beam", scenario_numbers=range(1), targets=SimpleNamespace(sha256="0"))
    times = pa.Table.from_pylist([{"scenario": 0, "cycle_time_s": 2.0, "feed_target": 3}], timing_file.SCHEMA)
    for kept, expected in ((times, [3]), (times.drop_columns(["feed_target"]), [None])):
        (tmp_path / "timing").mkdir(exist_ok=True)
        written = timing_file.timing_bytes(timing_file.Timing(0.02, {}, kept), [shard], "beam")
        timing_file.timing_file(tmp_path, "beam").write_bytes(written)
        assert timing_file.read_timing(tmp_path, [shard], "beam").rows["feed_target"].to_pylist() == expected
