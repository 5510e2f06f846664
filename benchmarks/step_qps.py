"""Solvers of the step QP on recorded QPs: agreement of verdicts and steps, and times.

    python -m benchmarks step-qps [--count 100000] [--set KEY=VALUE]...

The QPs are those that Clarabel solves while the poses are planned by the N-space sample planner, half of them under
configs/paper.yaml (one row, margin 0) and half under configs/duct.yaml (one row per body). Every verdict that differs
is listed with the slack of its rows: the largest t by which all of them can be satisfied, by scipy's LP. A slack within
1e-6 of 0 is undecidable for solvers with a tolerance of 1e-8.
"""

import argparse
import time
from pathlib import Path

import jax
import numpy as np
from scipy.optimize import linprog

from benchmarks import hardware
from htcp_jax.caching import cache_folder
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Problem
from htcp_jax.planning.batch import plan
from htcp_jax.planning.tracking import step_qps
from htcp_jax.solvers import ClarabelSolver
from htcp_jax.solvers.active_set import solve_step
from htcp_jax.solvers.step_qp import StepQP

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Record step QPs, solve them by every solver, and print times and differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    chosen = parser.parse_args()
    cache_folder.enable()
    print(hardware.line())
    for config in ("paper", "duct"):
        qps = _recorded(config, chosen.overrides, chosen.count // 2)
        exact, at_1e8 = (_clarabel(qps, tolerance) for tolerance in (1e-10, 1e-8))
        ours = _device(qps)
        print(f"{config}.yaml: {len(qps.b):,} QPs, {qps.h.shape[1]} clearance rows")
        for name, (y, status, microseconds) in {"clarabel 1e-8": at_1e8, "device": ours}.items():
            both = (status == 0) & (exact[1] == 0)
            apart = np.abs(y - exact[0])[both].max(initial=0.0)
            close = 100 * np.mean(np.abs(y - exact[0])[both].max(axis=1) <= 1e-6)
            other = np.flatnonzero(status != exact[1])
            print(
                f"  {name:14} {microseconds:6.1f} us a QP; against Clarabel at 1e-10: {len(other)} other verdicts, "
                f"largest difference {apart:.1e} rad, {close:.2f} % within 1e-6"
            )
            for k in other[:20]:
                print(f"      QP {k}: {exact[1][k]} -> {status[k]}, slack {_slack(qps, k):.1e}")


def _recorded(config: str, overrides: list[str], count: int) -> StepQP:
    """Record the first `count` step QPs of the sweep; if it has fewer, repeat them with up to 1 % other clearance."""
    spec = load_sweep(ROOT / "sweeps/workpiece.yaml", ROOT / f"configs/{config}.yaml", overrides)
    batch, seen = spec.batch(), []
    make = step_qps.make_solver

    class Recorder:
        def __init__(self, *arguments):
            self._solver = make(*arguments)

        def solve(self, qps):
            seen.append(qps)
            return self._solver.solve(qps)

    step_qps.make_solver = Recorder
    try:
        plan(Problem.of(batch.robot, batch.workpiece, batch.scenarios, spec.config.settings), "nspace-sample")
    finally:
        step_qps.make_solver = make
    qps = jax.tree.map(lambda *parts: np.concatenate(parts), *seen)
    random = np.random.default_rng(0)
    rows = np.resize(np.arange(len(qps.b)), count)
    scale = np.where(np.arange(count) < len(qps.b), 1.0, random.uniform(0.99, 1.01, count))
    qps = jax.tree.map(lambda table: table[rows], qps)
    return qps._replace(h=qps.h * scale[:, None])


def _clarabel(qps: StepQP, tolerance: float):
    solver = ClarabelSolver(qps.P[0], qps.h.shape[1], tolerance)
    began = time.perf_counter()
    y, status = solver.solve(qps)
    return y, status, 1e6 * (time.perf_counter() - began) / len(y)


def _device(qps: StepQP):
    side_by_side = 4 if jax.default_backend() == "cpu" else 8192
    program = jax.jit(lambda qps: jax.lax.map(solve_step, qps, batch_size=side_by_side))
    jax.block_until_ready(program(qps))
    began = time.perf_counter()
    y, status = jax.block_until_ready(program(qps))
    return np.asarray(y), np.asarray(status), 1e6 * (time.perf_counter() - began) / len(y)


def _slack(qps: StepQP, k: int) -> float:
    n = qps.q.shape[1]
    rows = np.concatenate([qps.G[k], np.eye(n), -np.eye(n)])
    bound = np.concatenate([qps.h[k], qps.ub[k], -qps.lb[k]])
    rows = np.concatenate([rows, np.ones((len(rows), 1))], axis=1)
    equal = np.concatenate([qps.A[k], np.zeros((len(qps.b[k]), 1))], axis=1)
    cost = np.append(np.zeros(n), -1.0)
    found = linprog(cost, rows, bound, equal, qps.b[k], bounds=[(None, None)] * n + [(None, 1.0)])
    return float(-found.fun) if found.success else float("nan")


if __name__ == "__main__":
    main()
