"""Comparison of motion planners by executable targets (`peers --motions`).

Here every planner is a method of htcp_jax, including the peers: all get the same problem, plan on one thread, and are
checked by `motion.motion_check`; a peer's own verdicts are not used. "cpu s" is the CPU time of planning and of that
check, without compilation.
"""

import importlib
import time
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

import htcp_jax
from htcp_jax.jobs.grid import Batch
from htcp_jax.motion import Execution, Plans, Problem
from htcp_jax.planning import registry
from htcp_jax.planning.batch import plan
from htcp_jax.status import SegmentStatus

ROW = "{:18} {:>10} {:>6} {:>8} {:>8} {:>9}  {}"
HEAD = ROW.format("planner", "executable", "%", "tracked", "cpu s", "compile s", "by pose; segments that end a motion")
PEERS = {  # module, class, and message if it cannot be imported
    "ompl-projected": ("benchmarks.peer_ompl", "ProjectedRRTConnect", "ompl is missing: pip install -e '.[peers]'"),
    "descartes-ladder": (
        "benchmarks.peer_descartes",
        "LadderGraph",
        "tesseract-robotics-nanobind is missing: pip install -e '.[descartes]', in an environment without peers",
    ),
}
OWN = "nspace-sqp", "hybrid", "beam"
NAMES = (*OWN, *PEERS)


class PlannerResults(NamedTuple):
    """Results of a planner."""

    plans: Plans
    cpu_s: float
    compile_s: float


def rows(batch: Batch, names: list[str], limit_s: float):
    """Yield a line for every planner when it has finished.

    `limit_s` is the limit of CPU time per scenario for OMPL, which would search without end.
    """
    yield HEAD
    targets = int(batch.scenarios.count.sum())
    for name in names:
        try:
            results = _planned(batch, name, limit_s)
        except ImportError:
            yield ROW.format(name, *["--"] * 5, PEERS[name][2])
            continue
        ends = results.plans.outcomes
        good, refuted = (
            int(ends.executable.sum()),
            [
                SegmentStatus(segment_status).name
                for segment_status in ends.segment_status
                if segment_status != SegmentStatus.VALID
            ],
        )
        by_pose = " ".join(str(count) for count in ends.executable.tolist())
        share, tracked = f"{100 * good / targets:.1f}", int(ends.tracked.sum())
        note = f"{by_pose}; {', '.join(f'{refuted.count(name)} {name}' for name in sorted(set(refuted))) or 'none'}"
        yield ROW.format(name, good, share, tracked, f"{results.cpu_s:.1f}", f"{results.compile_s:.1f}", note)


def _planned(batch: Batch, name: str, limit_s: float) -> PlannerResults:
    if name in PEERS and name not in registry.names():
        module, kind, _ = PEERS[name]
        made = getattr(importlib.import_module(module), kind)
        htcp_jax.register(made(limit_s) if name == "ompl-projected" else made())

    def run(scenarios):
        settings = batch.points[0].config.settings
        return plan(Problem.of(batch.robot, batch.workpiece, scenarios, settings, execution=Execution(threads=1)), name)

    # A peer compiles for any number of targets; the shapes of a method of htcp_jax depend on all scenarios.
    few = jax.tree.map(lambda leaf: leaf[:1], batch.scenarios)
    compile_s = run(replace(few, count=np.minimum(few.count, 3)) if name in PEERS else batch.scenarios).compile_s
    began = time.process_time()
    plans = run(batch.scenarios)
    return PlannerResults(plans, time.process_time() - began, compile_s + plans.compile_s)
