"""Times of sweeps under configs/paper.yaml: by default both of the paper's tables by its six planners.

    python -m benchmarks tables [--sweeps robot,workpiece] [--methods A,B] [--every N] [--device cpu|gpu[:N]]
        [--config FILE] [--profile] [--processes N] [--no-paths] [--set KEY=VALUE]... [--json FILE]

Every method runs twice: the first run compiles, the second is timed, joint-path checks of all accepted steps included.
"""

import argparse
import resource
import time
from pathlib import Path

import jax
import numpy as np

from benchmarks import hardware
from benchmarks.figures import Figure, save
from htcp_jax.caching import cache_folder
from htcp_jax.cli.output import claim_device
from htcp_jax.device import Executor
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning.batch import plan
from htcp_jax.runs.summary import summarise
from htcp_jax.solvers import ClarabelSolver

ROOT = Path(__file__).resolve().parents[1]
SIX = "baseline,cspace-sample,nspace-sample,nspace-sqp,nspace-ip,nspace-cmaes"


def main() -> None:
    """Plan every sweep by every method, and print the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sweeps", default="robot,workpiece")
    parser.add_argument("--methods", default=SIX)
    parser.add_argument("--every", type=int, default=1, help="only every N-th scenario")
    parser.add_argument("--copies", type=int, default=1, help="copies of every scenario, to see the memory")
    parser.add_argument("--device")
    parser.add_argument("--processes", type=int, help="as many share the scenarios; by default as many as pay")
    parser.add_argument("--config", type=Path, default=ROOT / "configs/paper.yaml")
    parser.add_argument("--profile", action="store_true", help="seconds and lanes by lane function")
    parser.add_argument("--no-paths", action="store_true", help="skip the joint-path checks")
    parser.add_argument("--once", action="store_true", help="time the first run, less its compilation")
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the seconds and counts as JSON, too")
    chosen = parser.parse_args()
    cache_folder.enable()
    claim_device(chosen.device)  # before anything is computed
    spent = _watch() if chosen.profile else {}
    print(hardware.line())
    head = f"{'sweep':10} {'method':14} {'tracked':>20} {'%':>6} {'compile s':>9} {'run s':>8} {'us a step':>9}"
    print(head, flush=True)
    total, rows = 0.0, []
    for sweep in chosen.sweeps.split(","):
        spec = load_sweep(ROOT / f"sweeps/{sweep}.yaml", chosen.config, chosen.overrides)
        batch = spec.batch()
        scenarios = jax.tree.map(lambda leaf: np.concatenate([leaf[:: chosen.every]] * chosen.copies), batch.scenarios)
        for method in chosen.methods.split(","):

            def run(method=method, batch=batch, scenarios=scenarios, settings=spec.config.settings):
                processes = 1 if chosen.profile else chosen.processes  # the profile is of this process only
                how = {"check_paths": not chosen.no_paths, "execution": Execution(chosen.device, processes=processes)}
                return plan(Problem.of(batch.robot, batch.workpiece, scenarios, settings, **how), method)

            plans = first = run()
            if not chosen.once:
                spent.clear()
                plans = run()
            found = summarise(plans)
            total += plans.run_s
            rows.append(Figure(f"{sweep} {method}", plans.run_s, "s", found.tracked))
            tracked = f"{found.tracked:,} of {found.targets:,}"
            step = 1e6 * plans.run_s / max(found.tracked, 1)
            rate = 100 * found.success_rate
            times = f"{first.compile_s:9.1f} {plans.run_s:8.2f} {step:9.0f}"
            print(f"{sweep:10} {method:14} {tracked:>20} {rate:6.2f} {times}", flush=True)
            for name, (seconds, calls, lanes) in sorted(spent.items(), key=lambda item: -item[1][0]):
                each = 1e6 * seconds / lanes
                print(f"    {name:12} {seconds:8.2f} s {calls:8,} calls {lanes:10,} lanes {each:9.1f} us a lane")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"run in all {total:.1f} s; largest memory {peak:.1f} GiB")
    save(chosen.json, rows)


def _watch() -> dict[str, tuple[float, int, int]]:
    """Start counting seconds, calls and lanes by compiled function and in the QP solver, summed over threads."""
    spent: dict[str, tuple[float, int, int]] = {}

    def watched(own, named):
        def call(self, *arguments):
            began, compiled = time.perf_counter(), getattr(self, "compile_s", 0.0)
            result = own(self, *arguments)
            seconds = time.perf_counter() - began - (getattr(self, "compile_s", 0.0) - compiled)
            name = named(arguments)
            before = spent.get(name, (0.0, 0, 0))
            lanes = len(jax.tree.leaves(arguments)[-1])
            spent[name] = (before[0] + seconds, before[1] + 1, before[2] + lanes)
            return result

        return call

    Executor.__call__ = watched(Executor.__call__, lambda arguments: arguments[0].name)
    ClarabelSolver.solve = watched(ClarabelSolver.solve, lambda arguments: "clarabel")
    return spent


if __name__ == "__main__":
    main()
