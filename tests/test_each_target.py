"""Reach of each target by itself: behind gaps, in any order, with the reason where no configuration exists."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import toy

import htcp_jax
from htcp_jax.clearance import Scene
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.cli import main
from htcp_jax.device import Executor
from htcp_jax.device.tables import gather
from htcp_jax.jobs import load_sweep_or_job
from htcp_jax.model import Workpiece
from htcp_jax.model.kinematics import max_reach
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.tool_cells import excluded
from htcp_jax.reachability import Reach, reachable_prefixes
from htcp_jax.reachability.each_target import STEP_NAMES
from htcp_jax.reachability.reachability import _upper_bounds, initial_reachability
from htcp_jax.report.reach_study import search_batch
from htcp_jax.settings import Settings

FAR = (5.0, 0.0, 0.5)
SEARCH = {"resolution_rad": 0.9, "proof_cells": 64, "each": True}


def judged(path, cloud=None, **changes):
    """The toy arm's reach at every point of a path, without an approach."""
    shelf = toy.workpiece()
    part = Workpiece("part", shelf.cloud if cloud is None else cloud, path, interior="none", pivot=np.zeros(3),
                     neutral_translation=np.zeros(3))  # fmt: skip
    one = make_scenario(toy.robot(), part, None, beyond_reach="record", **changes)
    return one, reachable_prefixes(toy.robot(), part, stack([one]), toy.SETTINGS, **SEARCH)


@pytest.fixture(scope="module")
def with_a_gap():
    path = toy.workpiece().path.copy()
    path[3] = FAR
    return judged(path)


def test_targets_behind_a_gap_are_judged_and_the_gap_has_its_reason(with_a_gap):
    one, found = with_a_gap
    reach = found.each.reach[0, int(one.on_path) :]
    assert found.prefix[0] == one.on_path + 3 and found.most[0] == found.prefix[0]
    assert reach[3] == Reach.OUT_OF_REACH
    assert (np.delete(reach, 3) == Reach.REACHABLE).all()


def test_the_configuration_at_every_reachable_target_is_clear_and_on_it(with_a_gap):
    one, found = with_a_gap
    reachable = found.each.reach[0] == Reach.REACHABLE
    D, tcp = toy.measured(one, found.each.x[0, reachable])
    assert (D >= one.margin_m).all()
    assert (np.linalg.norm(tcp - one.targets[reachable], axis=1) <= toy.SETTINGS.tolerance_m).all()


def test_the_order_of_the_targets_changes_nothing(with_a_gap):
    path = toy.workpiece().path.copy()
    path[3] = FAR
    one, found = judged(path[::-1])
    first, was = with_a_gap
    own, before = found.each.reach[0, int(one.on_path) :], was.each.reach[0, int(first.on_path) :]
    np.testing.assert_array_equal(own[::-1], before)


def walled_in(target):
    """Points of a ball about a target, and a margin so wide that few cells prove that no tool gets in."""
    count = len(toy.workpiece().cloud)  # as many points as the shelf has, so that the programs are the same
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ball = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    return target + 0.05 * ball, {"margin_m": 0.08}


def test_a_target_at_which_the_tool_is_walled_in_is_excluded_by_the_tool():
    target = np.array([0.5, 0.0, 0.5])
    ball, wide = walled_in(target)
    found = judged(np.stack([target, [0.5, 0.3, 0.6]]), ball, **wide)[1]
    assert found.each.reach[0, -2:].tolist() == [Reach.TOOL, Reach.REACHABLE]


def test_excluded_targets_are_found_on_a_path_that_comes_back_into_the_open():
    target, away = np.array([0.5, 0.0, 0.5]), np.array([0.5, 0.3, 0.6])
    ball, wide = walled_in(target)
    path = np.concatenate([np.tile(away, (3, 1)), np.tile(target, (8, 1)), np.tile(away, (20, 1))])
    part = Workpiece("ball", ball, path, interior="none", pivot=np.zeros(3), neutral_translation=np.zeros(3))
    scenarios = stack([make_scenario(toy.robot(), part, None, **wide)])
    prefix = np.array([int(scenarios.on_path[0]) + 3])
    found = initial_reachability(scenarios)._replace(prefix=prefix, resolution_rad=np.ones(1))
    executor = Executor(Scene(toy.robot(), make_obstacle(part)), Settings())
    assert _upper_bounds(executor, toy.robot(), scenarios, found, 64) == prefix


def test_no_sampled_valid_configuration_is_at_an_excluded_target():
    """Valid configurations of the arm beneath the shelf: at each one's TCP a proof would be wrong.

    For those next to the shelf, where more can be proven, with more cells.
    """
    robot, scene, one = toy.robot(), toy.scene(), toy.scenario()
    x = np.random.default_rng(4).uniform(robot.lower, robot.upper, (400, 4))
    D, tcp = toy.measured(one, x)
    tcp = tcp[np.argsort(D)][np.sort(D) >= one.margin_m]
    assert len(tcp) > 100
    one = replace(one, targets=tcp, count=np.asarray(len(tcp), np.int32))
    inputs = lane_inputs(stack([one]), np.zeros(len(tcp), int), np.arange(len(tcp)))
    assert not excluded(Executor(scene, Settings()), robot, inputs, 64).any()
    assert not excluded(Executor(scene, Settings()), robot, gather(inputs, slice(60)), 256).any()
    assert (np.linalg.norm(tcp - [0, 0, 0.3], axis=1) <= max_reach(robot)).all()


@pytest.fixture
def job(tmp_path):
    (tmp_path / "toy.xml").write_text(toy.ARM)
    path = toy.workpiece().path.copy()
    path[3] = FAR
    np.savetxt(tmp_path / "path.csv", path, delimiter=",", header="x,y,z", comments="")
    np.savetxt(tmp_path / "shelf.xyz", toy.workpiece().cloud)
    (tmp_path / "job.yaml").write_text(
        "robot: {model: toy.xml, limits: model}\n"
        "workpiece: {cloud: shelf.xyz, path: path.csv, interior: none, tip_contact_m: null}\n"
        "start_rad: auto\n"
    )
    return tmp_path / "job.yaml"


def test_one_command_judges_a_job_and_writes_a_table_and_a_picture(job, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["reachability", str(job), "--each", "--resolution", "0.9", "--proof-cells", "64", "--out", str(out)]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert re.search(r"excluded: out of reach +1 +10.00 +4\n", text)
    assert re.search(rf"target numbers +reason\n4 +{Reach.OUT_OF_REACH.message}\n", text)
    rows = list(csv.DictReader((out / "reach.csv").read_text().splitlines()))
    assert [row["reach"] for row in rows] == ["reachable"] * 3 + ["out of reach"] + ["reachable"] * 6
    assert rows[3]["reason"] == Reach.OUT_OF_REACH.message and rows[4]["j1_rad"]
    assert json.loads((out / "reachability.json").read_text())["each"][0][-10:] == [row["reach"] for row in rows]
    assert (out / "reach.png").read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--config", str(job)]) == 2
    assert "is a job; omit config (--config), which replaces the job of a sweep" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore:.*the path jumps")
def test_the_progress_of_every_step_goes_from_none_to_all_of_its_targets(job):
    batch, steps = load_sweep_or_job(job).batch(), list[tuple]()
    search_batch(batch, 0.9, 64, True, lambda _, *now: steps.append(now))
    named = [now for now in steps if len(now) == 3]
    assert {name for *_, name in named} >= {STEP_NAMES["coarse"], STEP_NAMES["proofs"]}
    begun = [k for k, (done, *_) in enumerate(named) if not done]
    ends = [named[k - 1] for k in [*begun[1:], len(named)]]
    assert all(done == count > 0 for done, count, _ in ends)


@pytest.mark.filterwarnings("ignore:.*the path jumps")
def test_the_study_from_python_has_the_counts_and_a_row_for_each_target(job):
    study = htcp_jax.reach_study(job, resolution_rad=0.9, proof_cells=64)
    assert study.counts[Reach.REACHABLE] == 9 and study.counts[Reach.OUT_OF_REACH] == 1
    assert len(study.table().rows) == sum(study.counts.values()) == 10
    assert len(study.figure().axes) == 2
