"""Readers of runs and plans: the viewer and the validation read the same; another format is refused."""

import json
import shutil

import numpy as np
import pytest
from made_plan import made_plan

from htcp_jax.errors import InputError
from htcp_jax.motion.plans import ARRAYS
from htcp_jax.runs import open_plans, open_run, parameters
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.plan_folder import SUMMARY, TRAJECTORY
from htcp_jax.validation.records import read_results
from htcp_jax.viewer.replay import open_replays

OTHER = "has the format of another version; plan it again"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A plan made by hand, and the folder it is saved in."""
    place = tmp_path_factory.mktemp("made")
    plan = made_plan(place)
    plan.save(place / "plan")
    return plan, place / "plan"


def rewritten(folder, place, **changes):
    """A copy of a plan's folder with other arrays; None removes an array."""
    shutil.copytree(folder, place)
    with np.load(place / TRAJECTORY) as file:
        arrays = {name: file[name] for name in file} | changes
    np.savez_compressed(place / TRAJECTORY, **{name: array for name, array in arrays.items() if array is not None})
    return place


def test_a_run_opens_with_its_plans_its_jobs_and_how_the_scenarios_differ(planned):
    run, found = open_run(planned / "run"), open_plans(planned / "run")
    assert (found.methods, found.count, found.mixed) == (run.methods, 8, False)
    for point, job in zip(run.points(), found.jobs, strict=True):
        assert job == point.config
        for mine, theirs in zip(found.parameters[point.number], parameters.of_job(job), strict=True):
            np.testing.assert_array_equal(mine, theirs)
    for method in found.methods:
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(found.plans(method), name), getattr(run.plans(method), name))


def test_a_planner_starts_where_the_job_says_and_a_run_remembers_it(planned):
    found = open_plans(planned / "run")
    jobs = np.array([job.start_rad for job in found.jobs])
    for method in found.methods:
        np.testing.assert_array_equal(found.plans(method).start, jobs)


def test_a_plan_opens_as_it_was_written_and_is_scenario_0(made):
    plan, folder = made
    found = open_plans(folder)
    assert (found.methods, found.count, found.labels, found.config) == (("baseline",), 1, {0: ""}, found.jobs[0])
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found.plans("baseline"), name), getattr(plan.plans, name))


@pytest.mark.parametrize("name", ["start", "segment_status", "orientation_error", "via_point_x"])
def test_a_plan_without_one_of_the_arrays_is_of_another_format(made, tmp_path, name):
    other = rewritten(made[1], tmp_path / "other", **{name: None})
    with pytest.raises(InputError, match=f"other {OTHER}: summary.json or trajectory.npz has no {name}$"):
        open_plans(other)


def test_a_plan_with_another_setting_is_of_another_format(made, tmp_path):
    other = shutil.copytree(made[1], tmp_path / "other")
    text = (other / SUMMARY).read_text()
    (other / SUMMARY).write_text(text.replace('"clearance_rows"', '"rows"'))
    with pytest.raises(InputError, match=f"other {OTHER}: summary.json: unknown key settings.rows$"):
        open_plans(other)


def test_a_run_of_another_format_is_refused_by_its_number(planned, tmp_path):
    other = shutil.copytree(planned / "run", tmp_path / "other")
    manifest = json.loads((other / MANIFEST).read_text()) | {"format": 2}
    (other / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=f"other {OTHER}: manifest.json has format 2, not 1"):
        open_plans(other)


def test_the_plan_s_own_start_wins_for_the_way_and_the_job_s_for_the_targets(made, tmp_path):
    plan, folder = made
    other = np.array(plan.job.start_rad) + 0.05
    moved = rewritten(folder, tmp_path / "moved", start=other)
    (track,) = read_results(moved).tracks
    np.testing.assert_array_equal(track.start, other)
    assert track.config.start_rad == plan.job.start_rad
    np.testing.assert_array_equal(open_plans(moved).plans("baseline").before(0, 0), other)


def test_who_looks_and_who_checks_say_the_same_of_a_folder_of_neither(tmp_path):
    reported = []
    for opener in (open_plans, open_replays, read_results):
        with pytest.raises(InputError, match="contains neither a run of htcp sweep") as error:
            opener(tmp_path)
        reported.append(str(error.value))
    assert len(set(reported)) == 1


@pytest.mark.parametrize("name", ["start", "x", "status", "clearance"])
def test_an_array_of_another_shape_is_damage(made, tmp_path, name):
    with np.load(made[1] / TRAJECTORY) as file:
        cut = file[name][:-1]
    spoiled = rewritten(made[1], tmp_path / "spoiled", **{name: cut})
    for opener in (open_plans, open_replays, read_results):
        with pytest.raises(InputError, match=r"is damaged: .* has the shape "):
            opener(spoiled)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["via_point_x", "via_point_share"])
def test_a_via_point_that_is_no_number_is_damage(made, tmp_path, name, wrong):
    arrays = {"via_point_x": made[0].plans.x[0, :1].copy(), "via_point_share": np.full(1, 0.5)}
    arrays[name].flat[0] = wrong
    spoiled = rewritten(made[1], tmp_path / "spoiled", via_point_target=np.ones(1, np.int32), **arrays)
    for opener in (open_plans, open_replays, read_results):
        with pytest.raises(InputError, match="is damaged: a via point to target 1 is NaN or infinite"):
            opener(spoiled)


def test_a_start_that_is_no_number_cannot_be_validated(made, tmp_path):
    spoiled = rewritten(made[1], tmp_path / "spoiled", start=np.full_like(made[0].plans.start[0], np.nan))
    with pytest.raises(InputError, match=r"trajectory.npz: start is missing or NaN"):
        read_results(spoiled)


def test_a_changed_file_of_the_scene_is_refused_by_all(made, tmp_path):
    copy = shutil.copytree(made[1], tmp_path / "copy")
    summary = json.loads((copy / SUMMARY).read_text())
    summary["files"] = dict.fromkeys(summary["files"], "0" * 64)
    (copy / SUMMARY).write_text(json.dumps(summary))
    for opener in (open_plans, open_replays, read_results):
        with pytest.raises(InputError, match="has changed since"):
            opener(copy)
