"""Record the null-space subproblems (11) by which `tests/test_sphere.py` tests the minimisers.

The poses of the workpiece sweep are planned on the generated duct by the baseline with one clearance row and margin 0,
which fails on most of them. Each failed target gives one configuration by inverse kinematics, as in Algorithm 1,
and further ones by random null-space offsets from it. Only configurations and poses are kept. Run it again only when
the problem itself changes:

    python benchmarks/record_subproblems.py
"""

import itertools
from pathlib import Path

import jax
import numpy as np

from htcp_jax.caching import cache_folder
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import gp50
from htcp_jax.model.inverse_kinematics import reanchor
from htcp_jax.model.kinematics import jacobian
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import Problem
from htcp_jax.numerics import null_basis
from htcp_jax.planning.batch import plan
from htcp_jax.settings import Settings

START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)
COUNT = 200
OFFSET_RAD = 0.6  # about the displacement of the null-space recovery in its first steps
OUT = Path(__file__).parents[1] / "tests" / "data" / "subproblems.npz"


def main() -> None:
    robot, workpiece = gp50(), load_workpiece()
    steps = 0.1 * np.arange(-3, 4)
    poses = [(0.5 + wy, wz) for wy, wz in itertools.product(steps, steps)]
    scenarios = stack(
        [make_scenario(robot, workpiece, START, rotation=pose, margin_m=0.0, number=n) for n, pose in enumerate(poses)]
    )
    settings = Settings(clearance_rows="smallest", cost_about="previous")
    plans = plan(Problem.of(robot, workpiece, scenarios, settings, check_paths=False), "baseline")
    tracked = np.sum(plans.status == 0, axis=1)
    stuck = np.flatnonzero(tracked < plans.status.shape[1])
    print(f"{len(stuck)} of {len(poses)} poses get stuck")

    @jax.jit
    def offset(x, target, w):
        x, _ = reanchor(robot, x, target, 1e-4)
        x, error = reanchor(robot, x + null_basis(jacobian(robot, x)) @ w, target, 1e-4)
        return x, error

    random = np.random.default_rng(0)
    rows = []
    for turn in itertools.count():
        for s in stuck:
            t = tracked[s]
            x_previous = scenarios.x_start[s] if t == 0 else plans.x[s, t - 1]
            w = random.normal(size=3)
            w *= 0.0 if turn == 0 else OFFSET_RAD * random.random() / np.linalg.norm(w)
            x, error = offset(x_previous, scenarios.targets[s, t], w)
            if error < 1e-3:
                rows.append((np.asarray(x), scenarios.T_world_workpiece[s], scenarios.interior_plane[s]))
            if len(rows) == COUNT:
                x, T_world_workpiece, interior_plane = (np.stack(column) for column in zip(*rows, strict=True))
                OUT.parent.mkdir(exist_ok=True)
                np.savez_compressed(OUT, x=x, T_world_workpiece=T_world_workpiece, gate=interior_plane)
                print(f"{OUT.name}: {COUNT} subproblems")
                return


if __name__ == "__main__":
    cache_folder.enable()
    main()
