"""Ladder graph over samples of inverse kinematics: how far a dense reference follows where the beam search ends.

    python -m benchmarks ladder SWEEP [--scenarios 246,248] [--samples 5000] [--set KEY=VALUE]...

A rung is a target. Its vertices are configurations at this target that satisfy the task, keep the margin, and are
connected to a vertex of the previous rung by an edge (a straight joint path), or by an edge and self-motions on this
rung. Candidates are the vertices of the previous rung, extended as the planner does, and samples of inverse kinematics.
Half of the samples are drawn around vertices of the previous rung and joined to them, a quarter around vertices of this
rung, and a quarter uniformly; the latter two are joined to the nearest vertices. Edges and self-motions are proven by
the planner's own collision checker, in the planner's tubes. In each cell of a grid of joint angles, a rung keeps the
vertex with the largest clearance, and at most `--samples` vertices, drawn at random. So the counts are lower bounds.

Up to the path's first point all uniform samples are vertices, as `settings.transfers` allows any joint path to them;
whether the arm can move there from home is not tested, which favours the reference. A scenario's count is the number
of its rungs with vertices. The table also contains the beam's tracked and executable targets.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from benchmarks import hardware
from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import Batch, load_sweep
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning.batch import plan
from htcp_jax.planning.beam.functions import EXTEND, SELF_MOTION, inputs_and_tubes
from htcp_jax.status import SegmentStatus

GRID_RAD = 0.06  # width of a grid cell, which keeps one vertex
AROUND_RAD, HALVINGS = 0.4, 4  # largest standard deviation of samples around vertices, and how often it is halved
NEAR_RAD, NEAREST = 1.2, 2  # maximum length of a self-motion to a sample, and number of vertices from which it is tried
ROUNDS = 4  # rounds of samples on a rung, each around the vertices so far
ROW = "{:>8} {:>7} {:>9} {:>7} {:>10} {:>7} {:>8}"

Rows = Float[np.ndarray, "n N"]


class Ladder:
    """Ladder graph of one scenario, built forwards rung by rung.

    Args:
        problem: Scene, settings and scenarios.
        scenario: Row of the scenario.
        samples: Maximum number of samples drawn on a rung, and of vertices kept on it.
    """

    def __init__(self, problem: Problem, scenario: int, samples: int):
        self._problem, self._scenario, self._samples = problem, scenario, samples
        self._checker = problem.checkers[0]
        self._draw = np.random.default_rng([problem.settings.seed, int(problem.scenarios.number[scenario])])
        start, (lower, upper) = problem.scenarios.x_start[scenario], self._checker.executor.limits
        self._limits = lower, upper
        self._box = np.maximum(lower, start - np.pi), np.minimum(upper, start + np.pi)  # box of the uniform samples

    def rungs(self):
        """Yield the vertices rung by rung, until a rung on the path has none."""
        scenarios, x = self._problem.scenarios, np.empty((0, len(self._box[0])))
        on_path = int(scenarios.on_path[self._scenario])
        for target in range(int(scenarios.count[self._scenario])):
            x = self._next(x, target) if len(x) else x
            if target <= on_path:  # any joint path in free space leads there
                x = np.concatenate([x, self._kept(*self._continued(self._uniform(self._samples), target)[:2])])
            elif not len(x):
                return
            yield x

    def _next(self, x: Rows, target: int) -> Rows:
        """Return the vertices of a rung, given the vertices of the previous rung."""
        extended = self._checker.executor(EXTEND, self._problem.inputs(self._scenario, target, len(x)), x).at
        before, drawn = self._around(x, self._samples // 2)
        before, drawn = np.concatenate([x, before]), np.concatenate([extended.x, drawn])
        there, clear, row = self._continued(drawn, target)
        proven = self._proven(before[row], there, target, turns=False)
        vertices, clear = there[proven], clear[proven]
        for _ in range(ROUNDS if len(vertices) else 0):
            around = self._around(vertices, self._samples // (4 * ROUNDS))[1]
            drawn, free, _ = self._continued(np.concatenate([self._uniform(len(around)), around]), target)
            joined = self._joined(vertices, drawn, target)
            vertices, clear = np.concatenate([vertices, drawn[joined]]), np.concatenate([clear, free[joined]])
        return self._kept(vertices, clear)

    def _around(self, x: Rows, count: int) -> tuple[Rows, Rows]:
        """Return vertices drawn at random, and samples around them."""
        x = x[self._draw.integers(len(x), size=count)]
        spread = AROUND_RAD * 2.0 ** self._draw.uniform(-HALVINGS, 0, (count, 1))
        return x, x + spread * self._draw.standard_normal(x.shape)

    def _uniform(self, count: int) -> Rows:
        return self._draw.uniform(*self._box, (count, len(self._box[0])))

    def _continued(self, x: Rows, target: int) -> tuple[Rows, np.ndarray, np.ndarray]:
        """Return valid configurations on a target by inverse kinematics, their clearance [m], and their rows in x."""
        inputs = self._problem.inputs(self._scenario, target, len(x))
        at = self._checker.states(inputs, self._checker.project(inputs, np.clip(x, *self._limits)))
        good = np.flatnonzero(self._checker.valid(inputs, at))
        return at.x[good], at.clearance[good], good

    def _kept(self, x: Rows, clear: np.ndarray) -> Rows:
        """Return the vertex with the largest clearance in each grid cell, at most as many vertices as samples."""
        order = np.argsort(-clear, kind="stable")
        first = np.unique(np.rint(x[order] / GRID_RAD), axis=0, return_index=True)[1]
        return x[order[self._draw.permutation(first)[: self._samples]]]

    def _proven(self, a: Rows, b: Rows, target: int, turns: bool, tip: bool = True) -> Bool[np.ndarray, "n"]:
        """Return a mask of the straight joint paths that are proven on the segment to a target, or as self-motions."""
        if not len(a):
            return np.zeros(0, bool)
        one = np.full(len(a), target)
        inputs, tube = inputs_and_tubes(self._problem, np.full(len(a), self._scenario), one, np.zeros_like(one), turns)
        return self._checker.edges(inputs, a, b, tube, tip=tip).verdict == SegmentStatus.VALID

    def _joined(self, vertices: Rows, x: Rows, target: int) -> Bool[np.ndarray, "n"]:
        """Return a mask of the samples to which a proven self-motion leads from one of the nearest vertices."""
        good = np.zeros(len(x), bool)
        if not len(x):
            return good
        away, nearest = cKDTree(vertices).query(x, k=range(1, NEAREST + 1), distance_upper_bound=NEAR_RAD)
        for k in range(NEAREST):
            row = np.flatnonzero(np.isfinite(away[:, k]) & ~good)
            if not len(row):
                break
            begin, end = vertices[nearest[row, k]], x[row]
            inputs = self._problem.inputs(self._scenario, target, len(row))
            moved = self._checker.executor(SELF_MOTION, inputs, begin, end, np.zeros(len(row), np.int32))
            arrived = np.flatnonzero(moved.arrives)
            steps = moved.steps[arrived]
            places = np.concatenate([begin[:, None], moved.path.x, end[:, None]], axis=1)[arrived]
            lane = np.repeat(np.arange(len(arrived)), steps + 1)
            step = np.arange(len(lane)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
            after = np.where(step == steps[lane], places.shape[1] - 1, step + 1)
            bad = ~self._proven(places[lane, step], places[lane, after], target, turns=True, tip=False)
            good[row[arrived]] = np.bincount(lane, bad, len(arrived)) == 0
        return good


def counts(batch: Batch, row: int, samples: int) -> list[int | str]:
    """Return a scenario's row of the table: targets, results of the reference and the beam, and CPU times [s]."""
    cell, settings = batch.cells[batch.cell[row]], replace(batch.points[row].config.settings, transfers=True)
    one = jax.tree.map(lambda leaf: leaf[row : row + 1], batch.scenarios)
    began, execution = time.process_time(), Execution(threads=1)
    problem = Problem.of(cell.robot, cell.workpiece, one, settings, cell.task, cell.obstacles, execution)
    plans, planned = plan(problem, "beam"), time.process_time()
    found = sum(len(x) > 0 for x in Ladder(problem, 0, samples).rungs())
    spent = f"{time.process_time() - planned:.0f}", f"{planned - began:.0f}"
    return [int(one.count[0]), found, int(plans.tracked[0].sum()), int(plans.executable[0].sum()), *spent]


def main() -> None:
    """Print a row for each scenario."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweep", type=Path)
    parser.add_argument("--config", type=Path, default=Path(__file__).parents[1] / "configs/duct.yaml")
    parser.add_argument("--scenarios", help="numbers of scenarios, separated by commas; default: all")
    parser.add_argument("--samples", type=int, default=5000)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    chosen = parser.parse_args()
    cache_folder.enable()
    batch = load_sweep(chosen.sweep, chosen.config, chosen.overrides).batch()
    numbers = batch.scenarios.number.tolist()
    print(hardware.line())
    print(f"{chosen.samples} samples per target; processor seconds of the reference and of the beam")
    print(ROW.format("scenario", "targets", "reference", "tracked", "executable", "ref s", "beam s"), flush=True)
    for number in map(int, chosen.scenarios.split(",")) if chosen.scenarios else numbers:
        print(ROW.format(number, *counts(batch, numbers.index(number), chosen.samples)), flush=True)


if __name__ == "__main__":
    main()
