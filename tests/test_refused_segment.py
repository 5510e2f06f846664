"""What prevents a segment to a lost target: clearances and deviations as brute force measures them."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from htcp_jax.jobs import load_config
from htcp_jax.motion import Plans, Problem, Tried
from htcp_jax.motion.plans import Outcome
from htcp_jax.planning.refused_segment import RefusedSegment, refused_segment
from htcp_jax.reachability.obstruction import obstruction
from htcp_jax.runs import failure_texts
from htcp_jax.status import Exclusion, SegmentStatus, Status

PROOFS = replace(toy.SETTINGS, effort=0.0, smooth=False)


def lost(problem: Problem, plans: Plans) -> dict[int, RefusedSegment]:
    """The refused segment of each scenario that lost a target on the path, by row."""
    found = {}
    for s, end in enumerate(map(plans.outcome, range(len(plans.status)))):
        if end.status not in failure_texts.MEASURED or end.failed <= problem.scenarios.on_path[s]:
            continue
        one = toy.scenarios()[s]
        x_last = plans.before(s, end.failed)
        at = obstruction(toy.robot(), toy.workpiece(), one, x_last, end.failed, problem.settings)
        own = toy.problem([one], problem.settings, threads=1)
        if at.reached and (made := refused_segment(own, x_last, end.failed, at.x)) is not None:
            found[s] = made
    return found


def test_where_a_segment_collides_brute_force_measures_the_same_clearance():
    plans, problem = toy.plans_by(settings=PROOFS), toy.problem(settings=PROOFS)
    found = lost(problem, plans)
    near = {s: each for s, each in found.items() if not each.leaves_path and each.verdict != SegmentStatus.VALID}
    assert near
    for s, each in near.items():
        (clearance,), _ = toy.measured(toy.scenarios()[s], each.x[None])
        assert each.clearance_m == pytest.approx(clearance, abs=1e-9)
        assert clearance < each.margin_m or each.verdict == SegmentStatus.UNDECIDED
        assert sum(each.counts.values()) > 0 and SegmentStatus.VALID not in each.counts
        assert "the bodies" in each.description("the bodies") and " colli" in each.description("")


def test_a_segment_that_leaves_the_path_is_off_its_line_by_the_stated_length():
    """Between targets that are three apart the straight joint path leaves the straight line."""
    settings, plans = replace(PROOFS, path_tolerance_m=1e-4), toy.plans_by(settings=PROOFS)
    one, row = toy.scenarios()[1], plans.outcome(1).tracked - 4
    assert row > one.on_path
    targets = one.targets.copy()
    targets[row + 1] = targets[row + 3]
    apart = replace(one, targets=targets)
    problem = toy.problem([apart], settings, threads=1)
    found = refused_segment(problem, plans.x[1, row], row + 1, plans.x[1, row + 3])
    assert found.verdict == SegmentStatus.OFF_PATH and found.leaves_path and found.tube_m == 1e-4
    _, (tcp,) = toy.measured(apart, found.x[None])
    a, b = apart.targets[[row, row + 1]]
    along = (b - a) / np.linalg.norm(b - a)
    off = tcp - a - ((tcp - a) @ along) * along
    assert found.off_m == pytest.approx(np.linalg.norm(off), abs=1e-6) and found.off_m > 1e-4
    assert f"leaves the path by {1e3 * found.off_m:.3g} mm, 0.1 mm allowed" in found.description("")
    found = found._replace(off_m=2.04e-4)
    line = failure_texts.next_step(_end(Status.PATH_BLOCKED), found, {}, load_config(None), "job.yaml")["next"]
    assert line.startswith("htcp plan job.yaml --set settings.path_tolerance_m=0.0003 ")


def test_a_proven_segment_below_the_aim_is_named_and_the_suggested_setting_gets_past_it():
    """A search that aims 3 cm above the margin loses targets at which the arm is clear."""
    strict = replace(PROOFS, beam_aim_m=0.03, aim_above_m=0.03)
    plans, problem = toy.plans_by(settings=strict), toy.problem(settings=strict)
    found = {s: each for s, each in lost(problem, plans).items() if each.verdict == SegmentStatus.VALID}
    assert found
    further = toy.plans_by(settings=replace(strict, beam_aim_m=0.0))
    job = load_config(None, ["settings.beam_aim_m=0.03"])
    for s, each in found.items():
        assert each.margin_m <= each.end_clearance_m < each.margin_m + 0.03
        assert "between the" in failure_texts.aim(each, job)["clearance there"]
        assert each.description("").endswith(", but the search did not use it")
        end = plans.outcome(s)
        assert end.status.ended in ("no configuration accepted", "no segment accepted")
        assert "accepted" in failure_texts.reason(end, each) and "clear" in failure_texts.reason(end, each)
        assert further.outcome(s).tracked > end.tracked
        line = failure_texts.next_step(end, each, {}, job, "my job.yaml")["next"]
        assert line.startswith("htcp plan my job.yaml --set settings.beam_aim_m=0 ")
        assert not failure_texts.aim(each._replace(end_clearance_m=each.margin_m + 0.031), job)


def _end(status: Status):
    return toy.plans_by(settings=PROOFS).outcome(0)._replace(status=status, failed=3)


def test_a_job_with_changes_is_one_line_of_arguments():
    assert failure_texts.arguments(None, ["margin_m=0.001"]) == "duct --set margin_m=0.001"
    assert failure_texts.arguments("a job.yaml", {"start_rad": "auto"}) == "'a job.yaml' --set start_rad=auto"
    assert failure_texts.arguments({"margin_m": 0.001}) == "JOB"


def test_the_next_command_follows_from_the_reason():
    job, seen = load_config(None), None
    line = failure_texts.next_step(_end(Status.NO_START), seen, {}, job, "job.yaml")["next"]
    assert line.startswith("htcp reachability job.yaml --each ")
    for effort, more in ((0.0, "2"), (2.0, "8")):
        own = load_config(None, [f"settings.effort={effort}"])
        line = failure_texts.next_step(_end(Status.PATH_BLOCKED), seen, {}, own, "")["next"]
        assert line.startswith(f"htcp plan --set settings.effort={more} ")
    own = load_config(None, ["settings.effort=8"])
    assert "settings.transfers=true" in failure_texts.next_step(_end(Status.PATH_BLOCKED), seen, {}, own, "")["next"]
    assert not failure_texts.next_step(_end(Status.TIP_BLOCKED), seen, {}, job, "job.yaml")


def test_a_longer_search_is_not_advised_for_a_target_without_a_known_clear_configuration():
    job, lost, found = load_config(None), _end(Status.RECOVERY_EXHAUSTED), _end(Status.PATH_BLOCKED)
    proof = Tried(excluded=Exclusion.ARM)
    at_failed, at_path_behind_it = {3: proof}, {5: proof}
    for end, tried in ((lost, {}), (lost, {3: Tried()}), (lost, at_failed), (found, at_path_behind_it)):
        line = failure_texts.next_step(end, None, tried, job, "job.yaml")["next"]
        assert line.startswith("htcp reachability job.yaml --each ") and "htcp place" in line
    assert "settings.effort=8" in failure_texts.next_step(found, None, {2: proof}, job, "job.yaml")["next"]
    without_search = load_config(None, ["settings.effort=0"])
    assert "settings.effort=2" in failure_texts.next_step(lost, None, {}, without_search, "job.yaml")["next"]


def test_a_start_that_lacks_less_than_half_of_the_margin_is_tried_with_other_random_configurations():
    end, job = Outcome(0, 4, 0, 0, 0, Status.NO_START, 0, SegmentStatus.VALID), load_config(None, ["margin_m=0.0008"])
    found = failure_texts.next_step(end, None, {}, job, "job.yaml --set settings.seed=0", start_m=0.00059)["next"]
    assert found.startswith("htcp plan job.yaml --set settings.seed=1   ")


def test_a_suggested_command_replaces_an_earlier_value_of_the_same_key():
    end, job = Outcome(0, 4, 0, 0, 0, Status.NO_START, 0, SegmentStatus.VALID), load_config(None, ["margin_m=0.04"])
    given = "job.yaml --set margin_m=0.04 --set 'home_rad=[0, 1]'"
    found = failure_texts.next_step(end, None, {}, job, given, start_m=0.00085)["next"]
    assert found.startswith("htcp plan job.yaml --set 'home_rad=[0, 1]' --set margin_m=0.0004   ")
    denser = failure_texts.next_step(end, None, {}, job, "job.yaml", spacing_m=0.003)["next"]
    assert denser.startswith("htcp plan job.yaml --set workpiece.mesh_spacing_m=0.003   ")


def test_if_the_points_on_the_mesh_cost_more_than_remains_a_denser_spacing_is_named():
    costs = "1.5 mm are subtracted for the gaps between them"
    coarse, fine = (replace(toy.workpiece(), covering_radius_m=radius_m) for radius_m in (0.0015, 0.0001))
    assert failure_texts.subtracted(coarse, 0.0016) == costs
    denser = f"{costs}, at most 0.5 mm with --set workpiece.mesh_spacing_m=0.001"
    assert failure_texts.subtracted(coarse, 0.0007) == denser
    as_dense_as_allowed = "0.1 mm are subtracted for the gaps between them"
    assert failure_texts.subtracted(fine, 0.0) == as_dense_as_allowed
