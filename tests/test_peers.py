"""Other planners whose plans are validated as motions: the scenarios they get, and the plans they return.

OMPL and tesseract-robotics-nanobind are not required by the tests: tests that need them are skipped without them.
"""

import itertools
import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.peer_cell import Brought, Cell
from benchmarks.peer_motions import PEERS, rows
from benchmarks.peer_planners import Task
from benchmarks.peers import chosen_scenarios, main
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning.batch import plan


def module(name):
    """Module of a peer; skip the test if its package is absent."""
    return pytest.importorskip(PEERS[name][0], reason=PEERS[name][2], exc_type=ImportError)


@pytest.fixture(scope="module")
def batch():
    return chosen_scenarios(1, None)


@pytest.fixture(scope="module")
def problem(batch):
    settings = batch.points[0].config.settings
    return Problem.of(batch.robot, batch.workpiece, batch.scenarios, settings, execution=Execution(threads=1))


@pytest.mark.slow
def test_configurations_that_are_brought_onto_a_target_are_there_and_clear_by_mujoco(batch, problem):
    cell, task = Cell(problem, 0), Task(batch, cKDTree(batch.workpiece.cloud), 0)
    draws = cell.start + 0.3 * np.random.default_rng(0).normal(size=(40, 6))
    here = cell.brought_clear(np.clip(draws, cell.lower, cell.upper), 30)
    assert 5 <= len(here.x) < 40
    for x, D, tcp in zip(here.x, here.clearance, here.tcp, strict=True):
        near = task.near(x)
        assert np.linalg.norm(near.tcp - task.targets[30]) <= 1e-3 and near.clearance.min() >= cell.margin - 1e-9
        assert near.clearance.min() == pytest.approx(D, abs=1e-8) and near.tcp == pytest.approx(tcp, abs=1e-9)


@pytest.mark.slow
def test_a_segment_off_the_path_is_not_proven_on_it_and_may_be_before_it(problem):
    """Proof of a segment that swings the TCP out and back: refused on the path, accepted before it."""
    cell = Cell(problem, 0)
    a, x = cell.start[None], cell.start[None] + np.array([0.02, 0, 0, 0, 0, 0])
    assert cell.proven(a, x, 1)[0] and not cell.proven(a, x, cell.on_path + 1)[0]


def test_a_planner_that_is_none_is_refused_in_one_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["peers", "--motions", "--planners", "ompl,beam"])
    with pytest.raises(SystemExit) as ended:
        main()
    last = capsys.readouterr().err.splitlines()[-1]
    assert ended.value.code == 2 and "ompl: no planner of --motions; valid: nspace-sqp, " in last


@pytest.mark.slow
@pytest.mark.parametrize("name", PEERS)
def test_a_peer_that_is_not_installed_is_named_with_what_to_install(batch, name):
    try:
        __import__(PEERS[name][0])
    except ImportError:
        _, line = rows(batch, [name], 1.0)
        assert line.startswith(name) and "pip install" in line
    else:
        pytest.skip(f"{name} is installed")


def test_ompls_constraint_has_the_jacobian_of_its_function():
    constraint = module("ompl-projected").AtPoint(np.array([1.2, 0.1, 0.9]))
    x, step = np.array([0.3, -0.4, 0.5, 0.2, -0.7, 0.1]), 1e-6
    value, jacobian = np.empty(3), np.empty((3, 6))

    def at(x):
        constraint.function(x, value)
        return value.copy()

    constraint.jacobian(x, jacobian)
    differences = [(at(x + e) - at(x - e)) / (2 * step) for e in step * np.eye(6)]
    assert jacobian == pytest.approx(np.transpose(differences), abs=1e-8)


def test_descartes_finds_the_shortest_path_through_a_ladder():
    """Shortest path through a small ladder graph with one edge in three missing, compared with all paths."""
    descartes, draw = module("descartes-ladder"), np.random.default_rng(1)
    configurations = [draw.normal(size=(count, 6)) for count in (1, 4, 5, 4)]
    rungs = [Brought(x, *np.zeros((2, len(x))), np.zeros((len(x), 3))) for x in configurations]
    edges = [
        {
            (i, j): float(np.linalg.norm(a[i] - b[j]))
            for i, j in itertools.product(range(len(a)), range(len(b)))
            if draw.random() < 0.67
        }
        for a, b in itertools.pairwise(configurations)
    ]

    def length(path):
        return sum(found.get(pair, np.inf) for found, pair in zip(edges, itertools.pairwise(path), strict=True))

    shortest = min(itertools.product(*(range(len(x)) for x in configurations)), key=length)
    assert np.isfinite(length(shortest)) and descartes.shortest_path(rungs, edges) == list(shortest)


@pytest.mark.slow
@pytest.mark.parametrize("name", PEERS)
def test_every_target_that_a_peer_claims_is_executable(problem, name):
    _, kind, _ = PEERS[name]
    made = getattr(module(name), kind)
    method = made(5.0) if name == "ompl-projected" else made()
    plans = plan(problem, _registered(method))
    assert plans.tracked.sum() >= 40 and (plans.executable == plans.tracked).all()


def _registered(method):
    from htcp_jax.planning import registry

    if method.name not in registry.names():
        registry.METHODS.register(method)
    return method.name
