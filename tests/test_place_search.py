"""Ranges of placements and the search in them: pure functions, compared with brute force."""

import math

import numpy as np
import pytest
import toy
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.mountings import fixed_score
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.placement.part_depth import part_depths
from htcp_jax.placement.place import is_on_pareto_front
from htcp_jax.placement.place_file import load_search
from htcp_jax.placement.ranges import Ranges, read_ranges
from htcp_jax.placement.search import APART, FROM, POPULATION, Evolution, SearchResults, best_apart, even, score

JOINTS = tuple(f"joint{k}" for k in range(1, 7))
NUMBER = st.floats(-1e3, 1e3)


def ranges(raw: dict, **changes) -> Ranges:
    return read_ranges("place", raw, JOINTS, load_config(None, changes).model_dump())


@given(NUMBER, NUMBER, st.lists(st.floats(0, 1), min_size=1, max_size=5))
def test_every_point_of_the_unit_cube_is_a_value_within_the_range_and_leads_back(a, b, u):
    low, high = sorted((a, b))
    if not low < high:
        return
    found = ranges({"workpiece.shift_m.y": [low, high]})
    values = found.values(np.array(u)[:, None])
    assert (values >= low).all() and (values <= high).all()
    came = (values - found.low)[:, 0]  # relative to the required width, however narrow the range is
    np.testing.assert_allclose(came, np.array(u) * found.width, atol=1e-12 * max(1, abs(low), abs(high)))


def test_elements_vary_and_numbers_stay_and_the_rest_of_a_vector_is_the_jobs():
    raw = {"workpiece.shift_m": [0.1, [0, 1], -0.2], "start_rad.3": [0.4, 0.6], "robot.base_m.z": [0, 0.5]}
    found = ranges(raw, **{"robot.base_m": [1, 2, 3]})
    assert [axis.name for axis in found.axes] == ["workpiece.shift_m.y", "start_rad.3", "robot.base_m.z"]
    columns = found.columns(found.values(np.array([[0.5, 0.5, 0.5], [1, 1, 1]])))
    assert columns["workpiece.shift_m"] == [[0.1, 0.5, -0.2], [0.1, 1.0, -0.2]]
    assert columns["start_rad"] == [[0.0, -2.3, 0.5, 0.0, 0.5, -2.0], [0.0, -2.3, 0.6, 0.0, 0.5, -2.0]]
    assert columns["robot.base_m"] == [[1, 2, 0.25], [1, 2, 0.5]]


def test_a_vector_in_which_every_number_stays_is_heeded_too():
    found = ranges({"workpiece.rotation_y_rad": [0, 1], "workpiece.shift_m": [0.1, 0.2, 0.3]})
    (jobs,) = [load_sweep({"grid": [found.columns(np.array([[0.25]]))]}).batch().points]
    assert jobs[0].config.workpiece.shift_m == (0.1, 0.2, 0.3) and jobs[0].config.workpiece.rotation_y_rad == 0.25


def test_the_grid_of_mountings_holds_the_same_jobs_as_the_values_say():
    rows = [{"point": "tcp", "on": "path"}, {"axis": "tcp.z", "towards": "path.tangent", "cone_deg": 90}]
    raw = {"robot.base_m": [[-0.1, 0.1], 0.0, [0, 0.2]], "task.2.cone_deg": [60, 120], "start_rad.joint3": [0.4, 0.6]}
    values = ranges(raw, task=rows).values(even(4, 0, 5, 0))
    jobs = load_sweep({"grid": [ranges(raw, task=rows).columns(values)]}, None, {"task": rows}).batch().points
    reported = [(*p.config.robot.base_m, p.config.task[1].cone_deg, p.config.start_rad[2]) for p in jobs]
    assert reported == [(x, 0.0, z, cone, joint) for x, z, cone, joint in values.tolist()]


@pytest.mark.parametrize(
    ("raw", "says"),
    [
        ({}, "place is empty; it needs at least one range"),
        ({"workpiece.rotation_y_rad": [1, 1]}, r"workpiece.rotation_y_rad: the range \[1, 1\] is empty"),
        ({"workpiece.shift_m": [[1, 0], 0, 0]}, r"workpiece.shift_m.x: the range \[1, 0\] is reversed"),
        ({"workpiece.shift_m.x": [-1e308, 1e308]}, r"the range is \[-1e\+308, 1e\+308\]; valid"),
        ({"workpiece.shift_m.x": [0, math.nan]}, r"a range must be \[smallest, largest\]"),
        ({"workpiece.shift_m.x": 3}, r"workpiece.shift_m.x is 3; a range must be \[smallest, largest\]"),
        ({"workpiece.shift_m": [0, 1]}, "workpiece.shift_m has 3 elements; each must be a range or a number"),
        ({"workpiece.shift_m": [0, 1, 2]}, r"only numbers; at least one range \[smallest, largest\] is needed"),
        ({"workpiece.shift_m": [[0, 1], 0, 0], "workpiece.shift_m.x": [0, 1]}, "is repeated"),
        ({"start_rad.3": [0, 1], "start_rad.joint3": [0, 1]}, "is repeated"),
        ({"method": ["a", "b"]}, "method cannot vary in a search; valid: keys of the workpiece's pose"),
        ({"settings.alpha_rad": [0, 1]}, "settings.alpha_rad cannot vary in a search"),
        ({"margin_m": [0, 1]}, "margin_m cannot vary in a search"),
        ({"workpiece.cloud": [0, 1]}, "workpiece.cloud cannot vary in a search, because it is not a number"),
        ({"start_rad": [[0, 1]] * 6}, "start_rad cannot vary in a search"),
        ({"workpiece.rotation_y": [0, 1]}, "unknown parameter workpiece.rotation_y; did you mean workpiece.rotation_y"),
    ],
)
def test_what_is_no_range_is_refused_in_one_line(raw, says):
    with pytest.raises(InputError, match=says) as refused:
        ranges(raw)
    assert "\n" not in str(refused.value)


def test_an_element_that_the_job_does_not_have_is_refused():
    with pytest.raises(InputError, match=r"start_rad\.3: the job's start_rad has no such element"):
        ranges({"start_rad.3": [0, 1]}, start_rad="auto")


RANGE = {"place": {"workpiece.rotation_y_rad": [0, 1]}}


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"within": {"scenarios": 0}}, "within.scenarios is 0"),
        ({"within": {"seconds": 0}}, "within.seconds is 0"),
        ({"within": {"scenarios": 1, "seconds": 1}}, "scenarios: N. or .seconds: S."),
        ({"config": "six-seams", "within": {"scenarios": 1}}, "scenarios must be at least 6, the number of seams"),
        ({"seams": ["left", "right"]}, "seams has moved to the job"),
        ({"objective": "speed"}, "unknown objective 'speed'; valid: clearance, cycle time, joint motion"),
        ({"objective": ["clearance", "clearance"]}, "it must be one objective or a list of two"),
        ({"objective": []}, "it must be one objective or a list of two"),
        ({"screen": "fast"}, "unknown method 'fast'; valid: baseline"),
        ({"confirm": "fast"}, "unknown method 'fast'; valid: baseline"),
        ({"perturbation": {"mm": 0}}, "perturbation.mm is 0"),
        ({"best": 0}, "best is 0"),
        ({"sead": 1}, "sead"),
    ],
)
def test_what_is_wrong_with_the_file_is_refused_in_one_line(more, says):
    with pytest.raises(InputError, match=says) as refused:
        load_search({**RANGE, **more})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("given", "deeper"), [(0.0, [0.0, 20e-3]), (-70e-3, [0.0, 10e-3])])
def test_a_part_in_the_table_is_told_by_how_much_deeper_it_is_than_in_the_job_as_given(tmp_path, given, deeper):
    """A table whose top is 60 mm below the shelf, which is moved down by 20 and 80 mm."""
    (tmp_path / "cell.xml").write_text(
        '<mujoco><worldbody><geom name="table" type="box" size="0.3 0.3 0.1" pos="0.6 0 0.2"/></worldbody></mujoco>'
    )
    job = toy.write_job(tmp_path, 3, shift_m=(0.0, 0.0, given), cell={"model": "cell.xml"})
    search = load_search({"place": {"workpiece.shift_m.z": [-0.1, 0.0]}}, job)
    found = part_depths(search, np.array([[-20e-3], [-80e-3]]))
    np.testing.assert_allclose([one.depth_m for one in found], deeper, atol=1e-9)
    assert [one.solid for one in found] == ["", "table"]


# The search


def known(u, objective, complete=None, done=None) -> SearchResults:
    objective = np.array(objective, float).reshape(len(u), -1)
    complete = np.ones(len(u), bool) if complete is None else np.array(complete)
    return SearchResults(np.asarray(u, float), np.ones(len(u)) if done is None else np.array(done), complete, objective)


def bowl(u) -> SearchResults:
    """An objective with its optimum at 0.3 in every parameter; only points near it are complete."""
    off = np.abs(np.asarray(u) - 0.3).max(axis=1)
    complete = off < 0.2
    return known(u, np.where(complete, -off, -np.inf), complete, np.where(complete, 1.0, 1 - off))


@pytest.mark.parametrize("d", [1, 2, 6])
def test_evolution_is_a_pure_function_of_answers_and_seed_and_betters_the_best(d):
    def rounds(seed: int) -> list[np.ndarray]:
        evolution, requested = Evolution(bowl(even(d, 0, 60, 0)), 1, seed), []
        for _ in range(12):
            requested.append(evolution.ask())
            evolution.tell(bowl(requested[-1]))
        return requested

    first, again, other = rounds(0), rounds(0), rounds(1)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert all(u.shape == (FROM * POPULATION, d) and u.min() >= 0 and u.max() <= 1 for u in first)
    best = bowl(even(d, 0, 60, 0)).objective.max()
    assert bowl(np.concatenate(first)).objective.max() > (0.7 * best if np.isfinite(best) else best)


def test_even_mountings_come_in_one_sequence_however_it_is_cut():
    whole = even(3, 0, 50, 7)
    np.testing.assert_array_equal(np.concatenate([even(3, 0, 20, 7), even(3, 20, 30, 7)]), whole)
    assert not np.array_equal(even(3, 0, 50, 8), whole)


@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 20), st.one_of(st.none(), st.floats(-1e3, 1e3))),
        min_size=1,
        max_size=12,
    )
)
def test_what_is_complete_scores_before_what_is_not_then_by_objective_or_by_the_share_done(rows):
    complete = np.array([c for c, _, _ in rows])
    done = np.array([1.0 if c else share / 21 for c, share, _ in rows])
    objective = np.array([-np.inf if v is None or not c else v for c, _, v in rows])
    found = score(known(np.zeros((len(rows), 1)), objective, complete, done), np.ones(1))
    assert np.isfinite(found).all()
    for i in range(len(rows)):
        for j in range(len(rows)):
            if complete[i] and not complete[j]:
                assert found[i] < found[j]
            elif complete[i] and complete[j] and np.isfinite(objective[[i, j]]).all() and objective[i] > objective[j]:
                assert found[i] <= found[j]
            elif not complete[i] and not complete[j] and done[i] > done[j]:
                assert found[i] < found[j]


def test_the_benchmark_of_differential_evolution_ranks_mountings_as_the_search_does():
    rng = np.random.default_rng(0)
    complete, done = rng.random(100) < 0.5, rng.integers(0, 90, 100) / 100
    for objective in (rng.normal(0.01, 0.005, 100), -rng.uniform(3, 60, 100)):  # clearances [m], joint motions [rad]
        own = known(rng.random((100, 2)), np.where(complete, objective, -np.inf), complete, np.where(complete, 1, done))
        scores, fixed = score(own, np.ones(1)), fixed_score(own)
        assert ((scores[:, None] < scores) == (fixed[:, None] < fixed)).all()


def test_an_objective_of_which_nothing_is_known_does_not_hide_the_other():
    found = score(known([[0.0], [0.1]], [[1.0, -np.inf], [2.0, -np.inf]]), np.array([0.5, 0.5]))
    assert found[1] < found[0]


@given(st.lists(st.lists(st.floats(0, 1), min_size=2, max_size=2), min_size=1, max_size=20), st.integers(1, 6))
def test_chosen_mountings_keep_apart_and_none_that_could_be_chosen_is_passed_over(points, count):
    u, order = np.array(points), np.random.default_rng(0).permutation(len(points))
    chosen = best_apart(u, order, count)
    far = np.abs(u[:, None] - u[None]).max(axis=2) >= APART
    assert all(far[a, b] for a in chosen for b in chosen if a != b) and len(chosen) <= count
    for k in order.tolist():
        if k not in chosen and len(chosen) < count:
            assert not far[k, chosen].all()


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=12))
def test_the_pareto_front_is_what_no_other_beats(objective):
    beaten = [any(a >= x and b >= y and (a, b) != (x, y) for a, b in objective) for x, y in objective]
    assert is_on_pareto_front(np.array(objective, float)).tolist() == [not b for b in beaten]
